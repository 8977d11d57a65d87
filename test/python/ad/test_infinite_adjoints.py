"""Infinite derivatives times zero: sqrt of a square, of a dot product, at zero."""

import numpy as np
import pytest
import tai as ti


@ti.func
def square(v):
    return ti.sqrt(v[0] * v[0])


@ti.func
def shifted(v):
    return ti.sqrt((v[0] + v[1] - 1) ** 2)


@ti.func
def product(v):
    return ti.sqrt(v.dot(v))


@ti.func
def squares(v):
    return ti.sqrt(v[0] ** 2 + v[1] ** 2)


@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize(
    ("function", "point", "regular", "slope"),
    [
        (square, [0, 0], [-2, 1], [-1, 0]),
        (shifted, [0.5, 0.5], [3, 1], [1, 1]),
        (product, [0, 0], [3, 4], [0.6, 0.8]),
        (squares, [0, 0], [-3, 4], [-0.6, 0.8]),
    ],
)
def test_kinks_are_finite(function, point, regular, slope, dtype):
    ti.init(arch=ti.cpu, default_fp=getattr(ti, dtype))
    x = ti.Vector.field(2, getattr(ti, dtype), shape=2, needs_grad=True)
    loss = ti.field(getattr(ti, dtype), shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += function(x[i])

    x.from_numpy(np.array([point, regular], {"f32": np.float32, "f64": np.float64}[dtype]))
    with ti.ad.Tape(loss):
        kernel()
    gradient = x.grad.to_numpy()
    np.testing.assert_array_equal(gradient[0], 0)
    np.testing.assert_allclose(gradient[1], slope, rtol=1e-6)


def test_what_is_infinite_or_undefined_stays_so():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=2, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += ti.sqrt(3 * x[i])

    x.from_numpy(np.array([0.0, -1.0]))
    with ti.ad.Tape(loss):
        kernel()
    assert x.grad[0] == np.inf
    assert np.isnan(x.grad[1])


@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_a_partial_that_is_no_number_is_not_hidden(dtype):
    """The derivative of x ** y by y is undefined for negative x, whatever comes behind it."""
    dtype = getattr(ti, dtype)
    ti.init(default_fp=dtype)
    x = ti.field(dtype, shape=2, needs_grad=True)
    y = ti.field(dtype, shape=2, needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += ti.sqrt(x[i] ** y[i] - 4)

    x.from_numpy(np.array([-2.0, 3.0]).astype(dtype.numpy))
    y.fill(2.0)
    with ti.ad.Tape(loss):
        kernel()
    assert np.isnan(y.grad[0]) and x.grad[0] == -np.inf
    assert np.isfinite(y.grad[1]) and np.isfinite(x.grad[1])
