"""Parallel loops around serial loops that carry sums: the order of a sum is the program's.

In strict mode each operation is rounded by itself, so NumPy's, one after the other, give the same
bits, whether iterations are unrolled and jammed or not.
"""

import numpy as np
import pytest
import tai as ti

SIZES = [1, 7, 16, 17, 100, 1_025]


def numbers(shape, dtype=np.float32, seed=0):
    return np.random.RandomState(seed).standard_normal(shape).astype(dtype)


def in_order(terms):
    """Sums over the last axis, from the first term to the last."""
    total = np.zeros(terms.shape[:-1], terms.dtype)
    for j in range(terms.shape[-1]):
        total = total + terms[..., j]
    return total


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=str)
@pytest.mark.parametrize("n", SIZES)
def test_rows_times_a_vector(n, dtype):
    ti.init(strict=True)
    m = 130
    kind = np.float32 if dtype == ti.f32 else np.float64
    a, x, y = ti.field(dtype, (n, m)), ti.field(dtype, m), ti.field(dtype, n)
    a.from_numpy(numbers((n, m), kind))
    x.from_numpy(numbers(m, kind, 1))

    @ti.kernel
    def rows():
        for i in range(n):
            total = 0.0 * x[0]
            for j in range(m):
                total += a[i, j] * x[j]
            y[i] = total

    rows()
    np.testing.assert_array_equal(y.to_numpy(), in_order(a.to_numpy() * x.to_numpy()))


@pytest.mark.parametrize("m", [0, 1, 3, 75])
def test_run_time_counts(m):
    ti.init(strict=True)
    n = 65_537
    x, y = ti.field(ti.f32, 80), ti.field(ti.f32, n)
    x.from_numpy(numbers(80))

    @ti.kernel
    def sums(count: ti.i32):
        for i in range(n):
            total = 0.0
            for j in range(count):
                total += x[j] * x[(i + j) % 80]
            y[i] = total

    sums(m)
    places = (np.arange(n)[:, None] + np.arange(m)) % 80
    values = x.to_numpy()
    np.testing.assert_array_equal(y.to_numpy(), in_order(values[:m] * values[places]))


def test_run_time_ranges():
    ti.init(strict=True)
    x, y = ti.field(ti.f32, 50), ti.field(ti.f32, 100)
    x.from_numpy(numbers(50))

    @ti.kernel
    def sums(low: ti.i32, high: ti.i32):
        for i in range(low, high):
            total = 0.0
            for j in range(50):
                total += x[j] / (1.0 + i)
            y[i] = total

    for low, high in [(3, 3), (9, 2), (5, 6), (0, 100), (1, 18), (83, 100)]:
        y.fill(-1.0)
        sums(low, high)
        found, due = y.to_numpy(), np.full(100, -1.0, np.float32)
        for i in range(low, high):
            due[i] = in_order(x.to_numpy() / np.float32(1.0 + i))
        np.testing.assert_array_equal(found, due)


@pytest.mark.parametrize("shape", [(1, 1, 90), (5, 19, 90), (33, 8, 61)], ids=str)
def test_products_of_matrices(shape):
    ti.init(strict=True)
    n, p, m = shape
    a, b, c = (ti.field(ti.f32, s) for s in ((n, m), (m, p), (n, p)))
    a.from_numpy(numbers((n, m)))
    b.from_numpy(numbers((m, p), seed=1))

    @ti.kernel
    def multiply():
        for i, j in c:
            total = 0.0
            for k in range(m):
                total += a[i, k] * b[k, j]
            c[i, j] = total

    multiply()
    terms = a.to_numpy()[:, None, :] * b.to_numpy().T[None]
    np.testing.assert_array_equal(c.to_numpy(), in_order(terms))


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=str)
@pytest.mark.parametrize("n", SIZES[:-1])
def test_triangles(n, dtype):
    """Bounds of each iteration's own: above, below, and beside the diagonal."""
    ti.init(strict=True)
    kind = np.float32 if dtype == ti.f32 else np.float64
    a, x, y = ti.field(dtype, (n, n)), ti.field(dtype, n), ti.Vector.field(3, dtype, n)
    a.from_numpy(numbers((n, n), kind))
    x.from_numpy(numbers(n, kind, 1))

    @ti.kernel
    def sums():
        for i in range(n):
            # Where a sum starts is a factor of its terms, too.
            first, below, above, band = x[0], x[0], 0.0 * x[0], x[i]
            for j in range(i):
                below += first * a[i, j] * x[j]
            for j in range(i + 1, n):
                above += a[j, i] * x[j]
            for j in range(i - 20, i - 3):
                if 0 <= j:
                    band = band * 0.5 + first
            y[i] = [below, above, band]

    sums()
    rows, column, found = a.to_numpy(), x.to_numpy(), y.to_numpy()
    half = kind(0.5)
    for i in range(n):
        below, above, band = column[0], kind(0), column[i]
        for j in range(i):
            below = below + column[0] * rows[i, j] * column[j]
        for j in range(i + 1, n):
            above = above + rows[j, i] * column[j]
        for _ in range(max(0, i - 20), i - 3):
            band = band * half + column[0]
        np.testing.assert_array_equal(found[i], [below, above, band])


