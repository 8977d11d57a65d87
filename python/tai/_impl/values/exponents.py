"""`ti.frexp`: a number as a mantissa and a power of two."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...errors import TaiTypeError
from ..base import dtypes, state
from .matrix import Matrix
from .ops import bit_cast, cast, select, stop_grad

# For each width: the bits of the fraction, the most that the field of the exponent holds, and its
# value for numbers of [1, 2).
_FORMS = {32: (23, 0xFF, 127), 64: (52, 0x7FF, 1023)}


def frexp(x: Any) -> tuple[Any, Any]:
    """Returns m and e with x = m · 2^e and 0.5 ≤ |m| < 1; of zero, infinity and NaN x and 0.

    The exponent is an i32. The mantissa has the type of x, and f32 for f16; its derivative by x is
    2^-e.
    """
    emitter = state.emitter
    if emitter is None or not hasattr(x, "emit_operand"):
        return _of_plain(x)
    x = emitter.as_value(x)
    if not x.dt.is_float:
        raise TaiTypeError(f"ti.frexp takes a float, but got a value of type {x.dt}")
    if x.dt.bits < 32:
        x = cast(x, dtypes.f32)
    fraction, most, one = _FORMS[x.dt.bits]
    whole = dtypes.i32 if x.dt.bits == 32 else dtypes.i64

    def field(y: Any) -> Any:
        """The field of the exponent."""
        bits = emitter.binary(">>", bit_cast(stop_grad(y), whole), fraction)
        return emitter.binary("&", bits, most)

    def constant(number: float) -> Any:
        return emitter.constant(number, x.dt)

    # Small numbers are scaled, so that a quarter of each is still a normal number.
    is_small = emitter.compare("<", field(x), one // 2)
    y = emitter.binary("*", x, select(is_small, constant(2.0**one), constant(1.0)))
    found = field(y)
    is_zero, is_infinite = emitter.compare("==", x, 0.0), emitter.compare("==", found, most)
    is_special = emitter.binary("|", is_zero, is_infinite)
    # 2^(one + 1 - found), of which a quarter of y makes the mantissa.
    power = emitter.binary("<<", emitter.binary("-", 2 * one + 1, found), fraction)
    quarter = emitter.binary("*", y, constant(0.25))
    mantissa = emitter.binary("*", quarter, bit_cast(power, x.dt))
    added = select(is_small, 2 * one - 1, one - 1)
    exponent = cast(emitter.binary("-", found, added), dtypes.i32)
    return select(is_special, x, mantissa), select(is_special, 0, exponent)


def _of_plain(x: Any) -> tuple[Any, Any]:
    if isinstance(x, Matrix):
        mantissas, exponents = np.frexp(x.to_numpy())
        return Matrix._wrap(mantissas), Matrix._wrap(exponents.astype(np.int32))
    if not isinstance(x, (float, int, np.number)):
        raise TaiTypeError(f"ti.frexp takes a float, but got {x!r}")
    return math.frexp(x)
