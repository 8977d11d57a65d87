"""`ti.sparse`: grids of structs of which few cells are in use."""

from __future__ import annotations

from typing import Any

from .errors import TaiRuntimeTypeError
from .fields import Field
from .snode import Axes
from .structs import Struct, StructField


def grid(members: dict[str, Any], shape: Any) -> StructField:
    """A struct field of two or three dimensions, on one `bitmasked` level.

    Args:
        members: the type of each member.
        shape: the extents.
    """
    from .program import root

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
    from .volumes import innermost

    level = innermost(field)
    cells = 1
    for extent in level.shape:
        cells *= extent
    return level.num_active / cells


__all__ = ["grid", "usage"]
