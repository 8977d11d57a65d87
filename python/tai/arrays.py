"""`ti.ndarray`: arrays that Python owns and kernels take as arguments."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import dtypes
from .errors import TaiRuntimeTypeError


class Ndarray:
    """An array around NumPy memory, indexed as a field is.

    Attributes:
        array: the memory, of shape `shape + element_shape`.
        shape: the extents, without those of the element.
        element_shape: `()`, `(n,)` or `(n, m)`.
    """

    def __init__(self, dtype: Any, shape: Any, element_shape: tuple[int, ...] = ()):
        from .types import MatrixType

        if isinstance(dtype, MatrixType):
            element_shape, dtype = dtype.shape, dtype.dtype
        resolved = dtypes.to_dtype(dtype)
        if resolved is None:
            raise TaiRuntimeTypeError(f"{dtype!r} is not a type of numbers")
        self.dtype, self.element_shape = resolved, tuple(element_shape)
        self.shape = tuple(shape) if isinstance(shape, (tuple, list)) else (int(shape),)
        self.array = np.zeros(self.shape + self.element_shape, resolved.numpy)

    def __getitem__(self, key: Any) -> Any:
        from .matrix import Matrix

        item = self.array[() if key is None else key]
        return Matrix._wrap(item) if np.ndim(item) else item.item()

    def __setitem__(self, key: Any, value: Any) -> None:
        self.array[() if key is None else key] = np.asarray(value)

    def to_numpy(self) -> np.ndarray:
        return self.array.copy()

    def from_numpy(self, array: Any) -> None:
        array = np.asarray(array)
        if array.shape != self.array.shape:
            raise TaiRuntimeTypeError(
                f"expects an array of shape {self.array.shape}, but got {array.shape}"
            )
        self.array[...] = array

    def fill(self, value: Any) -> None:
        self.array[...] = value

    def copy_from(self, other: Any) -> None:
        self.from_numpy(other.to_numpy())

    def __str__(self) -> str:
        return str(self.array)

    def __repr__(self) -> str:
        return f"<ti.ndarray of {self.dtype}, shape {self.shape}>"


def ndarray(dtype: Any, shape: Any, needs_grad: bool = False) -> Ndarray:
    """An array of zeros that kernels take as `ti.types.ndarray()`."""
    if needs_grad:
        from .errors import TaiAutodiffError

        raise TaiAutodiffError(
            "gradients of arrays are not built in yet", "keep what is differentiated in fields"
        )
    return Ndarray(dtype, shape)
