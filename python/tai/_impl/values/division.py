"""Errors for integer divisions that are undefined, as known at compile time."""

from __future__ import annotations

from ...errors import TaiTypeError
from ..base.dtypes import DataType
from .compile_time import divided_by_zero
from .value import Value


def check_division(a: Value, b: Value, dt: DataType) -> None:
    """Raises for whole numbers of type `dt` of which `a` cannot be divided by `b`."""
    if dt.is_float:
        return
    if b.const == 0:
        raise divided_by_zero()
    if b.const == -1 and dt.kind == "i" and a.const == dt.min:
        raise TaiTypeError(
            f"the smallest {dt} is divided by -1, and has no negative", "use a wider type"
        )
