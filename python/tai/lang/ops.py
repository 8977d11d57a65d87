"""`ti.lang.ops`: functions on numbers."""

from .._impl.values.ops import (
    abs,
    acos,
    asin,
    atan2,
    atomic_add,
    atomic_and,
    atomic_max,
    atomic_min,
    atomic_or,
    atomic_sub,
    atomic_xor,
    cast,
    ceil,
    cos,
    exp,
    floor,
    log,
    max,
    min,
    pow,
    random,
    round,
    rsqrt,
    select,
    sin,
    sqrt,
    tan,
    tanh,
)

__all__ = [
    "abs", "acos", "asin", "atan2", "atomic_add", "atomic_and", "atomic_max", "atomic_min",
    "atomic_or", "atomic_sub", "atomic_xor", "cast", "ceil", "cos", "exp", "floor", "log", "max",
    "min", "pow", "random", "round", "rsqrt", "select", "sin", "sqrt", "tan", "tanh",
]  # fmt: skip
