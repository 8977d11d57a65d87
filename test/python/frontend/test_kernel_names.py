"""A kernel may have the name of a function of the C library that its code calls."""

import math

import pytest
import tai as ti


def test_kernels_named_like_library_functions():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def atan2():
        y[None] += ti.atan2(x[None], 2.0)

    @ti.kernel
    def tan() -> ti.f64:
        return ti.tan(x[None])

    @ti.kernel
    def main():
        x[None] = 0.3

    main()
    with ti.ad.Tape(y):
        atan2()
    assert y[None] == pytest.approx(math.atan2(0.3, 2.0), abs=1e-15)
    assert x.grad[None] == pytest.approx(2.0 / (4.0 + 0.09), abs=1e-15)
    assert tan() == pytest.approx(math.tan(0.3), abs=1e-15)


def test_warnings_have_the_name_of_the_program():
    """The IR numbers kernels of one name."""
    x = ti.field(ti.f32, 4, needs_grad=True)
    y, loss = ti.field(ti.f32, 4), ti.field(ti.f32, (), needs_grad=True)

    def make(k):
        @ti.kernel
        def heat():
            for i in x:
                y[i] = x[i] * k

        return heat

    kernels = [make(k) for k in range(4)]
    for kernel in kernels:
        kernel()

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i]

    with pytest.warns(ti.ad.TaiGradientWarning, match="kernel 'heat' stores"):
        with ti.ad.Tape(loss):
            kernels[-1]()
            total()
    with pytest.raises(ti.TaiError, match="kernel 'heat' takes 0 arguments"):
        kernels[-1](1)
