"""Fields: the arrays that kernels read and write, and their element access from Python."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from ...errors import (
    TaiAutodiffError,
    TaiError,
    TaiIndexError,
    TaiRuntimeError,
    TaiRuntimeTypeError,
)
from ..base import dtypes, fitting, state
from ..base.program import get_program, name_fields
from ..history import origins
from . import active, copies
from .shapes import to_order, to_shape
from .shareable import Shareable
from .snode import Layout, Place, SNode


class Field(Shareable):
    """What scalar, vector and matrix fields have in common.

    Attributes:
        dtype: scalar type of the components.
        n, m: rows and columns of an element; 1 for a scalar, m is 1 for a vector.
        element_shape: `()`, `(n,)` or `(n, m)`.
        role: `primal`, `grad` or `dual`.
        level: the level that holds the field, or None before it is placed.
    """

    def __init__(self, dtype: Any, element_shape: tuple[int, ...], name: str | None, role: str):
        resolved = dtypes.to_dtype(dtype)
        if resolved is None:
            raise TaiRuntimeTypeError(
                f"a field holds numbers, not {dtype!r}", "use a type such as ti.f32 or ti.i32"
            )
        self.dtype = resolved
        self.element_shape = element_shape
        self.role = role
        self.primal: Field | None = None
        self.needs_grad = self.needs_dual = False
        self._name = name
        self._companions: dict[str, Field] = {}
        self._place: Place | None = None

    # Names

    def suggest_name(self, name: str) -> None:
        """Takes the name of the variable that holds the field, if it has none yet."""
        if self._name is None:
            self._name = name

    @property
    def name(self) -> str:
        """What to call the field in messages."""
        if self.primal is not None:
            return f"{self.primal.name}.{self.role}"
        return self._name or "field"

    # Companions

    def _companion(self, which: str) -> Field | None:
        # A gradient has a dual: the derivative of the gradient.
        nests = self.role == "primal" or (self.role == "grad" and which == "dual")
        if not self.dtype.is_float or not nests:
            return None
        if which not in self._companions:
            made = self._make_companion(which)
            made.primal = self
            self._companions[which] = made
        return self._companions[which]

    @property
    def grad(self) -> Any:
        """The field that accumulates the derivative of the loss, or None for integers."""
        return self._companion("grad")

    @property
    def dual(self) -> Any:
        """The field of tangents of forward mode, or None for integers."""
        return self._companion("dual")

    def _make_companion(self, which: str) -> Field:
        raise NotImplementedError

    # Shape

    @property
    def level(self) -> SNode | None:
        raise NotImplementedError

    @property
    def shape(self) -> tuple[int, ...]:
        """The extents, in the order of the axes i, j, k, …"""
        node = self._placed_node()
        return node.shape

    def _placed_node(self) -> SNode:
        if self.level is None:
            if self.role == "grad":
                raise TaiAutodiffError(
                    f"field '{self.primal.name}' has no gradient",
                    "make it with needs_grad=True, or call ti.root.lazy_grad() after placing it",
                )
            if self.role == "dual":
                raise TaiAutodiffError(
                    f"field '{self.primal.name}' has no dual",
                    "make it with needs_dual=True, or call ti.root.lazy_dual() after placing it",
                )
            raise TaiRuntimeError(
                f"field '{self.name}' is not placed",
                "give it a shape, or place it: ti.root.dense(ti.i, n).place(x)",
            )
        return self.level

    @property
    def snode(self) -> Place | None:
        """The place of the field, below its level; None before it is placed."""
        if self.level is None:
            return None
        if self._place is None:
            self._place = Place(self)
        return self._place

    def parent(self, n: int = 1) -> SNode | None:
        """The level `n` levels above the field; for 0, its place."""
        self._placed_node()
        return self.snode.parent(n)

    @property
    def num_indices(self) -> int:
        return len(self.shape)

    # Whole-field operations

    def to_numpy(self, dtype: Any = None) -> np.ndarray:
        """A copy as an array of shape `shape + element_shape`."""
        raise NotImplementedError

    def from_numpy(self, array: Any) -> None:
        """Copies an array of shape `shape + element_shape` into the field."""
        raise NotImplementedError

    def fill(self, value: Any) -> None:
        """Sets all elements to `value`; of a sparse field, those that are active."""
        raise NotImplementedError

    def _check_array(self, array: Any) -> np.ndarray:
        array = np.asarray(array)
        wanted = self.shape + self.element_shape
        if array.shape != wanted:
            raise TaiRuntimeTypeError(
                f"field '{self.name}' expects an array of shape {wanted}, but got {array.shape}"
            )
        array = fitting.stored_array(array, self.dtype, self)
        return np.ascontiguousarray(array)

    def copy_from(self, other: Field) -> None:
        """Copies all elements of a field of the same shape; tapes and forward mode follow it."""
        if not isinstance(other, Field) or hasattr(other, "members"):
            raise TaiRuntimeTypeError(f"copy_from expects a field, but got {other!r}")
        if other is self:
            return
        if copies.is_followed(self, other):
            copies.copy_field(self, other)
        else:
            copies.check_shapes(self, other)
            self.from_numpy(other.to_numpy())

    def __str__(self) -> str:
        if self.level is None:
            return f"<field '{self.name}', not placed>"
        return str(self.to_numpy())

    def __repr__(self) -> str:
        kind = "field" if not self.element_shape else f"field of {self.element_shape}"
        place = "not placed" if self.level is None else f"shape {self.shape}"
        return f"<{self.dtype} {kind} '{self.name}', {place}>"

    def __iter__(self) -> Any:
        raise TaiRuntimeTypeError(
            "a field is iterated in kernels only", "use x.to_numpy() to loop over it in Python"
        )

    def __len__(self) -> int:
        return self.shape[0]


def _index_tuple(key: Any) -> tuple:
    if key is None:
        return ()
    if isinstance(key, tuple):
        return key
    if isinstance(key, (list, np.ndarray)) or hasattr(key, "to_numpy"):
        return tuple(key)
    return (key,)


class ScalarField(Field):
    """One number per element; also the storage of a vector field, as one place."""

    def __init__(
        self,
        dtype: Any,
        name: str | None = None,
        role: str = "primal",
        element_shape: tuple[int, ...] = (),
    ):
        super().__init__(dtype, element_shape, name, role)
        self._level: SNode | None = None
        self.offset: tuple[int, ...] = ()
        self.symbol: str | None = None
        self._core: Any = None
        self._tree_freed = False

    # Placement

    @property
    def level(self) -> SNode | None:
        return self._level

    @property
    def mlir_type(self) -> str:
        if not self.element_shape:
            return self.dtype.mlir
        return f"vector<{'x'.join(map(str, self.element_shape))}x{self.dtype.mlir}>"

    def put_into(self, node: SNode, offset: Any = None) -> None:
        """Becomes a place of the cells of `node`."""
        if self._level is not None:
            raise TaiRuntimeError(f"field '{self.name}' is placed already")
        self._level = node
        node.children.append(self)
        if offset is not None:
            rank = len(node.shape)
            values = offset if isinstance(offset, (tuple, list)) else (offset,) * rank
            if len(values) != rank:
                raise TaiRuntimeTypeError(
                    f"the offset has {len(values)} numbers, but the field has {rank} dimensions"
                )
            self.offset = tuple(int(v) for v in values)

    def place_missing_grad(self) -> None:
        """Places a gradient or dual that was asked for and not placed, beside the field."""
        for which, needed in (("grad", self.needs_grad), ("dual", self.needs_dual)):
            if needed:
                companion = self._companion(which)
                if companion is not None and companion.level is None:
                    companion.put_into(self._level, self.offset or None)
        placed = {which: f for which, f in self._companions.items() if f.level is not None}
        if self.role == "primal" and len(placed) == 2:
            # Both modes together give the derivative of the gradient.
            second = placed["grad"]._companion("dual")
            if second.level is None:
                second.put_into(placed["grad"].level, placed["grad"].offset or None)

    def _make_companion(self, which: str) -> ScalarField:
        return ScalarField(self.dtype, None, which, self.element_shape)

    def choose_symbol(self, program: Any) -> None:
        if self.symbol is not None:
            return
        if self.primal is not None:
            self.primal.choose_symbol(program)
            self.symbol = program.unique_symbol(f"{self.primal.symbol}_{self.role}")
        else:
            self.symbol = program.unique_symbol(self._name or "field")

    def declaration(self, tree: str) -> str:
        """The `tai.field` op of this field."""
        text = f'tai.field @{self.symbol} = @{tree}["{self.symbol}"] : {self.mlir_type}'
        text += f", rank {len(self._level.shape)}"
        for which, word in (("grad", "adjoint"), ("dual", "dual")):
            companion = self._companions.get(which)
            if companion is not None and companion.level is not None:
                companion.choose_symbol(get_program())
                text += f", {word} @{companion.symbol}"
        if any(self.offset):
            text += f", offset [{', '.join(map(str, self.offset))}]"
        return text

    def declare(self, program: Any, tree: str) -> None:
        """Makes the field known to the C++ context."""
        self._core = program.context.add_field(self.declaration(tree))
        program.fields[self.symbol] = self

    def forget(self) -> None:
        """The tree is freed."""
        self._core = None
        self._tree_freed = True

    def release(self) -> None:
        """The program is over."""
        self._core = None

    @property
    def core(self) -> Any:
        """The field in C++; allocates its tree at the first use."""
        if self._core is None:
            self.materialize(sys._getframe(1))
        return self._core

    def materialize(self, frame: Any = None) -> None:
        """Allocates the tree of the field.

        Raises:
            TaiRuntimeError: it is not placed, or it belongs to an earlier `ti.init`.
        """
        if self._core is not None:
            return
        node = self._placed_node()
        while frame is not None and frame.f_globals.get("__name__", "").startswith("tai."):
            frame = frame.f_back
        if frame is not None:
            name_fields(frame.f_globals)
        program = get_program()
        root = node.root_node
        if self._tree_freed:
            raise TaiRuntimeError(f"the tree of field '{self.name}' has been destroyed and freed")
        if root.refused is not None:
            raise TaiRuntimeError(
                f"field '{self.name}' is not there, as its tree was refused: {root.refused}"
            )
        if root.allocator is not None and root.allocator is not state.thread:
            root.ready.wait()
        if root is program.root:
            program.materialize()
        elif not root.allocated:
            if any(root is r for r in (program.root,)):
                return
            raise TaiRuntimeError(
                f"field '{self.name}' belongs to a tree that is not in use",
                "make fields after ti.init, and finalize() a FieldsBuilder before using its fields",
            )
        if self._core is None:
            raise TaiRuntimeError(
                f"field '{self.name}' was made before the last ti.init and is gone",
                "make fields after ti.init",
            )

    def is_current(self) -> bool:
        """Whether the field is one of the program that runs now."""
        program = state.program
        return program is not None and program.fields.get(self.symbol) is self

    def storage(self) -> tuple[ScalarField, int]:
        """The place that holds the field, and the component in it that comes first."""
        return self, 0

    # Elements

    def __getitem__(self, key: Any) -> Any:
        if state.tape is not None or state.forward:
            origins.note_read(self)
        try:
            value = self.core.get(_index_tuple(key), 0)
        except (IndexError, TypeError) as error:
            raise self._index_error(error, key) from None
        return value if self.dtype.is_float else self._to_python(value)

    def __setitem__(self, key: Any, value: Any) -> None:
        self.set_component(key, 0, value)

    def get_component(self, key: Any, component: int) -> Any:
        try:
            value = self.core.get(_index_tuple(key), component)
        except (IndexError, TypeError) as error:
            raise self._index_error(error, key) from None
        return value if self.dtype.is_float else self._to_python(value)

    def set_component(self, key: Any, component: int, value: Any) -> None:
        if state.tape is not None or state.forward:
            origins.check_write(self, value)
        if not isinstance(value, (int, float)):
            if isinstance(value, str) or not hasattr(value, "__float__"):
                raise TaiRuntimeTypeError(
                    f"field '{self.name}' holds numbers of type {self.dtype}, not {value!r}"
                )
            value = value.item() if hasattr(value, "item") else float(value)
        if not self.dtype.is_float:
            value = fitting.stored(value, self.dtype, self)
        try:
            self.core.set(_index_tuple(key), component, value)
        except (IndexError, TypeError) as error:
            raise self._index_error(error, key) from None
        dual = origins.dual_of_written(self) if state.forward else None
        if dual is not None:
            dual.set(_index_tuple(key), component, 0.0)

    def _to_python(self, value: int) -> int | bool:
        if self.dtype.kind == "u":
            return value & ((1 << self.dtype.bits) - 1)
        return bool(value) if self.dtype.is_bool else value

    def _index_error(self, error: Exception, key: Any = None) -> TaiError:
        return fitting.index_error(self.name, key, error)

    # Whole field

    def to_numpy(self, dtype: Any = None) -> np.ndarray:
        if state.tape is not None or state.forward:
            origins.note_read(self)
        core = self.core
        array = np.empty(self.shape + self.element_shape, self.dtype.numpy)
        core.copy_to(array)
        wanted = None if dtype is None else dtypes.to_dtype(dtype)
        return array if wanted is None else array.astype(wanted.numpy)

    def from_numpy(self, array: Any) -> None:
        if state.tape is not None or state.forward:
            origins.check_write(self, array)
        self.core.copy_from(self._check_array(array))
        origins.end_tangent(self)

    def fill(self, value: Any) -> None:
        if not isinstance(value, (int, float)) and not hasattr(value, "__float__"):
            raise TaiRuntimeTypeError(
                f"field '{self.name}' is filled by a number of type {self.dtype}, not {value!r}"
            )
        if state.tape is not None or state.forward:
            origins.check_write(self, value)
        stored = float(value) if self.dtype.is_float else value
        self.core.fill(fitting.stored(stored, self.dtype, self))
        origins.end_tangent(self)


class ComponentField(ScalarField):
    """One component of a vector or matrix field.

    Placing it makes the components of that field separate arrays. Otherwise it is a
    window on the place that the whole field has.
    """

    def __init__(self, whole: Any, index: int, indices: tuple[int, ...]):
        super().__init__(whole.dtype, None, whole.role)
        self._whole, self._index, self._indices = whole, index, indices

    @property
    def name(self) -> str:
        return f"{self._whole.name}[{', '.join(map(str, self._indices))}]"

    def choose_symbol(self, program: Any) -> None:
        if self.symbol is None:
            base = self._whole._base_symbol(program)
            self.symbol = program.unique_symbol("_".join([base, *map(str, self._indices)]))

    def put_into(self, node: SNode, offset: Any = None) -> None:
        if self._whole._single is not None:
            raise TaiRuntimeError(f"field '{self._whole.name}' is placed already")
        super().put_into(node, offset)

    def _companion(self, which: str) -> Any:
        whole = self._whole._companion(which)
        return None if whole is None else whole.components[self._index]

    @property
    def _companions(self) -> dict[str, Any]:
        made = self._whole._companions
        return {which: whole.components[self._index] for which, whole in made.items()}

    @_companions.setter
    def _companions(self, value: Any) -> None:
        pass

    @property
    def needs_grad(self) -> bool:
        return self._whole.needs_grad

    @needs_grad.setter
    def needs_grad(self, value: bool) -> None:
        pass

    @property
    def level(self) -> SNode | None:
        single = self._whole._single
        return single.level if single is not None else self._level

    @property
    def is_window(self) -> bool:
        return self._whole._single is not None

    def storage(self) -> tuple[ScalarField, int]:
        return (self._whole._single, self._index) if self.is_window else (self, 0)

    def __getitem__(self, key: Any) -> Any:
        if self.is_window:
            return self._whole._single.get_component(key, self._index)
        return super().__getitem__(key)

    def __setitem__(self, key: Any, value: Any) -> None:
        if self.is_window:
            self._whole._single.set_component(key, self._index, value)
        else:
            super().__setitem__(key, value)

    def to_numpy(self, dtype: Any = None) -> np.ndarray:
        if not self.is_window:
            return super().to_numpy(dtype)
        array = self._whole.to_numpy(dtype)[(..., *self._indices)]
        return np.array(array, order="C")

    def from_numpy(self, array: Any) -> None:
        if not self.is_window:
            return super().from_numpy(array)
        if copies.store_component(self, self._check_array(array)):
            return None
        whole = self._whole.to_numpy()
        whole[(..., *self._indices)] = self._check_array(array)
        self._whole.from_numpy(whole)

    def fill(self, value: Any) -> None:
        if not self.is_window:
            return super().fill(value)
        if copies.store_component(self, value):
            return None
        if not active.fill_component(self._whole._single, self._index, value):
            self.from_numpy(np.full(self.shape, value, self.dtype.numpy))


class MatrixField(Field):
    """A small vector or matrix per element.

    It is stored as one place, unless its components were placed one by one
    (`get_scalar_field`) or it was made with `layout=ti.Layout.SOA`.
    """

    def __init__(
        self, element_shape: tuple[int, ...], dtype: Any, name: str | None = None,
        role: str = "primal",
    ):  # fmt: skip
        super().__init__(dtype, element_shape, name, role)
        self._single: ScalarField | None = None
        self._components: list[ComponentField] | None = None
        self._symbol_base: str | None = None

    @property
    def n(self) -> int:
        return self.element_shape[0]

    @property
    def m(self) -> int:
        return self.element_shape[1] if len(self.element_shape) == 2 else 1

    @property
    def ndim(self) -> int:
        return len(self.element_shape)

    def _make_companion(self, which: str) -> MatrixField:
        return MatrixField(self.element_shape, self.dtype, None, which)

    def _base_symbol(self, program: Any) -> str:
        if self._symbol_base is None:
            if self.primal is not None:
                self._symbol_base = f"{self.primal._base_symbol(program)}_{self.role}"
            else:
                self._symbol_base = self._name or "field"
        return self._symbol_base

    @property
    def components(self) -> list[ComponentField]:
        if self._components is None:
            self._components = [
                ComponentField(self, number, indices)
                for number, indices in enumerate(np.ndindex(*self.element_shape))
            ]
        return self._components

    def get_scalar_field(self, *indices: int) -> ComponentField:
        """The field of one component, to read, to write, or to place by itself."""
        if len(indices) == 2 and self.ndim == 1 and indices[1] == 0:
            indices = indices[:1]
        if len(indices) != self.ndim or any(
            not 0 <= i < n for i, n in zip(indices, self.element_shape, strict=True)
        ):
            raise TaiIndexError(
                f"field '{self.name}' has elements of shape {self.element_shape}: "
                f"there is no component {indices}"
            )
        return self.components[int(np.ravel_multi_index(indices, self.element_shape))]

    @property
    def is_split(self) -> bool:
        """Whether each component is an array of its own."""
        return self._single is None and any(c._level is not None for c in self._components or ())

    @property
    def single(self) -> ScalarField | None:
        """The place that holds whole elements, or None where the components are separate."""
        return self._single

    @property
    def level(self) -> SNode | None:
        if self._single is not None:
            return self._single.level
        if self._components and all(c._level is not None for c in self._components):
            return self._components[0]._level
        return None

    def put_into(self, node: SNode, offset: Any = None) -> None:
        if self._single is not None or self.is_split:
            raise TaiRuntimeError(f"field '{self.name}' is placed already")
        primal = self.primal
        if primal is not None and primal.is_split:
            # A gradient is stored as its field is: one array for each component.
            for component in self.components:
                component.put_into(node, offset)
            return
        from .whole import WholeElements

        self._single = WholeElements(self)
        self._single.put_into(node, offset)

    def materialize(self, frame: Any = None) -> None:
        """Allocates the tree of the field."""
        self._placed_node()
        for part in self.parts:
            part.materialize(frame)

    @property
    def parts(self) -> list[ScalarField]:
        """The places that hold the field: one, or one for each component."""
        return [self._single] if self._single is not None else list(self.components)

    @property
    def offset(self) -> tuple[int, ...]:
        return self.parts[0].offset

    def storage(self) -> tuple[ScalarField, int]:
        return self.parts[0], 0

    # Elements

    def __getitem__(self, key: Any) -> Any:
        from ..values.matrix import ElementOfField

        if state.tape is not None or state.forward:
            origins.note_read(self)
        self._placed_node()
        return ElementOfField(self, _index_tuple(key))

    def read(self, key: tuple) -> np.ndarray:
        """The components of one element."""
        if self._single is not None:
            try:
                values = self._single.core.get_all(key)
            except (IndexError, TypeError) as error:
                raise self._single._index_error(error, key) from None
            if not self.dtype.is_float:
                values = [self._single._to_python(v) for v in values]
        else:
            values = [component[key] for component in self.components]
        return np.array(values, self.dtype.numpy).reshape(self.element_shape)

    def write(self, key: tuple, component: int, value: Any) -> None:
        """Sets one component of one element."""
        if self._single is not None:
            self._single.set_component(key, component, value)
        else:
            self.components[component][key] = value

    def __setitem__(self, key: Any, value: Any) -> None:
        if state.tape is not None or state.forward:
            origins.check_write(self, value)
        self._placed_node()
        values = np.asarray(value.to_numpy() if hasattr(value, "to_numpy") else value)
        if values.ndim == 0:
            values = np.full(self.element_shape, values)
        if values.dtype.kind not in "biuf":
            raise TaiRuntimeTypeError(
                f"field '{self.name}' holds numbers of type {self.dtype}, not {value!r}"
            )
        if values.shape != self.element_shape:
            raise TaiRuntimeTypeError(
                f"an element of field '{self.name}' has shape {self.element_shape}, "
                f"but got {values.shape}"
            )
        at = _index_tuple(key)
        numbers = values.ravel().tolist()
        if not self.dtype.is_float:
            numbers = [fitting.stored(number, self.dtype, self) for number in numbers]
        if self._single is None:
            for component, number in zip(self.components, numbers, strict=True):
                component[at] = number
            return
        try:
            self._single.core.set_all(at, numbers)
        except (IndexError, TypeError) as error:
            raise self._single._index_error(error, key) from None
        dual = origins.dual_of_written(self._single) if state.forward else None
        if dual is not None:
            dual.set_all(at, [0.0] * len(numbers))

    # Whole field

    def to_numpy(self, keep_dims: bool = False, dtype: Any = None) -> np.ndarray:
        """A copy as an array of shape `shape + element_shape`."""
        self._placed_node()
        if self._single is not None:
            array = self._single.to_numpy(dtype)
        else:
            parts = [component.to_numpy(dtype) for component in self.components]
            array = np.stack(parts, axis=-1).reshape(self.shape + self.element_shape)
        return array[..., None] if keep_dims and self.ndim == 1 else array

    def from_numpy(self, array: Any) -> None:
        array = np.asarray(array)
        if self.ndim == 1 and array.shape == (*self.shape, self.n, 1):
            array = array[..., 0]
        array = self._check_array(array)
        if self._single is not None:
            self._single.from_numpy(array)
            return
        for component in self.components:
            component.from_numpy(np.array(array[(..., *component._indices)]))

    def fill(self, value: Any) -> None:
        active.fill_matrices(self, value)


def make_field(
    element_shape: tuple[int, ...],
    dtype: Any,
    shape: Any,
    order: str | None,
    name: str | None,
    offset: Any,
    needs_grad: bool,
    needs_dual: bool,
    layout: str = Layout.AOS,
) -> Field:
    """A field, placed under `ti.root` if it has a shape."""
    made: Any
    if element_shape:
        made = MatrixField(element_shape, dtype, name)
    else:
        made = ScalarField(dtype, name)
    if (needs_grad or needs_dual) and not made.dtype.is_float:
        raise TaiAutodiffError(
            f"a field of type {made.dtype} can have no gradient",
            "needs_grad=True goes with a float type such as ti.f32",
        )
    made.needs_grad, made.needs_dual = bool(needs_grad), bool(needs_dual)
    if shape is None:
        if offset is not None:
            raise TaiRuntimeTypeError("offset needs a shape", "or give it to place(x, offset=…)")
        if order is not None:
            raise TaiRuntimeTypeError("order needs a shape")
        return made
    shape = to_shape(shape)
    axes = to_order(order, len(shape))
    extents = tuple(shape[a] for a in axes)

    program = get_program()

    def put(field: Any) -> None:
        root = program.root
        if layout == Layout.SOA and element_shape:
            for component in field.components:
                node = root.dense(axes, extents) if shape else root
                node.place(component, offset=offset)
        else:
            node = root.dense(axes, extents) if shape else root
            node.place(field, offset=offset)

    with program.layout:
        put(made)
        if needs_grad:
            put(made.grad)
        if needs_dual:
            put(made.dual)
    return made


def field(
    dtype: Any,
    shape: Any = None,
    order: str | None = None,
    name: str | None = "",
    offset: Any = None,
    needs_grad: bool = False,
    needs_dual: bool = False,
) -> ScalarField:
    """A field of numbers.

    Args:
        dtype: `ti.f32`, `ti.i32`, …, `int` or `float`.
        shape: extents; without it the field is placed by hand: `ti.root.dense(…).place(x)`.
        order: layout order of the axes, such as `"ji"`, slowest first.
        name: what to call the field in messages and IR.
        offset: the first index along each dimension.
        needs_grad, needs_dual: place a gradient, a tangent.
    """
    return make_field((), dtype, shape, order, name or None, offset, needs_grad, needs_dual)
