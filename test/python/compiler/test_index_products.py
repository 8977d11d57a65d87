"""Indices such as i * n + j, where n is known to the launch only, against all iterations."""

import itertools

import numpy as np
import pytest
import tai as ti

SIZE = 12
NUMBERS = [-2, -1, 0, 1, 2, 3, 4, 6, 12, 13]


def refused(kernel, *arguments):
    try:
        kernel(*arguments)
    except ti.TaiAssertionError as error:
        assert "is out of range for" in str(error)
        return True
    return False


def agrees(kernel, model, random, arguments, count=120):
    """Whether a launch is refused just where one of its iterations leaves the field."""
    outcomes = set()
    for values in random.choice(NUMBERS, (count, arguments)).tolist():
        expected = any(not 0 <= index < SIZE for index in model(*values))
        assert refused(kernel, *values) == expected, values
        outcomes.add(expected)
    assert outcomes == {True, False}


@pytest.fixture
def x():
    ti.init(arch=ti.cpu, offline_cache=False)
    return ti.field(ti.f32, SIZE)


@pytest.fixture
def random():
    return np.random.default_rng(7)


def test_rows_of_a_matrix(x, random):
    @ti.kernel
    def parallel(m: ti.i32, n: ti.i32):
        for i, j in ti.ndrange(m, n):
            x[i * n + j] += 1.0

    @ti.kernel
    def serial(m: ti.i32, n: ti.i32):
        for i in range(m):
            for j in range(n):
                x[n * i + j] += 1.0

    def model(m, n):
        return [i * n + j for i in range(m) for j in range(n)]

    agrees(parallel, model, random, 2)
    agrees(serial, model, random, 2)


def test_strides_and_offsets_of_any_sign(x, random):
    @ti.kernel
    def run(m: ti.i32, by: ti.i32, to: ti.i32):
        for i in range(m):
            x[to - (i + 1) * by] += 1.0

    agrees(run, lambda m, by, to: [to - (i + 1) * by for i in range(m)], random, 3)


def test_three_dimensions(x, random):
    @ti.kernel
    def run(l: ti.i32, m: ti.i32, n: ti.i32):  # noqa: E741
        for i, j, k in ti.ndrange(l, m, n):
            x[(i * m + j) * n + k] += 1.0

    def model(*shape):
        boxes = itertools.product(*(range(extent) for extent in shape))
        return [(i * shape[1] + j) * shape[2] + k for i, j, k in boxes]

    agrees(run, model, random, 3)


def test_bounds_and_sums_as_factors(x, random):
    @ti.kernel
    def run(a: ti.i32, b: ti.i32, n: ti.i64):
        for i in range(a, b):
            x[(n - 1) * i - a] += 1.0

    agrees(run, lambda a, b, n: [(n - 1) * i - a for i in range(a, b)], random, 3)


def test_conditions_are_asked_in_the_corners(x, random):
    @ti.kernel
    def guarded(m: ti.i32, n: ti.i32):
        for i, j in ti.ndrange(m, n):
            if i * n + j < SIZE:
                x[i * n + j] += 1.0

    for m, n in itertools.product(NUMBERS, NUMBERS):
        assert not refused(guarded, m, n)


def test_what_would_wrap_around_is_refused(x):
    @ti.kernel
    def run(m: ti.i32, n: ti.i32):
        for i, j in ti.ndrange(m, n):
            x[i * n + j] += 1.0

    @ti.kernel
    def column(m: ti.i32, n: ti.i32):
        for i in range(m):
            x[i * n] += 1.0

    assert refused(run, 70000, 70000)
    assert refused(column, 2**31 - 1, 2**31 - 1)
    assert not x.to_numpy().any()


def test_hashes_may_wrap_around(x):
    @ti.kernel
    def run(m: ti.i32, prime: ti.i32):
        for i in range(m):
            x[(i * prime) & 7] += 1.0
            x[(i * prime) % SIZE] += 1.0

    run(1000, 73856093)
    assert x.to_numpy().sum() == 2000


def test_the_error_names_an_index_out_of_range(x):
    @ti.kernel
    def run(a: ti.types.ndarray(ti.f32, ndim=1), m: ti.i32, n: ti.i32):
        for i, j in ti.ndrange(m, n):
            a[i * n + j] = 2.0

    a = np.zeros(10, np.float32)
    run(a, 2, 5)
    assert (a == 2).all()
    with pytest.raises(ti.TaiAssertionError, match=r"index \[10\]") as info:
        run(a, 3, 5)
    assert "a[i * n + j] = 2.0" in str(info.value)
    assert (a == 2).all()


def test_gradients_of_checked_products():
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, SIZE, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)

    @ti.kernel
    def run(m: ti.i32, n: ti.i32):
        for i, j in ti.ndrange(m, n):
            loss[None] += (i + 1) * x[i * n + j] ** 2

    x.from_numpy(np.arange(SIZE, dtype=float))
    with ti.ad.Tape(loss):
        run(3, 4)
    weights = np.repeat([1.0, 2.0, 3.0], 4)
    assert np.allclose(x.grad.to_numpy(), 2 * weights * np.arange(SIZE))
    with pytest.raises(ti.TaiAssertionError, match="out of range"), ti.ad.Tape(loss):
        run(4, 4)
