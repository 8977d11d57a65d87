"""Additions that meet in memory, in deterministic mode: the same bits every time.

On a GPU one warp does them, in an order that the numbers of the iterations fix.
"""

import numpy as np
import pytest
import tai as ti

BLOCKS = [32, 128, 1024]
ROUNDING = {ti.f32: 2e-5, ti.f64: 1e-13}


def bits(results):
    return [r.tobytes() for r in results]


def run_everywhere(make, runs=5, **options):
    """The results of `make`, which are the same however it is run."""
    first = None
    for block_dim in BLOCKS:
        ti.init(deterministic=True, default_gpu_block_dim=block_dim, offline_cache=False, **options)
        run = make()
        for _ in range(runs):
            results = run()
            first = first or results
            assert bits(results) == bits(first), f"other bits in blocks of {block_dim}"
    return first


def assert_near(result, expected, dtype):
    scale = np.abs(expected).max() if np.size(expected) else 0.0
    np.testing.assert_allclose(result, expected, rtol=0, atol=ROUNDING[dtype] * max(scale, 1.0))


def numpy_type(dtype):
    return np.float32 if dtype is ti.f32 else np.float64


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=["f32", "f64"])
@pytest.mark.parametrize("count", [0, 1, 31, 33, 100])
@pytest.mark.parametrize("cells", [1, 7], ids=["one", "seven"])
@pytest.mark.parametrize("debug", [False, True], ids=["", "debug"])
def test_repeated_indices(dtype, count, cells, debug):
    values = np.random.default_rng(count).standard_normal(max(count, 1)).astype(numpy_type(dtype))

    def make():
        x = ti.field(dtype, max(count, 1))
        y = ti.field(dtype, cells)
        n = ti.field(ti.i32, ())
        x.from_numpy(values)
        n[None] = count

        @ti.kernel
        def scatter():
            for i in range(n[None]):
                y[i % cells] += x[i]
                y[(3 * i) % cells] -= 0.25 * x[i]

        def run():
            y.fill(0.5)
            scatter()
            return [y.to_numpy()]

        return run

    (result,) = run_everywhere(make, debug=debug)
    expected = np.full(cells, 0.5)
    i = np.arange(count)
    np.add.at(expected, i % cells, values[:count].astype(float))
    np.add.at(expected, (3 * i) % cells, -0.25 * values[:count].astype(float))
    assert_near(result, expected, dtype)


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=["f32", "f64"])
@pytest.mark.parametrize("unrolled", [True, False], ids=["unrolled", "loops"])
def test_particles_to_grid_and_back(dtype, unrolled):
    n, size, steps = 100, 12, 3
    rng = np.random.default_rng(4)
    start = (1 + 4 * rng.random((n, 2))).astype(numpy_type(dtype))
    masses = rng.random(n).astype(numpy_type(dtype))

    def make():
        x = ti.Vector.field(2, dtype, (steps + 1, n), needs_grad=True)
        m = ti.field(dtype, n, needs_grad=True)
        momentum = ti.Vector.field(2, dtype, (steps, size, size), needs_grad=True)
        mass = ti.field(dtype, (steps, size, size), needs_grad=True)
        loss = ti.field(dtype, (), needs_grad=True)

        @ti.kernel
        def to_grid(t: ti.i32):
            for p in range(n):
                base = ti.cast(ti.floor(x[t, p]), ti.i32)
                f = x[t, p] - ti.floor(x[t, p])
                if ti.static(unrolled):
                    w = [0.5 * (1.0 - f) ** 2, 0.5 + f * (1.0 - f), 0.5 * f**2]
                    for a, b in ti.static(ti.ndrange(3, 3)):
                        weight = w[a][0] * w[b][1] * m[p]
                        mass[t, base + ti.Vector([a, b])] += weight
                        momentum[t, base + ti.Vector([a, b])] += weight * x[t, p]
                else:
                    for a in range(3):
                        for b in range(3):
                            weight = (0.1 + a * f[0]) * (0.2 + b * f[1]) * m[p]
                            mass[t, base + ti.Vector([a, b])] += weight
                            momentum[t, base + ti.Vector([a, b])] += weight * x[t, p]

        @ti.kernel
        def to_particles(t: ti.i32):
            for p in range(n):
                base = ti.cast(ti.floor(x[t, p]), ti.i32)
                v = ti.Vector([0.0, 0.0], dtype)
                for a, b in ti.static(ti.ndrange(3, 3)):
                    cell = base + ti.Vector([a, b])
                    v += momentum[t, cell] / (mass[t, cell] + 0.1)
                x[t + 1, p] = x[t, p] + 0.01 * v

        @ti.kernel
        def total():
            for p in range(n):
                loss[None] += x[steps, p].norm_sqr() * m[p]

        x.from_numpy(np.concatenate([start[None], np.zeros((steps, n, 2), start.dtype)]))
        m.from_numpy(masses)

        def clear():
            mass.fill(0)
            momentum.fill(0)

        clear()
        with ti.ad.Tape(loss) as tape:
            for t in range(steps):
                to_grid(t)
                to_particles(t)
            total()

        def run():
            clear()
            tape.replay()
            return [
                a.to_numpy() for a in (mass, momentum, x, m.grad, x.grad, mass.grad, momentum.grad)
            ]

        return run

    results = run_everywhere(make)
    # Forward, one step: by NumPy.
    f = start.astype(float) - np.floor(start)
    base = np.floor(start).astype(int)
    if unrolled:
        w = [0.5 * (1 - f) ** 2, 0.5 + f * (1 - f), 0.5 * f**2]
        wx, wy = [k[:, 0] for k in w], [k[:, 1] for k in w]
    else:
        wx, wy = ([0.1 + a * f[:, 0] for a in range(3)], [0.2 + b * f[:, 1] for b in range(3)])
    expected = np.zeros((size, size))
    for a in range(3):
        for b in range(3):
            np.add.at(expected, (base[:, 0] + a, base[:, 1] + b), wx[a] * wy[b] * masses)
    assert_near(results[0][0], expected, dtype)
    # Gradients: those of the CPU, whose order is another one.
    ti.init(arch=ti.cpu, offline_cache=False)
    reference = make()()
    for result, other in zip(results, reference, strict=True):
        assert_near(result, other.astype(float), dtype)


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=["f32", "f64"])
def test_additions_under_conditions(dtype):
    n, cells = 77, 6
    values = np.random.default_rng(9).standard_normal(n).astype(numpy_type(dtype))

    def make():
        x = ti.field(dtype, n, needs_grad=True)
        y = ti.Vector.field(3, dtype, cells, needs_grad=True)
        total = ti.field(dtype, (), needs_grad=True)
        seen = ti.field(ti.i32, cells)
        x.from_numpy(values)

        @ti.kernel
        def scatter(limit: ti.i32):
            for i in range(n):
                if x[i] > 0.0:
                    y[i % cells] += ti.Vector([x[i], 1.0, 2.0 * x[i]])
                    seen[i % cells] += 1
                    if x[i] > 1.0:
                        y[(i * i) % cells][1] -= x[i] * x[i]
                else:
                    y[0][2] += x[i]
                for k in range(limit):
                    if x[i] * k < 1.0:
                        y[k][0] += x[i] * k
                total[None] += x[i] * x[i]

        def run():
            y.fill(0)
            seen.fill(0)
            total[None] = 0
            x.grad.fill(0)
            scatter(3)
            y.grad.fill(1)
            total.grad[None] = 2
            scatter.grad(3)
            return [a.to_numpy() for a in (y, total, seen, x.grad)]

        return run

    y, total, seen, grad = run_everywhere(make)
    expected, count, slope = np.zeros((cells, 3)), np.zeros(cells, int), np.zeros(n)
    v = values.astype(float)
    for i in range(n):
        if v[i] > 0:
            expected[i % cells] += [v[i], 1, 2 * v[i]]
            count[i % cells] += 1
            slope[i] += 3
            if v[i] > 1:
                expected[i * i % cells, 1] -= v[i] ** 2
                slope[i] -= 2 * v[i]
        else:
            expected[0, 2] += v[i]
            slope[i] += 1
        for k in range(3):
            if v[i] * k < 1:
                expected[k, 0] += v[i] * k
                slope[i] += k
        slope[i] += 4 * v[i]
    assert_near(y, expected, dtype)
    assert_near(total, np.sum(v**2), dtype)
    np.testing.assert_array_equal(seen, count)
    assert_near(grad, slope, dtype)


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=["f32", "f64"])
@pytest.mark.parametrize("count", [1, 33, 96])
def test_gradients_of_gathers(dtype, count):
    cells = 10
    rng = np.random.default_rng(count)
    table = rng.standard_normal(cells).astype(numpy_type(dtype))
    index = rng.integers(0, cells, count).astype(np.int32)

    def make():
        x = ti.field(dtype, cells, needs_grad=True)
        where = ti.field(ti.i32, count)
        y = ti.field(dtype, count, needs_grad=True)
        loss = ti.field(dtype, (), needs_grad=True)
        scale = ti.field(dtype, (), needs_grad=True)
        x.from_numpy(table)
        where.from_numpy(index)
        scale[None] = 1.5

        @ti.kernel
        def gather():
            for i in range(count):
                y[i] = scale[None] * x[where[i]] * x[(where[i] + i) % cells]

        @ti.kernel
        def total():
            for i in range(count):
                loss[None] += y[i] * y[i]

        with ti.ad.Tape(loss) as tape:
            gather()
            total()

        def run():
            tape.replay()
            return [loss.to_numpy(), x.grad.to_numpy(), scale.grad.to_numpy()]

        return run

    loss, grad, slope = run_everywhere(make)
    v, i = table.astype(float), np.arange(count)
    a, b = index, (index + i) % cells
    y = 1.5 * v[a] * v[b]
    expected = np.zeros(cells)
    np.add.at(expected, a, 2 * y * 1.5 * v[b])
    np.add.at(expected, b, 2 * y * 1.5 * v[a])
    assert_near(loss, np.sum(y**2), dtype)
    assert_near(grad, expected, dtype)
    assert_near(slope, np.sum(2 * y * v[a] * v[b]), dtype)


