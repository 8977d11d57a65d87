"""S25 to S27: ill-conditioned sums, and many contributions to one element."""

import math

import numpy as np
import pytest
import tai as ti

from points import TYPES, number


def ill_conditioned(n, condition, seed, dtype):
    """`n` numbers whose absolute values sum to about `condition` times their sum."""
    real = number(dtype)
    a = np.random.default_rng(seed).standard_normal(n)
    a = (a - a.mean()).astype(real)
    total = np.abs(a.astype(float)).sum()
    a[n // 2] += real(total / condition - math.fsum(a.astype(float)))
    return a


def make_sum(n, dtype, accumulator=None):
    """A kernel that sums a field, the field, and the element with the sum."""
    x = ti.field(TYPES[dtype], shape=n, needs_grad=True)
    s = ti.field(TYPES[accumulator or dtype], shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            s[None] += x[i]

    return total, x, s


def error_of(total, x, s, a):
    x.from_numpy(a)
    s[None] = 0
    total()
    exact = math.fsum(a.astype(float))
    return abs(s[None] - exact) / abs(exact)


@pytest.mark.parametrize("deterministic", [False, True])
def test_s25_f32(deterministic, measure):
    """A few numbers are added in f32, and all else in f64, where one by one loses 6e-3."""
    ti.init(offline_cache=False, deterministic=deterministic)
    program = make_sum(10**6, "f32")
    errors = [error_of(*program, ill_conditioned(10**6, 1e6, s, "f32")) for s in range(8)]
    measure("median of 8", float(np.median(errors)), 2e-4)


def test_s25_f64_accumulator(measure):
    """The sum is an f64: the f32 terms are exact in it, and only their sum is rounded."""
    ti.init(offline_cache=False)
    program = make_sum(10**6, "f32", "f64")
    errors = [error_of(*program, ill_conditioned(10**6, 1e6, s, "f32")) for s in range(8)]
    measure("greatest of 8", max(errors), 1e-7)


@pytest.mark.parametrize("deterministic", [False, True])
@pytest.mark.parametrize("condition", [1e6, 1e8, 1e10, 1e12])
def test_s25_f64_of_any_condition(condition, deterministic, measure):
    """At most the condition times a few units of f64: 4 for a million terms in blocks."""
    ti.init(offline_cache=False, deterministic=deterministic)
    program = make_sum(10**6, "f64")
    errors = [error_of(*program, ill_conditioned(10**6, condition, s, "f64")) for s in range(4)]
    measure("median of 4", float(np.median(errors)), 4 * condition * 2.0**-53)


@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [65537, 10**6])
def test_s25_deterministic(n, dtype, measure):
    """100 runs, on 1 to 4 threads: one answer."""
    a = ill_conditioned(n, 1e6, 0, dtype)
    answers = set()
    for threads in (1, 2, 3, 4):
        ti.init(offline_cache=False, deterministic=True, cpu_max_num_threads=threads)
        total, x, s = make_sum(n, dtype)
        x.from_numpy(a)
        for _ in range(25):
            s[None] = 0
            total()
            answers.add(s[None])
    measure("distinct answers of 100", len(answers), 1)


class Cell:
    """`n` numbers that are added to one element, by an index that is known or comes from a field.

    The gradient of each number is that of the element.
    """

    def __init__(self, n, dtype, known, accumulator=None):
        real = TYPES[dtype]
        v = self.v = ti.field(real, shape=n, needs_grad=True)
        where = self.where = ti.field(ti.i32, shape=n)
        cell = self.cell = ti.field(TYPES[accumulator or dtype], shape=2, needs_grad=True)
        loss = self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        a = np.random.default_rng(0).random(n).astype(number(dtype))
        self.exact = math.fsum(a.astype(float))
        v.from_numpy(a)
        where.fill(1)

        @ti.kernel
        def scatter():
            for i in v:
                if ti.static(known):
                    cell[1] += v[i]
                else:
                    cell[where[i]] += v[i]

        @ti.kernel
        def weigh():
            loss[None] = 3.0 * cell[1]

        self.scatter, self.weigh = scatter, weigh

    def run(self):
        self.cell.fill(0)
        self.scatter()
        return self.cell[1]

    def error(self):
        return abs(self.run() - self.exact) / self.exact


def size(long):
    return 10**7 if long else 10**6


@pytest.mark.parametrize("accumulator", ["f32", "f64"])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("known", [True, False], ids=["constant", "field"])
def test_s26_f32(known, threads, accumulator, measure, long):
    """1e7 into one cell: the sum of each thread in f64 is rounded once; one by one loses 1e-2."""
    ti.init(offline_cache=False, cpu_max_num_threads=threads)
    bound = 1e-7 if accumulator == "f64" else 1e-5
    measure("relative error", Cell(size(long), "f32", known, accumulator).error(), bound)


@pytest.mark.parametrize("known", [True, False], ids=["constant", "field"])
def test_s26_gradient(known, long):
    """Each of the 1e7 numbers has the gradient of the cell: 3, exactly."""
    ti.init(offline_cache=False)
    program = Cell(size(long), "f32", known)
    program.cell.fill(0)
    with ti.ad.Tape(program.loss):
        program.scatter()
        program.weigh()
    assert (program.v.grad.to_numpy() == 3.0).all()


@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("known", [True, False], ids=["constant", "field"])
def test_s26_deterministic(known, dtype, measure, long):
    """100 runs, on 1 to 4 threads and with blocks of 32 to 256 on a GPU: one answer."""
    answers, runs = set(), 25 if long else 5
    for threads, block in ((1, 0), (2, 32), (3, 64), (4, 256)):
        options = {"default_gpu_block_dim": block} if block else {}
        ti.init(offline_cache=False, deterministic=True, cpu_max_num_threads=threads, **options)
        program = Cell(size(long), dtype, known)
        answers |= {program.run() for _ in range(runs)}
    measure(f"distinct answers of {4 * runs}", len(answers), 1)


@pytest.mark.parametrize("deterministic", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("known", [True, False], ids=["constant", "field"])
def test_s27_f64(known, threads, deterministic, measure, long):
    """1e7 into one cell in f64: one by one loses 1.0e-13, the square root of n times a unit."""
    ti.init(offline_cache=False, cpu_max_num_threads=threads, deterministic=deterministic)
    measure("relative error", Cell(size(long), "f64", known).error(), 1e-13)
