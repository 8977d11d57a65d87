"""MLS-MPM in 3-D, f64, forward only: neo-Hookean solids with muscles along z, and liquid.

Particles have positions x (p, 3), velocities v (p, 3), affine velocities c (p, 3, 3) and
deformation gradients f (p, 3, 3); the grid is a cube of n³ nodes with side 1.
"""

from __future__ import annotations

import numpy as np

DT, N, E, GRAVITY = 2e-3, 64, 10.0, 10.0
OFFSETS = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(27, 3)


def actuation(weights: np.ndarray, bias: np.ndarray, step: int) -> np.ndarray:
    """The signal of each muscle in (-1, 1); `weights` is (muscles, waves)."""
    phases = 40 * step * DT + 2 * np.pi / weights.shape[1] * np.arange(weights.shape[1])
    return np.tanh(weights @ np.sin(phases) + bias)


def mean_x(
    x: np.ndarray, muscle: np.ndarray, solid: np.ndarray, weights: np.ndarray,
    bias: np.ndarray, steps: int,
) -> float:  # fmt: skip
    """The mean first coordinate of the solid particles after `steps - 1` steps.

    Args:
        x: initial positions, (p, 3).
        muscle: index of each particle's muscle, -1 for none, (p,).
        solid: which particles are solid, (p,).
        weights, bias: of the signals, (muscles, waves) and (muscles,).
    """
    dx = 1 / N
    count = len(x)
    v, c = np.zeros((count, 3)), np.zeros((count, 3, 3))
    f = np.tile(np.eye(3), (count, 1, 1))
    mass = np.where(solid, 1.0, 4.0)
    for step in range(steps - 1):
        act = np.where(muscle >= 0, actuation(weights, bias, step)[muscle] * 5, 0.0)
        base = (x / dx - 0.5).astype(int)
        fx = x / dx - base
        w = np.stack([0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2], 1)
        f = (np.eye(3) + DT * c) @ f
        volume = np.linalg.det(f)
        root = np.sqrt(volume)
        flat = np.zeros_like(f)
        flat[:, 0, 0] = flat[:, 1, 1] = root
        flat[:, 2, 2] = 1
        f = np.where(solid[:, None, None], f, flat)
        spherical = np.where(solid, E * np.log(volume) - E, E * (volume - 1))
        stress = spherical[:, None, None] * np.eye(3)
        stress += np.where(solid[:, None, None], E * f @ f.transpose(0, 2, 1), 0)
        stress += act[:, None, None] * f[:, :, 2:] @ f[:, :, 2:].transpose(0, 2, 1)
        affine = -DT * 4 / dx**2 * stress + mass[:, None, None] * c

        momentum, grid_mass = np.zeros((N, N, N, 3)), np.zeros((N, N, N))
        nodes, shares = [], []
        for offset in OFFSETS:
            node = tuple((base + offset).T)
            share = w[:, offset[0], 0] * w[:, offset[1], 1] * w[:, offset[2], 2]
            away = (offset - fx) * dx
            given = mass[:, None] * v + np.einsum("pij,pj->pi", affine, away)
            np.add.at(momentum, node, share[:, None] * given)
            np.add.at(grid_mass, node, share * mass)
            nodes.append(node)
            shares.append(share)
        grid = momentum / (grid_mass + 1e-10)[..., None]
        grid[..., 1] -= DT * GRAVITY
        for axis in (0, 2, 1):
            layers = np.moveaxis(grid, axis, 0)  # a view: assignments change the grid
            layers[:3][layers[:3, ..., axis] < 0] = 0
            layers[N - 2 :][layers[N - 2 :, ..., axis] > 0] = 0

        v, c = np.zeros_like(v), np.zeros_like(c)
        for offset, node, share in zip(OFFSETS, nodes, shares, strict=True):
            seen = share[:, None] * grid[node]
            v += seen
            c += 4 / dx * seen[:, :, None] * (offset - fx)[:, None, :]
        x = x + DT * v
    return float(x[solid, 0].mean())
