"""The expected behaviour of levels and fields, by dictionaries and sets.

Cells and elements are tuples of indices from zero, one for each axis divided so far, by
ascending axis.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

from sparse_trees import FieldSpec, Forest, Level, Place

Cell = tuple[int, ...]


class Full(Exception):
    """An append to a full list."""


def project(cell: Cell, source: Level, target: Level) -> Cell:
    """The cell of `target`, above `source`, that holds a cell of `source`."""
    at = dict(zip(source.cells, cell, strict=True))
    return tuple(at[a] // (source.cells[a] // n) for a, n in target.cells.items())


def list_of(level: Level, cell: Cell) -> tuple[Cell, int]:
    """The list that a cell of a `dynamic` level belongs to, and its position there."""
    d, capacity = level.list_dimension, level.extents[0]
    return (*cell[:d], cell[d] // capacity, *cell[d + 1 :]), cell[d] % capacity


def list_cell(level: Level, key: Cell, position: int) -> Cell:
    """The cell at a position of a list."""
    d = level.list_dimension
    return (*key[:d], key[d] * level.extents[0] + position, *key[d + 1 :])


def hashed(cell: Cell) -> int:
    """A number that kernels compute from indices, too."""
    code = 0
    for index in cell:
        code = code * 1009 + index + 50
    return code * 2654435761 % 1000003


class Model:
    """Activity and values of all trees of a program."""

    def __init__(self, forest: Forest):
        self.forest = forest
        self.active: dict[Level, set[Cell]] = {}
        self.lengths: dict[Level, dict[Cell, int]] = {}
        self.values: dict[tuple[FieldSpec, int], dict[Cell, Any]] = {}
        self.grads: dict[tuple[FieldSpec, int], dict[Cell, Any]] = {}
        for level in forest.levels:
            if level.is_list:
                self.lengths[level] = {}
            elif level.is_sparse:
                self.active[level] = set()
        for spec in forest.fields:
            for component in range(spec.components):
                self.values[spec, component] = {}
                self.grads[spec, component] = {}

    # Activity

    def cells(self, level: Level) -> Iterator[Cell]:
        """The active cells of a sparse level."""
        if not level.is_list:
            yield from self.active[level]
            return
        for key, length in self.lengths[level].items():
            for position in range(length):
                yield list_cell(level, key, position)

    def is_active(self, level: Level, cell: Cell) -> bool:
        sparse = level.sparse_above()
        if not sparse:
            return True
        own = project(cell, level, sparse[0])
        if sparse[0].is_list:
            key, position = list_of(sparse[0], own)
            return position < self.lengths[sparse[0]].get(key, 0)
        return own in self.active[sparse[0]]

    def activate(self, level: Level, cell: Cell) -> None:
        for above in level.sparse_above():
            own = project(cell, level, above)
            if above.is_list:
                key, position = list_of(above, own)
                known = self.lengths[above]
                known[key] = max(known.get(key, 0), position + 1)
            else:
                self.active[above].add(own)

    def deactivate(self, level: Level, *cells: Cell) -> None:
        """Deactivates cells of a sparse level. If the level is a list, it empties the whole."""
        if level.is_list:
            keys = {list_of(level, cell)[0] for cell in cells}

            def inside(below: Level, at: Cell) -> bool:
                return list_of(level, project(at, below, level))[0] in keys
        else:
            gone = set(cells)

            def inside(below: Level, at: Cell) -> bool:
                return project(at, below, level) in gone

        self._clear(level, inside)

    def deactivate_all(self, level: Level) -> None:
        tops = [level] if level.is_sparse else level.below()
        for top in tops:
            if top.is_sparse:
                self._clear(top, lambda below, at: True)

    def _clear(self, level: Level, inside: Callable[[Level, Cell], bool]) -> None:
        for below in level.below():
            if below.is_list:
                lengths = self.lengths[below]
                self.lengths[below] = {
                    key: length
                    for key, length in lengths.items()
                    if not inside(below, list_cell(below, key, 0))
                }
            elif below.is_sparse:
                self.active[below] = {c for c in self.active[below] if not inside(below, c)}
            for place in below.places:
                for component in place.components:
                    for store in (self.values, self.grads):
                        kept = store[place.of, component].items()
                        store[place.of, component] = {
                            at: value for at, value in kept if not inside(below, at)
                        }

    # Lists

    def length(self, level: Level, key: Cell) -> int:
        return self.lengths[level].get(key, 0)

    def append(self, level: Level, key: Cell, values: list[int]) -> int:
        """Adds an element; the list must hold one place.

        Raises:
            Full: there is no room.
        """
        at = self.length(level, key)
        if at == level.extents[0]:
            raise Full
        place = level.places[0]
        cell = list_cell(level, key, at)
        self.activate(level, cell)
        for component, value in zip(place.components, values, strict=True):
            self.values[place.of, component][cell] = value
        return at

    # Values

    def elements(self, level: Level) -> Iterator[Cell]:
        """The cells of a level that a loop over it visits."""
        sparse = level.sparse_above()
        if not sparse:
            yield from itertools.product(*map(range, level.shape))
            return
        for cell in self.cells(sparse[0]):
            at = dict(zip(sparse[0].cells, cell, strict=True))
            ranges = []
            for axis, extent in level.cells.items():
                span = extent // sparse[0].cells.get(axis, 1)
                first = at.get(axis, 0) * span
                ranges.append(range(first, first + span))
            yield from itertools.product(*ranges)

    def put(self, place: Place, component: int, element: Cell, value: Any) -> None:
        self.activate(place.level, element)
        self.values[place.of, component][element] = value

    def write(self, spec: FieldSpec, element: Cell, values: list[int]) -> None:
        for place in spec.places:
            for component in place.components:
                self.put(place, component, element, values[component])

    def read(self, spec: FieldSpec, element: Cell) -> list[Any]:
        return [self.values[spec, c].get(element, 0) for c in range(spec.components)]

    def fill(self, spec: FieldSpec, value: int) -> None:
        """Sets the active cells."""
        for place in spec.places:
            for element in self.elements(place.level):
                for component in place.components:
                    self.values[spec, component][element] = value

    def add_gradient(self, spec: FieldSpec, of: dict[tuple[int, Cell], Any]) -> None:
        """Adds to the adjoints of active elements."""
        for (component, element), value in of.items():
            place = next(p for p in spec.places if component in p.components)
            if self.is_active(place.level, element):
                grads = self.grads[spec, component]
                grads[element] = grads.get(element, 0) + value
