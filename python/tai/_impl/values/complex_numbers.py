"""Complex numbers as vectors of two: the real and the imaginary part."""

from __future__ import annotations

from typing import Any

from . import ops
from .matrix import Matrix


def cmul(a: Any, b: Any) -> Any:
    """a b."""
    return Matrix([a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]])


def cconj(z: Any) -> Any:
    """The conjugate."""
    return Matrix([z[0], -z[1]])


def cinv(z: Any) -> Any:
    """1 / z, also where the square of its length leaves the range of floats."""
    length = z.norm()
    return cconj(z / length) / length


def cdiv(a: Any, b: Any) -> Any:
    """a / b, also where the square of the length of b leaves the range of floats."""
    length = b.norm()
    return cmul(a / length, cconj(b / length))


def csqrt(z: Any) -> Any:
    """The principal square root; that of a negative real number has a positive imaginary part."""
    # The larger of the real and imaginary parts is computed first, and the smaller one from it,
    # without cancellation.
    large = ops.sqrt(0.5 * (z.norm() + ops.abs(z[0])))
    small = 0.5 * ops.abs(z[1]) / ops.select(large > 0, large, 1.0)
    right = z[0] >= 0
    above = ops.select(right, small, large)
    return Matrix([ops.select(right, large, small), ops.select(z[1] < 0, -above, above)])


def cexp(z: Any) -> Any:
    """e to the power of the complex number z."""
    return ops.exp(z[0]) * Matrix([ops.cos(z[1]), ops.sin(z[1])])


def clog(z: Any) -> Any:
    """The principal logarithm of a complex number: its imaginary part is between -π and π."""
    return Matrix([ops.log(z.norm()), ops.atan2(z[1], z[0])])


def cpow(z: Any, n: Any) -> Any:
    """z to the power of a real n; 0 for z = 0."""
    angle = ops.atan2(z[1], z[0]) * n
    length = z.norm()
    power = ops.select(length > 0, ops.pow(length, n), 0.0)
    return power * Matrix([ops.cos(angle), ops.sin(angle)])
