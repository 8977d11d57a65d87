"""Sums that all iterations of a loop update, and that the loop reads: a total so far."""

import numpy as np
import pytest
import tai as ti

MESSAGE = "is read here by one iteration of a parallel loop, while another one updates it"


def data(n=64):
    x, y = ti.field(ti.i32, n, name="x"), ti.field(ti.i32, n, name="y")
    x.from_numpy(np.random.default_rng(n).integers(0, 9, n).astype(np.int32))
    return x, y, ti.field(ti.i32, (), name="s")


def of_a_variable():
    x, y, _ = data()

    @ti.kernel
    def run():
        c = 0
        for i in x:
            c += x[i]
            y[i] = c

    return run


def of_a_field():
    x, y, s = data()

    @ti.kernel
    def run():
        for i in x:
            s[None] += x[i]
            y[i] = 2 * s[None] - 1

    return run


def before_its_update():
    x, y, s = data()

    @ti.kernel
    def run():
        for i in x:
            y[i] = s[None]
            ti.atomic_sub(s[None], x[i])

    return run


def as_an_index():
    x, y, s = data()

    @ti.kernel
    def run():
        for i in x:
            if x[i] > 3:
                s[None] += 1
                y[s[None] - 1] = i

    return run


def through_a_loop_and_a_branch():
    x, y, s = data()

    @ti.kernel
    def run():
        for i in x:
            s[None] += x[i]
            t = 0
            for j in range(3):
                if x[i] > j:
                    t += s[None]
            y[i] = t

    return run


def of_rows():
    x, y, s = data()
    z = ti.field(ti.i32, (8, 8))

    @ti.kernel
    def run():
        for i, j in z:
            y[i] += x[j]
            z[i, j] = y[i]

    return run


def of_an_array():
    x, y, s = data()
    a = np.zeros(1, np.int32)

    @ti.kernel
    def with_array(a: ti.types.ndarray(ndim=1)):
        for i in x:
            a[0] += x[i]
            y[i] = a[0]

    return lambda: with_array(a)


@pytest.mark.parametrize(
    "make",
    [of_a_variable, of_a_field, before_its_update, as_an_index, through_a_loop_and_a_branch,
     of_rows, of_an_array],
    ids=lambda make: make.__name__,
)  # fmt: skip
def test_total_so_far_is_refused(make):
    ti.init()
    with pytest.raises(ti.TaiTypeError, match=MESSAGE) as caught:
        make()()
    assert "use the value that the update returns" in str(caught.value)


@pytest.mark.parametrize("n", [1, 7, 65_537])
def test_total_so_far_on_one_thread(n):
    ti.init()
    x, y, s = data(n)

    @ti.kernel
    def run():
        ti.loop_config(serialize=True)
        for i in x:
            s[None] += x[i]
            y[i] = s[None]

    run()
    assert y.to_numpy().tolist() == np.cumsum(x.to_numpy()).tolist()


@pytest.mark.parametrize("n", [1, 7, 65_537])
def test_totals_that_are_right_beside_reads(n):
    ti.init()
    x, y, s = data(n)
    most = ti.field(ti.i32, ())
    rows = ti.field(ti.i32, n)

    @ti.kernel
    def run():
        for i in x:
            if x[i] > 3:
                j = ti.atomic_add(s[None], 1)
                y[j] = i
            most[None] = ti.max(most[None], x[i])
        for i in x:
            rows[i] += x[i]
            rows[i] += rows[i] + s[None]

    run()
    values = x.to_numpy()
    found = np.nonzero(values > 3)[0]
    assert s[None] == len(found) and most[None] == values.max()
    assert sorted(y.to_numpy()[: len(found)].tolist()) == found.tolist()
    assert rows.to_numpy().tolist() == (2 * values + len(found)).tolist()


@pytest.mark.parametrize("n", [3, 65_537])
def test_total_so_far_that_only_saves_work(n):
    ti.init()
    x, y, s = data(n)

    @ti.kernel
    def run() -> ti.i32:
        for _ in x:
            if s[None] < 2:
                j = ti.atomic_add(s[None], 1)
                if j < 2:
                    y[j] = 1
        return y[0] + y[1]

    assert run() == 2
