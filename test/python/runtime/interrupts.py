"""Helpers of the tests of interrupted programs, on the CPU and on devices."""

import contextlib
import os
import signal
import threading

import tai as ti


@contextlib.contextmanager
def ctrl_c_after(seconds):
    """Gives a function that sends what Ctrl-C sends, once work has begun, or before on a busy
    machine.

    It is to be called where the exception is expected: anywhere else that ends the session.
    """
    threads = []

    def send():
        thread = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
        thread.start()
        threads.append(thread)

    yield send
    for thread in threads:
        thread.join()


def interrupt(work, seconds=0.005):
    """Runs `work`, to which a signal comes once it has begun; says whether that ended it.

    Python may call the handler some steps after the signal, so that one which comes at the very
    end of `work` is seen behind it: the handler raises only while `work` is the caller's.
    """
    armed = True

    def stop(*_):
        if armed:
            raise KeyboardInterrupt

    former = signal.signal(signal.SIGALRM, stop)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds)
            work()
        finally:
            # No call stands before this, so that a late handler either raises in here or not at
            # all.
            armed = False
    except KeyboardInterrupt:
        return True
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
    return False


def is_on_gpu():
    return os.environ.get("TI_ARCH") == "cuda" and os.environ.get("TAI_CUDA_EMULATION") != "1"


def check_usable():
    """The context goes on: kernels, tapes, new fields."""
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] ** 2

    x.fill(2.0)
    with ti.ad.Tape(loss):
        total()
    assert loss[None] == 12.0
    assert x.grad.to_numpy().tolist() == [4.0, 4.0, 4.0]
