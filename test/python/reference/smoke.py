"""Smoke on a periodic grid: forward, adjoint, descent on the initial velocity.

All in f64, or in the type of the arrays.

The projection of step t subtracts the gradient of the last but one Jacobi sweep of step
t - 1: the published program's index, which its losses depend on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Smoke:
    """Grid size n, slots (one more than steps) and Jacobi sweeps of a step."""

    n: int = 110
    slots: int = 100
    sweeps: int = 6

    @property
    def dx(self) -> float:
        return 1.0 / self.n


def _sample(w: np.ndarray):
    """Wrapped indices and weights of the bilinear gather at (i, j) - w."""
    n = w.shape[0]
    index = np.arange(n)
    cx = index[:, None] - w[..., 0]
    cy = index[None, :] - w[..., 1]
    lx, ly = np.floor(cx), np.floor(cy)
    fx, fy = cx - lx, cy - ly
    ax, ay = lx.astype(int) % n, ly.astype(int) % n
    return ax, ay, (ax + 1) % n, (ay + 1) % n, fx, fy


def add_at(index: np.ndarray, value: np.ndarray, count: int) -> np.ndarray:
    """The sum of the values at each index, in their type."""
    if value.dtype == np.float64:
        return np.bincount(index, value, count)
    total = np.zeros(count, value.dtype)
    np.add.at(total, index, value)
    return total


def advect(f: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Semi-Lagrangian step of f, (n, n) or (n, n, 2), in the velocity w (n, n, 2)."""
    ax, ay, bx, by, fx, fy = _sample(w)
    if f.ndim == 3:
        fx, fy = fx[..., None], fy[..., None]
    near = (1.0 - fy) * f[ax, ay] + fy * f[ax, by]
    far = (1.0 - fy) * f[bx, ay] + fy * f[bx, by]
    return (1.0 - fx) * near + fx * far


def advect_adjoint(f: np.ndarray, w: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Adjoints of f and of w for the adjoint g of `advect(f, w)`."""
    n = w.shape[0]
    ax, ay, bx, by, fx, fy = _sample(w)
    fields = [f[..., c] for c in range(2)] if f.ndim == 3 else [f]
    adjoints = [g[..., c] for c in range(2)] if f.ndim == 3 else [g]
    gw = np.zeros_like(w)
    gf = []
    corners = [
        (ax * n + ay, (1.0 - fx) * (1.0 - fy)),
        (ax * n + by, (1.0 - fx) * fy),
        (bx * n + ay, fx * (1.0 - fy)),
        (bx * n + by, fx * fy),
    ]
    for q, a in zip(fields, adjoints, strict=True):
        f00, f01, f10, f11 = q[ax, ay], q[ax, by], q[bx, ay], q[bx, by]
        gw[..., 0] -= a * ((1.0 - fy) * (f10 - f00) + fy * (f11 - f01))
        gw[..., 1] -= a * ((1.0 - fx) * (f01 - f00) + fx * (f11 - f10))
        total = np.zeros(n * n, g.dtype)
        for at, weight in corners:
            total += add_at(at.ravel(), (weight * a).ravel(), n * n)
        gf.append(total.reshape(n, n))
    return (np.stack(gf, axis=-1) if f.ndim == 3 else gf[0]), gw


def _difference(p: np.ndarray, axis: int) -> np.ndarray:
    """Central difference without the factor; its adjoint is its negative."""
    return np.roll(p, -1, axis) - np.roll(p, 1, axis)


def _neighbours(p: np.ndarray) -> np.ndarray:
    return np.roll(p, -1, 0) + np.roll(p, 1, 0) + np.roll(p, -1, 1) + np.roll(p, 1, 1)


def forward(v0: np.ndarray, density0: np.ndarray, target: np.ndarray, smoke: Smoke):
    """Loss, and the slots of v, v*, density (lists), from v0 (n, n, 2)."""
    dx = smoke.dx
    v, starred, density = [v0], [np.zeros_like(v0)], [density0]
    pressure = np.zeros_like(density0)
    projected = np.zeros_like(density0)
    for _ in range(1, smoke.slots):
        star = advect(v[-1], v[-1])
        source = -0.5 * dx * (_difference(star[..., 0], 0) + _difference(star[..., 1], 1))
        gradient_p = np.stack([_difference(projected, 0), _difference(projected, 1)], -1)
        new = star - 0.5 / dx * gradient_p
        for sweep in range(smoke.sweeps):
            if sweep == smoke.sweeps - 1:
                projected = pressure
            pressure = (source + _neighbours(pressure)) / 4.0
        starred.append(star)
        v.append(new)
        density.append(advect(density[-1], new))
    loss = np.mean((target - density[-1]) ** 2)
    return loss, v, starred, density


def gradient(v0: np.ndarray, density0: np.ndarray, target: np.ndarray, smoke: Smoke):
    """Loss and its gradient with respect to v0 (n, n, 2)."""
    dx = smoke.dx
    loss, v, _, density = forward(v0, density0, target, smoke)
    g_density = 2.0 * (density[-1] - target) / density0.size
    g_v = np.zeros_like(v0)
    # Adjoints of what step t - 1 hands to step t: its last sweep, its last but one.
    g_pressure = np.zeros_like(density0)
    g_projected = np.zeros_like(density0)
    for t in range(smoke.slots - 1, 0, -1):
        g_density, g_w = advect_adjoint(density[t - 1], v[t], g_density)
        g_v = g_v + g_w
        g_star = g_v.copy()
        g_source = np.zeros_like(density0)
        g_p = g_pressure
        for sweep in range(smoke.sweeps - 1, -1, -1):
            g_source += g_p / 4.0
            g_p = _neighbours(g_p) / 4.0
            if sweep == smoke.sweeps - 1:
                g_p = g_p + g_projected
        g_pressure = g_p
        g_star[..., 0] += 0.5 * dx * _difference(g_source, 0)
        g_star[..., 1] += 0.5 * dx * _difference(g_source, 1)
        g_projected = 0.5 / dx * (_difference(g_v[..., 0], 0) + _difference(g_v[..., 1], 1))
        g_f, g_w = advect_adjoint(v[t - 1], v[t - 1], g_star)
        g_v = g_f + g_w
    return loss, g_v


def descent(density0: np.ndarray, target: np.ndarray, smoke: Smoke, iterations: int, rate: float):
    """Losses of gradient descent on v0 from 0, and the norms of the gradients."""
    v0 = np.zeros((smoke.n, smoke.n, 2))
    losses, norms = [], []
    for _ in range(iterations):
        loss, g = gradient(v0, density0, target, smoke)
        losses.append(loss)
        norms.append(float(np.linalg.norm(g)))
        v0 = v0 - rate * g
    return losses, norms
