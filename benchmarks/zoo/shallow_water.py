"""Shallow water in a closed basin, by a Lax-Friedrichs method with clamped borders.

The unknowns are the initial heights (m). The loss is the mean squared height above a level at the
end (m²), weighted towards one corner.
"""

import numpy as np
import tai as ti


def make(n=128, steps=24):
    """Returns a function that runs one iteration, the loss, and the unknowns."""
    k, gravity = 0.1, 1.0  # time step over the size of a cell
    h, p, q = (ti.field(ti.f32, shape=(steps + 1, n, n), needs_grad=True) for _ in range(3))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            a, b = ti.max(i - 1, 0), ti.min(i + 1, n - 1)
            c, d = ti.max(j - 1, 0), ti.min(j + 1, n - 1)
            h[t + 1, i, j] = 0.25 * (h[t, a, j] + h[t, b, j] + h[t, i, c] + h[t, i, d]) - k * (
                p[t, b, j] - p[t, a, j] + q[t, i, d] - q[t, i, c]
            )
            push_x = gravity * 0.5 * (h[t, b, j] * h[t, b, j] - h[t, a, j] * h[t, a, j])
            push_y = gravity * 0.5 * (h[t, i, d] * h[t, i, d] - h[t, i, c] * h[t, i, c])
            if i > 0 and i < n - 1:
                push_x += p[t, b, j] * p[t, b, j] / h[t, b, j]
                push_x -= p[t, a, j] * p[t, a, j] / h[t, a, j]
            if j > 0 and j < n - 1:
                push_y += q[t, i, d] * q[t, i, d] / h[t, i, d]
                push_y -= q[t, i, c] * q[t, i, c] / h[t, i, c]
            p[t + 1, i, j] = 0.25 * (p[t, a, j] + p[t, b, j] + p[t, i, c] + p[t, i, d]) - k * push_x
            q[t + 1, i, j] = 0.25 * (q[t, a, j] + q[t, b, j] + q[t, i, c] + q[t, i, d]) - k * push_y

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, n):
            above = h[steps, i, j] - 1.0
            loss[None] += above * above * (i + j) / (n * n * n)

    start = np.zeros((steps + 1, n, n), np.float32)
    at = np.arange(n) / n - 0.3
    start[0] = 1.0 + 0.3 * np.exp(-40 * (at[:, None] ** 2 + at[None, :] ** 2))
    h.from_numpy(start)

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            for t in range(steps):
                step(t)
            measure()

    return iterate, loss, h
