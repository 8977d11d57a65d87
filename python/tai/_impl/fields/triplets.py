"""Entries of a sparse matrix that kernels list one by one: row, column and value."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiMemoryError, TaiRuntimeTypeError
from ..base import dtypes
from ..values.types import NdarrayType
from .structs import StructType


class Triplets:
    """Three arrays (rows, columns, values) to which kernels append entries of a sparse matrix.

    Entries that do not fit go behind the last one, and are counted.

    Args:
        capacity: how many entries there may be.
        dtype: the type of the values.
    """

    def __init__(self, capacity: int, dtype: Any):
        self.capacity = capacity
        try:
            self.rows = np.zeros(capacity + 1, np.int32)
            self.columns = np.zeros(capacity + 1, np.int32)
            self.values = np.zeros(capacity + 1, dtype)
        except MemoryError:
            raise TaiMemoryError(
                f"there is no memory for {capacity} entries", "make max_num_triplets smaller"
            ) from None
        self.count = np.zeros(1, np.int32)

    def items(self) -> dict[str, np.ndarray]:
        """Returns the arrays of the builder by the names that kernels use for them."""
        return {name: getattr(self, name) for name in TripletsType.NAMES}


class TripletsType(StructType):
    """Annotates a `ti.linalg.SparseMatrixBuilder`, to which a kernel adds: `A[i, j] += v`."""

    NAMES = ("rows", "columns", "values", "count")

    def __init__(self) -> None:
        whole = NdarrayType(dtypes.i32, ndim=1)
        values = NdarrayType(ndim=1)
        self.members = {"rows": whole, "columns": whole, "values": values, "count": whole}
        self.methods: dict[str, Any] = {}

    def __repr__(self) -> str:
        return "ti.types.sparse_matrix_builder()"

    def take(self, kernel: str, name: str, value: Any) -> dict[str, np.ndarray]:
        """Returns the arrays of a builder that is an argument of a kernel."""
        if not isinstance(value, Triplets):
            raise TaiRuntimeTypeError(
                f"argument '{name}' of kernel '{kernel}' expects a sparse matrix builder, but got "
                f"a {type(value).__name__}",
                "make one by ti.linalg.SparseMatrixBuilder(rows, columns, max_num_triplets)",
            )
        return value.items()
