"""`ti.linalg`: solvers of systems of equations over fields that kernels define, with gradients;
sparse matrices and direct solvers, without."""

from __future__ import annotations

from ._impl.solvers.implicit import newton
from ._impl.solvers.linear import bicgstab, cg, jacobi
from ._impl.solvers.matrix_free import LinearOperator, MatrixFreeBICGSTAB, MatrixFreeCG
from ._impl.solvers.report import SolveInfo
from ._impl.solvers.sparse_cg import SparseCG
from ._impl.solvers.sparse_matrix import SparseMatrix, SparseMatrixBuilder, SparseSolver
from .errors import TaiConvergenceWarning

__all__ = [
    "LinearOperator", "MatrixFreeBICGSTAB", "MatrixFreeCG", "SolveInfo", "SparseCG",
    "SparseMatrix", "SparseMatrixBuilder", "SparseSolver", "TaiConvergenceWarning", "bicgstab",
    "cg", "jacobi", "newton",
]  # fmt: skip
