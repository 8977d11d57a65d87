"""Additions to elements that the data chooses, in deterministic mode on a device: in fixed point,
so that the result does not depend on the order (decision 0044).
"""

import math

import numpy as np
import pytest
import tai as ti

TYPES = {"f32": (ti.f32, np.float32, 24), "f64": (ti.f64, np.float64, 53)}
N = 5003


@pytest.fixture(params=[1, 32, 96], ids=lambda threads: f"blocks-of-{threads}")
def threads(request, monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    monkeypatch.setenv("TAI_EMULATED_THREADS", str(request.param))
    return request.param


def begin(dtype="f32", **options):
    ti.init(
        arch=ti.cuda, deterministic=True, offline_cache=False,
        default_fp=TYPES[dtype][0], **options,
    )  # fmt: skip


def scatter(dtype, values, where, start, by_argument=False):
    """Adds values to elements; the results start from their former values."""
    real, kind, _ = TYPES[dtype]
    n = len(values)
    x, at, grid = ti.field(real, n), ti.field(ti.i32, n), ti.field(real, len(start))
    x.from_numpy(np.asarray(values, kind))
    at.from_numpy(np.asarray(where, np.int32))
    grid.from_numpy(np.asarray(start, kind))

    @ti.kernel
    def run():
        for i in x:
            grid[at[i]] += x[i]

    @ti.kernel
    def run_some(first: ti.i32, last: ti.i32):
        for i in range(first, last):
            grid[at[i]] += x[i]

    if by_argument:
        run_some(0, n)
    else:
        run()
    return grid.to_numpy()


def assert_exact(dtype, found, values, where, start):
    """Each element is off by two roundings, of the sum and of the addition to the former value, and
    by half a unit for each value."""
    digits = TYPES[dtype][2]
    for cell, result in enumerate(found):
        own = values[where == cell]
        exact = math.fsum([start[cell], *own])
        unit = np.abs(own).max(initial=0) * 2.0 ** (-29 if dtype == "f32" else -59)
        allowed = (3 * abs(exact) + abs(start[cell])) * 2.0**-digits + unit * len(own)
        assert abs(result - exact) <= allowed, f"{cell}: {result} is not {exact}"


def draw(dtype, n, cells, seed=0):
    random = np.random.default_rng(seed)
    values = random.standard_normal(n) * 10.0 ** random.integers(-3, 4, n)
    return values.astype(TYPES[dtype][1]), random.integers(0, cells, n), random


@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize("cells", [1, 7, 3001])
def test_any_order_has_the_same_bits(dtype, cells, threads):
    values, where, random = draw(dtype, N, cells)
    start = random.standard_normal(cells).astype(TYPES[dtype][1])
    begin(dtype)
    first = scatter(dtype, values, where, start)
    assert_exact(dtype, first, values, where, start)
    for _ in range(3):
        order = random.permutation(N)
        found = scatter(dtype, values[order], where[order], start)
        assert found.tobytes() == first.tobytes()


@pytest.mark.parametrize("by_argument", [False, True], ids=["field", "run-time"])
@pytest.mark.parametrize("n", [1, 255, 257, 65_537])
def test_sizes(n, by_argument, threads):
    values, where, _ = draw("f64", n, 31)
    begin("f64")
    found = scatter("f64", values, where, np.zeros(31), by_argument)
    assert_exact("f64", found, values, where, np.zeros(31))


@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_no_numbers(dtype, threads):
    """Infinities and NaN come out as they would from any order of additions."""
    inf, nan = math.inf, math.nan
    most = float(np.finfo(TYPES[dtype][1]).max)
    cases = [
        (0.0, [1.0, inf, -3.0], inf), (0.0, [-inf, most], -inf), (0.0, [inf, -inf], nan),
        (0.0, [1.0, nan], nan), (0.0, [inf, nan], nan), (0.0, [inf, inf], inf),
        (-inf, [inf], nan), (inf, [1.0, 2.0], inf), (nan, [1.0], nan), (1.0, [], 1.0),
        (most, [most], inf), (-most, [-most, -most], -inf), (0.0, [most, most, -most], most),
    ]  # fmt: skip
    values = np.array([v for _, own, _ in cases for v in own] + [0.0] * N)
    where = np.array([i for i, (_, own, _) in enumerate(cases) for _ in own] + [len(cases)] * N)
    begin(dtype)
    found = scatter(dtype, values, where, [start for start, _, _ in cases] + [0.0])
    np.testing.assert_array_equal(found[:-1], np.array([e for _, _, e in cases], TYPES[dtype][1]))


@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_zeros_and_small_numbers(dtype, threads):
    """Zeros change nothing; subnormal numbers are added up as others are."""
    kind = TYPES[dtype][1]
    least, normal = np.finfo(kind).smallest_subnormal, np.finfo(kind).smallest_normal
    cases = [
        (-0.0, [-0.0, -0.0], -0.0), (0.0, [-0.0], 0.0), (0.0, [1.0, -1.0], 0.0),
        (0.0, [least, least, least], 3 * least), (least, [-least], 0.0),
        (0.0, [normal, -least], normal - least), (normal, [normal, normal], 3 * normal),
    ]  # fmt: skip
    values = np.array([v for _, own, _ in cases for v in own] + [0.0] * N, kind)
    where = np.array([i for i, (_, own, _) in enumerate(cases) for _ in own] + [len(cases)] * N)
    begin(dtype)
    found = scatter(dtype, values, where, [start for start, _, _ in cases] + [-0.0])
    expected = np.array([e for _, _, e in cases] + [-0.0], kind)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))


