"""Activity of sparse levels while gradients are checked: saved, restored, kept constant."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...errors import TaiAutodiffError
from ..base.program import get_program

# Matrices of derivatives are made by copies of whole fields to arrays; the index range of a sparse
# field may be far larger than its active part.
LARGEST = 1 << 32


def require_small(f: Any) -> None:
    """Refuses a sparse field whose whole index range does not fit into an array."""
    size = int(np.prod([int(n) for n in f.shape + f.element_shape], dtype=object))
    if size * np.dtype(f.dtype.numpy).itemsize > LARGEST:
        raise TaiAutodiffError(
            f"field '{f.name}' of shape {f.shape} is too large to check its gradient: a check "
            "copies whole fields, with the inactive cells",
            "check the same program in a smaller box",
        )


def sparse_level(f: Any) -> Any:
    """Returns the innermost sparse level above a field, or None."""
    levels = [] if f.level is None else f.level.path()
    return next((level for level in reversed(levels) if level.kind not in ("dense", "shard")), None)


def active_elements(f: Any) -> np.ndarray:
    """A mask of the components in active cells, of shape `shape + element_shape`."""
    level = sparse_level(f)
    mask = np.ones(f.shape, bool)
    if level is not None:
        own, axes = level.axis_extents(), list(f.level.axis_extents())
        cells = level.active_cells()
        active = np.zeros(tuple(own.values()), bool)
        active[tuple(cells.T)] = True
        for position, (axis, extent) in enumerate(zip(axes, f.shape, strict=True)):
            if axis in own:
                active = np.repeat(active, extent // own[axis], axis=position)
            else:
                active = np.repeat(np.expand_dims(active, position), extent, axis=position)
        mask = active
    return np.broadcast_to(
        mask.reshape(mask.shape + (1,) * len(f.element_shape)), f.shape + f.element_shape
    )


class Activity:
    """Keeps which cells are active in all trees, so that this state can be restored."""

    def __init__(self) -> None:
        self._context = get_program().context
        self._kept = [(tree, n, dynamic, self._cells(tree, n)) for tree, n, dynamic in _levels()]

    def _cells(self, tree: str, number: int) -> np.ndarray:
        return np.frombuffer(self._context.active_cells(tree, number), dtype=np.int64)

    def limit(self, trees: set[str]) -> None:
        """Restores these trees only."""
        self._kept = [entry for entry in self._kept if entry[0] in trees]

    def restore(self) -> None:
        for tree, number, dynamic, kept in self._kept:
            now = self._cells(tree, number)
            if np.array_equal(now, kept):
                continue
            extra = np.setdiff1d(now, kept, assume_unique=True)
            for cell in extra:
                # Deactivating a cell of a list makes all cells of the list inactive.
                self._context.set_active(tree, number, int(cell), False)
            missing = np.setdiff1d(kept, self._cells(tree, number) if dynamic else now)
            for cell in missing:
                self._context.set_active(tree, number, int(cell), True)


def _levels() -> Iterator[tuple[str, int, bool]]:
    """Yields the sparse levels of all trees, upper levels before lower ones."""
    seen = set()
    for f in get_program().fields.values():
        root = None if f.level is None or f._core is None else f.level.root_node
        if root is None or root.tree is None or root.tree in seen:
            continue
        seen.add(root.tree)
        for number, level in enumerate(root.sparse_levels()):
            yield root.tree, number, level.kind == "dynamic"
