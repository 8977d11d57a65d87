"""Sums of many numbers: how far they are from the exact ones, by default."""

import math
import os

import numpy as np
import pytest
import tai as ti

# The unit round-off of f32.
U = 2.0**-24
# The bound for sums into elements that the data chooses: a device adds to an f32 by atomics.
BOUND = 1e-4 if os.environ.get("TI_ARCH") == "cuda" else 1e-7


def ill_conditioned(n, condition, seed):
    """`n` numbers of f32 whose absolute values sum to about `condition` times their sum."""
    a = np.random.default_rng(seed).standard_normal(n)
    a = (a - a.mean()).astype(np.float32)
    total = np.abs(a.astype(float)).sum()
    a[n // 2] += np.float32(total / condition - math.fsum(a.astype(float)))
    return a


def summed(values, dt=ti.f32, shape=None):
    """The sum of an array by a kernel over a field of its shape."""
    values = values if shape is None else values.reshape(shape)
    x = ti.field(dt, shape=values.shape)
    s = ti.field(dt, shape=())
    x.from_numpy(values)

    @ti.kernel
    def total():
        for I in ti.grouped(x):
            s[None] += x[I]

    total()
    return s[None]


@pytest.mark.parametrize("deterministic", [False, True])
def test_condition_of_a_million(deterministic):
    """Stress case S25: 2e-4 at most, where one number after another gives 6e-3."""
    ti.init(deterministic=deterministic)
    errors = []
    for seed in range(8):
        a = ill_conditioned(10**6, 1e6, seed)
        exact = math.fsum(a.astype(float))
        errors.append(abs(summed(a) - exact) / abs(exact))
    assert np.median(errors) <= 2e-4


# Blocks of a loop and their rests; rows that are a block, and rows that are too short for one.
@pytest.mark.parametrize(
    "shape",
    [(1,), (2047,), (2048,), (2049,), (65537,), (300, 1000), (5, 7, 999), (70000, 3), (1, 4096)],
)
def test_no_number_is_lost_or_counted_twice(shape):
    ti.init()
    n = math.prod(shape)
    values = np.arange(1, n + 1) % 17 + 1.0
    assert summed(values.astype(np.float32), shape=shape) == np.float32(values.sum())
    assert summed(values, ti.f64, shape) == values.sum()


def test_positive_numbers():
    """A sum of a million positive numbers in f32 is right to a few roundings."""
    ti.init()
    a = np.random.default_rng(0).random(10**6).astype(np.float32)
    exact = math.fsum(a.astype(float))
    assert abs(summed(a) - exact) <= 4 * U * exact


@pytest.mark.parametrize("cells", [1, 4])
@pytest.mark.parametrize("threads", [1, 2])
def test_many_into_one_cell(cells, threads):
    """Stress case S26: 1e-7 where each addition to the element would round, which gives 2e-5."""
    ti.init(cpu_max_num_threads=threads)
    n = 2 * 10**6
    v = ti.field(ti.f32, shape=n)
    where = ti.field(ti.i32, shape=n)
    grid = ti.field(ti.f32, shape=cells)
    a = np.random.default_rng(0).random(n).astype(np.float32)
    index = np.arange(n, dtype=np.int32) % cells
    v.from_numpy(a)
    where.from_numpy(index)
    grid.fill(1.0)

    @ti.kernel
    def scatter():
        for i in v:
            grid[where[i]] += v[i]

    scatter()
    for cell in range(cells):
        exact = 1 + math.fsum(a[index == cell].astype(float))
        assert abs(grid[cell] - exact) <= BOUND * exact


def test_many_into_cells_beside_others():
    """The elements are members of a struct: the bytes between them keep their values."""
    ti.init()
    n = 65537
    mass, other = ti.field(ti.f32), ti.field(ti.f32)
    ti.root.dense(ti.i, 3).place(mass, other)
    v = ti.field(ti.f32, shape=n)
    v.fill(0.1)
    other.fill(7.0)

    @ti.kernel
    def scatter():
        for i in v:
            mass[i % 3] += v[i]
            mass[(i + 1) % 3] -= 0.5 * v[i]

    scatter()
    one = float(np.float32(0.1))
    counts = [sum(1 for i in range(n) if i % 3 == c) for c in range(3)]
    for c in range(3):
        exact = one * (counts[c] - 0.5 * counts[(c + 2) % 3])
        assert mass[c] == pytest.approx(exact, rel=2e-7)
        assert other[c] == 7.0


def test_gradients_of_shared_parameters():
    """The gradient of one number by a million terms, half of which cancel."""
    ti.init()
    n = 10**6
    a = ill_conditioned(n, 1e4, 3)
    x = ti.field(ti.f32, shape=n)
    w = ti.field(ti.f32, shape=(), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    x.from_numpy(a)
    w[None] = 2.0

    @ti.kernel
    def weigh():
        for i in x:
            loss[None] += w[None] * x[i]

    with ti.ad.Tape(loss):
        weigh()
    exact = math.fsum(a.astype(float))
    assert abs(w.grad[None] - exact) <= 2e-5 * abs(exact)
