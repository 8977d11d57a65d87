"""Range checks of numbers that Python stores in fields and arrays, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import TaiError, TaiIndexError, TaiRuntimeTypeError
from . import pieces
from .dtypes import DataType, all_types, fit
from .elements import is_number

# Whole numbers from this one on may be too large for a float.
_FLOAT_LIMIT = 1 << 1000
_RANGES = {dt: (dt.min, dt.max) for dt in all_types if dt.is_int}


def _say(what: Any) -> str:
    return what if isinstance(what, str) else f"field '{what.name}'"


def stored(value: Any, dt: DataType, what: Any) -> Any:
    """Returns the number that is stored when Python assigns `value` to a place of type `dt`.

    Args:
        value, dt: the number and the type.
        what: the field, or the name of the place.

    Raises:
        TaiRuntimeTypeError: the place holds whole numbers, and this is none that fits.
    """
    limits = _RANGES.get(dt)
    if limits is None:
        if type(value) is int and not -_FLOAT_LIMIT < value < _FLOAT_LIMIT:
            check_float(value, dt, what)
        return bool(value) if dt.is_bool else value
    if type(value) is int and limits[0] <= value <= limits[1]:
        return value
    if isinstance(value, float) and not value.is_integer():
        raise TaiRuntimeTypeError(
            f"{_say(what)} holds whole numbers ({dt}), not {value}", "drop the fraction: int(…)"
        )
    return _checked(value, dt, what)


def check_float(value: Any, dt: DataType, what: Any) -> None:
    """Raises TaiRuntimeTypeError for a whole number that is too large for a float."""
    try:
        float(value)
    except OverflowError:
        raise TaiRuntimeTypeError(
            f"{_say(what)}: a whole number of {value.bit_length()} bits is too large for {dt}",
            "the largest float is near 1.8e308",
        ) from None


def one_number(value: Any, what: Any) -> Any:
    """The number in an array of one element or in another library's scalar, as a Python number."""
    if isinstance(value, np.ma.MaskedArray):
        value = unmasked(value)
    try:
        return value.item() if hasattr(value, "item") else float(value)
    except (TypeError, ValueError):  # several numbers
        raise TaiRuntimeTypeError(
            f"{_say(what)} holds one number an element, not {value!r}",
            f"store a whole array by {what.name}.from_numpy(array)",
        ) from None


def listed(values: Any) -> Any:
    """Converts what stands for several whole numbers (an array, a tensor, a range, or one number)
    to a tuple or a list.
    """
    if hasattr(values, "tolist"):
        values = values.tolist()
    elif isinstance(values, Sequence) and not isinstance(values, (str, bytes)):
        values = tuple(values)
    return values if isinstance(values, (tuple, list)) else (values,)


def offsets(values: Any, what: Any) -> tuple[int, ...]:
    """Returns the first index along each dimension from the argument `offset`."""
    values = listed(values)
    for value in values:
        if not hasattr(value, "__index__") or not -(2**62) < value.__index__() < 2**62:
            raise TaiRuntimeTypeError(
                f"{_say(what)}: an offset is a whole number of less than 62 bits, not {value!r}"
            )
    return tuple(value.__index__() for value in values)


def _checked(value: Any, dt: DataType, what: Any) -> int:
    try:
        return fit(value, dt)
    except TaiError as error:
        hint = f"ti.cast({value}, ti.{dt}) keeps its low bits" if "low bits" in (
            error.hint or "") else "take a field of a wider type"  # fmt: skip
        raise TaiRuntimeTypeError(f"{_say(what)}: {error.message}", hint) from None


def unmasked(value: Any) -> np.ndarray:
    """Converts what Python code passes to an array.

    Raises:
        TaiRuntimeTypeError: some of its elements are masked.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise TaiRuntimeTypeError(
            "some elements of the array are masked, and fields and kernels know no masks",
            "say which number they hold: array.filled(0)",
        )
    return np.asarray(value)


def stored_array(array: np.ndarray, dt: DataType, what: Any) -> np.ndarray:
    """An array that Python stores in places of type `dt`; floats lose their fraction.

    Raises:
        TaiRuntimeTypeError: a number that does not fit.
    """
    array = np.asarray(array)
    if array.dtype.kind in "cmMSU" or (
        array.dtype.kind == "O" and any(isinstance(v, (str, type(None))) for v in array.flat)
    ):
        raise _no_numbers(array, dt, what)
    if dt.is_int and array.size and array.dtype.kind in "iuf" and not np.can_cast(
        array.dtype, dt.numpy
    ):  # fmt: skip
        for extreme in (array.min(), array.max()):
            _checked(extreme.item(), dt, what)
    try:
        return pieces.row_major(array, dt.numpy)
    except (TypeError, ValueError):
        raise _no_numbers(array, dt, what) from None


def _no_numbers(array: np.ndarray, dt: DataType, what: Any) -> TaiError:
    return TaiRuntimeTypeError(
        f"field '{what.name}' holds numbers of type {dt.name}, but the array {array.dtype}"
        if hasattr(what, "name")
        else f"numbers of type {dt.name} cannot be made of an array of {array.dtype}",
        "pass the real part: array.real" if array.dtype.kind == "c" else "pass an array of numbers",
    )


def index_error(name: str, key: Any, error: Exception) -> TaiError:
    """Makes the error for an index that Python code gave to a field."""
    for part in key if isinstance(key, tuple) else (key,):
        if isinstance(part, slice) or part is Ellipsis:
            return TaiRuntimeTypeError(
                f"field '{name}' has no slices",
                f"copy it: {name}.to_numpy()[…], or loop over it in a kernel",
            )
        if part is not None and not hasattr(part, "__index__"):
            return TaiRuntimeTypeError(
                f"field '{name}': an index is a whole number, not {part!r}",
                "convert it: int(…)" if is_number(part) else None,
            )
    if isinstance(error, TypeError):
        return TaiRuntimeTypeError(f"field '{name}': an index is a whole number: {error}")
    if isinstance(error, OverflowError):
        return TaiIndexError(f"field '{name}': index {key} is out of range")
    return TaiIndexError(f"field '{name}': {error}")
