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

# For each function with a limited domain: the predicate that holds inside of the domain, the bound,
# whether the absolute value is compared, and the text of the message. NaN is accepted, since
# another operation has made it.
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
    """Emits a check, in debug mode, that stops the program if a function is computed outside of its
    domain.
    """
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
    """Emits an assertion. Inside of an argument of a select, the assertion only counts if that
    argument is selected.
    """
    for condition, wanted in emitter.arms:
        if not isinstance(condition, Value):
            continue
        if condition.shape:
            return
        taken = emitter.to_bool(condition)
        holds = emitter.binary("|", holds, emitter.unary("not", taken) if wanted else taken)
    emitter.builder.assert_(holds.handle, message, [value.handle for value in values], failure)
