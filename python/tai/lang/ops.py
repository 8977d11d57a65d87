"""`ti.lang.ops`: functions on numbers, and operators as functions."""

import operator
from collections.abc import Callable
from typing import Any

from .._impl.base import state
from .._impl.values.exponents import frexp
from .._impl.values.ops import (
    abs,
    acos,
    acosh,
    asin,
    asinh,
    atan,
    atan2,
    atanh,
    atomic_add,
    atomic_and,
    atomic_max,
    atomic_min,
    atomic_or,
    atomic_sub,
    atomic_xor,
    bit_cast,
    bit_shr,
    cast,
    cbrt,
    ceil,
    copysign,
    cos,
    cosh,
    erf,
    erfc,
    exp,
    floor,
    hypot,
    log,
    log10,
    logical_and,
    logical_not,
    logical_or,
    max,
    min,
    pow,
    random,
    round,
    rsqrt,
    select,
    sin,
    sinh,
    sqrt,
    tan,
    tanh,
    trunc,
)


def _as_function(name: str, symbol: str, plain: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Returns the function `a symbol b`, which works in Python and in kernels.

    Args:
        name: of the function.
        symbol: of the operator.
        plain: the operator for plain numbers and matrices.
    """
    is_comparison = symbol[0] in "<>=!" and symbol not in ("<<", ">>")

    def function(a: Any, b: Any) -> Any:
        emitter = state.emitter
        if emitter is None or not any(hasattr(x, "emit_operand") for x in (a, b)):
            return plain(a, b)
        return (emitter.compare if is_comparison else emitter.binary)(symbol, a, b)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = f"Returns `a {symbol} b`."
    return function


add = _as_function("add", "+", operator.add)
sub = _as_function("sub", "-", operator.sub)
mul = _as_function("mul", "*", operator.mul)
truediv = _as_function("truediv", "/", operator.truediv)
floordiv = _as_function("floordiv", "//", operator.floordiv)
mod = _as_function("mod", "%", operator.mod)
bit_and = _as_function("bit_and", "&", operator.and_)
bit_or = _as_function("bit_or", "|", operator.or_)
bit_xor = _as_function("bit_xor", "^", operator.xor)
bit_shl = _as_function("bit_shl", "<<", operator.lshift)
bit_sar = _as_function("bit_sar", ">>", operator.rshift)
cmp_lt = _as_function("cmp_lt", "<", operator.lt)
cmp_le = _as_function("cmp_le", "<=", operator.le)
cmp_gt = _as_function("cmp_gt", ">", operator.gt)
cmp_ge = _as_function("cmp_ge", ">=", operator.ge)
cmp_eq = _as_function("cmp_eq", "==", operator.eq)
cmp_ne = _as_function("cmp_ne", "!=", operator.ne)


def neg(x: Any) -> Any:
    """Returns `-x`."""
    return state.emitter.unary("neg", x) if hasattr(x, "emit_operand") else -x


__all__ = [
    "abs", "acos", "acosh", "add", "asin", "asinh", "atan", "atan2", "atanh", "atomic_add",
    "atomic_and", "atomic_max", "atomic_min", "atomic_or", "atomic_sub", "atomic_xor", "bit_and",
    "bit_cast", "bit_or", "bit_sar", "bit_shl", "bit_shr", "bit_xor", "cast", "cbrt", "ceil",
    "cmp_eq", "cmp_ge", "cmp_gt", "cmp_le", "cmp_lt", "cmp_ne", "copysign", "cos", "cosh", "erf",
    "erfc", "exp", "floor", "floordiv", "frexp", "hypot", "log", "log10", "logical_and",
    "logical_not", "logical_or", "max", "min", "mod", "mul", "neg", "pow", "random", "round",
    "rsqrt", "select", "sin", "sinh", "sqrt", "sub", "tan", "tanh", "truediv", "trunc",
]  # fmt: skip
