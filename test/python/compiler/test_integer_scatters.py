"""Counts and sums of whole numbers into bins, which the threads of a CPU add up apart."""

import numpy as np
import pytest
import tai as ti


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("size", [1, 7, 256, 5000])
@pytest.mark.parametrize("dt", [ti.i32, ti.u32, ti.i64, ti.u64, ti.i16, ti.u8], ids=str)
def test_bins(dt, size, threads):
    """The sums wrap around, too."""
    ti.init(cpu_max_num_threads=threads)
    n = 65_537
    generator = np.random.default_rng(size)
    at = generator.integers(0, size, n).astype(np.int32)
    low, high = np.iinfo(dt.numpy).min, np.iinfo(dt.numpy).max
    values = generator.integers(low, high, n, dtype=dt.numpy, endpoint=True)
    index, value = ti.field(ti.i32, n), ti.field(dt, n)
    up, down = ti.field(dt, size), ti.field(dt, size)
    index.from_numpy(at)
    value.from_numpy(values)

    @ti.kernel
    def add():
        for i in index:
            up[index[i]] += value[i]
            down[index[i]] -= value[i]

    wanted_up, wanted_down = np.full(size, 3, dt.numpy), np.full(size, 3, dt.numpy)
    up.fill(3)
    down.fill(3)
    for _ in range(2):
        add()
        np.add.at(wanted_up, at, values)
        np.subtract.at(wanted_down, at, values)
    np.testing.assert_array_equal(up.to_numpy(), wanted_up)
    np.testing.assert_array_equal(down.to_numpy(), wanted_down)


@pytest.mark.parametrize("layout", [ti.Layout.AOS, ti.Layout.SOA])
@pytest.mark.parametrize("dt", [ti.i32, ti.i64], ids=str)
def test_vectors_beside_other_fields(dt, layout):
    """In a cell with a float, and with counts at once."""
    ti.init(cpu_max_num_threads=3)
    n, bins = 100_001, 97
    v, w, weight = ti.Vector.field(3, dt), ti.field(dt), ti.field(ti.f64)
    if layout == ti.Layout.AOS:
        ti.root.dense(ti.i, bins).place(v, w, weight)
    else:
        for f in (v, w, weight):
            ti.root.dense(ti.i, bins).place(f)

    @ti.kernel
    def add(n: ti.i32):
        for i in range(n):
            b = i * 31 % bins
            v[b] += ti.Vector([i, 2 * i, -i])
            v[b][i % 3] += 1
            w[b] += 1
            weight[b] += 0.5

    add(n)
    i = np.arange(n)
    b = i * 31 % bins
    wanted = np.stack([np.bincount(b, k * i) for k in (1, 2, -1)], axis=1)
    for c in range(3):
        wanted[:, c] += np.bincount(b, i % 3 == c)
    # Sums in 64 bits wrap around to 32 as those in 32 bits do.
    np.testing.assert_array_equal(v.to_numpy(), wanted.astype(np.int64).astype(dt.numpy))
    np.testing.assert_array_equal(w.to_numpy(), np.bincount(b))
    np.testing.assert_array_equal(weight.to_numpy(), 0.5 * np.bincount(b))


def test_old_values_are_each_given_once():
    """Such counts stay atomic: each is the place of a particle in its cell."""
    ti.init(cpu_max_num_threads=3)
    n, bins = 20_000, 11
    count, place = ti.field(ti.i32, bins), ti.field(ti.i32, n)

    @ti.kernel
    def sort():
        for i in place:
            place[i] = ti.atomic_add(count[i % bins], 1)

    sort()
    for b in range(bins):
        places = place.to_numpy()[b::bins]
        assert np.array_equal(np.sort(places), np.arange(len(places)))
