"""Emits integer arithmetic: shifts, powers, and errors for unsupported operations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import TaiTypeError
from ..base import state
from ..base.dtypes import DataType, wrapped
from .builder import UNSIGNED
from .value import Value

if TYPE_CHECKING:
    from .emitter import Emitter


def check_shift(op: str, a: Value, b: Value, dt: DataType) -> None:
    """Refuses a constant number of bits that the type does not have."""
    if b.const is not None and not 0 <= b.const < dt.bits:
        what = f"the {a.kind_name} has {dt.bits} bits"
        if b.const < 0:
            raise TaiTypeError(f"'{op}' by the negative number {b.const}", "shift the other way")
        raise TaiTypeError(
            f"'{op}' by {b.const}, but {what}",
            f"convert it first: ti.i64(x) {op} {b.const}"
            if dt.bits < 64 and b.const < 64
            else "the result has none of its bits",
        )


def shift(emitter: Emitter, op: str, name: str, a: Value, b: Value) -> Value:
    """A shift by a number known at run time: of all bits and more, nothing or the sign is left.

    The operation of IR is undefined there.
    """
    dt = a.dt
    if b.const is not None:
        return emitter.elementwise(name, [a, b], dt)
    if dt.kind == "i":
        _assert_not_negative(emitter, b, f"'{op}' by the negative number {{}}")
    if name == "arith.shrsi":
        most = emitter.constant(dt.bits - 1, dt)
        return emitter.elementwise(name, [a, emitter.elementwise("arith.minui", [b, most], dt)], dt)
    fits = emitter.compare_by(UNSIGNED["<"], b, emitter.constant(dt.bits, dt))
    return emitter.select(fits, emitter.elementwise(name, [a, b], dt), emitter.constant(0, dt))


def _assert_not_negative(emitter: Emitter, value: Value, message: str) -> None:
    """In debug mode, emits a check that ends the program if a number is negative."""
    emitter.builder.assert_(emitter.compare(">=", value, 0).handle, message, [value.handle])


def _integer_power(emitter: Emitter, a: Value, b: Value) -> Any:
    """Square and multiply over the bits of an exponent known only at run time."""
    if a.shape:
        pairs = zip(a.scalars(), b.scalars(), strict=True)
        return emitter.matrix([_integer_power(emitter, p, q) for p, q in pairs], a.dt, a.shape)
    builder, type_, counter = emitter.builder, emitter.type_of(a.dt), emitter.type_of(b.dt)
    one = emitter.constant(1, a.dt)
    if b.dt.kind == "i":
        _assert_not_negative(emitter, b, "a whole number is raised to the negative power {}")
    before, after = builder.region(), builder.region()
    outer = builder.get_block()
    types = [type_, type_, counter]
    head = builder.block(before, types)
    builder.set_block(head)
    carried = [head.argument(i) for i in range(3)]
    more = emitter.compare(">", Value(emitter, carried[2], b.dt), 0)
    builder.condition_of_while(more.handle, carried)
    body = builder.block(after, types)
    builder.set_block(body)
    result, base = (Value(emitter, body.argument(i), a.dt) for i in range(2))
    left = Value(emitter, body.argument(2), b.dt)
    odd = emitter.compare("!=", emitter.binary("&", left, 1), 0)
    result = emitter.select(odd, emitter.binary("*", result, base), result)
    base = emitter.binary("*", base, base)
    # The remaining exponent counts as unsigned, so the shift to the right fills with zeros.
    left = emitter.elementwise("arith.shrui", [left, emitter.constant(1, b.dt)], b.dt)
    builder.yield_([result.handle, base.handle, left.handle])
    builder.set_block(outer)
    found = builder.while_([one.handle, a.handle, b.handle], types, before, after)
    made = Value(emitter, found[0], a.dt)
    if b.dt.kind != "i":
        return made
    # Emits 1 / a ** -b without its fraction, for a negative exponent.
    odd = emitter.compare("!=", emitter.binary("&", b, 1), 0)
    inverse = emitter.select(emitter.compare("==", a, one), one, emitter.constant(0, a.dt))
    if a.dt.kind == "i":
        minus = emitter.constant(-1, a.dt)
        inverse = emitter.select(
            emitter.compare("==", a, minus), emitter.select(odd, minus, one), inverse
        )
    return emitter.select(emitter.compare("<", b, 0), inverse, made)


def integer_power(emitter: Emitter, a: Value, b: Value, dt: DataType) -> Any:
    """`a ** b` for integers: base and result are of type `dt`; the exponent keeps its own type."""
    default, shape = state.options.default_ip, a.shape or b.shape
    a = emitter.cast(a, default if dt.is_bool else dt)
    b = emitter.cast(b, default) if b.dt.is_bool else b
    return _integer_power(emitter, emitter.broadcast(a, shape), emitter.broadcast(b, shape))


def check_signs(op: str, a: Any, b: Any) -> None:
    """Raises an error for a comparison of an unsigned value with a negative number."""
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


def operand_beside(emitter: Emitter, number: Any, dt: DataType) -> Value:
    """Converts a plain Python number to the type of a value. Unsigned numbers count modulo a power
    of two.
    """
    if dt.kind == "u" and isinstance(number, (int, np.integer)) and -dt.max // 2 <= number < 0:
        number = wrapped(int(number), dt)
    return emitter.constant(number, dt)
