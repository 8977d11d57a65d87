"""Programs on a GPU, as the emulated device runs them wherever the tests run."""

import os
import subprocess
import sys

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def emulated(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if not os.environ.get("TAI_CUDA_EMULATION"):
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(offline_cache=False)


def run(tmp_path, text):
    """The output of a program, and its errors."""
    program = tmp_path / "program.py"
    program.write_text("import tai as ti\n" + text)
    done = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines(), done.stderr.splitlines()


def test_what_kernels_print_appears_when_someone_waits(tmp_path):
    out, _ = run(
        tmp_path,
        "ti.init(offline_cache=False)\n"
        "@ti.kernel\n"
        "def say():\n"
        "    for i in range(1):\n"
        "        print('there', i)\n"
        "say()\n"
        "ti.sync()\n"
        "print('here', flush=True)\n"
        "say()\n",
    )
    assert out == ["there 0", "here", "there 0"]


def test_failures_say_where():
    ti.init(offline_cache=False, debug=True)
    x = ti.field(ti.f32, shape=4)

    @ti.kernel
    def store(i: ti.i32):
        for _ in range(1):
            x[i] = 1

    with pytest.raises(ti.TaiAssertionError, match=r"index \[7\] is out of range") as caught:
        store(7)
    assert "x[i] = 1" in str(caught.value)
    store(3)
    assert x[3] == 1


@pytest.mark.parametrize("shared", [False, True])
def test_host_and_kernels_take_turns(shared):
    n = 3000
    x, y = ti.field(ti.f64), ti.Vector.field(2, ti.f32)
    if shared:
        ti.root.dense(ti.i, n).place(x, y)
    else:
        ti.root.dense(ti.i, n).place(x)
        ti.root.dense(ti.i, n).place(y)

    @ti.kernel
    def step():
        for i in x:
            x[i] += i
            y[i][1] += 1.0

    step()
    x[5] = 0.5
    y.fill(2.0)
    step()
    assert x[5] == 5.5
    assert x[6] == 12.0
    np.testing.assert_array_equal(y.to_numpy(), np.tile([2.0, 3.0], (n, 1)))
    values = np.linspace(0, 1, n)
    x.from_numpy(values)
    step()
    np.testing.assert_array_equal(x.to_numpy(), values + np.arange(n))
    assert y[n - 1][1] == 4.0


def test_arrays_of_numpy():
    @ti.kernel
    def double(a: ti.types.ndarray(), b: ti.types.ndarray()):
        for i in range(a.shape[0]):
            b[i] = 2 * a[i]

    a, b = np.arange(10.0), np.zeros(10)
    double(a, b)
    np.testing.assert_array_equal(b, 2 * a)


def test_overwritten_values_come_back_for_the_gradient():
    n, steps = 50, 6
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    start = ti.field(ti.f64, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def begin():
        for i in x:
            x[i] = start[i]

    @ti.kernel
    def step():
        for i in x:
            x[i] = x[i] * x[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    values = np.linspace(0.9, 1.02, n)
    start.from_numpy(values)
    for _ in range(4):
        with ti.ad.Tape(loss):
            begin()
            for _ in range(steps):
                step()
            total()
        np.testing.assert_allclose(loss[None], np.sum(values ** (2**steps)), rtol=1e-12)
        expected = 2**steps * values ** (2**steps - 1)
        np.testing.assert_allclose(start.grad.to_numpy(), expected, rtol=1e-10)


@pytest.mark.parametrize("shape", [(3, 40), (40, 3), (5, 3, 8)])
def test_slabs_come_back_for_the_gradient(shape):
    # A state that a launch overwrites at the position along one dimension that it is given.
    axis = shape.index(3)
    x = ti.field(ti.f64, shape=shape, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def square_2d_first(t: ti.i32):
        for i in range(shape[1]):
            x[t, i] = x[t, i] ** 2 + x[0, i]

    @ti.kernel
    def square_2d_last(t: ti.i32):
        for i in range(shape[0]):
            x[i, t] = x[i, t] ** 2 + x[i, 0]

    @ti.kernel
    def square_3d(t: ti.i32):
        for i, j in ti.ndrange(shape[0], shape[-1]):
            x[i, t, j] = x[i, t, j] ** 2 + x[i, 0, j]

    @ti.kernel
    def total():
        for I in ti.grouped(x):
            loss[None] += x[I]

    square = square_3d if len(shape) == 3 else (square_2d_last if axis else square_2d_first)
    values = np.random.default_rng(0).uniform(0.1, 0.7, shape)
    x.from_numpy(values)
    start = np.moveaxis(values, axis, 0)
    with ti.ad.Tape(loss):
        square(1)
        square(2)
        square(1)
        total()
    a, b, c = start
    b1 = b**2 + a
    np.testing.assert_allclose(loss[None], np.sum(a + (b1**2 + a) + (c**2 + a)), rtol=1e-12)
    expected = np.moveaxis(np.stack([1 + (2 * b1 + 1) + 1, 2 * b1 * 2 * b, 2 * c]), 0, axis)
    # The launches overwrite their own inputs: adjoints end there.
    found = x.grad.to_numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_out_of_memory_names_the_trees():
    ti.init(offline_cache=False, device_memory_limit=100_000)
    small = ti.field(ti.f64, shape=1000)

    @ti.kernel
    def first():
        for i in small:
            small[i] = i

    first()
    large = ti.field(ti.f64, shape=100_000)

    @ti.kernel
    def second():
        for i in large:
            large[i] = i

    with pytest.raises(ti.TaiMemoryError, match=r"out of memory on the device .* needs 781\.2 KiB"):
        second()
    assert small[10] == 10


def test_a_fill_stays_in_its_field():
    """Fields whose blocks alternate in memory: a fill reaches all blocks, and no other field."""
    first, second = ti.field(ti.f32), ti.field(ti.f32)
    blocks = ti.root.dense(ti.i, 3)
    blocks.dense(ti.jk, (4, 5)).place(first)
    blocks.dense(ti.jk, (4, 5)).place(second)

    @ti.kernel
    def count():
        for i, j, k in first:
            first[i, j, k] = 20 * i + 5 * j + k
            second[i, j, k] = -1.0

    numbers = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    count()
    second.fill(7.0)
    assert (first.to_numpy() == numbers).all()
    assert (second.to_numpy() == 7.0).all()
    count()
    first.fill(0.0)
    assert (first.to_numpy() == 0.0).all()
    assert (second.to_numpy() == -1.0).all()


@pytest.mark.parametrize("order", ["up", "down", "apart"])
@pytest.mark.parametrize("values", [(0.0, 0.0, 0.0), (3.0, 3.0, 3.0), (1.0, 2.0, 2.0)])
def test_fills_side_by_side(order, values):
    """Fills of fields that share cells may become one; each element has its own field's value."""
    a, b, c = ti.Vector.field(2, ti.f32), ti.field(ti.f32), ti.field(ti.f32)
    kept = ti.field(ti.f32)
    ti.root.dense(ti.i, 6).place(a, b, c, kept)

    @ti.kernel
    def count():
        for i in b:
            a[i] = ti.Vector([i, -i])
            b[i] = 10.0 * i
            c[i] = 100.0 * i
            kept[i] = 1000.0 * i

    @ti.kernel
    def total() -> ti.f32:
        s = 0.0
        for i in b:
            s += a[i].sum() + b[i] + c[i] + kept[i]
        return s

    fields = {"up": "abc", "down": "cba", "apart": "acb"}[order]
    held = dict(zip("abc", values))
    for _ in range(2):
        count()
        for name in fields:
            {"a": a, "b": b, "c": c}[name].fill(held[name])
        c[2] = 5.0
        kept[3] = 6.0
        expected = 6 * (2 * held["a"] + held["b"] + held["c"]) - held["c"] + 5
        assert total() == expected + 12000.0 + 6.0
        assert (a.to_numpy() == held["a"]).all() and (b.to_numpy() == held["b"]).all()
        c.fill(held["c"])
        c.fill(-1.0)
        assert (c.to_numpy() == -1.0).all()


def test_clears_side_by_side_are_part_of_the_sequence():
    """The clears before a replay, and those of its gradients, are one step for adjacent memory."""
    x = ti.field(ti.f32, shape=8, needs_grad=True)
    momentum, mass, rest = ti.Vector.field(2, ti.f32), ti.field(ti.f32), ti.field(ti.f32)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    ti.root.dense(ti.i, 8).place(momentum, mass, rest)
    ti.root.lazy_grad()

    @ti.kernel
    def scatter():
        for i in x:
            momentum[i // 2] += x[i] * ti.Vector([1.0, 2.0])
            mass[i // 2] += 1.0

    @ti.kernel
    def collect():
        for i in mass:
            loss[None] += momentum[i][0] * momentum[i][1] + rest[i]

    def clear():
        momentum.fill(0.0)
        mass.fill(0.0)
        rest.fill(0.0)

    clear()
    x.from_numpy(np.arange(8, dtype=np.float32))
    with ti.ad.Tape(loss) as tape:
        scatter()
        collect()
    for round in range(5):
        x[3] = round
        clear()
        loss[None] = 0.0
        tape.replay()
        pairs = x.to_numpy().reshape(4, 2).sum(axis=1)
        assert loss[None] == 2 * (pairs**2).sum()
        assert (x.grad.to_numpy() == np.repeat(4 * pairs, 2)).all()
        assert (rest.grad.to_numpy() == [1.0] * 8).all()
    # All of the cells at once, two losses (the tape clears its own), five gradients at most.
    steps = [int(line.split()[0]) for line in tape.explain().splitlines() if " steps, run" in line]
    assert steps and max(steps) <= 4 + 1 + 2 + 5


def power_kernels():
    """Kernels whose gradients record a number for each of `n` trips."""
    c = ti.field(ti.f64, shape=(), needs_grad=True)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    y = ti.field(ti.f64, shape=3, needs_grad=True)

    @ti.kernel
    def counted(n: ti.i32):
        for i in x:
            value = x[i]
            for _ in range(n):
                value *= c[None]
            y[i] = value

    @ti.kernel
    def leaving(n: ti.i32):
        for i in x:
            value = x[i]
            j = 0
            while True:
                if j >= n:
                    break
                value *= c[None]
                j += 1
            y[i] = value

    return c, x, y, {"counted": counted, "leaving": leaving}


@pytest.mark.parametrize("name", ["counted", "leaving"])
def test_a_gradient_that_finds_no_memory_on_the_device(name):
    """The heap of the emulated device; that of a GPU can be set once for a process."""
    if os.environ.get("TAI_CUDA_EMULATION") != "1":
        pytest.skip("takes the heap of the emulated device")
    ti.init(offline_cache=False, device_heap_memory=8192)
    c, x, y, kernels = power_kernels()
    kernel = kernels[name]
    c[None] = 1.0
    x.fill(2.0)

    def gradient(trips):
        for field in (c, x):
            field.grad.fill(0.0)
        y.grad.fill(1.0)
        kernel.grad(trips)
        ti.sync()
        return c.grad[None], x.grad[0]

    assert gradient(100) == (600.0, 1.0)
    for _ in range(2):
        with pytest.raises(ti.TaiMemoryError, match=f"kernel '{name}_grad' records") as caught:
            gradient(5000)
        message = str(caught.value)
        assert "KiB of values" in message and "device_heap_memory" in message
        assert "test_devices.py:" in message
        # The program goes on, and its memory has been given back.
        assert gradient(200) == (1200.0, 1.0)
    # A loop without iterations allocates nothing.
    assert gradient(0) == (0.0, 1.0)


def test_sums_of_a_gradient_that_finds_no_memory():
    """A sum over a block comes behind the memory that one of its threads is not given."""
    if os.environ.get("TAI_CUDA_EMULATION") != "1":
        pytest.skip("takes the heap of the emulated device")
    ti.init(offline_cache=False, device_heap_memory=4096)
    a = ti.field(ti.f64, shape=(), needs_grad=True)
    n = ti.field(ti.i32, shape=64)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in n:
            value = 1.0
            for _ in range(n[i]):
                value = value * a[None] + 0.5 * value * value
            loss[None] += value

    a[None] = 0.25
    n.fill(8)
    loss.grad[None] = 1.0
    total.grad()
    first = a.grad[None]
    assert first != 0
    n[17] = 100_000
    with pytest.raises(ti.TaiMemoryError, match="kernel 'total_grad'"):
        total.grad()
        ti.sync()
    n[17] = 8
    a.grad[None] = 0
    total.grad()
    assert a.grad[None] == pytest.approx(first, rel=1e-12)


def test_the_gradient_of_a_kernel_may_have_nothing_to_do():
    given = ti.ndarray(ti.f32, 4, needs_grad=True)
    tmp = ti.field(ti.f32, shape=4)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    given.fill(3)

    @ti.kernel
    def keep(a: ti.types.ndarray()):
        for i in tmp:
            tmp[i] = ti.stop_grad(a[i])

    @ti.kernel
    def total(a: ti.types.ndarray()):
        for i in tmp:
            loss[None] += tmp[i] * a[i]

    with ti.ad.Tape(loss):
        keep(given)
        total(given)
    assert loss[None] == 36
    assert list(given.grad.to_numpy()) == [3] * 4
