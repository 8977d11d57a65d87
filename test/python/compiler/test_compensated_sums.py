"""Compensated sums of what cancels: gathered (adjoints of stencils), and of products."""

import math
from fractions import Fraction

import numpy as np
import pytest
import tai as ti

NPT = {ti.f32: np.float32, ti.f64: np.float64}


@pytest.mark.parametrize("dt", [ti.f32, ti.f64])
@pytest.mark.parametrize("n", [5, 1031])
def test_compensated_gathers(dt, n):
    """The adjoint of a stencil sums what cancels, in each element by itself."""
    digits = 20 if dt == ti.f32 else 49
    rng = np.random.default_rng(n)
    # The terms of element i, exact products: two large ones that cancel but for their last digits.
    large = np.ldexp(rng.integers(2 ** (digits - 1), 2**digits, n).astype(NPT[dt]), -digits)
    small = np.ldexp(rng.integers(1, 2**9, n).astype(NPT[dt]), -digits - 9)

    def gradient(sums):
        ti.init(arch=ti.cpu, default_fp=dt, sums=sums)
        x = ti.field(dt, n, needs_grad=True)
        w = [ti.field(dt, n) for _ in range(3)]
        loss = ti.field(dt, (), needs_grad=True)

        @ti.kernel
        def stencil():
            for i in x:
                left, right = (i + n - 1) % n, (i + 1) % n
                loss[None] += (
                    x[left] * 2.0 * w[0][i] + x[i] * 0.5 * w[1][i] - x[right] * 4.0 * w[2][i]
                )

        w[0].from_numpy(np.roll(large, 1))
        w[1].from_numpy(small)
        w[2].from_numpy(np.roll(large, -1) / 2)
        with ti.ad.Tape(loss):
            stencil()
        return x.grad.to_numpy()

    np.testing.assert_array_equal(gradient("compensated"), small / 2)
    # Otherwise the test above could not fail.
    assert np.any(gradient("default") != small / 2)


@pytest.mark.filterwarnings("ignore:the loss")
def test_compensated_gathers_keep_infinities():
    ti.init(arch=ti.cpu, default_fp=ti.f64, sums="compensated")
    x = ti.field(ti.f64, 8, needs_grad=True)
    w = ti.field(ti.f64, 8)
    loss = ti.field(ti.f64, (), needs_grad=True)

    @ti.kernel
    def stencil():
        for i in x:
            loss[None] += (x[i] + x[(i + 1) % 8]) * w[i]

    w.from_numpy(np.array([1, math.inf, 2, 3, 4, 5, 6, 1e308]))
    with ti.ad.Tape(loss):
        stencil()
    assert x.grad.to_numpy().tolist() == [1e308, math.inf, math.inf, 5, 7, 9, 11, 1e308]


@pytest.mark.parametrize("where", ["scatter", "rows", "conditional rows", "total"])
def test_products_round_in_one_way(where):
    """A fused product in one half of a two-sum and a rounded one in the other would lose digits."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, sums="compensated")
    n, m = 300, 40
    rng = np.random.default_rng(5)
    one, two = rng.uniform(1, 2, (n, m)), rng.uniform(1, 2, (n, m))
    # Each product meets its opposite but for 1e-10 of it.
    one = np.concatenate([one, one])
    two = np.concatenate([two, -two * (1 - 1e-10)])
    order = rng.permutation(2 * n)
    one, two = one[order], two[order]
    a, b = ti.field(ti.f64, one.shape), ti.field(ti.f64, one.shape)
    cell = ti.field(ti.i32, 2 * n)
    out = ti.field(ti.f64, m)

    @ti.kernel
    def add(t: ti.i32):
        if ti.static(where == "scatter"):
            for i, j in a:
                out[(j + cell[i]) % m] += a[i, j] * b[i, j]
        elif ti.static(where == "total"):
            for i, j in a:
                out[t] += a[i, j] * b[i, j]
        else:
            for i in range(2 * n):
                for j in range(m):
                    if ti.static(where == "rows"):
                        out[j] += a[i, j] * b[i, j]
                    elif a[i, j] > 1.01:
                        out[j] -= a[i, j] * b[i, j]

    a.from_numpy(one)
    b.from_numpy(two)
    cell.from_numpy((order % 3).astype(np.int32))
    add(0)
    sums = [[Fraction(0), Fraction(0)] for _ in range(m)]
    for i in range(2 * n):
        for j in range(m):
            at, sign = j, 1
            if where == "scatter":
                at = (j + int(order[i]) % 3) % m
            elif where == "total":
                at = 0
            elif where == "conditional rows":
                sign = -1 if one[i, j] > 1.01 else 0
            sums[at][0] += sign * Fraction(float(one[i, j] * two[i, j]))
            sums[at][1] += sign * Fraction(float(one[i, j])) * Fraction(float(two[i, j]))
    for got, either in zip(out.to_numpy().tolist(), sums, strict=True):
        assert min(abs(Fraction(got) - exact) - abs(exact) / 10**12 for exact in either) <= 0
