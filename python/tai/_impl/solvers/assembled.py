"""Sparse matrices in memory whose entries are a field: their products have gradients."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from ..base import dtypes
from ..fields.make import make_field
from ..launch.kernels import data_oriented, kernel
from ..values.ops import static, zero
from ..values.types import template
from .sparse_matrix import get_scipy


@data_oriented
class AssembledMatrix:
    """A sparse matrix with a fixed pattern, whose entries are a field that may have gradients.

    ```python
    A = ti.linalg.AssembledMatrix(rows, columns, (n, n), ti.f64, needs_grad=True)
    fill(A.values)  # a kernel writes entry k, which is at [rows[k], columns[k]]
    with ti.ad.Tape(loss):
        ti.linalg.cg(A, b, x)  # A in the place of a kernel
        compute_loss()
    print(A.values.grad)
    ```

    Entries at one place count as their sum; each has its own gradient. With `block`, entries are
    matrices and vectors are fields of vectors (BSR); otherwise both are numbers (CSR).

    Args:
        rows, columns: where the entries are: arrays of whole numbers.
        shape: rows and columns of the matrix, in blocks.
        dtype: ti.f32 or ti.f64.
        block: the size of blocks, n for n×n.
        needs_grad, needs_dual: whether entries have gradients and tangents.

    Attributes:
        values: the field of the entries, in the order of `rows`.
    """

    def __init__(
        self, rows: Any, columns: Any, shape: tuple[int, int], dtype: Any = dtypes.f32, *,
        block: int | None = None, needs_grad: bool = False, needs_dual: bool = False,
    ):  # fmt: skip
        called = "ti.linalg.AssembledMatrix"
        kind = dtypes.to_dtype(dtype)
        if kind not in (dtypes.f32, dtypes.f64):
            raise TaiRuntimeTypeError(f"{called} holds ti.f32 or ti.f64, but got {dtype!r}")
        if block is not None and (
            isinstance(block, bool) or not isinstance(block, int) or block < 1
        ):
            raise TaiRuntimeTypeError(
                f"{called}: block is a whole number above 0, but got {block!r}"
            )
        places = []
        for name, given, extent in zip(("rows", "columns"), (rows, columns), shape, strict=True):
            array = np.asarray(given)
            if array.ndim != 1 or array.dtype.kind not in "iu" or len(array) == 0:
                raise TaiRuntimeTypeError(
                    f"{called}: {name} is an array of one or more whole numbers, but got {given!r}"
                )
            outside = (array < 0) | (array >= extent)
            if outside.any():
                at = int(np.flatnonzero(outside)[0])
                raise TaiRuntimeTypeError(
                    f"{called}: {name}[{at}] is {array[at]}, but the matrix has {extent} {name}"
                )
            places.append(array.astype(np.int32))
        if len(places[0]) != len(places[1]):
            raise TaiRuntimeTypeError(
                f"{called}: there are {len(places[0])} rows, but {len(places[1])} columns"
            )
        self.rows, self.columns = places
        self.shape = (int(shape[0]), int(shape[1]))
        self.block, self.dtype = block, kind
        element = () if block is None else (block, block)
        count = len(self.rows)
        self.values: Any = make_field(
            element, kind, (count,), None, "values", None, needs_grad, needs_dual
        )
        order = np.lexsort((self.columns, self.rows)).astype(np.int32)
        starts = np.searchsorted(self.rows[order], np.arange(self.shape[0] + 1))
        self._starts, self._order, self._columns = (
            _constant(array, name)
            for array, name in ((starts, "starts"), (order, "order"),
                                (self.columns[order], "columns"))
        )  # fmt: skip
        self.num_rows = self.shape[0]

    @classmethod
    def from_scipy(
        cls, matrix: Any, dtype: Any = None, *, needs_grad: bool = False, needs_dual: bool = False
    ) -> AssembledMatrix:
        """Makes a matrix from an array of `scipy.sparse`, or from a `ti.linalg.SparseMatrix`."""
        to_scipy = getattr(matrix, "to_scipy", None)
        a = to_scipy() if to_scipy is not None else matrix
        kind = dtype or (dtypes.f32 if a.dtype == np.float32 else dtypes.f64)
        block = a.blocksize[0] if a.format == "bsr" else None
        if block is not None and a.blocksize != (block, block):
            raise TaiRuntimeTypeError(f"blocks are square, but got {a.blocksize}")
        if block is None:
            entries = a.tocoo()
            made = cls(entries.row, entries.col, a.shape, kind, needs_grad=needs_grad,
                       needs_dual=needs_dual)  # fmt: skip
            values = entries.data
        else:
            shape = (a.shape[0] // block, a.shape[1] // block)
            rows = np.repeat(np.arange(shape[0]), np.diff(a.indptr))
            made = cls(rows, a.indices, shape, kind, block=block, needs_grad=needs_grad,
                       needs_dual=needs_dual)  # fmt: skip
            values = a.data
        shape = made.values.shape + made.values.element_shape
        made.values.from_numpy(values.astype(made.dtype.numpy).reshape(shape))
        return made

    def to_scipy(self) -> Any:
        """The matrix with the entries that it has now, as an array of `scipy.sparse` in CSR."""
        sparse, _ = get_scipy()
        # NumPy's form of 1×1 matrices has fewer axes, so the array is reshaped.
        values = self.values.to_numpy().reshape(len(self.rows), *self.values.element_shape)
        if self.block is None:
            return sparse.coo_array((values, (self.rows, self.columns)), self.shape).tocsr()
        n = self.block
        inner = np.arange(n)
        rows = np.broadcast_to((self.rows * n)[:, None, None] + inner[:, None], values.shape)
        columns = np.broadcast_to((self.columns * n)[:, None, None] + inner, values.shape)
        shape = (self.shape[0] * n, self.shape[1] * n)
        return sparse.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape).tocsr()

    def diagonal(self) -> np.ndarray:
        """Returns the diagonal of the matrix as it is now: numbers, or blocks."""
        count = min(self.shape)
        found = np.zeros((count, *self.values.element_shape), self.dtype.numpy)
        on = self.rows == self.columns
        values = self.values.to_numpy().reshape(len(self.rows), *found.shape[1:])
        np.add.at(found, self.rows[on], values[on])
        return found

    @kernel
    def multiply(self, x: template(), y: template()):
        """y = A x."""
        for i in range(self.num_rows):
            total = zero(y[i])
            for k in range(self._starts[i], self._starts[i + 1]):
                if static(self.block is None):
                    total += self.values[self._order[k]] * x[self._columns[k]]
                else:
                    total += self.values[self._order[k]] @ x[self._columns[k]]
            y[i] = total

    def check(self, x: Any, solver: str) -> None:
        """Refuses a field that is no vector of a square matrix like this one."""
        n, columns = self.shape
        if n != columns:
            raise TaiRuntimeTypeError(
                f"{solver} takes a square matrix, but got one of {n}×{columns}",
                "for the nearest solution, solve with a kernel that computes AᵀA",
            )
        element = () if self.block is None else (self.block,)
        offset = tuple(getattr(x, "offset", ()) or ())
        if (x.shape, x.element_shape, x.dtype) != ((n,), element, self.dtype) or any(offset):
            of = "numbers" if self.block is None else f"vectors of {self.block}"
            raise TaiRuntimeTypeError(
                f"{solver}: {self!r} takes fields of {n} {of} of {self.dtype} that begin at 0, but "
                f"field '{x.name}' has shape {x.shape}, element shape {x.element_shape} and type "
                f"{x.dtype}"
            )

    def __repr__(self) -> str:
        of = "" if self.block is None else f" of {self.block}×{self.block}"
        return (
            f"<assembled matrix of {self.shape[0]}×{self.shape[1]}{of} {self.dtype}, "
            f"{len(self.rows)} entries>"
        )


def _constant(array: np.ndarray, name: str) -> Any:
    made: Any = make_field((), dtypes.i32, array.shape, None, name, None, False, False)
    made.from_numpy(array.astype(np.int32))
    return made
