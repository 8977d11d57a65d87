"""Random trees of levels and fields, as data.

A tree has one to four levels on a path, over one to three axes, and may branch; fields stand at
any level. Nothing here needs the package: `sparse_scene` writes a program for a tree, and
`sparse_model` predicts its results.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from math import prod

SPARSE = ("pointer", "bitmasked", "hash", "dynamic")
KINDS = ("dense", "dense", "pointer", "pointer", "bitmasked", "hash", "dynamic")
INTEGERS = ("i32", "i64", "i16", "u8", "u32")
FLOATS = ("f32", "f64")


@dataclass(eq=False)
class Level:
    """A level of a tree.

    Attributes:
        axes: the axes that it divides, in the order of the layout.
        cells: the number of cells along each axis divided so far, by ascending axis.
    """

    name: str
    kind: str
    axes: tuple[int, ...]
    extents: tuple[int, ...]
    parent: Level | None
    tree: int
    levels: list[Level] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)

    def __post_init__(self) -> None:
        cells = dict(self.parent.cells) if self.parent else {}
        for axis, extent in zip(self.axes, self.extents, strict=True):
            cells[axis] = cells.get(axis, 1) * extent
        self.cells: dict[int, int] = dict(sorted(cells.items()))

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(self.cells.values())

    @property
    def rank(self) -> int:
        return len(self.cells)

    @property
    def is_sparse(self) -> bool:
        return self.kind != "dense"

    @property
    def is_list(self) -> bool:
        return self.kind == "dynamic"

    @property
    def list_dimension(self) -> int:
        """The position of the list's index among those of a cell."""
        return list(self.cells).index(self.axes[0])

    def path(self) -> list[Level]:
        """The levels from the root down to this one."""
        return [*(self.parent.path() if self.parent else []), self]

    def sparse_above(self) -> list[Level]:
        """The sparse levels from this one up, this one included."""
        return [level for level in self.path()[::-1] if level.is_sparse]

    def below(self) -> list[Level]:
        """This level and those below it."""
        return [self, *(level for child in self.levels for level in child.below())]

    def takes_appends(self) -> bool:
        """Whether this is a list of one field."""
        return self.is_list and len(self.places) == 1 and not self.levels


@dataclass(eq=False)
class Place:
    """Where a field, or one component of it, is stored."""

    of: FieldSpec
    components: tuple[int, ...]
    level: Level


@dataclass(eq=False)
class FieldSpec:
    """A field: its type, the shape of its elements, and where they are."""

    name: str
    dtype: str
    element: tuple[int, ...]
    offset: tuple[int, ...] = ()
    needs_grad: bool = False
    places: list[Place] = field(default_factory=list)

    @property
    def components(self) -> int:
        return prod(self.element)

    @property
    def level(self) -> Level:
        return self.places[0].level

    @property
    def shape(self) -> tuple[int, ...]:
        return self.level.shape

    @property
    def first(self) -> tuple[int, ...]:
        """The first index along each dimension."""
        return self.offset or (0,) * self.level.rank

    @property
    def is_split(self) -> bool:
        return len(self.places) > 1


@dataclass
class Forest:
    """The trees of one program."""

    tops: list[Level] = field(default_factory=list)
    fields: list[FieldSpec] = field(default_factory=list)
    debug: bool = False

    @property
    def levels(self) -> list[Level]:
        return [level for top in self.tops for level in top.below()]

    def __str__(self) -> str:
        def show(level: Level) -> str:
            axes = "".join("ijk"[a] for a in level.axes)
            inner = [show(child) for child in level.levels]
            inner += [f"{p.of.name}: {p.of.dtype}{list(p.of.element)}" for p in level.places]
            return f"{level.kind}({axes} {level.extents}: {', '.join(inner)})"

        return "; ".join(f"tree {top.tree}: {show(top)}" for top in self.tops)


