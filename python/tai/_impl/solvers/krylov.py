"""Krylov methods for A x = b with short recurrences, and stationary iterations."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from .operators import scratch
from .system import BEGIN_AGAIN, Method, Progress, System

# If the residual grows to this multiple of its first value, the method starts again from the best
# point, since rounding errors of the residual grow along with it.
_GROWTH = {"f32": 1e3, "f64": 1e6}
# The growth after which conjugate gradients begin again: the residual may grow by the root of the
# condition number.
_GROWTH_OF_CG = {"f32": 1e5, "f64": 1e10}
# If ‖A r‖ / (‖A‖ ‖r‖) is less than this many rounding units, r counts as a vector of the null
# space.
_NULL = 300
# After the first attempt, BiCGSTAB takes no step of its second kind that is shorter than this part
# of the one that would change the residual by its own size.
_SHORTEST = 0.7


def _conjugate_gradients(system: System, residual: float, limit: int) -> Progress:
    """The method of conjugate gradients, for symmetric positive definite operators."""
    k, x, r, p, q = system.kernels, system.x, system.r, system.p, system.q
    goal = (system.tolerance * system.norm) ** 2
    square = start = (residual * system.norm) ** 2
    most = start * _GROWTH_OF_CG[x.dtype.name] ** 2
    z, rho, precondition = r, square, system.precondition
    if precondition is not None:
        z = scratch(x, "preconditioned")
        precondition(r, z)
        rho = k.dot(r, z)
        if not rho > 0:
            return Progress(0, residual, "preconditioner")
    k.copy(p, z)
    last_alpha, beta = math.inf, 0.0
    for step in range(1, limit + 1):
        system.apply(p, q)
        curvature = k.dot(p, q)
        if not curvature > 0:
            return Progress(step, residual, "indefinite" if curvature <= 0 else "diverges")
        alpha = rho / curvature
        square = k.advance(x, p, alpha, r, q, alpha)
        if not square <= most:
            return Progress(step, math.inf, "diverges")
        if precondition is None:
            # An element of the tridiagonal matrix of Lanczos' process: no eigenvalue is greater.
            system.note_norm(1 / alpha + beta / last_alpha)
        if square <= goal:
            return Progress(step, 0.0, "")
        system.keep(math.sqrt(square) / system.norm)
        last, rho = rho, square
        if precondition is not None:
            precondition(r, z)
            rho = k.dot(r, z)
            if not rho > 0:
                return Progress(step, residual, "preconditioner")
        last_alpha, beta = alpha, rho / last
        k.turn(p, z, beta, q, 0.0)
    return Progress(limit, 0.0, "")


def _bi_conjugate_gradients(system: System, residual: float, limit: int) -> Progress:
    """BiCGSTAB, for any A that can be inverted, with the preconditioner on the right."""
    k, x, r, p, v = system.kernels, system.x, system.r, system.p, system.q
    shadow, t = scratch(x, "shadow"), scratch(x, "second_product")
    precondition = system.precondition
    step_p, step_r = p, r
    if precondition is not None:
        step_p, step_r = scratch(x, "preconditioned"), scratch(x, "second_preconditioned")
    goal = (system.tolerance * system.norm) ** 2
    square = (residual * system.norm) ** 2
    most = square * _GROWTH[x.dtype.name] ** 2
    if system.restarts > 1:
        # The residual has served as the shadow vector and led nowhere, so a random vector replaces
        # it.
        k.make_noise(shadow)
    else:
        k.copy(shadow, r)
    k.copy(p, r)
    rho = k.dot(shadow, r)
    for step in range(1, limit + 1):
        if precondition is not None:
            precondition(p, step_p)
        system.apply(step_p, v)
        sigma = k.dot(shadow, v)
        if sigma == 0 or not math.isfinite(sigma):
            return Progress(step, 0.0, "breakdown" if sigma == 0 else "diverges")
        alpha = rho / sigma
        square = k.advance(x, step_p, alpha, r, v, alpha)
        if square <= goal:
            return Progress(step, 0.0, "")
        if precondition is not None:
            precondition(r, step_r)
        system.apply(step_r, t)
        length = k.dot(t, t)
        if length == 0 or not math.isfinite(length):
            return Progress(step, 0.0, "breakdown" if length == 0 else "diverges")
        if precondition is None and square > 0:
            system.note_norm(math.sqrt(length / square))
        along = k.dot(t, r)
        omega = along / length
        if system.restarts and abs(along) < _SHORTEST * math.sqrt(length * square):
            omega = math.copysign(_SHORTEST * math.sqrt(square / length), along)
        k.add(x, step_r, omega)
        k.add(r, t, -omega)
        square = k.dot(r, r)
        if not square <= most:
            return Progress(step, math.inf, "diverges")
        if square <= goal:
            return Progress(step, 0.0, "")
        system.keep(math.sqrt(square) / system.norm)
        last, rho = rho, k.dot(shadow, r)
        if rho == 0 or omega == 0:
            # The residual is orthogonal to the shadow vector, so the method begins again.
            return Progress(step, 0.0, BEGIN_AGAIN)
        k.turn(p, r, rho / last * (alpha / omega), v, omega)
    return Progress(limit, 0.0, "")


def _minimal_residuals(system: System, residual: float, limit: int) -> Progress:
    """MINRES, for symmetric A, which may be indefinite, or singular if b is in its range."""
    k, x, q = system.kernels, system.x, system.q
    older, newer = scratch(x, "older_residual"), system.r
    w, last_w = system.p, scratch(x, "last_direction")
    z, precondition = newer, system.precondition
    epsilon = 2.0**-52 if x.dtype.name == "f64" else 2.0**-23
    beta = (residual * system.norm) ** 2
    if precondition is not None:
        z = scratch(x, "preconditioned")
        precondition(newer, z)
        beta = k.dot(newer, z)
        if not beta > 0:
            return Progress(0, residual, "preconditioner")
    beta = math.sqrt(beta)
    for field in (older, w, last_w):
        field.fill(0)
    last_beta, dbar, eps_next, phi_bar, cosine, sine = 1.0, 0.0, 0.0, beta, -1.0, 0.0
    goal, norm = system.tolerance / residual * beta, 0.0
    v = scratch(x, "basis_vector")
    for step in range(1, limit + 1):
        k.scale(v, z, 1 / beta)
        system.apply(v, q)
        # Lanczos' process: q = A v - α v - β v₋.
        alpha = k.orthogonalize(q, older, beta / last_beta if step > 1 else 0.0, v)
        square = k.shift(q, newer, alpha / beta, older)
        last_beta = beta
        if precondition is not None:
            precondition(newer, z)
            square = k.dot(newer, z)
            if square < 0:
                return Progress(step, residual, "preconditioner")
        if not math.isfinite(square) or not math.isfinite(alpha):
            return Progress(step, math.inf, "diverges")
        beta = math.sqrt(square)
        column = math.sqrt(alpha**2 + square + (last_beta**2 if step > 1 else 0.0))
        norm = max(norm, column)
        if precondition is None:
            system.note_norm(column)
        # These are the Givens rotations of the least squares problem.
        eps, delta = eps_next, cosine * dbar + sine * alpha
        gamma_bar = sine * dbar - cosine * alpha
        eps_next, dbar = sine * beta, -cosine * beta
        rest = math.hypot(gamma_bar, dbar)
        gamma = math.hypot(gamma_bar, beta) or 1.0
        cosine, sine = gamma_bar / gamma, beta / gamma
        if rest <= _NULL * epsilon * norm:
            # ‖A r‖ = ‖r‖ rest for the present residual r, so r is in the null space of A, and so is
            # the step.
            return Progress(step, residual, "inconsistent")
        phi = cosine * phi_bar
        phi_bar *= sine
        k.step_minres(x, v, last_w, w, eps, delta, 1 / gamma, phi)
        if phi_bar <= goal:
            return Progress(step, 0.0, "")
        if beta <= epsilon * norm:
            return Progress(step, 0.0, BEGIN_AGAIN)
    return Progress(limit, 0.0, "")


conjugate_gradients = Method(_conjugate_gradients, symmetric=True)
bi_conjugate_gradients = Method(_bi_conjugate_gradients)
minimal_residuals = Method(_minimal_residuals, symmetric=True, monotone=True)


def jacobi_sweeps(diagonal: Any, damping: float) -> Method:
    """x += damping (b - A x) / diagonal, for A whose diagonal outweighs the rest."""
    return stationary(lambda system: system.kernels.sweep(system.x, system.r, diagonal, damping))


def stationary(sweep: Callable[[System], None]) -> Method:
    """A stationary iteration: the sweep again and again, until it converges or diverges."""

    def run(system: System, residual: float, limit: int) -> Progress:
        first = residual
        for step in range(1, limit + 1):
            sweep(system)
            residual = system.compute_residual()
            if residual <= system.tolerance:
                return Progress(step, residual, "")
            if not residual < 1e6 * max(first, 1.0):
                # Another start would fail in the same way, so no restarts are left.
                system.restarts = limit
                return Progress(step, residual, "diverges")
            system.keep(residual)
        return Progress(limit, residual, "")

    return Method(run, stationary=True)