def particles(real, n):
    """Particles add momenta and masses to neighbours, with other effects, and with reads before."""
    x = ti.Vector.field(2, real, n, offset=(3,))
    momentum = ti.Vector.field(2, real, (2, 40, 41))
    mass, count = ti.field(real, (2, 40, 41)), ti.field(ti.i32, (40, 41))
    total, age = ti.field(real, ()), ti.field(real, n, offset=(3,))

    @ti.kernel
    def run(slot: ti.i32):
        for p in x:
            base = ti.cast(ti.floor(x[p]), ti.i32)
            f = x[p] - ti.floor(x[p])
            for a in range(3):
                for b in ti.static(range(3)):
                    w = (0.5 + a * f[0]) * (1.5 - b * f[1])
                    cell = base + ti.Vector([a, b])
                    momentum[slot, cell] -= w * x[p]
                    if w > 0.6:
                        mass[slot, cell] += w + age[p]
                    count[cell] += 1
            total[None] += f[0]
            age[p] += 0.5

    return x, age, [momentum, mass, count, total, age], run


@pytest.mark.parametrize("debug", [False, True], ids=["", "debug"])
@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_particles(dtype, debug, threads):
    random = np.random.default_rng(5)
    place = (37 * random.random((N, 2))).astype(TYPES[dtype][1])
    begin(dtype, debug=debug)
    x, age, results, run = particles(TYPES[dtype][0], N)
    bits = []
    for order in (np.arange(N), random.permutation(N)):
        x.from_numpy(place[order])
        age.fill(0.25)
        for field in results[:-1]:
            field.fill(0)
        run(1)
        run(1)
        found = [field.to_numpy() for field in results]
        bits.append([array.tobytes() for array in found[:3]])
    assert bits[0] == bits[1]
    momentum, mass, count, total, ages = found
    expected, weights = np.zeros((40, 41, 2)), np.zeros((40, 41))
    exact = place.astype(np.float64)
    base, f = np.floor(exact).astype(int), exact - np.floor(exact)
    for a in range(3):
        for b in range(3):
            w = (0.5 + a * f[:, 0]) * (1.5 - b * f[:, 1])
            at = (base[:, 0] + a, base[:, 1] + b)
            np.add.at(expected, at, -2 * w[:, None] * exact)
            np.add.at(weights, at, np.where(w > 0.6, 2 * w + 0.25 + 0.75, 0))
    assert not momentum[0].any() and not mass[0].any()
    np.testing.assert_allclose(momentum[1], expected, atol=1e-4 * np.abs(expected).max(), rtol=0)
    if dtype == "f64":  # rounded weights are on either side of the condition
        np.testing.assert_allclose(mass[1], weights, rtol=1e-12, atol=1e-12)
    assert count.sum() == 2 * 9 * N and (ages == 1.25).all()
    np.testing.assert_allclose(total, 2 * f[:, 0].sum(), rtol=1e-5)


def test_an_iteration_reads_what_it_wrote(threads):
    begin()
    x, at, grid = ti.field(ti.f32, N), ti.field(ti.i32, N), ti.field(ti.f32, 11)
    values, where, _ = draw("f32", N, 11)
    x.from_numpy(values)
    at.from_numpy(where.astype(np.int32))

    @ti.kernel
    def run():
        for i in x:
            for _ in range(2):
                x[i] = 2.0 * x[i]
                grid[at[i]] += x[i]

    run()
    doubled = 6 * np.bincount(where, values.astype(np.float64), 11)
    np.testing.assert_allclose(grid.to_numpy(), doubled, rtol=1e-4)


