"""Lvalues of a kernel: variables, elements of fields and of arrays."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from ...errors import TaiAutodiffError, TaiIndexError, TaiRuntimeError, TaiSyntaxError, TaiTypeError
from ..base.dtypes import DataType
from ..base.elements import Elements
from ..fields.field import Field
from ..fields.matrix_field import MatrixField
from ..fields.scalar import ComponentField, ScalarField
from ..fields.structs import parts_of
from ..values.emitter import Emitter
from ..values.positions import flat, in_range, read
from ..values.value import MatrixValue, Value, stop_gradient

# For each operator, the kind of `tai.atomic`.
ATOMIC_KINDS = {"+": "add", "-": "sub", "*": "mul", "min": "min", "max": "max",
                "&": "and", "|": "or", "^": "xor"}  # fmt: skip


class Variable:
    """A local variable: the value that it has at this point of the program.

    Its type is that of the first assignment. `hidden` is set while a parallel loop runs that
    changes it: the variable then lives in memory that all iterations share.
    """

    __slots__ = ("fixed", "hidden", "name", "value")

    def __init__(self, name: str, value: Value, fixed: str | None = None):
        self.name, self.value, self.fixed = name, value, fixed
        self.hidden: FieldElement | None = None


class Place:
    """A variable, element or component, which a kernel can load and store.

    Attributes:
        dt, shape: the type of its value. A loaded value has the type that it is computed in (f32
            for f16); `convert` gives a value that can be stored.
    """

    emitter: Emitter
    dt: DataType
    shape: tuple[int, ...]

    def load(self) -> Any:
        raise NotImplementedError

    def store(self, value: Any) -> None:
        raise NotImplementedError

    def atomic(self, op: str, value: Any) -> Any:
        """Combines `value` into the place and returns its former value."""
        old = self.load()
        self.store(self.convert(self.emitter.binary(op, old, value)))
        return old

    def fill(self, value: Any) -> None:
        """Sets all components of a matrix to one number: `v.fill(1)`."""
        number = self.emitter.as_value(value)
        if number.shape:
            raise TaiTypeError(
                f"fill takes one number, but got a {number.kind_name}", "assign it: v = …"
            )
        self.store(self.convert(value))

    def at(self, key: Any) -> Place:
        """Returns a component of the matrix in this place."""
        component = self.emitter.component_of(_Shape(self), key)
        if isinstance(component, list):
            return Part(self, *component)
        return self.component(component)

    def component(self, component: Any) -> Place:
        return Component(self, component)

    def convert(self, value: Any) -> Any:
        """Converts `value` to the type of this place."""
        emitter = self.emitter
        if isinstance(value, (bool, int, float)) and not self.shape:
            emitter.check_fraction(value, self.dt, self._what())
            return emitter.constant(value, self.dt)
        value, given = emitter.as_value(value), value
        if value.shape and not self.shape:
            raise TaiTypeError(
                f"a {value.kind_name} cannot be stored where one number of type {self.dt} is"
            )
        if value.shape and value.shape != self.shape:
            raise TaiTypeError(f"a {value.kind_name} cannot be stored in {self._kind()}")
        emitter.check_fraction(given, self.dt, self._what())
        return emitter.broadcast(emitter.cast(value, self.dt), self.shape)

    def _what(self) -> str:
        """Returns the name of the place for messages."""
        return f"a place of type {self.dt}"

    def _kind(self) -> str:
        size = "×".join(map(str, self.shape))
        return f"a {'vector' if len(self.shape) == 1 else 'matrix'} of {size} {self.dt}"


class _Shape:
    """The shape and the kind of a place (something that can be assigned to), as `component_of`
    needs them.
    """

    def __init__(self, place: Place):
        self.shape = place.shape
        self.kind_name = place._kind()[2:] if place.shape else str(place.dt)


class VariablePlace(Place):
    """A local variable."""

    def __init__(self, emitter: Emitter, variable: Variable):
        self.emitter, self.variable = emitter, variable
        self.dt, self.shape = variable.value.dt, variable.value.shape

    def _what(self) -> str:
        return f"variable '{self.variable.name}' of type {self.dt}"

    def load(self) -> Value:
        hidden = self.variable.hidden
        return self.variable.value if hidden is None else hidden.load()

    def store(self, value: Value) -> None:
        variable = self.variable
        if variable.fixed is not None:
            raise _immutable(variable)
        if variable.hidden is not None:
            variable.hidden.store(value)
        else:
            variable.value = value

    def atomic(self, op: str, value: Value) -> Value:
        hidden = self.variable.hidden
        if hidden is not None and self.variable.fixed is None:
            return hidden.atomic(op, value)
        return super().atomic(op, value)

    def component(self, component: Any) -> Place:
        hidden = self.variable.hidden
        return hidden.component(component) if hidden is not None else Component(self, component)


def refuse_truth_arithmetic(op: str, dt: DataType) -> None:
    """Refuses arithmetic updates of a place of type bool."""
    if dt.is_bool and op not in ("&", "|", "^", "min", "max"):
        raise TaiTypeError(
            f"'{op}' counts, but the target holds {dt}: true or false",
            "use |= or &=, or a ti.i32 to count in",
        )


def _immutable(variable: Variable) -> TaiSyntaxError:
    return TaiSyntaxError(
        f"{variable.fixed} '{variable.name}' cannot be changed",
        f"copy it first: {variable.name}_ = {variable.name}",
    )


class Component(Place):
    """One component of a matrix that is stored as a whole."""

    def __init__(self, base: Place, component: Any):
        self.emitter, self.base = base.emitter, base
        self.dt, self.shape = base.dt, ()
        component = in_range(self.emitter, component, _Shape(base))
        self.number = flat(self.emitter, component, base.shape)

    def load(self) -> Value:
        whole = self.base.load()
        if isinstance(self.number, int):
            return self.emitter.extract(whole, self.number)
        return read(self.emitter, whole, self.number)

    def store(self, value: Value) -> None:
        whole = self.base.load()
        value = self.emitter.cast(value, whole.dt)
        changed = self.emitter.with_component(whole, self.number, value)
        self.base.store(self.base.convert(changed))


class Part(Place):
    """Several components of a matrix: a swizzle or a row."""

    def __init__(self, base: Place, components: list[Any], shape: tuple[int, ...]):
        self.emitter, self.base, self.numbers = base.emitter, base, components
        self.dt, self.shape = base.dt, shape

    def load(self) -> Value:
        parts = [self.base.component(c).load() for c in self.numbers]
        return self.emitter.matrix(parts, parts[0].dt, self.shape)

    def store(self, value: MatrixValue) -> None:
        for number, scalar in zip(self.numbers, value.scalars(), strict=True):
            self.base.component(number).store(scalar)

    def atomic(self, op: str, value: MatrixValue) -> Value:
        parts = zip(self.numbers, value.scalars(), strict=True)
        old = [self.base.component(number).atomic(op, scalar) for number, scalar in parts]
        return self.emitter.matrix(old, old[0].dt, self.shape)

    def component(self, component: Any) -> Place:
        if not isinstance(component, int):
            raise TaiTypeError("a component of a part must be known at compile time")
        return self.base.component(self.numbers[component])


class FieldElement(Place):
    """An element of a field, or a component of one.

    Args:
        field: the storage of one place.
        indices: handles of type `index`.
        components: handles of type `index` for each dimension of the element, or none.
    """

    def __init__(
        self, emitter: Emitter, field: ScalarField, indices: list[Any], components: Any = ()
    ):
        self.emitter, self.field = emitter, field
        self.indices, self.components = indices, list(components)
        self.dt = field.dtype
        self.shape = () if self.components else field.element_shape
        emitter.fields.add(field)

    @property
    def _symbol(self) -> str:
        symbol = self.field.symbol
        assert symbol is not None  # fields that a kernel reads or writes are allocated
        return symbol

    def _what(self) -> str:
        return f"field '{self.field.name}' of type {self.dt}"

    def load(self) -> Value:
        type_ = self.emitter.type_of(self.dt, self.shape)
        handle = self.emitter.builder.load(self._symbol, self.indices, self.components, type_)
        value = self.emitter.to_computed(self.emitter.value(handle, self.dt, self.shape))
        value = self.emitter.loaded(self.field, value)
        stopped = id(self.field) in self.emitter.stopped
        return stop_gradient(value) if stopped else value

    def store(self, value: Value) -> None:
        self.emitter.stored.add(self.field)
        self.emitter.builder.store(self._symbol, value.handle, self.indices, self.components)

    def atomic(self, op: str, value: Value) -> Value:
        kind = ATOMIC_KINDS[op]
        if self.dt.kind == "u" and op in ("min", "max"):
            kind += "u"
        self.emitter.accumulated.add(self.field)
        if op in ("+", "-"):
            value = self.emitter.added(self.field, value)
        handle = self.emitter.builder.atomic(
            kind, self._symbol, value.handle, self.indices, self.components,
            self.emitter.type_of(self.dt, self.shape),
        )  # fmt: skip
        return self.emitter.to_computed(self.emitter.value(handle, self.dt, self.shape))

    def component(self, component: Any) -> Place:
        shape = self.field.element_shape
        emitter = self.emitter
        if len(shape) == 1:
            parts = [emitter.to_index(component)]
        else:
            pair = component if isinstance(component, tuple) else divmod(component, shape[1])
            parts = [emitter.to_index(i) for i in pair]
        return FieldElement(emitter, self.field, self.indices, parts)


class SplitElement(Place):
    """An element of a matrix field whose components are separate arrays."""

    def __init__(self, emitter: Emitter, field: MatrixField, indices: list[Any]):
        self.emitter, self.field, self.indices = emitter, field, indices
        self.dt, self.shape = field.dtype, field.element_shape

    def _part(self, component: int) -> FieldElement:
        return FieldElement(self.emitter, self.field.components[component], self.indices)

    def load(self) -> Value:
        parts = [part.load() for part in self.parts()]
        return self.emitter.matrix(parts, parts[0].dt, self.shape)

    def store(self, value: MatrixValue) -> None:
        for part, scalar in zip(self.parts(), value.scalars(), strict=True):
            part.store(scalar)

    def atomic(self, op: str, value: MatrixValue) -> Value:
        pairs = zip(self.parts(), value.scalars(), strict=True)
        old = [part.atomic(op, scalar) for part, scalar in pairs]
        return self.emitter.matrix(old, old[0].dt, self.shape)

    def component(self, component: Any) -> Place:
        if isinstance(component, int):
            return self._part(component)
        return SplitComponent(self, component)

    def parts(self) -> list[FieldElement]:
        return [self._part(c) for c in range(len(self.field.components))]


class SplitComponent(Component):
    """A component of a `SplitElement`, with an index that is known only when the kernel runs.

    Each is stored elsewhere, and the others must stay as they are: another iteration may be
    changing them.
    """

    def __init__(self, base: SplitElement, component: Any):
        super().__init__(base, component)
        self.parts = base.parts()

    def _only(self, number: int, change: Callable[[], Value | None], old: Value | None) -> Any:
        """Emits a branch that performs `change` only if the index selects component `number`;
        returns the result of `change`, otherwise `old`.
        """
        emitter, builder = self.emitter, self.emitter.builder
        holds = emitter.compare("==", self.number, number)
        outer = builder.get_block()
        regions = [builder.region(), builder.region()]
        builder.set_block(builder.block(regions[0], []))
        found = change()
        builder.yield_([] if found is None else [found.handle])
        builder.set_block(builder.block(regions[1], []))
        if found is not None and old is None:
            old = emitter.constant(0, found.dt)
        builder.yield_([] if old is None else [old.handle])
        builder.set_block(outer)
        types = [] if found is None else [emitter.type_of(found.dt)]
        handle = builder.if_(holds.handle, types, *regions)
        return None if found is None else emitter.value(handle, found.dt)

    def store(self, value: Value) -> None:
        for number, part in enumerate(self.parts):
            self._only(number, functools.partial(part.store, value), None)

    def atomic(self, op: str, value: Value) -> Value:
        old: Any = None
        for number, part in enumerate(self.parts):
            old = self._only(number, functools.partial(part.atomic, op, value), old)
        return old


class ArrayElement(Place):
    """An element of an array argument, or a component of one."""

    def __init__(self, emitter: Emitter, array: ArrayArgument, indices: list[Any]):
        self.emitter, self.array, self.indices = emitter, array, indices
        self.dt = array.dt
        self.shape = array.element_shape[len(indices) - array.spec.ndim :]

    def load(self) -> Value:
        self.array.spec.is_read = self.array.spec.is_loaded = True
        if self.shape:
            parts = [self.component(c).load() for c in range(_count(self.shape))]
            return self.emitter.matrix(parts, parts[0].dt, self.shape)
        handle = self.emitter.builder.load_from_array(
            self.array.handle, self.indices, self.emitter.type_of(self.dt)
        )
        value = Value(self.emitter, handle, self.dt)
        return self.emitter.to_computed(value)

    def store(self, value: Any) -> None:
        self.array.spec.is_written = True
        if self.shape:
            for number, scalar in enumerate(value.scalars()):
                self.component(number).store(scalar)
            return
        self.emitter.builder.store_to_array(value.handle, self.array.handle, self.indices)

    def atomic(self, op: str, value: Any) -> Value:
        self.array.spec.is_written = self.array.spec.is_read = True
        # The gradient of a sum does not need the values of the element.
        self.array.spec.is_loaded |= op not in ("+", "-")
        if self.shape:
            old = [self.component(c).atomic(op, v) for c, v in enumerate(value.scalars())]
            return self.emitter.matrix(old, old[0].dt, self.shape)
        if op == "-":
            return self.atomic("+", self.convert(self.emitter.unary("neg", value)))
        names = {"+": ("addf", "addi"), "max": ("maxnumf", "maxs"), "min": ("minnumf", "mins"),
                 "&": ("", "andi"), "|": ("", "ori"), "^": ("", "xori")}  # fmt: skip
        if op not in names:
            return super().atomic(op, value)
        name = names[op][0 if self.dt.is_float else 1]
        if self.dt.kind == "u" and op in ("min", "max"):
            name = name[:-1] + "u"
        handle = self.emitter.builder.atomic_in_array(
            name, value.handle, self.array.handle, self.indices, self.emitter.type_of(self.dt)
        )
        return self.emitter.to_computed(self.emitter.value(handle, self.dt))

    def component(self, component: Any) -> Place:
        emitter, shape = self.emitter, self.array.element_shape
        if len(shape) == 1:
            extra = [emitter.to_index(component)]
        else:
            pair = component if isinstance(component, tuple) else divmod(component, shape[1])
            extra = [emitter.to_index(i) for i in pair]
        return ArrayElement(emitter, self.array, [*self.indices, *extra])


class ArrayArgument(Elements):
    """An array argument of a kernel: `ti.types.ndarray`."""

    def __init__(self, emitter: Emitter, name: str, handles: list, spec: Any):
        self.emitter, self.name, self.spec = emitter, name, spec
        # The handle of the array, and the handle of its gradient if it has one.
        self.handle, self._gradient = handles[0], handles[1:]
        self.dt, self.element_shape = spec.dt, spec.element_shape
        # Leaves out the first dimension of arrays in a batched kernel, which counts the worlds and
        # is hidden from the kernel.
        self._is_stacked = emitter.worlds is not None and emitter.worlds.is_stacked(name)
        self.ndim = spec.ndim - self._is_stacked

    def _described(self) -> str:
        return f"array '{self.name}'"

    def _example(self) -> str:
        return f"{self.name}[{', '.join('ijklmnop'[: self.ndim])}]"

    @property
    def dtype(self) -> DataType:
        return self.dt

    @property
    def n(self) -> int:
        return self.element_shape[0] if self.element_shape else 1

    @property
    def m(self) -> int:
        return self.element_shape[1] if len(self.element_shape) == 2 else 1

    @property
    def shape(self) -> tuple[Value, ...]:
        """The extents of the array, which are known only when the kernel runs."""
        emitter, extents = self.emitter, []
        for dimension in range(self._is_stacked, self.spec.ndim):
            at = emitter.index(dimension)
            handle = emitter.builder.extent(self.handle, at)
            extents.append(emitter.from_index(handle))
        return tuple(extents)

    def __getattr__(self, name: str) -> Any:
        if name != "grad":
            raise AttributeError(name)
        if not self._gradient:
            raise TaiAutodiffError(
                f"array '{self.name}' has no gradient",
                "pass a ti.ndarray that was made with needs_grad=True",
            )
        self.spec.uses_gradient = True
        found = ArrayArgument(self.emitter, self.name, self._gradient, self.spec)
        found.name = f"{self.name}.grad"
        return found

    def element(self, key: Any) -> ArrayElement:
        indices = flatten_indices(key)
        if len(indices) != self.ndim:
            raise TaiIndexError(_count_message("array", self.name, self.ndim, len(indices)))
        if self.spec.is_clamped:
            indices = list(map(self._clamped, indices, self.shape))
        if self._is_stacked:
            indices.insert(0, self.emitter.worlds.index_of_array(self.name))
        return ArrayElement(self.emitter, self, [self.emitter.to_index(i) for i in indices])

    def _clamped(self, index: Any, extent: Value) -> Any:
        """The index, moved to the nearest one of the array, as `boundary="clamp"` asks for."""
        last = self.emitter.binary("-", extent, 1)
        return self.emitter.binary("max", self.emitter.binary("min", index, last), 0)


def _count(shape: tuple[int, ...]) -> int:
    count = 1
    for extent in shape:
        count *= extent
    return count


def flatten_indices(key: Any) -> list[Any]:
    """The numbers of a subscript; vectors of whole numbers are taken apart."""
    if key is None:
        return []
    indices: list[Any] = []
    for part in key if isinstance(key, tuple) else (key,):
        if isinstance(part, MatrixValue):
            indices += part.scalars()
        elif getattr(part, "is_matrix", False) or isinstance(part, (list, tuple)):
            indices += list(part)
        elif isinstance(part, slice):
            raise TaiTypeError("fields have no slices", "loop over the elements")
        else:
            indices.append(part)
    return indices


def _count_message(kind: str, name: str, wanted: int, got: int) -> str:
    indices = "index" if wanted == 1 else "indices"
    return f"{kind} '{name}' takes {wanted} {indices}, but got {got}"


def field_element(emitter: Emitter, field: Field, key: Any) -> Place:
    """Returns the element of `field` that a subscript names.

    Raises:
        TaiIndexError: the number of indices, or a constant index that is out of range.
        TaiRuntimeError: the field is not placed.
    """
    use_field(field)
    indices = flatten_indices(key)
    if emitter.worlds is not None:
        indices = emitter.worlds.indices(field, [] if key is None else indices)
    shape = field.shape
    if len(indices) != len(shape):
        error = TaiIndexError(_count_message("field", field.name, len(shape), len(indices)))
        if not shape:
            error.hint = f"a field without dimensions is read as {field.name}[None]"
        raise error
    offset = getattr(field, "offset", ()) or (0,) * len(shape)
    handles = []
    for dimension, (index, extent, first) in enumerate(zip(indices, shape, offset, strict=True)):
        constant = index.const if isinstance(index, Value) else index
        if (
            isinstance(constant, int)
            and not isinstance(constant, bool)
            and not first <= constant < first + extent
        ):
            raise TaiIndexError(
                f"index {constant} is out of range: dimension {dimension} of field "
                f"'{field.name}' runs from {first} to {first + extent - 1}"
            )
        handles.append(emitter.to_index(index))
    if isinstance(field, MatrixField):
        if field.single is None:
            return SplitElement(emitter, field, handles)
        return FieldElement(emitter, field.single, handles)
    if isinstance(field, ComponentField) and field.is_window:
        whole = FieldElement(emitter, field._whole.single, handles)
        return whole.component(field._index)
    assert isinstance(field, ScalarField)
    return FieldElement(emitter, field, handles)


def use_field(field: Field) -> None:
    """Allocates a field that a kernel uses.

    Raises:
        TaiRuntimeError: it is not placed, or of an earlier program.
    """
    if isinstance(field, ComponentField) and field.is_window:
        field = field._whole
    field._placed_node()
    for part in parts_of(field):
        part.materialize()
        if not part.is_current():
            raise TaiRuntimeError(
                f"field '{field.name}' was made before the last ti.init and is gone",
                "make fields after ti.init",
            )