def test_arrays_of_the_caller():
    n, cells = 70, 5
    values = np.random.default_rng(2).standard_normal(n).astype(np.float32)

    def make():
        @ti.kernel
        def scatter(x: ti.types.ndarray(ti.f32, ndim=1), y: ti.types.ndarray(ti.f32, ndim=1)):
            for i in range(n):
                y[(i * i) % cells] += x[i] * x[i]

        def run():
            y = np.zeros(cells, np.float32)
            scatter(values, y)
            return [y]

        return run

    (result,) = run_everywhere(make)
    expected = np.zeros(cells)
    np.add.at(expected, np.arange(n) ** 2 % cells, values.astype(float) ** 2)
    assert_near(result, expected, ti.f32)


def test_what_stays_on_one_thread():
    """Loops with trip counts that differ, and serial loops that read the field they add to."""
    n, cells = 50, 4

    def make():
        x = ti.field(ti.f32, cells)
        y = ti.field(ti.f32, cells)

        @ti.kernel
        def uneven():
            for i in range(n):
                for k in range(i % 5):
                    x[(i + k) % cells] += 0.1 * k

        @ti.kernel
        def reads():
            ti.loop_config(serialize=True)
            for i in range(n):
                y[i % cells] += 1.0 + 0.01 * y[(i + 1) % cells]

        def run():
            x.fill(0)
            y.fill(0)
            uneven()
            reads()
            return [x.to_numpy(), y.to_numpy()]

        return run

    x, y = run_everywhere(make)
    expected, chain = np.zeros(cells), np.zeros(cells)
    for i in range(n):
        for k in range(i % 5):
            expected[(i + k) % cells] += 0.1 * k
        chain[i % cells] += 1 + 0.01 * chain[(i + 1) % cells]
    assert_near(x, expected, ti.f32)
    assert_near(y, chain, ti.f32)


