"""Ctrl-C in the middle of fills and copies: they stop before their end, and all stays usable.

One thread goes from the first element to the last, so that the last one shows whether the copy was
stopped.
"""

import signal

import numpy as np
import pytest
import tai as ti

from interrupts import check_usable, interrupt, is_on_gpu

# 1 GB of f32, which takes far longer than the 20 ms between the ticks of safepoints.
SIZE = 1 << 28


@pytest.fixture
def field():
    ti.init(default_fp=ti.f32, offline_cache=False, cpu_max_num_threads=1)
    x = ti.field(ti.f32, shape=SIZE, needs_grad=True)
    x.fill(1.0)
    return x


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


def start(arch, monkeypatch):
    """The CPU with one thread, or the emulated device."""
    if arch == "emulated":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
        ti.init(arch=ti.cuda, default_fp=ti.f32, offline_cache=False)
    else:
        ti.init(default_fp=ti.f32, offline_cache=False, cpu_max_num_threads=1)


def make_field(layout, size):
    """A field with a gradient, whose elements are beside each other, apart, or in blocks."""
    x = ti.field(ti.f32, needs_grad=True)
    if layout == "blocks":
        ti.root.dense(ti.i, size // 1024).dense(ti.i, 32).dense(ti.i, 32).place(x)
    elif layout == "apart":
        ti.root.dense(ti.i, size).place(x, ti.field(ti.i32))
    elif layout == "sparse":
        ti.root.pointer(ti.i, size // 4096).dense(ti.i, 4096).place(x, x.grad)
    else:
        ti.root.dense(ti.i, size).place(x)
    if x.grad.level is None:
        ti.root.dense(ti.i, size).place(x.grad)
    return x


SWEEPS = [
    *(("cpu", layout, snapshots) for layout in ("dense", "sparse") for snapshots in (0, 1, 2)),
    *(("emulated", layout, 0) for layout in ("dense", "apart", "blocks", "sparse")),
    ("emulated", "dense", 2), ("emulated", "blocks", 1), ("emulated", "sparse", 2),
]  # fmt: skip


@pytest.mark.parametrize(("arch", "layout", "snapshots"), SWEEPS)
def test_a_sweep_leaves_the_last_values(arch, layout, snapshots, monkeypatch):
    """Wherever it is interrupted; also in a later sweep, which runs the launches again."""
    start(arch, monkeypatch)
    size, rounds = 1 << 20, 4
    options = {"checkpoint": snapshots} if snapshots else {}
    x = make_field(layout, size)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def begin():
        for i in range(size):
            x[i] = 1.0 + i % 2

    @ti.kernel
    def square():
        for i in range(size):
            x[i] = 0.5 * x[i] * x[i]

    @ti.kernel
    def total():
        for i in range(size):
            loss[None] += x[i]

    begin()
    tape = ti.ad.Tape(loss, **options)
    with tape:
        for _ in range(rounds):
            square()
        total()
    last, gradient = x.to_numpy(), x.grad.to_numpy()
    assert last[1] == 2.0 and gradient[1] == 2.0**rounds
    interrupted = 0
    for milliseconds in (1, 3, 8, 20, 45, 90, 150):
        interrupted += interrupt(tape.grad, milliseconds / 1000)
        assert np.array_equal(x.to_numpy(), last), milliseconds
    # The sweeps of a GPU are over before the first signal comes.
    assert interrupted or is_on_gpu()
    x.grad.fill(0.0)
    tape.grad()
    assert np.array_equal(x.grad.to_numpy(), gradient)
    begin()
    tape.replay()
    assert np.array_equal(x.to_numpy(), last)
    assert np.array_equal(x.grad.to_numpy(), gradient)
    check_usable()


@pytest.mark.parametrize("layout", ["blocks", "sparse"])
def test_a_tree_on_its_way_from_and_to_a_device(layout, monkeypatch):
    """The copy that is read stays the current one."""
    start("emulated", monkeypatch)
    size = 1 << 25
    x = make_field(layout, size)

    @ti.kernel
    def write(value: ti.f32):
        for i in range(size // 4096):
            x[i * 4096] = value

    write(3.0)
    interrupted = 0
    for milliseconds in (1, 2, 4, 8, 16):
        interrupted += interrupt(x.to_numpy, milliseconds / 1000)
        write(3.0)
    assert interrupted
    array = x.to_numpy()
    assert array[0] == array[size - 4096] == 3.0 and array[1] == 0.0
    for milliseconds in (1, 2, 4, 8, 16):
        x[4096] = 5.0
        array = x.to_numpy()
        interrupt(lambda: write(4.0), milliseconds / 1000)
        assert x[0] in (3.0, 4.0) and x[4097] == 0.0
    write(4.0)
    assert x[0] == x[4096] == x[size - 4096] == 4.0
    check_usable()


def test_an_array_on_its_way_to_a_device(monkeypatch):
    start("emulated", monkeypatch)
    a = np.ones(1 << 27, np.float32)

    @ti.kernel
    def double(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(4):
            a[i] = 2.0 * a[i]

    double(a)
    assert a[0] == 2.0
    assert interrupt(lambda: double(a))
    assert a[0] in (2.0, 4.0) and a[-1] == 1.0
    a[:4] = 1.0
    double(a)
    assert a[:5].tolist() == [2.0, 2.0, 2.0, 2.0, 1.0]
    check_usable()


def test_gradients_on_their_way_to_zero(field):
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def head():
        for i in range(4):
            loss[None] += field[i] * field[i]

    with ti.ad.Tape(loss) as tape:
        head()
    field.grad.fill(7.0)
    assert interrupt(tape.replay)
    tape.replay()
    assert field.grad[0] == 2.0 and field.grad[4] == field.grad[SIZE - 1] == 0.0
    # A tape that is interrupted at its beginning is none.
    field.grad.fill(7.0)
    ran = []

    def begin():
        with ti.ad.Tape(loss):
            ran.append(True)
            head()

    assert interrupt(begin) and not ran
    begin()
    assert field.grad[0] == 2.0 and field.grad[SIZE - 1] == 0.0
    check_usable()


def test_a_replay_that_does_not_reach_its_end(middle):
    """There is nothing to sweep: the fields hold neither the old values nor the new ones."""
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def square():
        for i in middle:
            middle[i] = middle[i] * middle[i]

    @ti.kernel
    def head():
        for i in range(4):
            loss[None] += middle[i]

    with ti.ad.Tape(loss) as tape:
        square()
        square()
        head()
    middle.fill(1.0)
    assert interrupt(lambda: tape.replay(backward=False))
    with pytest.raises(ti.TaiRuntimeError, match="did not reach its end.*replay it again"):
        tape.grad()
    middle.fill(2.0)
    tape.replay()
    assert middle[0] == middle[middle.shape[0] - 1] == 16.0 and middle.grad[1] == 32.0
    check_usable()


def test_arrays_of_numpy(field):
    """They are copied and converted in pieces."""
    a = ti.ndarray(ti.f32, SIZE)
    assert interrupt(lambda: a.fill(1.0))
    a.fill(1.0)
    assert interrupt(a.to_numpy)
    doubles = np.full(SIZE // 2, 2.0)
    small = ti.field(ti.f32, shape=SIZE // 2)
    assert interrupt(lambda: small.from_numpy(doubles))
    small.from_numpy(doubles)
    assert small[0] == small[SIZE // 2 - 1] == 2.0
    assert a.array[0] == a.array[-1] == 1.0
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
    # The host only asks a GPU to fill it.
    assert interrupt(write) or (form == "fill" and is_on_gpu())
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

    former = signal.signal(signal.SIGPROF, destroy)
    try:
        # Time of all threads of this process: the call has begun long before, also beside another
        # busy thread, and a tree that is gone by then would be an error.
        signal.setitimer(signal.ITIMER_PROF, 0.03)
        y.fill(2.0)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, former)
    assert ran
    assert field[SIZE - 1] == 1.0
    check_usable()
