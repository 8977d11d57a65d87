"""Weakly compressible smoothed particles in 3-D, with a neighbour grid.

The unknowns are the initial velocities of all particles (m/s). The loss is the mean squared
distance of the particles from a point (m²) after the last step. Every step counts the particles
of each grid cell, writes their numbers into it, and sums pressure and viscosity over the 27 cells
around a particle.
"""

import numpy as np
import tai as ti


def make(n=8192, steps=10, cells=24):
    """Returns a function that runs one iteration, and the loss and its gradient as fields."""
    h, dt, most = 1.0 / cells, 2e-4, 32
    mass = 1.0 / n
    x = ti.Vector.field(3, ti.f32, shape=(steps + 1, n), needs_grad=True)
    v = ti.Vector.field(3, ti.f32, shape=(steps + 1, n), needs_grad=True)
    rho = ti.field(ti.f32, shape=(steps, n), needs_grad=True)
    count = ti.field(ti.i32, shape=(steps, cells, cells, cells))
    inside = ti.field(ti.i32, shape=(steps, cells, cells, cells, most))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.func
    def cell(position):
        return ti.math.clamp(ti.cast(ti.floor(position * cells), ti.i32), 0, cells - 1)

    @ti.kernel
    def empty(t: ti.i32):
        for i, j, k in ti.ndrange(cells, cells, cells):
            count[t, i, j, k] = 0

    @ti.kernel
    def fill(t: ti.i32):
        for p in range(n):
            c = cell(x[t, p])
            at = ti.atomic_add(count[t, c[0], c[1], c[2]], 1)
            if at < most:
                inside[t, c[0], c[1], c[2], at] = p

    @ti.func
    def weight(r):
        q = ti.max(1.0 - r / h, 0.0)
        return q * q * q

    @ti.kernel
    def density(t: ti.i32):
        for p in range(n):
            c = cell(x[t, p])
            total = 0.0
            for d in ti.grouped(ti.ndrange((-1, 2), (-1, 2), (-1, 2))):
                e = c + d
                if e.min() >= 0 and e.max() < cells:
                    for m in range(ti.min(count[t, e[0], e[1], e[2]], most)):
                        q = inside[t, e[0], e[1], e[2], m]
                        total += mass * weight((x[t, p] - x[t, q]).norm(1e-9))
            rho[t, p] = total

    @ti.kernel
    def step(t: ti.i32):
        for p in range(n):
            c = cell(x[t, p])
            force = ti.Vector([0.0, -9.8, 0.0])
            for d in ti.grouped(ti.ndrange((-1, 2), (-1, 2), (-1, 2))):
                e = c + d
                if e.min() >= 0 and e.max() < cells:
                    for m in range(ti.min(count[t, e[0], e[1], e[2]], most)):
                        q = inside[t, e[0], e[1], e[2], m]
                        apart = x[t, p] - x[t, q]
                        r = apart.norm(1e-6)
                        push = 1e-3 * mass * (1.0 / rho[t, p] + 1.0 / rho[t, q])
                        force += push * weight(r) * apart / r
                        force += 0.1 * mass * weight(r) / rho[t, q] * (v[t, q] - v[t, p])
            v[t + 1, p] = v[t, p] + dt * force
            x[t + 1, p] = x[t, p] + dt * v[t + 1, p]

    @ti.kernel
    def measure():
        for p in range(n):
            d = x[steps, p] - ti.Vector([0.5, 0.4, 0.5])
            loss[None] += d.dot(d) / n

    side = round(n ** (1 / 3)) + 1
    points = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)[:n]
    start = np.zeros((steps + 1, n, 3), np.float32)
    start[0] = 0.2 + 0.5 * points / side + 1e-3 * np.random.default_rng(1).random((n, 3))
    x.from_numpy(start)

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            for t in range(steps):
                empty(t)
                fill(t)
                density(t)
                step(t)
            measure()

    return iterate, loss, v
