"""The wave equation on a grid: forward, adjoint, descent on the initial height.

All in f64, or in the type of the arrays, of which `Wave.real` makes a number.

u_t = 2 u_{t-1} + (c^2 dt^2 + c a dt) Lap u_{t-1} - u_{t-2} - c a dt Lap u_{t-2}, with
value 0 outside the grid, u_1 = 0 and the initial field u_0 as the unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Wave:
    """Grid size n, slots, wave speed and damping constant of a wave."""

    n: int = 128
    slots: int = 256
    speed: float = 340.0
    damping: float = 0.0
    real: type = float

    @property
    def dx(self) -> float:
        return self.real(1.0 / self.n)

    @property
    def dt(self) -> float:
        a = self.damping
        return (np.sqrt(a * a + self.dx**2 / 3.0) - a) / self.speed


def laplacian(u: np.ndarray, dx: float) -> np.ndarray:
    """Five-point Laplacian with value 0 outside; it is its own adjoint."""
    out = -4.0 * u
    out[1:] += u[:-1]
    out[:-1] += u[1:]
    out[:, 1:] += u[:, :-1]
    out[:, :-1] += u[:, 1:]
    return out / (dx * dx)


def _coefficients(wave: Wave) -> tuple[float, float]:
    if not wave.damping:
        # The number that the programs have.
        return wave.dx * wave.dx / 3.0, 0.0
    old = wave.speed * wave.damping * wave.dt
    return (wave.speed * wave.dt) ** 2 + old, old


def forward(u0: np.ndarray, target: np.ndarray, wave: Wave) -> tuple[float, np.ndarray]:
    """Loss and the last field, from the initial field u0 (n, n)."""
    new, old = _coefficients(wave)
    before, now = u0, np.zeros_like(u0)
    for _ in range(2, wave.slots):
        after = 2.0 * now + new * laplacian(now, wave.dx) - before
        if old:
            after -= old * laplacian(before, wave.dx)
        before, now = now, after
    return wave.real(wave.dx**2 * np.sum((target - now) ** 2)), now


def gradient(u0: np.ndarray, target: np.ndarray, wave: Wave) -> tuple[float, np.ndarray]:
    """Loss and its gradient with respect to u0 (n, n). The update is linear."""
    new, old = _coefficients(wave)
    loss, last = forward(u0, target, wave)
    g_now = 2.0 * wave.dx**2 * (last - target)
    g_before = np.zeros_like(g_now)
    for _ in range(2, wave.slots):
        g_older = -g_now
        if old:
            g_older -= old * laplacian(g_now, wave.dx)
        g_now, g_before = g_before + 2.0 * g_now + new * laplacian(g_now, wave.dx), g_older
    return loss, g_before


def descent(target: np.ndarray, wave: Wave, iterations: int, rate: float = 1.0):
    """Losses of gradient descent on u0 from 0, and the norms of the gradients."""
    u0 = np.zeros((wave.n, wave.n))
    losses, norms = [], []
    for _ in range(iterations):
        loss, g = gradient(u0, target, wave)
        losses.append(loss)
        norms.append(float(np.linalg.norm(g)))
        u0 = u0 - rate * g
    return losses, norms