@pytest.mark.parametrize("fuse_launches", [True, False], ids=["", "apart"])
@pytest.mark.parametrize("dtype", ["f32", "f64"])
def test_gradients_of_gathers(dtype, fuse_launches, threads):
    """The gradients of several launches, which are replayed."""
    real = TYPES[dtype][0]
    begin(dtype, fuse_launches=fuse_launches)
    x = ti.field(real, 997, needs_grad=True)
    y, loss = ti.field(real, N, needs_grad=True), ti.field(real, (), needs_grad=True)
    at = ti.field(ti.i32, N)
    values, where, _ = draw(dtype, N, 997)
    at.from_numpy(where.astype(np.int32))
    x.from_numpy(values[:997])

    @ti.kernel
    def look(scale: real):
        for i in y:
            y[i] += x[at[i]] * x[(i * 17) % 997] * scale

    @ti.kernel
    def measure():
        for i in y:
            loss[None] += y[i] * 0.5

    first = None
    for _ in range(7):
        y.fill(0)
        loss[None] = 0
        with ti.ad.Tape(loss=loss):
            for step in range(5):
                look(0.5 + step)
            measure()
        found = x.grad.to_numpy()
        first = found if first is None else first
        assert found.tobytes() == first.tobytes()
    other = (np.arange(N) * 17) % 997
    exact = values[:997].astype(np.float64)
    expected = np.bincount(where, exact[other], 997) + np.bincount(other, exact[where], 997)
    near = 1e-5 if dtype == "f32" else 1e-13
    expected *= 0.5 * 12.5
    np.testing.assert_allclose(first, expected, rtol=0, atol=near * np.abs(expected).max())


def test_blocks_and_matrices(threads):
    """Elements in an order of their own, of two dimensions."""
    begin("f64")
    grid, other = ti.Matrix.field(2, 3, ti.f64), ti.field(ti.f64)
    ti.root.dense(ti.ij, (5, 4)).dense(ti.ij, (3, 6)).place(grid, other)
    x, at = ti.field(ti.f64, N), ti.field(ti.i32, N)
    values, where, _ = draw("f64", N, 15 * 24)
    x.from_numpy(values)
    at.from_numpy(where.astype(np.int32))

    @ti.kernel
    def run():
        for i in x:
            cell = ti.Vector([at[i] // 24, at[i] % 24])
            grid[cell] += x[i] * ti.Matrix([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
            other[cell] -= x[i]

    run()
    sums = np.bincount(where, values, 15 * 24).reshape(15, 24)
    atol = 1e-12 * np.abs(sums).max()
    np.testing.assert_allclose(other.to_numpy(), -sums, rtol=0, atol=atol)
    expected = sums[:, :, None, None] * np.arange(1, 7).reshape(2, 3)
    np.testing.assert_allclose(grid.to_numpy(), expected, rtol=0, atol=6 * atol)


def test_loops_of_uneven_length(threads):
    """Their adjoints save the values of the inner loops, in memory of each iteration."""
    begin("f64")
    w = ti.field(ti.f64, 211, needs_grad=True)
    y = ti.field(ti.f64, N, needs_grad=True)

    @ti.kernel
    def run():
        for i in y:
            v = 1.0
            for k in range(i % 7):
                v = ti.sin(v * w[(i * 31 + k * k) % 211])
            y[i] = v

    values, _, _ = draw("f64", N, 1)
    w.from_numpy(np.linspace(0.2, 1.4, 211))
    first = None
    for _ in range(3):
        with ti.ad.Tape() as tape:
            run()
        tape.backward({y: values})
        found = w.grad.to_numpy()
        first = found if first is None else first
        assert found.tobytes() == first.tobytes()
    expected = np.zeros(211)
    for i in range(N):
        chain, number = [], 1.0
        for k in range(i % 7):
            at = (i * 31 + k * k) % 211
            chain.append((at, number, 0.2 + at * (1.2 / 210)))
            number = math.sin(number * chain[-1][2])
        adjoint = values[i]
        for at, number, weight in reversed(chain):
            slope = adjoint * math.cos(number * weight)
            expected[at] += slope * number
            adjoint = slope * weight
    np.testing.assert_allclose(first, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
