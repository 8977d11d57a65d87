"""Functions of two floats in kernels."""

from __future__ import annotations

import math
from typing import Any

from ..base import dtypes
from ..base.dtypes import computed_in


def _floats(emitter: Any, a: Any, b: Any) -> tuple[Any, Any]:
    a, b, dt = emitter.operands(a, b)
    return emitter.unify(a, b, dt if dt.is_float else computed_in(dtypes.default_fp()))


def atan2(emitter: Any, a: Any, b: Any) -> Any:
    """Emits the angle of the point (b, a)."""
    a, b = _floats(emitter, a, b)
    if a.const == 0 and b.const == 0:  # MLIR's folder makes NaN of it
        return emitter.splat(math.atan2(a.const, b.const), a.dt, a.shape)
    return emitter.elementwise("math.atan2", [a, b], a.dt)


def copysign(emitter: Any, a: Any, b: Any) -> Any:
    """Emits |a| with the sign of b."""
    a, b = _floats(emitter, a, b)
    return emitter.elementwise("math.copysign", [a, b], a.dt)


def hypot(emitter: Any, a: Any, b: Any) -> Any:
    """Emits the norm of (a, b), component by component."""
    a, b = _floats(emitter, a, b)
    if a.shape:
        pairs = zip(a.scalars(), b.scalars(), strict=True)
        return emitter.matrix([hypot(emitter, p, q) for p, q in pairs], a.dt, a.shape)
    return emitter.matrix([a, b], a.dt, (2,)).norm()
