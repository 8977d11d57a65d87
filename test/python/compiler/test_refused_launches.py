"""Launches are refused exactly where an iteration reads what another one writes."""

import itertools

import pytest
import tai as ti

SIZE = 24


def meets(writes, reads):
    """Whether iterations that differ write and read one element; by enumeration."""
    return any(
        place == other and i != j
        for i, place in enumerate(writes)
        for j, other in enumerate(reads)
    )  # fmt: skip


def is_refused(kernel, *args):
    try:
        kernel(*args)
    except ti.TaiRuntimeError as error:
        assert "is read here by one iteration of a parallel loop" in str(error)
        return True
    return False


@pytest.fixture
def x():
    ti.init(default_fp=ti.f32, cpu_max_num_threads=2)
    return ti.field(float, shape=SIZE)


def test_mirrored_indices(x):
    @ti.kernel
    def mirror(m: ti.i32, n: ti.i32):
        for i in range(n):
            x[i] = x[m - i]

    for m, n in itertools.product(range(12), range(1, 8)):
        if m >= n - 1:  # all indices are in the field
            expected = meets(range(n), [m - i for i in range(n)])
            assert is_refused(mirror, m, n) == expected, (m, n)


@pytest.mark.parametrize("factor", [2, 3, -1, -2])
@pytest.mark.parametrize("reads", [True, False])
def test_scaled_indices(x, factor, reads):
    @ti.kernel
    def scale(m: ti.i32, n: ti.i32):
        for i in range(n):
            if ti.static(reads):
                x[i + 1] = x[factor * i + m]
            else:
                x[factor * i + m] = x[i + 1]

    for m, n in itertools.product(range(10), range(1, 6)):
        scaled = [factor * i + m for i in range(n)]
        if all(0 <= place < SIZE for place in scaled):
            plain = range(1, n + 1)
            expected = meets(plain, scaled) if reads else meets(scaled, plain)
            assert is_refused(scale, m, n) == expected, (m, n)


def test_transposed_indices():
    ti.init(default_fp=ti.f32, cpu_max_num_threads=2)
    z = ti.field(float, shape=(12, 12))

    @ti.kernel
    def transpose(p: ti.i32, q: ti.i32, m: ti.i32, n: ti.i32):
        for i, j in ti.ndrange(m, n):
            z[i, j] = z[j + p, i + q]

    for p, q, m, n in itertools.product(range(3), range(3), range(1, 4), range(1, 4)):
        pairs = list(itertools.product(range(m), range(n)))
        expected = meets(pairs, [(j + p, i + q) for i, j in pairs])
        assert is_refused(transpose, p, q, m, n) == expected, (p, q, m, n)


def test_halves_that_are_exchanged(x):
    @ti.kernel
    def exchange(n: ti.i32):
        for i in range(n):
            if i < n // 2:
                kept = x[i]
                x[i] = x[n - 1 - i]
                x[n - 1 - i] = kept

    for n in range(SIZE):
        assert not is_refused(exchange, n)


def test_a_mirrored_loop_on_one_thread():
    ti.init(default_fp=ti.f32, cpu_max_num_threads=1)
    x = ti.field(float, shape=SIZE)

    @ti.kernel
    def mirror(m: ti.i32):
        for i in range(m + 1):
            x[i] = x[m - i] + 1

    mirror(5)
    assert list(x.to_numpy()[:6]) == [1, 1, 1, 2, 2, 2]
