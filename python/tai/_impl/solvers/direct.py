"""Direct solves of assembled sparse matrices, by SuperLU on the host."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError
from . import recorded
from .assembled import AssembledMatrix
from .linear import check_system
from .operators import Operator
from .recorded import Adjoint
from .report import Caller, SolveInfo
from .sparse_matrix import get_scipy
from .system import Progress

# A pivot counts as zero if it is less than this many rounding units, for each row, of the greatest
# pivot.
_SINGULAR = 4 * 2.0**-52
# The most steps of iterative refinement of a solution.
_REFINEMENTS = 3


def solve(A: Any, b: Any, x: Any) -> SolveInfo:
    """Solves A x = b directly, by the factors of SuperLU on the host, in f64.

    The factors serve the adjoint, too: gradients pass to `b` and to `A.values`. On a GPU, the
    entries and vectors come to the host for it.

    Args:
        A: a square `ti.linalg.AssembledMatrix`.
        b: the right-hand side.
        x: the solution. Under a tape it needs a gradient.

    Returns:
        How it ended. If A has no inverse, x is zero, and there is a `TaiConvergenceWarning`.
    """
    solver = "ti.linalg.solve"
    if not isinstance(A, AssembledMatrix):
        raise TaiRuntimeTypeError(
            f"{solver} takes a ti.linalg.AssembledMatrix, but got {A!r}",
            "with a kernel in its place: ti.linalg.gmres, cg and others; many small systems: "
            "ti.linalg.solve_batch",
        )
    kernel = check_system(solver, A, b, x)
    caller = Caller(solver, None, 1, x.dtype.name, has_tangents=True)
    operator = Operator(solver, kernel, x, ())
    factors = _Factors()

    def run(right: Any, field: Any, transposed: bool) -> Progress:
        found, progress = factors.solve(A, right.to_numpy(), transposed)
        field.from_numpy(found)
        return progress

    def solve_forward(field: Any) -> Progress:
        factors.forget()
        return run(b, field, False)

    def solve_adjoint(g: Any, adjoint: Any) -> Adjoint:
        # The entries of the matrix may have changed since, so the factors are dropped.
        factors.forget()
        return Adjoint(run(g, adjoint, True))

    def solve_tangent(rest: Any, tangent: Any) -> Progress:
        recorded.subtract_from_tangent(b, rest)
        return run(rest, tangent, False)

    return recorded.run(caller, operator, solve_forward, solve_adjoint, -1.0, b, solve_tangent)


class _Factors:
    """The factors of a matrix, which are computed when they are first needed."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self._made: Any = None
        self._matrix: Any = None

    def solve(
        self, matrix: AssembledMatrix, right: np.ndarray, transposed: bool
    ) -> tuple[np.ndarray, Progress]:
        """Solves the system on the host; returns the solution in the shape and type of the
        right-hand side, and how the solve ended.
        """
        _, solvers = get_scipy()
        b = right.astype(np.float64).ravel()
        nothing = np.zeros_like(right)
        if self._matrix is None:
            self._matrix = matrix.to_scipy().astype(np.float64).tocsc()
        a = self._matrix
        if not np.isfinite(b).all() or not np.isfinite(a.data).all():
            return nothing, Progress(0, math.nan, "not finite")
        if not b.any():
            return nothing, Progress(0, 0.0, "", 0.0, 0.0, 0.0)
        if self._made is None:
            self._made = _factorize(solvers, a)
        if self._made is None:
            return nothing, Progress(0, 1.0, "singular", 1.0, _norm(a))
        product = a.T if transposed else a
        scale = math.ldexp(1.0, math.frexp(np.abs(b).max())[1])
        b = b / scale
        x = self._apply(b, transposed)
        rest = b - product @ x
        for _ in range(_REFINEMENTS):
            better = x + self._apply(rest, transposed)
            new = b - product @ better
            if not np.linalg.norm(new) < 0.5 * np.linalg.norm(rest):
                break
            x, rest = better, new
        with np.errstate(over="ignore"):
            found = (x * scale).astype(right.dtype).reshape(right.shape)
        if not np.isfinite(found).all():
            return nothing, Progress(1, 1.0, "overflow", 1.0, _norm(a))
        # The residual is computed for the solution as it is stored, rounded to its type.
        rest = b - product @ (found.ravel().astype(np.float64) / scale)
        norm, size = _norm(a), np.linalg.norm(x)
        residual = float(np.linalg.norm(rest) / np.linalg.norm(b))
        error = np.linalg.norm(rest) / (norm * size + np.linalg.norm(b))
        misfit = scale * float(np.linalg.norm(rest))
        return found, Progress(1, residual, "", float(error), norm, misfit)

    def _apply(self, b: np.ndarray, transposed: bool) -> np.ndarray:
        factors, rows, columns = self._made
        if transposed:
            return rows * factors.solve(columns * b, "T")
        return columns * factors.solve(rows * b)


def _norm(a: Any) -> float:
    """The greatest norm of a column of the matrix, which is a lower bound of the 2-norm of the
    matrix.
    """
    return float(np.sqrt(np.asarray(a.multiply(a).sum(axis=0)).max())) if a.nnz else 0.0


def _inverse_of_largest(a: Any, axis: int) -> np.ndarray | None:
    """Powers of two that scale the greatest elements of rows or columns to about one."""
    largest = abs(a).max(axis=axis).toarray().ravel()
    if not (largest > 0).all():
        return None
    return np.ldexp(1.0, -np.frexp(largest)[1])


def _factorize(solvers: Any, a: Any) -> tuple[Any, np.ndarray, np.ndarray] | None:
    """The factors of the matrix with scaled rows and columns, and both scales; None if a pivot is
    zero but for rounding."""
    sparse, _ = get_scipy()
    rows = _inverse_of_largest(a, 1)
    if rows is None:
        return None
    scaled = sparse.diags_array(rows) @ a
    columns = _inverse_of_largest(scaled, 0)
    if columns is None:
        return None
    scaled = (scaled @ sparse.diags_array(columns)).tocsc()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            made = solvers.splu(scaled)
        except RuntimeError:
            return None
    pivots = np.abs(made.U.diagonal())
    if not np.isfinite(pivots).all() or pivots.min() <= _SINGULAR * len(pivots) * pivots.max():
        return None
    return made, rows, columns
