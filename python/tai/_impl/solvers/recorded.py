"""Solutions under a tape: the solve is not recorded; its gradient is another solve.

The record of a solution x of R(x, θ) = 0 is, in this order: the solve, into a field of the
solvers; a copy of it to x; the kernel at x; and a function that runs in reverse only. That one
solves Jᵀ λ = x.grad, J = ∂R/∂x, and gives -λ to the kernel's own adjoint, which the tape runs
next: it adds -(∂R/∂θ)ᵀ λ to the gradients of all that the kernel reads. The tape saves the values
that adjoints read, as for any kernel.

In forward mode, the tangents of a linear solve A x = b are those of two more solves:
A ẋ = ḃ - Ȧ x beside the first, and Aᵀ λ̇ = ġ - Ȧᵀ λ beside the adjoint one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ..ad.mode import suspended
from ..ad.tape import run_unrecorded
from ..base import state
from .operators import Operator, check_alike, check_unknown, scratch
from .report import Caller, SolveInfo
from .system import Progress, norm_of
from .vectors import get_kernels


class Adjoint(NamedTuple):
    """How the solve for a gradient ended, and the relative norm of the component of the gradient
    that was removed because no solution can follow it.
    """

    progress: Progress
    projected: float = 0.0


def run(
    caller: Caller,
    operator: Operator,
    solve: Callable[[Any], Progress],
    solve_adjoint: Callable[[Any, Any], Adjoint],
    sign: float,
    right_side: Any = None,
    solve_tangent: Callable[[Any, Any], Progress] | None = None,
    start: Any = None,
) -> SolveInfo:
    """Runs a solver, and records the solve if a tape is recording.

    Args:
        caller: the name of the solver, and the place of its call.
        operator: the kernel; its unknown is solved for.
        solve: improves the field that it is given to a solution.
        solve_adjoint: solve_adjoint(g, λ) solves the adjoint system.
        sign: of λ where the adjoint of the kernel gets it: -1 for a residual.
        right_side: a field whose gradient gets λ, or None.
        solve_tangent: solve_tangent(t, d) solves A d = t; for forward mode.
        start: a field of λ, in which the adjoint solve begins and leaves its solution, or None.
    """
    if start is not None:
        check_unknown(start, "the solution of the adjoint system", caller.solver)
        check_alike(start, operator.x, caller.solver)
    info = SolveInfo(solver=caller.solver, x=operator.x, place=(caller.filename, caller.lineno))
    tape: Any = state.tape
    x = operator.x
    if tape is None:
        with suspended():
            progress = solve(x)
        info.take(progress)
        caller.warn(operator, progress, "field", False)
        if state.forward and solve_tangent is not None:
            _take_tangent(caller, operator, solve_tangent, x)
        return info
    operator.check_differentiable()
    state.of_thread.solves.append(info)
    has_report = state.of_thread.rounding is not None
    kernels = get_kernels()
    has_tangents = state.forward
    found = solution = scratch(x, "solution")
    if has_tangents:
        solution = scratch(x, "solution_tangent")

    def is_forward() -> bool:
        if state.forward and not has_tangents:
            caller.refuse_tangents(" on a tape that was recorded outside of it")
        return bool(state.forward)

    def forward() -> None:
        with suspended():
            kernels.copy(found, x)
            progress = solve(found)
        info.take(progress)
        caller.warn(operator, progress, "field", True)
        if has_tangents:
            # A tape saves tangents where values with them are written.
            kernels.copy(solution, found)
        if is_forward() and solve_tangent is not None:
            _take_tangent(caller, operator, solve_tangent, solution)

    run_unrecorded(tape, forward)
    tape.record(forward, None)
    kernels.copy(x, solution)
    operator.record()

    def backward() -> None:
        is_tangent = is_forward()
        g, seed = scratch(x, "seed"), scratch(x, "tangent_seed")
        adjoint = scratch(x, "adjoint_tangent" if has_tangents else "adjoint")
        with suspended():
            kernels.copy(g, x.grad)
            if is_tangent:
                kernels.copy(seed, x.grad.dual)
            if start is None:
                adjoint.fill(0)
            else:
                kernels.copy(adjoint, start)
            progress, projected = solve_adjoint(g, adjoint)
            if start is not None:
                kernels.copy(start, adjoint)
            if progress.reason == "not finite":
                # The adjoint becomes NaN, so that NaN spreads as it would have without a solver.
                adjoint.fill(math.nan)
            if has_report:
                info.effect = info.misfit * norm_of(adjoint)
        info.adjoint = SolveInfo(solver=caller.solver, x=operator.x.grad, projected=projected)
        info.adjoint.take(progress)
        caller.warn(operator, progress, "the gradient of field", False)
        if is_tangent:
            _take_tangent_of_adjoint(caller, operator, solve_adjoint, seed, adjoint)
            x.grad.dual.fill(0)
        if right_side is not None and has_gradient(right_side):
            kernels.add(right_side.grad, adjoint, 1.0)
        x.grad.fill(0)
        kernels.scale(operator.image.grad, adjoint, sign)

    tape.record(lambda: None, backward)
    return info


def _take_tangent(
    caller: Caller, operator: Operator, solve_tangent: Callable[[Any, Any], Progress], x: Any
) -> None:
    """Computes x.dual, the solution of A ẋ = ḃ - Ȧ x."""
    dual = x.dual
    if dual is None or dual.snode is None:
        return  # a constant of forward mode
    k = get_kernels()
    point = scratch(x, "unknown")
    with suspended():
        k.copy(point, x)
        point.dual.fill(0)
    operator.push_parameters(point)
    with suspended():
        rest, tangent = scratch(x, "seed"), scratch(x, "adjoint")
        k.copy(rest, operator.image.dual)
        tangent.fill(0)
        progress = solve_tangent(rest, tangent)
        k.copy(dual, tangent)
    caller.warn(operator, progress, "the tangent of field", False)


def _take_tangent_of_adjoint(
    caller: Caller, operator: Operator, solve_adjoint: Callable[[Any, Any], Adjoint],
    seed: Any, adjoint: Any,
) -> None:  # fmt: skip
    """Computes the tangent of the adjoint λ, the solution of Aᵀ λ̇ = ġ - Ȧᵀ λ, where seed is ġ."""
    x, k = operator.x, get_kernels()
    with suspended():
        adjoint.dual.fill(0)
    operator.pull_tangent(adjoint)
    with suspended():
        k.subtract(seed, seed, x.grad.dual, 1.0)
        tangent = scratch(x, "adjoint")
        tangent.fill(0)
        progress, _ = solve_adjoint(seed, tangent)
        k.copy(adjoint.dual, tangent)
    caller.warn(operator, progress, "the tangent of the gradient of field", False)


def subtract_from_tangent(b: Any, rest: Any) -> None:
    """Computes rest = ḃ - rest; a right-hand side without a dual is constant."""
    k = get_kernels()
    dual = b.dual
    if dual is None or dual.snode is None:
        k.scale(rest, rest, -1.0)
    else:
        k.subtract(rest, dual, rest, 1.0)


def pull(operator: Operator, v: Any, result: Any) -> None:
    """Computes result = Jᵀ v, through the gradient of the unknown."""
    kernels = get_kernels()
    operator.x.grad.fill(0)
    kernels.copy(operator.image.grad, v)
    operator.pull()
    kernels.copy(result, operator.x.grad)


def has_gradient(field: Any) -> bool:
    """Whether the gradient of the field exists in memory."""
    grad = field.grad
    return grad is not None and grad.snode is not None
