"""Heat in a plate of triangles, one implicit step, solved by conjugate gradients.

The unknowns are the sources in all vertices. The loss is the mean squared temperature. Each
iteration of the solver launches five short kernels; its vectors have an axis for the iteration.
"""

import numpy as np
import tai as ti


def make(n=64, rounds=12):
    """Returns a function that runs one iteration, the loss, and the unknowns."""
    count = n * n
    stiffness, mass = 0.2, 1.0
    x, r, p = (ti.field(ti.f32, shape=(rounds + 1, count), needs_grad=True) for _ in range(3))
    ap = ti.field(ti.f32, shape=(rounds, count), needs_grad=True)
    rr = ti.field(ti.f32, shape=rounds + 1, needs_grad=True)
    pap = ti.field(ti.f32, shape=rounds, needs_grad=True)
    source = ti.field(ti.f32, shape=count, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    corner = ti.Vector.field(3, ti.i32, shape=2 * (n - 1) * (n - 1))

    @ti.kernel
    def begin():
        for i in range(count):
            r[0, i] = source[i]
            p[0, i] = source[i]
            rr[0] += source[i] * source[i]

    @ti.kernel
    def lump(k: ti.i32):
        for i in range(count):
            ap[k, i] += mass * p[k, i]

    @ti.kernel
    def apply(k: ti.i32):
        for e in corner:
            a, b, c = corner[e][0], corner[e][1], corner[e][2]
            along, across = p[k, b] - p[k, a], p[k, c] - p[k, a]
            ap[k, a] -= stiffness * (along + across)
            ap[k, b] += stiffness * along
            ap[k, c] += stiffness * across

    @ti.kernel
    def product(k: ti.i32):
        for i in range(count):
            pap[k] += p[k, i] * ap[k, i]

    @ti.kernel
    def advance(k: ti.i32):
        for i in range(count):
            alpha = rr[k] / pap[k]
            x[k + 1, i] = x[k, i] + alpha * p[k, i]
            r[k + 1, i] = r[k, i] - alpha * ap[k, i]

    @ti.kernel
    def square(k: ti.i32):
        for i in range(count):
            rr[k + 1] += r[k + 1, i] * r[k + 1, i]

    @ti.kernel
    def turn(k: ti.i32):
        for i in range(count):
            p[k + 1, i] = r[k + 1, i] + rr[k + 1] / rr[k] * p[k, i]

    @ti.kernel
    def measure():
        for i in range(count):
            loss[None] += x[rounds, i] * x[rounds, i] / count

    vertex = np.arange(count).reshape(n, n)
    lower = [vertex[:-1, :-1], vertex[1:, :-1], vertex[:-1, 1:]]
    upper = [vertex[1:, 1:], vertex[:-1, 1:], vertex[1:, :-1]]
    parts = [np.stack([v.ravel() for v in half], -1) for half in (lower, upper)]
    corner.from_numpy(np.concatenate(parts).astype(np.int32))
    source.from_numpy(np.random.default_rng(1).random(count).astype(np.float32))

    def iterate():
        for field in (ap, rr, pap):
            field.fill(0.0)
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            begin()
            for k in range(rounds):
                lump(k)
                apply(k)
                product(k)
                advance(k)
                square(k)
                turn(k)
            measure()

    return iterate, loss, source
