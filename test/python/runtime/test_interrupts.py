"""Ctrl-C, and other threads, while kernels run, sweep or are compiled.

All programs here would go on for hours: the tests check that they end.
"""

import os
import signal
import threading

import numpy as np
import pytest
import tai as ti

from interrupts import check_usable, ctrl_c_after, interrupt


@pytest.fixture(autouse=True)
def start():
    ti.init(arch=ti.cpu, default_fp=ti.f64)


@pytest.fixture
def ctrl_c():
    with ctrl_c_after(0.1) as send:
        yield send


def endless_while(s):
    @ti.kernel
    def run():
        while s[None] < 1.0:
            s[None] += 0.0

    return run


def endless_for(s):
    @ti.kernel
    def run():
        for _ in range(1):
            for i in range(ti.i64(1) << 60):
                s[None] += ti.sin(ti.cast(i, ti.f64))

    return run


def endless_sum(s):
    @ti.kernel
    def run():
        for i in range(ti.i64(1) << 60):
            s[None] += ti.cast(i, ti.f64) * 1e-30

    return run


def endless_iterations(s):
    """Many iterations, each of them long."""

    @ti.kernel
    def run():
        for i in range(1 << 30):
            for j in range(1 << 30):
                if i + j < 0:
                    s[None] += 1.0

    return run


def endless_in_one_iteration(s):
    @ti.kernel
    def run():
        for i in range(64):
            x = 0.5
            while x > -1.0:
                x = 0.5 * x + 0.1
            s[None] += x * i

    return run


def endless_in_many_loops(s):
    """The kernel has so many loops that they are compiled as several functions."""

    @ti.kernel
    def run():
        for i in range(64):
            x = 0.5
            n = ti.cast(s[None], ti.i64) + (ti.i64(1) << 60)
            for _ in ti.static(range(210)):
                for _ in range(n):
                    x = 0.5 * x + 0.1
            s[None] += x * i

    return run


ENDLESS = [
    endless_while, endless_for, endless_sum, endless_iterations, endless_in_one_iteration,
    endless_in_many_loops,
]  # fmt: skip


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("opt_level", [0, 1, 3])
@pytest.mark.parametrize("make", ENDLESS)
def test_a_kernel_is_interrupted(make, opt_level, threads, ctrl_c):
    ti.init(arch=ti.cpu, default_fp=ti.f64, opt_level=opt_level, cpu_max_num_threads=threads)
    run = make(ti.field(ti.f64, shape=()))
    # Python itself loses a signal that comes in a callback of its garbage collector, say.
    run.compile()
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            ctrl_c()
            run()
        check_usable()


def scene_that_asks(number):
    """A scene whose kernel asks a property that, once `stops` is set, raises a signal."""
    x = ti.field(ti.f64, shape=4)

    @ti.data_oriented
    class Scene:
        stops = False

        @property
        def size(self):
            if self.stops:
                self.stops = False
                signal.raise_signal(number)
            return 3

        @ti.kernel
        def run(self):
            for i in range(self.size):
                x[i] += 1.0

    return Scene()


def test_a_signal_while_the_launcher_asks_an_argument_is_not_lost():
    """The launcher looks at a property to see whether the code still holds, and drops the
    exceptions of the property."""
    scene = scene_that_asks(signal.SIGINT)
    for _ in range(3):
        scene.run()
    scene.stops = True
    with pytest.raises(KeyboardInterrupt):
        scene.run()
    assert not scene.stops
    check_usable()


def test_a_time_limit_while_the_launcher_asks_an_argument_is_not_lost():
    """The exception of the signal handler reaches the caller."""

    class Stop(Exception):
        pass

    def stop(*_):
        raise Stop("late")

    scene = scene_that_asks(signal.SIGALRM)
    before = signal.signal(signal.SIGALRM, stop)
    try:
        for _ in range(3):
            scene.run()
        scene.stops = True
        with pytest.raises(Stop, match="late"):
            scene.run()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert not scene.stops
    check_usable()


def make_scale():
    x = ti.field(ti.f64, shape=8, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def scale():
        for i in x:
            loss[None] += 0.5 * x[i]

    return scale, loss


def test_replays_are_interrupted(ctrl_c):
    scale, loss = make_scale()
    with ti.ad.Tape(loss) as tape:
        for _ in range(10):
            scale()
    with pytest.raises(KeyboardInterrupt):
        ctrl_c()
        while True:
            tape.replay()
    check_usable()


def test_a_host_function_of_a_sweep_is_interrupted(ctrl_c):
    scale, loss = make_scale()
    endless = endless_while(ti.field(ti.f64, shape=()))

    @ti.ad.grad_replaced
    def outer():
        scale()

    @ti.ad.grad_for(outer)
    def outer_gradient():
        ctrl_c()
        endless()

    with pytest.raises(KeyboardInterrupt), ti.ad.Tape(loss):
        outer()
    check_usable()


def test_an_adjoint_is_interrupted(ctrl_c):
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)
    n = ti.field(ti.i64, shape=())

    @ti.kernel
    def power():
        for _ in range(1):
            v = x[None]
            for _ in range(n[None]):
                v = ti.sin(v)
            y[None] = v

    power()
    power.compile(grad=True)
    y.grad[None] = 1.0
    n[None] = 1 << 60
    with pytest.raises(KeyboardInterrupt):
        ctrl_c()
        power.grad()
    n[None] = 1
    power.grad()
    check_usable()


