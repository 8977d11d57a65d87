"""Directional derivatives of a program by finite differences, with error estimates.

Used by the checker of gradients: random directions with components of both signs, a sequence of
step sizes with Richardson extrapolation, and one-sided slopes that detect kinks and jumps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

STEPS = tuple(10.0**-k for k in range(2, 11))  # 1e-2 … 1e-10

# Relative errors that a gradient check accepts. Differences in f32 lose about two thirds of its
# seven digits; a dot product that compares forward and reverse mode loses as many as sums of f32.
DIFFERENCES_TOLERANCE = {"f64": 1e-7, "f32": 5e-3}
FORWARD_TOLERANCE = {"f64": 1e-12, "f32": 1e-4}
# A finite difference of noisy values is known up to the noise divided by the step. A gradient that
# differs from the finite difference by less passes, up to this relative error.
_NOISE_TOLERANCE = {"f64": 1e-3, "f32": 5e-2}
# Noise is measured by differences of order 4 of values at close points, where a smooth function
# leaves nothing: the distance of the points, and their number.
_NOISE_STEP = {"f64": 2.0**-20, "f32": 2.0**-12}
_NOISE_POINTS = 8
# A derivative smaller than this share of the function's values cannot be told from the rounding of
# the finite differences.
_FLOOR = {"f64": 1e-4, "f32": 1e-2}


@dataclass
class Rung:
    """The finite differences at one step size, a rung of the ladder of steps.

    Attributes:
        step: distance from the point to either side.
        central: the central difference.
        improved: the Richardson extrapolation with the rung before, or None.
        left, right: the one-sided slopes.
        error: relative error of the gradient against the better of the two estimates.
    """

    step: float
    central: float
    improved: float | None
    left: float
    right: float
    error: float


@dataclass
class Probe:
    """The comparison of a derivative with finite differences along one direction.

    Attributes:
        method: `forward` or `differences`.
        reverse: the derivative by the gradient of the reverse sweep.
        expected: the derivative by the method, from the best step.
        error: relative.
        step: the best step, or None for forward mode.
        ladder: all steps that were tried.
        kink: the slopes on the two sides differ and do not meet as the step shrinks.
        jump: they grow without end as the step shrinks.
        is_noisy: the tolerance is the noise of the differences.
    """

    method: str
    reverse: float
    expected: float
    error: float
    tolerance: float
    step: float | None = None
    ladder: list[Rung] = field(default_factory=list)
    kink: bool = False
    jump: bool = False
    is_noisy: bool = False

    @property
    def passed(self) -> bool:
        if self.error <= self.tolerance:  # false for nan
            return True
        # At a kink of the function, any slope between the slopes of its two sides is accepted as a
        # gradient.
        return self.kink and not self.jump and self.between

    @property
    def is_flat(self) -> bool:
        """Whether the derivative and all finite differences are exactly 0, for every step."""
        return self.reverse == 0 == self.expected and all(
            rung.left == 0 == rung.right for rung in self.ladder
        )

    @property
    def between(self) -> bool:
        """Whether the gradient lies between the one-sided slopes on the two sides."""
        if not self.ladder:
            return False
        rung = _finest(self.ladder)
        low, high = min(rung.left, rung.right), max(rung.left, rung.right)
        slack = 1e-3 * max(abs(low), abs(high))
        return low - slack <= self.reverse <= high + slack

    def show(self) -> list[str]:
        """Returns the ladder of step sizes as lines of text."""
        lines = [
            "      step        central           improved           left           right  error"
        ]
        for rung in self.ladder:
            improved = "-" if rung.improved is None else f"{rung.improved:.10g}"
            lines.append(
                f"   {rung.step:7.0e} {rung.central:14.8g} {improved:>18} {rung.left:14.6g} "
                f"{rung.right:15.6g}  {rung.error:.1e}"
            )
        return lines


def direction(generator: np.random.Generator, array: np.ndarray, mask: Any = None) -> np.ndarray:
    """A random direction of length 1 whose components have both signs and are zero outside of the
    mask.
    """
    found = generator.standard_normal(array.shape)
    if mask is not None:
        found = np.where(mask, found, 0.0)
    norm = np.linalg.norm(found)
    return found / norm if norm else found


def relative_error(a: float, b: float, scale: float) -> float:
    """The relative distance of two derivatives; 0 if they are equal, NaN if one of them is not a
    number.
    """
    if a == b:
        return 0.0
    if not (np.isfinite(a) and np.isfinite(b) and np.isfinite(scale)):
        return np.nan
    return abs(a - b) / max(abs(a), abs(b), scale)


def climb(
    value: Callable[[float], list[np.ndarray]],
    seeds: list[np.ndarray],
    reverse: float,
    scale: float,
    dtype: str = "f64",
    tolerance: float | None = None,
    quick: bool = False,
) -> Probe:
    """Compares a derivative with finite differences for a ladder of step sizes.

    Args:
        value: the outputs at a signed distance from the point.
        seeds: weights of the outputs, of their shapes.
        reverse: the derivative to check.
        scale: the typical size of the derivative, so that one that is small by accident is not held
            against the gradient.
        dtype: the type that the program computes in.
        quick: stop at the first good step.
    """
    tolerance = DIFFERENCES_TOLERANCE[dtype] if tolerance is None else tolerance
    base = value(0.0)
    size = max(
        (float(np.max(np.abs(b * s), initial=0.0)) for b, s in zip(base, seeds, strict=True)),
        default=0.0,
    )
    scale = max(scale, _FLOOR[dtype] * size) if np.isfinite(size) else scale

    def weigh(a: list[np.ndarray], b: list[np.ndarray]) -> float:
        # The outputs are subtracted before they are summed, which keeps more digits.
        with np.errstate(all="ignore"):
            parts = [
                np.sum((x - y)[s != 0] * s[s != 0]) for x, y, s in zip(a, b, seeds, strict=True)
            ]
        return float(sum(parts))

    ladder: list[Rung] = []
    steps = STEPS if dtype == "f64" else tuple(2.0**-k for k in range(2, 11))
    best: tuple[float, float, float] | None = None
    for step in steps:
        above, below = value(step), value(-step)
        central = weigh(above, below) / (2 * step)
        right, left = weigh(above, base) / step, weigh(base, below) / step
        improved = None
        if ladder:
            ratio = (ladder[-1].step / step) ** 2
            improved = (ratio * central - ladder[-1].central) / (ratio - 1)
        errors = [(relative_error(central, reverse, scale), central)]
        if improved is not None:
            errors.append((relative_error(improved, reverse, scale), improved))
        error, estimate = min(errors, key=lambda e: np.inf if np.isnan(e[0]) else e[0])
        ladder.append(Rung(step, central, improved, left, right, error))
        if not np.isnan(error) and (best is None or error < best[0]):
            best = (error, estimate, step)
        if quick and error <= 0.1 * tolerance:
            break
    if best is None:
        best = (np.nan, ladder[-1].central, ladder[-1].step)
    probe = Probe("differences", reverse, best[1], best[0], tolerance, best[2], ladder)
    if not best[0] <= tolerance:
        noise = measure_noise(lambda step: weigh(value(step), base), _NOISE_STEP[dtype])
        eps = float(np.finfo(dtype.replace("f", "float")).eps)
        _look_for_kinks(probe, scale, max(noise, 8 * eps * size))
        if not probe.jump:
            _allow_noise(probe, scale, noise, _NOISE_TOLERANCE[dtype])
    return probe


def measure_noise(value: Callable[[float], float], step: float) -> float:
    """The standard deviation of the rounding errors of a function near 0.

    A smooth function leaves nothing of the fourth differences of values at close points, and
    errors that do not depend on each other leave 8.4 (the root of 70) times their deviation
    (Hamming, Numerical Methods, section 6.4). Both sides of 0 are measured and the smaller figure
    counts, because a jump at 0 is no noise.

    Args:
        value: the function.
        step: the distance of the points.
    """
    sides = []
    for sign in (1.0, -1.0):
        values = np.array([value(sign * k * step) for k in range(1, _NOISE_POINTS + 1)])
        with np.errstate(all="ignore"):
            fourth = np.diff(values, 4)
            sides.append(float(np.sqrt(np.mean(fourth**2) / 70.0)))
    finite = [side for side in sides if np.isfinite(side)]
    return min(finite, default=0.0)


def _allow_noise(probe: Probe, scale: float, noise: float, most: float) -> None:
    """Accepts a gradient that differs from the finite differences by no more than the noise of the
    function.
    """
    for rung in probe.ladder:
        # Three standard deviations of a difference of two values with this noise. The extrapolation
        # adds less than that.
        bound = 3 * noise / (np.sqrt(2.0) * rung.step) / max(scale, abs(probe.reverse))
        if probe.tolerance < bound <= most and rung.error <= bound:
            best = rung.central
            if rung.improved is not None:
                best = min(best, rung.improved, key=lambda e: abs(e - probe.reverse))
            probe.error, probe.expected, probe.step = rung.error, best, rung.step
            probe.tolerance, probe.is_noisy = bound, True
            return


def _finest(ladder: list[Rung]) -> Rung:
    """Selects the step of the finite differences whose one-sided slopes are best: a small one, but
    well above the rounding.
    """
    return min(ladder, key=lambda r: abs(np.log10(r.step) + 6))


def _look_for_kinks(probe: Probe, scale: float, noise: float) -> None:
    gaps = []
    for rung in probe.ladder:
        gap = abs(rung.right - rung.left)
        if gap > max(8 * noise / rung.step, 1e-6 * scale):
            gaps.append((rung.step, gap))
    small = [(s, g) for s, g in gaps if 1e-8 <= s <= 1e-4]
    if len(small) >= 2:
        # Classifies the function at this point. At a smooth point, the difference of the
        # one-sided slopes shrinks with the step; at a kink it stays; at a jump it grows.
        growth = np.log(small[-1][1] / small[0][1]) / np.log(small[0][0] / small[-1][0])
        probe.kink = growth > -0.3
        probe.jump = growth > 0.6