class _Grower:
    def __init__(self, choice: random.Random):
        self.choice = choice
        self.forest = Forest(debug=choice.random() < 0.15)
        # Most trees are small, so that actions meet; some have more cells than a word has bits.
        self.budget = choice.choice([24, 60, 150, 150, 400, 5000])
        self.sizes = [1, 2, 2, 3, 3, 4, 5, 7, 8]
        if self.budget > 300:
            self.sizes += [9, 16, 33, 65, 70, 130]
        self.count = 0

    def level(self, parent: Level | None, axes: list[int], tree: int, kind: str) -> Level:
        """A new level below `parent`, within the budget of elements."""
        choice = self.choice
        room = self.budget // prod(parent.shape if parent else ())
        own = choice.sample(axes, 1 if kind == "dynamic" else choice.randint(1, len(axes)))
        extents = []
        for _ in own:
            fitting = [s for s in self.sizes if s <= room] or [1]
            extents.append(choice.choice(fitting))
            room //= extents[-1]
        if kind == "dense" and parent is None and choice.random() < 0.5:
            kind = "pointer"
        made = Level(f"L{self.count}", kind, tuple(own), tuple(extents), parent, tree)
        self.count += 1
        (parent.levels if parent else self.forest.tops).append(made)
        return made

    def grow(self, parent: Level | None, axes: list[int], tree: int, depth: int) -> None:
        choice = self.choice
        kind = choice.choice(KINDS)
        own = axes
        if kind == "dynamic":
            # The axis of a list is divided by no other level.
            own = [axis for axis in axes if parent is None or axis not in parent.cells]
            if not own:
                kind, own = "bitmasked", axes
        level = self.level(parent, own, tree, kind)
        if kind == "dynamic":
            axes = [axis for axis in axes if axis not in level.axes]
        branches = 0 if depth == 1 or not axes else choice.choice([0, 1, 1, 1, 2])
        if kind == "dynamic" and choice.random() < 0.4:
            branches = 0
        for _ in range(branches):
            self.grow(level, axes, tree, depth - 1)
        if not branches or choice.random() < 0.3:
            for _ in range(choice.choice([1, 1, 1, 2])):
                self.field(level)

    def field(self, level: Level) -> None:
        choice = self.choice
        element = choice.choice([(), (), (), (2,), (3,), (2, 2)])
        made = FieldSpec(
            f"f{len(self.forest.fields)}", choice.choice(INTEGERS + FLOATS * 2), element
        )
        made.needs_grad = made.dtype in FLOATS and choice.random() < 0.5
        if choice.random() < 0.25:
            made.offset = tuple(choice.randint(-5, 5) for _ in range(level.rank))
        self.forest.fields.append(made)
        if len(element) != 1 or choice.random() < 0.6:
            self.put(Place(made, tuple(range(made.components)), level))
            return
        # An array for each component: beside each other, or below levels of their own.
        homes = [level]
        while len(homes) < made.components:
            if level.parent is None or choice.random() < 0.5:
                homes.append(level)
                continue
            kind = level.kind if level.is_list else choice.choice(["dense", "bitmasked"])
            twin = Level(
                f"L{self.count}", kind, level.axes, level.extents, level.parent, level.tree
            )
            self.count += 1
            level.parent.levels.append(twin)
            homes.append(twin)
        for component, home in enumerate(homes):
            self.put(Place(made, (component,), home))

    def put(self, place: Place) -> None:
        place.of.places.append(place)
        place.level.places.append(place)


def random_forest(choice: random.Random) -> Forest:
    """One or two trees with at least one sparse level."""
    grower = _Grower(choice)
    for tree in range(choice.choice([1, 1, 2])):
        axes = list(range(choice.randint(1, 3)))
        for _ in range(choice.choice([1, 1, 2])):
            grower.grow(None, axes, tree, choice.randint(1, 4))
    if not any(level.is_sparse for level in grower.forest.levels):
        return random_forest(choice)
    return grower.forest
