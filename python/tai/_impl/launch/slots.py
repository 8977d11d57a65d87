"""Encoding of scalar arguments as the 64 bits of a slot."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import fitting
from ..base.elements import Elements, is_number


def _hint(parameter: str, dt: Any, value: Any) -> str:
    if isinstance(value, float):
        return f"convert it: int(…), or annotate {parameter}: ti.f32"
    if isinstance(value, Elements):
        return f"annotate {parameter}: ti.template() to pass a field, or pass an element of it"
    if getattr(value, "ndim", 0):
        return f"annotate {parameter}: ti.types.ndarray() to pass an array"
    if isinstance(value, (list, tuple)):
        return f"annotate {parameter}: ti.types.vector({len(value)}, ti.{dt}) to pass a vector"
    return "pass a number of Python or NumPy, as float(…) and int(…) make it"


def number_slot(kernel: str, parameter: str, dt: Any, value: Any) -> int:
    """Returns the bits of the argument slot that holds a number."""
    good = isinstance(value, (bool, int, float, np.generic)) or (
        not isinstance(value, bytes) and is_number(value) and getattr(value, "ndim", 0) == 0
    )
    whole = isinstance(value, (bool, int, np.integer, np.bool_))
    if not good or (not dt.is_float and not whole):
        kind = "a number" if dt.is_float else "a whole number"
        raise TaiRuntimeTypeError(
            f"argument '{parameter}' of kernel '{kernel}' expects {kind} ({dt}), but got {value!r}",
            _hint(parameter, dt, value),
        )
    what = f"argument '{parameter}' of kernel '{kernel}'"
    if isinstance(value, int):
        fitting.stored(value, dt, what)
    elif dt.is_int and not dt.min <= int(value) <= dt.max:
        raise TaiRuntimeTypeError(f"{what}: {value} does not fit {dt}", "take a wider type: ti.i64")
    data = np.asarray(value).astype(dt.numpy).tobytes()
    return int.from_bytes(data, "little")
