"""Ctrl-C while a kernel runs on a device: on the emulated one, or on the GPU with --arch=cuda.

The kernels here would go on for hours: the tests check that they end.
"""

import os

import pytest
import tai as ti

from interrupts import check_usable, ctrl_c_after

ON_GPU = os.environ.get("TI_ARCH") == "cuda" and not os.environ.get("TAI_CUDA_EMULATION")


@pytest.fixture(autouse=True, params=[None] if ON_GPU else ["1", "96"])
def device(request, monkeypatch):
    """The GPU, or blocks of so many threads."""
    if request.param:
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
        monkeypatch.setenv("TAI_EMULATED_THREADS", request.param)
    monkeypatch.setenv("TI_ARCH", "cuda")
    ti.init(arch=ti.cuda, default_fp=ti.f64)


@pytest.fixture
def ctrl_c():
    with ctrl_c_after(0.3) as send:
        yield send


def endless_while(s, x):
    @ti.kernel
    def run():
        while s[None] < 1.0:
            s[None] += 0.0

    return run


def endless_for(s, x):
    @ti.kernel
    def run():
        for _ in range(1):
            for i in range(ti.i64(1) << 60):
                s[None] = ti.sin(s[None] + ti.cast(i, ti.f64))

    return run


def endless_iterations(s, x):
    """Parallel ones, of which each has a sum to add in the end."""

    @ti.kernel
    def run():
        for i in x:
            v = 0.0
            while x[i] >= 0.0:
                v += 1e-30
            s[None] += v

    return run


def endless_in_short(s, x):
    """A loop of unknown length around another one."""

    @ti.kernel
    def run(n: ti.i64, m: ti.i32):
        for i in x:
            for j in range(n):
                for k in range(m):
                    for _ in range(m):
                        x[i] += ti.sin(ti.cast(j + k, ti.f64)) * 0.0

    return run, 1 << 60, 1 << 13


def endless_count(s, x):
    """Short iterations, of which there is no end."""

    @ti.kernel
    def run(n: ti.i64):
        for i in range(n):
            x[i % 100] = ti.cast(i, ti.f64)

    return run, 1 << 60


def endless_sum(s, x):
    @ti.kernel
    def run():
        for i in range(ti.i64(1) << 60):
            s[None] += ti.cast(i, ti.f64) * 1e-30

    return run


ENDLESS = [
    endless_while, endless_for, endless_iterations, endless_in_short, endless_count, endless_sum,
]  # fmt: skip


@pytest.mark.parametrize("make", ENDLESS)
def test_a_kernel_is_interrupted(make, ctrl_c):
    s, x = ti.field(ti.f64, shape=()), ti.field(ti.f64, shape=100)
    made = make(s, x)
    run, *args = made if isinstance(made, tuple) else (made,)
    # Python itself loses a signal that comes in a callback of its garbage collector, say.
    run.compile(*args)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            ctrl_c()
            run(*args)
            ti.sync()
        check_usable()


def test_what_was_stored_stays(ctrl_c):
    s, x = ti.field(ti.f64, shape=()), ti.field(ti.f64, shape=100)

    @ti.kernel
    def run():
        for i in x:
            x[i] = 1.0
        for i in x:
            x[i] += 2.0
            while s[None] < 1.0:
                s[None] += 0.0
            x[i] += 4.0

    values = []
    # On a busy machine the kernel may not have begun.
    while 3.0 not in values:
        with pytest.raises(KeyboardInterrupt):
            ctrl_c()
            run()
            ti.sync()
        values = x.to_numpy().tolist()
    assert set(values) <= {1.0, 3.0}


def test_failures_after_an_interrupt_are_told(ctrl_c):
    ti.init(arch=ti.cuda, default_fp=ti.f64, debug=True)
    s, x = ti.field(ti.f64, shape=()), ti.field(ti.f64, shape=100)
    run = endless_while(s, x)
    with pytest.raises(KeyboardInterrupt):
        ctrl_c()
        run()
        ti.sync()

    @ti.kernel
    def fail():
        for i in x:
            assert x[i] > 0.0, "not positive"

    with pytest.raises(ti.TaiAssertionError, match="not positive"):
        fail()


def asks(kernel, *args):
    """How often the device code of a kernel asks whether it goes on."""
    kernel(*args)
    return kernel.mlir(stage="nvvm").count("call @tai_rt_go_on")


def test_short_loops_do_not_ask():
    x, n = ti.field(ti.f64, shape=100), ti.field(ti.i32, shape=100)

    @ti.kernel
    def short():
        for i in x:
            for _ in range(1000):
                x[i] += 1.0

    @ti.kernel
    def neighbours(m: ti.i32):
        for i in x:
            for j in range(n[i]):
                for k in range(3):
                    x[i] += j + k
            for j in range(m):
                x[i] += j

    @ti.kernel
    def alone(m: ti.i32):
        for _ in range(1):
            for j in range(m):
                x[0] += j

    @ti.kernel
    def long():
        for i in x:
            for j in range(3000):
                for k in range(3000):
                    x[i] += j * k

    @ti.kernel
    def searching():
        for i in x:
            while x[i] < 0:
                x[i] += 1.0

    @ti.kernel
    def counted(m: ti.i32):
        for i in range(m):
            x[i] += 1.0

    @ti.kernel
    def countless(m: ti.i64):
        for i in range(m):
            x[i] += 1.0

    assert asks(counted, 3) == 0
    assert asks(countless, 3) == 1
    assert asks(short) == 0
    assert asks(neighbours, 3) == 0
    assert asks(alone, 3) == 1
    assert asks(long) == 1
    assert asks(searching) == 1
