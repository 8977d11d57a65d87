"""Linear systems A x = b, where A is a kernel."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from ...errors import TaiRuntimeTypeError
from . import recorded
from .krylov import (
    Progress,
    System,
    bi_conjugate_gradients,
    conjugate_gradients,
    jacobi_sweeps,
)
from .operators import Operator, check_alike, check_unknown
from .report import Caller, SolveInfo

Method = Callable[[System, float, int], Progress]


def _solve(
    solver: str, method: Method, apply: Any, b: Any, x: Any, tol: Any, limit: Any, args: tuple
) -> SolveInfo:
    check_unknown(x, "the solution", solver)
    check_unknown(b, "the right-hand side", solver)
    check_alike(b, x, solver)
    caller = Caller(solver, tol, limit, x.dtype.name)
    operator = Operator(solver, apply, x, args)

    def solve(field: Any) -> Progress:
        return System(operator.apply, b, field, caller.tolerance, caller.limit).solve(method)

    def solve_adjoint(g: Any, adjoint: Any) -> Progress:
        pull = functools.partial(recorded.pull, operator)
        return System(pull, g, adjoint, caller.tolerance, caller.limit).solve(method)

    right_side = b if recorded.has_gradient(b) else None
    return recorded.run(caller, operator, solve, solve_adjoint, -1.0, right_side)


def cg(
    apply: Any, b: Any, x: Any, *, tol: float | None = None, max_iterations: int = 1000,
    args: tuple[Any, ...] = (),
) -> SolveInfo:  # fmt: skip
    """Solves A x = b by conjugate gradients, for a symmetric positive definite operator.

    ```python
    @ti.kernel
    def laplace(p: ti.template(), q: ti.template()):
        for i in p:
            left = p[i - 1] if i > 0 else 0.0
            right = p[i + 1] if i < n - 1 else 0.0
            q[i] = 2 * p[i] - left - right


    with ti.ad.Tape(loss):
        ti.linalg.cg(laplace, b, x, tol=1e-8)
        compute_loss()
    ```

    Under a tape, gradients pass to `b` and to all fields that the operator reads, by one more
    solve with the adjoint of the operator: at the cost of the first, and with memory that does
    not depend on the iterations.

    Args:
        apply: a kernel `apply(p, q, *args)` that computes field q = A p; it may read any fields.
        b: the right-hand side.
        x: the initial guess, and the solution afterwards. Under a tape it needs a gradient; the
            derivative with respect to the initial guess is zero.
        tol: bound of ‖b - A x‖ / ‖b‖; 1e-10 for f64, 1e-5 for f32. Also used for the adjoint
            system.
        max_iterations: maximum of iterations, for each of the two systems.
        args: more arguments of the kernel.

    Returns:
        How it ended. If it did not converge, there is a `TaiConvergenceWarning`.
    """
    return _solve(
        "ti.linalg.cg", conjugate_gradients, apply, b, x, tol, max_iterations, args
    )  # fmt: skip


def bicgstab(
    apply: Any, b: Any, x: Any, *, tol: float | None = None, max_iterations: int = 1000,
    args: tuple[Any, ...] = (),
) -> SolveInfo:  # fmt: skip
    """Solves A x = b by BiCGSTAB, for an operator that need not be symmetric.

    The arguments and the gradient are those of `cg`; an iteration applies the operator twice.
    """
    return _solve(
        "ti.linalg.bicgstab", bi_conjugate_gradients, apply, b, x, tol, max_iterations, args
    )  # fmt: skip


def jacobi(
    apply: Any, diagonal: Any, b: Any, x: Any, *, tol: float | None = None,
    max_iterations: int = 1000, damping: float = 1.0, args: tuple[Any, ...] = (),
) -> SolveInfo:  # fmt: skip
    """Solves A x = b by Jacobi's iteration, x += damping (b - A x) / diagonal.

    It converges, slowly, for diagonally dominant A; its only reductions are those for the
    residual. Other arguments and the gradient are those of `cg`.

    Args:
        diagonal: a field of the diagonal of A. The solution does not depend on it, and so it
            gets no gradient.
        damping: less than 1 where the plain iteration oscillates.
    """
    solver = "ti.linalg.jacobi"
    check_unknown(x, "the solution", solver)
    check_unknown(diagonal, "the diagonal", solver)
    check_alike(diagonal, x, solver)
    if isinstance(damping, bool) or not isinstance(damping, (int, float)) or not 0 < damping <= 2:
        raise TaiRuntimeTypeError(f"{solver}: damping must be between 0 and 2, but got {damping!r}")
    method = jacobi_sweeps(diagonal, float(damping))
    return _solve(solver, method, apply, b, x, tol, max_iterations, args)
