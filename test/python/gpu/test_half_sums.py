"""Sums into one 16-bit number by many threads of a GPU are rounded once."""

import os

import numpy as np
import pytest
import tai as ti

from half_floats import nearest


@pytest.fixture(autouse=True)
def device(monkeypatch):
    if os.environ.get("TI_ARCH") != "cuda":
        monkeypatch.setenv("TI_ARCH", "cuda")
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
@pytest.mark.parametrize("n", [1, 33, 3001, 65537, 1_000_003])
def test_totals(dt, n):
    ti.init()
    x = ti.field(dt, n)
    s, d = ti.field(dt, ()), ti.Vector.field(2, dt, ())
    x.fill(1 / 64)

    @ti.kernel
    def add():
        for i in x:
            s[None] += x[i]
            d[None] -= ti.Vector([x[i], 2 * x[i]])

    add()
    assert s[None] == nearest(n / 64, dt)
    assert d.to_numpy().tolist() == [nearest(-n / 64, dt), nearest(-n / 32, dt)]


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
def test_to_what_stands_there(dt):
    """Launches add to what others have left, also when they are replayed."""
    ti.init()
    x, s = ti.field(dt, 4096), ti.field(dt, ())
    x.fill(1 / 64)

    @ti.kernel
    def add():
        for i in x:
            s[None] += x[i]

    s[None] = 64
    for _ in range(5):
        add()
    assert s[None] == 64 + 5 * 64


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
@pytest.mark.parametrize("deterministic", [False, True])
def test_losses_and_gradients(dt, deterministic):
    ti.init(deterministic=deterministic)
    n = 20_000
    x = ti.field(dt, n, needs_grad=True)
    w = ti.field(dt, (), needs_grad=True)
    loss = ti.field(dt, (), needs_grad=True)
    x.fill(1 / 64)
    w[None] = 2

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] * w[None]

    for _ in range(3):
        with ti.ad.Tape(loss):
            measure()
    assert loss[None] == nearest(n / 32, dt)
    assert w.grad[None] == n / 64
    assert np.all(x.grad.to_numpy() == 2)
