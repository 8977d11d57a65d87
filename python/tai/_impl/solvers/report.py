"""Results of solvers: the reason to stop, and a warning if they did not converge."""

from __future__ import annotations

import math
import sys
import warnings
from dataclasses import dataclass
from types import FrameType
from typing import Any

from ...errors import TaiAutodiffError, TaiConvergenceWarning, TaiRuntimeTypeError, shorten
from ..base import state
from ..fields.root import name_fields
from .krylov import Progress
from .operators import Operator

_REASONS = {
    "iterations": "it needs more iterations",
    "indefinite": "the operator is not positive definite (p·Ap <= 0), perhaps singular",
    "diverges": "the iteration diverges",
    "breakdown": "the iteration breaks down: the operator may be singular",
    "stagnates": "the residual no longer falls: it is at the rounding error of the type, or the "
    "operator is singular or not linear",
    "not finite": "what is given holds NaN or infinity",
    "no descent": "no step of Newton's method makes the residual smaller",
}
_HINTS = {
    "iterations": "raise max_iterations or tol",
    "indefinite": "ti.linalg.bicgstab needs no symmetry",
    "stagnates": "raise tol, or use f64",
}


@dataclass
class SolveInfo:
    """The result of a solver.

    Attributes:
        iterations: the number of iterations.
        residual: the relative norm that `tol` bounds; see the solver.
        converged: whether the residual is at most the tolerance.
        reason: why it is not, in words; empty if it is.
        adjoint: how the solve for the gradient ended, once a tape has run it.
    """

    iterations: int = 0
    residual: float = math.inf
    converged: bool = False
    reason: str = ""
    adjoint: SolveInfo | None = None

    def __bool__(self) -> bool:
        return self.converged

    def take(self, progress: Progress) -> None:
        self.iterations, self.residual = progress.iterations, progress.residual
        self.converged = not progress.reason
        self.reason = _REASONS.get(progress.reason, progress.reason)


def _get_caller() -> FrameType:
    """The innermost frame of the program."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("tai."):
        frame = frame.f_back
    return frame


class Caller:
    """The line of the program that called a solver.

    Raises:
        TaiAutodiffError: forward mode is on.
    """

    def __init__(self, solver: str, tolerance: Any, limit: Any, dtype_name: str):
        frame = _get_caller()
        self.solver = solver
        self.filename, self.lineno = frame.f_code.co_filename, frame.f_lineno
        self.module = frame.f_globals.get("__name__", "")
        if state.forward:
            error = TaiAutodiffError(
                f"{solver} has no derivative in forward mode yet",
                "take the gradient by a ti.ad.Tape",
            )
            error.locate(self.filename, self.lineno, 1)
            raise error
        if tolerance is None:
            tolerance = 1e-10 if dtype_name == "f64" else 1e-5
        if isinstance(tolerance, bool) or not isinstance(tolerance, (int, float)):
            raise TaiRuntimeTypeError(f"{solver}: tol must be a number, but got {tolerance!r}")
        if not 0 < tolerance < 1:
            raise TaiRuntimeTypeError(
                f"{solver}: tol must be between 0 and 1, but got {tolerance!r}",
                "it is relative: 1e-6 asks for six digits",
            )
        if isinstance(limit, bool) or not isinstance(limit, int) or limit < 1:
            raise TaiRuntimeTypeError(
                f"{solver}: max_iterations must be a positive whole number, but got {limit!r}"
            )
        self.tolerance, self.limit = float(tolerance), limit

    def warn(self, operator: Operator, progress: Progress, what: str, is_recorded: bool) -> None:
        """Says that a solve did not converge."""
        if not progress.reason:
            return
        # Only kernels name fields otherwise, and none of the program's may have read it yet.
        frame = _get_caller()
        name_fields(frame.f_locals)
        name_fields(frame.f_globals)
        text = (
            f"{self.solver}: {what} '{operator.x.name}' has not converged: residual "
            f"{progress.residual:.1e} after {progress.iterations} iterations with kernel "
            f"'{operator.name}' ({operator.place}), but tol is {self.tolerance:.1e}; "
            f"{_REASONS.get(progress.reason, progress.reason)}"
        )
        if progress.reason in _HINTS:
            text += f" ({_HINTS[progress.reason]})"
        if is_recorded:
            text += ". The gradient is that of a converged solution"
        place = f"\n  called from {shorten(self.filename)}:{self.lineno}"
        warnings.warn_explicit(
            text + place, TaiConvergenceWarning, self.filename, self.lineno, self.module
        )
