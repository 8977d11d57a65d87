"""Iterative solvers under the names and with the tolerances of Taichi's `ti.linalg`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from .linear import bicgstab, cg
from .report import SolveInfo
from .sparse_matrix import SparseMatrix, as_numpy, get_scipy, like


class LinearOperator:
    """A matrix that is given as a kernel `apply(x, y)`, which computes field y = A x."""

    def __init__(self, matvec_kernel: Any):
        self.apply = matvec_kernel

    def matvec(self, x: Any, ax: Any) -> None:
        self.apply(x, ax)


def _solve(
    solver: Callable[..., SolveInfo], name: str, a: Any, b: Any, x: Any, tol: float,
    maxiter: int, quiet: bool,
) -> bool:  # fmt: skip
    if not isinstance(a, LinearOperator):
        raise TaiRuntimeTypeError(
            f"{name} takes a ti.linalg.LinearOperator, but got a {type(a).__name__}",
            "make one of a kernel: ti.linalg.LinearOperator(apply)",
        )
    size = float(np.linalg.norm(b.to_numpy().astype(np.float64)))
    found = solver(a.apply, b, x, tol=tol / size if size > 0 else tol, max_iterations=maxiter)
    if not quiet:
        print(f"{name}: {found.iterations} iterations, residual {found.residual * size:g}")
    return found.converged


def MatrixFreeCG(  # noqa: N802
    A: LinearOperator, b: Any, x: Any, tol: float = 1e-6, maxiter: int = 5000, quiet: bool = True
) -> bool:  # fmt: skip
    """Solves A x = b by conjugate gradients; whether ‖b - A x‖ is at most `tol`.

    As `ti.linalg.cg`, which says more of how it ended, and whose tolerance is relative to ‖b‖.
    """
    return _solve(cg, "ti.linalg.MatrixFreeCG", A, b, x, tol, maxiter, quiet)


def MatrixFreeBICGSTAB(  # noqa: N802
    A: LinearOperator, b: Any, x: Any, tol: float = 1e-6, maxiter: int = 5000, quiet: bool = True
) -> bool:  # fmt: skip
    """The same by BiCGSTAB, for a matrix that need not be symmetric."""
    return _solve(bicgstab, "ti.linalg.MatrixFreeBICGSTAB", A, b, x, tol, maxiter, quiet)


class SparseCG:
    """Solves A x = b by conjugate gradients, for a sparse matrix that is positive definite.

    Args:
        A: the matrix.
        b: the right-hand side: a field, a `ti.ndarray` or an array of NumPy.
        x0: where it begins; at zero if None.
        max_iter: maximum of iterations.
        atol: bound of ‖b - A x‖.
    """

    def __init__(
        self, A: SparseMatrix, b: Any, x0: Any = None, max_iter: int = 50, atol: float = 1e-6
    ):
        if not isinstance(A, SparseMatrix) or A.n != A.m:
            raise TaiRuntimeTypeError(f"SparseCG takes a square sparse matrix, but got {A!r}")
        self.matrix, self.b, self.x0, self.max_iter, self.atol = A, b, x0, max_iter, atol

    def solve(self) -> tuple[Any, bool]:
        """The solution, as a `ti.ndarray` where b is one, and whether it is within `atol`."""
        _, solvers = get_scipy()
        a = self.matrix.to_scipy().astype(np.float64)
        b = as_numpy(self.b).astype(np.float64)
        x0 = None if self.x0 is None else as_numpy(self.x0).astype(np.float64)
        x, ended = solvers.cg(a, b, x0, rtol=0.0, atol=self.atol, maxiter=self.max_iter)
        return like(self.b, x.astype(self.matrix.dtype.numpy)), ended == 0
