"""Minima and maxima that a loop chooses by several conditions."""

import numpy as np
import pytest
import tai as ti

from shared_loops import GROUPS, refused, same
from shared_loops import data as data
from shared_loops import mode as mode


def test_extrema_under_conditions(data):
    """A choice between the element and a number, by a comparison and other conditions."""
    x, n, g = data.x, data.n, data.g
    h, y = ti.field(ti.f32, GROUPS), ti.field(ti.f32, GROUPS)
    pair = ti.types.struct(low=ti.f32, high=ti.f32)
    vectors, records = ti.Vector.field(2, ti.f32, GROUPS), pair.field(shape=GROUPS)
    y.fill(2.0)

    @ti.func
    def least(old, value, holds):
        found = old
        if holds and value < found:
            found = value
        return found

    @ti.kernel
    def by_expressions(most: ti.types.ndarray(ti.f32, 1)):
        for i in x:
            c = g[i]
            h[c] = x[i] if (n[i] > 0 and x[i] < h[c]) else h[c]
            v = vectors[c]
            vectors[c][1] = x[i] if (n[i] > 0) & (v[1] > x[i]) else v[1]
            r = records[c].low
            records[c].low = r if not (n[i] > 0 and x[i] <= r) else x[i]
            records[c].high = ti.select(n[i] <= 0 or records[c].high >= x[i], records[c].high, x[i])
            most[c] = x[i] if (x[i] > most[c] and n[i] > 0 and y[c] > 1) else most[c]

    @ti.kernel
    def by_branches(most: ti.types.ndarray(ti.f32, 1)):
        for i in x:
            c = g[i]
            h[c] = least(h[c], x[i], n[i] > 0)
            if (n[i] > 50 and x[i] < vectors[c][1]) or (n[i] > 0 and vectors[c][1] >= x[i]):
                vectors[c][1] = x[i]
            if not (n[i] <= 0 or x[i] >= records[c].low):
                records[c].low = x[i]
            if records[c].high < x[i]:
                if n[i] > 0:
                    records[c].high = ti.max(x[i], records[c].high)
            known = most[c]
            if n[i] > 0:
                known = x[i] if x[i] > known and n[i] > 0 else known
            most[c] = known

    @ti.kernel
    def of_variables() -> ti.types.vector(3, ti.f32):
        m, k, least_group = 9.0, -9000, GROUPS
        for i in x:
            m = x[i] if (n[i] > 0 and x[i] < m) else m
            k = n[i] if (n[i] > k and g[i] == 3) else k
            if g[i] < least_group and x[i] > 0 and n[i] > 0:
                least_group = g[i]
        return ti.Vector([m, ti.cast(k, ti.f32), ti.cast(least_group, ti.f32)])

    taken = data.whole > 0
    low, high = np.full(GROUPS, 9.0), np.full(GROUPS, -9.0)
    np.minimum.at(low, data.groups[taken], data.numbers[taken].astype(np.float64))
    np.maximum.at(high, data.groups[taken], data.numbers[taken].astype(np.float64))
    for kernel in (by_expressions, by_branches):
        for _ in range(3):
            h.fill(9.0)
            vectors.fill(9.0)
            records.low.fill(9.0)
            records.high.fill(-9.0)
            most = np.full(GROUPS, -9.0, np.float32)
            kernel(most)
            np.testing.assert_array_equal(h.to_numpy(), low)
            np.testing.assert_array_equal(vectors.to_numpy()[:, 1], low)
            np.testing.assert_array_equal(records.low.to_numpy(), low)
            np.testing.assert_array_equal(records.high.to_numpy(), high)
            np.testing.assert_array_equal(most, high)
    most = data.whole[data.groups == 3].max()
    group = data.groups[(data.numbers > 0) & taken].min()
    same(of_variables, [data.numbers[taken].min(), most, group])


