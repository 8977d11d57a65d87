"""Taichi's classes of arrays by element kind, for `isinstance` and as constructors."""

from __future__ import annotations

from typing import Any

from .arrays import Ndarray


class _Kind(type):
    """The type of a class whose instances are all arrays with elements of so many indices."""

    rank: int

    def __instancecheck__(cls, thing: Any) -> bool:
        return isinstance(thing, Ndarray) and len(thing.element_shape) == cls.rank


class ScalarNdarray(metaclass=_Kind):
    """The kind of arrays of numbers, `ti.ndarray(dtype, shape)`, for `isinstance`."""

    rank = 0

    def __new__(cls, dtype: Any, arr_shape: Any) -> Any:
        return Ndarray(dtype, arr_shape)


class VectorNdarray(metaclass=_Kind):
    """The kind of arrays of vectors, `ti.Vector.ndarray(n, dtype, shape)`, for `isinstance`."""

    rank = 1

    def __new__(cls, n: int, dtype: Any, shape: Any) -> Any:
        return Ndarray(dtype, shape, (n,))


class MatrixNdarray(metaclass=_Kind):
    """The kind of arrays of matrices, `ti.Matrix.ndarray(n, m, dtype, shape)`, for `isinstance`."""

    rank = 2

    def __new__(cls, n: int, m: int, dtype: Any, shape: Any) -> Any:
        return Ndarray(dtype, shape, (n, m))
