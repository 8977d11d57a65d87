"""A picture as a small network of its coordinates, two hidden layers.

The unknowns are the weights. The loss is the mean squared difference from rings.
"""

import numpy as np
import tai as ti


def make(n=64, width=16):
    """Returns a function that runs one iteration, the loss, and the unknowns."""
    first = ti.field(ti.f32, shape=(width, 3), needs_grad=True)
    second = ti.field(ti.f32, shape=(width, width + 1), needs_grad=True)
    last = ti.field(ti.f32, shape=width + 1, needs_grad=True)
    a, b = (ti.field(ti.f32, shape=(n, n, width), needs_grad=True) for _ in range(2))
    picture = ti.field(ti.f32, shape=(n, n), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def encode():
        for i, j, k in a:
            a[i, j, k] = ti.sin(first[k, 0] * i / n + first[k, 1] * j / n + first[k, 2])

    @ti.kernel
    def hide():
        for i, j, k in b:
            total = second[k, width]
            for m in range(width):
                total += second[k, m] * a[i, j, m]
            b[i, j, k] = ti.tanh(total)

    @ti.kernel
    def show():
        for i, j in picture:
            total = last[width]
            for m in range(width):
                total += last[m] * b[i, j, m]
            picture[i, j] = total

    @ti.kernel
    def measure():
        for i, j in picture:
            x, y = i / n - 0.5, j / n - 0.5
            d = picture[i, j] - ti.sin(20.0 * (x * x + y * y))
            loss[None] += d * d / (n * n)

    random = np.random.default_rng(1)
    first.from_numpy((4 * random.standard_normal((width, 3))).astype(np.float32))
    second.from_numpy((0.3 * random.standard_normal((width, width + 1))).astype(np.float32))
    last.from_numpy((0.3 * random.standard_normal(width + 1)).astype(np.float32))

    def iterate():
        loss[None] = 0.0
        with ti.ad.Tape(loss):
            encode()
            hide()
            show()
            measure()

    return iterate, loss, second
