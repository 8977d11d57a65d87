"""Domain checks of functions in debug mode, such as log of a negative number.

Infinite results, as of a division by zero, may be intended and are accepted, except for the
logarithm of zero: usually that of a volume that has vanished.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base import state
from .builder import UNORDERED
from .value import Value

if TYPE_CHECKING:
    from .emitter import Emitter

# The predicate that holds where there is a value, the bound, whether of the absolute value, and the
# text of the message. NaN passes: it was made elsewhere.
_ABOVE, _FROM, _UP_TO = (UNORDERED[op] for op in (">", ">=", "<="))
_DOMAINS = {
    "log": (_ABOVE, 0.0, False, "the logarithm of {}"),
    "log2": (_ABOVE, 0.0, False, "the logarithm of {}"),
    "log10": (_ABOVE, 0.0, False, "the logarithm of {}"),
    "log1p": (_ABOVE, -1.0, False, "the logarithm of 1 + {}"),
    "sqrt": (_FROM, 0.0, False, "the square root of {}"),
    "rsqrt": (_FROM, 0.0, False, "the square root of {}"),
    "asin": (_UP_TO, 1.0, True, "the arc sine of {}"),
    "acos": (_UP_TO, 1.0, True, "the arc cosine of {}"),
    "acosh": (_FROM, 1.0, False, "the inverse hyperbolic cosine of {}"),
    "atanh": (_UP_TO, 1.0, True, "the inverse hyperbolic tangent of {}"),
}


def check_domain(emitter: Emitter, name: str, x: Value) -> None:
    """Stops a debug run where a function is computed outside of its domain."""
    if not state.options.debug or name not in _DOMAINS:
        return
    predicate, bound, absolute, what = _DOMAINS[name]
    for value in x.scalars() if x.shape else [x]:
        size = emitter.unary("abs", value) if absolute else value
        _require(emitter, _compare(emitter, predicate, size, bound), value, what)


def check_power(emitter: Emitter, base: Value, exponent: Value) -> None:
    """Checks the domain of a power: negative numbers have only whole powers."""
    if not state.options.debug:
        return
    pairs = zip(base.scalars(), exponent.scalars(), strict=True) if base.shape else [
        (base, exponent)
    ]  # fmt: skip
    for number, power in pairs:
        is_whole = emitter.compare("==", emitter.unary("floor", power), power)
        holds = emitter.binary("|", _compare(emitter, _FROM, number, 0.0), is_whole)
        _require(emitter, holds, number, "a power of {} that is not whole")


def _compare(emitter: Emitter, predicate: int, value: Value, bound: float) -> Value:
    return emitter.compare_by(predicate, value, emitter.constant(bound, value.dt))


def _require(emitter: Emitter, holds: Value, value: Value, what: str) -> None:
    require(emitter, holds, f"{what} does not exist", [value])


def require(
    emitter: Emitter, holds: Value, message: str, values: list[Value], failure: int | None = None
) -> None:
    """Fails unless it holds, or the arm of a select that it stands in is not taken."""
    for condition, wanted in emitter.arms:
        if not isinstance(condition, Value):
            continue
        if condition.shape:
            return
        taken = emitter.to_bool(condition)
        holds = emitter.binary("|", holds, emitter.unary("not", taken) if wanted else taken)
    emitter.builder.assert_(holds.handle, message, [value.handle for value in values], failure)
