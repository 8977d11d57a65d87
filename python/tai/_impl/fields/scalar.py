"""Scalar fields, and the components of vector fields: the leaves of the runtime's trees."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from ...errors import TaiError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import dtypes, fitting, pieces, state
from ..base.elements import is_number
from ..base.keywords import check_keywords
from ..base.program import get_program
from ..history import origins
from . import active, copies
from .field import Field, index_tuple
from .root import materialize, name_fields
from .shard_rows import own_part, put_own
from .snode import SNode


class ScalarField(Field):
    """A field of one number per element; also the storage of a vector field whose elements are
    stored whole.
    """

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
        # The mesh that shares the field, and the dimension whose rows it divides.
        self._sharded: Any = None

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
        """Makes the field a place of the cells of `node`."""
        if self._level is not None:
            raise TaiRuntimeError(f"field '{self.name}' is placed already")
        if offset is not None:
            rank = len(node.shape)
            values = fitting.listed(offset)
            values = values if len(values) != 1 else tuple(values) * rank
            if len(values) != rank:
                raise TaiRuntimeTypeError(
                    f"the offset has {len(values)} numbers, but the field has {rank} dimensions"
                )
            self.offset = fitting.offsets(values, self)
        self._level = node
        node.children.append(self)

    def place_missing_grad(self) -> None:
        """Places a gradient or dual that was requested but not placed, beside its field."""
        for which, needed in (("grad", self.needs_grad), ("dual", self.needs_dual)):
            if needed:
                companion = self._companion(which)
                if companion is not None and companion.level is None:
                    companion.put_into(self._placed_node(), self.offset or None)
        placed = {which: f for which, f in self._companions.items() if f.level is not None}
        if self.role == "primal" and len(placed) == 2:
            # Reverse mode in forward mode needs this place: the derivative of the gradient.
            first = placed["grad"]
            second = first._companion("dual")
            if second is not None and second.level is None:
                second.put_into(first._placed_node(), first.offset or None)

    def _make_companion(self, which: str) -> ScalarField:
        dt = dtypes.gradient_of(self.dtype) if which == "grad" else self.dtype
        return ScalarField(dt, None, which, self.element_shape)

    def choose_symbol(self, program: Any) -> None:
        if self.symbol is not None:
            return
        if self.primal is not None:
            assert isinstance(self.primal, ScalarField)
            self.primal.choose_symbol(program)
            self.symbol = program.unique_symbol(f"{self.primal.symbol}_{self.role}")
        else:
            self.symbol = program.unique_symbol(self._name or "field")

    def declaration(self, tree: str) -> str:
        """Returns the text of the `tai.field` op that declares this field."""
        text = f'tai.field @{self.symbol} = @{tree}["{self.symbol}"] : {self.mlir_type}'
        text += f", rank {len(self._placed_node().shape)}"
        for which, word in (("grad", "adjoint"), ("dual", "dual")):
            companion = self._companions.get(which)
            if companion is not None and companion.level is not None:
                assert isinstance(companion, ScalarField)
                companion.choose_symbol(get_program())
                text += f", {word} @{companion.symbol}"
        if any(self.offset):
            text += f", offset [{', '.join(map(str, self.offset))}]"
        return text

    def declare(self, program: Any, tree: str) -> None:
        """Declares the field in the C++ context."""
        self._core = program.context.add_field(self.declaration(tree))
        program.fields[self.symbol] = self
        shard = self._placed_node().above_shard()
        if shard is not None:
            dimension = list(self._placed_node().axis_extents()).index(shard.shard_axis)
            self._sharded = (program.options.mesh, dimension)

    def forget(self) -> None:
        """The tree is freed."""
        self._core = None
        self._tree_freed = True

    def release(self) -> None:
        """The program is over."""
        self._core = None

    @property
    def core(self) -> Any:
        """The field as a C++ object; the first use allocates its tree."""
        if self._core is None:
            self.materialize(sys._getframe(1))
        return self._core

    def materialize(self, frame: Any = None) -> None:
        """Allocates the tree that holds the field.

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
        if root is program.root or any(root is other for other in program.laid_out):
            # If another thread is laying out the tree, this call waits for that thread.
            materialize(program)
        elif not root.allocated:
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
        """Whether the field belongs to the current program, made by the last `ti.init`."""
        program = state.program
        return program is not None and program.fields.get(self.symbol) is self

    def storage(self) -> tuple[ScalarField, int]:
        """The storage place of the field, and the number of its first component there."""
        return self, 0

    # Elements

    def __getitem__(self, key: Any) -> Any:
        value = self.get_component(key, 0)
        if state.tape is not None or state.forward:
            return origins.note_number(self, value)
        return value

    def from_owner(self, key: Any, values: Any) -> Any:
        """The numbers of an element of a sharded field that its owner has."""
        mesh, dimension = self._sharded
        first = self.offset[dimension] if self.offset else 0
        row = int(index_tuple(key)[dimension]) - first
        return mesh.from_owner(row, self.shape[dimension], values, self.name)

    def __setitem__(self, key: Any, value: Any) -> None:
        self.set_component(key, 0, value)

    def get_component(self, key: Any, component: int) -> Any:
        try:
            value = self.core.get(index_tuple(key), component)
        except (IndexError, TypeError, OverflowError) as error:
            raise self._index_error(error, key) from None
        if self._sharded is not None:
            value = self.from_owner(key, value)
        return value if self.dtype.is_float else self._to_python(value)

    def set_component(self, key: Any, component: int, value: Any) -> None:
        if state.tape is not None or state.forward:
            origins.check_write(self, value)
        if not isinstance(value, (int, float)):
            if not is_number(value):
                raise TaiRuntimeTypeError(
                    f"field '{self.name}' holds numbers of type {self.dtype}, not {value!r}"
                )
            value = fitting.one_number(value, self)
        if not self.dtype.is_float:
            value = fitting.stored(value, self.dtype, self)
        try:
            self.core.set(index_tuple(key), component, value)
        except (IndexError, TypeError, OverflowError) as error:
            fitting.check_float(value, self.dtype, self)
            raise self._index_error(error, key) from None
        dual = origins.dual_of_written(self) if state.forward else None
        if dual is not None:
            dual.set(index_tuple(key), component, 0.0)

    def _to_python(self, value: int) -> int | bool:
        if self.dtype.kind == "u":
            return value & ((1 << self.dtype.bits) - 1)
        return bool(value) if self.dtype.is_bool else value

    def _index_error(self, error: Exception, key: Any = None) -> TaiError:
        found = fitting.index_error(self.name, key, error)
        is_list = self.level is not None and self.level.kind == "dynamic"
        if is_list and len(index_tuple(key)) == len(self.shape) - 1:
            found.hint = (
                f"{self.name}[i] is a list: kernels have {self.name}[i].append(value) and "
                f"{self.name}[i].length(); Python reads and writes single elements"
            )
        return found

    # Whole field

    def to_numpy(self, dtype: Any = None) -> np.ndarray:
        if state.tape is not None or state.forward:
            origins.note_read(self)
        core = self.core
        array = np.empty(self.shape + self.element_shape, self.dtype.numpy)
        core.copy_to(array)
        if self._sharded is not None:
            mesh, dimension = self._sharded
            mesh.gather_rows(array, dimension, self.name)
        wanted = None if dtype is None else dtypes.to_dtype(dtype)
        return array if wanted is None else pieces.row_major(array, wanted.numpy)

    def from_numpy(self, array: Any) -> None:
        if state.tape is not None or state.forward:
            origins.check_write(self, array)
        core, given = self.core, self._check_array(array)
        if self._sharded is None or not put_own(self, own_part(self, given)):
            core.copy_from(given)
        origins.end_tangent(self)

    def fill(self, value: Any) -> None:
        if np.ndim(value) and np.shape(value) == self.shape:
            self.from_numpy(value)
            return
        if isinstance(value, np.ndarray) and value.ndim and value.dtype.kind in "biuf":
            raise TaiRuntimeTypeError(
                f"field '{self.name}' has shape {self.shape}, but the array that fills it "
                f"{value.shape}",
                "fill it with a number, or with an array of its shape",
            )
        if np.ndim(value) or (not isinstance(value, (int, float)) and not is_number(value)):
            raise TaiRuntimeTypeError(
                f"field '{self.name}' is filled by a number of type {self.dtype}, not {value!r}"
            )
        if state.tape is not None or state.forward:
            origins.check_write(self, value)
        fitting.check_float(value, self.dtype, self)
        stored = float(value) if self.dtype.is_float else value
        self.core.fill(fitting.stored(stored, self.dtype, self))
        origins.end_tangent(self)


class ComponentField(ScalarField):
    """The field of one component of a vector or matrix field.

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

    def materialize(self, frame: Any = None) -> None:
        if self._whole._single is None:
            return super().materialize(frame)
        self._whole.materialize(frame)
        raise TaiRuntimeError(
            f"'{self.name}' is no field by itself: elements of '{self._whole.name}' are stored as "
            "a whole",
            f"give the whole field, or make '{self._whole.name}' with layout=ti.Layout.SOA",
        )

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
        return pieces.copied(self._whole.to_numpy(dtype)[(..., *self._indices)])

    def from_numpy(self, array: Any) -> None:
        if not self.is_window:
            return super().from_numpy(array)
        if copies.store_component(self, self._check_array(array)):
            return None
        whole = self._whole.to_numpy()
        pieces.copy(whole[(..., *self._indices)], self._check_array(array))
        self._whole.from_numpy(whole)

    def fill(self, value: Any) -> None:
        if not self.is_window:
            return super().fill(value)
        if copies.store_component(self, value):
            return None
        if not active.fill_component(self._whole._single, self._index, value):
            self.from_numpy(np.full(self.shape, value, self.dtype.numpy))


check_keywords(globals(), ["ScalarField"], attributes=False)
