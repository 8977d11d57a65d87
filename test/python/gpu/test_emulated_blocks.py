"""Blocks of several threads on the emulated device: barriers, shuffles and sums of warps.

`TAI_EMULATED_THREADS` says how many threads a block has; they run one after another up to the next
barrier, in an order that changes.
"""

import numpy as np
import pytest
import tai as ti

THREADS = [1, 32, 96]


@pytest.fixture(params=THREADS)
def start(request, monkeypatch):
    """`ti.init` on the emulated device, with blocks of so many threads."""
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    monkeypatch.setenv("TAI_EMULATED_THREADS", str(request.param))

    def begin(**options):
        ti.init(offline_cache=False, **options)
        return request.param

    return begin


@pytest.mark.parametrize("n", [1, 31, 100, 1000, 20_001])
def test_reductions(start, n):
    start()
    x = ti.field(ti.i32, shape=n)
    total, least, bits = (ti.field(ti.i32, shape=()) for _ in range(3))
    wide, largest = ti.field(ti.f64, shape=()), ti.field(ti.f64, shape=())

    @ti.kernel
    def reduce():
        for i in x:
            total[None] += x[i]
            ti.atomic_min(least[None], x[i])
            ti.atomic_xor(bits[None], x[i])
            wide[None] += ti.cast(x[i], ti.f64)
            ti.atomic_max(largest[None], 0.5 * x[i])

    values = np.random.default_rng(n).integers(-1000, 1000, n, dtype=np.int32)
    x.from_numpy(values)
    largest[None] = -1e9
    reduce()
    assert total[None] == values.sum()
    assert least[None] == min(values.min(), 0)
    assert bits[None] == np.bitwise_xor.reduce(values)
    assert wide[None] == values.sum()
    assert largest[None] == 0.5 * values.max()


def test_ordered_additions(start):
    """Threads of a warp add to the same element, many at a time, in a fixed order."""
    start(deterministic=True)
    n, m = 777, 5
    x = ti.field(ti.f32, shape=n, needs_grad=True)
    y = ti.field(ti.f32, shape=m, needs_grad=True)
    to = ti.field(ti.i32, shape=n)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def scatter():
        for i in x:
            y[to[i]] += ti.sin(x[i]) * 1e3

    @ti.kernel
    def measure():
        for j in y:
            loss[None] += y[j] ** 2

    generator = np.random.default_rng(1)
    values = generator.uniform(-1, 1, n).astype(np.float32)
    places = generator.integers(0, m, n).astype(np.int32) // 2
    x.from_numpy(values)
    to.from_numpy(places)
    found = []
    for _ in range(2):
        y.fill(0)
        with ti.ad.Tape(loss):
            scatter()
            measure()
        found.append((y.to_numpy(), x.grad.to_numpy()))
    for value, again in zip(*found, strict=True):
        assert np.array_equal(value, again)
    sums = np.bincount(places, 1e3 * np.sin(values.astype(float)), m)
    slopes = 2e3 * sums[places] * np.cos(values)
    assert np.allclose(found[0][0], sums, rtol=1e-5, atol=1e-5 * np.abs(sums).max())
    assert np.allclose(found[0][1], slopes, rtol=1e-5, atol=1e-5 * np.abs(slopes).max())


def test_lists_of_active_cells(start):
    start()
    x = ti.field(ti.f32)
    # More cells than a block makes a list of at once.
    ti.root.pointer(ti.i, 5000).dense(ti.i, 2).place(x)
    count = ti.field(ti.i32, shape=())

    @ti.kernel
    def fill():
        for i in range(5000):
            if i % 7 == 3 or i > 4900:
                x[2 * i] = ti.cast(i, ti.f32)

    @ti.kernel
    def visit():
        for i in x:
            count[None] += 1
            x[i] += 1.0

    fill()
    visit()
    active = [i for i in range(5000) if i % 7 == 3 or i > 4900]
    assert count[None] == 2 * len(active)
    expected = np.zeros(10_000, np.float32)
    expected[[2 * i for i in active]] = active
    expected[[2 * i for i in active]] += 1
    expected[[2 * i + 1 for i in active]] += 1
    assert np.array_equal(x.to_numpy(), expected)
