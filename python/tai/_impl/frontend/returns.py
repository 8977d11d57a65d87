"""`return`: the last statement of a function, or anywhere in it.

A conditional return sets a flag and the results, and the statements after it run only
while the flag is not set. Both are variables like those of the program, so that branches and
loops carry them, and gradients pass through them.
"""

from __future__ import annotations

import ast
from typing import Any

from ...errors import TaiSyntaxError, TaiTypeError
from ..base.dtypes import DataType, i64, promote, u1, u64
from ..values.value import MatrixValue, Value
from .context import Context, Part
from .parameters import Parameters
from .refs import Variable, VariablePlace
from .structs import variables_of


def find_return(statements: list[ast.stmt]) -> ast.Return | None:
    """Finds a `return` anywhere in the statements, or None."""
    for statement in statements:
        for node in ast.walk(statement):
            if isinstance(node, ast.Return):
                return node
    return None


def always_returns(statements: list[ast.stmt]) -> bool:
    """Whether the statements certainly end by `return`, judged by their form alone."""
    last = statements[-1] if statements else None
    if isinstance(last, ast.If):
        return always_returns(last.body) and always_returns(last.orelse)
    return isinstance(last, ast.Return)


def _returns_inside(node: ast.FunctionDef) -> bool:
    """Whether a branch or loop of the function contains a `return`."""
    return find_return([s for s in node.body if not isinstance(s, ast.Return)]) is not None


class Results:
    """The results of a function that returns from inside of branches and loops.

    Attributes:
        returned: the flag.
        parts: a variable for each number, vector or matrix.
        is_tuple: whether the function returns a tuple of them.
    """

    def __init__(self, returned: Variable, parts: list[Variable], is_tuple: bool):
        self.returned, self.parts, self.is_tuple = returned, parts, is_tuple

    @property
    def variables(self) -> list[Variable]:
        return [self.returned, *self.parts]

    @property
    def may_have_run(self) -> bool:
        return self.returned.value.const is not False


class _Form:
    """The types of the results of a function, which a first walk over its body finds."""

    def __init__(self) -> None:
        self.types: list[tuple[DataType, tuple[int, ...]]] | None = None
        self.is_tuple = False

    def add(self, values: list[Value], is_tuple: bool) -> None:
        if self.types is None:
            self.types = [(v.dt, v.shape) for v in values]
            self.is_tuple = is_tuple
            return
        if is_tuple != self.is_tuple or len(values) != len(self.types):
            raise TaiTypeError(
                f"one return gives {_count(len(self.types))} and another {_count(len(values))}",
                "return the same number of values everywhere",
            )
        for number, (value, (dt, shape)) in enumerate(zip(values, self.types, strict=True)):
            if value.shape and shape and value.shape != shape:
                raise TaiTypeError(
                    f"one return gives a {value.kind_name} and another one of shape {shape}"
                )
            self.types[number] = (promote(dt, value.dt), shape or value.shape)


def _count(count: int) -> str:
    return "no value" if count == 0 else "1 value" if count == 1 else f"{count} values"