@pytest.mark.parametrize("most", [3, 12, 60])
def test_lists_of_neighbours(most):
    """Counts of each iteration's own; some are none, or less."""
    ti.init(strict=True)
    n = 101
    count, near = ti.field(ti.i32, n), ti.field(ti.i32, (n, most))
    place, pull = ti.Vector.field(3, ti.f32, n), ti.Vector.field(3, ti.f32, n)
    random = np.random.RandomState(2)
    count.from_numpy(random.randint(-1, most + 1, n).astype(np.int32) // (1 + np.arange(n) % 2))
    near.from_numpy(random.randint(0, n, (n, most)).astype(np.int32))
    place.from_numpy(numbers((n, 3)))

    @ti.kernel
    def pulls():
        for i in range(n):
            force = ti.Vector([0.0, 0.0, 0.0])
            for k in range(count[i]):
                way = place[near[i, k]] - place[i]
                force += way / (way.dot(way) + 0.125)
            pull[i] = force

    pulls()
    places, lists, found = place.to_numpy(), near.to_numpy(), pull.to_numpy()
    for i, length in enumerate(count.to_numpy()):
        way = places[lists[i, : max(length, 0)]] - places[i]
        square = in_order(way * way) + np.float32(0.125)
        np.testing.assert_array_equal(found[i], in_order((way / square[:, None]).T))


def test_bounds_far_apart():
    """The number of iterations between them has no sign that says something."""
    ti.init(strict=True)
    n, least = 40, -(2**63)
    stop, y = ti.field(ti.i64, n), ti.field(ti.f32, n)
    stop.from_numpy(np.where(np.arange(n) % 5, least, least + 30))

    @ti.kernel
    def sums(start: ti.i64):
        for i in range(n):
            total = 1.0
            for _ in range(start + i, stop[i]):
                total += 0.5
            y[i] = total

    sums(2**63 - 1 - n)
    np.testing.assert_array_equal(y.to_numpy(), np.ones(n))
    stop.fill(least + 30)
    sums(least)
    np.testing.assert_array_equal(y.to_numpy(), 1 + 0.5 * np.maximum(30 - np.arange(n), 0))


def test_several_sums_and_two_levels():
    ti.init(strict=True)
    n = 37
    x = ti.Vector.field(3, ti.f32, (9, 11))
    low, pull = ti.field(ti.f32, n), ti.Vector.field(3, ti.f32, n)
    x.from_numpy(numbers((9, 11, 3)))

    @ti.kernel
    def sums():
        for i in range(n):
            total = ti.Vector([0.0, 0.0, 0.0])
            least = 1e9
            for j in range(9):
                for k in range(11):
                    way = x[j, k] * (i + 1.0)
                    total += way
                    least = ti.min(least, way[0])
            pull[i] = total
            low[i] = least

    sums()
    values = x.to_numpy().reshape(99, 3)
    for i in range(n):
        way = values * np.float32(i + 1.0)
        np.testing.assert_array_equal(pull.to_numpy()[i], in_order(way.T))
        assert low.to_numpy()[i] == way[:, 0].min()


def test_arrays_and_recurrences():
    """A recurrence is no sum, but it waits for itself as one does."""
    ti.init(strict=True)

    @ti.kernel
    def roots(values: ti.types.ndarray(ti.f32, 1), out: ti.types.ndarray(ti.f32, 1)):
        for i in range(values.shape[0]):
            x = values[i] + 1.0
            for _ in range(60):
                x = 0.5 * (x + values[i] / x)
            out[i] = x

    for n in SIZES:
        values, out = np.abs(numbers(n)), np.zeros(n, np.float32)
        roots(values, out)
        x = values + np.float32(1.0)
        for _ in range(60):
            x = np.float32(0.5) * (x + values / x)
        np.testing.assert_array_equal(out, x)


def test_terms_that_read_what_other_iterations_wrote_before():
    """The loop in place reads its own element only; the next kernel sees all of them."""
    ti.init(strict=True)
    n = 50
    x, y = ti.field(ti.f32, n), ti.field(ti.f32, n)
    x.from_numpy(numbers(n))

    @ti.kernel
    def step():
        for i in range(n):
            total = x[i]
            for j in range(100):
                total += x[i] * j
            x[i] = total * 1e-4
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += x[j] * (i - j)
            y[i] = total

    before = x.to_numpy()
    step()
    terms = np.concatenate(
        [before[:, None], before[:, None] * np.arange(100, dtype=np.float32)], axis=1
    )
    total = terms[:, 0]
    for j in range(1, 101):
        total = total + terms[:, j]
    after = total * np.float32(1e-4)
    np.testing.assert_array_equal(x.to_numpy(), after)
    away = (np.arange(n)[:, None] - np.arange(n)).astype(np.float32)
    np.testing.assert_array_equal(y.to_numpy(), in_order(after * away))


@pytest.mark.parametrize("n", [1, 16, 45])
def test_branches_around_terms(n):
    """The term of a particle and itself divides by zero, and is left out."""
    ti.init(strict=True)
    x, y = ti.field(ti.f32, n), ti.field(ti.f32, n)
    turns, count = ti.field(ti.f32, n), ti.field(ti.i32, n)
    x.from_numpy(numbers(n))

    @ti.kernel
    def pull():
        for i in range(n):
            total = 0.0
            for j in range(n):
                if i == j:
                    continue
                way = x[j] - x[i]
                total += 1.0 / way if way < 1.0 else way
            y[i] = total

    @ti.kernel
    def iterate():
        for i in range(n):
            z, steps = x[i], 0
            for _ in range(100):
                if z * z < 1e30:
                    z = z * z + x[i]
                    steps += 1
            turns[i], count[i] = z, steps

    pull()
    iterate()
    values = x.to_numpy()
    for i in range(n):
        total, z, steps = np.float32(0.0), values[i], 0
        for j in range(n):
            if i != j:
                way = values[j] - values[i]
                total += np.float32(1.0) / way if way < 1 else way
        for _ in range(100):
            if abs(z) < 1e15 and z * z < np.float32(1e30):
                z, steps = z * z + values[i], steps + 1
        assert (y[i], turns[i], count[i]) == (total, z, steps)


@pytest.mark.parametrize("n", [1, 19])
def test_gradients(n):
    ti.init(default_fp=ti.f64)
    m = 70
    a, x = ti.field(ti.f64, (n, m), needs_grad=True), ti.field(ti.f64, m, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    y = ti.field(ti.f64, n, needs_grad=True)
    a.from_numpy(numbers((n, m), np.float64))
    x.from_numpy(numbers(m, np.float64, 1))

    @ti.kernel
    def rows():
        for i in range(n):
            total = 0.0
            for j in range(m):
                total += ti.sin(a[i, j] * x[j])
            y[i] = total

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += y[i] ** 2

    with ti.ad.Tape(loss):
        rows()
        measure()
    values, vector = a.to_numpy(), x.to_numpy()
    phase = values * vector
    slope = 2 * np.sin(phase).sum(1)[:, None] * np.cos(phase)
    np.testing.assert_allclose(a.grad.to_numpy(), slope * vector, rtol=1e-12)
    np.testing.assert_allclose(x.grad.to_numpy(), (slope * values).sum(0), rtol=1e-10)
