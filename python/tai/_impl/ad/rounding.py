"""Kernels that compute the effect of their rounding errors on a loss.

While `state.rounding` is set, kernels are compiled with a probe at each operation of floats and at
each element that they load: the number r becomes r + t δ, where t is an element of a field that
holds 0, and δ is the rounding error of r there. Results do not change, and the derivative of the
loss with respect to t is the sum of adjoint times δ over all iterations and launches: to first
order the effect of these roundings on the loss. There is one t per line, and some per field.

See docs/decisions/0032-precision.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError
from ..base import dtypes, state
from ..base.locks import snapshot
from ..base.program import Program
from ..fields.scalar import ScalarField
from ..fields.snode import FieldsBuilder, axes
from ..values.emitter import Emitter
from ..values.value import MatrixValue, Value, stop_gradient

# The most lines and fields that a program with probes may have.
SIZE = 4096
# Operations of the dialect `arith` and of the IR builder whose results are rounded, and operations
# of the dialect `math` whose results are not: all others of `math` are rounded.
_ROUNDED = {"arith.addf", "arith.subf", "arith.mulf", "arith.divf"}
_EXACT = {"math.absf", "math.floor", "math.ceil", "math.round", "math.trunc"}
_ROUNDED_FORMS = {"dot", "cross", "outer", "matmul", "solve", "inverse", "determinant", "trace",
                  "sum"}  # fmt: skip
# Types that are tried for the storage of a field: f16 with its denormal numbers, bf16, and a format
# with 14 bits, which no type has.
BITS = {"f16": 11, "bf16": 8, "14 bits": 14}
_LEAST_NORMAL_F16 = 2.0**-14


@dataclass
class Sweep:
    """The results of a reverse sweep over a tape whose kernels estimate their rounding errors.

    Attributes:
        sums: the derivative of each place, by the key of the place.
        loaded, stored, accumulated: symbols of the fields that the kernels use, write to, and add
            to.
        not_finite: symbols of those that held NaN or an infinity at the start, with the message.
    """

    sums: dict[tuple, float] = field(default_factory=dict)
    loaded: set[str] = field(default_factory=set)
    stored: set[str] = field(default_factory=set)
    accumulated: set[str] = field(default_factory=set)
    not_finite: dict[str, str] = field(default_factory=dict)


class Probes:
    """Numbers the places of a program, such as its lines, whose rounding errors are estimated; all
    kernels share the numbers.

    Attributes:
        field: a field of f64 whose gradient has the estimates; its values are 0, except that a
            1 marks a place whose rounding is simulated.
        sweep: the results of the last reverse sweep, or of the one that runs.
    """

    def __init__(self) -> None:
        self.field = ScalarField(dtypes.f64, "rounding")
        self.field.needs_grad = True
        builder = FieldsBuilder()
        builder.dense(axes(0), SIZE).place(self.field)
        builder.finalize()
        self.field.materialize()
        self._gradient: Any = self.field._companions["grad"]
        self._places: dict[tuple, int] = {}
        self.clear()

    @property
    def symbol(self) -> str:
        """The symbol, in the IR, of the field whose gradient has the estimates."""
        assert self.field.symbol is not None  # it was allocated
        return self.field.symbol

    def place(self, *key: Any) -> int:
        """The element of the field of estimates for a line of a file, or for a type and a field."""
        found = self._places.setdefault(key, len(self._places))
        if found >= SIZE:
            raise TaiAutodiffError(
                f"a precision report has room for {SIZE} lines and fields, and the program has more"
            )
        return found

    def clear(self) -> None:
        """Begins another sweep."""
        self._gradient.core.fill(0.0)
        self.sweep = Sweep()

    def take(self) -> Sweep:
        """Returns the results of the sweep, which has ended."""
        array = np.empty(SIZE)
        self._gradient.core.copy_to(array)
        self.sweep.sums = {key: float(array[number]) for key, number in self._places.items()}
        return self.sweep

    def emulate(self, keys: set[tuple]) -> None:
        """Only the roundings of these places are simulated from now on; none, if the list is
        empty.
        """
        array = np.zeros(SIZE)
        for key in keys:
            array[self._places[key]] = 1.0
        self.field.core.copy_from(array)

    def make_emitter(self, builder: Any) -> Emitter:
        return RoundingEmitter(builder, self)

    def note(self, kernel: Any) -> None:
        """Called when a kernel is launched for the first time since the estimate began."""
        sweep = self.sweep
        sweep.loaded |= {f.symbol for f in kernel.fields}
        sweep.accumulated |= {f.symbol for f in kernel.accumulated}
        sweep.stored |= {f.symbol for f in (*kernel.stored, *kernel.accumulated)}


class RoundingEmitter(Emitter):
    """An emitter that appends a probe of the rounding error to each operation whose result is
    rounded.
    """

    def __init__(self, builder: Any, probes: Probes):
        super().__init__(builder)
        self._probes = probes
        self._line, self._file = 0, builder.filename
        self._follow(builder)

    def _follow(self, builder: Any) -> None:
        """Notes which line of the program the operations made next belong to."""
        set_location, set_file = builder.set_location, builder.set_file

        def at(line: int, column: int) -> None:
            self._line = line
            set_location(line, column)

        def enter(filename: str) -> None:
            self._file = filename
            set_file(filename)

        builder.set_location, builder.set_file = at, enter

    # What is rounded

    def elementwise(self, name: str, operands: list[Value], dt: Any) -> Any:
        result = super().elementwise(name, operands, dt)
        is_math = name.startswith("math.") and name not in _EXACT
        if not dt.is_float or not (name in _ROUNDED or is_math):
            return result
        plain = super().elementwise
        return self._probed(result, operands, lambda wide: plain(name, wide, dtypes.f64))

    def scalar_op(self, op: Callable[..., Any], operands: list[Value], dt: Any) -> Value:
        result = super().scalar_op(op, operands, dt)
        if getattr(op, "__name__", "") not in _ROUNDED_FORMS:
            return result
        plain = super().scalar_op
        return self._probed(result, operands, lambda wide: plain(op, wide, dtypes.f64))

    def matrix_op(
        self, op: Callable[..., Any], operands: list[Value], dt: Any, shape: tuple[int, ...]
    ) -> MatrixValue:
        result = super().matrix_op(op, operands, dt, shape)
        if getattr(op, "__name__", "") not in _ROUNDED_FORMS:
            return result
        plain = super().matrix_op
        return self._probed(result, operands, lambda wide: plain(op, wide, dtypes.f64, shape))

    def _probed(self, result: Any, operands: list[Value], widely: Callable[[Any], Any]) -> Any:
        """Returns the result of an operation, with the probe for rounding errors of its line."""
        if all(operand.const is not None for operand in operands):
            return result
        if result.dt is dtypes.f64:
            # The result is compared with its own value rounded to f32.
            wide = result
            narrow = self._convert(self._convert(result, dtypes.f32), dtypes.f64)
        else:
            wide = widely([self._convert(operand, dtypes.f64) for operand in operands])
            narrow = self._convert(result, dtypes.f64)
        error = self._difference(narrow, wide)
        return self._with(result, [(("line", self._file, self._line), error)])

    def loaded(self, field: Any, value: Any) -> Any:
        """Called for an element that a kernel has loaded; returns it with the probes of its
        field.
        """
        if not value.dt.is_float or field is self._probes.field:
            return value
        bits = BITS.get(field.dtype.name) or {32: 24, 64: 53}[field.dtype.bits]
        errors = []
        for name, width in BITS.items():
            if width < bits:
                rounded = self._rounded(value, width)
                if name == "f16":
                    rounded = self._as_f16(value, rounded)
                errors.append(((name, field.symbol), self._difference(rounded, value)))
        if bits == 53:
            rounded = self._convert(self._convert(value, dtypes.f32), dtypes.f64)
            errors.append((("f32", field.symbol), self._difference(rounded, value)))
        return self._with(value, errors)

    def added(self, field: Any, value: Any) -> Any:
        """Probes a term of a sum. The sign of the term counts as random, so that its rounding is
        that of partial sums of this size.

        The sign belongs to the magnitude: errors of terms that cancel do not cancel.
        """
        if not field.dtype.is_float or field.dtype.bits == 16:
            return value
        size = super().elementwise("math.absf", [value], value.dt)
        error = self._difference(self._rounded(size, BITS["14 bits"]), size)
        return self._with(value, [(("sum", field.symbol), error)])

    # Arithmetic without probes

    def _convert(self, value: Any, dt: Any) -> Any:
        if value.dt is dt:
            return value
        name = "arith.extf" if dt.bits > value.dt.bits else "arith.truncf"
        return super().elementwise(name, [value], dt)

    def _apply(self, name: str, a: Any, b: Any) -> Any:
        return super().elementwise(name, [a, b], a.dt)

    def _difference(self, a: Any, b: Any) -> Any:
        return self._apply("arith.subf", a, b)

    def _number(self, number: float, like: Any) -> Any:
        if like.shape:
            return self.splat(number, like.dt, like.shape)
        return self.constant(number, like.dt)

    def _rounded(self, value: Any, bits: int) -> Any:
        """Rounds a number to fewer bits. A product that is fused with an addition is exact."""
        shift = {32: 24, 64: 53}[value.dt.bits] - bits
        scaled = self._apply("arith.mulf", value, self._number(2.0**shift, value))
        total = self._apply("arith.addf", value, scaled)
        return self._difference(total, self._difference(total, value))

    def _as_f16(self, value: Any, rounded: Any) -> Any:
        """In the range of f16's denormal numbers, rounds to a multiple of the least of them."""
        large = self._number(1.5 * 2.0 ** ({32: 23, 64: 52}[value.dt.bits] - 24), value)
        small = self._difference(self._apply("arith.addf", value, large), large)
        size = super().elementwise("math.absf", [value], value.dt)
        is_small = self.compare("<", size, self._number(_LEAST_NORMAL_F16, value))
        return self.select(is_small, small, rounded)

    def _with(self, value: Any, errors: list[tuple[tuple, Any]]) -> Any:
        """Returns value + Σ t δ over the rounding errors δ, without terms that are not finite."""
        for key, error in errors:
            error = stop_gradient(self._convert(error, value.dt))
            where = [self.index(self._probes.place(*key))]
            handle = self.builder.load(self._probes.symbol, where, [], self.type_of(dtypes.f64))
            self.fields.add(self._probes.field)
            amount = self._convert(Value(self, handle, dtypes.f64), value.dt)
            amount = self.broadcast(amount, value.shape)
            value = self._apply("arith.addf", value, self._apply("arith.mulf", amount, error))
        return value


def probes_of(program: Program) -> Probes:
    """Returns the probes of a program, which are made at the first call."""
    if program.probes is None:
        program.probes = Probes()
    return program.probes


def begin(program: Program, not_finite: dict[str, str]) -> Probes:
    """Gives probes to kernels that are launched from now on; see `Sweep.not_finite`."""
    probes = probes_of(program)
    probes.clear()
    probes.sweep.not_finite = not_finite
    state.of_thread.rounding = probes
    _forget_launches(program)
    return probes


def end(program: Program) -> None:
    """Ends the estimate: kernels that are launched from now on do not estimate rounding errors."""
    state.of_thread.rounding = None
    _forget_launches(program)


def _forget_launches(program: Program) -> None:
    """Makes each launch look up again which compiled code it needs."""
    for kernel in snapshot(program.kernels):
        kernel.forget_launches()
