"""Sparse levels on a GPU, as the emulated device runs them wherever the tests run."""

import os
import re

import numpy as np
import pytest
import tai as ti

CELLS, BLOCK = 96, 4


@pytest.fixture(autouse=True)
def emulated(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if not os.environ.get("TAI_CUDA_EMULATION"):
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(offline_cache=False)


def fetched():
    """The number of times that the host has waited for lists of active cells."""
    return ti.profiler.skips()["unchanged-lists"]["fetched"]


def make_scene(levels):
    """Fields x and y of 384 numbers, below one or two sparse levels."""
    x, y = ti.field(ti.i32), ti.field(ti.i32)
    if levels == 1:
        top = ti.root.pointer(ti.i, CELLS)
        blocks = top
    else:
        top = ti.root.pointer(ti.i, 8)
        blocks = top.bitmasked(ti.i, CELLS // 8)
    blocks.dense(ti.i, BLOCK).place(x, y)
    return x, y, top, blocks


@pytest.mark.parametrize("levels", [1, 2])
def test_a_simulation_runs_without_the_host(levels):
    x, y, top, blocks = make_scene(levels)
    n = CELLS * BLOCK

    @ti.kernel
    def scatter(t: ti.i32):
        for i in range(10):
            x[(i * 29 + t * 13) % n] += i + 1

    @ti.kernel
    def visit():
        for i in x:
            y[i] += 2 * x[i] + 1

    @ti.kernel
    def drop(t: ti.i32):
        for b in blocks:
            if b % 5 == t % 5:
                ti.deactivate(blocks, b)

    expected = np.zeros((2, CELLS, BLOCK), np.int64)
    active = np.zeros(CELLS, bool)
    for t in range(12):
        scatter(t)
        for i in range(10):
            at = (i * 29 + t * 13) % n
            expected[0].reshape(-1)[at] += i + 1
            active[at // BLOCK] = True
        for _ in range(2):
            visit()
            expected[1][active] += 2 * expected[0][active] + 1
        if t == 7:
            top.deactivate_all()
            gone = np.ones(CELLS, bool)
        else:
            drop(t)
            gone = np.arange(CELLS) % 5 == t % 5
        active &= ~gone
        expected[:, gone] = 0
    assert fetched() == 0
    assert blocks.active_cells().ravel().tolist() == np.flatnonzero(active).tolist()
    assert fetched() == 1
    assert (x.to_numpy() == expected[0].ravel()).all()
    assert (y.to_numpy() == expected[1].ravel()).all()
    assert fetched() == 1


def test_lists_grow_without_the_host():
    n = 40
    items, sums = ti.field(ti.i32), ti.field(ti.i32, shape=n)
    lists = ti.root.dense(ti.i, n).dynamic(ti.j, 64)
    lists.place(items)

    @ti.kernel
    def fill(t: ti.i32):
        for i in range(n):
            for k in range((i * 7 + t) % 12):
                items[i].append(i * 100 + t + k)

    @ti.kernel
    def add():
        for i, j in items:
            sums[i] += items[i, j]

    @ti.kernel
    def empty():
        for i in range(n):
            if i % 2 == 0:
                items[i].deactivate()

    model = [[] for _ in range(n)]
    expected = np.zeros(n, np.int64)
    for t in range(5):
        fill(t)
        for i, one in enumerate(model):
            one += [i * 100 + t + k for k in range((i * 7 + t) % 12)]
        add()
        expected += [sum(one) for one in model]
        empty()
        for one in model[::2]:
            one.clear()
    assert fetched() == 0
    assert (sums.to_numpy() == expected).all()
    assert lists.num_active == sum(map(len, model))


def test_a_kernel_goes_over_what_it_has_made_active():
    x, y, _, blocks = make_scene(1)

    @ti.kernel
    def both():
        for i in range(3):
            x[i * 50] = 1
        for i in x:
            y[i] = 1
        for i in range(2):
            ti.deactivate(blocks, i * 50 // BLOCK)
        for i in x:
            y[i] += 1

    both()
    assert fetched() == 0
    where = np.flatnonzero(y.to_numpy())
    assert where.tolist() == [100, 101, 102, 103]
    assert (y.to_numpy()[where] == 2).all()


def test_many_cells():
    # More than one block makes a list of.
    cells = 1 << 20
    x = ti.field(ti.i32)
    top = ti.root.pointer(ti.i, cells)
    top.place(x)
    total = ti.field(ti.i64, shape=())

    @ti.kernel
    def scatter(t: ti.i32):
        for i in range(1000):
            x[(i * i * 17 + t * 1237) % cells] = i + t

    @ti.kernel
    def add():
        for i in x:
            total[None] += i + ti.cast(x[i], ti.i64)

    model = {}
    expected = 0
    for t in range(3):
        scatter(t)
        # Iterations that meet leave the value of one of them: they are no matter here.
        for i in range(1000):
            model.setdefault((i * i * 17 + t * 1237) % cells, set()).add(i + t)
        add()
    assert fetched() == 0
    assert top.active_cells().ravel().tolist() == sorted(model)
    found = x.to_numpy()
    assert all(found[cell] in values for cell, values in model.items())
    total[None] = 0
    add()
    expected = sum(cell + int(found[cell]) for cell in model)
    assert total[None] == expected


def test_gradients_by_hand_know_what_the_loops_went_over():
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    blocks = ti.root.pointer(ti.i, CELLS)
    blocks.dense(ti.i, BLOCK).place(x, y, x.grad, y.grad)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def activate(first: ti.i32):
        for i in range(3):
            x[first + i * 40] += 2.0

    @ti.kernel
    def square():
        for i in x:
            loss[None] += x[i] ** 2

    activate(0)
    square()
    activate(8)
    loss.grad[None] = 1.0
    square.grad()
    found = x.grad.to_numpy()
    assert np.flatnonzero(found).tolist() == [0, 40, 80]
    assert (found[[0, 40, 80]] == 4.0).all()

    @ti.kernel
    def drop():
        for b in blocks:
            ti.deactivate(blocks, b)

    drop()
    with pytest.raises(ti.TaiRuntimeError, match="were deactivated since kernel 'square'"):
        square.grad()
    # Cells dropped before the launch do not matter.
    activate(4)
    square()
    square.grad()
    assert np.flatnonzero(x.grad.to_numpy()).tolist() == [4, 44, 84]


def test_out_of_memory_names_the_level_and_the_program_goes_on():
    ti.init(memory_limit=1 << 20, offline_cache=False)
    x = ti.field(ti.f32, name="x")
    level = ti.root.pointer(ti.i, 1 << 12)
    level.dense(ti.i, 1024).place(x)

    @ti.kernel
    def write(first: ti.i32, count: ti.i32):
        for b in range(first, first + count):
            x[1024 * b] = 1.0

    @ti.kernel
    def drop():
        for b in level:
            ti.deactivate(level, b)

    write(0, 100)
    ti.sync()
    write(100, 1000)
    with pytest.raises(ti.TaiMemoryError, match="one more cell of the 'pointer' level") as caught:
        ti.sync()
    assert "of 4.0 KiB each" in str(caught.value)
    assert "all of 1.0 MiB" in str(caught.value)
    assert "x[1024 * b] = 1.0" in str(caught.value)
    # Refused cells were not written either.
    assert level.num_active == 256
    assert np.count_nonzero(x.to_numpy()) == 256
    drop()
    write(300, 256)
    ti.sync()
    assert level.active_cells().ravel().tolist() == list(range(300, 556))
    with pytest.raises(ti.TaiMemoryError):
        x[0] = 1.0
    level.deactivate_all()
    write(0, 256)
    ti.sync()
    assert level.num_active == 256


def test_lists_have_the_same_limit():
    ti.init(memory_limit=1 << 12, offline_cache=False)
    items = ti.field(ti.i32, name="items")
    lists = ti.root.dense(ti.i, 64).dynamic(ti.j, 64)
    lists.place(items)

    @ti.kernel
    def fill():
        for i in range(64):
            for _ in range(20):
                items[i].append(i)

    fill()
    with pytest.raises(ti.TaiMemoryError, match="one more cell of the 'dynamic' level"):
        ti.sync()
    assert 0 < lists.num_active <= 1024


def test_a_tape_keeps_cells_on_the_device():
    n = CELLS * BLOCK
    x, y = ti.field(ti.f64), ti.field(ti.f64)
    blocks = ti.root.pointer(ti.i, CELLS)
    blocks.dense(ti.i, BLOCK).place(x, y, x.grad, y.grad)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    start = ti.field(ti.f64, shape=10, needs_grad=True)

    @ti.kernel
    def scatter(t: ti.i32):
        for i in range(10):
            x[(i * 29 + t * 13) % n] += start[i]

    @ti.kernel
    def square():
        for i in x:
            x[i] = x[i] ** 2

    @ti.kernel
    def drop(t: ti.i32):
        for b in blocks:
            if b % 5 == t % 5:
                ti.deactivate(blocks, b)

    @ti.kernel
    def add():
        for i in x:
            loss[None] += x[i]

    values = np.linspace(0.5, 1.1, 10)

    def model(values):
        cells = np.zeros(n)
        for t in range(4):
            for i in range(10):
                cells[(i * 29 + t * 13) % n] += values[i]
            cells = cells**2
            cells.reshape(CELLS, BLOCK)[np.arange(CELLS) % 5 == t % 5] = 0
        return cells.sum()

    start.from_numpy(values)
    tape = ti.ad.Tape(loss)
    with tape:
        for t in range(4):
            scatter(t)
            square()
            drop(t)
        add()
    expected = []
    for i in range(10):
        step = np.zeros(10)
        step[i] = 1e-6
        expected.append((model(values + step) - model(values - step)) / 2e-6)
    assert loss[None] == pytest.approx(model(values))
    np.testing.assert_allclose(start.grad.to_numpy(), expected, rtol=1e-7, atol=1e-9)


def test_a_tape_records_and_replays_without_the_host():
    """Activity changes with each launch; the host looks at it when all have run."""
    n, steps, sources = CELLS * BLOCK, 12, 10
    x, w = ti.field(ti.f64), ti.field(ti.f64, shape=sources, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    blocks = ti.root.pointer(ti.i, CELLS)
    blocks.dense(ti.i, BLOCK).place(x)
    ti.root.lazy_grad()

    @ti.kernel
    def scatter(t: ti.i32):
        for i in range(sources):
            x[(i * 29 + t * 13) % n] += w[i] * (t + 1)

    @ti.kernel
    def drop():
        for b in blocks:
            if b % 3 == 0:
                ti.deactivate(blocks, b)

    @ti.kernel
    def judge():
        for i in x:
            loss[None] += x[i] ** 2

    def run():
        for t in range(steps):
            scatter(t)
            if t == 6:
                drop()
        judge()

    def expected(weights):
        """The loss, its gradient, and which blocks are active at the end."""
        value, derivative = np.zeros(n), np.zeros((n, sources))
        active = np.zeros(CELLS, bool)
        for t in range(steps):
            for i in range(sources):
                at = (i * 29 + t * 13) % n
                value[at] += weights[i] * (t + 1)
                derivative[at, i] += t + 1
                active[at // BLOCK] = True
            if t == 6:
                gone = np.arange(CELLS) % 3 == 0
                value.reshape(CELLS, BLOCK)[gone] = 0
                derivative.reshape(CELLS, BLOCK, sources)[gone] = 0
                active[gone] = False
        return (value**2).sum(), 2 * value @ derivative, active

    def check(weights):
        total, gradient, active = expected(weights)
        assert loss[None] == pytest.approx(total, rel=1e-12)
        assert w.grad.to_numpy() == pytest.approx(gradient, rel=1e-12)
        assert blocks.active_cells().ravel().tolist() == np.flatnonzero(active).tolist()

    weights = np.linspace(0.5, 1.5, sources)
    w.from_numpy(weights)
    before = fetched()
    with ti.ad.Tape(loss) as tape:
        run()
    assert fetched() - before <= 1
    check(weights)
    for factor in (2.0, -1.0):
        blocks.deactivate_all()
        loss[None] = 0
        w.from_numpy(factor * weights)
        before = fetched()
        tape.replay()
        assert fetched() - before <= 1
        check(factor * weights)


def test_a_tape_keeps_values_without_the_host():
    """Overwritten elements of few cells are kept whether these are active or not."""
    n, steps = CELLS * BLOCK, 9
    x, w = ti.field(ti.f64), ti.field(ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    blocks = ti.root.pointer(ti.i, CELLS)
    blocks.dense(ti.i, BLOCK).place(x)
    ti.root.lazy_grad()

    @ti.kernel
    def scatter(t: ti.i32):
        for i in range(8):
            x[(i * 31 + t * 17) % n] += w[None] * (i + 1)

    @ti.kernel
    def fold():
        for i in x:
            x[i] = ti.sin(x[i]) + w[None]

    @ti.kernel
    def judge():
        for i in x:
            loss[None] += x[i] ** 2

    def run(weight):
        """The loss and its derivative."""
        value, derivative = np.zeros((2, CELLS, BLOCK))
        active = np.zeros(CELLS, bool)
        for t in range(steps):
            for i in range(8):
                at = (i * 31 + t * 17) % n
                value.reshape(-1)[at] += weight * (i + 1)
                derivative.reshape(-1)[at] += i + 1
                active[at // BLOCK] = True
            derivative[active] = np.cos(value[active]) * derivative[active] + 1
            value[active] = np.sin(value[active]) + weight
            if t == 4:
                value[:], derivative[:], active[:] = 0, 0, False
        return (value**2).sum(), 2 * (value * derivative).sum()

    w[None] = 0.3
    before = fetched()
    with ti.ad.Tape(loss) as tape:
        for t in range(steps):
            scatter(t)
            fold()
            if t == 4:
                blocks.deactivate_all()
        judge()
    waits = fetched() - before
    assert (loss[None], w.grad[None]) == pytest.approx(run(0.3), rel=1e-11)
    assert waits <= 2
    for weight in (0.7, -0.2, 0.4):
        blocks.deactivate_all()
        loss[None], w[None] = 0, weight
        before = fetched()
        tape.replay()
        assert fetched() - before <= 2
        assert (loss[None], w.grad[None]) == pytest.approx(run(weight), rel=1e-11)
    # The work of a replay is the same again, bits that go back included.
    assert re.search(r"run [34] times, [23] of them with new parameters", tape.explain())
