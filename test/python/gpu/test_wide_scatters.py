"""Scatters on a GPU that are rounded once: of 16-bit floats, and compensated ones.

On a machine without a GPU they run on the emulated device.
"""

import math
import os

import numpy as np
import pytest
import tai as ti

from half_floats import check_scatters, nearest


@pytest.fixture(autouse=True)
def device(monkeypatch):
    if os.environ.get("TI_ARCH") != "cuda":
        monkeypatch.setenv("TI_ARCH", "cuda")
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")


def exact_sums(values, where, cells):
    return np.array([math.fsum(values[where == cell]) for cell in range(cells)])


def ill_conditioned(n, real, seed=0):
    """Terms with a sum some 1e6 (f32) or 1e12 (f64) times smaller than that of their sizes."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(n) * 10.0 ** rng.uniform(0, 4 if real == ti.f32 else 12, n)
    values = values.astype(np.float32 if real == ti.f32 else np.float64)
    values[n // 2 :] = -values[: n - n // 2]
    values[0] += 1
    return values


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
@pytest.mark.parametrize("cells", [1, 7])
@pytest.mark.parametrize("n", [1, 33, 100_003])
def test_halves(dt, cells, n):
    ti.init()
    check_scatters(dt, cells, n)


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
def test_halves_of_a_row_launched_again_and_again(dt):
    """Each launch adds to what others have left; other rows stay."""
    ti.init()
    n, cells = 5000, 3
    x, at, grid = ti.field(dt, n), ti.field(ti.i32, n), ti.field(dt, (4, cells))
    at.from_numpy((np.arange(n) % cells).astype(np.int32))
    x.fill(1 / 64)
    grid.fill(1)

    @ti.kernel
    def scatter(row: ti.i32):
        for i in x:
            grid[row, at[i]] += x[i]

    expected = np.ones((4, cells))
    for launch in range(12):
        row = 1 + launch % 2
        scatter(row)
        expected[row] = nearest(expected[row] + np.bincount(np.arange(n) % cells) / 64, dt)
    np.testing.assert_array_equal(grid.to_numpy().astype(np.float32), expected)


@pytest.mark.parametrize("real", [ti.f32, ti.f64], ids=["f32", "f64"])
@pytest.mark.parametrize("cells", [1, 5])
@pytest.mark.parametrize("n", [2, 33, 65537])
def test_compensated(real, cells, n):
    ti.init(sums="compensated", default_fp=real)
    x, at = ti.field(real, n), ti.field(ti.i32, n)
    grid, total = ti.Vector.field(2, real, cells), ti.field(real, ())
    values = ill_conditioned(n, real)
    where = (np.arange(n) * 7 % 11 % cells).astype(np.int32)
    x.from_numpy(values)
    at.from_numpy(where)
    grid.fill(3)

    @ti.kernel
    def scatter():
        for i in x:
            grid[at[i]] += ti.Vector([x[i], -2 * x[i]])
            total[None] += x[i]

    scatter()
    exact = exact_sums(values.astype(np.float64), where, cells)
    # The sum of what stood there and the terms is rounded once.
    unit = 2.0 ** (-24 if real == ti.f32 else -53)
    sizes = np.bincount(where, np.abs(values.astype(np.float64)), cells) + 3
    kept = 2.0 ** (-52 if real == ti.f32 else -100)
    slack = 1.01 * unit * np.abs(exact + 3) + kept * n * sizes
    found = grid.to_numpy().astype(np.float64)
    assert (np.abs(found[:, 0] - (exact + 3)) <= slack).all()
    assert (np.abs(found[:, 1] - (3 - 2 * exact)) <= 2 * slack + 3 * unit * 3).all()
    whole = math.fsum(values.astype(np.float64))
    assert abs(total[None] - whole) <= 1.01 * unit * abs(whole) + kept * n * sizes.sum()


@pytest.mark.parametrize("real", [ti.f32, ti.f64], ids=["f32", "f64"])
@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan, "huge"])
def test_what_is_not_finite_stays_in_its_cell(real, bad):
    ti.init(sums="compensated", default_fp=real)
    n = 40
    x, grid = ti.field(real, n), ti.field(real, 4)
    values = np.ones(n)
    # Two of these are too large together.
    values[1:9:4] = (3e38 if real == ti.f32 else 1.5e308) if bad == "huge" else bad
    x.from_numpy(values)

    @ti.kernel
    def scatter():
        for i in x:
            grid[i % 4] += x[i]

    scatter()
    found = grid.to_numpy()
    np.testing.assert_array_equal(found[[0, 2, 3]], 10)
    assert np.isnan(found[1]) if bad is np.nan else found[1] == (np.inf if bad == "huge" else bad)


def test_gradients_of_a_lookup():
    """The reverse of a gather is a scatter: compensated, in f64."""
    ti.init(sums="compensated", default_fp=ti.f64)
    n, cells = 20_001, 3
    x, at = ti.field(ti.f64, cells, needs_grad=True), ti.field(ti.i32, n)
    weight, loss = ti.field(ti.f64, n), ti.field(ti.f64, (), needs_grad=True)
    values = ill_conditioned(n, ti.f64, seed=3)
    where = (np.arange(n) % 5 % cells).astype(np.int32)
    at.from_numpy(where)
    weight.from_numpy(values)
    x.fill(1.0)

    @ti.kernel
    def measure():
        for i in weight:
            loss[None] += weight[i] * x[at[i]]

    for _ in range(3):
        loss[None] = 0
        with ti.ad.Tape(loss):
            measure()
        exact = exact_sums(values, where, cells)
        np.testing.assert_allclose(x.grad.to_numpy(), exact, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("cells", [1, 3])
def test_many_numbers_of_f32_into_few_cells(cells):
    """Each addition to a large number would be off by half a unit of that number."""
    ti.init()
    n = 400_003
    x, at, grid = ti.field(ti.f32, n), ti.field(ti.i32, n), ti.field(ti.f32, cells)
    values = np.random.default_rng(1).uniform(0, 1, n).astype(np.float32)
    where = np.random.default_rng(2).integers(0, cells, n).astype(np.int32)
    x.from_numpy(values)
    at.from_numpy(where)

    @ti.kernel
    def scatter():
        for i in x:
            grid[at[i]] += x[i]

    scatter()
    exact = exact_sums(values.astype(np.float64), where, cells)
    np.testing.assert_array_equal(grid.to_numpy(), exact.astype(np.float32))


def test_two_fields_and_other_effects():
    ti.init(sums="compensated", default_fp=ti.f64)
    n = 1000
    x, at, out = ti.field(ti.f64, n), ti.field(ti.i32, n), ti.field(ti.f64, n)
    a, b, count = ti.field(ti.f64, 3), ti.field(ti.f32, (2, 3)), ti.field(ti.i32, 3)
    x.from_numpy(np.linspace(-1, 1, n))
    at.from_numpy((np.arange(n) % 3).astype(np.int32))

    @ti.kernel
    def scatter():
        for i in x:
            out[i] = 2 * x[i]
            a[at[i]] += x[i]
            b[1, at[i]] -= ti.cast(x[i], ti.f32)
            count[at[i]] += 1
            if x[i] > 0:
                b[0, at[i]] += 1.0

    scatter()
    where = np.arange(n) % 3
    np.testing.assert_array_equal(out.to_numpy(), np.linspace(-1, 1, n) * 2)
    exact = exact_sums(np.linspace(-1, 1, n), where, 3)
    np.testing.assert_allclose(a.to_numpy(), exact, rtol=0, atol=1e-16)
    positive = np.bincount(where, np.linspace(-1, 1, n) > 0, 3)
    np.testing.assert_array_equal(b.to_numpy()[0], positive)
    rounded = np.linspace(-1, 1, n).astype(np.float32).astype(np.float64)
    np.testing.assert_allclose(b.to_numpy()[1], -exact_sums(rounded, where, 3), rtol=1e-6)
    np.testing.assert_array_equal(count.to_numpy(), np.bincount(where))


@pytest.mark.parametrize("kind", ["old", "read", "deterministic"])
def test_what_cannot_be_compensated_is_refused(kind):
    ti.init(sums="compensated", default_fp=ti.f64, deterministic=kind == "deterministic")
    x, grid = ti.field(ti.f64, 64), ti.field(ti.f64, 4)

    @ti.kernel
    def scatter():
        for i in x:
            if ti.static(kind == "old"):
                x[i] = ti.atomic_add(grid[ti.cast(x[i], ti.i32)], 1.0)
            else:
                grid[ti.cast(x[i], ti.i32)] += 1.0
                if ti.static(kind == "read"):
                    x[i] = grid[0]

    with pytest.raises(Exception, match=r"sums=.compensated. cannot be had for this sum"):
        scatter()
