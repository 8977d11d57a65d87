"""Threads of one program on a device: one records a tape at a time, the others go on."""

import os
import threading

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def emulated(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if not os.environ.get("TAI_CUDA_EMULATION"):
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(offline_cache=False)
    yield
    ti.reset()


class Problem:
    """Fields and kernels of one thread."""

    steps, n = 6, 16

    def __init__(self, k):
        x = self.x = ti.field(ti.f64, shape=(self.steps + 1, self.n), needs_grad=True)
        loss = self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        y = self.y = ti.field(ti.f64, shape=self.n)

        @ti.kernel
        def step(t: ti.i32):
            for i in range(Problem.n):
                x[t + 1, i] = x[t, i] + k * ti.sin(x[t, i])

        @ti.kernel
        def measure():
            for i in range(Problem.n):
                loss[None] += x[Problem.steps, i] ** 2

        @ti.kernel
        def count():
            for i in y:
                y[i] += 1.0

        self.step, self.measure, self.count = step, measure, count

    def run(self):
        for t in range(self.steps):
            self.step(t)
        self.measure()

    def set_state(self, value):
        self.x.from_numpy(np.full((self.steps + 1, self.n), value))

    def gradient(self, value):
        self.set_state(value)
        with ti.ad.Tape(self.loss) as tape:
            self.run()
        return tape, self.result()

    def result(self):
        return self.loss[None], self.x.grad.to_numpy().tobytes()


def in_a_thread(task):
    """The result or the exception of a function in a thread of its own."""
    answer = []

    def work():
        try:
            answer.append(task())
        except BaseException as error:  # noqa: BLE001
            answer.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return answer[0]


def test_a_second_tape_is_refused_and_harms_none():
    first, second = Problem(0.1), Problem(0.2)
    expected = first.gradient(0.5)[1]
    alone = second.gradient(0.7)[1]
    first.set_state(0.5)
    with ti.ad.Tape(first.loss):
        for t in range(first.steps):
            first.step(t)
        error = in_a_thread(lambda: second.gradient(0.7))
        first.measure()
    assert isinstance(error, ti.TaiRuntimeError)
    assert "a GPU has room for one at a time: let it finish first" in str(error)
    assert first.result() == expected
    # Once the first has ended, the other thread may.
    assert in_a_thread(lambda: second.gradient(0.7)[1]) == alone


@pytest.mark.parametrize("read", ["element", "array"])
def test_what_another_thread_has_the_queue_run_is_waited_for(read):
    """The next thread, whichever it is, runs the launches that a recording has collected; the own
    thread reads the result."""
    n = 8
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    y = ti.field(ti.f64, shape=n)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x.fill(0.5)

    @ti.kernel
    def slow():
        for i in x:
            s = x[i]
            for _ in range(400_000):
                s = ti.sin(s) + 0.1
            loss[None] += s

    @ti.kernel
    def other():
        for i in y:
            y[i] += 1.0

    def result():
        return loss[None] if read == "element" else loss.to_numpy()[()]

    def once():
        with ti.ad.Tape(loss):
            slow()
        return result()

    other()
    expected = once()
    # It is collected once it has come a few times.
    assert [once() for _ in range(4)] == [expected] * 4
    rounds = 4
    for _ in range(rounds):
        recorded, about = threading.Event(), threading.Event()

        def work(recorded=recorded, about=about):
            recorded.wait()
            about.set()
            other()

        thread = threading.Thread(target=work)
        thread.start()
        with ti.ad.Tape(loss):
            slow()
            recorded.set()
            about.wait()
            got = result()
        thread.join()
        assert got == expected
    assert y[3] == rounds + 1


def test_launches_and_replays_of_other_threads_are_not_recorded():
    """A device knows a recording again by its queued work, which includes the launches of other
    threads."""
    first, second = Problem(0.1), Problem(0.2)
    values = [0.1 * i for i in range(5)]
    expected = [first.gradient(value)[1] for value in values]
    tape, replayed = second.gradient(0.5)
    rounds, over, wrong = [0], [], []

    def work():
        while not over:
            second.set_state(0.5)
            second.loss[None] = 0.0
            tape.replay()
            if second.result() != replayed:
                wrong.append(f"replay {rounds[0]}")
            for _ in range(1 + rounds[0] % 3):
                second.count()
            rounds[0] += 1

    thread = threading.Thread(target=work)
    thread.start()
    try:
        done = 0
        while thread.is_alive() and (rounds[0] < 20 or done < 20):
            at = done % len(values)
            if first.gradient(values[at])[1] != expected[at]:
                wrong.append(f"gradient {done}")
            done += 1
    finally:
        over.append(True)
        thread.join()
    assert not wrong and rounds[0] >= 20
    assert second.y[0] == sum(1 + number % 3 for number in range(rounds[0]))
