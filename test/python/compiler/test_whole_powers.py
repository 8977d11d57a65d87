"""Powers whose exponent is a whole number of the run: LLVM may call a library function for them."""

import numpy as np
import pytest
import tai as ti


@pytest.mark.parametrize("fast_math", [True, False])
@pytest.mark.parametrize("n", [1, 8, 37, 1000])
@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
def test_powers_and_their_gradients(dtype, n, fast_math):
    ti.init(arch=ti.cpu, fast_math=fast_math)
    x = ti.field(dtype, n, needs_grad=True)
    y = ti.field(dtype, n)
    loss = ti.field(ti.f64, (), needs_grad=True)

    @ti.kernel
    def forward(p: ti.i32):
        for i in x:
            y[i] = x[i] ** p

    @ti.kernel
    def total(p: ti.i32):
        for i in x:
            loss[None] += x[i] ** p

    @ti.kernel
    def by_index():
        for i in x:
            loss[None] += x[i] ** (i % 4)

    base = np.linspace(0.5, 1.5, n).astype(dtype.numpy)
    x.from_numpy(base)
    base = base.astype(np.float64)
    close = 5e-6 if dtype is ti.f32 else 1e-13
    for p in (0, 1, 3, -2, 31):
        forward(p)
        np.testing.assert_allclose(y.to_numpy(), base**p, rtol=close)
        with ti.ad.Tape(loss):
            total(p)
        np.testing.assert_allclose(x.grad.to_numpy(), p * base ** (p - 1.0), rtol=close)
    with ti.ad.Tape(loss):
        by_index()
    p = np.arange(n) % 4
    np.testing.assert_allclose(x.grad.to_numpy(), p * base ** (p - 1.0), rtol=close)
