"""Signal handlers, other threads and forked children that come in the middle of the library."""

import os
import signal
import threading

import pytest
import tai as ti
from tai._impl.base.locks import Lock, snapshot
from tai._impl.base.symbols import Symbols
from tai._impl.fields.snode import Root


def ends(work):
    """Whether it does, on a thread of its own."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(60)
    return not thread.is_alive()


def test_names_are_taken_while_a_name_is_taken():
    """A handler defines a field while one is defined."""
    names = []

    def is_used(_):
        names.append(symbols.take("x"))
        return False

    symbols = Symbols(is_used, lambda _: None)

    def work():
        names.append(symbols.take("x"))
        symbols.give_back(names[0])
        names.append(symbols.take("x"))

    assert ends(work)
    assert len(names) == 3
    # The first is free when the last one is taken.
    assert names[1] != names[0] and names[2] == names[0]


def test_sets_that_grow_while_they_are_read():
    class Growing:
        reads = 0

        def __iter__(self):
            self.reads += 1
            yield 1
            if self.reads == 1:
                raise RuntimeError("Set changed size during iteration")
            yield 2

    assert snapshot(Growing()) == [1, 2]


def test_a_handler_raises_while_a_set_is_read():
    """The exception that reports a grown set is of the same class."""

    class Late(RuntimeError):
        pass

    class Read:
        reads = 0

        def __iter__(self):
            self.reads += 1
            if self.reads == 1:
                signal.raise_signal(signal.SIGALRM)
            return iter([1, 2])

    def stop(*_):
        raise Late

    before = signal.signal(signal.SIGALRM, stop)
    try:
        with pytest.raises(Late):
            snapshot(Read())
    finally:
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("holder", ["this thread", "another thread"])
def test_a_lock_in_a_forked_child(holder):
    lock, taken, over = Lock(), threading.Event(), threading.Event()

    def hold():
        with lock:
            taken.set()
            over.wait()

    def fork():
        child = os.fork()
        if child == 0:
            # Not the test's own handlers: what waits for ever is ended.
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(60)
            with lock:
                os._exit(0)
        return os.waitpid(child, 0)[1]

    if holder == "this thread":
        with lock:
            status = fork()
    else:
        thread = threading.Thread(target=hold)
        thread.start()
        taken.wait()
        status = fork()
        over.set()
        thread.join()
    assert status == 0
    assert ends(lambda: lock.__enter__())


def test_a_forked_child_of_a_process_that_allocates(monkeypatch):
    """Another thread of the parent was at it: the child has fields of its own."""
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f32, shape=3)
    begun, over = threading.Event(), threading.Event()
    allocate = Root._allocate_all

    def wait(root, program):
        begun.set()
        over.wait()
        allocate(root, program)

    monkeypatch.setattr(Root, "_allocate_all", wait)
    thread = threading.Thread(target=x.fill, args=(1.0,))
    thread.start()
    begun.wait()
    monkeypatch.undo()
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(60)
        y = ti.field(ti.f32, shape=3)
        y.fill(2.0)
        os._exit(0 if y[1] == 2.0 else 1)
    assert os.waitpid(child, 0)[1] == 0
    over.set()
    thread.join()
    assert x[1] == 1.0


def test_a_lock_whose_block_is_interrupted_is_free():
    """At any step: before its block, in it and behind it."""
    lock = Lock()

    class Stop(Exception):
        pass

    def interrupt(*_):
        raise Stop

    def use_until_interrupted():
        with pytest.raises(Stop):
            signal.setitimer(signal.ITIMER_REAL, 2e-5)
            while True:
                with lock:
                    pass

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        for _ in range(300):
            use_until_interrupted()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert ends(lambda: lock.__enter__())


@pytest.mark.parametrize("at", ["tracked.begin", "native.set_tape"])
def test_a_tape_that_is_interrupted_while_it_begins(at, monkeypatch):
    """Its `__exit__` is never called, and the next tape records."""
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] ** 2

    def interrupt(given, *_):
        if given is not None:
            raise KeyboardInterrupt

    x.fill(2.0)
    tape = ti.ad.Tape(loss)
    with monkeypatch.context() as patch:
        patch.setattr(f"tai._impl.ad.tape.{at}", interrupt)
        with pytest.raises(KeyboardInterrupt), tape:
            total()
    assert loss[None] == 0.0
    with ti.ad.Tape(loss):
        total()
    assert x.grad.to_numpy().tolist() == [4.0, 4.0, 4.0]


def test_a_handler_launches_what_is_being_compiled():
    """It is refused, and the compilation goes on."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=8)

    @ti.kernel
    def large():
        for k in x:
            s = 0.0
            for i in ti.static(range(400)):
                s += ti.sin(x[k] * i) * ti.exp(x[k] - i)
            x[k] = s

    # The front end has run; the call has only to make machine code.
    large._specialize(large._get_signature().bind((), {}))
    refused = []

    def handle(*_):
        signal.setitimer(signal.ITIMER_PROF, 0)
        try:
            large()
        except ti.TaiRuntimeError as error:
            refused.append(str(error))

    before = signal.signal(signal.SIGPROF, handle)
    try:
        # Time of this process: on a busy machine, too, the compiler has begun.
        signal.setitimer(signal.ITIMER_PROF, 0.05)
        large()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    large()
    assert len(refused) == 1 and "a signal handler needs what the call" in refused[0]
