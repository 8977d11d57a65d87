"""On one thread a loop reads and writes memory as if its iterations ran in order.

Each form is one that iterations share memory in. The reference is the same loop in Python.
"""

import numpy as np
import pytest
import tai as ti

SIZES = [1, 8, 1000, 65_537, 200_000]
TYPES = {"f32": ti.f32, "f64": ti.f64, "i32": ti.i32}
NUMPY = {"f32": np.float32, "f64": np.float64, "i32": np.int32}


@pytest.fixture(params=["plain", "deterministic"])
def one_thread(request):
    ti.init(
        arch=ti.cpu,
        cpu_max_num_threads=1,
        offline_cache=False,
        deterministic=request.param == "deterministic",
    )


def fields(kind, n):
    """An array of small numbers, one of their kind to write to, and buckets."""
    x, y = (ti.field(TYPES[kind], shape=n) for _ in range(2))
    p = ti.field(ti.i32, shape=n)
    rng = np.random.default_rng(n)
    values = rng.integers(0, 16, n).astype(NUMPY[kind])
    buckets = rng.integers(0, max(1, min(n, 100)), n).astype(np.int32)
    x.from_numpy(values)
    p.from_numpy(buckets)
    return x, y, p, values, buckets


each = pytest.mark.parametrize("n", SIZES)
of_each_type = pytest.mark.parametrize("kind", TYPES)


@each
@of_each_type
def test_counts_by_assignment(one_thread, n, kind):
    x, y, p, values, buckets = fields(kind, n)

    @ti.kernel
    def count():
        for i in x:
            y[p[i]] = y[p[i]] + ti.select(x[i] > 3, 1, 2)

    count()
    expected = np.zeros(n, NUMPY[kind])
    np.add.at(expected, buckets, np.where(values > 3, 1, 2).astype(NUMPY[kind]))
    assert (y.to_numpy() == expected).all()


@each
@of_each_type
def test_what_came_before(one_thread, n, kind):
    x, y, p, values, _ = fields(kind, n)

    @ti.kernel
    def follow():
        for i in range(1, n):
            x[i] = x[i - 1] % 7 + x[i]

    follow()
    expected = values.copy()
    for i in range(1, n):
        expected[i] = expected[i - 1] % 7 + expected[i]
    assert (x.to_numpy() == expected).all()


@each
def test_halves_of_what_came_before(one_thread, n):
    x, y, p, values, _ = fields("f64", n)

    @ti.kernel
    def follow():
        for i in x:
            if i > 0:
                x[i] = 0.5 * x[i - 1] + x[i]

    follow()
    expected = values.copy()
    for i in range(1, n):
        expected[i] = 0.5 * expected[i - 1] + expected[i]
    np.testing.assert_allclose(x.to_numpy(), expected, rtol=1e-14)


@each
@of_each_type
@pytest.mark.parametrize("distance", [2, 5, 16])
def test_a_distance(one_thread, n, kind, distance):
    x, y, p, values, _ = fields(kind, n)

    @ti.kernel
    def follow(k: ti.i32):
        for i in range(n - distance):
            x[i + k] = x[i] % 5 + x[i + distance]

    follow(distance)
    expected = values.copy()
    for i in range(n - distance):
        expected[i + distance] = expected[i] % 5 + expected[i + distance]
    assert (x.to_numpy() == expected).all()


@each
@of_each_type
def test_a_counter_that_is_read_and_set(one_thread, n, kind):
    x, y, p, values, _ = fields(kind, n)
    counter = ti.field(ti.i32, shape=())

    @ti.kernel
    def number():
        for i in x:
            if x[i] > 4:
                slot = counter[None]
                counter[None] = slot + 1
                y[slot] = x[i]

    number()
    kept = values[values > 4]
    assert counter[None] == len(kept)
    assert (y.to_numpy()[: len(kept)] == kept).all()


