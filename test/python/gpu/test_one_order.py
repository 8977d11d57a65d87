"""Sums over iterations, scatters, and adjoints that meet in an element: the same bits on the CPU,
with any number of threads, and on the emulated device, with blocks of any size, where
`math="strict"` and `deterministic=True` are chosen (decision 0039).
"""

import numpy as np
import pytest
import tai as ti

import layouts
from same_bits import TYPES, N, assert_same, fields, numbers

FLOATS = ["f32", "f64", "f16", "bf16"]


def targets(n, cells, seed=0):
    at = ti.field(ti.i32, shape=n)
    at.from_numpy(np.random.default_rng(seed).integers(0, cells, n).astype(np.int32))
    return at


def total(dtype, n=N):
    """All iterations add to one element."""
    (x,) = fields(dtype, 1, n)
    (s,) = fields(dtype, 1, ())

    @ti.kernel
    def run():
        for i in x:
            s[None] += x[i] * x[i] - 0.5

    x.from_numpy(numbers(n, dtype))
    run()
    return [s.to_numpy()]


def totals(dtype):
    """Several updates of one element, under conditions and in inner loops; products; parts of a
    vector; sums beside sums of integers and extremes; to elements that held something before."""
    (x,) = fields(dtype, 1)
    s = ti.field(TYPES[dtype], shape=8)
    most, count = ti.field(TYPES[dtype], shape=()), ti.field(ti.i32, shape=())
    v = ti.Vector.field(3, TYPES[dtype], shape=2)

    @ti.kernel
    def run():
        for i in x:
            s[0] += x[i]
            s[0] -= x[i] * x[i] * 0.5
            if x[i] > 0.25:
                s[1] += x[i]
                count[None] += 1
            for k in range(i % 5):
                s[2] -= x[(i * 3 + k) % N]
            ti.atomic_mul(s[3], 1.0 + 0.001 * x[i])
            ti.atomic_max(most[None], x[i])

    @ti.kernel
    def parts():
        for i in x:
            v[1] += ti.Vector([x[i], -x[i], 2.0 * x[i]]) * x[(i * 7) % N]

    x.from_numpy(numbers(N, dtype))
    s.from_numpy(numbers(8, dtype, 1))
    run()
    parts()
    return [f.to_numpy() for f in (s, most, count, v)]


def nothing_to_add(dtype):
    """An empty loop leaves -0, and so do terms that are -0; a loop of one iteration."""
    s = ti.field(TYPES[dtype], shape=4)

    @ti.kernel
    def run(n: ti.i32):
        for _i in range(n):
            s[0] += 1.0
        for i in range(7):
            s[1] += -0.0 * (i + 1)
        for _i in range(1):
            s[2] += 0.1
            s[2] += 0.3
            s[2] -= 0.7
        for i in range(3):
            s[3] += 0.1 * i
            s[3] += 0.3

    s.from_numpy(np.array([-0.0, -0.0, 0.2, 0.7], np.float32))
    run(0)
    found = s.to_numpy()
    assert np.signbit(found[:2]).all()
    return [found]


def run_time_sizes(dtype):
    """Bounds that the kernel is given, in one dimension and in two."""
    (x,) = fields(dtype, 1, 70_000)
    s = ti.field(TYPES[dtype], shape=12)
    grid = ti.field(TYPES[dtype], shape=97)

    @ti.kernel
    def line(first: ti.i32, last: ti.i32, to: ti.i32):
        for i in range(first, last):
            s[to] += x[i]
            s[to] += x[i] * 0.3

    @ti.kernel
    def plane(rows: ti.i32, columns: ti.i32, to: ti.i32):
        for i, j in ti.ndrange(rows, (3, columns)):
            s[to] += x[i * 300 + j] * x[j]

    @ti.kernel
    def spread(last: ti.i32):
        for i in range(last):
            grid[(i * i) % 97] += x[i]

    x.from_numpy(numbers(70_000, dtype))
    for to, (first, last) in enumerate(
        [(0, 0), (5, 6), (3, 259), (3, 260), (0, 8192), (1, 65_538)]
    ):
        line(first, last, to)
    for to, size in enumerate([(1, 4), (200, 300), (3, 290), (31, 8)]):
        plane(*size, 6 + to)
    spread(66_001)
    return [s.to_numpy(), grid.to_numpy()]


