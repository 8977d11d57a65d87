"""Levels of a layout in kernels: activity, lists, and loops over active cells."""

from __future__ import annotations

from typing import Any

from ...errors import TaiIndexError, TaiTypeError
from ..base.dtypes import i32, i64, u1, u64
from ..fields.field import Field
from ..fields.scalar import ScalarField
from ..fields.snode import AXIS_NAMES, Place, SNode
from ..values import ops
from ..values.emitter import Emitter
from ..values.matrix import Vector
from ..values.value import Value
from .context import Context, Part
from .refs import FieldElement, flatten_indices, use_field
from .structs import StructValue


def level_of(thing: Any, what: str) -> SNode:
    """The level that an argument of a sparse operation means: the argument itself, or the level
    that holds the field.
    """
    node = thing
    if isinstance(thing, Field):
        use_field(thing)
        node = thing.level
    elif isinstance(thing, Place):
        node = thing.parent()
    if isinstance(node, SNode) and node.kind != "root":
        return node
    if isinstance(thing, (Field, Place)):
        raise TaiTypeError(
            f"{what} takes a level of a layout, but '{thing._name}' stands in none",
            "place it in one: ti.root.pointer(ti.i, n).place(x)",
        )
    raise TaiTypeError(
        f"{what} takes a level of a layout, but got {thing!r}",
        "keep what ti.root.pointer(…) returns, or write x.parent()",
    )