@each
@of_each_type
def test_a_sum_under_a_condition(one_thread, n, kind):
    x, y, p, values, _ = fields(kind, n)
    total = ti.field(TYPES[kind], shape=2)

    @ti.kernel
    def add():
        for i in x:
            if x[i] > 4:
                total[0] = total[0] + 2
            total[1] = ti.max(total[1] - 1, x[i])

    add()
    running = 0
    for value in values:
        running = max(running - 1, value)
    assert total[0] == 2 * (values > 4).sum()
    assert total[1] == running


@each
@of_each_type
def test_the_last_store_remains(one_thread, n, kind):
    x, y, p, values, buckets = fields(kind, n)
    last = ti.field(ti.i32, shape=n)

    @ti.kernel
    def store():
        for i in x:
            y[p[i]] = x[i]
            last[p[i]] = i

    store()
    expected, who = np.zeros(n, NUMPY[kind]), np.zeros(n, np.int32)
    for i in range(n):
        expected[buckets[i]], who[buckets[i]] = values[i], i
    assert (y.to_numpy() == expected).all()
    assert (last.to_numpy() == who).all()


@each
def test_an_update_reads_what_the_one_before_left(one_thread, n):
    x, y, p, values, _ = fields("i32", n)

    @ti.kernel
    def follow():
        for i in range(1, n):
            x[i] += x[i - 1] % 3

    follow()
    expected = values.copy()
    for i in range(1, n):
        expected[i] += expected[i - 1] % 3
    assert (x.to_numpy() == expected).all()


@pytest.mark.parametrize("n", [1, 8, 300])
def test_vectors_in_two_dimensions(one_thread, n):
    x = ti.Vector.field(3, ti.f64, shape=(n, n))
    values = np.random.default_rng(0).integers(0, 9, (n, n, 3)).astype(np.float64)
    x.from_numpy(values)

    @ti.kernel
    def follow():
        for i, j in ti.ndrange(n, n):
            if i > 0 and j > 0:
                x[i, j] = ti.floor(0.5 * (x[i - 1, j] + x[i, j - 1])) + x[i, j] - 4

    follow()
    for i in range(1, n):
        for j in range(1, n):
            values[i, j] += np.floor(0.5 * (values[i - 1, j] + values[i, j - 1])) - 4
    assert (x.to_numpy() == values).all()


@each
def test_one_array_given_twice(one_thread, n):
    @ti.kernel
    def follow(a: ti.types.ndarray(ti.i64, 1), b: ti.types.ndarray(ti.i64, 1)):
        for i in range(1, a.shape[0]):
            a[i] = b[i - 1] % 7 + a[i]

    values = np.random.default_rng(n).integers(0, 16, n)
    expected = values.copy()
    for i in range(1, n):
        expected[i] = expected[i - 1] % 7 + expected[i]
    follow(values, values)
    assert (values == expected).all()


@pytest.mark.parametrize("n", [1000, 65_537])
def test_the_border_has_its_turn(one_thread, n):
    """The border of a loop runs before the interior that follows it, and not apart from it."""
    x, y, p, values, _ = fields("i32", n)

    @ti.kernel
    def follow():
        for i in x:
            before = i - 1
            if i == 0:
                before = n - 1
            x[i] = x[before] % 5 + x[i]

    follow()
    expected = values.copy()
    for i in range(n):
        expected[i] = expected[i - 1] % 5 + expected[i]
    assert (x.to_numpy() == expected).all()


def test_loops_that_are_told_to_run_in_order_on_several_threads():
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, offline_cache=False)
    n = 65_537
    x, y, p, values, buckets = fields("f32", n)

    @ti.kernel
    def follow():
        ti.loop_config(serialize=True)
        for i in range(1, n):
            x[i] = x[i - 1] % 7 + x[i]
            y[p[i]] = y[p[i]] + 1

    follow()
    expected, counts = values.copy(), np.zeros(n)
    for i in range(1, n):
        expected[i] = expected[i - 1] % 7 + expected[i]
    np.add.at(counts, buckets[1:], 1)
    assert (x.to_numpy() == expected).all()
    assert (y.to_numpy() == counts).all()