def boxes(dtype):
    """Constant boxes of two and three dimensions, with long and short rows."""
    p, q = fields(dtype, 1, (131, 517))[0], fields(dtype, 1, (40, 9, 5))[0]
    s = ti.field(TYPES[dtype], shape=3)

    @ti.kernel
    def run():
        for i, j in p:
            s[0] += p[i, j] * (i + 1)
        for i, j, k in q:
            s[1] += q[i, j, k] * p[i, j]
        for i, j in ti.ndrange((1, 130), (1, 516)):
            s[2] += p[i, j + 1] - 2.0 * p[i, j] + p[i, j - 1]

    p.from_numpy(numbers(131 * 517, dtype).reshape(131, 517))
    q.from_numpy(numbers(40 * 9 * 5, dtype, 1).reshape(40, 9, 5))
    run()
    return [s.to_numpy()]


def scatter(dtype, cells, n=N):
    """Iterations add to elements that an index names."""
    (x,) = fields(dtype, 1, n)
    (grid,) = fields(dtype, 1, cells)
    at = targets(n, cells)

    @ti.kernel
    def run():
        for i in x:
            grid[at[i]] += x[i]

    x.from_numpy(numbers(n, dtype))
    run()
    return [grid.to_numpy()]


def particles(dtype):
    """To nine neighbours, vectors, masses and one sum of all."""
    (x,) = fields(dtype, 1)
    v = ti.Vector.field(2, TYPES[dtype], shape=(40, 40))
    m = ti.field(TYPES[dtype], shape=(40, 40))
    (mass,) = fields(dtype, 1, ())
    at = targets(N, 37 * 37)

    @ti.kernel
    def run():
        for p in x:
            i, j = at[p] // 37, at[p] % 37
            for a, b in ti.static(ti.ndrange(3, 3)):
                w = x[p] * (0.5 + a) * (1.5 - b)
                v[i + a, j + b] += w * ti.Vector([x[p], 1.0])
                if w > 0.1:
                    m[i + a, j + b] += w
            mass[None] += x[p]

    x.from_numpy(numbers(N, dtype))
    run()
    return [f.to_numpy() for f in (v, m, mass)]


def borders(dtype):
    """The first and the last iterations, whose neighbours lie elsewhere, take their turns."""
    (x,) = fields(dtype, 1, 317)
    (y,) = fields(dtype, 1, (40, 60))
    (row, grid) = fields(dtype, 2, 7)
    (mass,) = fields(dtype, 1, ())
    at, to = targets(317, 7), targets(40 * 60, 7, 1)

    @ti.kernel
    def run():
        for i in x:
            row[at[i]] += x[i] * x[i - 1 if i > 0 else 316] + x[(i + 1) % 317]
            mass[None] += x[(i + 1) % 317]
        for i, j in y:
            left = y[i, j - 1] if j > 0 else 0.5
            grid[to[i * 60 + j]] += y[i, j] * y[i, (j + 1) % 60] - left

    x.from_numpy(numbers(317, dtype))
    y.from_numpy(numbers(40 * 60, dtype, 1).reshape(40, 60))
    run()
    return [f.to_numpy() for f in (row, grid, mass)]


def old_values(dtype):
    """The former value of an addition is used, and a kernel reads the elements that it adds to."""
    x, y = fields(dtype, 2)
    (grid,) = fields(dtype, 1, 101)
    at = targets(N, 101)

    @ti.kernel
    def run():
        for i in x:
            y[i] = ti.atomic_add(grid[at[i]], x[i])
        for i in range(1, N):
            if grid[at[i]] > 0.0:
                grid[at[i - 1]] -= x[i] * 0.1

    x.from_numpy(numbers(N, dtype))
    run()
    return [y.to_numpy(), grid.to_numpy()]


def arrays(dtype):
    """A case in which the kernel adds to arrays of the caller."""
    kind = numbers(1, dtype).dtype
    x, sums = numbers(N, dtype), np.zeros(19, kind)

    @ti.kernel
    def run(x: ti.types.ndarray(), sums: ti.types.ndarray()):
        for i in range(N):
            sums[(i * 5) % 18] += x[i]
            sums[18] += x[i] * 0.1

    run(x, sums)
    return [sums]


def adjoints_across_parts(dtype):
    """A stencil under a condition, whose adjoint is not gathered: parts of the loop meet."""
    n = 100_003
    x, y = fields(dtype, 2, n)

    @ti.kernel
    def run():
        for i in x:
            if i > 0 and i < n - 1:
                y[i] = (x[i - 1] - 2.0 * x[i] + x[i + 1]) * x[i]

    x.from_numpy(numbers(n, dtype))
    with ti.ad.Tape() as tape:
        run()
    tape.backward({y: numbers(n, dtype, 1)})
    return [x.grad.to_numpy()]


