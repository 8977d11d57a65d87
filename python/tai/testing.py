"""Checks of gradients, for tests and for debugging."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ._impl.ad.tape import Tape
from ._impl.base import native
from .errors import TaiAutodiffError


def check_gradient(
    loss: Any,
    wrt: Sequence[Any],
    run: Callable[[], None],
    tolerance: float = 1e-7,
    directions: int = 4,
    seed: int = 0,
) -> float:
    """Compares gradients with central differences.

    For each field of `wrt` and each of some random directions (components of both signs), the
    derivative of the loss along the direction is computed by central differences with several
    step sizes and Richardson extrapolation. The most accurate estimate is compared.

    Args:
        loss: the field of the loss; f64, as all fields should be.
        wrt: fields with gradients.
        run: runs the kernels from the fields of `wrt` to the loss.
        tolerance: greatest relative error.

    Returns:
        The greatest relative error.

    Raises:
        AssertionError: the error exceeds the tolerance; says for which field. Or nothing was
            compared: there is no field or no element, or the loss depends on none of them.
        TaiAutodiffError: a field is not f64: differences would be too coarse.
    """
    for field in (loss, *wrt):
        if field.dtype.name != "f64":
            raise TaiAutodiffError(
                f"field '{field.name}' is of type {field.dtype}: differences need f64"
            )
    with Tape(loss):
        run()
    gradients = [field.grad.to_numpy() for field in wrt]
    generator = np.random.default_rng(seed)
    worst, is_flat = 0.0, True
    for field, gradient in zip(wrt, gradients, strict=True):
        with _Kept(field) as start:

            def value(array: np.ndarray, field: Any = field) -> float:
                field.from_numpy(array)
                run()
                return loss[None]

            for _ in range(directions if start.size else 0):
                direction = generator.standard_normal(start.shape)
                direction /= np.linalg.norm(direction)
                expected = float(np.sum(gradient * direction))
                moved = [value(start + step * direction) for step in (0.0, 0.1, -0.1)]
                is_flat &= expected == 0 and moved[0] == moved[1] == moved[2]

                def along(h: float, d: np.ndarray = direction, s: np.ndarray = start) -> float:
                    return value(s + h * d)

                error = _best_error(along, expected)
                if not error <= tolerance:
                    field.from_numpy(start)
                    run()
                    raise AssertionError(
                        f"the gradient of '{field.name}' along a direction is {expected!r}, but "
                        f"central differences disagree by {error:.3g} (relative)"
                    )
                worst = max(worst, error)
    run()
    if is_flat:
        names = ", ".join(f"'{field.name}'" for field in wrt)
        raise AssertionError(
            f"nothing was checked: the loss '{loss.name}' depends on no element of {names}"
            if wrt
            else "nothing was checked: wrt names no field"
        )
    return worst


class _Kept(native.WithBlock):
    """Afterwards a field has the values again that it had at the start, which `as` names."""

    def __init__(self, field: Any):
        self._field, self._start = field, field.to_numpy()

    def _enter(self) -> np.ndarray:
        return self._start

    def _end(self) -> None:
        self._field.from_numpy(self._start)


def _best_error(value: Callable[[float], float], expected: float) -> float:
    """The least relative error over a ladder of steps."""
    best, coarse = np.inf, None
    scale = max(abs(expected), 1e-3)
    for exponent in range(3, 9):
        step = 2.0 ** (-2 * exponent + 2)
        fine = (value(step) - value(-step)) / (2 * step)
        estimates = [fine]
        if coarse is not None:  # the last step was four times as large
            estimates.append(fine + (fine - coarse) / 15)
        coarse = fine
        best = min([best, *(abs(e - expected) / scale for e in estimates)])
    return float(best)
