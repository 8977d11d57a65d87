"""Layouts: the tree of `ti.root.dense(ti.ij, (8, 8)).place(x, y)`."""

from __future__ import annotations

import contextlib
import functools
import html
import math
import threading
import weakref
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from ...errors import TaiError, TaiMemoryError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import fitting, state
from ..base.keywords import CELL_OPERATIONS, MissingMethod, check_keywords, present_names
from ..base.program import Program, get_program
from ..values.types import refuse_quant
from . import offsets, shards

if TYPE_CHECKING:
    from .field import Field
    from .scalar import ScalarField

AXIS_NAMES = "ijklmnopqrst"


class Axes(tuple):
    """One or more axes of a layout: `ti.i`, `ti.ij`, `ti.axes(0, 2)`."""

    __slots__ = ()

    def __repr__(self) -> str:
        return "ti." + "".join(AXIS_NAMES[a] for a in self)


def axes(*numbers: int) -> Axes:
    """Returns the axes with these numbers, 0 being `i`."""
    for number in numbers:
        if not isinstance(number, int) or not 0 <= number < len(AXIS_NAMES):
            raise TaiRuntimeTypeError(f"there is no axis {number!r}: axes are 0 to 11")
    return Axes(numbers)


class SNode:
    """A level of the layout tree of fields.

    Attributes:
        kind: `root`, `dense`, `pointer`, `bitmasked`, `hash`, `dynamic` or `shard`.
        axes: the axes that it divides.
        extents: the number of cells along each of `axes`.
    """

    append, length, activate, deactivate, is_active = (
        MissingMethod(CELL_OPERATIONS[name])
        for name in ("append", "length", "activate", "deactivate", "is_active")
    )
    __dir__ = present_names

    def __init__(
        self,
        kind: str,
        parent: SNode | None,
        axes: Sequence[int] = (),
        extents: Sequence[int] = (),
        chunk: int = 0,
    ):
        self.kind, self._parent = kind, parent
        self.axes, self.extents, self.chunk = tuple(axes), tuple(extents), chunk
        # The axis that a shard divides among ranks, and their number.
        self.shard_axis, self.ranks = -1, 0
        self.children: list[SNode | ScalarField] = []

    # Levels

    def dense(self, axes: Axes, dimensions: Any) -> SNode:
        """Adds a level of cells that all exist, the last axis fastest."""
        return self._add("dense", axes, dimensions)

    def pointer(self, axes: Axes, dimensions: Any) -> SNode:
        """Adds a level of coarse cells, each of which becomes active on the first write."""
        return self._add("pointer", axes, dimensions)

    def bitmasked(self, axes: Axes, dimensions: Any) -> SNode:
        """Adds a level of cells, each of which has an activity bit."""
        return self._add("bitmasked", axes, dimensions)

    def hash(self, axes: Axes, dimensions: Any) -> SNode:
        """Sparse cells, named after Taichi's hash level; stored as `pointer` levels are."""
        return self._add("hash", axes, dimensions)

    def dynamic(self, axis: Axes, dimension: int, chunk_size: int | None = None) -> SNode:
        """Lists along one axis, which no other level divides, that grow by `append`.

        Args:
            axis: one axis, such as `ti.j`.
            dimension: how many cells a list holds at most; one more is an error.
            chunk_size: accepted without effect: cells have fixed addresses.
        """
        if isinstance(axis, tuple) and len(axis) != 1:
            raise TaiRuntimeTypeError(
                f"a dynamic level has one axis, but got {axis!r}",
                "put a level for each other axis above it: ti.root.dense(ti.i, n).dynamic(ti.j, m)",
            )
        return self._add("dynamic", axis, dimension, chunk_size or 0)

    def shard(self, axis: Axes) -> SNode:
        """Divides the levels below among the processes of the mesh, by rows along one axis.

        Args:
            axis: one axis, such as `ti.i`, which one level below divides.

        Raises:
            TaiRuntimeError: the program has no mesh.
        """
        self._check_open()
        child = SNode("shard", self)
        child.ranks = shards.check_shard(axis, self.path(), AXIS_NAMES)
        child.shard_axis = axis[0]
        self.children.append(child)
        return child

    def above_shard(self) -> SNode | None:
        """This level or the one above it that is a shard."""
        return next((level for level in self.path() if level.kind == "shard"), None)

    def quant_array(self, axes: Axes, dimensions: Any, max_num_bits: int) -> SNode:
        """Refuses levels with numbers of a few bits side by side, which are not built in."""
        refuse_quant("quant_array")

    def _add(self, kind: str, axes: Any, dimensions: Any, chunk: int = 0) -> SNode:
        self._check_open()
        if isinstance(axes, int):
            axes = (axes,)
        if not isinstance(axes, tuple) or not axes:
            raise TaiRuntimeTypeError(f"expects axes such as ti.ij, but got {axes!r}")
        if len(set(axes)) != len(axes):
            raise TaiRuntimeTypeError("an axis stands twice in one level")
        dimensions = fitting.listed(dimensions)
        if len(dimensions) == 1:
            dimensions = tuple(dimensions) * len(axes)
        if len(dimensions) != len(axes):
            raise TaiRuntimeTypeError(
                f"{len(axes)} axes need {len(axes)} extents, but got {len(dimensions)}"
            )
        extents = []
        for extent in dimensions:
            try:
                value = extent.__index__()
            except AttributeError:
                raise TaiRuntimeTypeError(
                    f"an extent must be a whole number, but got {extent!r}"
                ) from None
            if value <= 0:
                raise TaiRuntimeTypeError(f"an extent must be positive, but got {value}")
            extents.append(value)
        cells = math.prod(extents) * math.prod(n for level in self.path() for n in level.extents)
        if cells >= 2**63:
            raise TaiMemoryError(
                f"the level has more cells than a 64-bit number can count: {cells:,}",
                "make the extents smaller",
            )
        self._check_list_axes(kind, axes)
        shards.check_below(self, kind, dict(zip(axes, extents, strict=True)), AXIS_NAMES)
        if kind == "dynamic":
            chunk = min(max(1, int(chunk) or extents[0] // 32), extents[0])
        child = SNode(kind, self, axes, extents, chunk)
        self.children.append(child)
        return child

    def _check_list_axes(self, kind: str, axes: Sequence[int]) -> None:
        """The index along a list must be a single number, because no other level divides the axis
        of a list.
        """
        above = self.path()
        for axis in axes:
            for level in above:
                if axis in level.axes and "dynamic" in (kind, level.kind):
                    letter = AXIS_NAMES[axis]
                    raise TaiRuntimeTypeError(
                        f"a {kind} level cannot divide axis {letter}, which a {level.kind} level "
                        f"above it divides: the axis of a list is its own",
                        "give the list another axis: ti.root.dense(ti.i, n).dynamic(ti.j, m)",
                    )

    def place(self, *fields: Any, offset: Any = None) -> SNode:
        """Puts one element of each of the fields into each cell of this level.

        Args:
            fields: fields without a place; lists and tuples of them are taken apart.
            offset: the first index along each dimension.
        """
        self._check_open()
        for field in _flatten(fields):
            if not hasattr(field, "put_into"):
                raise TaiRuntimeTypeError(f"place expects fields, but got {field!r}")
            field.put_into(self, offset)
        return self

    def lazy_grad(self) -> None:
        """Places the gradient of every float field below, beside the field."""
        self._place_companions("grad")

    def lazy_dual(self) -> None:
        """Places the tangent of every float field below, beside the field."""
        self._place_companions("dual")

    def _place_companions(self, which: str) -> None:
        self._check_open()
        for child in list(self.children):
            if isinstance(child, SNode):
                child._place_companions(which)
            elif child.role == "primal" and child.dtype.is_float:
                companion = getattr(child, which)
                if companion.level is None:
                    companion.put_into(self, child.offset or None)

    def _check_open(self) -> None:
        root = self.root_node
        if root.allocated:
            raise TaiRuntimeError(
                "this tree is in use already and cannot be extended",
                "lay out all fields of a tree before the first kernel runs",
            )

    # Queries

    def parent(self, n: int = 1) -> SNode | None:
        """The level `n` levels up, the last being `ti.root`; None above that."""
        node: SNode | None = self
        for _ in range(n):
            if node is None:
                break
            node = node._parent
        return node

    @property
    def root_node(self) -> Root:
        node = self
        while node._parent is not None:
            node = node._parent
        return node  # type: ignore[return-value]

    def path(self) -> list[SNode]:
        """The levels from the root's child down to this level."""
        levels = []
        node: SNode | None = self
        while node is not None and node._parent is not None:
            levels.append(node)
            node = node._parent
        return levels[::-1]

    def nearest_sparse(self) -> SNode | None:
        """Returns this level or the innermost level above it whose cells can be inactive."""
        return next((n for n in self.path()[::-1] if n.kind not in ("dense", "shard")), None)

    def axis_extents(self) -> dict[int, int]:
        """The number of cells along each axis divided so far, in the order of the axes."""
        total: dict[int, int] = {}
        for level in self.path():
            for axis, extent in zip(level.axes, level.extents, strict=True):
                total[axis] = total.get(axis, 1) * extent
        return dict(sorted(total.items()))

    @functools.cached_property
    def shape(self) -> tuple[int, ...]:
        """The number of cells along each dimension, over all levels down to this one."""
        return tuple(self.axis_extents().values())

    @property
    def num_dims(self) -> int:
        return len(self.shape)

    # Activity

    def deactivate_all(self) -> None:
        """Deactivates all cells of this level and of those below; their contents become zero.

        On a dense level, it deactivates the sparse levels below.
        """
        if self.kind not in ("root", "dense", "shard"):
            if next(self.places(), None) is None:
                return
            context, tree, number = self._sparse()
            context.deactivate_all(tree, number)
            return
        for child in self.children:
            if isinstance(child, SNode):
                child.deactivate_all()

    @property
    def num_active(self) -> int:
        """The number of active cells of this sparse level."""
        context, tree, number = self._sparse()
        return context.sparse_level(tree, number)[2]

    def active_cells(self) -> Any:
        """The indices of the active cells of this sparse level.

        Returns:
            A NumPy array of shape (number of active cells, dimensions), in the order of memory.
        """
        import numpy as np

        context, tree, number = self._sparse()
        cells = np.frombuffer(context.active_cells(tree, number), dtype=np.int64)
        extents = self.axis_extents()
        result = np.zeros((len(cells), len(extents)), dtype=np.int64)
        column = {axis: position for position, axis in enumerate(extents)}
        span = dict.fromkeys(extents, 1)
        for level in reversed(self.path()):
            for axis, extent in zip(level.axes[::-1], level.extents[::-1], strict=True):
                result[:, column[axis]] += cells % extent * span[axis]
                cells = cells // extent
                span[axis] *= extent
        return result

    @property
    def peak_active(self) -> int:
        """The most cells of a sparse level that were active at any time."""
        context, tree, number = self._sparse()
        return context.sparse_level(tree, number)[5]

    @property
    def _num_dynamically_allocated(self) -> int:
        """The name of `peak_active` in Taichi."""
        return self.peak_active

    # Properties of levels that Taichi programs query

    def _get_children(self) -> list[SNode]:
        """The levels and fields in a cell of this level."""
        found = [c if isinstance(c, SNode) else c.snode for c in self.children]
        return [child for child in found if child is not None]

    def _path_from_root(self) -> list[SNode]:
        """The levels from the root down to this level."""
        return [self.root_node, *self.path()]

    def _physical_index_position(self) -> dict[int, int]:
        """For each index of the fields below, by number, the axis along which it runs."""
        return dict(enumerate(self.axis_extents()))

    @property
    def _cell_size_bytes(self) -> int:
        """Bytes of one cell, with all that lies in it, active or not."""
        return offsets.cell_size(self)

    @property
    def _offset_bytes_in_parent_cell(self) -> int:
        """The offset of the first of these cells in the cell above."""
        return offsets.offset_in_parent(self)

    @property
    def _snode_tree_id(self) -> int:
        """The number of the tree, in the order in which trees were allocated."""
        root = self.root_node
        if root.number is None:
            self._allocate()
        assert root.number is not None
        return root.number

    @property
    def _id(self) -> int:
        return id(self)

    @property
    def _name(self) -> str:
        return self.kind

    def _allocate(self) -> None:
        """Allocates the tree of this level, as the first use of a field does."""
        field = next(self.places(), None)
        if field is None:
            raise TaiRuntimeError("this level holds no field", "place one below it")
        field.materialize()

    def _sparse(self) -> tuple[Any, str, int]:
        """The context, the tree, and the number of this sparse level in it."""
        if self.kind in ("root", "dense", "shard"):
            above = self.nearest_sparse()
            if above is not None:
                raise TaiRuntimeError(
                    f"the cells of a dense level are active as those of the {above.kind} level "
                    "above it are",
                    "ask that one: level.parent()",
                )
            raise TaiRuntimeError(
                f"all cells of a {self.kind} level are active",
                "ask a pointer, bitmasked, hash or dynamic level",
            )
        root = self.root_node
        if root.tree is None and not root.is_destroyed:
            self._allocate()
        if root.tree is None or state.program is None:
            raise TaiRuntimeError("the tree of this level has been destroyed")
        if state.program.trees.get(root.tree) is not root:
            raise TaiRuntimeError(
                "this level was made before the last ti.init and is gone",
                "make levels after ti.init",
            )
        for number, level in enumerate(root.sparse_levels()):
            if level is self:
                return state.program.context, root.tree, number
        raise TaiRuntimeError("this level holds no field", "place one below it")

    def sparse_levels(self) -> Iterator[SNode]:
        """The sparse levels below that hold fields, each before those below it."""
        for child in self.children:
            if isinstance(child, SNode) and next(child.places(), None) is not None:
                if child.kind not in ("dense", "shard"):
                    yield child
                yield from child.sparse_levels()

    def places(self) -> Iterator[ScalarField]:
        """Yields the fields below this level, in storage order."""
        for child in self.children:
            if isinstance(child, SNode):
                yield from child.places()
            else:
                yield child

    def layout(self) -> str:
        """Returns the tree below the root as text of the type `!tai.root`."""
        return f"!tai.root<{', '.join(self._bodies()['primal'])}>"

    def _level(self, role: str) -> str:
        """Returns the text of this level in the type `!tai.root`, without the prefix.

        A dense level with gradients becomes a level for each role, side by side: a forward kernel
        then reads and writes whole cache lines of primal values. Sparse levels keep gradients in
        the cells of their primals, whose activity they share.
        """
        head = ", ".join(
            f"{AXIS_NAMES[a]}: {n}" for a, n in zip(self.axes, self.extents, strict=True)
        )
        if self.kind == "shard":
            head = f"{AXIS_NAMES[self.shard_axis]}: {self.ranks}"
            return f"!tai_mesh.shard<[{head}], {', '.join(self._bodies()[role])}>"
        chunk = f", chunk {self.chunk}" if self.kind == "dynamic" else ""
        return f"{self.kind}<[{head}]{chunk}, {', '.join(self._bodies()[role])}>"

    def _bodies(self) -> dict[str, list[str]]:
        """The contents of the cells of this level in MLIR assembly, for each role (primal, grad,
        dual) that has its own cells.
        """
        bodies: dict[str, list[str]] = {}
        for role, parts in self.contents().items():
            body = bodies.setdefault(role, [])
            for part in parts:
                if isinstance(part, tuple):
                    child, of = part
                    body.append(child._level(of))
                else:
                    body.append("{" + ", ".join(f"{f.symbol}: {f.mlir_type}" for f in part) + "}")
        return bodies

    def contents(self) -> dict[str, list]:
        """The contents of the cells of this level, for each role (primal, grad, dual) that has its
        own cells.

        A part is a list of fields side by side, or a pair of a level and one of its roles.
        """
        bodies: dict[str, list] = {"primal": []}
        records: dict[str, list] = {}

        def close() -> None:
            for role, record in records.items():
                bodies.setdefault(role, []).append(record)
            records.clear()

        for child in self.children:
            if isinstance(child, SNode):
                close()
                if next(child.places(), None) is not None:
                    bodies["primal"] += [(child, role) for role, body in child.contents().items()
                                         if body]  # fmt: skip
            else:
                role = child.role if self.kind == "dense" else "primal"
                records.setdefault(role, []).append(child)
        close()
        return bodies

    def __repr__(self) -> str:
        if self.kind == "root":
            return "ti.root"
        names = "".join(AXIS_NAMES[a] for a in self.axes)
        return f"{self._parent!r}.{self.kind}(ti.{names}, {self.extents})"

    def as_tree(self, depth: int = 0) -> str:
        """Describes the levels and fields below this level, with a line for each."""
        axes = "".join(AXIS_NAMES[a] for a in self.axes)
        own = "ti.root" if self.kind == "root" else f"{self.kind}(ti.{axes}, {self.extents})"
        lines = ["  " * depth + own]
        for child in self.children:
            if isinstance(child, SNode):
                lines.append(child.as_tree(depth + 1))
            else:
                element = f" of shape {child.element_shape}" if child.element_shape else ""
                lines.append("  " * (depth + 1) + f"{child.name}: {child.dtype}{element}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Shows the tree in a notebook."""
        return f"<pre>{html.escape(self.as_tree())}</pre>"

    def __str__(self) -> str:
        shapes = [f"{level.kind} {list(level.shape)}" for level in self.path()]
        return " => ".join(["ti.root", *shapes])


class Place(SNode):
    """The place of a field in a cell: the end of the path from the root.

    A loop over a place, and a query of its activity, refer to the level that holds it.
    """

    def __init__(self, field: Any):
        super().__init__("place", field.level)
        self.field = field

    def _add(self, kind: str, axes: Any, dimensions: Any, chunk: int = 0) -> SNode:
        raise TaiRuntimeError(
            f"a field has no {kind} level in it", "put levels below a level: x.parent()"
        )

    def place(self, *fields: Any, offset: Any = None) -> SNode:
        raise TaiRuntimeError(
            "a field holds no other field", "place it beside: x.parent().place(y)"
        )

    def places(self) -> Iterator[ScalarField]:
        yield from getattr(self.field, "parts", [self.field])

    def deactivate_all(self) -> None:
        assert self._parent is not None
        self._parent.deactivate_all()

    def _sparse(self) -> tuple[Any, str, int]:
        assert self._parent is not None
        return self._parent._sparse()

    @property
    def _name(self) -> str:
        return self.field.name

    @property
    def _dtype(self) -> Any:
        return self.field.dtype

    def __repr__(self) -> str:
        return f"<place of field '{self.field.name}'>"


def _check_size(fields: list[Any]) -> None:
    """Refuses dense fields whose size in bytes does not fit a 64-bit number."""
    for field in fields:
        path = field.level.path()
        if any(level.kind not in ("dense", "root", "shard") for level in path):
            continue
        size = math.prod(n for level in path for n in level.extents)
        size *= math.prod(field.element_shape) * max(1, field.dtype.bits // 8)
        if size >= 2**62:
            raise TaiMemoryError(
                f"field '{field.name}' would take {size:,} bytes", "make its shape smaller"
            )


class Root(SNode):
    """The root of one layout tree."""

    def __init__(self) -> None:
        super().__init__("root", None)
        self.allocated = self.is_destroyed = False
        self.tree: str | None = None
        # The symbol of the tree in the context, or None.
        self._symbol: str | None = None
        self.number: int | None = None
        # The reason why the tree could not be allocated, or None.
        self.refused: str | None = None
        # A lock of the thread that allocates the tree. It is no `Lock` of this package: trees are
        # made and freed often, and Python would lose a Ctrl-C that comes while the set of all such
        # locks forgets one. See `root.begin_in_child`.
        self.lock: Any = threading.RLock()
        # Kernels that were compiled for the tree; they are dropped with it.
        self.users: weakref.WeakSet[Any] = weakref.WeakSet()

    def allocate(self, program: Program) -> None:
        """Makes the tree in the program's context and declares its fields, once."""
        with self.lock:
            if self.allocated:
                return
            try:
                self._allocate_all(program)
            except TaiError as error:
                if self.tree is None:
                    self.refused, self.allocated = error.message, True
                raise
            except BaseException:
                # After an interruption, such as Ctrl-C, the fields are allocated when they are used
                # next.
                self._undo(program)
                raise

    def _allocate_all(self, program: Program) -> None:
        for field in list(self.places()):
            field.place_missing_grad()
        fields = list(self.places())
        if not fields:
            return
        self.allocated = True
        for field in fields:
            field.choose_symbol(program)
        tree = self._symbol = program.unique_symbol("tree")
        try:
            _check_size(fields)
            program.context.add_tree(tree, self.layout())
        except TaiError as error:
            if isinstance(error, TaiMemoryError) and not error.hint:
                error.hint = "make the extents smaller"
            for field in fields:
                assert field.symbol is not None
                program.symbols.give_back(field.symbol)
            program.symbols.give_back(tree)
            error.filename = error.lineno = None  # a place in the text of the layout
            raise
        self.tree, self.number = tree, program.num_trees
        program.num_trees += 1
        program.trees[tree] = self
        # Adjoints are declared first, so that they exist when a primal field names them.
        for field in sorted(fields, key=lambda f: f.role == "primal"):
            field.declare(program, self.tree)

    def _undo(self, program: Program) -> None:
        """Restores the state before the allocation of the tree."""
        for field in self.places():
            field.release()
            if field.symbol is not None:
                program.fields.pop(field.symbol, None)
                program.symbols.give_back(field.symbol)
                field.symbol = None
        if self._symbol is not None:
            with contextlib.suppress(TaiError):  # it may not be there yet
                program.context.destroy_tree(self._symbol)
            program.trees.pop(self._symbol, None)
            program.symbols.give_back(self._symbol)
        self.tree = self.number = self._symbol = None
        self.allocated = False

    def __eq__(self, other: Any) -> bool:
        # All roots count as equal to `ti.root`, because programs compare parents with it.
        return isinstance(other, Root) or getattr(other, "is_root", False)

    __hash__ = object.__hash__


def _flatten(items: Any) -> Iterator[Field]:
    for item in items:
        if isinstance(item, (list, tuple)):
            yield from _flatten(item)
        else:
            yield item


class FieldsBuilder:
    """A tree of its own, which can be freed: `dense`, `place`, …, then `finalize`."""

    def __init__(self) -> None:
        get_program()
        self._root = Root()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._root, name)

    @property
    def root(self) -> Root:
        """The root of the tree that this builder lays out."""
        return self._root

    @property
    def empty(self) -> bool:
        """Whether nothing was laid out in this builder yet."""
        return not self._root.children

    @property
    def finalized(self) -> bool:
        """Whether the fields of this builder are allocated."""
        return self._root.allocated

    @classmethod
    def _finalized_roots(cls) -> list[Root]:
        """Returns the roots of all allocated trees."""
        return [] if state.program is None else list(state.program.trees.values())

    def finalize(self, raise_warning: bool = True) -> SNodeTree:
        """Allocates the fields of this builder.

        Raises:
            TaiRuntimeError: the tree holds no field, or is finalized already.
        """
        program = get_program()
        if self._root.allocated:
            raise TaiRuntimeError("the tree is finalized already", "make a new ti.FieldsBuilder()")
        if not any(True for _ in self._root.places()):
            raise TaiRuntimeError("the tree holds no field", "place a field before finalize()")
        self._root.allocate(program)
        return SNodeTree(self._root)


class SNodeTree:
    """An allocated tree of a `FieldsBuilder`."""

    def __init__(self, root: Root):
        self._root = root

    @property
    def id(self) -> int:
        """The number of the tree, in the order in which trees were allocated."""
        if self._root.is_destroyed:
            raise TaiRuntimeError("the tree is freed already")
        assert self._root.number is not None
        return self._root.number

    def destroy(self) -> None:
        """Frees the fields of the tree; using one afterwards is an error.

        Raises:
            TaiRuntimeError: a kernel runs that uses the tree, in another thread or around a
                signal handler that calls this.
        """
        if self._root.tree is None or state.program is None:
            raise TaiRuntimeError("the tree is freed already")
        program, symbol = state.program, self._root.tree
        try:
            program.context.destroy_tree(symbol)
            self._forget(program, symbol)
        except TaiError:
            raise
        except BaseException:
            # An interruption such as Ctrl-C: the destruction is completed. The tree may be gone
            # already.
            with contextlib.suppress(TaiError):
                program.context.destroy_tree(symbol)
            self._forget(program, symbol)
            raise

    def _forget(self, program: Program, tree: str) -> None:
        for field in self._root.places():
            field.forget()
            assert field.symbol is not None  # it was allocated
            if program.fields.pop(field.symbol, None) is not None:
                program.symbols.give_back(field.symbol)
        if program.trees.pop(tree, None) is not None:
            program.symbols.give_back(tree)
        self._root.tree, self._root.is_destroyed = None, True
        for user in list(self._root.users):
            user.drop()


class Layout:
    """The storage order of the components of a vector or matrix field."""

    AOS = "aos"
    SOA = "soa"


i, j, k, l = (Axes((n,)) for n in range(4))  # noqa: E741
ij, ik, il, jk, jl, kl = (Axes(pair) for pair in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)))
ijk, ijl, ikl, jkl = (Axes(t) for t in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)))
ijkl = Axes((0, 1, 2, 3))


check_keywords(globals(), ["SNode", "FieldsBuilder", "SNodeTree"], attributes=False)