def test_a_compilation_is_interrupted():
    ti.init(arch=ti.cpu, default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=1000)
    ended = []

    @ti.kernel
    def large():
        for k in x:
            s = 0.0
            for i in ti.static(range(3000)):
                s += ti.sin(x[k] * i) * ti.exp(x[k] - i) + ti.sqrt(x[k] + i)
            x[k] = s

    class Stop(Exception):
        """Not Ctrl-C: the handler of any signal may raise."""

    def stop(*_):
        raise Stop

    before = signal.signal(signal.SIGPROF, stop)
    try:
        with pytest.raises(Stop):
            # Time of this process, so that the compiler has it on a busy machine, too.
            signal.setitimer(signal.ITIMER_PROF, 0.6)
            large()
            ended.append(True)
            threading.Event().wait()
    finally:
        signal.signal(signal.SIGPROF, before)
    # Compilation takes seconds, so the signal came while it ran.
    assert not ended
    check_usable()


def test_a_plan_that_was_interrupted_is_made_again():
    """The exception is that of the handler, and the missing plan is not recorded as a failure."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=4, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    count = 400

    @ti.kernel
    def large(a: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for i in x:
            s = 0.0
            for k in ti.static(range(count)):
                s += ti.sin(a[i] * x[i] * k)
            loss[None] += s

    array = np.array([0.1, 0.2, 0.3, 0.4])
    x.from_numpy(np.ones(4))
    core = large._specialize(large._get_signature().bind((array,), {})).core
    ended = []

    class Stop(Exception):
        pass

    def stop(*_):
        raise Stop

    before = signal.signal(signal.SIGPROF, stop)
    try:
        with pytest.raises(Stop):
            signal.setitimer(signal.ITIMER_PROF, 0.01)
            core.reads_in_reverse(0)
            ended.append(True)
            threading.Event().wait()
    finally:
        signal.signal(signal.SIGPROF, before)
    assert not ended
    with ti.ad.Tape(loss):
        large(array)
    numbers = np.arange(count)
    expected = [(a * numbers * np.cos(a * numbers)).sum() for a in array]
    np.testing.assert_allclose(x.grad.to_numpy(), expected)


def test_a_handler_that_raises_in_the_front_end():
    """An exception of the handler is no error of the kernel, at any compiled statement."""
    ti.init(arch=ti.cpu, offline_cache=False)
    x = ti.field(ti.f64, shape=3)

    class Stop(Exception):
        """The exception of a handler, as a time limit raises it."""

    def stop(*_):
        raise Stop

    def interrupted():
        signal.raise_signal(signal.SIGALRM)
        return 1.0

    @ti.kernel
    def fill():
        for i in x:
            x[i] = ti.static(interrupted())

    before = signal.signal(signal.SIGALRM, stop)
    try:
        with pytest.raises(Stop):
            fill()
    finally:
        signal.signal(signal.SIGALRM, before)
    check_usable()


def test_other_threads_run_while_a_kernel_does():
    run = endless_while(ti.field(ti.f64, shape=()))
    ticks = []

    def work():
        # Only if the kernel lets this thread run is it ever ended.
        for i in range(100_000):
            ticks.append(i)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=work)
    with pytest.raises(KeyboardInterrupt):
        thread.start()
        run()
    thread.join()
    assert len(ticks) == 100_000


def test_launches_of_another_thread_are_not_recorded():
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    y = ti.field(ti.f64, shape=())

    @ti.kernel
    def use():
        loss[None] += 3.0 * x[None]

    @ti.kernel
    def other():
        y[None] += 1.0
        loss[None] += 0.0 * x[None]

    failures = []

    def work():
        try:
            for _ in range(10):
                other()
            with pytest.raises(ti.TaiRuntimeError, match="another thread records a tape"):
                ti.ad.Tape(loss).__enter__()
        except BaseException as error:  # noqa: BLE001
            failures.append(error)

    with ti.ad.Tape(loss):
        use()
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    assert not failures
    assert y[None] == 10.0
    assert x.grad[None] == 3.0


def test_threads_compile_and_launch_their_own_programs():
    count = 8
    results = [None] * count
    failures = []

    def work(number):
        try:
            x = ti.field(ti.f64, shape=1000 + number)

            @ti.kernel
            def fill(a: ti.f64):
                for i in x:
                    x[i] = a * i + number

            for _ in range(20):
                fill(2.0)
            results[number] = x.to_numpy().sum()
        except BaseException as error:  # noqa: BLE001
            failures.append(error)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    for number in range(count):
        n = 1000 + number
        assert results[number] == n * (n - 1) + number * n


@pytest.mark.parametrize("lines", [1, 400])
def test_the_helper_keeps_a_late_signal(lines):
    """A signal that comes while the last call returns is not raised behind the helper."""

    def work():
        for _ in range(lines):
            threading.get_ident()
        signal.raise_signal(signal.SIGALRM)

    def late():
        # A native call that ends with the signal set, as a copy behind its last safepoint.
        work()

    assert interrupt(late, 10.0)
    stopped = sum(interrupt(lambda: sum(range(lines)), k * 1e-6) for k in range(1, 400))
    assert 0 <= stopped < 400
    check_usable()
