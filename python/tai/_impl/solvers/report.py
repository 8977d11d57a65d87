"""Results of solvers: the reason to stop, and a warning if they did not converge."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any, NoReturn

from ...errors import TaiAutodiffError, TaiConvergenceWarning, TaiRuntimeTypeError, shorten
from ..base import state
from ..base.callers import calling_frame
from ..fields.root import name_fields
from .operators import Operator
from .system import Progress

# The least tolerance in a run that tightens the tolerances of solvers to measure their effect.
LEAST_TOLERANCE = {"f32": 1e-6, "f64": 1e-13}
_REASONS = {
    "iterations": "it needs more iterations",
    "indefinite": "the operator is not positive definite (p·Ap <= 0), perhaps singular",
    "asymmetric": "the operator is not symmetric: ⟨Au, v⟩ and ⟨u, Av⟩ differ",
    "inconsistent": "the operator is singular, or nearly, and the right-hand side is not in its "
    "range",
    "preconditioner": "the preconditioner is not symmetric and positive definite",
    "diverges": "the iteration diverges",
    "breakdown": "the iteration breaks down: the operator may be singular",
    "singular": "a matrix has no inverse, or none but for rounding; its solution is zero",
    "overflow": "the solution is too large for its type",
    "stagnates": "the residual no longer falls: it is at the rounding error of the type, or the "
    "operator is singular or not linear",
    "not finite": "what is given holds NaN or infinity",
    "no descent": "no step of Newton's method makes the residual smaller",
}
_HINTS = {
    "iterations": "raise max_iterations or tol",
    "indefinite": "ti.linalg.minres takes indefinite operators",
    "asymmetric": "ti.linalg.gmres and bicgstab need no symmetry",
    "inconsistent": "take the part outside of the range from it, such as its mean",
    "diverges": "more iterations do not help; ti.linalg.gmres diverges never",
    "breakdown": "ti.linalg.gmres, or minres for a symmetric operator, may go on",
    "stagnates": "raise tol, or use f64",
}
_STATUS = {
    "": "converged",
    "iterations": "max iterations",
    "indefinite": "indefinite",
    "asymmetric": "not symmetric",
    "inconsistent": "stagnated",
    "preconditioner": "breakdown",
    "diverges": "diverged",
    "breakdown": "breakdown",
    "singular": "breakdown",
    "overflow": "breakdown",
    "stagnates": "stagnated",
    "not finite": "not finite",
    "no descent": "stagnated",
}


@dataclass
class SolveInfo:
    """The result of a solver call, as the program gets it.

    Attributes:
        solver: its name.
        x: the field of the solution.
        iterations: the number of iterations.
        residual: the relative norm that `tol` bounds; see the solver.
        converged: whether the residual is at most the tolerance.
        status: "converged", "max iterations", "stagnated", "diverged", "breakdown", "indefinite",
            "not symmetric" or "not finite".
        reason: why it is not converged, in words; empty if it is.
        backward_error: of a linear system, ‖b - A x‖ / (‖A‖ ‖x‖ + ‖b‖): the least relative change
            of A and b for which x is exact. NaN of other problems.
        norm: ‖A‖ in it: the greatest ‖A v‖ / ‖v‖ that the solve has met, which is not greater than
            the 2-norm. So the backward error is never reported too small.
        misfit: ‖b - A x‖ or ‖F(x)‖; of a fixed point, the last change.
        effect: a bound of the change of the loss that the misfit makes, to first order: ‖λ‖ times
            the misfit, λ the solution of the adjoint system. A tape of `precision=True` finds it.
        place: the line of the call.
        projected: of the gradient of a singular system, the relative norm of the part that no
            solution can follow, and that was taken away; 0 of others.
        adjoint: how the solve for the gradient ended, once a tape has run it.
    """

    iterations: int = 0
    residual: float = math.inf
    converged: bool = False
    reason: str = ""
    adjoint: SolveInfo | None = None
    status: str = ""
    backward_error: float = math.nan
    norm: float = math.nan
    misfit: float = math.nan
    effect: float = math.nan
    place: tuple[str, int] = ("", 0)
    projected: float = 0.0
    solver: str = ""
    x: Any = None

    def __bool__(self) -> bool:
        return self.converged

    def take(self, progress: Progress) -> None:
        self.iterations, self.residual = progress.iterations, progress.residual
        self.converged = not progress.reason
        self.reason = _REASONS.get(progress.reason, progress.reason)
        self.status = _STATUS[progress.reason]
        self.backward_error, self.norm = progress.backward_error, progress.norm
        self.misfit = progress.misfit


class Caller:
    """The line of the program that called a solver, for messages.

    Raises:
        TaiAutodiffError: forward mode is on, and the solver has no derivative in it.
    """

    def __init__(
        self, solver: str, tolerance: Any, limit: Any, dtype_name: str, has_tangents: bool = False
    ):
        frame = calling_frame()
        self.solver = solver
        self.filename, self.lineno = frame.f_code.co_filename, frame.f_lineno
        self.module = frame.f_globals.get("__name__", "")
        if state.forward and not has_tangents:
            self.refuse_tangents("")
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
        version = state.of_thread.version
        scale = 1.0 if version is None else version.tolerances
        self.is_tightened = scale != 1
        self.tolerance, self.limit = float(tolerance), limit
        if self.is_tightened:
            self.tolerance = max(self.tolerance * scale, LEAST_TOLERANCE[dtype_name])

    def refuse_tangents(self, where: str) -> NoReturn:
        """Says that the solver has no derivative in forward mode."""
        error = TaiAutodiffError(
            f"{self.solver} has no derivative in forward mode{where}",
            "pass the function in the place of the tape" if where
            else "take the gradient by a ti.ad.Tape alone",
        )  # fmt: skip
        error.locate(self.filename, self.lineno, 1)
        raise error

    def warn(self, operator: Operator, progress: Progress, what: str, is_recorded: bool) -> None:
        """Warns that a solve did not converge."""
        if not progress.reason or self.is_tightened:
            return
        # Fields get their names from the caller's variables, because no kernel may have named them
        # yet.
        frame = calling_frame()
        name_fields(frame.f_locals)
        name_fields(frame.f_globals)
        text = (
            f"{self.solver}: {what} '{operator.x.name}' has not converged "
            f"({_STATUS[progress.reason]}): residual {progress.residual:.1e} after "
            f"{progress.iterations} iterations with kernel '{operator.name}' ({operator.place}), "
            f"but tol is {self.tolerance:.1e}; "
            f"{_REASONS.get(progress.reason, progress.reason)}"
        )
        if progress.reason in _HINTS:
            text += f" ({_HINTS[progress.reason]})"
        if is_recorded:
            text += ". Its gradient will be that of a converged solution, taken at this point"
        place = f"\n  called from {shorten(self.filename)}:{self.lineno}"
        warnings.warn_explicit(
            text + place, TaiConvergenceWarning, self.filename, self.lineno, self.module
        )
