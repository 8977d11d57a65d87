"""A line search for the strong Wolfe conditions, after Nocedal and Wright, with cubic steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

DECREASE, CURVATURE = 1e-4, 0.9
_MOST = 30


class Trial(NamedTuple):
    """A tried step along the direction, with the loss and the slope there."""

    step: float
    loss: float
    slope: float

    @property
    def is_finite(self) -> bool:
        return math.isfinite(self.loss) and math.isfinite(self.slope)


def _between(low: Trial, high: Trial) -> float:
    """The minimum of the cubic through two trials, well inside of the interval."""
    width = high.step - low.step
    middle = low.step + 0.5 * width
    if not high.is_finite:
        return low.step + 0.1 * width if low.step == 0 else middle
    a = low.slope + high.slope - 3 * (low.loss - high.loss) / (low.step - high.step)
    square = a * a - low.slope * high.slope
    if not (math.isfinite(square) and square >= 0):
        return middle
    b = math.copysign(math.sqrt(square), width)
    bottom = high.slope - low.slope + 2 * b
    if bottom == 0:
        return middle
    step = high.step - width * (high.slope + b - a) / bottom
    least, most = sorted((low.step + 0.1 * width, high.step - 0.1 * width))
    return min(max(step, least), most) if math.isfinite(step) else middle


def search(evaluate: Callable[[float], Trial], start: Trial, step: float, noise: float) -> Trial:
    """Returns the step that the search has chosen.

    Args:
        evaluate: moves to a step along the direction.
        start: the step 0, with a negative slope.
        step: the first step to try.
        noise: rounding of the loss, relative to it.

    Returns:
        A trial with a lower loss (but for noise), or `start` if none was found.
    """
    allowed = start.loss + noise * abs(start.loss)

    def is_enough(t: Trial) -> bool:
        return t.is_finite and t.loss <= start.loss + DECREASE * t.step * start.slope

    def is_flat(t: Trial) -> bool:
        if not t.is_finite:
            return False
        if is_enough(t) and abs(t.slope) <= -CURVATURE * start.slope:
            return True
        # If rounding hides the decrease of the loss, the slopes decide (Hager and Zhang).
        upper = (2 * DECREASE - 1) * start.slope
        return t.loss <= allowed and CURVATURE * start.slope <= t.slope <= upper

    low, high = start, None
    for number in range(_MOST):
        trial = evaluate(step)
        if is_flat(trial):
            return trial
        if not is_enough(trial) or (number and trial.loss >= low.loss):
            high = trial
            break
        if trial.slope >= 0:
            low, high = trial, low
            break
        low, step = trial, 2.5 * step
    if high is None:
        return low
    for _ in range(_MOST):
        trial = evaluate(_between(low, high))
        if is_flat(trial):
            return trial
        if not is_enough(trial) or trial.loss >= low.loss:
            high = trial
        else:
            if trial.slope * (high.step - low.step) >= 0:
                high = low
            low = trial
        if abs(high.step - low.step) <= 1e-15 * max(low.step, high.step):
            break
    return low