def adjoints_that_meet(dtype):
    """Adjoints of gathers, of a scalar that all iterations read, of a value computed before the
    loop, of an argument, and through a loss; several launches, replayed."""
    x, y = fields(dtype, 2)
    a, loss = fields(dtype, 2, ())
    w = ti.field(TYPES[dtype], shape=13, needs_grad=True)
    at = targets(N, N)

    @ti.kernel
    def step(scale: ti.f32):
        b = a[None] * a[None] * scale
        for i in y:
            y[i] = x[at[i]] * b + w[i % 13] * x[(i * 17) % N]

    @ti.kernel
    def measure():
        for i in y:
            loss[None] += y[i] * y[i] * 0.001

    x.from_numpy(numbers(N, dtype))
    w.from_numpy(numbers(13, dtype, 1))
    a[None] = 0.7
    found = []
    for scale in (0.5, 0.25, 0.75):
        loss[None] = 0.0
        with ti.ad.Tape(loss=loss):
            step(scale)
            measure()
        found += [f.to_numpy() for f in (loss, x.grad, a.grad, w.grad)]
    return found


PROGRAMS = [
    total, totals, nothing_to_add, run_time_sizes, boxes, particles, borders, old_values,
]  # fmt: skip


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.__name__)
def test_sums(program, dtype, monkeypatch):
    assert_same(program, dtype, monkeypatch)


@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize(
    "program", [arrays, adjoints_across_parts, adjoints_that_meet],
    ids=lambda program: program.__name__,
)  # fmt: skip
def test_arrays_and_adjoints(program, dtype, monkeypatch):
    assert_same(program, dtype, monkeypatch)


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("cells", [1, 13, 6007])
def test_scatters(cells, dtype, monkeypatch):
    assert_same(lambda dtype: scatter(dtype, cells), dtype, monkeypatch)


def test_more_fields_than_registers(monkeypatch):
    """With denormal numbers that are zero, functions of many arguments keep these as they are."""
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(math="strict", deterministic=True, ftz=True, offline_cache=False)
    count, n = 24, 65
    x = [ti.field(ti.f32, shape=n) for _ in range(count)]
    y = ti.field(ti.f32, shape=7)
    at = targets(n, 7)

    @ti.kernel
    def run():
        for i in at:
            for k in ti.static(range(count)):
                y[at[i]] += x[k][i] * x[(k + 1) % count][i]

    for k in range(count):
        x[k].fill(1e-30 if k == 3 else 0.5)
    run()
    run()
    expected = 2 * (count - 2) * 0.25 * np.bincount(at.to_numpy(), minlength=7)
    np.testing.assert_array_equal(y.to_numpy(), expected.astype(np.float32))


@pytest.mark.parametrize("n", [1, 255, 257, 65_537])
def test_sizes(n, monkeypatch):
    assert_same(lambda dtype: [*total(dtype, n), *scatter(dtype, 31, n)], "f64", monkeypatch)


@pytest.mark.parametrize(
    "layout, dtype",
    [
        ("pointer", "f64"), ("bitmasked", "f32"), ("hash", "f64"),
        ("pointer-lazy", "f32"), ("bitmasked-lazy", "f64"), ("hash-lazy", "f32"),
    ],
)  # fmt: skip
def test_layouts(layout, dtype, monkeypatch):
    """Loops over cells of sparse levels, and additions that make cells active."""

    def program(dtype):
        with layouts.below(layout):
            return [
                *total(dtype, 4096), *scatter(dtype, 600, 4096),
                *sparse_sums(dtype), *adjoints_across_cells(dtype),
            ]  # fmt: skip

    assert_same(program, dtype, monkeypatch)


def sparse_sums(dtype):
    """Over a box, and below the cells of the layout, in two dimensions."""
    (p,) = fields(dtype, 1, (64, 48))
    s = ti.field(TYPES[dtype], shape=2)

    @ti.kernel
    def fill():
        for i, j in ti.ndrange((3, 50), (1, 47)):
            if (i * j) % 3 != 1:
                p[i, j] = 0.1 * i - 0.01 * j * j

    @ti.kernel
    def run():
        for i, j in p:
            s[0] += p[i, j] * (i - 0.3 * j)
        for i, j in ti.ndrange(64, 48):
            s[1] += p[i, j]

    fill()
    run()
    return [s.to_numpy()]


def adjoints_across_cells(dtype):
    """Neighbours in other cells."""
    x, y = fields(dtype, 2, 4096)

    @ti.kernel
    def run():
        for i in x:
            if i > 0 and i < 4095:
                y[i] = (x[i - 1] - 2.0 * x[i] + x[i + 1]) * x[i]

    x.from_numpy(numbers(4096, dtype))
    with ti.ad.Tape() as tape:
        run()
    tape.backward({y: numbers(4096, dtype, 1)})
    return [x.grad.to_numpy()]
