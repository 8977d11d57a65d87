"""Loops long enough to be polled, in kernels that flush denormal numbers.

Such a kernel is a function that sets the processor's control word, and one that computes. The
second is called from one place, and LLVM may change what its arguments are, of which a poll needs
the first.
"""

import numpy as np
import pytest
import tai as ti

STEPS = 20


def descend(n: int, **modes) -> tuple[float, np.ndarray]:
    """Loss and gradient of a chain of steps over `n` elements."""
    ti.init(arch=ti.cpu, **modes)
    x = ti.field(ti.f32, (STEPS, n), needs_grad=True)
    loss = ti.field(ti.f32, (), needs_grad=True)
    start = np.zeros((STEPS, n), np.float32)
    start[0] = np.random.default_rng(1).random(n)
    x.from_numpy(start)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            s = 0.0
            for j in range(8):
                s += ti.sin(x[t - 1, i] * j)
            x[t, i] = 0.1 * s

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += x[STEPS - 1, i]

    # The third time the tape is replayed.
    for _ in range(4):
        with ti.ad.Tape(loss):
            for t in range(1, STEPS):
                step(t)
            measure()
    return loss[None], x.grad.to_numpy()[0]


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("n", [1, 3000, 65_537])
def test_long_loops_flush_and_are_polled(n, threads):
    loss, gradient = descend(n, ftz=True, cpu_max_num_threads=threads)
    expected, slopes = descend(n, cpu_max_num_threads=threads)
    # No number of these programs is denormal, so that flushing changes no result.
    assert loss == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(gradient, slopes, rtol=1e-3, atol=1e-5 * np.abs(slopes).max())
