"""Bodies that attract each other, all pairs, by a symplectic Euler method.

The unknowns are the initial velocities. The loss is the mean squared distance from the origin
after the last step.
"""

import numpy as np
import tai as ti


def make(n=1024, steps=8):
    """Returns a function that runs one iteration, the loss, and the unknowns."""
    dt, soft = 1e-2, 1e-2
    x = ti.Vector.field(3, ti.f32, shape=(steps + 1, n), needs_grad=True)
    v = ti.Vector.field(3, ti.f32, shape=(steps + 1, n), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            pull = ti.Vector([0.0, 0.0, 0.0])
            for j in range(n):
                d = x[t, j] - x[t, i]
                r = ti.sqrt(d.dot(d) + soft)
                pull += d / (r * r * r * n)
            v[t + 1, i] = v[t, i] + dt * pull
            x[t + 1, i] = x[t, i] + dt * (v[t, i] + dt * pull)

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += x[steps, i].dot(x[steps, i]) / n

    start = np.zeros((steps + 1, n, 3), np.float32)
    start[0] = np.random.default_rng(1).random((n, 3)) - 0.5
    x.from_numpy(start)

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            for t in range(steps):
                step(t)
            measure()

    return iterate, loss, v
