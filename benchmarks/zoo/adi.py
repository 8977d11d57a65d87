"""Diffusion by alternating directions: a tridiagonal system for each row, then for each column.

The unknowns are the initial values. The loss is the mean squared value at the end. Each thread
solves one system by elimination in a serial loop.
"""

import numpy as np
import tai as ti


def make(n=96, steps=6):
    """Returns a function that runs one iteration, the loss, and the unknowns."""
    k = 0.3
    u = ti.field(ti.f32, shape=(2 * steps + 1, n, n), needs_grad=True)
    c = ti.field(ti.f32, shape=(2 * steps, n, n), needs_grad=True)
    d = ti.field(ti.f32, shape=(2 * steps, n, n), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def rows(s: ti.i32):
        for i in range(n):
            for j in range(n):
                above, below = u[s, ti.max(i - 1, 0), j], u[s, ti.min(i + 1, n - 1), j]
                right = u[s, i, j] + k * (above - 2.0 * u[s, i, j] + below)
                if j == 0:
                    c[s, i, j] = -k / (1.0 + 2.0 * k)
                    d[s, i, j] = right / (1.0 + 2.0 * k)
                else:
                    pivot = 1.0 + 2.0 * k + k * c[s, i, j - 1]
                    c[s, i, j] = -k / pivot
                    d[s, i, j] = (right + k * d[s, i, j - 1]) / pivot
            for back in range(n):
                j = n - 1 - back
                u[s + 1, i, j] = d[s, i, j]
                if j < n - 1:
                    u[s + 1, i, j] -= c[s, i, j] * u[s + 1, i, j + 1]

    @ti.kernel
    def columns(s: ti.i32):
        for j in range(n):
            for i in range(n):
                left, right_of = u[s, i, ti.max(j - 1, 0)], u[s, i, ti.min(j + 1, n - 1)]
                right = u[s, i, j] + k * (left - 2.0 * u[s, i, j] + right_of)
                if i == 0:
                    c[s, i, j] = -k / (1.0 + 2.0 * k)
                    d[s, i, j] = right / (1.0 + 2.0 * k)
                else:
                    pivot = 1.0 + 2.0 * k + k * c[s, i - 1, j]
                    c[s, i, j] = -k / pivot
                    d[s, i, j] = (right + k * d[s, i - 1, j]) / pivot
            for back in range(n):
                i = n - 1 - back
                u[s + 1, i, j] = d[s, i, j]
                if i < n - 1:
                    u[s + 1, i, j] -= c[s, i, j] * u[s + 1, i + 1, j]

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, n):
            loss[None] += u[2 * steps, i, j] * u[2 * steps, i, j] / (n * n)

    start = np.zeros((2 * steps + 1, n, n), np.float32)
    start[0] = np.random.default_rng(1).random((n, n))
    u.from_numpy(start)

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            for t in range(steps):
                rows(2 * t)
                columns(2 * t + 1)
            measure()

    return iterate, loss, u
