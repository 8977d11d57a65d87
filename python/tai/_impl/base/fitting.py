"""What Python stores in fields and arrays: which numbers fit, and what to say of others."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiError, TaiIndexError, TaiRuntimeTypeError
from .dtypes import DataType, all_types, fit

_RANGES = {dt: (dt.min, dt.max) for dt in all_types if dt.is_int}


def _say(what: Any) -> str:
    return what if isinstance(what, str) else f"field '{what.name}'"


def stored(value: Any, dt: DataType, what: Any) -> Any:
    """A number that Python stores in a place of type `dt`.

    Args:
        value, dt: the number and the type.
        what: the field, or what to call the place.

    Raises:
        TaiRuntimeTypeError: the place holds whole numbers, and this is none that fits.
    """
    limits = _RANGES.get(dt)
    if limits is None:
        return bool(value) if dt.is_bool else value
    if type(value) is int and limits[0] <= value <= limits[1]:
        return value
    if isinstance(value, float) and not value.is_integer():
        raise TaiRuntimeTypeError(
            f"{_say(what)} holds whole numbers ({dt}), not {value}", "drop the fraction: int(…)"
        )
    return _checked(value, dt, what)


def _checked(value: Any, dt: DataType, what: Any) -> int:
    try:
        return fit(value, dt)
    except TaiError as error:
        hint = f"ti.cast({value}, ti.{dt}) keeps its low bits" if "low bits" in (
            error.hint or "") else "take a field of a wider type"  # fmt: skip
        raise TaiRuntimeTypeError(f"{_say(what)}: {error.message}", hint) from None


def stored_array(array: np.ndarray, dt: DataType, what: Any) -> np.ndarray:
    """An array that Python stores in places of type `dt`; floats lose their fraction.

    Raises:
        TaiRuntimeTypeError: a number that does not fit.
    """
    array = np.asarray(array)
    if dt.is_int and array.size and array.dtype.kind in "iuf" and not np.can_cast(
        array.dtype, dt.numpy
    ):  # fmt: skip
        for extreme in (array.min(), array.max()):
            _checked(extreme.item(), dt, what)
    try:
        return array.astype(dt.numpy, copy=False)
    except (TypeError, ValueError):
        raise TaiRuntimeTypeError(
            f"field '{what.name}' holds numbers of type {dt.name}, but the array {array.dtype}"
            if hasattr(what, "name")
            else f"numbers of type {dt.name} cannot be made of an array of {array.dtype}",
            "pass an array of numbers",
        ) from None


def index_error(name: str, key: Any, error: Exception) -> TaiError:
    """What is wrong with an index that Python gave to a field."""
    for part in key if isinstance(key, tuple) else (key,):
        if isinstance(part, slice) or part is Ellipsis:
            return TaiRuntimeTypeError(
                f"field '{name}' has no slices",
                f"copy it: {name}.to_numpy()[…], or loop over it in a kernel",
            )
        if part is not None and not hasattr(part, "__index__"):
            return TaiRuntimeTypeError(
                f"field '{name}': an index is a whole number, not {part!r}",
                "convert it: int(…)" if hasattr(part, "__float__") else None,
            )
    if isinstance(error, TypeError):
        return TaiRuntimeTypeError(f"field '{name}': an index is a whole number: {error}")
    return TaiIndexError(f"field '{name}': {error}")
