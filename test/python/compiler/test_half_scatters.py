"""Scatters into fields of 16 bits are added up in f64 and rounded once."""

import numpy as np
import pytest
import tai as ti

from half_floats import check_scatters, nearest


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
@pytest.mark.parametrize("cells", [1, 7])
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("options", [{}, {"deterministic": True}, {"sums": "compensated"}], ids=str)
def test_many_terms_of_few_cells(dt, cells, threads, options):
    ti.init(arch=ti.cpu, cpu_max_num_threads=threads, **options)
    check_scatters(dt, cells, 100_003)


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
def test_gradients_through_scatters(dt):
    ti.init(arch=ti.cpu)
    n = 20_000
    x, at = ti.field(dt, n, needs_grad=True), ti.field(ti.i32, n)
    grid, loss = ti.field(dt, 2, needs_grad=True), ti.field(ti.f32, (), needs_grad=True)
    at.from_numpy((np.arange(n) % 2).astype(np.int32))
    x.fill(1 / 32)

    @ti.kernel
    def scatter():
        for i in x:
            grid[at[i]] += x[i]

    @ti.kernel
    def measure():
        for c in grid:
            loss[None] += grid[c] * (c + 1)

    with ti.ad.Tape(loss):
        scatter()
        measure()
    assert loss[None] == nearest(np.array(n / 64), dt) * 3
    assert np.array_equal(x.grad.to_numpy(), 1.0 + np.arange(n) % 2)


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
@pytest.mark.parametrize("cells", [3, 100_000])
@pytest.mark.parametrize("n", [33, 600, 5000])
@pytest.mark.parametrize("options", [{}, {"deterministic": True}, {"sums": "compensated"}], ids=str)
def test_few_terms_of_loops_of_known_length(dt, cells, n, options):
    """Such loops run on one thread, and their additions are not rounded one by one there."""
    ti.init(arch=ti.cpu, **options)
    x, at = ti.field(dt, n), ti.field(ti.i32, n)
    grid, total = ti.field(dt, cells), ti.field(dt, ())
    x.fill(1 / 8)

    @ti.kernel
    def scatter():
        for i in x:
            grid[at[i]] += x[i]

    @ti.kernel
    def add():
        for i in x:
            total[None] -= x[i]

    scatter()
    add()
    assert grid.to_numpy().astype(np.float32)[0] == nearest(n / 8, dt)
    assert np.float32(total[None]) == nearest(-n / 8, dt)
