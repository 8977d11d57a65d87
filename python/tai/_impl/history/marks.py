"""Arrays and objects outside of fields whose numbers depend on values with a gradient.

A recorded kernel may store such numbers to an array of the caller, a sparse matrix may be built of
them, and a view of a field by DLPack shows them to other libraries. The tape follows none of these
back to a field. So they are marked while it records, and `origins` warns where they come back.
"""

from __future__ import annotations

import math
import threading
import weakref
from collections.abc import Iterable
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from ..base import native
from ..base.program import at_close


class Mark(Enum):
    """The origin of numbers in memory: where they were computed."""

    KERNEL = 1  # a recorded kernel has stored them
    HOST = 2  # Python has computed them
    VIEW = 3  # they are those of a field, by a view that other libraries use


class Extent(NamedTuple):
    """The memory of an array: elements of `size` bytes at distances that are multiples of `step`.

    Attributes:
        begin: the address of the first byte.
        end: the address behind the last byte.
    """

    begin: int
    end: int
    step: int
    size: int

    def overlaps(self, other: Extent) -> bool:
        """Whether elements of two extents may share memory; columns of a matrix are interleaved."""
        if self.begin >= other.end or other.begin >= self.end:
            return False
        common = math.gcd(self.step, other.step)
        apart = (self.begin - other.begin) % common
        return apart < other.size or apart + self.size > common


class _Region:
    """Memory with a mark, which is valid as long as the owner of the memory lives."""

    def __init__(self, extent: Extent, mark: Mark, owner: Any):
        # A weak reference to the array would not do, since a view of an array may be a new object
        # for each use.
        while isinstance(getattr(owner, "base", None), np.ndarray):
            owner = owner.base
        self.extent, self.mark, self.owner = extent, mark, weakref.ref(owner)


class _View(_Region):
    """Memory of a field of which other libraries have a view, for as long as the view exists."""

    def __init__(self, extent: Extent, field: Any, loan: Any):
        super().__init__(extent, Mark.VIEW, field)
        self._loan = weakref.ref(loan)

    def field(self) -> Any:
        """The field that the memory belongs to, or None if the field or the view is gone."""
        field = None if self._loan() is None else self.owner()
        is_there = field is not None and (getattr(field, "single", None) or field).is_current()
        return field if is_there else None


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.objects: dict[int, weakref.ref] = {}
        self.regions: dict[tuple[Extent, Mark], _Region] = {}


_of_thread = _OfThread()
# They outlive tapes.
_views: list[_View] = []


def extent_of(value: Any) -> Extent | None:
    """The memory of an array; None for other values and for empty arrays."""
    value = getattr(value, "array", value)
    if isinstance(value, np.ndarray):
        if value.size == 0:
            return None
        address, size = value.ctypes.data, value.itemsize
        pairs = zip(value.shape, value.strides, strict=True)
    elif hasattr(value, "data_ptr") and hasattr(value, "element_size"):  # a torch tensor
        if value.numel() == 0:
            return None
        address, size = value.data_ptr(), value.element_size()
        steps = (int(step) * size for step in value.stride())
        pairs = zip(map(int, value.shape), steps, strict=True)
    elif hasattr(value, "ctypes") and hasattr(value, "nbytes"):  # a `DeviceArray`
        if value.nbytes == 0:
            return None
        address, size = value.ctypes.data, value.dtype.itemsize
        pairs = zip((value.nbytes // size,), (size,), strict=True)
    else:
        return None
    return made_of(address, size, pairs)


def made_of(address: int, size: int, pairs: Iterable[tuple[int, int]]) -> Extent:
    """Computes the memory of an array from its extents and its strides in bytes."""
    steps = [(n - 1, step) for n, step in pairs if n > 1 and step]
    begin = address + sum(n * step for n, step in steps if step < 0)
    end = address + size + sum(n * step for n, step in steps if step > 0)
    # Contiguous elements, such as the components of a vector, count as one element.
    apart = sorted((abs(step), n + 1) for n, step in steps)
    while apart and apart[0][0] == size:
        size *= apart.pop(0)[1]
    step = math.gcd(*(step for step, _ in apart)) if apart else size
    return Extent(begin, end, step, size)


def mark(value: Any, how: Mark = Mark.HOST) -> None:
    """Notes that the numbers of an array, or of another object, depend on values with a
    gradient.
    """
    extent = extent_of(value)
    if extent is None:
        _of_thread.objects[id(value)] = weakref.ref(value)
    else:
        _of_thread.regions[extent, how] = _Region(extent, how, value)


def mark_view(field: Any, extent: Extent, loan: Any) -> None:
    """Notes that another library has a view of the memory of a field, while `loan` exists."""
    _views[:] = [view for view in _views if view.field() is not None]
    native.note_views_of_fields(True)
    _views.append(_View(extent, field, loan))


def viewed() -> list[tuple[Any, Extent]]:
    """The fields of which other libraries have views, and the memory of these fields."""
    found = {id(field): (field, view.extent) for view in _views if (field := view.field())}
    return list(found.values())


def field_behind(value: Any) -> Any:
    """The field whose memory an array is a view of, or None."""
    extent = extent_of(value) if _views else None
    if extent is None:
        return None
    for view in _views:
        field = view.field() if view.extent.overlaps(extent) else None
        if field is not None:
            return field
    return None


def mark_of(value: Any) -> Mark | None:
    """The mark of an array or object that depends on recorded values with a gradient, or None."""
    known = _of_thread.objects.get(id(value))
    if known is not None and known() is value:
        return Mark.HOST
    extent = extent_of(value) if _of_thread.regions else None
    if extent is None:
        return None
    for region in _of_thread.regions.values():
        if region.extent.overlaps(extent) and region.owner() is not None:
            return region.mark
    return None


def has_views() -> bool:
    """Whether other libraries may have views of fields."""
    return bool(_views)


def is_empty() -> bool:
    """Whether no memory is marked, so that no value need be looked up."""
    return not (_of_thread.regions or _of_thread.objects or _views)


def clear() -> None:
    """Removes all marks, when the tape records no more."""
    _of_thread.objects.clear()
    _of_thread.regions.clear()


def _forget_views() -> None:
    if _views:
        _views.clear()
        native.note_views_of_fields(False)


at_close.append(_forget_views)
