"""Iteration spaces of `for` loops: ranges, boxes, fields, levels, arrays."""

from __future__ import annotations

import ast
from functools import reduce
from typing import Any, NoReturn

from ...errors import TaiSyntaxError, TaiTypeError
from ..base.dtypes import DataType, i32, i64, promote
from ..fields.field import Field
from ..fields.snode import Place, SNode
from ..fields.structs import StructField, first_of
from ..values import ops
from ..values.builder import FAIL_INDEX
from ..values.misuse import misuse_hint, said_as
from ..values.positions import require
from ..values.value import MatrixValue, Value
from .context import Context, Part
from .expressions import Expressions
from .refs import ArrayArgument, Variable, use_field
from .sparse import Level
from .worlds import batch_of


class Bounds:
    """The ranges of a loop: lower and upper bounds and the step, as numbers or values.

    Attributes:
        step: of all ranges, but where `steps` says another.
    """

    def __init__(
        self, lower: list[Any], upper: list[Any], step: Any = 1, steps: list[Any] | None = None
    ):
        self.lower, self.upper, self.step = lower, upper, step
        self.steps = [step] * len(lower) if steps is None else steps


class LoopDomains(Part):
    """The part of the compiler that finds the domain of a `for` and gives it its variables.

    Args:
        context, expressions: other parts of the compiler, which it uses.
    """

    def __init__(self, context: Context, expressions: Expressions):
        super().__init__(context)
        self.expressions = expressions

    def domain(self, node: ast.expr) -> tuple[Any, bool]:
        """The domain of a loop, `Bounds` or a field; and whether indices come as a vector."""
        if isinstance(node, ast.Call):
            function = self.visit(node.func)
            if function is range:
                return self._range_bounds(node), False
            if function is ops.grouped:
                if len(node.args) != 1:
                    raise TaiTypeError("ti.grouped takes one argument")
                inner, _ = self.domain(node.args[0])
                if (
                    isinstance(inner, Bounds)
                    and isinstance(node.args[0], ast.Call)
                    and (self.visit(node.args[0].func) is range)
                ):
                    raise TaiTypeError("ti.grouped takes a field or a ti.ndrange")
                return inner, True
            if function is ops.ndrange:
                return self._ndrange_bounds(self.expressions.items(node.args)), False
            thing = self.visit(node)
        else:
            thing = self.visit(node)
        if isinstance(thing, ops.ndrange):
            return self._ndrange_bounds(thing.arguments), False
        if isinstance(thing, ops.Grouped):
            if isinstance(thing.inner, ops.ndrange):
                return self._ndrange_bounds(thing.inner.arguments), True
            return self._field_domain(thing.inner), True
        if isinstance(thing, range):
            return Bounds([thing.start], [thing.stop], thing.step), False
        if isinstance(thing, (Field, SNode)):
            return self._field_domain(thing), False
        if isinstance(thing, ArrayArgument):
            shape = list(thing.shape)
            return Bounds([0] * len(shape), shape), False
        self._refuse_domain(thing, node)

    def _refuse_domain(self, thing: Any, node: ast.expr) -> NoReturn:
        text = ast.unparse(node)
        if isinstance(thing, Value) and not isinstance(thing, MatrixValue):
            raise TaiTypeError(f"a number cannot be looped over: {text}", f"for i in range({text})")
        if isinstance(thing, (list, tuple, MatrixValue, zip, enumerate, dict)) or getattr(
            thing, "is_matrix", False
        ):
            raise TaiSyntaxError(
                f"a loop over '{text}' is unrolled by the compiler and must say so",
                f"for … in ti.static({text})",
            )
        raise TaiTypeError(
            f"'{text}' cannot be looped over", "use range, ti.ndrange, a field, or ti.static"
        )

    def _field_domain(self, thing: Any) -> Any:
        if isinstance(thing, Place):
            thing = thing.field
        if isinstance(thing, SNode):
            if thing.kind == "root":
                raise TaiTypeError("ti.root cannot be looped over", "loop over a level or a field")
            return Level(thing, "a loop")
        if not isinstance(thing, Field):
            raise TaiTypeError("ti.grouped takes a field or a ti.ndrange")
        use_field(thing)
        return first_of(thing) if isinstance(thing, StructField) else thing

    def _range_bounds(self, node: ast.Call) -> Bounds:
        if node.keywords:
            raise TaiSyntaxError("range takes no keywords")
        parts = self.expressions.items(node.args)
        if not 1 <= len(parts) <= 3:
            raise TaiSyntaxError(f"range takes 1 to 3 arguments, but got {len(parts)}")
        step = 1
        if len(parts) == 3:
            step = self._step(parts.pop())
        lower, upper = (0, parts[0]) if len(parts) == 1 else parts
        for part in (lower, upper):
            self._check_bound(part)
        return Bounds([lower], [upper], step)

    def _step(self, step: Any) -> Any:
        """The step of a range: a number, or a value that is checked not to be 0."""
        self._check_bound(step)
        if isinstance(step, Value) and step.const is not None:
            step = step.const
        if not isinstance(step, Value):
            if int(step) == 0:
                raise TaiSyntaxError(
                    "the step of a range must not be 0",
                    "count up by a positive step, or down by a negative one",
                )
            return int(step)
        nonzero = self.emitter.compare("!=", step, 0)
        require(self.emitter, nonzero, "the step of a range must not be 0", [], FAIL_INDEX)
        return step

    def _check_bound(self, part: Any) -> None:
        whole = part.dt.is_int and not part.shape if isinstance(part, Value) else (
            isinstance(part, int) or hasattr(part, "__index__")
        )  # fmt: skip
        if not whole:
            hint = misuse_hint(part)
            if isinstance(part, Field):
                hint = f"to loop over it: for i in {part.name}"
            raise TaiTypeError(
                f"the bounds of a loop are whole numbers, but got {said_as(part)}",
                hint or "convert it: int(…)",
            )
        if isinstance(part, int) and not -(2**63) <= part < 2**63:
            raise TaiTypeError(
                "the bounds of a loop are whole numbers of 64 bits, but one has "
                f"{part.bit_length()} bits",
                "nest two loops",
            )

    def _ndrange_bounds(self, arguments: Any) -> Bounds:
        lower, upper = [], []
        for argument in arguments:
            if isinstance(argument, (tuple, list)):
                if len(argument) != 2:
                    raise TaiTypeError("a range of ti.ndrange is a number or a pair (begin, end)")
                low, high = argument
            elif isinstance(argument, MatrixValue) or getattr(argument, "is_matrix", False):
                for extent in argument:
                    self._check_bound(extent)
                    lower.append(0)
                    upper.append(extent)
                continue
            else:
                low, high = 0, argument
            self._check_bound(low)
            self._check_bound(high)
            lower.append(low)
            upper.append(high)
        if not lower:
            raise TaiTypeError("ti.ndrange takes at least one range")
        return Bounds(lower, upper)

    def targets(self, node: ast.For, rank: int, grouped: bool, field: Any = None) -> list[str]:
        """The names of the variables that get the loop indices; a single name if the indices are
        grouped to a vector.

        Args:
            field: the field over which the loop runs, for a hint.
        """
        return self.guarded(
            lambda target: self._names_in(target, rank, grouped, field), node.target
        )

    def _names_in(self, target: ast.expr, rank: int, grouped: bool, field: Any) -> list[str]:
        if grouped:
            if not isinstance(target, ast.Name):
                raise TaiSyntaxError("a loop over ti.grouped(…) has one variable, a vector")
            return [target.id]
        items = target.elts if isinstance(target, (ast.Tuple, ast.List)) else [target]
        names = [item.id for item in items if isinstance(item, ast.Name)]
        if len(names) != len(items):
            raise TaiSyntaxError("the variables of a loop are names")
        if len(items) != rank:
            variables = "1 variable" if len(items) == 1 else f"{len(items)} variables"
            hint = (
                "use ti.grouped(…) to have all indices in one vector"
                if len(items) == 1
                else "give one variable for each dimension"
            )
            if self.emitter.worlds is not None and len(items) == rank + 1:
                hint = "leave the index of the world away: a kernel of a batch is for one world"
            elif self.emitter.worlds is None and batch_of(field) and len(items) == rank - 1:
                hint = (
                    f"the first dimension of '{field.name}' is that of the worlds of its batch, "
                    "which kernels marked @batch.kernel leave away"
                )
            raise TaiTypeError(
                f"the loop has {variables}, but runs over {rank} "
                f"dimension{'s' if rank != 1 else ''}",
                hint,
            )
        return names

    def define_indices(self, names: list[str], indices: list[Value], grouped: bool) -> None:
        if grouped:
            dt = reduce(promote, (index.dt for index in indices), i32)
            parts = [self.emitter.cast(index, dt) for index in indices]
            vector = MatrixValue(self.emitter, None, dt, (len(indices),), parts)
            self.frame.define(names[0], Variable(names[0], vector, "loop variable"))
            return
        for name, index in zip(names, indices, strict=True):
            if name != "_":
                self.frame.define(name, Variable(name, index, "loop variable"))

    def index_type_of(self, parts: list[Any]) -> DataType:
        """The type of a loop variable: that of its bounds, and of numbers that they are. With
        `default_ip=ti.i64` it is i64, so that `i * i` does not wrap in a program of such numbers.
        """
        dt = i64 if self.context.options.default_ip is i64 else i32
        for part in parts:
            if not isinstance(part, Value):
                # The upper bound itself is not an index of the loop, so it may exceed the type by
                # one.
                dt = dt if i32.min <= part <= i32.max + 1 else promote(dt, i64)
            elif part.dt.is_int:
                dt = promote(dt, part.dt)
        return dt

    def at_step(self, low: Any, number: Value, step: Any) -> Value:
        """Returns the value of the loop variable in iteration `number`."""
        return self.emitter.binary("+", low, self.emitter.binary("*", number, step))

    def trip_count(self, low: Any, high: Any, step: Any) -> Any:
        """The number of iterations of a range with a step, as an index handle."""
        emitter = self.emitter
        if isinstance(step, Value):
            dt = promote(self.index_type_of([low, high, step]), i64)
            low, high, step = (emitter.cast(emitter.as_value(p, dt), dt) for p in (low, high, step))
            # The number of iterations is computed as `len` of a Python range: -((low - high) //
            # step), but at least 0.
            behind = emitter.binary("//", emitter.binary("-", low, high), step)
            return emitter.to_index(emitter.binary("max", emitter.unary("neg", behind), 0))
        size = abs(step)
        if not isinstance(low, Value) and not isinstance(high, Value):
            first, last = (low, high) if step > 0 else (high, low)
            return emitter.index(max(-((first - last) // size), 0))
        # The distance of two bounds may be greater than their type can count, so a wider type is
        # used.
        low, high = (
            emitter.cast(part if isinstance(part, Value) else emitter.constant(part, i64), dt)
            for dt in [promote(self.index_type_of([low, high]), i64)]
            for part in (low, high)
        )
        span = emitter.binary("-", high, low) if step > 0 else emitter.binary("-", low, high)
        count = emitter.binary("//", emitter.binary("+", span, size - 1), size)
        return emitter.to_index(count)
