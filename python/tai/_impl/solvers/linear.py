"""Linear systems A x = b, where A is a kernel or an assembled matrix."""

from __future__ import annotations

import functools
from typing import Any

from ...errors import TaiRuntimeTypeError
from . import preconditioners, recorded
from .assembled import AssembledMatrix
from .gmres import generalized_minimal_residuals
from .krylov import (
    bi_conjugate_gradients,
    conjugate_gradients,
    jacobi_sweeps,
    minimal_residuals,
)
from .operators import Operator, check_alike, check_unknown
from .projection import project
from .recorded import Adjoint
from .report import Caller, SolveInfo
from .system import MAY_BE_SINGULAR, Method, Progress, System


def check_system(solver: str, apply: Any, b: Any, x: Any) -> Any:
    """Checks the arguments of a solver, and returns the kernel of the operator A."""
    check_unknown(x, "the solution", solver)
    check_unknown(b, "the right-hand side", solver)
    check_alike(b, x, solver)
    if isinstance(apply, AssembledMatrix):
        apply.check(x, solver)
        return apply.multiply
    return apply


def _solve(
    solver: str, method: Method, apply: Any, b: Any, x: Any, tol: Any, limit: Any, args: tuple,
    preconditioner: Any = None, adjoint_start: Any = None,
) -> SolveInfo:  # fmt: skip
    kernel = check_system(solver, apply, b, x)
    caller = Caller(solver, tol, limit, x.dtype.name, has_tangents=True)
    operator = Operator(solver, kernel, x, args)
    precondition = preconditioners.bind(solver, preconditioner, x)

    def run(product: Any, right: Any, field: Any, precondition: Any) -> Progress:
        system = System(product, right, field, caller.tolerance, caller.limit, precondition)
        return system.solve(method)

    def solve(field: Any) -> Progress:
        return run(operator.apply, b, field, precondition)

    def solve_adjoint(g: Any, adjoint: Any) -> Adjoint:
        pull = functools.partial(recorded.pull, operator)
        transposed = preconditioners.bind(solver, preconditioner, x, transposed=True)
        progress = run(pull, g, adjoint, transposed)
        if progress.reason not in MAY_BE_SINGULAR:
            return Adjoint(progress)
        # If A is singular, the solution follows only a part of its gradient.
        size = project(operator, pull, g, method.symmetric, caller)
        if not size:
            return Adjoint(progress)
        adjoint.fill(0)
        return Adjoint(run(pull, g, adjoint, transposed), size)

    def solve_tangent(rest: Any, tangent: Any) -> Progress:
        recorded.subtract_from_tangent(b, rest)
        return run(operator.apply, rest, tangent, precondition)

    return recorded.run(caller, operator, solve, solve_adjoint, -1.0, b, solve_tangent,
                        adjoint_start)  # fmt: skip


def cg(
    apply: Any, b: Any, x: Any, *, tol: float | None = None, max_iterations: int = 1000,
    args: tuple[Any, ...] = (), preconditioner: Any = None, adjoint_start: Any = None,
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
    not depend on the iterations. In forward mode, so do tangents.

    Args:
        apply: a kernel `apply(p, q, *args)` that computes field q = A p; it may read any fields.
            Or a `ti.linalg.AssembledMatrix`.
        b: the right-hand side.
        x: the initial guess, and the solution afterwards. Under a tape it needs a gradient; the
            derivative with respect to the initial guess is zero.
        tol: bound of ‖b - A x‖ / ‖b‖; 1e-10 for f64, 1e-5 for f32. Also used for the adjoint
            system.
        max_iterations: maximum of iterations, for each of the two systems.
        args: more arguments of the kernel.
        preconditioner: `ti.linalg.Jacobi`, `BlockJacobi`, `IncompleteCholesky`, or a kernel or
            function `precondition(r, z)` that computes field z ≈ A⁻¹ r, such as a cycle of
            multigrid: linear in r, symmetric and positive definite.
        adjoint_start: a field like x, in which the adjoint solve begins, and which then holds its
            solution. Where programs differ little from one sweep to the next, as in an
            optimisation, the last solution is a good start. Without, it begins at zero.

    Returns:
        How it ended. If it did not converge, there is a `TaiConvergenceWarning`.
    """
    return _solve(
        "ti.linalg.cg",
        conjugate_gradients,
        apply,
        b,
        x,
        tol,
        max_iterations,
        args,
        preconditioner,
        adjoint_start,
    )


def minres(
    apply: Any, b: Any, x: Any, *, tol: float | None = None, max_iterations: int = 1000,
    args: tuple[Any, ...] = (), preconditioner: Any = None, adjoint_start: Any = None,
) -> SolveInfo:  # fmt: skip
    """Solves A x = b by MINRES, for a symmetric operator, which may be indefinite or singular.

    The arguments and the gradient are those of `cg`. The residual never grows. Where A is
    singular, b has to be in its range.
    """
    return _solve(
        "ti.linalg.minres", minimal_residuals, apply, b, x, tol, max_iterations, args,
        preconditioner, adjoint_start,
    )  # fmt: skip


def bicgstab(
    apply: Any, b: Any, x: Any, *, tol: float | None = None, max_iterations: int = 1000,
    args: tuple[Any, ...] = (), preconditioner: Any = None, adjoint_start: Any = None,
) -> SolveInfo:  # fmt: skip
    """Solves A x = b by BiCGSTAB, for an operator that need not be symmetric.

    The arguments and the gradient are those of `cg`; an iteration applies the operator twice. A
    preconditioner need not be symmetric.
    """
    return _solve(
        "ti.linalg.bicgstab", bi_conjugate_gradients, apply, b, x, tol, max_iterations, args,
        preconditioner, adjoint_start,
    )  # fmt: skip


def gmres(
    apply: Any, b: Any, x: Any, *, tol: float | None = None, max_iterations: int = 1000,
    restart: int = 30, args: tuple[Any, ...] = (), preconditioner: Any = None,
    adjoint_start: Any = None,
) -> SolveInfo:  # fmt: skip
    """Solves A x = b by GMRES, for any operator that has an inverse; the residual never grows.

    The other arguments and the gradient are those of `cg`. A preconditioner need not be symmetric.

    Args:
        restart: after how many iterations it begins again. So many fields like x are kept. If it
            stagnates, a greater number helps; with that of the unknowns it is a direct solver.
    """
    if isinstance(restart, bool) or not isinstance(restart, int) or restart < 1:
        raise TaiRuntimeTypeError(
            f"ti.linalg.gmres: restart must be a positive whole number, but got {restart!r}"
        )
    method = generalized_minimal_residuals(restart)
    return _solve(
        "ti.linalg.gmres", method, apply, b, x, tol, max_iterations, args, preconditioner,
        adjoint_start,
    )  # fmt: skip


def jacobi(
    apply: Any, diagonal: Any, b: Any, x: Any, *, tol: float | None = None,
    max_iterations: int = 1000, damping: float = 1.0, args: tuple[Any, ...] = (),
    adjoint_start: Any = None,
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
    return _solve(solver, method, apply, b, x, tol, max_iterations, args,
                  adjoint_start=adjoint_start)  # fmt: skip
