"""Python numbers in types of a few bits: which fit, and what becomes of those that do not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...errors import TaiError, TaiIndexError, TaiRuntimeTypeError, TaiTypeError
from . import state
from .dtypes import DataType, all_types


def misfit(number: Any, dt: DataType) -> TaiTypeError:
    """The error for a whole number that a type cannot hold."""
    if isinstance(number, float):
        return TaiTypeError(f"{number} is no whole number of type {dt}")
    default = state.options.default_ip
    if dt is default or not default.min <= number <= default.max:
        wide = "u64" if number > 2**63 - 1 else "i64"
        hint = f"name a wider type: ti.{wide}({number})"
        if dt is default and wide == "i64":
            hint += ", or ti.init(default_ip=ti.i64)"
    else:
        hint = f"ti.cast({number}, ti.{dt}) keeps its low bits: {wrapped(number, dt)}"
    return TaiTypeError(f"the whole number {number} does not fit {dt}", hint)


def wrapped(number: int, dt: DataType) -> int:
    """The number of type `dt` with the same low bits."""
    number &= (1 << dt.bits) - 1
    return number - (1 << dt.bits) if number > dt.max else number


def fit(number: Any, dt: DataType) -> int:
    """The whole number, if the type can hold it; a float loses its fraction.

    Raises:
        TaiTypeError: it cannot.
    """
    if isinstance(number, float) and not math.isfinite(number):
        raise misfit(number, dt)
    whole = int(number)
    if not dt.min <= whole <= dt.max:
        raise misfit(whole, dt)
    return whole


def convert(number: Any, dt: DataType) -> Any:
    """A number in a type that the program named: `ti.cast(300, ti.u8)` keeps the low bits.

    Raises:
        TaiTypeError: a whole number that neither this type nor the default one can hold.
    """
    if dt.is_bool:
        return bool(number)
    if dt.is_float:
        return float(dt.numpy.type(number)) if dt.bits < 64 else float(number)
    default = state.options.default_ip
    if isinstance(number, float) and not math.isfinite(number):
        raise misfit(number, dt)
    whole = int(number)
    if not (dt.min <= whole <= dt.max or default.min <= whole <= default.max):
        raise misfit(whole, dt)
    return wrapped(whole, dt)


# What Python stores in fields and arrays


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
