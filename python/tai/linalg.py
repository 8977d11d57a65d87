"""`ti.linalg`: solvers of systems of equations over fields that kernels define, with gradients."""

from __future__ import annotations

from typing import Any

from ._impl.solvers.implicit import newton
from ._impl.solvers.linear import bicgstab, cg, jacobi
from ._impl.solvers.matrix_free import LinearOperator, MatrixFreeBICGSTAB, MatrixFreeCG
from ._impl.solvers.report import SolveInfo
from .errors import TaiConvergenceWarning

__all__ = [
    "LinearOperator",
    "MatrixFreeBICGSTAB",
    "MatrixFreeCG",
    "SolveInfo",
    "TaiConvergenceWarning",
    "bicgstab",
    "cg",
    "jacobi",
    "newton",
]


def __getattr__(name: str) -> Any:
    if not name.startswith("Sparse"):
        raise AttributeError(f"module 'tai.linalg' has no attribute '{name}'")
    error = AttributeError(f"ti.linalg.{name} is not built in: there are no assembled matrices")
    error.add_note("hint: ti.linalg.cg and bicgstab solve with a kernel in the place of a matrix")
    raise error
