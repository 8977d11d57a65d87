"""`ti.linalg`: solvers of equations over fields, with gradients: by iterations with kernels or
assembled matrices, and direct; sparse matrices and solvers of Taichi programs, without."""

from __future__ import annotations

from ._impl.base.keywords import check_keywords
from ._impl.solvers.assembled import AssembledMatrix
from ._impl.solvers.batch import solve_batch
from ._impl.solvers.direct import solve
from ._impl.solvers.implicit import newton
from ._impl.solvers.linear import bicgstab, cg, gmres, jacobi, minres
from ._impl.solvers.matrix_free import LinearOperator, MatrixFreeBICGSTAB, MatrixFreeCG
from ._impl.solvers.preconditioners import BlockJacobi, IncompleteCholesky, Jacobi
from ._impl.solvers.report import SolveInfo
from ._impl.solvers.sparse_cg import SparseCG
from ._impl.solvers.sparse_matrix import SparseMatrix, SparseMatrixBuilder, SparseSolver
from .errors import TaiConvergenceWarning

__all__ = [
    "AssembledMatrix", "BlockJacobi", "IncompleteCholesky", "Jacobi", "LinearOperator",
    "MatrixFreeBICGSTAB", "MatrixFreeCG", "SolveInfo", "SparseCG", "SparseMatrix",
    "SparseMatrixBuilder", "SparseSolver", "TaiConvergenceWarning", "bicgstab", "cg", "gmres",
    "jacobi", "minres", "newton", "solve", "solve_batch",
]  # fmt: skip


check_keywords(globals())