class Returns(Part):
    """The part of the compiler that handles `return`.

    Args:
        context, parameters: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, parameters: Parameters):
        super().__init__(context)
        self.parameters = parameters
        # The result types of inlined functions that may return early, by the types of their
        # parameters.
        self._forms: dict[tuple, _Form] = {}

    def prepare_returns(self) -> None:
        """Makes variables for the results of the current function, if it may return early.

        Called where its body begins, once its parameters are defined.
        """
        frame = self.frame
        if not _returns_inside(frame.node):
            return
        kernel = self.context.kernel
        if frame.kind == "kernel":
            types = [] if kernel.result is None else [(kernel.result.dt, kernel.result.shape)]
            self._make_results(types, False)
        elif (several := getattr(frame.result_type, "types", None)) is not None and all(
            hasattr(type_, "dtype") for type_ in several
        ):
            self._make_results([(type_.dtype, type_.shape) for type_ in several], True)
        elif hasattr(frame.result_type, "dtype"):
            self._make_results([(frame.result_type.dtype, frame.result_type.shape)], False)
        else:
            form = self._find_form()
            self._make_results(form.types or [], form.is_tuple)

    def _make_results(self, types: list, is_tuple: bool) -> None:
        emitter, parts = self.emitter, []
        for dt, shape in types:
            zero = emitter.broadcast(emitter.constant(0, dt), shape)
            parts.append(Variable("result", zero))
        returned = Variable("return", emitter.constant(False, u1))
        self.frame.results = Results(returned, parts, is_tuple)

    def _find_form(self) -> _Form:
        """Compiles the function once into an unused region, only to find the types of its
        results.
        """
        frame, builder = self.frame, self.builder
        key = (frame.function, *(_kind(frame.scopes[0].get(n)) for n in frame.scopes[0]))
        known = self._forms.get(key)
        if known is not None:
            return known
        form = frame.form = _Form()
        scopes = [scope for f in self.context.frames for scope in f.scopes]
        variables = {id(v): v for s in scopes for m in s.values() for v in variables_of(m)}
        flags = [v for f in self.context.frames if f.results for v in f.results.variables]
        loops = [loop for f in self.context.frames for loop in f.loops]
        flags += [v for loop in loops for v in (loop.broken, loop.skipped) if v is not None]
        saved = [(v, v.value, v.hidden) for v in [*variables.values(), *flags]]
        named = [(scope, dict(scope)) for scope in scopes]
        numbers, dead, outer = self.emitter.num_random, self.context.is_dead, builder.get_block()
        builder.set_block(builder.block(builder.region(), []))
        self.body(frame.node.body)
        builder.set_block(outer)
        self.emitter.num_random, self.context.is_dead = numbers, dead
        for variable, value, hidden in saved:
            variable.value, variable.hidden = value, hidden
        for scope, names in named:
            scope.clear()
            scope.update(names)
        frame.form, frame.has_returned, frame.result = None, False, None
        frame.gone.clear()
        self._forms[key] = form
        return form

    def visit_Return(self, node: ast.Return) -> None:
        frame, results = self.frame, self.frame.results
        self.refuse_parallel_return(node)
        value = None if node.value is None else self.visit(node.value)
        self.at(node)
        if frame.form is not None:
            frame.form.add(*self._parts_of(value))
            self.context.is_dead = True
            return
        if self.context.depth == frame.depth and (results is None or not results.may_have_run):
            frame.has_returned = True
            if frame.kind == "kernel":
                self.parameters.return_from_kernel(value, node)
            else:
                frame.result = self.convert_result(value)
            return
        self._set_results(value)
        self.context.is_dead = True

    def refuse_parallel_return(self, node: ast.Return) -> None:
        """Refuses a `return` in a parallel loop, which cannot be left early."""
        if any(loop.kind == "parallel" for loop in self.frame.loops):
            raise TaiSyntaxError(
                "the outermost loop of a kernel runs in parallel and cannot be left by 'return'",
                "end one iteration by 'continue', or write ti.loop_config(serialize=True) before "
                "the loop",
            )

    def _parts_of(self, value: Any) -> tuple[list[Value], bool]:
        """Returns the values of a `return` statement, and whether they form a tuple."""
        if value is None:
            return [], False
        if isinstance(value, tuple):
            return [self._computed(v) for v in value], True
        return [self._computed(value)], False

    def _computed(self, value: Any) -> Value:
        default = self.context.options.default_ip
        if isinstance(value, int) and not default.min <= value <= default.max:
            return self.emitter.constant(value, i64 if value <= i64.max else u64)
        try:
            return self.emitter.as_value(value)
        except TaiTypeError as error:
            raise TaiTypeError(
                "a 'return' inside of a branch or loop gives numbers, vectors or matrices: "
                + error.message,
            ) from None

    def _set_results(self, value: Any) -> None:
        emitter, results = self.emitter, self.frame.results
        if self.frame.kind == "kernel":
            self.parameters.check_kernel_result(value)
            is_whole = hasattr(value, "members") or isinstance(value, (tuple, list))
            if is_whole and self.context.kernel.result is not None:
                value = self.context.kernel.result.convert(emitter, value)
        parts, is_tuple = self._parts_of(value)
        if len(parts) != len(results.parts) or is_tuple != results.is_tuple:
            raise TaiTypeError(
                f"the function returns {_count(len(results.parts))}, but {_count(len(parts))} here"
            )
        given = value if is_tuple else (value,)
        for variable, part, source in zip(results.parts, parts, given, strict=False):
            place = VariablePlace(emitter, variable)
            exact = isinstance(source, (bool, int, float)) and not place.shape
            if part.shape != place.shape and (part.shape or place.shape):
                raise TaiTypeError(f"returns a {part.kind_name}, but {place._kind()} elsewhere")
            variable.value = place.convert(source if exact else part)
        results.returned.value = emitter.constant(True, u1)

    def finish_function(self) -> Any:
        """The result of an inlined function, once its body has been compiled."""
        frame, results = self.frame, self.frame.results
        if frame.has_returned or results is None or not results.may_have_run:
            return frame.result
        self.refuse_open_end()
        values = [variable.value for variable in results.parts]
        if results.is_tuple:
            return tuple(values)
        return values[0] if values else None

    def refuse_open_end(self) -> None:
        """Refuses a function that returns a value on some paths and ends without `return` on
        others.
        """
        if self.context.is_dead or not self.frame.results.parts:
            return
        frame = self.frame
        error = TaiSyntaxError(
            f"'{frame.name}' returns a value in some branches, but can end without a return",
            "return a value at its end, too",
        )
        node = frame.node
        raise error.locate(frame.filename, node.lineno, node.col_offset + 1)

    def returned_since(self, statements: list[ast.stmt]) -> Value | None:
        """Returns the flag that says that the statements have returned; None if they cannot."""
        results = self.frame.results
        if results is None or not results.may_have_run or find_return(statements) is None:
            return None
        return results.returned.value

    def exit_flags(self, broken: Variable | None, statements: list[ast.stmt]) -> list[Variable]:
        """The flags that end a loop with this body early: the flag of `break`, and the flag of
        `return`.
        """
        flags = [] if broken is None else [broken]
        if self.frame.results is not None and find_return(statements) is not None:
            flags.append(self.frame.results.returned)
        return flags

    def running(self, flags: list[Variable]) -> Value:
        """Returns the condition that no return flag is set."""
        stopped = flags[0].value
        for flag in flags[1:]:
            stopped = self.emitter.binary("|", stopped, flag.value)
        return self.emitter.unary("not", stopped)

    def convert_result(self, value: Any) -> Any:
        """The result of a `ti.func` in the type of its annotation, if it has one."""
        dtype = self.frame.result_type
        if dtype is None or value is None:
            return value
        return dtype.convert(self.emitter, value)


def _kind(meaning: Any) -> Any:
    """A key for the type of a parameter: equal for equal types."""
    value = meaning.value if isinstance(meaning, Variable) else getattr(meaning, "thing", meaning)
    if isinstance(value, (Value, MatrixValue)):
        return (value.dt.name, value.shape, value.const)
    return _Same(value)


class _Same:
    """A key that is equal only for the same object. The key keeps the object alive, because another
    object could get the same identity later.
    """

    __slots__ = ("_thing",)

    def __init__(self, thing: Any):
        self._thing = thing

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, _Same) and self._thing is other._thing

    def __hash__(self) -> int:
        return id(self._thing)
