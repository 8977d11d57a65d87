"""Fields of small vectors and matrices."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiIndexError, TaiRuntimeError, TaiRuntimeTypeError
from ..base import dtypes, fitting, pieces, state
from ..base.keywords import check_keywords
from ..history import origins
from ..values.matrix import ElementOfField
from . import active
from .field import Field, index_tuple
from .scalar import ComponentField, ScalarField
from .snode import SNode
from .whole import WholeElements


class MatrixField(Field):
    """A field with a small vector or matrix in each element.

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
        dt = dtypes.gradient_of(self.dtype) if which == "grad" else self.dtype
        return MatrixField(self.element_shape, dt, None, which)

    def _base_symbol(self, program: Any) -> str:
        if self._symbol_base is None:
            if isinstance(self.primal, MatrixField):
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
        """The field of one component of a vector or matrix field, to read, to write, or to place
        separately.
        """
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
        """Whether each component of the field is stored as an array of its own."""
        return self._single is None and any(c._level is not None for c in self._components or ())

    @property
    def single(self) -> ScalarField | None:
        """The storage place of whole elements, or None if the components are stored separately."""
        return self._single

    @property
    def level(self) -> SNode | None:
        if self._single is not None:
            return self._single.level
        if self._components and all(c._level is not None for c in self._components):
            return self._components[0]._level
        return None

    def put_into(self, node: SNode, offset: Any = None) -> None:
        primal = self.primal
        splits = isinstance(primal, MatrixField) and primal.is_split
        if self.level is not None or (self.is_split and not splits):
            raise TaiRuntimeError(f"field '{self.name}' is placed already")
        # Ctrl-C may have interrupted an earlier call when half of this was done.
        if splits:
            # The gradient is stored in the same way as the field: an array for each component.
            for component in self.components:
                if component._level is None:
                    component.put_into(node, offset)
            return
        if self._single is None:
            self._single = WholeElements(self)
        self._single.put_into(node, offset)

    def materialize(self, frame: Any = None) -> None:
        """Allocates the tree that holds the field."""
        self._placed_node()
        for part in self.parts:
            part.materialize(frame)

    @property
    def parts(self) -> list[ScalarField]:
        """The storage places of the field: a single one, or one for each component."""
        return [self._single] if self._single is not None else list(self.components)

    @property
    def offset(self) -> tuple[int, ...]:
        return self.parts[0].offset

    def storage(self) -> tuple[ScalarField, int]:
        return self.parts[0], 0

    # Elements

    def __getitem__(self, key: Any) -> Any:
        if state.tape is not None or state.forward:
            origins.note_read(self)
        self._placed_node()
        return ElementOfField(self, index_tuple(key))

    def read(self, key: tuple) -> np.ndarray:
        """Returns the components of one element."""
        if self._single is not None:
            try:
                values = self._single.core.get_all(key)
            except (IndexError, TypeError, OverflowError) as error:
                raise self._single._index_error(error, key) from None
            if self._single._sharded is not None:
                values = self._single.from_owner(key, values)
            if not self.dtype.is_float:
                values = [self._single._to_python(v) for v in values]
        else:
            values = [component[key] for component in self.components]
        return np.array(values, self.dtype.numpy).reshape(self.element_shape)

    def write(self, key: tuple, component: int, value: Any) -> None:
        """Sets one component of one element of the field."""
        if self._single is not None:
            self._single.set_component(key, component, value)
        else:
            self.components[component][key] = value

    def __setitem__(self, key: Any, value: Any) -> None:
        if state.tape is not None or state.forward:
            origins.check_write(self, value)
        self._placed_node()
        values = fitting.unmasked(value.to_numpy() if hasattr(value, "to_numpy") else value)
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
        at = index_tuple(key)
        numbers = values.ravel().tolist()
        if not self.dtype.is_float:
            numbers = [fitting.stored(number, self.dtype, self) for number in numbers]
        if self._single is None:
            for component, number in zip(self.components, numbers, strict=True):
                component[at] = number
            return
        try:
            self._single.core.set_all(at, numbers)
        except (IndexError, TypeError, OverflowError) as error:
            raise self._single._index_error(error, key) from None
        dual = origins.dual_of_written(self._single) if state.forward else None
        if dual is not None:
            dual.set_all(at, [0.0] * len(numbers))

    # Whole field

    def to_numpy(  # type: ignore[override]
        self, keep_dims: bool = False, dtype: Any = None
    ) -> np.ndarray:
        """Returns a copy as an array of shape `shape + element_shape`.

        Args:
            keep_dims: give elements of one column, vectors too, a dimension of 1 for it.
            dtype: of the array, if not that of the field.
        """
        self._placed_node()
        if self._single is not None:
            array = self._single.to_numpy(dtype)
        else:
            parts = [component.to_numpy(dtype) for component in self.components]
            array = np.empty((*self.shape, len(parts)), parts[0].dtype)
            for number, part in enumerate(parts):
                pieces.copy(array[..., number], part)
            array = array.reshape(self.shape + self.element_shape)
        if self.m > 1:
            return array
        return array.reshape(*self.shape, self.n, *([1] if keep_dims else []))

    def from_numpy(self, array: Any) -> None:
        array = fitting.unmasked(array)
        if self.m == 1 and array.shape in ((*self.shape, self.n), (*self.shape, self.n, 1)):
            array = array.reshape(self.shape + self.element_shape)
        array = self._check_array(array)
        if self._single is not None:
            self._single.from_numpy(array)
            return
        for component in self.components:
            component.from_numpy(pieces.copied(array[(..., *component._indices)]))

    def fill(self, value: Any) -> None:
        self._placed_node()
        active.fill_matrices(self, value)


check_keywords(globals(), ["MatrixField"], attributes=False)
