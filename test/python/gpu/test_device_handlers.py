"""Signal handlers that use a device in the middle of a call of their own thread.

A handler finds the state of the interrupted call either complete or is refused: nothing waits for
itself, and half-done state is not read.
"""

import contextlib
import signal

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def emulated(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    # The clock decides nothing here: a recording that comes again is collected.
    monkeypatch.setenv("TAI_KEEP_LAUNCHES_US", "1000000000")
    monkeypatch.setenv("TAI_COLLECT_RECORDINGS", "1")
    ti.init(offline_cache=False, default_fp=ti.f64)
    yield
    ti.reset()


@contextlib.contextmanager
def handled(handle):
    """Calls the function at safepoints, through signals that come all the time."""
    before = signal.signal(signal.SIGALRM, lambda *_: handle())
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.002, 0.002)
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class Problem:
    """Long launches, which a tape collects once they have come a few times."""

    n, launches, rounds = 4, 6, 20_000

    def __init__(self):
        x = self.x = ti.field(ti.f64, shape=self.n, needs_grad=True)
        loss = self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        # Not evenly spaced: it is copied by way of its tree.
        y = self.y = ti.field(ti.f64)
        z = ti.field(ti.f64)
        ti.root.dense(ti.i, 3).place(z)
        pair = ti.root.dense(ti.i, 3)
        pair.dense(ti.i, 2).place(y)

        @ti.kernel
        def slow(rounds: ti.i32):
            for i in x:
                s = x[i]
                k = 0
                while k < rounds:
                    s = ti.sin(s) + 0.1
                    k += 1
                loss[None] += s
            for i in y:
                y[i] += 1.0

        self.slow = slow
        x.fill(0.5)

    def record(self):
        for _ in range(self.launches):
            self.slow(self.rounds)


INNER = {
    "element": lambda p: p.loss[None],
    "array": lambda p: p.loss.to_numpy()[()],
    "tree": lambda p: p.y.to_numpy()[1],
    "copy": lambda p: p.x.from_numpy(np.full(p.n, 0.5)),
    "launch": lambda p: p.slow(0),
    "sync": lambda p: ti.sync(),
}
OUTER = {
    "element": lambda p: p.loss[None],
    "array": lambda p: p.y.to_numpy()[1],
    "sync": lambda p: ti.sync(),
}


@pytest.mark.parametrize("inner", INNER)
@pytest.mark.parametrize("outer", OUTER)
def test_a_handler_in_the_middle_of_what_is_queued(outer, inner):
    problem = Problem()
    answers, refused, state = [], [], {"waits": False}

    def handle():
        # Not in handlers: there would be many, one inside the other.
        if not state["waits"]:
            return
        state["waits"] = False
        try:
            answers.append(INNER[inner](problem))
        except ti.TaiRuntimeError as error:
            refused.append(str(error))

    def once():
        problem.y.fill(0.0)
        with ti.ad.Tape(problem.loss):
            problem.record()
            state["waits"] = True
            read = OUTER[outer](problem)
            state["waits"] = False
            return read, problem.loss[None], problem.y.to_numpy()[1]

    expected = once()
    assert expected[2] == problem.launches
    most = 200
    with handled(handle):
        while not refused and most > 0:
            most -= 1
            found = once()
            # A handler that comes before or after the wait has its usual effect.
            if inner != "launch":
                assert found == expected
    assert "a signal handler needs what the call that it has interrupted" in refused[0]
    right = {"element": expected[1], "array": expected[1], "tree": expected[2]}
    assert all(answer == right.get(inner) for answer in answers)
    assert once() == expected


def test_a_handler_while_launches_are_timed():
    """The profiler waits for the launches that it times."""
    ti.init(offline_cache=False, default_fp=ti.f64, kernel_profiler=True)
    problem = Problem()
    problem.slow(0)
    came = []

    def handle():
        came.append(problem.loss.to_numpy().shape)

    with handled(handle):
        while not came:
            problem.slow(problem.rounds)
    assert came[0] == ()
