"""Sparse matrices that kernels fill, their arithmetic, and direct solvers.

The arithmetic and the factorisations are SciPy's. Nothing here is differentiated: `ti.linalg.cg`
and others, which take a kernel in the place of a matrix, are.
"""

from __future__ import annotations

import operator
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base import dtypes, pieces
from ..base import scipy as base_scipy
from ..base.program import sync
from ..fields.arrays import Ndarray
from ..fields.field import Field
from ..fields.triplets import Triplets
from ..history import origins

# SciPy's formats by Taichi's.
_FORMATS = {"col_major": "csc", "row_major": "csr"}
_SOLVERS = ("LLT", "LDLT", "LU")
# For each ordering of Eigen, which Taichi names, the one of SciPy.
_ORDERINGS = {"AMD": "MMD_AT_PLUS_A", "COLAMD": "COLAMD"}


def get_scipy() -> tuple[Any, Any]:
    """Returns the modules of SciPy that matrices need."""
    return base_scipy.get_scipy(
        instead="solve with a kernel in the place of a matrix: ti.linalg.cg"
    )


def _float_type(dtype: Any, what: str) -> dtypes.DataType:
    found = dtypes.to_dtype(dtype)
    if found not in (dtypes.f32, dtypes.f64):
        raise TaiRuntimeTypeError(f"{what} holds ti.f32 or ti.f64, but got {dtype!r}")
    return found


def _count(value: Any, what: str) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise TaiRuntimeTypeError(f"{what} is a whole number above 0, but got {value!r}")
    return int(value)


def _format(storage_format: str) -> str:
    if storage_format not in _FORMATS:
        raise TaiRuntimeTypeError(
            f"storage_format is {' or '.join(map(repr, _FORMATS))}, but got {storage_format!r}"
        )
    return _FORMATS[storage_format]


