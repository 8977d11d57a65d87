"""Encoding of scalar arguments as the 64 bits of a slot."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError


def number_slot(kernel: str, parameter: str, dt: Any, value: Any) -> int:
    """A number in the bits of its slot."""
    good = isinstance(value, (bool, int, float, np.generic)) or (
        not isinstance(value, (str, bytes))
        and hasattr(value, "__float__")
        and getattr(value, "ndim", 0) == 0
    )
    whole = isinstance(value, (bool, int, np.integer, np.bool_))
    if not good or (not dt.is_float and not whole):
        kind = "a number" if dt.is_float else "a whole number"
        raise TaiRuntimeTypeError(
            f"argument '{parameter}' of kernel '{kernel}' expects {kind} ({dt}), but got {value!r}"
        )
    if dt.is_int and not dt.min <= int(value) <= dt.max:
        raise TaiRuntimeTypeError(
            f"argument '{parameter}' of kernel '{kernel}': {value} does not fit {dt}"
        )
    data = np.asarray(value).astype(dt.numpy).tobytes()
    return int.from_bytes(data, "little")
