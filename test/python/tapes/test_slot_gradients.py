"""Gradients of steps between slots of one field, which a launch gives in any order."""

import itertools

import numpy as np
import pytest
import tai as ti

N = 23


def wave(old, now):
    """The step in NumPy: the inner elements of the next slot."""
    inner = 2 * now[1:-1] - old[1:-1] + 0.1 * (now[:-2] - 2 * now[1:-1] + now[2:])
    return np.concatenate([[0.0], inner, [0.0]])


def wave_gradient(bar):
    """The gradients by the old and the present slot."""
    inner = np.concatenate([[0.0], bar[1:-1], [0.0]])
    now = 1.8 * inner
    now[:-1] += 0.1 * inner[1:]
    now[1:] += 0.1 * inner[:-1]
    return -inner, now


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("order", [*itertools.permutations(range(3)), (3, 0, 1)])
def test_a_wave_with_three_slots(order, threads):
    ti.init(default_fp=ti.f64, cpu_max_num_threads=threads)
    x = ti.field(float, shape=(4, N), needs_grad=True)
    loss = ti.field(float, shape=(), needs_grad=True)
    rng = np.random.default_rng(0)
    values, weights = rng.normal(size=(4, N)), rng.normal(size=N)

    @ti.kernel
    def step(a: ti.i32, b: ti.i32, c: ti.i32):
        for i in range(1, N - 1):
            x[c, i] = 2 * x[b, i] - x[a, i] + 0.1 * (x[b, i - 1] - 2 * x[b, i] + x[b, i + 1])

    @ti.kernel
    def measure(c: ti.i32, w: ti.types.ndarray()):
        for i in range(1, N - 1):
            loss[None] += w[i] * x[c, i]

    a, b, c = order
    x.from_numpy(values)
    with ti.ad.Tape(loss):
        step(a, b, c)
        measure(c, weights)
    expected = wave(values[a], values[b])
    np.testing.assert_allclose(x.to_numpy()[c, 1:-1], expected[1:-1], rtol=1e-13)
    old, now = wave_gradient(weights)
    np.testing.assert_allclose(x.grad.to_numpy()[a], old, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(x.grad.to_numpy()[b], now, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("order", [(0, 0, 1), (1, 1, 0)])
def test_three_slots_of_which_two_are_equal(order):
    ti.init(default_fp=ti.f64)
    x = ti.field(float, shape=(4, N), needs_grad=True)
    rng = np.random.default_rng(0)
    bars = rng.normal(size=N)

    @ti.kernel
    def step(a: ti.i32, b: ti.i32, c: ti.i32):
        for i in range(1, N - 1):
            x[c, i] = 2 * x[b, i] - x[a, i] + 0.1 * (x[b, i - 1] - 2 * x[b, i] + x[b, i + 1])

    a, b, c = order
    with ti.ad.Tape() as tape:
        step(a, b, c)
    seeds = np.zeros((4, N))
    seeds[c] = bars
    tape.backward({x: seeds})
    old, now = wave_gradient(bars)
    np.testing.assert_allclose(x.grad.to_numpy()[a], old + now, rtol=1e-12, atol=1e-13)


def test_a_ring_of_three_slots():
    ti.init(default_fp=ti.f64)
    x = ti.field(float, shape=(3, N), needs_grad=True)
    loss = ti.field(float, shape=(), needs_grad=True)
    values = np.random.default_rng(0).normal(size=(3, N))

    @ti.kernel
    def step(t: ti.i32):
        for i in range(1, N - 1):
            now = x[(t + 1) % 3, i]
            around = x[(t + 1) % 3, i - 1] - 2 * now + x[(t + 1) % 3, i + 1]
            x[(t + 2) % 3, i] = 2 * now - x[t % 3, i] + 0.1 * around

    @ti.kernel
    def measure(c: ti.i32):
        for i in range(1, N - 1):
            loss[None] += x[c, i]

    x.from_numpy(values)
    with ti.ad.Tape(loss):
        for t in range(7):
            step(t)
        measure(8 % 3)
    bars = {2: np.ones(N), 1: np.zeros(N), 0: np.zeros(N)}
    for t in reversed(range(7)):
        bar = bars[(t + 2) % 3]
        old, now = wave_gradient(bar)
        bars[(t + 1) % 3] = bars[(t + 1) % 3] + now
        bars[t % 3] = bars[t % 3] + old
        bars[(t + 2) % 3] = np.concatenate([bar[:1], np.zeros(N - 2), bar[-1:]])
    found = x.grad.to_numpy()
    for slot in (0, 1):
        np.testing.assert_allclose(found[slot, 1:-1], bars[slot][1:-1], rtol=1e-10, atol=1e-11)
