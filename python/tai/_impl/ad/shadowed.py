"""The error of a program in f64 next to its shadows, for `ti.solve_to`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import TaiError
from ..launch.shadow_values import shadow_values, shadows
from .tape import Tape
from .tuning import distance


def error_of_f64(
    run: Callable[..., Any], options: dict[str, Any], loss: Any, unknowns: list[Any]
) -> float:
    """Returns the relative error of the loss or of the gradient, whichever is greater, next to
    values with more digits; 0 where kernels cannot have such values.

    Unlike results of near inputs, it contains roundings that go the same way in all of them, as
    those of `sqrt(1 + x)` do for small x. The caller has restored the fields, which must be of f64.

    Args:
        run, options: the program and its arguments.
        loss, unknowns: its loss, and the fields of the gradient.
    """
    try:
        with shadows():
            with Tape(loss):
                run(**options)
            values = [_values(f) for f in [loss, *(f._companions["grad"] for f in unknowns)]]
    except (TaiError, AttributeError):
        return 0.0
    found, exact = (
        (number[0], np.concatenate([number[:0], *gradients]))
        for number, *gradients in zip(*values, strict=True)
    )
    error = max(distance(found, exact))
    return error if np.isfinite(error) else 0.0


def _values(field: Any) -> tuple[np.ndarray, np.ndarray]:
    """The values of a field, and those of its shadows."""
    wide = shadow_values(field).ravel()
    return field.to_numpy().ravel().astype(wide.dtype), wide
