"""Compensated sums that are gathered: adjoints of stencils."""

import math
import os

import numpy as np
import pytest
import tai as ti

NPT = {ti.f32: np.float32, ti.f64: np.float64}


@pytest.fixture(autouse=True)
def on_cpu():
    if os.environ.get("TI_ARCH") == "cuda":
        pytest.skip("a GPU has no compensated sums of elements")


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
