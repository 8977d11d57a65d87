"""Arguments of fields: shape, order and offset of their layout."""

from __future__ import annotations

import operator
from typing import Any

from ...errors import TaiRuntimeTypeError
from ..base import fitting
from .snode import AXIS_NAMES, Axes


def to_shape(shape: Any) -> tuple[int, ...]:
    """Returns the extents that an argument `shape` means: a number is one extent.

    Raises:
        TaiRuntimeTypeError: something else than whole numbers, or too many of them.
    """
    result = []
    for extent in fitting.listed(shape):
        try:
            result.append(operator.index(extent))
        except TypeError:
            raise TaiRuntimeTypeError(
                f"a shape is made of whole numbers, but got {extent!r}",
                "write shape=4, shape=(4, 3), or shape=array.shape",
            ) from None
    if len(result) > len(AXIS_NAMES):
        raise TaiRuntimeTypeError(f"a field has at most {len(AXIS_NAMES)} dimensions")
    return tuple(result)


def to_order(order: str | None, rank: int) -> Axes:
    """Returns the axes in the order of storage, the slowest first."""
    if order is None:
        return Axes(range(rank))
    if sorted(order) != sorted(AXIS_NAMES[:rank]):
        raise TaiRuntimeTypeError(
            f"order must hold each of '{AXIS_NAMES[:rank]}' once, but got '{order}'"
        )
    return Axes(AXIS_NAMES.index(c) for c in order)
