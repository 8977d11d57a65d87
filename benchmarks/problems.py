"""The scenes of the benchmark: sizes, initial conditions, f64 losses and gradients.

Every peer starts from the arrays made here and is compared with the NumPy adjoints of
``test/python/reference``. Gradients are flat f64 arrays: of the initial velocity (n, n, 2)
for smoke, the initial height (n, n) for the wave, the particles' initial velocities (p, 2)
for diffmpm, and w1, b1, w2, b2 one after another for the robot.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test" / "python"))

from reference import diffmpm, scenes, smoke, wave
from reference import mass_spring as springs


@dataclass(frozen=True)
class SmokeProblem:
    """Initial velocity (n, n, 2), density and target (n, n), slots, Jacobi sweeps."""

    n: int
    slots: int
    sweeps: int
    velocity: np.ndarray
    density: np.ndarray
    target: np.ndarray

    units = 1

    def reference(self) -> tuple[float, np.ndarray]:
        setup = smoke.Smoke(self.n, self.slots, self.sweeps)
        loss, gradient = smoke.gradient(self.velocity, self.density, self.target, setup)
        return loss, gradient.ravel()


@dataclass(frozen=True)
class WaveProblem:
    """Initial height and target (n, n), slots."""

    n: int
    slots: int
    height: np.ndarray
    target: np.ndarray

    units = 1

    def reference(self) -> tuple[float, np.ndarray]:
        setup = wave.Wave(self.n, self.slots, real=self.height.dtype.type)
        loss, gradient = wave.gradient(self.height, self.target, setup)
        return loss, gradient.ravel()


@dataclass(frozen=True)
class MpmProblem:
    """Particle positions and velocities (p, 2); the loss sees every particle's distance.

    A loss of the mean position alone would leave the gradient free of the elastic forces,
    which cancel in the mean.
    """

    slots: int
    position: np.ndarray
    velocity: np.ndarray
    material: diffmpm.Material
    target: tuple[float, float] = (0.3, 0.6)

    @property
    def units(self) -> int:
        """Times are given per step."""
        return self.slots - 1

    def reference(self) -> tuple[float, np.ndarray]:
        loss, _, gradient = diffmpm.block_gradient(
            self.position,
            self.velocity,
            np.array(self.target),
            self.material,
            self.slots,
            each=True,
        )
        return loss, gradient.ravel()


@dataclass(frozen=True)
class RobotProblem:
    """A mass-spring robot with its controller's weights."""

    body: scenes.Robot
    weights: dict[str, np.ndarray]
    walk: springs.Walk

    units = 1

    def reference(self) -> tuple[float, np.ndarray]:
        loss, gradient = springs.robot_gradient(self.body, self.weights, self.walk)
        return loss, np.concatenate([gradient[k].ravel() for k in ("w1", "b1", "w2", "b2")])


@dataclass(frozen=True)
class FirstKernelProblem:
    """The sum of the squares of x (n,): the cost of a first kernel and its gradient."""

    x: np.ndarray

    units = 1

    def reference(self) -> tuple[float, np.ndarray]:
        return float(np.sum(self.x**2)), 2.0 * self.x


def first_kernel_problem(small: bool = False) -> FirstKernelProblem:
    return FirstKernelProblem(np.cos(np.arange(8 if small else 64)))


def smoke_problem(small: bool = False) -> SmokeProblem:
    n, slots = (30, 8) if small else (110, 100)
    return SmokeProblem(n, slots, 6, scenes.smooth_velocity(n), scenes.stripes(n), scenes.yy(n))


def wave_problem(small: bool = False) -> WaveProblem:
    n, slots = (32, 32) if small else (128, 256)
    return WaveProblem(n, slots, scenes.smooth_wave(n), scenes.wave_target(n))


def mpm_problem(small: bool = False) -> MpmProblem:
    side, slots = (16, 11) if small else (80, 51)
    material = diffmpm.Material(n=128)
    position = scenes.mpm_block(side, 0.5, material.dx)
    velocity = scenes.smooth_particle_velocity(position)
    return MpmProblem(slots, position, velocity, material)


def large_mpm_problem(small: bool = False) -> MpmProblem:
    """A million particles. The time step shrinks with the cells, or they would be unstable."""
    n, side, slots = (256, 32, 6) if small else (1024, 1000, 21)
    material = diffmpm.Material(n=n, dt=3e-4 * 128 / n)
    position = scenes.mpm_block(side, 0.5, material.dx)
    velocity = scenes.smooth_particle_velocity(position)
    return MpmProblem(slots, position, velocity, material)


def robot_problem(small: bool = False) -> RobotProblem:
    body = scenes.robot(3)
    walk = springs.Walk(slots=100 if small else 2048)
    return RobotProblem(body, scenes.robot_weights(body), walk)


PROBLEMS: dict[str, Callable[[bool], object]] = {
    "smoke": smoke_problem,
    "diffmpm": mpm_problem,
    "wave": wave_problem,
    "mass_spring": robot_problem,
    "first_kernel": first_kernel_problem,
}

# Problems that are timed on a GPU in addition. There is no time for their f64 adjoints.
LARGE_PROBLEMS: dict[str, Callable[[bool], object]] = {"diffmpm_large": large_mpm_problem}