class SparseMatrixBuilder(Triplets):
    """Collects the entries of a sparse matrix; those at the same place are added up.

    ```python
    builder = ti.linalg.SparseMatrixBuilder(n, n, max_num_triplets=3 * n)


    @ti.kernel
    def fill(A: ti.types.sparse_matrix_builder()):
        for i in range(n):
            A[i, i] += 2.0


    fill(builder)
    A = builder.build()
    ```

    Args:
        num_rows, num_cols: the size of the matrix; square if the second is left out.
        max_num_triplets: how many entries there may be before they are added up.
        dtype: ti.f32 or ti.f64.
        storage_format: "col_major" or "row_major".
    """

    def __init__(
        self, num_rows: Any = None, num_cols: Any = None, max_num_triplets: Any = 0,
        dtype: Any = dtypes.f32, storage_format: str = "col_major",
    ):  # fmt: skip
        self.num_rows = _count(num_rows, "num_rows")
        self.num_cols = _count(num_rows if num_cols is None else num_cols, "num_cols")
        self.dtype = _float_type(dtype, "a sparse matrix")
        self._format = _format(storage_format)
        capacity = _count(max_num_triplets, "max_num_triplets")
        if capacity >= 2**31 - 1:
            raise TaiRuntimeTypeError(
                f"max_num_triplets is below 2^31 - 1, but got {capacity}",
                "fill several builders, and add the matrices up",
            )
        super().__init__(capacity, self.dtype.numpy)

    def _entries(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        sync()
        number = int(self.count[0])
        if number > self.capacity:
            raise TaiRuntimeError(
                f"kernels added {number} entries to a builder of {self.capacity}",
                f"make it with max_num_triplets={number}",
            )
        rows, columns = self.rows[:number], self.columns[:number]
        outside = (rows < 0) | (rows >= self.num_rows) | (columns < 0) | (columns >= self.num_cols)
        if outside.any():
            at = int(np.flatnonzero(outside)[0])
            raise TaiRuntimeError(
                f"a kernel added to [{rows[at]}, {columns[at]}] of a matrix of "
                f"{self.num_rows}×{self.num_cols}"
            )
        # Threads append entries in any order; sorting fixes the order in which entries at the same
        # place are added up.
        order = pieces.beside(lambda: np.lexsort((self.values[:number], rows, columns)), number)
        return rows[order], columns[order], self.values[:number][order]

    def print_triplets(self) -> None:
        """Prints the entries of the matrix, column by column."""
        rows, columns, values = self._entries()
        size = f"n={self.num_rows}, m={self.num_cols}"
        print(f"{size}, num_triplets={len(values)} (max={self.capacity})")
        for entry in zip(rows, columns, values, strict=True):
            print("[{}, {}] = {:g}".format(*entry))

    def build(self, dtype: Any = None, _format: Any = None) -> SparseMatrix:
        """The matrix of the entries so far, after which the builder is empty."""
        sparse, _ = get_scipy()
        kind = self.dtype if dtype is None else _float_type(dtype, "a sparse matrix")
        rows, columns, values = self._entries()
        self.count[0] = 0
        entries = sparse.coo_array(
            (values.astype(kind.numpy), (rows, columns)), (self.num_rows, self.num_cols)
        )
        made = pieces.beside(lambda: entries.asformat(self._format), len(values))
        return origins.note_computed(SparseMatrix._of(made), self.values)


def as_numpy(x: Any) -> np.ndarray:
    if isinstance(x, (Field, Ndarray)):
        return x.to_numpy()
    return np.asarray(x)


class SparseMatrix:
    """A sparse matrix that is computed on the host by SciPy.

    `+`, `-` and `*` go element by element, `*` also with a number; `A @ x` is the product with
    another one, or with a vector: a field, a `ti.ndarray` or an array of NumPy.

    Args:
        n, m: rows and columns; square if the second is left out.
        dtype: ti.f32 or ti.f64.
        storage_format: "col_major" or "row_major".
    """

    def __init__(
        self, n: Any = None, m: Any = None, dtype: Any = dtypes.f32,
        storage_format: str = "col_major",
    ):  # fmt: skip
        sparse, _ = get_scipy()
        shape = (_count(n, "n"), _count(n if m is None else m, "m"))
        kind = _float_type(dtype, "a sparse matrix").numpy
        self._matrix = sparse.coo_array(shape, dtype=kind).asformat(_format(storage_format))

    @classmethod
    def _of(cls, matrix: Any) -> SparseMatrix:
        made = cls.__new__(cls)
        made._matrix = matrix
        return made

    @property
    def n(self) -> int:
        """The number of rows."""
        return self._matrix.shape[0]

    @property
    def m(self) -> int:
        """The number of columns."""
        return self._matrix.shape[1]

    @property
    def shape(self) -> tuple[int, int]:
        return self._matrix.shape

    @property
    def dtype(self) -> dtypes.DataType:
        return dtypes.f32 if self._matrix.dtype == np.float32 else dtypes.f64

    def to_scipy(self) -> Any:
        """Returns the same matrix as an array of `scipy.sparse`, which shares its memory."""
        return self._matrix

    def to_numpy(self) -> np.ndarray:
        """All elements, zeros included."""
        return self._matrix.toarray()

    def __getitem__(self, indices: tuple[int, int]) -> float:
        return float(self._matrix[indices])

    def __setitem__(self, indices: tuple[int, int], value: float) -> None:
        with warnings.catch_warnings():
            # SciPy's warning that changing single entries is slow is suppressed.
            warnings.simplefilter("ignore")
            self._matrix[indices] = value
        origins.note_computed(self, value)

    def _combined(self, other: Any, op: str, apply: Callable[[Any, Any], Any]) -> Any:
        if not isinstance(other, SparseMatrix):
            return NotImplemented
        if other.shape != self.shape:
            sizes = " and ".join(f"{a}×{b}" for a, b in (self.shape, other.shape))
            raise TaiRuntimeTypeError(f"'{op}' takes sparse matrices of one size, but got {sizes}")
        made = apply(self._matrix, other._matrix)
        return self._derived(made.asformat(self._matrix.format), other)

    def _derived(self, matrix: Any, *operands: Any) -> SparseMatrix:
        """Makes a matrix that is computed from this one and from others."""
        return origins.note_computed(SparseMatrix._of(matrix), self, *operands)

    def __add__(self, other: Any) -> Any:
        return self._combined(other, "+", operator.add)

    def __sub__(self, other: Any) -> Any:
        return self._combined(other, "-", operator.sub)

    def __neg__(self) -> SparseMatrix:
        return self._derived(-self._matrix)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, (int, float, np.number)):
            return self._derived(self._matrix * self._matrix.dtype.type(other))
        return self._combined(other, "*", operator.mul)

    __rmul__ = __mul__

    def __matmul__(self, other: Any) -> Any:
        inner = other.shape[0] if getattr(other, "shape", ()) else None
        if inner != self.m:
            raise TaiRuntimeTypeError(
                f"'@' of a sparse matrix of {self.n}×{self.m} takes {self.m} rows, but got "
                + (f"{inner}" if inner is not None else f"{other!r}")
            )
        if isinstance(other, SparseMatrix):
            product = (self._matrix @ other._matrix).asformat(self._matrix.format)
            return self._derived(product, other)
        result = self._matrix @ as_numpy(other)
        return origins.note_computed(like(other, result), self, other)

    def spmv(self, x: Any, y: Any) -> None:
        """Computes the product y = A x for fields or arrays."""
        product = np.asarray(self._matrix @ as_numpy(x), dtype=y.dtype.numpy)
        y.from_numpy(origins.note_computed(product, self, x))

    def transpose(self) -> SparseMatrix:
        return self._derived(self._matrix.T.asformat(self._matrix.format))

    def build_from_ndarray(self, triplets: Any) -> None:
        """Takes the entries of an array of (row, column, value), one after another."""
        flat = as_numpy(triplets).reshape(-1, 3)
        sparse, _ = get_scipy()
        made = sparse.coo_array(
            (flat[:, 2], (flat[:, 0].astype(np.int64), flat[:, 1].astype(np.int64))), self.shape
        )
        self._matrix = made.astype(self._matrix.dtype).asformat(self._matrix.format)
        origins.note_computed(self, triplets)

    def mmwrite(self, filename: str) -> None:
        """Writes the matrix as a Matrix Market file."""
        import scipy.io

        scipy.io.mmwrite(filename, self._matrix)

    def __str__(self) -> str:
        words = [[f"{x:g}" for x in row] for row in self.to_numpy()]
        width = max(len(word) for row in words for word in row)
        return "\n".join("[" + ", ".join(w.rjust(width) for w in row) + "]" for row in words)

    def __repr__(self) -> str:
        return f"<sparse matrix of {self.n}×{self.m} {self.dtype}, {self._matrix.nnz} entries>"


