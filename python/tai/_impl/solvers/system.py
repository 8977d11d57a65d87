"""A linear system A x = b, where A is a function from a field to a field, and how its solve ends.

Methods solve for x / scale, where `scale` is a power of two near the largest element of b, so that
squares neither overflow nor vanish. If they fail for an operator whose norm is extreme, they try
again with the operator divided by a power of two near its norm.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from .operators import scratch
from .vectors import get_kernels

# The reason that a method gives if it must restart from the present point.
BEGIN_AGAIN = "begin again"
# Reasons for an early end after which a restart may help, and the greatest number of restarts.
_MAY_PASS = {BEGIN_AGAIN, "diverges", "breakdown"}
_RESTARTS = 4
# The reasons of a failure that can mean that the operator is singular.
MAY_BE_SINGULAR = {"indefinite", "diverges", "stagnates", "iterations", "breakdown",
                   "inconsistent"}  # fmt: skip
# Reasons for an early end that may be caused by an operator that is not symmetric.
_MAY_BE_ASYMMETRIC = {*MAY_BE_SINGULAR, "preconditioner"}
# For each type, the least asymmetry of an operator that rounding does not explain.
_ASYMMETRY = {"f32": 1e-3, "f64": 1e-8}
# The least binary exponent of the norm of an operator, or of its inverse, with which squares of
# products may overflow or vanish.
_EXTREME = {"f32": 40, "f64": 200}
# The solution is saved each time its residual has fallen by this factor.
_KEEP_EACH = 0.1


class Progress(NamedTuple):
    """The end of an iteration: `reason` says why it stopped before the tolerance, or is empty.

    Linear systems have a backward error, too, the bound from below of the norm of A in it, and
    ‖b - A x‖.
    """

    iterations: int
    residual: float
    reason: str
    backward_error: float = math.nan
    norm: float = math.nan
    misfit: float = math.nan


class Method(NamedTuple):
    """An iterative method: run(system, residual, limit) improves the solution.

    Attributes:
        run: starts from `system.x` and `system.r`, the residual there.
        symmetric: it needs a symmetric operator.
        monotone: the residual never grows.
        stationary: its steps do not depend on products alone.
    """

    run: Callable[[System, float, int], Progress]
    symmetric: bool = False
    monotone: bool = False
    stationary: bool = False


def _power(exponent: int) -> float:
    """2 to the exponent, or the nearest power that f64 can hold."""
    return math.ldexp(1.0, min(max(exponent, -1074), 1023))


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
    """A linear system A x = b, and the state of its iterative solution.

    Args:
        apply: apply(p, q) writes A p to q.
        b, x: fields; x holds the start, and the solution afterwards.
        tolerance: for the norm of b - A x by that of b.
        limit: the most iterations.
        precondition: precondition(r, z) writes about A⁻¹ r to z; or None.
    """

    def __init__(
        self, apply: Callable[[Any, Any], None], b: Any, x: Any, tolerance: float, limit: int,
        precondition: Callable[[Any, Any], None] | None = None,
    ):  # fmt: skip
        self._apply, self.b, self.x = apply, b, x
        self.tolerance, self.limit = tolerance, limit
        self._precondition = precondition
        # The exponent of the power of two by which the operator is divided.
        self._exponent = 0
        self.kernels = get_kernels()
        self.r, self.p, self.q = (scratch(x, role) for role in ("residual", "direction", "product"))
        # A bound from below of the norm of A: the greatest of ‖A v‖ / ‖v‖ that is known.
        self.operator_norm = 0.0
        # The number of times that a method has begun again.
        self.restarts = 0
        self._kept = math.inf

    def apply(self, p: Any, q: Any) -> None:
        """q = A p, where A is divided by its power of two."""
        self._apply(p, q)
        if self._exponent:
            self.kernels.scale(q, q, _power(-self._exponent))

    @property
    def precondition(self) -> Callable[[Any, Any], None] | None:
        """About the inverse of what `apply` does, or None."""
        plain = self._precondition
        if plain is None or not self._exponent:
            return plain

        def scaled(r: Any, z: Any) -> None:
            plain(r, z)
            self.kernels.scale(z, z, _power(self._exponent))

        return scaled

    def solve(self, method: Method) -> Progress:
        """Runs a method until the residual itself, computed anew, is small enough.

        The solution is the best that the method has passed, to a factor of ten, and never worse
        than zero.
        """
        k = self.kernels
        largest = k.largest(self.b)
        if largest == 0 and k.dot(self.b, self.b) == 0:
            self.x.fill(0)
            return Progress(0, 0.0, "", 0.0, 0.0, 0.0)
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
        done, residual, reason = self._run(method)
        # A norm of zero is one whose square has vanished; with a preconditioner none is noted.
        has_vanished = done > 0 and self.operator_norm == 0 and self._precondition is None
        if (reason or has_vanished) and not method.stationary and self._divide_operator():
            self.x.fill(0)
            steps, residual, reason = self._run(method)
            done += steps
        if reason and reason != "not finite":
            if not residual <= 1.0 or self._is_noise(residual):
                self.x.fill(0)
                residual = self.compute_residual()
            if method.symmetric and reason in _MAY_BE_ASYMMETRIC and self._is_asymmetric():
                reason = "asymmetric"
                # The method's recurrences give the operator's norm only for symmetric operators.
                self.operator_norm = 0.0
        error = self._compute_backward_error(residual)
        # The two factors together may be representable where one is not.
        k.scale(self.x, self.x, _power(-self._exponent - math.frexp(inverse)[1] + 1))
        misfit = residual * self.norm / inverse
        norm = self.operator_norm * _power(self._exponent)
        return Progress(done, residual, reason, error, norm, misfit)

    def _divide_operator(self) -> bool:
        """Divides the operator by a power of two near its norm, if that is extreme.

        Returns whether it did.
        """
        noise, image = scratch(self.x, "kept"), scratch(self.x, "last")
        self.kernels.make_noise(noise)
        self._apply(noise, image)
        largest = self.kernels.largest(image)
        if largest == 0 or not math.isfinite(largest):
            return False
        exponent = math.frexp(largest)[1]
        if abs(exponent) < _EXTREME[self.x.dtype.name]:
            return False
        self._exponent, self.operator_norm, self.restarts = exponent, 0.0, 0
        return True

    def _run(self, method: Method) -> tuple[int, float, str]:
        done, last, reason = 0, math.inf, ""
        residual = self.compute_residual()
        if not math.isfinite(residual):
            # A start that is not finite is replaced by zero, but only once.
            self.x.fill(0)
            residual = self.compute_residual()
            if not math.isfinite(residual):
                return 0, residual, "not finite"
        while residual > self.tolerance:
            if reason in _MAY_PASS and self.restarts < _RESTARTS:
                self.restarts += 1
                # The residual need not have fallen at that point.
                last, reason = math.inf, ""
            if reason or done >= self.limit:
                break
            if residual > 0.5 * last:
                reason = "stagnates"
                break
            last = residual
            if not method.monotone:
                self._kept = math.inf
                self.keep(residual)
            found = method.run(self, residual, self.limit - done)
            done, reason = done + found.iterations, found.reason
            residual = self._take_the_best(method)
        if residual <= self.tolerance:
            return done, residual, ""
        if reason == BEGIN_AGAIN:
            reason = "stagnates"
        return done, residual, reason or "iterations"

    def _is_noise(self, residual: float) -> bool:
        """Whether rounding errors of A x are as large as a residual that has hardly fallen.

        Then x has run away along a null space, and is worth less than zero.
        """
        if residual <= 0.1:
            return False
        epsilon = 2.0**-52 if self.x.dtype.name == "f64" else 2.0**-23
        size = math.sqrt(self.kernels.dot(self.x, self.x))
        return not 1e3 * epsilon * self.operator_norm * size <= residual * self.norm

    def keep(self, residual: float) -> None:
        """Saves the solution if its relative residual is much less than that of the last saved
        one.
        """
        if residual <= _KEEP_EACH * self._kept:
            self.kernels.copy(scratch(self.x, "kept"), self.x)
            self._kept = residual

    def _take_the_best(self, method: Method) -> float:
        """Takes the present or the saved solution, whichever has the smaller residual; returns that
        residual.
        """
        residual = self.compute_residual()
        if method.monotone or residual <= self._kept:
            return residual
        kept, last = scratch(self.x, "kept"), scratch(self.x, "last")
        self.kernels.copy(last, self.x)
        self.kernels.copy(self.x, kept)
        better = self.compute_residual()
        if better <= residual or not math.isfinite(residual):
            return better
        self.kernels.copy(self.x, last)
        return self.compute_residual()

    def compute_residual(self) -> float:
        """r = b - A x, and its norm by that of b."""
        self.apply(self.x, self.q)
        return math.sqrt(self.kernels.subtract(self.r, self.scaled_b, self.q, 1.0)) / self.norm

    def note_norm(self, norm: float) -> None:
        """Notes the ratio ‖A v‖ / ‖v‖ of any vector as a lower bound of the operator's norm."""
        if self.operator_norm < norm < math.inf:
            self.operator_norm = norm

    def _compute_backward_error(self, residual: float) -> float:
        """‖b - A x‖ / (‖A‖ ‖x‖ + ‖b‖), by a norm of A that is too small rather than too large.

        `q` holds A x.
        """
        size = norm_of(self.x)
        if 0 < size < math.inf:
            self.note_norm(norm_of(self.q) / size)
            return residual * self.norm / (self.operator_norm * size + self.norm)
        return residual

    def _is_asymmetric(self) -> bool:
        """Whether ⟨A u, A u⟩ and ⟨u, A A u⟩ differ for a vector u without structure."""
        k, u, v, w = self.kernels, self.p, scratch(self.x, "kept"), scratch(self.x, "last")
        k.make_noise(u)
        self.apply(u, v)
        square = k.dot(v, v)
        self.apply(v, w)
        other, size = k.dot(u, w), math.sqrt(k.dot(u, u) * k.dot(w, w))
        difference = abs(square - other)
        return difference > _ASYMMETRY[self.x.dtype.name] * max(square, size)
