"""Loops of any length, loops that the data ends, and indices that the data gives."""

import numpy as np
import pytest
import tai as ti

from derivatives import Derivation


def compare(found, expected, dtype, condition=1.0):
    """f64: 1e-10; f32: what its rounding leaves of a product of so many factors."""
    bound = 1e-10 if dtype == "f64" else 1e-6 * max(condition, 1.0)
    np.testing.assert_allclose(found, expected, rtol=bound)


@pytest.mark.parametrize("mode", ["reverse"])
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("trips", [0, 1, 30, 31, 100, 5000])
def test_powers(trips, dtype, mode):
    @ti.func
    def power(x):
        y = 1.0 + 0.0 * x
        for _ in range(trips):
            y *= x
        return y

    at = float(np.float32(0.9995))
    value, gradient = Derivation(lambda x: power(x[0]), (1,), dtype, mode)([at])
    compare(value, at**trips, dtype, trips)
    compare(gradient[0], trips * at ** (trips - 1) if trips else 0.0, dtype, trips)


@pytest.mark.parametrize("mode", ["reverse"])
@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_trips_from_a_number(dtype, mode):
    """The number of trips is computed from the data, which has no derivative by it."""

    @ti.func
    def power(x, n):
        y = x * 0.0 + 1.0
        for _ in range(ti.cast(n, int)):
            y *= x
        return y

    derivation = Derivation(lambda x: power(x[0], x[1]), (2,), dtype, mode)
    for trips in (0, 3, 31, 200):
        value, gradient = derivation([0.98, trips + 0.5])
        at = 0.98 if dtype == "f64" else float(np.float32(0.98))
        compare(value, at**trips, dtype, trips)
        compare(gradient, [trips * at ** (trips - 1) if trips else 0.0, 0.0], dtype, trips)


@pytest.mark.parametrize("mode", ["reverse"])
@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_while_in_a_branch(dtype, mode):
    """Newton's square root until it converges, where x is not negative."""

    @ti.func
    def root(x):
        y = 0.0 * x
        if x > 0:
            y = 1.0 + 0.0 * x
            while abs(y * y - x) > 1e-6 * x:
                y = 0.5 * (y + x / y)
        return y

    derivation = Derivation(lambda x: root(x[0]) * x[1], (2,), dtype, mode)
    for at in (2.0, 9.0, 1234.5):
        value, gradient = derivation([at, 3.0])
        assert value == pytest.approx(3 * np.sqrt(at), rel=1e-5)
        # The derivative of the computed steps, by differences in f64 of the same steps.
        assert gradient[0] == pytest.approx(1.5 / np.sqrt(at), rel=2e-3)
        assert gradient[1] == pytest.approx(np.sqrt(at), rel=1e-5)

        def newton(x):
            y = 1.0
            while abs(y * y - x) > 1e-6 * x:
                y = 0.5 * (y + x / y)
            return y

        if dtype == "f64":
            h = 1e-5 * at
            slope = 3 * (newton(at + h) - newton(at - h)) / (2 * h)
            assert gradient[0] == pytest.approx(slope, rel=1e-7)
    value, gradient = derivation([-4.0, 3.0])
    assert value == 0
    np.testing.assert_array_equal(gradient, [0, 0])


@pytest.mark.parametrize("dtype", [ti.f64, ti.f32])
def test_fibonacci_indices(dtype):
    """Gathers and scatters at Fibonacci numbers: whole numbers, exactly."""
    n, size = 12, 256
    ti.init(arch=ti.cpu, default_fp=dtype, offline_cache=False)
    index = ti.field(ti.i32, shape=n)
    x = ti.field(dtype, shape=size, needs_grad=True)
    y = ti.field(dtype, shape=size, needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)
    numbers = [1, 1]
    while len(numbers) < n:
        numbers.append(numbers[-1] + numbers[-2])
    index.from_numpy(np.array(numbers, np.int32))
    x.from_numpy(np.arange(size).astype(np.float32))

    @ti.kernel
    def scatter():
        for i in range(n):
            y[index[i]] += x[index[n - 1 - i]] * (i + 1)

    @ti.kernel
    def gather():
        for i in range(n):
            loss[None] += y[index[i]] * y[2 * index[i] % size]

    with ti.ad.Tape(loss):
        scatter()
        gather()

    expected_y, slope_y, slope_x = (np.zeros(size) for _ in range(3))
    for i in range(n):
        expected_y[numbers[i]] += numbers[n - 1 - i] * (i + 1)
    for i in range(n):
        a, b = numbers[i], 2 * numbers[i] % size
        slope_y[a] += expected_y[b]
        slope_y[b] += expected_y[a]
    for i in range(n):
        slope_x[numbers[n - 1 - i]] += slope_y[numbers[i]] * (i + 1)
    np.testing.assert_array_equal(y.to_numpy(), expected_y)
    np.testing.assert_array_equal(x.grad.to_numpy(), slope_x)
