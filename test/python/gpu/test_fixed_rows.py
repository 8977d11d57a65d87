"""Rows of fields at constant indices, in steps of a program: each waits for those that it needs.

The compiler adds the constants of several indices up, and a loop whose bounds are arguments leaves
the last index unknown. A step that was taken for one of another row did not wait, and a sweep lost
its gradient from the second run on.
"""

import numpy as np
import pytest
import tai as ti

RUNS = 4


@pytest.fixture(params=[1, 32])
def start(request, monkeypatch):
    """`ti.init` on the emulated device, with blocks of so many threads."""
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    monkeypatch.setenv("TAI_EMULATED_THREADS", str(request.param))
    ti.init(offline_cache=False, default_fp=ti.f64)


@pytest.mark.parametrize("bodies, n, steps", [(3, 16, 2), (1, 7, 1), (8, 33, 3)])
@pytest.mark.parametrize("layout", ["whole", "blocks", "turned"])
def test_a_loss_on_one_body(start, layout, bodies, n, steps):
    x = ti.field(ti.f64, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    if layout == "whole":
        ti.root.dense(ti.ijk, (steps + 1, bodies, n)).place(x)
    elif layout == "blocks":
        ti.root.dense(ti.ij, (steps + 1, bodies)).dense(ti.k, (n + 3) // 4).dense(ti.k, 4).place(x)
    else:
        ti.root.dense(ti.k, n).dense(ti.ij, (steps + 1, bodies)).place(x)
    ti.root.lazy_grad()

    @ti.kernel
    def advance(t: ti.i32):
        for b, i in ti.ndrange(bodies, n):
            x[t + 1, b, i] = x[t, b, i] + ti.sin(x[t, b, i])

    @ti.kernel
    def total(first: ti.i32, last: ti.i32):
        for i in range(first, last):
            loss[None] += x[steps, bodies - 1, i] ** 2

    data = np.random.default_rng(n).uniform(0.2, 1.0, (bodies, n))
    for number in range(RUNS):
        first, last = number % 3, number % 3 + 3
        for b in range(bodies):
            for i in range(n):
                x[0, b, i] = data[b, i]
        loss[None] = 0
        with ti.ad.Tape(loss):
            for t in range(steps):
                advance(t)
            total(first, last)
        value, slope = data[-1], np.ones(n)
        for _ in range(steps):
            value, slope = value + np.sin(value), slope * (1 + np.cos(value))
        expected = np.zeros((bodies, n))
        expected[-1, first:last] = (2 * value * slope)[first:last]
        assert abs(loss[None] - (value[first:last] ** 2).sum()) < 1e-12 * loss[None]
        np.testing.assert_allclose(x.grad.to_numpy()[0, :bodies, :n], expected, rtol=1e-12)


def test_rows_of_vectors(start):
    n = 16
    x = ti.Vector.field(3, ti.f64, shape=(4, 2, n), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def copy(first: ti.i32, last: ti.i32):
        for i in range(first, last):
            x[3, 1, i][2] = ti.exp(x[2, 0, i][1])

    @ti.kernel
    def prepare(first: ti.i32, last: ti.i32):
        for i in range(first, last):
            x[2, 0, i][1] = 0.5 * x[1, 1, i][0]

    @ti.kernel
    def total():
        for i in range(n):
            loss[None] += x[3, 1, i][2]

    for number in range(RUNS):
        x.fill(0)
        loss[None] = 0
        for i in range(n):
            x[1, 1, i] = [0.1 * i, 0, 0]
        first = number % 2
        with ti.ad.Tape(loss):
            prepare(first, n)
            copy(first, n)
            total()
        values = np.exp(0.05 * np.arange(n))[first:]
        assert abs(loss[None] - values.sum()) < 1e-12 * loss[None]
        gradient = x.grad.to_numpy()[1, 1, :, 0]
        np.testing.assert_allclose(gradient[first:], 0.5 * values, rtol=1e-12)
        assert not gradient[:first].any()
