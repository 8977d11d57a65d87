"""Statements: assignments, branches, `while`, `assert`."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiSyntaxError, TaiTypeError
from ..base.dtypes import DataType, u1
from ..fields.field import Field
from ..values.misuse import describe_misuse, misuse_hint
from ..values.ops import stop_grad
from ..values.value import Value
from .checks import refuse_condition
from .expressions import BINARY
from .printing import FormattedText
from .refs import Place, Variable, VariablePlace
from .returns import always_returns, find_return
from .scope import Bound, Loop
from .source import AssignedNames, own_exits
from .structs import StructPlace, StructValue, StructVariable

_ATOMIC_ASSIGN = {"+", "-", "&", "|", "^"}

_REFUSED = {
    ast.Try: ("'try'", "check conditions with if, or use assert"),
    ast.With: ("'with'", None),
    ast.Raise: ("'raise'", "use assert"),
    ast.Delete: ("'del'", None),
    ast.Global: ("'global'", "use a field to change what others see"),
    ast.Nonlocal: ("'nonlocal'", "use a field to change what others see"),
    ast.Import: ("'import'", "import at the top of the file"),
    ast.ImportFrom: ("'import'", "import at the top of the file"),
    ast.FunctionDef: ("function definitions", "define a @ti.func outside"),
    ast.ClassDef: ("class definitions", None),
    ast.AsyncFor: ("'async for'", None),
    ast.AsyncWith: ("'async with'", None),
    ast.AsyncFunctionDef: ("coroutines", None),
    ast.Match: ("'match'", "use if and elif"),
}


def refuse_truth_arithmetic(op: str, dt: DataType) -> None:
    """Refuses to count in a place that holds true or false."""
    if dt.is_bool and op not in ("&", "|", "^", "min", "max"):
        raise TaiTypeError(
            f"'{op}' counts, but the target holds {dt}: true or false",
            "use |= or &=, or a ti.i32 to count in",
        )


class StaticBreak(Exception):
    """`break` in a loop that is unrolled."""


class StaticContinue(Exception):
    """`continue` in a loop that is unrolled."""


class Statements:
    """The part of the compiler that walks statements."""

    emitter: Any
    builder: Any
    frame: Any
    depth: int
    top_depth: int
    # Set while the statements that follow cannot be reached.
    is_dead: bool

    def body(self, statements: list[ast.stmt]) -> None:
        """Compiles a list of statements; what follows a possible exit runs only without it."""
        outer, self.emitter.stopped = self.emitter.stopped, self.stopped_in(statements)
        try:
            self.statements(statements)
        finally:
            self.emitter.stopped = outer

    def stopped_in(self, statements: list[ast.stmt]) -> set[int]:
        """The places that `ti.stop_grad(field)` makes constants, here and around.

        The statement holds for the whole block that it stands in.
        """
        found = self.emitter.stopped
        for statement in statements:
            call = getattr(statement, "value", None)
            if not isinstance(statement, ast.Expr) or not isinstance(call, ast.Call):
                continue
            if len(call.args) == 1 and self.static_callee(call.func) is stop_grad:
                field = self.static_callee(call.args[0])
                if isinstance(field, Field):
                    field.materialize()
                    found = found | {id(field), *map(id, getattr(field, "parts", ()))}
        return found

    def statements(self, statements: list[ast.stmt]) -> None:
        """Compiles the statements of a block."""
        for number, statement in enumerate(statements):
            rest = statements[number + 1 :]
            if isinstance(statement, ast.If) and rest and always_returns(statement.body):
                # What follows is all that the other branch does.
                self.guarded(lambda node, rest=rest: self.visit_If(node, rest), statement)
                return
            self.visit(statement)
            if self.is_dead or self.frame.has_returned:
                return
            running = self.still_running(statement) if rest else None
            if running is not None:
                self.rest_of_body(running, lambda rest=rest: self.body(rest), rest, statement)
                return

    def rest_of_body(
        self, running: Value, action: Callable[[], None], rest: list[ast.stmt], node: ast.stmt
    ) -> None:
        """What runs only if nothing has been left before."""
        is_dead = self.branch(running, self.as_top(action), None, rest, node)[0]
        # Either it was left before, or it is left there.
        self.is_dead = is_dead

    def as_top(self, action: Callable[[], None]) -> Callable[[], None]:
        """Lets the outermost loops of what follows a return still run in parallel."""
        if self.depth != self.top_depth:
            return action

        def wrapped() -> None:
            self.top_depth += 1
            action()
            self.top_depth -= 1

        return wrapped

    def still_running(self, statement: ast.stmt) -> Value | None:
        """The condition that a statement was not left by an exit, or None if surely."""
        stopped = self.returned_since([statement])
        loop = self.frame.loops[-1] if self.frame.loops else None
        if (
            loop is not None
            and loop.kind != "static"
            and isinstance(statement, ast.If)
            and own_exits([statement])
        ):
            for flag in (loop.broken, loop.skipped):
                if flag is None or flag.value.const is False:
                    continue
                value = flag.value
                stopped = value if stopped is None else self.emitter.binary("|", stopped, value)
        return None if stopped is None else self.emitter.unary("not", stopped)

    # Regions

    def changed_by(self, *lists: list[ast.stmt]) -> list[Variable]:
        """The variables of this function that the statements may change."""
        known = self.frame.assigned
        collector = AssignedNames(self.takes_reference, self.is_settled, known)
        found: list[Variable] = []
        for statements in lists:
            for name in collector.collect(statements):
                meaning = self.frame.find(name)
                if isinstance(meaning, StructVariable):
                    found += [v for v in meaning.thing.variables() if v not in found]
                elif isinstance(meaning, Variable) and meaning not in found:
                    found.append(meaning)
            loop = self.frame.loops[-1] if self.frame.loops else None
            if loop is not None and own_exits(statements):
                for flag in (loop.broken, loop.skipped):
                    if flag is not None and flag not in found:
                        found.append(flag)
            if self.frame.results is not None and find_return(statements) is not None:
                found += [v for v in self.frame.results.variables if v not in found]
        return [v for v in found if v.hidden is None and v.fixed is None]

    def branch(
        self,
        condition: Value,
        then: Callable[[], None],
        orelse: Callable[[], None] | None,
        statements: list[ast.stmt],
        node: ast.stmt,
    ) -> list[bool]:
        """An `scf.if` that yields the variables that its branches change.

        Returns:
            For each branch, whether it ends by an exit.
        """
        emitter, builder = self.emitter, self.builder
        variables = self.changed_by(statements)
        before = [v.value for v in variables]
        outer = builder.get_block()
        after, blocks, regions, ends = [], [], [], []
        for action in (then, orelse):
            region = builder.region()
            regions.append(region)
            if action is None and not variables:
                continue
            block = builder.block(region, [])
            builder.set_block(block)
            if action is not None:
                self.depth += 1
                self.frame.push()
                action()
                self.frame.pop(node.lineno)
                self.depth -= 1
            ends.append(self.is_dead)
            self.is_dead = False
            blocks.append(block)
            after.append([v.value for v in variables])
            for variable, value in zip(variables, before, strict=True):
                variable.value = value
        merged = [
            number
            for number in range(len(variables))
            if any(values[number] is not before[number] for values in after)
        ]
        self.at(node)
        for block, values in zip(blocks, after, strict=True):
            builder.set_block(block)
            builder.yield_([values[number].handle for number in merged])
        builder.set_block(outer)
        types = [emitter.type_of(before[n].dt, before[n].shape) for n in merged]
        results = builder.if_(condition.handle, types, *regions)
        self.take_results(results, [variables[n] for n in merged])
        self.is_dead = len(ends) == 2 and all(ends)
        return ends or [False]

    def take_results(self, results: Any, variables: list[Variable]) -> None:
        """Gives the results of a structured op to the variables that it carries."""
        if len(variables) == 1:
            results = (results,)
        for variable, handle in zip(variables, results or (), strict=True):
            variable.value = self.emitter.value(handle, variable.value.dt, variable.value.shape)

    # Branches

    def visit_If(self, node: ast.If, rest: list[ast.stmt] | None = None) -> None:
        """A branch; `rest` is what follows where its first part returns."""
        static = self.static_argument(node.test)
        condition = self.visit(node.test) if static is None else self.visit_static(static)
        if isinstance(condition, Value) and static is not None:
            raise TaiTypeError(
                "the condition of 'if ti.static(…)' is known only when the kernel runs",
                "drop ti.static",
            )
        refuse_condition(condition)
        orelse = [*node.orelse, *(rest or [])]
        compile_else: Callable[[], None] | None = None
        if rest:
            compile_else = self.as_top(lambda: self.body(orelse))
        elif orelse:
            compile_else = lambda: self.body(orelse)  # noqa: E731
        if not isinstance(condition, Value):
            self.body(node.body if condition else orelse)
            return
        self.at(node)
        condition = self.emitter.to_bool(condition)
        self.branch(
            condition,
            lambda: self.body(node.body),
            compile_else,
            [*node.body, *orelse],
            node,
        )

    # Loops that carry variables

    def visit_While(self, node: ast.While) -> None:
        if node.orelse:
            raise TaiSyntaxError("'else' of a while is not supported in kernels")
        emitter = self.emitter
        loop = Loop("while", self.depth + 1)
        if own_exits(node.body):
            loop.broken = Variable("break", emitter.constant(False, u1))

        def condition() -> Value | None:
            value = self.visit(node.test)
            self.guarded(lambda _: refuse_condition(value), node.test)
            if isinstance(value, Value):
                return emitter.to_bool(value)
            return None if value else emitter.constant(False, u1)

        self.frame.loops.append(loop)
        variables = self.changed_by(node.body)
        self.frame.loops.pop()
        self.carried_while(loop, variables, condition, node)
        # Without a condition and `break`, only `return` leaves it.
        endless = isinstance(node.test, ast.Constant) and node.test.value
        self.is_dead = bool(endless) and loop.broken is None and bool(find_return(node.body))

    def carried_while(
        self,
        loop: Loop,
        variables: list[Variable],
        condition: Callable[[], Value | None],
        node: ast.While | ast.For,
        step: Callable[[], None] | None = None,
    ) -> None:
        """An `scf.while`; `condition` is not evaluated any more once `break` has run."""
        emitter, builder = self.emitter, self.builder
        flags = self.exit_flags(loop.broken, node.body)
        variables = [*(f for f in flags if f not in variables), *variables]
        types = [emitter.type_of(v.value.dt, v.value.shape) for v in variables]
        initial = [v.value.handle for v in variables]
        outer = builder.get_block()
        before, after = builder.region(), builder.region()
        names = [v.name for v in variables]
        head = builder.block(before, types, names)
        builder.set_block(head)
        self.take_arguments(head, variables)
        carried = [v.value.handle for v in variables]
        self.depth += 1
        if not flags:
            go_on = condition()
            if go_on is None:
                go_on = emitter.constant(True, u1)
        else:
            go_on = self.both(self.running(flags), condition)
        self.at(node)
        builder.condition_of_while(go_on.handle, carried)
        block = builder.block(after, types, names)
        builder.set_block(block)
        self.take_arguments(block, variables)
        self.loop_body(loop, node)
        if step is not None:
            step()
        self.depth -= 1
        self.at(node)
        builder.yield_([v.value.handle for v in variables])
        builder.set_block(outer)
        results = builder.while_(initial, types, before, after)
        self.take_results(results, variables)

    def both(self, running: Value, condition: Callable[[], Value | None]) -> Value:
        """`running and condition()`, evaluating the condition only while running."""
        emitter, builder = self.emitter, self.builder
        outer = builder.get_block()
        region = builder.region()
        builder.set_block(builder.block(region, []))
        value = condition()
        if value is None:
            builder.yield_([running.handle])
            value = running
        else:
            builder.yield_([value.handle])
        other = builder.region()
        builder.set_block(builder.block(other, []))
        builder.yield_([emitter.constant(False, u1).handle])
        builder.set_block(outer)
        if value is running:
            return running
        handle = builder.if_(running.handle, [emitter.type_of(u1)], region, other)
        return Value(emitter, handle, u1)

    def take_arguments(self, block: Any, variables: list[Variable], first: int = 0) -> None:
        """Gives the arguments of a block to the variables that a loop carries."""
        for number, variable in enumerate(variables):
            old = variable.value
            variable.value = self.emitter.value(block.argument(first + number), old.dt, old.shape)

    def loop_body(self, loop: Loop, node: ast.For | ast.While) -> None:
        """The statements of a loop, once."""
        if own_exits(node.body):
            loop.skipped = Variable("continue", self.emitter.constant(False, u1))
        self.frame.loops.append(loop)
        self.frame.push()
        self.body(node.body)
        self.frame.pop(node.lineno)
        self.frame.loops.pop()
        self.is_dead = False

    def visit_Break(self, node: ast.Break) -> None:
        loop = self.innermost_loop("break")
        if loop.kind == "static":
            raise StaticBreak
        if loop.kind == "parallel":
            raise TaiSyntaxError(
                "the outermost loop of a kernel runs in parallel and cannot be left by 'break'",
                "write ti.loop_config(serialize=True) before the loop",
            )
        loop.broken.value = self.emitter.constant(True, u1)
        self.is_dead = True

    def visit_Continue(self, node: ast.Continue) -> None:
        loop = self.innermost_loop("continue")
        if loop.kind == "static":
            raise StaticContinue
        loop.skipped.value = self.emitter.constant(True, u1)
        self.is_dead = True

    def innermost_loop(self, word: str) -> Loop:
        if not self.frame.loops:
            raise TaiSyntaxError(f"'{word}' outside of a loop")
        loop = self.frame.loops[-1]
        if loop.kind == "static" and self.depth > loop.depth:
            raise TaiSyntaxError(
                f"'{word}' of a ti.static loop depends on what is known only when the kernel runs",
                "loop with range(…) instead of ti.static(range(…))",
            )
        return loop

    # Assignments

    def visit_Assign(self, node: ast.Assign) -> None:
        static = self.static_argument(node.value)
        value = self.visit(node.value) if static is None else self.visit_static(static)
        for target in node.targets:
            self.at(node)
            self.guarded(lambda t: self.assign(t, value, node, static is not None), target)

    def assign(self, target: ast.expr, value: Any, node: ast.stmt, is_static: bool = False) -> None:
        if isinstance(target, (ast.Tuple, ast.List)):
            self.unpack(target, value, node, is_static)
            return
        if isinstance(target, ast.Name):
            self.assign_name(target.id, value, is_static)
            return
        if isinstance(target, ast.Starred):
            raise TaiSyntaxError("'*' in the target of an assignment is not supported in kernels")
        place = self.locate(target)
        self.at(node)
        if isinstance(place, Value):
            raise TaiTypeError(f"a {place.kind_name} that has no name cannot be changed")
        if not isinstance(place, Place):
            raise TaiTypeError(
                f"a kernel cannot change the Python object '{ast.unparse(target)}'",
                "use a field for what a kernel writes",
            )
        place.store(place.convert(self.number(value)))

    def number(self, value: Any) -> Any:
        """The right side of an assignment as something to compute with."""
        if isinstance(value, (Value, StructValue)):
            return value
        if isinstance(value, (bool, int, float, np.generic)):
            return value.item() if isinstance(value, np.generic) else value
        return self.emitter.as_value(value)

    def unpack(self, target: ast.Tuple | ast.List, value: Any, node: Any, is_static: bool) -> None:
        items = self.take_apart(value)
        if any(isinstance(t, ast.Starred) for t in target.elts):
            raise TaiSyntaxError("'*' in the target of an assignment is not supported in kernels")
        if len(items) != len(target.elts):
            raise TaiTypeError(f"{len(target.elts)} targets cannot take {len(items)} values")
        for one, item in zip(target.elts, items, strict=True):
            self.guarded(lambda t, item=item: self.assign(t, item, node, is_static), one)

    def assign_name(self, name: str, value: Any, is_static: bool) -> None:
        meaning = self.frame.find(name)
        if isinstance(meaning, Variable):
            place = VariablePlace(self.emitter, meaning)
            place.store(place.convert(self.number(value)))
            return
        if isinstance(meaning, StructVariable):
            meaning.store(value)
            return
        if isinstance(value, StructValue) and meaning is None and not is_static:
            self.frame.define(name, StructVariable(self.emitter, name, value))
            return
        if meaning is None and not is_static:
            self.warn_of_hidden_field(name)
        is_number = isinstance(value, (Value, bool, int, float, np.generic)) or getattr(
            value, "is_matrix", False
        )
        if meaning is not None and self.depth > 0 and self.frame.scopes[-1].get(name) is None:
            raise TaiTypeError(
                f"'{name}' is known at compile time outside of this block and cannot change in it",
                "give it another name",
            )
        if is_static or not is_number:
            self.frame.define(name, Bound(value))
            return
        self.frame.define(name, Variable(name, self.emitter.as_value(value)))

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is None:
            raise TaiSyntaxError("a variable needs a value", f"{ast.unparse(node)} = 0")
        if not isinstance(node.target, ast.Name):
            raise TaiSyntaxError("only variables are annotated")
        dtype = self.emitter.to_dtype(self.visit(node.annotation))
        if self.frame.find(node.target.id) is not None:
            raise TaiSyntaxError(f"variable '{node.target.id}' has its type already")
        value = self.visit(node.value)
        self.at(node)
        self.emitter.check_fraction(value, dtype, f"variable '{node.target.id}' of type {dtype}")
        if isinstance(value, (bool, int, float)):
            value = self.emitter.constant(value, dtype)
        else:
            value = self.emitter.cast(self.emitter.as_value(value), dtype)
        self.frame.define(node.target.id, Variable(node.target.id, value))

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        value = self.visit(node.value)
        op = BINARY[type(node.op)]
        place = self.guarded(self.locate, node.target)
        self.at(node)
        if not isinstance(place, Place):
            self.augment_static(node, op, place, value)
            return
        self.refuse_non_number(value, (value,))
        if isinstance(place, StructPlace):
            raise TaiTypeError("structs have no arithmetic", "compute with their members")
        value = self.number(value)
        refuse_truth_arithmetic(op, place.dt)
        if op in _ATOMIC_ASSIGN and place.dt.is_float and op in "&|^":
            raise TaiTypeError(f"'{op}=' takes whole numbers, but the target holds {place.dt}")
        if op not in _ATOMIC_ASSIGN or isinstance(place, VariablePlace):
            if (
                isinstance(place, VariablePlace)
                and place.variable.hidden is not None
                and (op in _ATOMIC_ASSIGN)
            ):
                place.atomic(op, place.convert(value))
                return
            place.store(place.convert(self.emitter.binary(op, place.load(), value)))
            return
        place.atomic(op, place.convert(value))

    def augment_static(self, node: ast.AugAssign, op: str, old: Any, value: Any) -> None:
        """`a += …` where `a` is known at compile time."""
        if (
            isinstance(node.target, ast.Name)
            and isinstance(self.frame.find(node.target.id), Bound)
            and not isinstance(old, Field)
        ):
            self.frame.define(node.target.id, Bound(self.emitter.binary(op, old, value)))
            return
        if isinstance(old, Field):
            raise TaiTypeError(describe_misuse(old), misuse_hint(old))
        raise TaiTypeError(
            f"a kernel cannot change the Python object '{ast.unparse(node.target)}'",
            "use a field for what a kernel writes",
        )

    # The rest

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.visit(node.value)

    def visit_Pass(self, node: ast.Pass) -> None:
        pass

    def visit_Assert(self, node: ast.Assert) -> None:
        condition = self.visit(node.test)
        refuse_condition(condition)
        text: Any = None if node.msg is None else self.visit(node.msg)
        if not isinstance(condition, Value):
            if not condition:
                raise TaiTypeError(f"the assertion never holds: {ast.unparse(node.test)}")
            return
        values: list[Value] = []
        if isinstance(text, FormattedText):
            text, values = text.text, text.values
        elif isinstance(text, tuple) and text and isinstance(text[0], str):
            values = [self.emitter.as_value(v) for v in text[1:]]
            text = text[0]
        elif text is None:
            text = f"assertion failed: {ast.unparse(node.test)}"
        elif not isinstance(text, str):
            raise TaiTypeError("the message of an assertion must be a string")
        self.at(node)
        condition = self.emitter.to_bool(condition)
        shown = [self.printable(v).handle for v in values]
        self.builder.assert_(condition.handle, text, shown)

    def convert_result(self, value: Any) -> Any:
        """The result of a `ti.func` in the type of its annotation, if it has one."""
        dtype = self.frame.result_type
        if dtype is None or value is None:
            return value
        return dtype.convert(self.emitter, value)

    def generic_statement(self, node: ast.stmt) -> None:
        what, hint = _REFUSED.get(type(node), (f"'{type(node).__name__}'", None))
        raise TaiSyntaxError(f"kernels have no {what}", hint)
