"""Annotations of parameters, and small vector and matrix types: most of `ti.types`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError, TaiTypeError
from ..base import dtypes
from .matrix import Matrix, Vector


class template:  # noqa: N801
    """Annotates a parameter that is part of the compiled code: a field, a function, a constant.

    A kernel is compiled for each value. In a `ti.func`, variables are passed by reference.
    """

    def __init__(self, tensor: Any = None, dim: Any = None):
        pass

    def __repr__(self) -> str:
        return "ti.template()"


class MatrixType:
    """The type of n×m matrices, or of vectors of n components (`m` is None).

    Called, it makes one: `vec3(x, y, z)`, `vec3(0.0)`, `vec3(v.xy, 1)`.
    """

    def __init__(self, n: int, m: int | None, dtype: Any):
        self.n, self.columns, self._dtype = n, m, dtype
        if dtypes.to_dtype(dtype) is None:
            raise TaiRuntimeTypeError(f"{dtype!r} is not a type of numbers")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MatrixType) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple:
        return self.n, self.columns, self._dtype

    @property
    def m(self) -> int:
        return 1 if self.columns is None else self.columns

    @property
    def dtype(self) -> dtypes.DataType:
        found = dtypes.to_dtype(self._dtype)
        assert found is not None
        return found

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.n,) if self.columns is None else (self.n, self.columns)

    def __call__(self, *parts: Any) -> Any:
        items: list[Any] = []
        for part in parts:
            if getattr(part, "is_matrix", False):
                shape = part.shape if hasattr(part, "emit_operand") else part.element_shape
                items += list(part) if len(shape) == 1 else [x for row in part for x in row]
            elif isinstance(part, np.ndarray):
                items += part.ravel().tolist()
            elif isinstance(part, (list, tuple)):
                for item in part:
                    nested = isinstance(item, (list, tuple)) or getattr(item, "is_matrix", False)
                    items += list(item) if nested else [item]
            else:
                items.append(part)
        count = self.n * self.m
        if len(items) == 1:
            items *= count
        if len(items) != count:
            raise TaiTypeError(f"{self!r} takes {count} numbers, but got {len(items)}")
        if self.columns is None:
            return Vector(items, self.dtype)
        rows = [items[r * self.columns : (r + 1) * self.columns] for r in range(self.n)]
        return Matrix(rows, self.dtype)

    def field(self, shape: Any = None, **options: Any) -> Any:
        """Makes a field of such elements; for the arguments see `ti.field`."""
        if self.columns is None:
            return Vector.field(self.n, self.dtype, shape, **options)
        return Matrix.field(self.n, self.columns, self.dtype, shape, **options)

    def ndarray(self, shape: Any, needs_grad: bool = False) -> Any:
        """Makes an array of such elements; see `ti.ndarray`."""
        if self.columns is None:
            return Vector.ndarray(self.n, self.dtype, shape, needs_grad)
        return Matrix.ndarray(self.n, self.columns, self.dtype, shape, needs_grad)

    def convert(self, emitter: Any, value: Any) -> Any:
        """Converts a value of a kernel to this type."""
        value = emitter.as_value(value)
        if value.shape != self.shape:
            raise TaiTypeError(f"expects {self!r}, but got a {value.kind_name}")
        return emitter.cast(value, self.dtype)

    def __repr__(self) -> str:
        if self.columns is None:
            return f"vector({self.n}, {self.dtype})"
        return f"matrix({self.n}, {self.columns}, {self.dtype})"


class ScalarType:
    """Wraps a scalar type for places that expect a type with `convert`."""

    shape: tuple[int, ...] = ()

    def __init__(self, dtype: Any):
        self._dtype = dtype

    @property
    def dtype(self) -> dtypes.DataType:
        found = dtypes.to_dtype(self._dtype)
        assert found is not None
        return found

    def convert(self, emitter: Any, value: Any) -> Any:
        """Converts a value of a kernel to this type."""
        emitter.check_fraction(
            value, self.dtype, f"a result, parameter or member of type {self.dtype}"
        )
        if not hasattr(value, "emit_operand"):
            if isinstance(value, (bool, int, float)):
                return emitter.constant(value, self.dtype)
            value = emitter.as_value(value)
        if value.shape:
            raise TaiTypeError(
                f"expects a number of type {self.dtype}, but got a {value.kind_name}"
            )
        return emitter.cast(value, self.dtype)


class NdarrayType:
    """Annotates an array that the caller owns: a NumPy array, a torch tensor, a `ti.ndarray`.

    Args:
        dtype: type of the numbers, or a vector or matrix type; any if left out.
        ndim: number of dimensions without those of the element; any if left out.
        element_dim: 1 or 2: the last dimensions are vectors or matrices.
        element_shape: the extents of the element.
        needs_grad: True refuses a `ti.ndarray` without a gradient; False takes the array for a
            constant, also one that has a gradient. Without either, an array that has a gradient
            is differentiated. A NumPy array is always constant.
        boundary: with `"clamp"` an index that leaves the array is moved to the nearest one of it.
            `"unsafe"` leaves such indices to the checks of the context.
    """

    def __init__(
        self, dtype: Any = None, ndim: int | None = None, element_dim: int | None = None,
        element_shape: tuple[int, ...] | None = None, field_dim: int | None = None,
        needs_grad: bool | None = None, boundary: str = "unsafe",
    ):  # fmt: skip
        self.ndim = ndim if ndim is not None else field_dim
        self.element_shape = element_shape
        self.element_dim = element_dim
        self.needs_grad = needs_grad
        if isinstance(dtype, MatrixType):
            self.element_shape, dtype = dtype.shape, dtype.dtype
        if self.element_shape is not None:
            self.element_dim = len(self.element_shape)
        if boundary not in ("unsafe", "clamp"):
            raise TaiRuntimeTypeError(f"boundary is 'unsafe' or 'clamp', but got {boundary!r}")
        self.boundary = boundary
        self._dtype = dtype
        if dtype is not None and dtypes.to_dtype(dtype) is None:
            raise TaiRuntimeTypeError(f"{dtype!r} is not a type of numbers")

    if TYPE_CHECKING:  # the parameter in the body of a kernel
        shape: Any
        grad: Any

        def __getitem__(self, key: Any) -> Any: ...
        def __setitem__(self, key: Any, value: Any) -> None: ...
        def __iter__(self) -> Any: ...

    def __repr__(self) -> str:
        given = {"dtype": self._dtype, "ndim": self.ndim, "element_shape": self.element_shape}
        words = (f"{name}={value!r}" for name, value in given.items() if value is not None)
        return f"ti.types.ndarray({', '.join(words)})"

    @property
    def dtype(self) -> dtypes.DataType | None:
        return None if self._dtype is None else dtypes.to_dtype(self._dtype)


ndarray = NdarrayType


def vector(n: int, dtype: Any) -> MatrixType:
    """Returns the type of vectors of n components."""
    return MatrixType(n, None, dtype)


def matrix(n: int, m: int, dtype: Any) -> MatrixType:
    """Returns the type of n×m matrices."""
    return MatrixType(n, m, dtype)


def refuse_quant(what: str) -> NoReturn:
    """Raises an error, because there are no types of a few bits."""
    raise TaiRuntimeError(
        f"{what}: types of a few bits are not built in", "use ti.i8, ti.i16, ti.u8 or ti.f16"
    )


class _Quant:
    """Stands for `ti.types.quant`, of which every use is refused."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *args, **options: refuse_quant(f"ti.types.quant.{name}")


quant = _Quant()


class BitpackedFields:
    """Refuses fields of a few bits side by side, which are not built in."""

    def __init__(self, max_num_bits: int = 32):
        refuse_quant("ti.BitpackedFields")


def is_integral(dtype: Any) -> bool:
    found = dtypes.to_dtype(dtype)
    return found is not None and found.is_int


def is_real(dtype: Any) -> bool:
    found = dtypes.to_dtype(dtype)
    return found is not None and found.is_float


def is_signed(dtype: Any) -> bool:
    found = dtypes.to_dtype(dtype)
    return found is not None and found.is_signed
