"""The gradient of a program next to differences of its loss, for `ti.solve_to`."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

# The step of the first difference, in units of the magnitude of each input; and the ratio of steps.
_STEP, _RATIO = 1e-5, 16.0
# A step that should change the loss by more than the first share of it is too long for a
# difference; one that should change it by the second share is taken in its place.
_TOO_LONG, _SHORT = 1e-3, 1e-4
# A loss that magnifies relative changes of its inputs more often is named as one that does.
_MAGNIFIED = 1e3
# Differences whose noise is more than this part of the slope confirm no gradient.
_CONFIRMS = 0.1
# Curvature makes second differences 256 times smaller if the step is divided by 16; a ratio between
# these counts as that. Roundings do not, or vanish at once where the step is below an ulp.
_CURVED = 128.0, 512.0

Result = tuple[float, np.ndarray]


class Slopes:
    """Differences of a loss along the signs of its gradient.

    Args:
        at: loss and gradient where each input is moved by a step.
        base: the same without a step.
        slope: the one that the gradient has.
        error: the relative error that is wanted.
    """

    def __init__(self, at: Callable[[float], Result], base: Result, slope: float, error: float):
        self._at, self._base, self._slope = at, base, slope
        self._tolerance = max(error / 2, 1e-4) * slope
        self._sides: dict[float, tuple[float, float]] = {}
        self._changes: dict[float, np.ndarray] = {}

    def _off(self, h: float) -> float:
        """The distance of the central difference from the slope."""
        if h not in self._sides:
            above, below, base = self._at(h), self._at(-h), self._base
            self._sides[h] = (above[0] - base[0]) / h, (base[0] - below[0]) / h
            self._changes[h] = above[1] + below[1] - 2 * base[1]
        return abs(sum(self._sides[h]) / 2 - self._slope)

    def _bend(self, h: float) -> float:
        """The second difference of the loss."""
        above, below = self._sides[h]
        return (above - below) * h

    def find_trouble(self, rounding: float, worst: str) -> tuple[str, str] | None:
        """Returns why no difference confirms the gradient, with a hint; or None if one does.

        Args:
            rounding: how much roundings are expected to change the loss.
            worst: the lines that cause most of that.
        """
        h, closer = _STEP, _STEP / _RATIO
        for step in (h, closer):
            if self._off(step) <= self._tolerance + 4 * rounding / step:
                return None
        share = self._slope / abs(self._base[0])
        if share * closer > _TOO_LONG:
            # The linear part of the loss is large at this distance: only a shorter step will do.
            short = _SHORT / share
            if self._off(short) <= self._tolerance + 4 * rounding / short:
                return None
            return (
                f"no difference of the loss confirms its gradient, not even with a step of "
                f"{short:.0e}{self.magnified()}",
                "differentiate over a shorter time",
            )
        # The error of a smooth loss shrinks with the square of the step.
        if self._off(closer) < self._off(h) / _RATIO:
            closest = closer / _RATIO
            if self._off(closest) <= self._tolerance + 4 * rounding / closest:
                return None
        # Second differences that are the same for both steps are a jump, and no noise.
        noise = abs(self._bend(h) - self._bend(closer)) / math.sqrt(12)
        for longer in (_RATIO * h, _RATIO**2 * h):
            allowed = 4 * max(noise, rounding) / longer
            confirms = allowed <= _CONFIRMS * self._slope
            if self._off(longer) <= self._tolerance + allowed and confirms:
                return None
            if noise / h <= self._tolerance:
                break  # differences have digits enough, and say something else
        if noise / h > self._tolerance and self._is_noise(h, noise):
            return (
                f"rounding in f64 changes the loss by about {noise / abs(self._base[0]):.0e} of "
                f"it, so that differences do not confirm the gradient: {worst}",
                "rewrite the line that cancels; ti.ad.Tape(precision=True) reports it",
            )
        sides = [self._sides[step] for step in (h, closer)]
        return explain_slopes(sides, (h, closer), self._slope)

    def _is_noise(self, h: float, noise: float) -> bool:
        """Whether a longer step makes the difference better, as it does where noise is divided by
        it.
        """
        return self._off(_RATIO * h) < self._off(h) / 2 < self._off(h / _RATIO)

    def magnified(self) -> str:
        """Says that the program magnifies changes of its inputs, if it does."""
        share = self._slope / abs(self._base[0])
        if share < _MAGNIFIED:
            return ""
        return f"; the loss magnifies changes of its inputs {share:.0e} times, as chaos does"

    def spread(self, runs: int) -> float:
        """A bound of the error of f64 from results of inputs that differ by small steps, in which
        roundings are drawn anew: twice their second differences without curvature, or eight times,
        where changes are magnified.

        Args:
            runs: how many may be made for it.
        """
        share = self._slope / abs(self._base[0])
        far = min(_STEP, _SHORT / share) if runs >= 4 else _STEP
        if runs >= 4 or far / _RATIO in self._sides:
            self._off(far)
            self._off(far / _RATIO)
            pair = [far, far / _RATIO]
        else:
            pair = [_STEP, _STEP]
        size = float(np.linalg.norm(self._base[1]))
        gradients = [float(np.linalg.norm(self._changes[h])) / size for h in pair]
        losses = [abs(self._bend(h) / self._base[0]) for h in pair]
        found = max(map(_without_curvature, (losses, gradients)))
        # Where a step is too short to draw anew, the loss departs from a line by its roundings.
        steps = sorted((h for h in self._sides if h >= pair[-1]), reverse=True)
        lines = [self._off(h) * h / abs(self._base[0]) for h in steps]
        if share * _STEP > _TOO_LONG:
            lines = lines[-1:]  # curvature
        margin = 8.0 if share > _MAGNIFIED else 2.0
        return margin * max(found, *lines)


def _without_curvature(changes: list[float]) -> float:
    """The part of two second differences that is no curvature; the second has a 16th of the step
    of the first.
    """
    far, near = changes
    least, most = _CURVED
    return near if least * near <= far <= most * near else max(far, near)


def explain_slopes(
    sides: list[tuple[float, float]], steps: tuple[float, float], slope: float
) -> tuple[str, str]:
    """Explains why differences of the loss do not have the slope of the gradient, with a hint.

    Args:
        sides: the slopes along the gradient and in the other direction, for each of two steps.
        steps: the step of each, which shrinks.
        slope: the one that the gradient has.
    """
    found, closer = ((above + below) / 2 for above, below in sides)
    hint = "move the point, or smooth the condition; ti.ad.check shows the slopes"
    if abs(closer) > 4 * abs(found):
        return (
            f"the loss jumps within {steps[0]:.0e} of the point: differences of it grow as their "
            f"step shrinks, from {found:.3g} to {closer:.3g}, and no derivative foretells that",
            hint,
        )
    bends = [abs(above - below) for above, below in sides]
    if bends[1] > max(0.05 * slope, 0.9 * bends[0]):  # a smooth loss has a 16th of the first
        return (
            "the point is at a kink, where no gradient holds: along its gradient the loss grows by "
            f"{sides[1][0]:.3g}, and by {sides[1][1]:.3g} from the other side",
            hint,
        )
    return (
        f"along its gradient the loss grows by {found:.3g}, but the gradient says {slope:.3g}: "
        "either a part of the program is outside of kernels (host code, other frameworks), "
        "where no estimate sees it, or a kink is near by, or kernels pass numbers on as ti.f32",
        "compute it in kernels; write float for ti.f32 in signatures; ti.ad.check finds kinks",
    )
