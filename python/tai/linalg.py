"""`ti.linalg`: solvers of systems of equations over fields that kernels define, with gradients."""

from __future__ import annotations

from ._impl.solvers.implicit import newton
from ._impl.solvers.linear import bicgstab, cg, jacobi
from ._impl.solvers.report import SolveInfo
from .errors import TaiConvergenceWarning

__all__ = ["SolveInfo", "TaiConvergenceWarning", "bicgstab", "cg", "jacobi", "newton"]
