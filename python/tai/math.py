"""`ti.math`: vector types and shader-like functions, for kernels and for Python."""

from __future__ import annotations

import math as _math
from typing import Any

from ._impl.base import dtypes
from ._impl.base.keywords import check_keywords, suggest_names
from ._impl.values import ops
from ._impl.values.complex_numbers import cconj, cdiv, cexp, cinv, clog, cmul, cpow, csqrt
from ._impl.values.matrix import Matrix
from ._impl.values.ops import (
    acos,
    acosh,
    asin,
    asinh,
    atan,
    atan2,
    atanh,
    cbrt,
    ceil,
    copysign,
    cos,
    cosh,
    erf,
    erfc,
    exp,
    exp2,
    expm1,
    floor,
    hypot,
    log,
    log1p,
    log2,
    log10,
    max,
    min,
    pow,
    round,
    sin,
    sinh,
    sqrt,
    tan,
    tanh,
    trunc,
)
from ._impl.values.rotations import (
    rot_by_axis,
    rot_yaw_pitch_roll,
    rotation2d,
    rotation3d,
    scale,
    translate,
)
from ._impl.values.types import matrix, vector

pi, e, inf, nan = _math.pi, _math.e, _math.inf, _math.nan

vec2, vec3, vec4 = (vector(n, float) for n in (2, 3, 4))
ivec2, ivec3, ivec4 = (vector(n, int) for n in (2, 3, 4))
uvec2, uvec3, uvec4 = (vector(n, dtypes.u32) for n in (2, 3, 4))
mat2, mat3, mat4 = (matrix(n, n, float) for n in (2, 3, 4))


def clamp(x: Any, low: Any, high: Any) -> Any:
    """Returns x, but at least `low` and at most `high`."""
    # In this order, x wins ties at both ends, and so gets the derivative there.
    return min(high, max(low, x))


def mix(x: Any, y: Any, a: Any) -> Any:
    """x for a = 0, y for a = 1, on the line between them otherwise."""
    return x * (1.0 - a) + y * a


def sign(x: Any) -> Any:
    """-1, 0 or 1."""
    return ops.select(x > 0, 1.0, ops.select(x < 0, -1.0, 0.0))


def fract(x: Any) -> Any:
    """x - floor(x)."""
    return x - floor(x)


def step(edge: Any, x: Any) -> Any:
    """Returns 0 below the edge, else 1."""
    return ops.select(x < edge, 0.0, 1.0)


def smoothstep(edge0: Any, edge1: Any, x: Any) -> Any:
    """Returns a smooth step from 0 to 1 between two edges."""
    t = clamp((x - edge0) / (edge1 - edge0), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def dot(x: Any, y: Any) -> Any:
    """Σ xᵢ yᵢ."""
    return x.dot(y)


def cross(x: Any, y: Any) -> Any:
    """The cross product."""
    return x.cross(y)


def length(x: Any) -> Any:
    """Returns the norm of a vector."""
    return x.norm()


def distance(x: Any, y: Any) -> Any:
    """Returns the norm of x - y."""
    return (x - y).norm()


def normalize(x: Any) -> Any:
    """The vector of norm 1 in the direction of x, and zero for zero."""
    return x.normalized()


def reflect(x: Any, n: Any) -> Any:
    """Returns x reflected at the plane with the unit normal n."""
    return x - 2.0 * x.dot(n) * n


def refract(x: Any, n: Any, eta: Any) -> Any:
    """The refracted direction of x at the unit normal n; zero for total reflection."""
    d = x.dot(n)
    k = 1.0 - eta * eta * (1.0 - d * d)
    safe = max(k, 0.0)
    bent = eta * x - (eta * d + sqrt(safe)) * n
    return ops.select(k < 0.0, 0.0 * x, bent)


def degrees(x: Any) -> Any:
    return x * (180.0 / pi)


def radians(x: Any) -> Any:
    return x * (pi / 180.0)


def isnan(x: Any) -> Any:
    """Returns whether x is not a number."""
    return x != x


def isinf(x: Any) -> Any:
    """Whether x is infinite."""
    return ops.abs(x) == inf


def inverse(m: Any) -> Any:
    return m.inverse()


def determinant(m: Any) -> Any:
    return m.determinant()


def eye(n: int) -> Any:
    """Returns the identity matrix of size n."""
    return Matrix.identity(float, n)


def mod(x: Any, y: Any) -> Any:
    """x - y floor(x / y), which has the sign of y."""
    return x % y


def vdir(angle: Any) -> Any:
    """Returns the unit vector at an angle from the first axis."""
    return Matrix([cos(angle), sin(angle)])


def popcnt(x: Any) -> Any:
    """Returns the number of set bits of an integer."""
    return ops.count_bits("popcnt", x)


def clz(x: Any) -> Any:
    """The number of leading zero bits of an integer; its width for 0."""
    return ops.count_bits("clz", x)


__all__ = [
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "cconj", "cdiv", "ceil",
    "cexp", "cinv", "clamp", "clog", "clz", "cmul", "copysign", "cos", "cosh", "cpow", "cross",
    "csqrt", "degrees", "determinant", "distance", "dot", "e", "erf", "erfc", "exp", "exp2",
    "expm1", "eye", "floor", "fract", "hypot", "inf", "inverse", "isinf", "isnan", "ivec2", "ivec3",
    "ivec4", "length", "log", "log10", "log1p", "log2", "mat2", "mat3", "mat4", "max", "min", "mix",
    "mod", "nan", "normalize", "pi", "popcnt", "pow", "radians", "reflect", "refract",
    "rot_by_axis", "rot_yaw_pitch_roll", "rotation2d", "rotation3d", "round", "scale", "sign",
    "sin", "sinh", "smoothstep", "sqrt", "step", "tan", "tanh", "translate", "trunc", "uvec2",
    "uvec3", "uvec4", "vdir", "vec2", "vec3", "vec4",
]  # fmt: skip

_here = [name for name in __all__ if getattr(globals()[name], "__module__", None) == __name__]
check_keywords(globals(), _here)
suggest_names(globals())
