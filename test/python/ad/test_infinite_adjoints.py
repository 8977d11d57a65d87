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


def quotients(x, y, n):
    """A product that a loop carries, of which one factor is zero."""
    loss = ti.field(x.dtype, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for _ in range(1):
            product = 1.0
            for j in range(n):
                product *= x[j] / y[j]
            loss[None] += ti.sqrt(product)

    return loss, kernel


def quotients_until(x, y, n):
    loss = ti.field(x.dtype, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for _ in range(1):
            product = 1.0
            j = 0
            while j < n:
                product *= x[j] / y[j]
                j += 1
            loss[None] += ti.sqrt(product)

    return loss, kernel


@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize("make", [quotients, quotients_until])
def test_products_of_loops(make, dtype):
    dtype = getattr(ti, dtype)
    ti.init(arch=ti.cpu, default_fp=dtype)
    n = 5
    x, y = (ti.field(dtype, shape=n, needs_grad=True) for _ in range(2))
    loss, kernel = make(x, y, n)
    values = np.array([2.0, 0.5, 3.0, 4.0, 1.5])
    y.from_numpy((values + 1).astype(dtype.numpy))
    for zero in (None, 0, 2, 4):
        factors = values.copy()
        if zero is not None:
            factors[zero] = 0
        x.from_numpy(factors.astype(dtype.numpy))
        with ti.ad.Tape(loss):
            kernel()
        if zero is None:
            np.testing.assert_allclose(x.grad.to_numpy(), loss[None] / (2 * factors), rtol=1e-5)
            np.testing.assert_allclose(
                y.grad.to_numpy(), -loss[None] / (2 * (factors + 1)), rtol=1e-5
            )
            continue
        # The root is infinitely steep in the factor that is zero, and flat in all others.
        expected = np.zeros(n)
        expected[zero] = np.inf
        np.testing.assert_array_equal(x.grad.to_numpy(), expected)
        np.testing.assert_array_equal(y.grad.to_numpy(), 0)


def test_sums_of_squares_of_loops():
    """All are zero: as sqrt(v · v), whose derivative there is 0."""
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=(2, 4), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for i in range(2):
            s = 0.0
            for j in range(4):
                s += x[i, j] * x[i, j]
            loss[None] += ti.sqrt(s)

    x.from_numpy(np.array([[0.0] * 4, [1.0, -1.0, 1.0, -1.0]]))
    with ti.ad.Tape(loss):
        kernel()
    np.testing.assert_array_equal(x.grad.to_numpy(), [[0.0] * 4, [0.5, -0.5, 0.5, -0.5]])


def test_squares_of_branches():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for i in x:
            s = 4.0
            if i < 2:
                for j in range(i + 1):
                    s = x[i] * x[i] * (j + 1)
            loss[None] += ti.sqrt(s)

    x.from_numpy(np.array([0.0, 0.0, 0.0]))
    with ti.ad.Tape(loss):
        kernel()
    np.testing.assert_array_equal(x.grad.to_numpy(), 0)


def test_an_iteration_begins_with_what_a_later_one_made_infinite():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def kernel():
        for _ in range(1):
            v = 1.0
            for j in range(3):
                v = x[j] * ti.sqrt(v)
            loss[None] += v

    x.from_numpy(np.array([2.0, 0.0, 3.0]))
    with ti.ad.Tape(loss):
        kernel()
    np.testing.assert_array_equal(x.grad.to_numpy(), [0, np.inf, 0])
