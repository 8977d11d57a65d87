"""The part of a gradient that the solution of a singular system can follow.

If A is singular, x moves within the range of Aᵀ only, but for its start. So the adjoint system
Aᵀ λ = g has a solution for the part of g in that range alone, and the rest has no effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from .krylov import minimal_residuals
from .operators import Operator, scratch
from .report import Caller
from .system import System
from .vectors import get_kernels

# If ‖A r‖ / (‖A‖ ‖r‖) is less than this number, r counts as a vector of the null space.
_IN_NULL_SPACE = {"f32": 1e-5, "f64": 1e-8}
_UNIT = {"f32": 2.0**-23, "f64": 2.0**-52}


def project(
    operator: Operator, pull: Callable[[Any, Any], None], g: Any, symmetric: bool, caller: Caller
) -> float:
    """Removes from g its component in the null space of A.

    Args:
        operator: A.
        pull: pull(v, w) writes Aᵀ v to w.
        g: the gradient; changed.
        symmetric: A is symmetric.
        caller: the name of the solver, and the place of its call.

    Returns:
        The norm of that part by that of g; 0 if there is none, and g is as it was.
    """
    k = get_kernels()
    size = math.sqrt(k.dot(g, g))
    rest = scratch(operator.x, "solution")
    if not 0 < size < math.inf:
        return 0.0
    if symmetric:
        # What MINRES leaves.
        guess = scratch(operator.x, "image_of_null")
        guess.fill(0)
        system = System(pull, g, guess, caller.tolerance, caller.limit)
        system.solve(minimal_residuals)
        pull(guess, rest)
        k.subtract(rest, g, rest, 1.0)
        is_null = _is_null(pull, rest)
    if not symmetric or not is_null:
        is_null = _descend(operator, pull, g, rest, caller)
    part = math.sqrt(k.dot(rest, rest)) / size
    if not is_null or not 10 * caller.tolerance < part < math.inf:
        return 0.0
    k.subtract(g, g, rest, 1.0)
    return part


def _is_null(apply: Callable[[Any, Any], None], v: Any) -> bool:
    """Whether A v is zero except for rounding."""
    k = get_kernels()
    noise, image = scratch(v, "kept"), scratch(v, "last")
    apply(v, image)
    small, size = k.dot(image, image), k.dot(v, v)
    k.make_noise(noise)
    apply(noise, image)
    norm = k.dot(image, image) / k.dot(noise, noise)
    return small <= _IN_NULL_SPACE[v.dtype.name] ** 2 * norm * size


def _descend(
    operator: Operator, pull: Callable[[Any, Any], None], g: Any, r: Any, caller: Caller
) -> bool:
    """r = g - Aᵀ λ for the λ that makes it least, by conjugate gradients for A Aᵀ λ = A g.

    Whether r is in the null space of A then.
    """
    k = get_kernels()
    s, p, q = (scratch(r, role) for role in ("residual", "direction", "product"))
    try:
        k.copy(r, g)
        operator.apply(r, s)
        k.copy(p, s)
        square = first = k.dot(s, s)
        whole = rest = k.dot(r, r)
        goal = (0.1 * _IN_NULL_SPACE[r.dtype.name]) ** 2
        least = (4 * _UNIT[r.dtype.name]) ** 2
        for _ in range(caller.limit):
            # A r must be small next to r, of which little may be left, and not next to g.
            if not max(goal * rest / whole, least) * first < square < math.inf:
                break
            pull(p, q)
            length = k.dot(q, q)
            if not length > 0:
                break
            k.add(r, q, -square / length)
            rest = k.dot(r, r)
            operator.apply(r, s)
            last, square = square, k.dot(s, s)
            k.turn(p, s, square / last, q, 0.0)
        return _is_null(operator.apply, r)
    finally:
        # Applies the operator once more, so that fields that the kernel writes besides hold their
        # values at the solution again.
        operator.apply(operator.x, operator.image)
