"""Arithmetic on compile-time constants."""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np

from ...errors import TaiTypeError
from ..base import dtypes

PYTHON = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "//": operator.floordiv, "%": operator.mod, "**": operator.pow, "&": operator.and_,
    "|": operator.or_, "^": operator.xor, "<<": operator.lshift, ">>": operator.rshift,
    "@": operator.matmul,
}  # fmt: skip


def divided_by_zero() -> TaiTypeError:
    """The error of a division of whole numbers by a constant zero."""
    return TaiTypeError(
        "a whole number is divided by zero",
        "make the divisor a float, or leave the division out: if ti.static(n != 0)",
    )


_FLOATS = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.true_divide, "//": np.floor_divide,
    "%": np.mod, "**": np.power,
}  # fmt: skip


def compute(op: str, a: Any, b: Any) -> Any:
    """`a op b` of values known at compile time: out of range, they wrap as when the kernel runs."""
    try:
        result = PYTHON[op](a, b)
    except (ZeroDivisionError, OverflowError):
        whole = not isinstance(a, (float, np.floating)) and not isinstance(b, (float, np.floating))
        if whole and op in ("//", "%"):
            raise divided_by_zero() from None
        function = _FLOATS[op]
        a, b = (dtypes.rounded(x, dtypes.f64) for x in (a, b))
        with np.errstate(all="ignore"):
            result = float(function(a, b))
    return math.nan if isinstance(result, complex) else result
