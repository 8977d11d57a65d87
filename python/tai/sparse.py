"""`ti.sparse`: sparse grids of structs."""

from __future__ import annotations

from typing import Any

from ._impl.base.keywords import check_keywords
from ._impl.fields.field import Field
from ._impl.fields.root import root
from ._impl.fields.snode import Axes
from ._impl.fields.structs import Struct, StructField
from .errors import TaiRuntimeTypeError
from .volumes import innermost


def grid(members: dict[str, Any], shape: Any) -> StructField:
    """A struct field of two or three dimensions, on one `bitmasked` level.

    Args:
        members: the type of each member.
        shape: the extents.
    """
    extents = tuple(shape) if isinstance(shape, (tuple, list)) else (shape,)
    if len(extents) not in (2, 3):
        raise TaiRuntimeTypeError(
            f"a sparse grid has two or three dimensions, but got {len(extents)}",
            "lay it out: ti.root.pointer(ti.i, n).dense(ti.i, 8).place(x)",
        )
    made = Struct.field(members)
    root.bitmasked(Axes(range(len(extents))), extents).place(made)
    return made


def usage(field: Field) -> float:
    """The active part of a field, from 0 to 1: of the cells of the innermost sparse level."""
    level = innermost(field)
    cells = 1
    for extent in level.shape:
        cells *= extent
    return level.num_active / cells


__all__ = ["grid", "usage"]


check_keywords(globals())