class Level:
    """A level of the layout, as seen from a field below it.

    Attributes:
        field: the first field below, whose indices name cells.
        symbol, below: of that field, and the level that holds it.
        up: how many levels it stands above the field; 1 is the innermost.
        scale: for each dimension of the field, how many of its indices one cell spans.
        dimensions: for each dimension of the level, that of the field.
    """

    def __init__(self, node: SNode, what: str):
        self.node = node
        field = next(node.places(), None)
        if field is None:
            raise TaiTypeError(f"{what} takes a level that holds a field", "place one below it")
        use_field(field)
        self.field: ScalarField = field
        below = field.level
        assert below is not None and field.symbol is not None
        self.symbol, self.below = field.symbol, below
        self.up = len(below.path()) - len(node.path()) + 1
        extents, own = below.axis_extents(), node.axis_extents()
        self.scale = [extents[axis] // own.get(axis, 1) for axis in extents]
        self.dimensions = [list(extents).index(axis) for axis in own]

    @property
    def rank(self) -> int:
        return len(self.dimensions)

    def element(self, emitter: Emitter, indices: list[Any]) -> list[Any]:
        """Returns the indices of the first element in a cell, as handles."""
        offset = self.field.offset or (0,) * len(self.scale)
        handles = [emitter.index(first) for first in offset]
        for dimension, index in zip(self.dimensions, indices, strict=True):
            value = emitter.binary("*", index, self.scale[dimension])
            handles[dimension] = emitter.to_index(emitter.binary("+", value, offset[dimension]))
        return handles


def _describe(node: SNode) -> str:
    names = "".join(AXIS_NAMES[axis] for axis in node.axis_extents())
    return f"the '{node.kind}' level over {names}"


class Levels(Part):
    """The part of the compiler that handles levels.

    Attributes:
        appends: whether the loop that is compiled appends to a list.
    """

    def __init__(self, context: Context):
        super().__init__(context)
        self.appends = False

    def level_call(self, function: Any, args: list) -> Any:
        """Compiles a call of `ti.activate`, `ti.is_active`, `ti.append` and so on."""
        name = f"ti.{function.__name__}"
        if function is ops.rescale_index:
            return self._rescale(args)
        if function is ops.get_addr:
            return self._address(args)
        if len(args) != (3 if function is ops.append else 2):
            form = "level, indices, value" if function is ops.append else "level, indices"
            raise TaiTypeError(f"{name} takes ({form})")
        level = Level(level_of(args[0], name), name)
        indices = flatten_indices(args[1])
        if function in (ops.append, ops.length):
            value = args[2] if function is ops.append else None
            return self.list_call(level, indices, value, name)
        if level.node.kind == "dynamic" and function is ops.deactivate:
            # A list is deactivated as a whole, so the program may leave out the index along it.
            if len(indices) == level.rank - 1:
                indices = self._with_list_index(level, indices, 0)
        if len(indices) != level.rank:
            raise TaiIndexError(
                f"{_describe(level.node)} has {level.rank} indices, but got {len(indices)}"
            )
        if level.node.kind == "dense" and function is ops.deactivate:
            raise TaiTypeError(
                f"cells of {_describe(level.node)} are always active",
                "deactivate a pointer, bitmasked or dynamic level above it, or store zeros",
            )
        cell = level.symbol, level.up, level.element(self.emitter, indices)
        if function is ops.is_active:
            return self.emitter.value(self.builder.is_active(*cell), u1)
        if function is ops.activate:
            self.builder.activate(*cell)
        else:
            self.builder.deactivate(*cell)
        return None

    def list_call(self, level: Level, indices: list, value: Any, name: str) -> Any:
        """Compiles `ti.append` (with a value) or `ti.length` of a list."""
        node, emitter = level.node, self.emitter
        if node.kind != "dynamic":
            raise TaiTypeError(
                f"{name} takes a dynamic level, but this is {_describe(node)}",
                "ti.root.dynamic(ti.j, 1024).place(x)",
            )
        inner = [n for n in level.below.path() if n.kind == "dynamic"][-1]
        if inner is not node:
            raise TaiTypeError(
                f"{name} takes the innermost list, and there are lists in {_describe(node)}",
                "keep the number of outer cells in a field",
            )
        if len(indices) != level.rank - 1:
            raise TaiIndexError(
                f"a list of {_describe(node)} has {level.rank - 1} indices, but got {len(indices)}"
            )
        handles = level.element(emitter, self._with_list_index(level, indices, 0))
        del handles[self.list_dimension(level)]
        if value is None:
            count = self.builder.length(level.symbol, handles)
            return emitter.from_index(count, i32)
        if any(isinstance(child, SNode) for child in node.children):
            raise TaiTypeError(
                f"{name} takes a list of numbers, but there are levels in {_describe(node)}",
                "write to the elements: the list grows to the highest index",
            )
        places = [p for p in node.places() if p.role == "primal"]
        values = list(value.leaves()) if isinstance(value, StructValue) else [value]
        if len(places) != len(values):
            fields = "1 field" if len(places) == 1 else f"{len(places)} fields"
            what = f"{len(values)} members" if isinstance(value, StructValue) else "one value"
            raise TaiTypeError(
                f"{name} takes a value for each field of the list, which holds {fields}, "
                f"but got {what}",
                "place a struct field in the list, or write to the elements: "
                "the list grows to the highest index",
            )
        elements = []
        for place, one in zip(places, values, strict=True):
            converted = FieldElement(emitter, place, []).convert(one)
            elements.append(converted)
        self.appends = True
        at = self.builder.append(level.symbol, elements[0].handle, handles)
        dimension, offset = self.list_dimension(level), level.field.offset
        first = offset[dimension] if offset else 0
        number = emitter.from_index(at, i32)
        where = emitter.to_index(emitter.binary("+", number, first))
        handles.insert(dimension, where)
        for place, element in zip(places[1:], elements[1:], strict=True):
            FieldElement(emitter, place, handles).store(element)
        return number

    def _address(self, args: list) -> Any:
        """Compiles `ti.get_addr(field, indices)`: the address of an element, as a u64."""
        if len(args) != 2 or not isinstance(args[0], Field):
            raise TaiTypeError("ti.get_addr takes (field, indices)")
        field, indices = args[0], flatten_indices(args[1])
        use_field(field)
        if len(indices) != len(field.shape):
            raise TaiIndexError(
                f"field '{field.name}' takes {len(field.shape)} indices, but got {len(indices)}"
            )
        storage, component = field.storage()
        emitter, node = self.emitter, storage.level
        assert node is not None
        begin = list(storage.offset or (0,) * len(indices))
        base = storage.core.address(tuple(begin))
        size = storage.dtype.numpy.itemsize
        address = emitter.constant(base + component * size, i64)
        axes = list(node.axis_extents())
        below = node.axis_extents()
        for level in node.path():
            for axis, extent in zip(level.axes, level.extents, strict=True):
                below[axis] //= extent
                if extent == 1:
                    continue
                dimension = axes.index(axis)
                # One step along a digit of an index changes the address by the same bytes
                # everywhere.
                step = list(begin)
                step[dimension] += below[axis]
                stride = storage.core.address(tuple(step)) - base
                index = emitter.cast(emitter.as_value(indices[dimension]), i64)
                digit = emitter.binary("-", index, begin[dimension])
                digit = emitter.binary("//", digit, below[axis])
                digit = emitter.binary("%", digit, extent)
                address = emitter.binary("+", address, emitter.binary("*", digit, stride))
        return emitter.cast(address, u64)

    def list_dimension(self, level: Level) -> int:
        """The position of the list's index among the indices of its field."""
        axes = list(level.node.axis_extents())
        return level.dimensions[axes.index(level.node.axes[0])]

    def _with_list_index(self, level: Level, indices: list, index: Any) -> list:
        axes = list(level.node.axis_extents())
        at = axes.index(level.node.axes[0])
        return [*indices[:at], index, *indices[at:]]

    def _rescale(self, args: list) -> Any:
        if len(args) != 3:
            raise TaiTypeError("ti.rescale_index takes (from level, to level, indices)")
        source, target = (level_of(a, "ti.rescale_index") for a in args[:2])
        have, want = source.axis_extents(), target.axis_extents()
        indices = flatten_indices(args[2])
        if list(have) != list(want) or len(indices) != len(have):
            raise TaiTypeError("ti.rescale_index takes levels and indices of the same axes")
        result = []
        for axis, index in zip(have, indices, strict=True):
            if want[axis] >= have[axis]:
                result.append(self.emitter.binary("*", index, want[axis] // have[axis]))
            else:
                result.append(self.emitter.binary("//", index, have[axis] // want[axis]))
        return Vector(result)


_LIST_METHODS = ("append", "length", "deactivate")


def list_method(levels: Levels, field: Field, name: str) -> Any:
    """A method such as `x.append`, `x.length` or `x.deactivate` of a field that consists of one
    list, or None.
    """
    if name not in _LIST_METHODS or field.level is None or len(field.shape) != 1:
        return None
    found = list_element(levels, field, None)
    return None if found is None else getattr(found, name)


class ListElement:
    """The list of a dynamic level as a whole, written as `y[i]` for a field y below the level."""

    def __init__(self, levels: Levels, field: Field, indices: list[Any]):
        self._levels = levels
        assert field.level is not None
        self._level = level = Level(field.level, f"field '{field.name}'")
        # Indices of the field begin at its offset, but indices of a list begin at zero.
        first = list(field.offset or (0,) * level.rank)
        del first[levels.list_dimension(level)]
        self._indices = [
            levels.emitter.binary("-", index, start) if start else index
            for index, start in zip(indices, first, strict=True)
        ]

    def append(self, value: Any) -> Value:
        """Emits the append of a cell to a list, and returns the index of the cell."""
        return self._levels.list_call(self._level, self._indices, value, "append")

    def length(self) -> Value:
        """The number of cells."""
        return self._levels.list_call(self._level, self._indices, None, "length")

    def deactivate(self) -> None:
        """Empties the list."""
        self._levels.level_call(ops.deactivate, [self._level.node, self._indices])


def list_element(levels: Levels, field: Field, key: Any) -> ListElement | None:
    """The list that a subscript names if it has one index less than the field; otherwise None."""
    storage, _ = field.storage()
    node = storage.level
    if node is None or node.kind != "dynamic":
        return None
    indices = [] if key is None else flatten_indices(key)
    if len(indices) != len(field.shape) - 1:
        return None
    use_field(field)
    return ListElement(levels, storage, indices)
