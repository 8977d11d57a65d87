"""Ctrl-C in the middle of fills and copies: they stop before their end, and all stays usable.

One thread goes from the first element to the last, so that the last one shows whether the copy was
stopped.
"""

import signal

import numpy as np
import pytest
import tai as ti

from interrupts import check_usable

# 1 GB of f32, which takes far longer than the 20 ms between the ticks of safepoints.
SIZE = 1 << 28


@pytest.fixture
def field():
    ti.init(default_fp=ti.f32, offline_cache=False, cpu_max_num_threads=1)
    x = ti.field(ti.f32, shape=SIZE, needs_grad=True)
    x.fill(1.0)
    return x


def interrupt(work):
    """Runs `work`, to which a signal comes once it has begun; says whether that ended it."""

    def stop(*_):
        raise KeyboardInterrupt

    former = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.005)
        work()
    except KeyboardInterrupt:
        return True
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
    return False


def writes(x):
    twos = np.full(SIZE, 2.0, np.float32)
    return {"fill": lambda: x.fill(2.0), "from_numpy": lambda: x.from_numpy(twos)}


@pytest.mark.parametrize("form", ["fill", "from_numpy"])
@pytest.mark.parametrize("taped", [False, True])
def test_a_write_stops_before_its_end(field, form, taped):
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    write = writes(field)[form]

    @ti.kernel
    def head():
        for i in range(4):
            loss[None] += field[i] * field[i]

    def work():
        if not taped:
            return write()
        with ti.ad.Tape(loss):
            head()
            write()

    head()
    assert interrupt(work)
    assert field[0] in (1.0, 2.0) and field[SIZE - 1] == 1.0
    write()
    assert field[0] == field[SIZE // 2] == field[SIZE - 1] == 2.0
    loss[None] = 0.0
    with ti.ad.Tape(loss):
        head()
    assert loss[None] == 16.0 and field.grad[0] == field.grad[3] == 4.0
    check_usable()


def test_a_read_is_interrupted(field):
    assert interrupt(field.to_numpy)
    array = field.to_numpy()
    assert array[0] == array[-1] == 1.0
    check_usable()


def tape_of_many_values(x):
    """A tape whose sweep puts all of `x` back; it has not been swept."""
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def head():
        for i in x:
            loss[None] += x[i] * x[i]

    @ti.kernel
    def change():
        for i in x:
            x[i] = 3.0 * x[i]

    tape = ti.ad.Tape(loss)
    return tape, head, change, loss


@pytest.fixture
def middle():
    """A field of 128 MB."""
    ti.init(default_fp=ti.f32, offline_cache=False, cpu_max_num_threads=1)
    x = ti.field(ti.f32, shape=1 << 25, needs_grad=True)
    x.fill(1.0)
    return x


def test_values_that_a_sweep_puts_back(middle, monkeypatch):
    """The sweep stops, and the field holds its last values again."""
    x = middle
    tape, head, change, loss = tape_of_many_values(x)
    with tape:
        head()
        change()
    assert x[0] == x[x.shape[0] - 1] == 3.0
    kept = x.grad[5]
    assert interrupt(tape.grad)
    assert x[0] == x[x.shape[0] // 2] == x[x.shape[0] - 1] == 3.0
    tape.grad()
    assert x.grad[5] == kept == 2.0
    assert x[0] == x[x.shape[0] - 1] == 3.0
    check_usable()


@pytest.mark.parametrize("form", ["fill", "from_numpy"])
def test_a_sparse_field(form):
    ti.init(default_fp=ti.f32, offline_cache=False, cpu_max_num_threads=1)
    x = ti.field(ti.f32)
    size = 1 << 28
    ti.root.pointer(ti.i, size >> 12).dense(ti.i, 1 << 12).place(x)

    @ti.kernel
    def activate():
        for i in range(size >> 12):
            x[i << 12] = 1.0

    activate()
    x.fill(1.0)
    twos = np.full(size, 2.0, np.float32)
    write = {"fill": lambda: x.fill(2.0), "from_numpy": lambda: x.from_numpy(twos)}[form]
    assert interrupt(write)
    assert x[size - 1] in (1.0, 2.0)
    write()
    assert x[0] == x[size // 2] == x[size - 1] == 2.0
    check_usable()


@pytest.fixture
def device(monkeypatch):
    """A field of 512 MB on the emulated device, which holds it; one of its neighbours is not
    dense."""
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(arch=ti.cuda, default_fp=ti.f32, offline_cache=False)
    x = ti.field(ti.f32, shape=SIZE // 2)

    @ti.kernel
    def set_all(value: ti.f32):
        for i in range(64):
            x[i * (SIZE // 128)] = value

    x.fill(1.0)
    set_all(1.0)
    ti.sync()
    return x


def test_copies_to_a_device(device):
    x = device
    twos = np.full(SIZE // 2, 2.0, np.float32)
    assert interrupt(lambda: x.from_numpy(twos))
    # How far the copy came depends on the machine's load.
    assert x[SIZE // 2 - 1] in (1.0, 2.0)
    x.from_numpy(twos)
    assert x[0] == x[SIZE // 2 - 1] == 2.0
    check_usable()


def test_copies_from_a_device(device):
    assert interrupt(device.to_numpy)
    array = device.to_numpy()
    assert array[0] == array[-1] == 1.0
    check_usable()


def test_a_handler_that_destroys_the_tree(field):
    """The memory stays until the copy has ended."""
    tree = ti.FieldsBuilder()
    y = ti.field(ti.f32)
    tree.dense(ti.i, SIZE).place(y)
    made = tree.finalize()
    y.fill(1.0)
    ran = []

    def destroy(*_):
        if not ran:
            ran.append(True)
            made.destroy()

    former = signal.signal(signal.SIGALRM, destroy)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.005)
        y.fill(2.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
    assert ran
    assert field[SIZE - 1] == 1.0
    check_usable()
