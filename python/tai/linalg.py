"""`ti.linalg`: systems of equations over fields, given by kernels, and their gradients."""

from __future__ import annotations

from ._impl.solvers.implicit import newton
from ._impl.solvers.linear import bicgstab, cg, jacobi
from ._impl.solvers.report import SolveInfo
from .errors import TaiConvergenceWarning

__all__ = ["SolveInfo", "TaiConvergenceWarning", "bicgstab", "cg", "jacobi", "newton"]
