"""Stencils and their gradients against NumPy: over inner ranges, with guards, with wrapped and
clamped indices, and so large that a GPU gives each thread several elements.
"""

import numpy as np
import pytest
import tai as ti

SMALL = (13, 22)
LARGE = (1500, 1501)


def numbers(shape, seed=0):
    """Multiples of 1/8, so that f32 holds sums of them exactly."""
    return np.random.default_rng(seed).integers(-32, 32, shape).astype(np.float64) / 8


@pytest.fixture(autouse=True)
def start():
    ti.init()


def fields(shape, dtype=ti.f32):
    return [ti.field(dtype, shape=shape, needs_grad=True) for _ in range(2)]


def run(kernel, x, y, seed=1):
    """The result of a kernel from x to y, and the gradient of x."""
    x.from_numpy(numbers(x.shape))
    y.fill(0.5)
    x.grad.from_numpy(numbers(x.shape, seed + 1))
    y.grad.from_numpy(numbers(x.shape, seed))
    kernel()
    result = y.to_numpy()
    kernel.grad()
    return result, x.grad.to_numpy()


def five_points(values, weights, row, column):
    """Sums over the neighbours of the cells with these indices, and the transpose of that."""
    centre, up, down, left, right = weights
    here, cells = np.ix_(row, column), (row, column)
    total = centre * values[here]
    for weight, (rows, columns) in zip(
        (up, down, left, right),
        ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)),
        strict=True,
    ):
        total = total + weight * values[np.ix_(rows % values.shape[0], columns % values.shape[1])]
    return cells, total


def transposed(bar, weights, row, column, shape):
    result = np.zeros(shape)
    centre, up, down, left, right = weights
    for weight, rows, columns in (
        (centre, row, column),
        (up, row - 1, column),
        (down, row + 1, column),
        (left, row, column - 1),
        (right, row, column + 1),
    ):
        result[np.ix_(rows % shape[0], columns % shape[1])] += weight * bar[np.ix_(row, column)]
    return result


WEIGHTS = (0.5, 2.0, 4.0, 0.25, 8.0)


def check(kernel, x, y, row, column):
    result, gradient = run(kernel, x, y)
    expected = np.full(x.shape, 0.5)
    _, total = five_points(numbers(x.shape), WEIGHTS, row, column)
    expected[np.ix_(row, column)] = total
    np.testing.assert_array_equal(result, expected)
    bar = numbers(x.shape, 1)
    expected = numbers(x.shape, 2) + transposed(bar, WEIGHTS, row, column, x.shape)
    np.testing.assert_array_equal(gradient, expected)


@pytest.mark.parametrize("shape", [SMALL, LARGE])
def test_inner_ranges(shape):
    x, y = fields(shape)
    n, m = shape

    @ti.kernel
    def step():
        for i, j in ti.ndrange((1, n - 1), (1, m - 1)):
            near = 2.0 * x[i - 1, j] + 4.0 * x[i + 1, j] + 0.25 * x[i, j - 1] + 8.0 * x[i, j + 1]
            y[i, j] = 0.5 * x[i, j] + near

    check(step, x, y, np.arange(1, n - 1), np.arange(1, m - 1))


@pytest.mark.parametrize("shape", [SMALL, LARGE])
def test_guards(shape):
    x, y = fields(shape)
    n, m = shape

    @ti.kernel
    def step():
        for i, j in x:
            if 0 < i < n - 1 and 0 < j < m - 1:
                near = 2.0 * x[i - 1, j] + 4.0 * x[i + 1, j]
                near += 0.25 * x[i, j - 1] + 8.0 * x[i, j + 1]
                y[i, j] = 0.5 * x[i, j] + near

    check(step, x, y, np.arange(1, n - 1), np.arange(1, m - 1))


@pytest.mark.parametrize("shape", [SMALL, LARGE])
def test_uneven_ranges(shape):
    x, y = fields(shape)
    n, m = shape

    @ti.kernel
    def step():
        for i, j in ti.ndrange((3, n - 1), (2, m - 5)):
            near = 2.0 * x[i - 1, j] + 4.0 * x[i + 1, j] + 0.25 * x[i, j - 1] + 8.0 * x[i, j + 1]
            y[i, j] = 0.5 * x[i, j] + near

    check(step, x, y, np.arange(3, n - 1), np.arange(2, m - 5))


@pytest.mark.parametrize("shape", [SMALL, LARGE, (1024, 2048)])
def test_wrapped_indices(shape):
    x, y = fields(shape)
    n, m = shape

    @ti.kernel
    def step():
        for i, j in x:
            near = 2.0 * x[(i - 1) % n, j] + 4.0 * x[(i + 1) % n, j]
            near += 0.25 * x[i, (j - 1) % m] + 8.0 * x[i, (j + 1) % m]
            y[i, j] = 0.5 * x[i, j] + near

    check(step, x, y, np.arange(n), np.arange(m))


