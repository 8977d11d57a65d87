"""Taichi's names of solvers: an operator as an object, and tolerances that are not relative."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from .linear import bicgstab, cg

# For each type, the least relative tolerance that rounding allows.
_LEAST = {"f32": 1e-6, "f64": 1e-14}


class LinearOperator:
    """A matrix that a kernel stands for: `matvec(x, y)` computes field y = A x."""

    def __init__(self, matvec: Any):
        self._matvec = matvec

    def matvec(self, x: Any, Ax: Any) -> None:
        """Computes A x."""
        self._matvec(x, Ax)


def _solve(
    solve: Any, name: str, operator: Any, b: Any, x: Any, tol: Any, limit: int, quiet: bool
) -> bool:
    if not isinstance(operator, LinearOperator):
        raise TaiRuntimeTypeError(
            f"ti.linalg.{name} takes a ti.linalg.LinearOperator, but got {operator!r}",
            "make it of a kernel: ti.linalg.LinearOperator(multiply)",
        )
    size = float(np.linalg.norm(b.to_numpy()))
    relative = max(float(tol) / size if size > 0 else 0.5, _LEAST.get(b.dtype.name, 1e-6))
    info = solve(operator._matvec, b, x, tol=min(relative, 0.5), max_iterations=limit)
    if not quiet:
        ended = "converged" if info.converged else f"did not converge: {info.reason}"
        print(f"{ended} after {info.iterations} iterations, relative residual {info.residual:.3e}")
    return bool(info)


def MatrixFreeCG(
    A: LinearOperator, b: Any, x: Any, tol: float = 1e-6, maxiter: int = 5000, quiet: bool = True
) -> bool:
    """Solves A x = b by conjugate gradients; see `ti.linalg.cg`.

    Args:
        A: the operator, symmetric and positive definite.
        b, x: the right-hand side; the initial guess, and the solution afterwards.
        tol: bound of ‖b - A x‖.
        maxiter: maximum of iterations.
        quiet: whether to print nothing.

    Returns:
        Whether it converged.
    """
    return _solve(cg, "MatrixFreeCG", A, b, x, tol, maxiter, quiet)


def MatrixFreeBICGSTAB(
    A: LinearOperator, b: Any, x: Any, tol: float = 1e-6, maxiter: int = 5000, quiet: bool = True
) -> bool:
    """Solves A x = b by BiCGSTAB, for an operator that need not be symmetric.

    The arguments are those of `MatrixFreeCG`.
    """
    return _solve(bicgstab, "MatrixFreeBICGSTAB", A, b, x, tol, maxiter, quiet)
