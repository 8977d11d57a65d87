"""Krylov methods for A x = b, where A is a function from a field to a field.

They solve for x / scale, where `scale` is a power of two near the largest element of b, so that
squares neither overflow nor vanish.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from .operators import scratch
from .vectors import get_kernels

# The reason of a method that has to begin again from where it is.
_BEGIN_AGAIN = "begin again"


class Progress(NamedTuple):
    """The end of an iteration: `reason` says why it stopped before the tolerance, or is empty."""

    iterations: int
    residual: float
    reason: str


def norm_of(field: Any) -> float:
    """The norm of a field, also where squares of its elements overflow or vanish."""
    k = get_kernels()
    square = k.dot(field, field)
    if 1e-280 < square < 1e280:
        return math.sqrt(square)
    largest = k.largest(field)
    if largest == 0 or not math.isfinite(largest):
        return math.sqrt(square)  # zero, infinite, or NaN
    inverse = math.ldexp(1.0, min(-math.frexp(largest)[1], 1022))
    scaled = scratch(field, "scaled")
    k.scale(scaled, field, inverse)
    return math.sqrt(k.dot(scaled, scaled)) / inverse


class System:
    """A x = b.

    Args:
        apply: apply(p, q) writes A p to q.
        b, x: fields; x holds the start, and the solution afterwards.
        tolerance: for the norm of b - A x by that of b.
        limit: the most iterations.
    """

    def __init__(
        self, apply: Callable[[Any, Any], None], b: Any, x: Any, tolerance: float, limit: int
    ):
        self.apply, self.b, self.x = apply, b, x
        self.tolerance, self.limit = tolerance, limit
        self.kernels = get_kernels()
        self.r, self.p, self.q = (scratch(x, role) for role in ("residual", "direction", "product"))

    def solve(self, method: Callable[[System, float, int], Progress]) -> Progress:
        """Runs a method until the residual itself, computed anew, is small enough."""
        k = self.kernels
        largest = k.largest(self.b)
        if largest == 0 and k.dot(self.b, self.b) == 0:
            self.x.fill(0)
            return Progress(0, 0.0, "")
        if not math.isfinite(largest):
            return Progress(0, math.nan, "not finite")
        scale = math.ldexp(1.0, math.frexp(largest)[1])
        inverse = 1 / scale if math.isfinite(1 / scale) else math.ldexp(1.0, 1022)
        self.scaled_b = scratch(self.x, "right_side")
        k.scale(self.scaled_b, self.b, inverse)
        k.scale(self.x, self.x, inverse)
        self.norm = math.sqrt(k.dot(self.scaled_b, self.scaled_b))
        if not math.isfinite(self.norm):
            return Progress(0, math.nan, "not finite")
        done, last, reason = 0, math.inf, ""
        while True:
            residual = self.compute_residual()
            if not math.isfinite(residual):
                # A start that is not finite is replaced by zero, once.
                if done == 0 and last == math.inf:
                    self.x.fill(0)
                    last = residual
                    continue
                reason = reason or "diverges"
            if residual <= self.tolerance or reason or done >= self.limit:
                break
            if residual > 0.5 * last:
                reason = "stagnates"
                break
            last = residual
            found = method(self, residual, self.limit - done)
            done, reason = done + found.iterations, found.reason
            if reason == _BEGIN_AGAIN:
                # The residual need not have fallen by then.
                last, reason = math.inf, ""
        k.scale(self.x, self.x, 1 / inverse)
        if residual <= self.tolerance:
            reason = ""
        elif not reason:
            reason = "iterations"
        return Progress(done, residual, reason)

    def compute_residual(self) -> float:
        """r = b - A x, and its norm by that of b."""
        self.apply(self.x, self.q)
        return math.sqrt(self.kernels.subtract(self.r, self.scaled_b, self.q, 1.0)) / self.norm


def conjugate_gradients(system: System, residual: float, limit: int) -> Progress:
    """For symmetric positive definite A."""
    k, x, r, p, q = system.kernels, system.x, system.r, system.p, system.q
    goal = (system.tolerance * system.norm) ** 2
    square = (residual * system.norm) ** 2
    k.copy(p, r)
    for step in range(1, limit + 1):
        system.apply(p, q)
        curvature = k.dot(p, q)
        if not curvature > 0:
            return Progress(step, residual, "indefinite" if curvature <= 0 else "diverges")
        alpha = square / curvature
        last, square = square, k.advance(x, p, alpha, r, q, alpha)
        if not math.isfinite(square):
            return Progress(step, math.inf, "diverges")
        if square <= goal:
            return Progress(step, 0.0, "")
        k.turn(p, r, square / last, q, 0.0)
    return Progress(limit, 0.0, "")


def bi_conjugate_gradients(system: System, residual: float, limit: int) -> Progress:
    """BiCGSTAB, for any A that can be inverted."""
    k, x, r, p, v = system.kernels, system.x, system.r, system.p, system.q
    shadow, t = scratch(x, "shadow"), scratch(x, "second_product")
    goal = (system.tolerance * system.norm) ** 2
    k.copy(shadow, r)
    k.copy(p, r)
    rho = k.dot(shadow, r)
    for step in range(1, limit + 1):
        system.apply(p, v)
        sigma = k.dot(shadow, v)
        if sigma == 0 or not math.isfinite(sigma):
            return Progress(step, 0.0, "breakdown" if sigma == 0 else "diverges")
        alpha = rho / sigma
        square = k.advance(x, p, alpha, r, v, alpha)
        if square <= goal:
            return Progress(step, 0.0, "")
        system.apply(r, t)
        length = k.dot(t, t)
        if length == 0 or not math.isfinite(length):
            return Progress(step, 0.0, "breakdown" if length == 0 else "diverges")
        omega = k.dot(t, r) / length
        k.add(x, r, omega)
        k.add(r, t, -omega)
        square = k.dot(r, r)
        if not math.isfinite(square):
            return Progress(step, math.inf, "diverges")
        if square <= goal:
            return Progress(step, 0.0, "")
        last, rho = rho, k.dot(shadow, r)
        if rho == 0 or omega == 0:
            # The residual is orthogonal to the shadow.
            return Progress(step, 0.0, _BEGIN_AGAIN)
        k.turn(p, r, rho / last * (alpha / omega), v, omega)
    return Progress(limit, 0.0, "")


def jacobi_sweeps(diagonal: Any, damping: float) -> Callable[[System, float, int], Progress]:
    """x += damping (b - A x) / diagonal, for A whose diagonal outweighs the rest."""
    return stationary(lambda system: system.kernels.sweep(system.x, system.r, diagonal, damping))


def stationary(sweep: Callable[[System], None]) -> Callable[[System, float, int], Progress]:
    """A stationary iteration: the sweep again and again, until it converges or diverges."""

    def method(system: System, residual: float, limit: int) -> Progress:
        first = residual
        for step in range(1, limit + 1):
            sweep(system)
            residual = system.compute_residual()
            if residual <= system.tolerance:
                return Progress(step, residual, "")
            if not residual < 1e6 * max(first, 1.0):
                return Progress(step, residual, "diverges")
        return Progress(limit, residual, "")

    return method