def test_ring_inside():
    """A wrap around the range of a loop that is a part of the field."""
    n = 11
    x, y = fields(n)

    @ti.kernel
    def step():
        for i in range(1, n - 1):
            y[i] = x[i] + 2.0 * x[1 + (i % (n - 2))]

    result, gradient = run(step, x, y)
    values, bar = numbers(n), numbers(n, 1)
    inner = np.arange(1, n - 1)
    following = 1 + inner % (n - 2)
    expected = np.full(n, 0.5)
    expected[inner] = values[inner] + 2 * values[following]
    np.testing.assert_array_equal(result, expected)
    expected = numbers(n, 2)
    expected[inner] += bar[inner]
    expected[following] += 2 * bar[inner]
    np.testing.assert_array_equal(gradient, expected)


def test_fields_of_two_sizes():
    """Differences live between points: one fewer than those."""
    n = 9
    x, gap = ti.field(ti.f32, n, needs_grad=True), ti.field(ti.f32, n - 1, needs_grad=True)

    @ti.kernel
    def differences():
        for i in range(n - 1):
            gap[i] = x[i + 1] - 0.5 * x[i]

    x.from_numpy(numbers(n))
    gap.grad.from_numpy(numbers(n - 1, 1))
    differences()
    np.testing.assert_array_equal(gap.to_numpy(), numbers(n)[1:] - 0.5 * numbers(n)[:-1])
    differences.grad()
    expected = np.zeros(n)
    expected[1:] += numbers(n - 1, 1)
    expected[:-1] -= 0.5 * numbers(n - 1, 1)
    np.testing.assert_array_equal(x.grad.to_numpy(), expected)


def test_nonlinear_inner_ranges():
    n, m = SMALL
    x, y = fields(SMALL, ti.f64)

    @ti.kernel
    def step():
        for i, j in ti.ndrange((1, n - 1), (0, m)):
            y[i, j] = ti.sin(x[i - 1, j]) * x[i + 1, j]

    _, gradient = run(step, x, y)
    values, bar = numbers(SMALL), numbers(SMALL, 1)
    expected = numbers(SMALL, 2)
    expected[:-2] += bar[1:-1] * np.cos(values[:-2]) * values[2:]
    expected[2:] += bar[1:-1] * np.sin(values[:-2])
    np.testing.assert_allclose(gradient, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
def test_large_maps_and_sums(dtype):
    """Stores, updates in place and a sum, of rows that end within a strip."""
    n, m = LARGE
    x, y = fields(LARGE, dtype)
    total = ti.field(dtype, shape=(), needs_grad=True)

    @ti.kernel
    def step():
        for i, j in x:
            y[i, j] = 2.0 * x[i, j] + y[i, j]
            if j >= 7:
                total[None] += x[i, j]

    total.grad[None] = 3.0
    result, gradient = run(step, x, y)
    values = numbers(LARGE)
    np.testing.assert_array_equal(result, 2.0 * values + 0.5)
    assert total[None] == pytest.approx(values[:, 7:].sum(), abs=0.5)
    expected = numbers(LARGE, 2) + 2.0 * numbers(LARGE, 1)
    expected[:, 7:] += 3.0
    np.testing.assert_array_equal(gradient, expected)


def test_large_vectors():
    n = 1 << 21
    x = ti.Vector.field(2, ti.f32, shape=n, needs_grad=True)
    y = ti.Vector.field(2, ti.f32, shape=n, needs_grad=True)

    @ti.kernel
    def turn():
        for i in x:
            y[i] = ti.Vector([x[i][1], -0.5 * x[i][0]])

    values, bar = numbers((n, 2)), numbers((n, 2), 1)
    x.from_numpy(values)
    y.grad.from_numpy(bar)
    turn()
    np.testing.assert_array_equal(y.to_numpy(), np.stack([values[:, 1], -0.5 * values[:, 0]], 1))
    turn.grad()
    np.testing.assert_array_equal(x.grad.to_numpy(), np.stack([-0.5 * bar[:, 1], bar[:, 0]], 1))


def test_large_box():
    """Three dimensions, of which the first is a part."""
    shape = (40, 200, 300)
    x, y = fields(shape)

    @ti.kernel
    def step():
        for i, j, k in ti.ndrange((2, 40), 200, (1, 299)):
            if j > 0:
                y[i, j, k] = x[i - 2, j, k] + 2.0 * x[i, j - 1, k] + 4.0 * x[i, j, k + 1]

    result, gradient = run(step, x, y)
    values, bar = numbers(shape), numbers(shape, 1)
    expected = np.full(shape, 0.5)
    to = np.s_[2:, 1:, 1:-1]
    from_ = (np.s_[:-2, 1:, 1:-1], np.s_[2:, :-1, 1:-1], np.s_[2:, 1:, 2:])
    expected[to] = sum(2**k * values[at] for k, at in enumerate(from_))
    np.testing.assert_array_equal(result, expected)
    expected = numbers(shape, 2)
    for k, at in enumerate(from_):
        expected[at] += 2**k * bar[to]
    np.testing.assert_array_equal(gradient, expected)