def test_gradients_of_extrema_under_conditions(mode):
    """The gradient goes to the number that remains, or to the value from before."""
    x = ti.field(ti.f64, 4099, needs_grad=True)
    h = ti.field(ti.f64, GROUPS, needs_grad=True)
    n, g = ti.field(ti.i32, 4099), ti.field(ti.i32, 4099)
    loss = ti.field(ti.f64, (), needs_grad=True)
    rng = np.random.default_rng(3)
    numbers = rng.standard_normal(4099)
    whole, groups = rng.integers(-9, 9, 4099), rng.integers(0, GROUPS, 4099)
    x.from_numpy(numbers)
    n.from_numpy(whole.astype(np.int32))
    g.from_numpy(groups.astype(np.int32))

    @ti.kernel
    def expression():
        for i in x:
            h[g[i]] = x[i] if (n[i] > 0 and x[i] < h[g[i]]) else h[g[i]]

    @ti.kernel
    def branch():
        for i in x:
            if not (n[i] <= 0 or h[g[i]] <= x[i]):
                h[g[i]] = x[i]

    @ti.kernel
    def total():
        for j in h:
            loss[None] += h[j] * (j + 1)

    first = -2.0
    expected, left = np.zeros(4099), np.zeros(GROUPS)
    for j in range(GROUPS):
        candidates = np.flatnonzero((whole > 0) & (groups == j) & (numbers < first))
        if len(candidates):
            expected[candidates[np.argmin(numbers[candidates])]] = j + 1
        else:
            left[j] = j + 1
    assert expected.any() and left.any()
    for kernel in (expression, branch):
        h.fill(first)
        with ti.ad.Tape(loss):
            kernel()
            total()
        np.testing.assert_array_equal(x.grad.to_numpy(), expected)
        np.testing.assert_array_equal(h.grad.to_numpy(), left)


def test_choices_that_are_no_extrema_are_found(mode):
    """Races that are certain are refused."""
    x, o, n = ti.field(ti.f32, 1000), ti.field(ti.f32, ()), ti.field(ti.i32, 1000)

    @ti.kernel
    def whatever_it_was():
        for i in x:
            o[None] = x[i] if (n[i] > 5 or x[i] < o[None]) else o[None]

    @ti.kernel
    def compared_with_another_number():
        for i in x:
            if n[i] > 0 and 2 * x[i] < o[None]:
                o[None] = x[i]

    @ti.kernel
    def bounded_count():
        for i in x:
            if o[None] < 5 and n[i] > 0:
                o[None] = o[None] + 1

    for kernel in (whatever_it_was, compared_with_another_number, bounded_count):
        refused(kernel, "o[None] = ")


@pytest.mark.parametrize("arch", ["cpu", "device"])
def test_choices_that_are_no_extrema_at_data_are_found_when_they_run(arch, monkeypatch):
    if arch == "device":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(arch=ti.cuda if arch == "device" else ti.cpu, cpu_max_num_threads=2, validation=True)
    monkeypatch.undo()
    x, h = ti.field(ti.f32, 1000), ti.field(ti.f32, GROUPS)
    n, g = ti.field(ti.i32, 1000), ti.field(ti.i32, 1000)
    x.from_numpy(np.linspace(1, -1, 1000, dtype=np.float32))
    n.fill(1)

    @ti.kernel
    def whatever_it_was():
        for i in x:
            h[g[i]] = x[i] if (n[i] > 5 or x[i] < h[g[i]]) else h[g[i]]

    @ti.kernel
    def bounded_count():
        for i in x:
            if h[g[i]] < 5 and n[i] > 0:
                h[g[i]] = h[g[i]] + 1

    @ti.kernel
    def least():
        for i in x:
            h[g[i]] = x[i] if (n[i] > 0 and x[i] < h[g[i]]) else h[g[i]]

    for kernel in (whatever_it_was, bounded_count):
        h.fill(3)
        with pytest.raises(ti.TaiAssertionError, match="two iterations of a parallel loop"):
            kernel()
            ti.sync()
    h.fill(3)
    least()
    assert h.to_numpy()[0] == -1
