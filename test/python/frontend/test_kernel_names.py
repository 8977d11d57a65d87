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
