"""Fixed points x = f(x), where f is a kernel, and roots of F(x) = 0 by Newton's method."""

from __future__ import annotations

import functools
import math
from typing import Any

from ..ad.mode import ForwardMode
from . import recorded
from .krylov import bi_conjugate_gradients, conjugate_gradients, stationary
from .operators import Operator, check_unknown, scratch
from .recorded import Adjoint
from .report import Caller, SolveInfo
from .system import Progress, System, norm_of
from .vectors import get_kernels

# The number of times that Newton's method halves a step before it gives up.
_HALVINGS = 30


def implicit(
    step: Any,
    x: Any,
    *,
    tol: float | None = None,
    max_iterations: int = 1000,
    args: tuple[Any, ...] = (),
    adjoint_start: Any = None,
) -> SolveInfo:
    """Repeats a kernel until its field no longer changes, and differentiates the fixed point.

    ```python
    @ti.kernel
    def relax(x: ti.template(), y: ti.template()):
        for i in x:
            y[i] = f(x[i], stiffness[i])


    with ti.ad.Tape(loss):
        ti.ad.implicit(relax, x, tol=1e-10)
        compute_loss()
    ```

    Under a tape the iterations are not recorded. In reverse, λ = (∂f/∂x)ᵀ λ + x.grad is solved
    by the same kind of iteration, which converges as fast; then the gradients of all fields that
    the kernel reads get (∂f/∂θ)ᵀ λ. Memory does not depend on the number of iterations.

    Args:
        step: a kernel `step(x, y, *args)` that computes field y = f(x); it may read any fields.
        x: the initial guess, and the fixed point afterwards. Under a tape it needs a gradient; the
            derivative with respect to the initial guess is zero.
        tol: bound of ‖f(x) - x‖ / ‖f(x)‖; 1e-10 for f64, 1e-5 for f32. Also used for λ.
        max_iterations: maximum of iterations, for each of the two.
        args: more arguments of the kernel.
        adjoint_start: a field like x for the start and the solution of the adjoint system; see
            `ti.linalg.cg`.

    Returns:
        How it ended. If it did not converge, there is a `TaiConvergenceWarning`.
    """
    solver = "ti.ad.implicit"
    check_unknown(x, "the fixed point", solver)
    caller = Caller(solver, tol, max_iterations, x.dtype.name)
    operator = Operator(solver, step, x, args)
    k = get_kernels()

    def solve(field: Any) -> Progress:
        new, rest = scratch(x, "product"), scratch(x, "residual")
        misfit = change = math.inf
        for done in range(1, caller.limit + 1):
            operator.apply(field, new)
            k.subtract(rest, new, field, 1.0)
            k.copy(field, new)
            change, norm = norm_of(rest), norm_of(new)
            if not math.isfinite(change) or not math.isfinite(norm):
                return Progress(done, math.inf, "diverges")
            misfit, change = change, change / norm if norm else change
            if change <= caller.tolerance:
                return Progress(done, change, "", misfit=misfit)
        return Progress(caller.limit, change, "iterations", misfit=misfit)

    def solve_adjoint(g: Any, adjoint: Any) -> Adjoint:
        system = System(functools.partial(_one_minus, operator), g, adjoint, caller.tolerance,
                        caller.limit)  # fmt: skip
        return Adjoint(system.solve(stationary(_add_residual)))

    return recorded.run(caller, operator, solve, solve_adjoint, 1.0, start=adjoint_start)


def _one_minus(operator: Operator, v: Any, result: Any) -> None:
    """Computes result = v - (∂f/∂x)ᵀ v."""
    recorded.pull(operator, v, result)
    get_kernels().subtract(result, v, result, 1.0)


def _add_residual(system: System) -> None:
    """Computes λ = (∂f/∂x)ᵀ λ + g."""
    system.kernels.add(system.x, system.r, 1.0)


def newton(
    residual: Any, x: Any, *, tol: float | None = None, max_iterations: int = 50,
    symmetric: bool = False, linear_tol: float = 1e-3, linear_iterations: int = 1000,
    args: tuple[Any, ...] = (), adjoint_start: Any = None,
) -> SolveInfo:  # fmt: skip
    """Solves F(x) = 0 by Newton's method; a step that makes the residual greater is halved.

    The systems J δ = -F are solved by BiCGSTAB, or by conjugate gradients, with products J v
    from the derivative of the kernel. Under a tape, gradients pass to all fields that the kernel
    reads, by one solve with the transpose of J at the solution.

    Args:
        residual: a kernel `residual(x, r, *args)` that computes field r = F(x); it may read any
            fields.
        x: the initial guess, and the solution afterwards. Under a tape it needs a gradient; the
            derivative with respect to the initial guess is zero.
        tol: bound of ‖F‖ relative to its initial value, or of the next step relative to ‖x‖;
            1e-10 for f64, 1e-5 for f32. Also the tolerance of the adjoint system.
        max_iterations: the most steps.
        symmetric: J is symmetric and positive definite, as that of the gradient of an energy
            near its minimum: conjugate gradients instead of BiCGSTAB.
        linear_tol: relative residual of the linear system of a step.
        linear_iterations: the most iterations for a step, and for the adjoint system.
        args: more arguments of the kernel.
        adjoint_start: a field like x for the start and the solution of the adjoint system; see
            `ti.linalg.cg`.

    Returns:
        How it ended. If it did not converge, there is a `TaiConvergenceWarning`.
    """
    solver = "ti.linalg.newton"
    check_unknown(x, "the solution", solver)
    caller = Caller(solver, tol, max_iterations, x.dtype.name)
    linear = Caller(solver, linear_tol, linear_iterations, x.dtype.name)
    operator = Operator(solver, residual, x, args)
    method = conjugate_gradients if symmetric else bi_conjugate_gradients
    k = get_kernels()

    def solve(field: Any) -> Progress:
        # The point at which kernels are differentiated, F there, and the step.
        point, value = scratch(x, "unknown"), scratch(x, "value")
        step = scratch(x, "step")
        k.copy(point, field)

        def push(v: Any, result: Any) -> None:
            k.copy(point.dual, v)
            with ForwardMode():
                operator.push(point)
            k.copy(result, operator.image.dual)

        operator.apply(point, value)
        norm = norm_of(value)
        if not math.isfinite(norm):
            return Progress(0, norm, "not finite")
        first, done, reason = norm, 0, ""
        measure = 1.0 if norm else 0.0
        while measure > caller.tolerance:
            if done == caller.limit:
                reason = "iterations"
                break
            done += 1
            step.fill(0)
            inner = System(push, value, step, linear.tolerance, linear.limit).solve(method)
            if not inner.reason:
                change, size = norm_of(step), norm_of(point)
                if change <= caller.tolerance * size:
                    # The solution is as accurate as F can tell, as is a start that is a solution
                    # already.
                    measure = change / size
                    break
            length = 1.0
            for _ in range(_HALVINGS):
                k.copy(field, point)
                k.add(field, step, -length)
                operator.apply(field, value)
                new = norm_of(value)
                if new <= (1 - 0.25 * length) * norm:
                    break
                length /= 2
            else:
                k.copy(field, point)
                reason = "no descent"
                break
            k.copy(point, field)
            norm = new
            measure = norm / first
        return Progress(done, measure, reason, misfit=norm)

    def solve_adjoint(g: Any, adjoint: Any) -> Adjoint:
        pull = functools.partial(recorded.pull, operator)
        return Adjoint(System(pull, g, adjoint, caller.tolerance, linear.limit).solve(method))

    return recorded.run(caller, operator, solve, solve_adjoint, -1.0, start=adjoint_start)
