"""Blocks of statements, branches, `assert`, and errors for unsupported statements."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import partial
from typing import Any

from ...errors import TaiSyntaxError, TaiTypeError
from ..fields.field import Field
from ..fields.structs import parts_of
from ..values.ops import stop_grad
from ..values.value import Value
from .checks import refuse_condition
from .compile_time import CompileTime
from .context import Context, Part
from .printing import FormattedText, Printing
from .regions import Regions
from .returns import Returns, always_returns
from .source import own_exits

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
}


def refuse_statement(node: ast.stmt) -> None:
    what, hint = _REFUSED.get(type(node), (f"'{type(node).__name__}'", None))
    raise TaiSyntaxError(f"kernels have no {what}", hint)


class Statements(Part):
    """The part of the compiler that handles blocks of statements, branches and assertions.

    Args:
        context, compile_time, printing, returns, regions: other parts of the compiler, which it
            uses.
    """

    def __init__(
        self, context: Context, compile_time: CompileTime, printing: Printing, returns: Returns,
        regions: Regions,
    ):  # fmt: skip
        super().__init__(context)
        self.compile_time, self.printing = compile_time, printing
        self.returns, self.regions = returns, regions

    def block(self, statements: list[ast.stmt]) -> None:
        """Compiles a list of statements; statements behind a possible exit run only without it."""
        outer, self.emitter.stopped = self.emitter.stopped, self.stopped_in(statements)
        try:
            self._statements(statements)
        finally:
            self.emitter.stopped = outer

    def stopped_in(self, statements: list[ast.stmt]) -> set[int]:
        """Returns the fields that `ti.stop_grad(field)` makes constants, in these statements or
        around.

        The statement holds for the whole block that it stands in.
        """
        found = self.emitter.stopped
        for statement in statements:
            call = getattr(statement, "value", None)
            if not isinstance(statement, ast.Expr) or not isinstance(call, ast.Call):
                continue
            if len(call.args) == 1 and self.compile_time.static_callee(call.func) is stop_grad:
                field = self.compile_time.static_callee(call.args[0])
                if isinstance(field, Field):
                    field.materialize()
                    found = found | {id(field), *map(id, parts_of(field))}
        return found

    def _statements(self, statements: list[ast.stmt]) -> None:
        """Compiles the statements of a block."""
        for number, statement in enumerate(statements):
            rest = statements[number + 1 :]
            if isinstance(statement, ast.If) and rest and always_returns(statement.body):
                # The statements that follow an `if` with a return are compiled as its other branch.
                self.guarded(partial(self.visit_If, rest=rest), statement)
                return
            self.visit(statement)
            if self.context.is_dead or self.frame.has_returned:
                return
            running = self.still_running(statement) if rest else None
            if running is not None:
                self.rest_of_body(running, partial(self.block, rest), rest, statement)
                return

    def rest_of_body(
        self, running: Value, action: Callable[[], None], rest: list[ast.stmt], node: ast.stmt
    ) -> None:
        """Compiles statements that run only if no earlier statement has left the body."""
        is_dead = self.regions.branch(running, self.as_top(action), None, rest, node)[0]
        # The body has been left in both cases: by an earlier statement, or by these statements.
        self.context.is_dead = is_dead

    def as_top(self, action: Callable[[], None]) -> Callable[[], None]:
        """Wraps `action` so that outermost loops behind a return still run in parallel."""
        if self.context.depth != self.context.top_depth:
            return action

        def wrapped() -> None:
            self.context.top_depth += 1
            action()
            self.context.top_depth -= 1

        return wrapped

    def still_running(self, statement: ast.stmt) -> Value | None:
        """The condition that a statement has not left the body by a `break`, `continue` or
        `return`; None if it never leaves.
        """
        stopped = self.returns.returned_since([statement])
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

    def visit_If(self, node: ast.If, rest: list[ast.stmt] | None = None) -> None:
        """Compiles an `if`; `rest` are the statements after it, which become part of the `else`
        branch if the first branch returns.
        """
        condition, is_static = self.compile_time.evaluate(node.test)
        if isinstance(condition, Value) and is_static:
            raise TaiTypeError(
                "the condition of 'if ti.static(…)' is known only when the kernel runs",
                "drop ti.static",
            )
        self.guarded(lambda _: refuse_condition(condition), node.test)
        orelse = [*node.orelse, *(rest or [])]
        compile_else: Callable[[], None] | None = None
        if rest:
            compile_else = self.as_top(lambda: self.block(orelse))
        elif orelse:
            compile_else = lambda: self.block(orelse)  # noqa: E731
        if not isinstance(condition, Value):
            self.block(node.body if condition else orelse)
            return
        self.at(node)
        self.regions.branch(
            self.guarded(lambda _: self.emitter.to_bool(condition), node.test),
            lambda: self.block(node.body),
            compile_else,
            [*node.body, *orelse],
            node,
        )

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
        condition = self.guarded(lambda _: self.emitter.to_bool(condition), node.test)
        shown = [self.printing.printable(v).handle for v in values]
        self.builder.assert_(condition.handle, text, shown)
