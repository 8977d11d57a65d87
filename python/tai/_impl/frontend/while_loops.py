"""`while`, `break` and `continue`."""

from __future__ import annotations

import ast
from collections.abc import Callable

from ...errors import TaiSyntaxError
from ..base.dtypes import u1
from ..values.value import Value
from .checks import refuse_condition
from .context import Context, Part
from .refs import Variable
from .regions import Regions
from .returns import Returns, find_return
from .scope import Loop, StaticBreak, StaticContinue
from .source import own_exits


class WhileLoops(Part):
    """The part of the compiler that handles `while`, `break` and `continue`.

    Args:
        context, returns, regions: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, returns: Returns, regions: Regions):
        super().__init__(context)
        self.returns, self.regions = returns, regions

    def visit_While(self, node: ast.While) -> None:
        emitter = self.emitter
        loop = Loop("while", self.context.depth + 1)
        if own_exits(node.body):
            loop.broken = Variable("break", emitter.constant(False, u1))

        def condition() -> Value | None:
            value = self.visit(node.test)
            self.guarded(lambda _: refuse_condition(value), node.test)
            if isinstance(value, Value):
                return self.guarded(lambda _: emitter.to_bool(value), node.test)
            return None if value else emitter.constant(False, u1)

        self.frame.loops.append(loop)
        # The condition is evaluated as a statement, because it may call a function that changes a
        # variable.
        test = ast.copy_location(ast.Expr(node.test), node.test)
        variables = loop.carried = self.regions.changed_by([test], node.body)
        self.frame.loops.pop()
        self._carried_while(loop, variables, condition, node)
        # Without a condition and without `break`, only a `return` leaves the loop.
        endless = isinstance(node.test, ast.Constant) and node.test.value
        returns = find_return(node.body) is not None
        self.context.is_dead = bool(endless) and loop.broken is None and returns

    def _carried_while(
        self,
        loop: Loop,
        variables: list[Variable],
        condition: Callable[[], Value | None],
        node: ast.While,
    ) -> None:
        """Emits an `scf.while` whose `condition` is no longer evaluated after a `break`."""
        emitter, builder = self.emitter, self.builder
        flags = self.returns.exit_flags(loop.broken, node.body)
        variables = [*(f for f in flags if f not in variables), *variables]
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in variables]
        initial = [v.value.handle for v in variables]
        outer = builder.get_block()
        before, after = builder.region(), builder.region()
        names = [v.name for v in variables]
        head = builder.block(before, types, names)
        builder.set_block(head)
        self.regions.take_arguments(head, variables)
        self.context.depth += 1
        if not flags:
            go_on = condition()
            if go_on is None:
                go_on = emitter.constant(True, u1)
        else:
            go_on = self._both(self.returns.running(flags), condition, variables)
        self.at(node)
        builder.condition_of_while(go_on.handle, [v.value.handle for v in variables])
        block = builder.block(after, types, names)
        builder.set_block(block)
        self.regions.take_arguments(block, variables)
        self.regions.loop_body(loop, node)
        self.context.depth -= 1
        self.at(node)
        builder.yield_([v.value.handle for v in variables])
        builder.set_block(outer)
        results = builder.while_(initial, types, before, after)
        self.regions.take_results(results, variables)

    def _both(
        self, running: Value, condition: Callable[[], Value | None], variables: list[Variable]
    ) -> Value:
        """Emits `running and condition()`, which evaluates the condition only while `running`
        holds.

        Args:
            variables: those that the condition may change are among them.
        """
        emitter, builder = self.emitter, self.builder
        before = [v.value for v in variables]
        outer = builder.get_block()
        region = builder.region()
        builder.set_block(builder.block(region, []))
        value = condition()
        value = running if value is None else value
        changed = [v for v, old in zip(variables, before, strict=True) if v.value is not old]
        builder.yield_([value.handle, *(v.value.handle for v in changed)])
        for variable, old in zip(variables, before, strict=True):
            variable.value = old
        other = builder.region()
        builder.set_block(builder.block(other, []))
        no = emitter.constant(False, u1)
        builder.yield_([no.handle, *(v.value.handle for v in changed)])
        builder.set_block(outer)
        if value is running:
            return running
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in changed]
        results = builder.if_(running.handle, [emitter.type_of(u1), *types], region, other)
        first, *rest = results if changed else [results]
        self.regions.take_results(rest[0] if len(rest) == 1 else rest, changed)
        return Value(emitter, first, u1)

    def visit_Break(self, node: ast.Break) -> None:
        loop = self._innermost_loop("break")
        if loop.kind == "static":
            raise StaticBreak
        if loop.kind == "parallel":
            raise TaiSyntaxError(
                "the outermost loop of a kernel runs in parallel and cannot be left by 'break'",
                "write ti.loop_config(serialize=True) before the loop",
            )
        assert loop.broken is not None
        loop.broken.value = self.emitter.constant(True, u1)
        self.context.is_dead = True

    def visit_Continue(self, node: ast.Continue) -> None:
        loop = self._innermost_loop("continue")
        if loop.kind == "static":
            raise StaticContinue
        assert loop.skipped is not None
        loop.skipped.value = self.emitter.constant(True, u1)
        self.context.is_dead = True

    def _innermost_loop(self, word: str) -> Loop:
        if not self.frame.loops:
            raise TaiSyntaxError(f"'{word}' outside of a loop")
        loop = self.frame.loops[-1]
        if loop.kind == "static" and self.context.depth > loop.depth:
            raise TaiSyntaxError(
                f"'{word}' of a ti.static loop depends on what is known only when the kernel runs",
                "loop with range(…) instead of ti.static(range(…))",
            )
        return loop
