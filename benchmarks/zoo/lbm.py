"""A lattice Boltzmann flow in two dimensions (D2Q9, one relaxation time), periodic.

The unknowns are the initial densities of all directions. The loss is the mean squared velocity
along the first axis at the end.
"""

import numpy as np
import tai as ti

VELOCITIES = [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]
WEIGHTS = [4 / 9] + [1 / 9] * 4 + [1 / 36] * 4


def make(n=96, steps=16):
    """Returns a function that runs one iteration, the loss, and the unknowns."""
    relax = 0.8
    f = ti.field(ti.f32, shape=(steps + 1, n, n, 9), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            density, flow_x, flow_y = 0.0, 0.0, 0.0
            for k in ti.static(range(9)):
                e = ti.static(VELOCITIES[k])
                part = f[t, (i - e[0] + n) % n, (j - e[1] + n) % n, k]
                density += part
                flow_x += e[0] * part
                flow_y += e[1] * part
            u, v = flow_x / density, flow_y / density
            for k in ti.static(range(9)):
                e = ti.static(VELOCITIES[k])
                along = 3.0 * (e[0] * u + e[1] * v)
                rest = WEIGHTS[k] * density
                rest *= 1.0 + along + 0.5 * along * along - 1.5 * (u * u + v * v)
                part = f[t, (i - e[0] + n) % n, (j - e[1] + n) % n, k]
                f[t + 1, i, j, k] = part + relax * (rest - part)

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, n):
            flow = 0.0
            for k in ti.static(range(9)):
                flow += ti.static(VELOCITIES[k])[0] * f[steps, i, j, k]
            loss[None] += flow * flow / (n * n)

    start = np.zeros((steps + 1, n, n, 9), np.float32)
    wave = 0.1 * np.sin(2 * np.pi * np.arange(n) / n)
    for k, e in enumerate(VELOCITIES):
        start[0, :, :, k] = WEIGHTS[k] * (1 + 3 * e[0] * wave[None, :] + e[1] * wave[:, None])
    f.from_numpy(start)

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            for t in range(steps):
                step(t)
            measure()

    return iterate, loss, f