def like(given: Any, result: np.ndarray) -> Any:
    """Returns a result as a `ti.ndarray` if the argument was one."""
    if not isinstance(given, Ndarray):
        return result
    made = Ndarray(given.dtype, result.shape)
    made.from_numpy(result.astype(given.dtype.numpy))
    return made


class SparseSolver:
    """Solves A x = b by a factorisation of A.

    ```python
    solver = ti.linalg.SparseSolver(solver_type="LLT")
    solver.analyze_pattern(A)
    solver.factorize(A)
    x = solver.solve(b)
    ```

    Args:
        dtype: ti.f32 or ti.f64; the factorisation is in f64.
        solver_type: "LLT" and "LDLT" for symmetric matrices, of which the first must be positive
            definite; "LU" for all.
        ordering: "AMD" or "COLAMD".
    """

    def __init__(self, dtype: Any = dtypes.f32, solver_type: str = "LLT", ordering: str = "AMD"):
        if solver_type not in _SOLVERS or ordering not in _ORDERINGS:
            raise TaiRuntimeTypeError(
                f"there is no solver of type {solver_type!r} and ordering {ordering!r}",
                f"types are {', '.join(_SOLVERS)}, orderings {', '.join(_ORDERINGS)}",
            )
        self.dtype = _float_type(dtype, "a solver")
        self.solver_type, self.ordering = solver_type, ordering
        self._factors: Any = None
        self._problem = "nothing is factorised yet"

    def analyze_pattern(self, sparse_matrix: SparseMatrix) -> None:
        """Checks that there is a factorisation of matrices of this form; `factorize` makes it."""
        self._check(sparse_matrix)

    def _check(self, matrix: Any) -> None:
        if not isinstance(matrix, SparseMatrix):
            raise TaiRuntimeTypeError(
                f"a solver takes a sparse matrix, but got a {type(matrix).__name__}",
                "make one by ti.linalg.SparseMatrixBuilder",
            )
        if matrix.n != matrix.m:
            raise TaiRuntimeTypeError(
                f"a solver takes a square matrix, but got one of {matrix.n}×{matrix.m}"
            )

    def factorize(self, sparse_matrix: SparseMatrix) -> None:
        """Factorises the matrix; afterwards `info` says whether this succeeded."""
        _, solvers = get_scipy()
        self._check(sparse_matrix)
        a = sparse_matrix.to_scipy().astype(np.float64).tocsc()
        self._factors, self._problem = None, ""
        is_symmetric = self.solver_type != "LU"
        if is_symmetric and abs(a - a.T).max() > 1e-5 * max(abs(a).max(), 1e-300):
            self._problem = f"the matrix is not symmetric, as {self.solver_type} needs it"
            return
        options = {"SymmetricMode": True} if is_symmetric else {}
        try:
            factors = solvers.splu(
                a, permc_spec=_ORDERINGS[self.ordering], options=options,
                diag_pivot_thresh=0.0 if is_symmetric else None,
            )  # fmt: skip
        except RuntimeError as error:
            self._problem = f"the matrix cannot be factorised: {error}"
            return
        # Without pivoting, U = D Lᵀ, so the diagonal of U shows whether the matrix is positive
        # definite.
        pivots = factors.U.diagonal()
        if self.solver_type == "LLT" and (pivots <= 0).any():
            self._problem = "the matrix is not positive definite, as LLT needs it"
            return
        self._factors = factors
        origins.note_computed(self, sparse_matrix)

    def compute(self, sparse_matrix: SparseMatrix) -> None:
        """Does the steps of `analyze_pattern`, which `factorize` includes, and of `factorize`."""
        self.factorize(sparse_matrix)

    def solve(self, b: Any) -> Any:
        """x as an array of NumPy, or as a `ti.ndarray` where b is one."""
        if self._factors is None:
            raise TaiRuntimeError(
                f"there is nothing to solve with: {self._problem}",
                "call factorize(A) first, and ask info()",
            )
        right = as_numpy(b)
        if right.shape[:1] != (self._factors.shape[0],):
            raise TaiRuntimeTypeError(
                f"the right-hand side has {self._factors.shape[0]} elements, but got {right.shape}"
            )
        found = self._factors.solve(right.astype(np.float64))
        return origins.note_computed(like(b, found.astype(self.dtype.numpy)), self, b)

    def info(self) -> bool:
        """Whether the last matrix could be factorised."""
        return self._factors is not None
