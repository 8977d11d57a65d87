"""Launches without a tape between gradients, while the sweep's last zeros are not stored yet."""

import numpy as np
import pytest
import tai as ti

STEPS = 5


@pytest.fixture(params=["f32", "f64"])
def scene(request):
    fp = getattr(ti, request.param)
    ti.init(default_fp=fp, offline_cache=False)
    x = ti.field(fp, shape=(STEPS + 1, 7), needs_grad=True)
    a = ti.field(fp, shape=7, needs_grad=True)
    loss = ti.field(fp, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in a:
            x[t + 1, i] = a[i] * x[t, i]

    @ti.kernel
    def total():
        for i in a:
            loss[None] += x[STEPS, i]

    def run():
        for t in range(STEPS):
            step(t)
        total()

    x.fill(1.0)
    a.from_numpy(np.linspace(0.5, 1.5, 7))
    return x, a, loss, run


def gradient(a):
    return STEPS * a.to_numpy() ** (STEPS - 1)


def test_evaluations_between_gradients(scene):
    x, a, loss, run = scene
    for _ in range(3):
        with ti.ad.Tape(loss):
            run()
        for _ in range(3):
            loss[None] = 0.0
            run()
            np.testing.assert_allclose(loss[None], (a.to_numpy() ** STEPS).sum(), 1e-5)
        np.testing.assert_allclose(a.grad.to_numpy(), gradient(a), 1e-5)


def test_kernels_that_read_gradients(scene):
    """Each sees the zeros of overwritten steps, also one that was launched before the sweep."""
    x, a, loss, run = scene
    seen = ti.field(ti.f64, shape=x.shape)

    @ti.kernel
    def copy():
        for i, j in x:
            seen[i, j] = x.grad[i, j]

    for _ in range(4):
        copy()
    assert not seen.to_numpy().any()
    for _ in range(3):
        with ti.ad.Tape(loss):
            run()
        run()
        copy()
        found = seen.to_numpy()
        assert not found[1:].any()
        np.testing.assert_allclose(found[0], a.to_numpy() ** STEPS, 1e-5)


def test_kernels_that_write_gradients(scene):
    """A store to an element stays, whatever is stored around it later."""
    x, a, loss, run = scene

    @ti.kernel
    def put(value: ti.f64):
        for i in range(7):
            x.grad[2, i] = value

    for _ in range(4):
        put(1.0)
    with ti.ad.Tape(loss):
        run()
    run()
    put(3.0)
    run()
    found = x.grad.to_numpy()
    assert (found[2] == 3.0).all()
    assert not found[1].any() and not found[3:].any()


def test_steps_of_descent(scene):
    x, a, loss, run = scene
    by_hand = a.to_numpy().astype(np.float64)

    @ti.kernel
    def update():
        for i in a:
            a[i] -= 0.01 * a.grad[i]

    for _ in range(10):
        with ti.ad.Tape(loss):
            run()
        run()
        update()
        by_hand -= 0.01 * STEPS * by_hand ** (STEPS - 1)
    np.testing.assert_allclose(a.to_numpy(), by_hand, 1e-5)
