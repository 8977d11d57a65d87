"""Whole numbers in IR: division that rounds down, shifts, powers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...errors import TaiTypeError
from ..base import state
from ..base.dtypes import DataType, wrapped
from .builder import UNSIGNED
from .value import Value


class Integers:
    """The part of the emitter for operations that are not one operation of IR."""

    builder: Any
    as_value: Any
    binary: Any
    broadcast: Any
    cast: Any
    compare: Any
    constant: Any
    matrix: Any
    operands: Any
    select: Any
    splat: Any
    to_float: Any
    type_of: Any
    unary: Any
    unify: Any
    _elementwise: Any
    _op: Any

    def check_shift(self, op: str, a: Value, b: Value, dt: DataType) -> None:
        """Refuses a constant number of bits that the type does not have."""
        if b.const is not None and not 0 <= b.const < dt.bits:
            what = f"the {a.kind_name} has {dt.bits} bits"
            if b.const < 0:
                raise TaiTypeError(
                    f"'{op}' by the negative number {b.const}", "shift the other way"
                )
            raise TaiTypeError(
                f"'{op}' by {b.const}, but {what}",
                f"convert it first: ti.i64(x) {op} {b.const}"
                if dt.bits < 64 and b.const < 64
                else "the result has none of its bits",
            )

    def shift(self, op: str, name: str, a: Value, b: Value) -> Value:
        """A shift by a number known at run time: of all bits and more, nothing or the sign is left.

        The operation of IR is undefined there.
        """
        dt = a.dt
        if b.const is not None:
            return self._elementwise(name, [a, b], dt)
        if dt.kind == "i":
            self.assert_not_negative(b, f"'{op}' by the negative number {{}}")
        if name == "arith.shrsi":
            most = self.constant(dt.bits - 1, dt)
            return self._elementwise(name, [a, self._elementwise("arith.minui", [b, most], dt)], dt)
        fits = self.compare_by(UNSIGNED["<"], b, self.constant(dt.bits, dt))
        return self.select(fits, self._elementwise(name, [a, b], dt), self.constant(0, dt))

    def assert_not_negative(self, value: Value, message: str) -> None:
        """In debug mode, ends the program where a number is negative."""
        self.builder.assert_(self.compare(">=", value, 0).handle, message, [value.handle])

    def _integer_power(self, a: Value, b: Value) -> Any:
        """Square and multiply over the bits of an exponent known only at run time."""
        if a.shape:
            pairs = zip(a.scalars(), b.scalars(), strict=True)
            return self.matrix([self._integer_power(p, q) for p, q in pairs], a.dt, a.shape)
        builder, type_, counter = self.builder, self.type_of(a.dt), self.type_of(b.dt)
        one = self.constant(1, a.dt)
        if b.dt.kind == "i":
            self.assert_not_negative(b, "a whole number is raised to the negative power {}")
        before, after = builder.region(), builder.region()
        outer = builder.get_block()
        types = [type_, type_, counter]
        head = builder.block(before, types)
        builder.set_block(head)
        carried = [head.argument(i) for i in range(3)]
        more = self.compare(">", Value(self, carried[2], b.dt), 0)
        builder.condition_of_while(more.handle, carried)
        body = builder.block(after, types)
        builder.set_block(body)
        result, base = (Value(self, body.argument(i), a.dt) for i in range(2))
        left = Value(self, body.argument(2), b.dt)
        odd = self.compare("!=", self.binary("&", left, 1), 0)
        result = self.select(odd, self.binary("*", result, base), result)
        base = self.binary("*", base, base)
        # The count is positive, also with its highest bit set where it has no sign.
        left = self._elementwise("arith.shrui", [left, self.constant(1, b.dt)], b.dt)
        builder.yield_([result.handle, base.handle, left.handle])
        builder.set_block(outer)
        made = builder.while_([one.handle, a.handle, b.handle], types, before, after)
        made = Value(self, made[0], a.dt)
        if b.dt.kind != "i":
            return made
        # 1 / a ** -b without its fraction.
        odd = self.compare("!=", self.binary("&", b, 1), 0)
        inverse = self.select(self.compare("==", a, one), one, self.constant(0, a.dt))
        if a.dt.kind == "i":
            minus = self.constant(-1, a.dt)
            inverse = self.select(
                self.compare("==", a, minus), self.select(odd, minus, one), inverse
            )
        return self.select(self.compare("<", b, 0), inverse, made)

    def integer_power(self, a: Value, b: Value, dt: DataType) -> Any:
        """`a ** b` in type `dt`. A power is no number of that type: it keeps its sign."""
        default, shape = state.options.default_ip, a.shape or b.shape
        a = self.cast(a, default if dt.is_bool else dt)
        b = self.cast(b, default) if b.dt.is_bool else b
        return self._integer_power(self.broadcast(a, shape), self.broadcast(b, shape))

    def check_signs(self, op: str, a: Any, b: Any) -> None:
        """Refuses to compare what is never negative with a negative number."""
        if op in ("==", "!="):
            return
        for number, value in ((a, b), (b, a)):
            if isinstance(value, Value) and value.dt.kind == "u" and (
                isinstance(number, int) and number < 0
            ):  # fmt: skip
                raise TaiTypeError(
                    f"a {value.kind_name} is never below zero, and is compared with {number}",
                    "convert it: ti.i64(x)",
                )

    def _operand(self, number: Any, dt: DataType) -> Value:
        """A plain number beside a value. Unsigned numbers count modulo a power of two."""
        if dt.kind == "u" and isinstance(number, (int, np.integer)) and -dt.max // 2 <= number < 0:
            number = wrapped(int(number), dt)
        return self.constant(number, dt)

    def check_fraction(self, value: Any, dt: DataType, what: str) -> None:
        """Warns where a float goes into a whole number without a conversion."""
        if not dt.is_int:
            return
        if isinstance(value, Value):
            loses = value.dt.is_float and (value.const is None or value.const % 1 != 0)
        else:
            loses = isinstance(value, float) and value % 1 != 0 and math.isfinite(value)
        if loses:
            self.warn_of_fraction(what)
