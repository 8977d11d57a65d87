"""Extended position-based dynamics of a cloth that hangs at two corners.

The unknowns are the initial velocities of all vertices (m/s). The loss is the mean squared
distance of the last positions to a target height (m²). Positions and velocities are updated in
place; each step launches a prediction, the constraints in four colours, and a velocity update.
"""

import numpy as np
import tai as ti


def make(n=128, steps=12, sweeps=3):
    """Returns a function that runs one iteration, and the loss and its gradient as fields."""
    h, rest, compliance = 4e-3, 1.0 / n, 1e-7
    x = ti.Vector.field(3, ti.f32, shape=(steps + 1, n, n), needs_grad=True)
    v = ti.Vector.field(3, ti.f32, shape=(steps + 1, n, n), needs_grad=True)
    p = ti.Vector.field(3, ti.f32, shape=(steps * (4 * sweeps + 1) + 1, n, n), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def predict(t: ti.i32, s: ti.i32):
        for i, j in ti.ndrange(n, n):
            move = h * v[t, i, j] + h * h * ti.Vector([0.0, -9.8, 0.0])
            if j == n - 1 and (i == 0 or i == n - 1):
                move = ti.Vector([0.0, 0.0, 0.0])
            p[s, i, j] = x[t, i, j] + move

    @ti.func
    def pull(a, b):
        d = a - b
        length = ti.sqrt(d.dot(d) + 1e-12)
        return -0.5 * (length - rest) / (1.0 + compliance / (h * h)) * d / length

    @ti.kernel
    def relax(s: ti.i32, axis: ti.i32, parity: ti.i32):
        for i, j in ti.ndrange(n, n):
            k = i if axis == 0 else j
            other = k + 1 if k % 2 == parity else k - 1
            q = p[s, i, j]
            if other >= 0 and other < n:
                if not (j == n - 1 and (i == 0 or i == n - 1)):
                    if axis == 0:
                        q += pull(p[s, i, j], p[s, other, j])
                    else:
                        q += pull(p[s, i, j], p[s, i, other])
            p[s + 1, i, j] = q

    @ti.kernel
    def finish(t: ti.i32, s: ti.i32):
        for i, j in ti.ndrange(n, n):
            v[t + 1, i, j] = (p[s, i, j] - x[t, i, j]) / h * 0.999
            x[t + 1, i, j] = p[s, i, j]

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, n):
            d = x[steps, i, j][1] + 0.1
            loss[None] += d * d / (n * n)

    grid = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), -1) / n
    start = np.zeros((steps + 1, n, n, 3), np.float32)
    start[0, :, :, 0], start[0, :, :, 2] = grid[..., 0], grid[..., 1]
    x.from_numpy(start)

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            s = 0
            for t in range(steps):
                predict(t, s)
                for _ in range(sweeps):
                    for axis in range(2):
                        for parity in range(2):
                            relax(s, axis, parity)
                            s += 1
                finish(t, s)
                s += 1
            measure()

    return iterate, loss, v
