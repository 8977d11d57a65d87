"""Fills in front of replays and between the launches of a tape.

Whether fills are fused, delayed or dropped, fields have the values that they have on the CPU, and
that NumPy computes.
"""

import os

import numpy as np
import pytest
import tai as ti

N, M = 7, 40


@pytest.fixture(autouse=True)
def device(monkeypatch, request):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if request.config.getoption("--arch") != "cuda":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")


class Fields:
    """Three fields in one cell, and two that lie elsewhere, with gradients."""

    def __init__(self):
        self.a, self.b, self.c = (ti.field(ti.f32) for _ in range(3))
        self.d, self.e = ti.field(ti.f64), ti.field(ti.i8)
        ti.root.dense(ti.i, N).dense(ti.j, M).place(self.a, self.b, self.c)
        ti.root.dense(ti.ij, (N, M)).place(self.d)
        ti.root.dense(ti.i, 13).place(self.e)
        self.loss = ti.field(ti.f64, shape=())
        ti.root.lazy_grad()
        a, b, c, d, loss = self.a, self.b, self.c, self.d, self.loss

        @ti.kernel
        def add(t: ti.i32):
            for j in range(M):
                a[t, j] += 0.5 * b[t, j]
                d[t, j] += a[t, j] * c[t, j]

        @ti.kernel
        def total():
            for i, j in d:
                loss[None] += d[i, j] * d[i, j]

        self.add, self.total = add, total

    def forward(self):
        for t in range(N):
            self.add(t)
        self.total()


def expected(a, b, c, d):
    """The fields after `forward`, and the gradients of a and c."""
    a = np.full((N, M), a + 0.5 * b, np.float64)
    d = d + a * c
    return a, d, np.sum(d * d), 2 * d * c, 2 * d * a


def test_what_is_filled_last_counts():
    ti.init(offline_cache=False)
    f = Fields()
    f.b.fill(0.5)
    f.c.fill(1.0)
    with ti.ad.Tape(f.loss) as tape:
        f.forward()
    for k in range(12):
        # In each replay with other values and in another order, some of them twice.
        fills = [(f.a, 1.0 + k), (f.b, 0.25 * k), (f.c, 2.0), (f.d, -1.0), (f.e, k)]
        for field, value in fills[k % 5 :] + fills[: k % 5]:
            field.fill(7)
            field.fill(value)
        f.a.grad.fill(5.0)
        f.loss[None] = 0.0
        tape.replay()
        a, d, loss, grad_a, grad_c = expected(1.0 + k, 0.25 * k, 2.0, -1.0)
        np.testing.assert_allclose(f.a.to_numpy(), a, rtol=1e-6)
        np.testing.assert_allclose(f.d.to_numpy(), d, rtol=1e-6)
        np.testing.assert_allclose(f.loss[None], loss, rtol=1e-6)
        np.testing.assert_allclose(f.a.grad.to_numpy(), grad_a, rtol=1e-6)
        np.testing.assert_allclose(f.c.grad.to_numpy(), grad_c, rtol=1e-6)
        assert (f.e.to_numpy() == k).all()
        assert (f.b.to_numpy() == np.float32(0.25 * k)).all()


@pytest.mark.parametrize("fuse", [True, False])
def test_fills_without_a_tape_keep_their_order(fuse):
    ti.init(offline_cache=False, fuse_launches=fuse)
    f = Fields()
    rng = np.random.default_rng(3)
    fields = [f.a, f.b, f.c, f.d, f.e]
    held = [np.zeros(field.shape) for field in fields]
    for _ in range(60):
        for _ in range(rng.integers(1, 9)):
            k, value = rng.integers(len(fields)), int(rng.integers(100))
            fields[k].fill(value)
            held[k][...] = value
        if rng.integers(2):
            t = int(rng.integers(N))
            f.add(t)
            held[0][t] += 0.5 * held[1][t]
            held[3][t] += held[0][t] * held[2][t]
        if rng.integers(3) == 0:
            for field, values in zip(fields, held, strict=True):
                np.testing.assert_allclose(field.to_numpy(), values, rtol=1e-5)
            # Sums of sums would leave what f32 holds.
            f.a.fill(1)
            held[0][...] = 1
    assert os.environ["TI_ARCH"] == "cuda"


def test_fills_in_kernels():
    pair = ti.types.struct(a=ti.f32, v=ti.math.vec2)
    x, v = ti.field(ti.i32, shape=(3, 4)), ti.Vector.field(2, ti.f32, shape=3)
    one, pairs = ti.field(ti.f32, shape=()), pair.field(shape=2)
    sparse = ti.field(ti.i32)
    ti.root.pointer(ti.i, 4).dense(ti.i, 4).place(sparse)

    @ti.func
    def clear(field: ti.template(), value):
        field.fill(value)

    @ti.kernel
    def activate():
        sparse[5] = 1

    @ti.kernel
    def kernel(a: ti.f32):
        x.fill(7)
        for i, j in x:
            x[i, j] += i
        clear(v, ti.Vector([a, 2 * a]))
        one.fill(a)
        pairs.fill(val=3)
        sparse.fill(9)

    activate()
    kernel(1.5)
    assert x.to_numpy().tolist() == [[7 + i] * 4 for i in range(3)]
    assert v.to_numpy().tolist() == [[1.5, 3.0]] * 3
    assert one[None] == 1.5
    assert pairs.a.to_numpy().tolist() == [3] * 2
    assert pairs.v.to_numpy().tolist() == [[3, 3]] * 2
    assert sparse.to_numpy().tolist() == [0] * 4 + [9] * 4 + [0] * 8  # what is active
