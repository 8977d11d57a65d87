"""The rows of sharded fields that a process of a mesh owns, as arrays."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from ..base import state
from ..base.dtypes import bf16
from ..base.pieces import row_major


def sharding_of(field: Any) -> tuple[Any, int] | None:
    """The mesh that divides a field and the dimension of its rows, or None."""
    if not hasattr(field, "storage"):
        return None
    storage = field.storage()[0]
    storage.materialize()
    found: tuple[Any, int] | None = storage._sharded
    return found


def own_part(field: Any, array: np.ndarray) -> np.ndarray:
    """The rows of this rank in an array of the whole field, or an array without a sharding."""
    sharding = sharding_of(field)
    if sharding is None:
        return array
    mesh, dimension = sharding
    block = array.shape[dimension] // mesh.ranks
    return array[_at(dimension, mesh.rank * block, (mesh.rank + 1) * block)]


def own_rows(field: Any) -> np.ndarray:
    """A copy of the rows of this rank, for which the ranks do not communicate."""
    memory, loan = _memory(field)
    if memory is None:
        return row_major(own_part(field, field.to_numpy()))
    rows = row_major(np.array(own_part(field, memory)))
    del memory, loan
    return rows


def put_own(field: Any, rows: Any) -> bool:
    """Sets the rows of this rank, in its memory alone: those of others have no meaning here.

    Returns:
        False if this is not possible, and the whole field must be set.
    """
    if state.tape is not None or state.forward:
        return False
    memory, loan = _memory(field)
    if memory is None:
        return False
    own_part(field, memory)[...] = rows
    field.storage()[0].core.note_write()
    del memory, loan
    return True


def put_rows(field: Any, rows: np.ndarray) -> None:
    """Sets the rows of this rank, while the other ranks set theirs."""
    if put_own(field, rows):
        return
    whole = np.zeros(tuple(field.shape) + tuple(field.element_shape), field.dtype.numpy)
    own_part(field, whole)[...] = rows
    field.from_numpy(whole)


def _memory(field: Any) -> tuple[np.ndarray | None, Any]:
    """The memory of the whole field as an array, and an object that keeps it; or None."""
    parts = getattr(field, "parts", [field])
    if len(parts) != 1 or getattr(field, "is_window", False) or field.dtype is bf16:
        return None, None
    address, on_device, strides, loan = parts[0].core.lend()
    dtype = np.dtype(field.dtype.numpy)
    shape = tuple(field.shape) + tuple(field.element_shape)
    if on_device or len(strides) != len(shape):
        return None, None
    size = dtype.itemsize + sum((n - 1) * s for n, s in zip(shape, strides, strict=True))
    memory = (ctypes.c_char * size).from_address(address)
    return np.ndarray(shape, dtype, memory, 0, tuple(strides)), loan


def _at(dimension: int, low: int, high: int) -> tuple:
    return (slice(None),) * dimension + (slice(low, high),)


def stored_rows(parts: list[tuple[int, Any]], dimension: int, low: int, high: int) -> np.ndarray:
    """Rows `low` to `high` of an array whose parts, in their order, have some rows each.

    Args:
        parts: the number of rows of each part, and a function that reads it.
    """
    found, first = [], 0
    for count, read in parts:
        begin, end = max(low - first, 0), min(high - first, count)
        if begin < end:
            found.append(read()[_at(dimension, begin, end)])
        first += count
    return found[0] if len(found) == 1 else np.concatenate(found, dimension)
