"""Snapshots of all fields of a program, and their restoration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base import native, pieces
from ..base.program import get_program
from ..fields.structs import parts_of
from .sparse import Activity, require_small, sparse_level


class Snapshot(native.WithBlock):
    """The contents of all fields of the program, which can be restored bit for bit.

    At the end of a `with` block, too, whatever interrupts it.
    """

    def __init__(self, arrays: Sequence[np.ndarray] = ()):
        self._fields = [f for f in get_program().fields.values() if f._core is not None]
        for f in self._fields:
            if sparse_level(f) is not None:
                require_small(f)
        self._activity = Activity()
        self._kept = [self._take(f) for f in self._fields]
        self._arrays = [(a, pieces.copied(a)) for a in arrays]
        self.is_limited = False
        # The gradients that no launch uses, but that tapes clear; with their contents.
        self._others: list[tuple[Any, np.ndarray]] = []

    def limit(self, core: Any) -> None:
        """Restores only the fields that the launches of a tape use, because other fields may belong
        to another thread.
        """
        used: set[str] = set()
        for record in range(core.records):
            if core.kernel_of(record) is None:
                return  # a function of the host may use anything
            used.update(symbol for symbol, *_ in core.accesses(record))
        kept = []
        trees = set()
        for f, array in zip(self._fields, self._kept, strict=True):
            if f.symbol in used or (f.role != "primal" and used & _symbols_of_primal(f)):
                kept.append((f, array))
                trees.add(f.level.root_node.tree)
            elif f.role == "grad" and array.any():
                self._others.append((f, array))
        # Both lists change in one statement: if an interrupt came in between, arrays and fields
        # would not belong together.
        self._fields, self._kept = [f for f, _ in kept], [array for _, array in kept]
        self._activity.limit(trees)
        self.is_limited = True

    def _end(self) -> None:
        self.restore()

    @staticmethod
    def _take(f: Any) -> np.ndarray:
        array = np.empty(f.shape + f.element_shape, f.dtype.numpy)
        f.core.copy_to(array)
        return array

    def restore(self, only_primal: bool = False) -> None:
        self._activity.restore()
        for f, kept in zip(self._fields, self._kept, strict=True):
            if only_primal and f.role != "primal":
                continue
            f.core.copy_from(kept)
        for f, kept in self._others if not only_primal else ():
            if not self._take(f).any():
                f.core.copy_from(kept)
        for array, kept in self._arrays:
            array[...] = kept


def storage(f: Any) -> list[Any]:
    """Returns the fields that hold memory, by name, of a field which a symbol names."""
    if getattr(f, "is_window", False):
        f = f._whole
    return parts_of(f)


def _symbols_of_primal(f: Any) -> set[str]:
    """The symbols of the field to which a gradient or dual, or a component of one, belongs."""
    owner = getattr(f, "field", None) or getattr(f, "_whole", None) or f
    while owner.primal is not None:
        owner = owner.primal
    return {part.symbol for part in storage(owner)}