def test_a_tape_that_runs_as_one_kernel():
    """Steps that scatter and steps that do not, replayed often enough to become a program."""
    n, cells, steps = 70, 9, 6
    rng = np.random.default_rng(7)
    values, index = rng.standard_normal(n).astype(np.float32), rng.integers(0, cells, (steps, n))

    def make():
        x = ti.field(ti.f32, (steps + 1, n), needs_grad=True)
        grid = ti.field(ti.f32, (steps, cells), needs_grad=True)
        where = ti.field(ti.i32, (steps, n))
        loss = ti.field(ti.f32, (), needs_grad=True)
        where.from_numpy(index.astype(np.int32))
        x.from_numpy(np.concatenate([values[None], np.zeros((steps, n), np.float32)]))

        @ti.kernel
        def scatter(t: ti.i32):
            for i in range(n):
                grid[t, where[t, i]] += x[t, i]

        @ti.kernel
        def smooth(t: ti.i32):
            for c in range(cells):
                grid[t, c] *= 0.5

        @ti.kernel
        def gather(t: ti.i32):
            for i in range(n):
                x[t + 1, i] = x[t, i] + 0.1 * grid[t, where[t, i]] * grid[t, where[t, i]]

        @ti.kernel
        def total():
            for i in range(n):
                loss[None] += x[steps, i]

        grid.fill(0)
        with ti.ad.Tape(loss) as tape:
            for t in range(steps):
                scatter(t)
                smooth(t)
                gather(t)
            total()

        def run():
            grid.fill(0)
            tape.replay()
            return [a.to_numpy() for a in (loss, x, x.grad, grid, grid.grad)]

        return run

    fused = run_everywhere(make, runs=12)
    single = run_everywhere(make, runs=2, fuse_launches=False)
    assert bits(fused) == bits(single)
    x, grids = values.astype(float), []
    for t in range(steps):
        grid = np.zeros(cells)
        np.add.at(grid, index[t], x)
        grids.append(0.5 * grid)
        x = x + 0.1 * grids[-1][index[t]] ** 2
    grad = np.ones(n)
    for t in reversed(range(steps)):
        bar = np.zeros(cells)
        np.add.at(bar, index[t], grad * 0.2 * grids[t][index[t]])
        grad = grad + 0.5 * bar[index[t]]
    assert_near(fused[0], np.sum(x), ti.f32)
    assert_near(fused[2][0], grad, ti.f32)
