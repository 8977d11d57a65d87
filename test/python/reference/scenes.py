"""Geometry and initial conditions shared by the reference scenes and the benchmark.

Everything is given by formula, so no file is needed and every implementation of a scene
starts from the same numbers. Arrays are f64; grids are indexed [row, column].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def yy(n: int) -> np.ndarray:
    """Yin-yang symbol on an n x n grid, [row, column], values 0 and 1."""
    centre = (np.arange(n) + 0.5) / n - 0.5
    u = centre[None, :]
    w = centre[:, None]
    rho2 = u * u + w * w
    upper = u * u + (w + 0.235) ** 2
    lower = u * u + (w - 0.235) ** 2
    rules = [
        (rho2 > 0.25, 1.0),
        (rho2 >= 0.47**2, 0.0),
        (upper < 0.07**2, 0.0),
        (lower < 0.07**2, 1.0),
        (upper < 0.235**2, 1.0),
        (lower < 0.235**2, 0.0),
        (np.broadcast_to(u > 0, rho2.shape), 0.0),
    ]
    return np.select([r for r, _ in rules], [v for _, v in rules], default=1.0)


def wave_target(n: int) -> np.ndarray:
    """The symbol minus its mean: the target of the wave, n x n."""
    picture = yy(n)
    return picture - picture.mean()


def checkerboard(n: int, cell: int = 16) -> np.ndarray:
    """Initial smoke density of the picture setting, n x n, 0 and 1."""
    index = np.arange(n) // cell
    return ((index[:, None] + index[None, :]) % 2).astype(np.float64)


def stripes(n: int) -> np.ndarray:
    """Initial smoke density of the benchmark setting: rows 10-19, 50-59, 90-99 are 1."""
    row = np.arange(n)
    on = (row // 10) % 4 == 1
    return np.repeat(on[:, None], n, axis=1).astype(np.float64)


def smooth_velocity(n: int) -> np.ndarray:
    """Smooth, periodic, non-zero initial velocity for timing, (n, n, 2), cells per step.

    At velocity zero every gather of the advection is aligned, which no real iteration is.
    """
    phase = 2.0 * np.pi * np.arange(n) / n
    i, j = phase[:, None], phase[None, :]
    return np.stack(
        [
            0.6 * np.sin(j) + 0.25 * np.cos(i + 2.0 * j),
            0.5 * np.cos(i) - 0.2 * np.sin(2.0 * i + j),
        ],
        axis=-1,
    )


def smooth_wave(n: int) -> np.ndarray:
    """Smooth non-zero initial wave for timing, n x n."""
    centre = (np.arange(n) + 0.5) / n
    x, y = centre[:, None], centre[None, :]
    return 0.3 * np.sin(np.pi * x) * np.sin(2.0 * np.pi * y) + 0.1 * np.cos(5.0 * x + 3.0 * y)


def mpm_block(side: int, spacing: float, dx: float) -> np.ndarray:
    """Square block of side^2 particles, (side^2, 2), first index outer."""
    i, j = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    return dx * np.stack([spacing * i + 10.0, spacing * j + 25.0], axis=-1).reshape(-1, 2)


def smooth_particle_velocity(x: np.ndarray) -> np.ndarray:
    """Smooth non-zero velocity of particles at x for timing, (particles, 2)."""
    return np.stack(
        [
            0.5 + 0.8 * np.sin(9.0 * x[:, 1]) * np.cos(5.0 * x[:, 0]),
            0.3 * np.cos(7.0 * x[:, 0]) - 0.4 * np.sin(4.0 * x[:, 1]),
        ],
        axis=-1,
    )


def crawler(n: int = 128) -> tuple[np.ndarray, np.ndarray]:
    """The 2-D soft crawler: particle positions (count, 2) and muscle numbers (-1: none)."""
    dx = 1.0 / n
    rectangles = [
        (0.0, 0.1, 0.3, 0.1, -1),
        (0.0, 0.0, 0.05, 0.1, 0),
        (0.05, 0.0, 0.05, 0.1, 1),
        (0.2, 0.0, 0.05, 0.1, 2),
        (0.25, 0.0, 0.05, 0.1, 3),
    ]
    positions, muscles = [], []
    for x, y, w, h, muscle in rectangles:
        columns, rows = 2 * int(w / dx), 2 * int(h / dx)
        px = x + (np.arange(columns) + 0.5) * (w / columns) + 0.1
        py = y + (np.arange(rows) + 0.5) * (h / rows) + 0.03
        grid = np.stack(np.meshgrid(px, py, indexing="ij"), axis=-1).reshape(-1, 2)
        positions.append(grid)
        muscles.append(np.full(len(grid), muscle))
    return np.concatenate(positions), np.concatenate(muscles)


@dataclass(frozen=True)
class Robot:
    """A mass-spring robot.

    points (n, 2), springs (m, 2) of point indices, rest lengths (m,), stiffness (m,),
    actuation amounts (m,).
    """

    points: np.ndarray
    springs: np.ndarray
    rest: np.ndarray
    stiffness: np.ndarray
    actuation: np.ndarray

    @property
    def inputs(self) -> int:
        """Number of inputs of the controller."""
        return 10 + 4 * len(self.points) + 2


_ROBOT_0_POINTS = ".2,.1 .3,.13 .4,.1 .2,.2 .3,.2 .4,.2"
_ROBOT_0_SPRINGS = "0-1 1-2 3-4 4-5 0-3 2-5 0-4 1-4 2-4 3-1 5-1"

_ROBOT_1_POINTS = (
    ".225,.125 .2,.15 .25,.15 .125,.125 .1,.15 .15,.15 .1,.2 .15,.2 .1,.25 .15,.25 "
    ".2,.2 .2,.25 .25,.2 .25,.25"
)
_ROBOT_1_SPRINGS = (
    "0-1 0-2 1-2 3-4 3-5 4-5 4-6* 5-7* 4-7 6-5 6-7 6-8 7-9 6-9 8-7 8-9 10-11 7-10 7-11 "
    "9-10 9-11 1-10* 2-12* 1-12 10-2 10-12 12-13 10-13 11-12 11-13"
)

_ROBOT_2_POINTS = (
    ".2,.1 .2,.15 .25,.1 .25,.15 .1,.1 .1,.15 .15,.1 .15,.15 .1,.2 .15,.2 .1,.25 .15,.25 "
    ".2,.2 .2,.25 .25,.2 .25,.25 .2,.3 .25,.3 .2,.35 .25,.35"
)
_ROBOT_2_SPRINGS = (
    "0-1* 2-3* 0-2 0-3 1-2 1-3 4-5* 6-7* 4-6 4-7 5-6 5-7 5-8* 7-9* 5-9 8-7 8-9 8-10 9-11 "
    "8-11 10-9 10-11 12-13 9-12 9-13 11-12 11-13 1-12* 3-14* 1-14 12-3 12-14 14-15 12-15 "
    "13-14 13-15 13-16 15-17 13-17 16-15 16-17 16-18 17-19 16-19 18-17 18-19"
)

_ROBOT_3_POINTS = _ROBOT_2_POINTS + " .3,.15 .3,.2 .3,.1 .35,.1 .35,.15 .35,.2"
_ROBOT_3_SPRINGS = (
    _ROBOT_2_SPRINGS + " 20-21 3-20 3-21 14-20 14-21 22-20* 23-24* 22-23 22-24 20-23 20-24 "
    "24-25* 20-25 21-24 21-25"
)


def robot(number: int) -> Robot:
    """Robot 0 (all springs active, soft) or one of 1 to 3 (springs marked * are active)."""
    points_text, springs_text = {
        0: (_ROBOT_0_POINTS, _ROBOT_0_SPRINGS),
        1: (_ROBOT_1_POINTS, _ROBOT_1_SPRINGS),
        2: (_ROBOT_2_POINTS, _ROBOT_2_SPRINGS),
        3: (_ROBOT_3_POINTS, _ROBOT_3_SPRINGS),
    }[number]
    points = np.array([[float(c) for c in p.split(",")] for p in points_text.split()])
    marked = springs_text.split()
    springs = np.array([[int(e) for e in s.rstrip("*").split("-")] for s in marked])
    rest = np.linalg.norm(points[springs[:, 0]] - points[springs[:, 1]], axis=1)
    if number == 0:
        stiffness, actuation = np.full(len(marked), 14000.0), np.full(len(marked), 0.1)
    else:
        stiffness = np.full(len(marked), 30000.0)
        actuation = np.array([0.15 if s.endswith("*") else 0.0 for s in marked])
    return Robot(points, springs, rest, stiffness, actuation)


HIDDEN = 32


def robot_weights(body: Robot, seed: int = 0) -> dict[str, np.ndarray]:
    """Initial controller: w1 (32, inputs), b1 (32,), w2 (springs, 32), b2 (springs,)."""
    outputs = len(body.springs)
    # The legacy generator fixes the numbers for good; they are drawn one after another.
    draw = np.random.RandomState(seed).randn
    w1 = draw(HIDDEN, body.inputs) * 2.0 * np.sqrt(2.0 / (HIDDEN + body.inputs))
    w2 = draw(outputs, HIDDEN) * 3.0 * np.sqrt(2.0 / (HIDDEN + outputs))
    return {"w1": w1, "b1": np.zeros(HIDDEN), "w2": w2, "b2": np.zeros(outputs)}


def crawler_weights(seed: int = 0) -> dict[str, np.ndarray]:
    """Initial actuation of the crawler: weights (4 muscles, 4 waves) and biases (4,)."""
    draw = np.random.RandomState(seed).randn
    return {"weights": 0.01 * draw(4, 4), "bias": np.zeros(4)}
