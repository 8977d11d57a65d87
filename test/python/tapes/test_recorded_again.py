"""Tapes that are recorded anew in each iteration, whose launches are collected.

Whether launches are collected or not, fields have in each iteration the same bits as if each launch
were queued by itself; and the values that NumPy computes, or the CPU.
"""

import os
import re

import numpy as np
import pytest
import tai as ti

N = 12
TARGET = np.linspace(-1.0, 2.0, N)
START = np.random.default_rng(7).random(N)
# Enough for all ways to be tried, and some more.
ITERATIONS = 24


@pytest.fixture(autouse=True)
def device(monkeypatch, request):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if request.config.getoption("--arch") != "cuda":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    # The clock decides nothing here.
    monkeypatch.setenv("TAI_KEEP_LAUNCHES_US", "1000000000")
    monkeypatch.setenv("TAI_COLLECT_RECORDINGS", "1")


def is_emulated():
    return os.environ.get("TAI_CUDA_EMULATION") == "1"


def counts(tape):
    """How often recordings were collected, and how often for nothing."""
    found = re.search(r"recordings: (\d+) times .*, (\d+) times", tape.explain())
    return (int(found[1]), int(found[2])) if found else (0, 0)


def compare(run, **options):
    """Runs it collected, launch by launch, and on the CPU.

    `run` returns all results that it has seen, and its last tape. Returns the results and the
    counts.
    """
    seen = {}
    for name, fuse, arch in [("collected", True, "cuda"), ("queued", False, "cuda"),
                             ("cpu", True, "cpu")]:  # fmt: skip
        os.environ["TI_ARCH"] = arch
        ti.init(offline_cache=False, deterministic=True, fuse_launches=fuse, default_fp=ti.f64,
                **options)  # fmt: skip
        values, tape = run()
        seen[name] = values
        if name == "collected":
            found = counts(tape)
        else:
            assert counts(tape) == (0, 0)
    assert len(seen["collected"]) == len(seen["queued"]) == len(seen["cpu"])
    for one, other, cpu in zip(*seen.values(), strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(one, cpu, rtol=1e-12, atol=1e-13)
    return seen["collected"], found


class Problem:
    """The sum of squares of w - target after some steps in rows of an array; momentum."""

    def __init__(self, steps=6, target=TARGET):
        x = ti.field(ti.f64, shape=(32, N), needs_grad=True)
        w = ti.field(ti.f64, shape=N, needs_grad=True)
        goal = ti.field(ti.f64, shape=N)
        v = ti.field(ti.f64, shape=N)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def begin():
            for i in range(N):
                x[0, i] = w[i] - goal[i]

        @ti.kernel
        def step(t: ti.i32, factor: ti.f64):
            for i in range(N):
                x[t + 1, i] = factor * x[t, i] + 0.25 * x[t, (i + 1) % N]

        @ti.kernel
        def other(t: ti.i32):
            for i in range(N):
                x[t + 1, i] = ti.sin(x[t, i])

        @ti.kernel
        def total(t: ti.i32):
            for i in range(N):
                loss[None] += x[t, i] ** 2

        @ti.kernel
        def push(mu: ti.f64):
            for i in range(N):
                v[i] = mu * v[i] + w.grad[i]

        @ti.kernel
        def move(rate: ti.f64):
            for i in range(N):
                w[i] -= rate * v[i]

        self.x, self.w, self.v, self.loss, self.steps = x, w, v, loss, steps
        self.begin, self.step, self.other, self.total = begin, step, other, total
        self.push, self.move = push, move
        goal.from_numpy(target)
        w.from_numpy(START)

    def forward(self, steps=None, factor=0.75, middle=lambda t: None):
        steps = steps or self.steps
        self.begin()
        for t in range(steps):
            self.step(t, factor)
            middle(t)
        self.total(steps)

    def descend(self, rate=0.1):
        self.push(0.5)
        self.move(rate)

    def state(self):
        return [self.loss[None], self.w.grad.to_numpy(), self.w.to_numpy()]


def by_numpy(iterations, steps=6, factor=0.75):
    """The losses of the same in NumPy, and w after it."""
    matrix = np.linalg.matrix_power(factor * np.eye(N) + 0.25 * np.roll(np.eye(N), 1, 1), steps)
    w, v, losses = START.copy(), np.zeros(N), []
    for it in range(iterations):
        x = matrix @ (w - TARGET)
        losses.append(x @ x)
        v = 0.5 * v + 2 * matrix.T @ x
        w = w - 0.1 / (1 + it / 4) * v
    return losses, w


@pytest.mark.parametrize("reads", ["never", "before the step", "behind the step"])
@pytest.mark.parametrize("keeps_tape", [True, False])
def test_training(reads, keeps_tape):
    losses, w = by_numpy(ITERATIONS)

    def run():
        problem, seen = Problem(), []
        for it in range(ITERATIONS):
            if keeps_tape:
                with ti.ad.Tape(problem.loss) as tape:
                    problem.forward()
            else:
                with ti.ad.Tape(problem.loss):
                    problem.forward()
            if reads == "before the step":
                seen.append(problem.loss[None])
            problem.descend(0.1 / (1 + it / 4))
            if reads == "behind the step":
                seen.append(problem.loss[None])
        seen.append(problem.w.to_numpy())
        with ti.ad.Tape(problem.loss) as tape:
            problem.forward()
        return seen, tape

    seen, (taken, lost) = compare(run)
    assert taken >= ITERATIONS - 3
    assert lost == 0
    np.testing.assert_allclose(seen[-1], w, rtol=1e-11)
    if reads != "never":
        np.testing.assert_allclose(seen[:-1], losses, rtol=1e-11)


def test_the_step_is_part_of_the_next_recording():
    ti.init(offline_cache=False, deterministic=True, default_fp=ti.f64)
    problem = Problem()
    for _ in range(40):
        with ti.ad.Tape(problem.loss) as tape:
            problem.forward()
        problem.descend()
    assert re.search(r"with push\S*, move\S* before it: \d+ times", tape.explain())


def test_arguments_that_change_each_time():
    def run():
        problem, seen = Problem(), []
        for it in range(ITERATIONS):
            with ti.ad.Tape(problem.loss) as tape:
                problem.forward(factor=0.5 + it / 64)
            seen += problem.state()
            problem.descend()
        return seen, tape

    assert compare(run)[1][0] >= ITERATIONS - 3


def test_reads_in_the_middle():
    def run():
        problem, seen = Problem(), []

        def read(t):
            if t == 3:
                seen.append(problem.x[2, 5])

        for _ in range(2 * ITERATIONS):
            with ti.ad.Tape(problem.loss) as tape:
                problem.forward(middle=read)
            problem.descend()
            seen += problem.state()
        return seen, tape

    assert compare(run)[1][0] > ITERATIONS


def test_reads_and_writes_in_the_middle_now_and_then():
    def run():
        problem, seen = Problem(), []
        for it in range(2 * ITERATIONS):

            def touch(t, it=it):
                if t == 2 and it % 7 == 3:
                    seen.append(problem.x.to_numpy())
                if t == 4 and it % 5 == 2:
                    problem.x[5, 3] = 0.125 * it
                if t == 1 and it % 11 == 8:
                    problem.x.grad.fill(0)

            with ti.ad.Tape(problem.loss) as tape:
                problem.forward(middle=touch)
            problem.descend()
            seen += problem.state()
        return seen, tape

    compare(run)


def test_sequences_that_change():
    def run():
        problem, seen = Problem(), []
        for it in range(3 * ITERATIONS):

            def more(t, it=it):
                if it % 13 == 12 and t == 5:
                    problem.other(5)

            with ti.ad.Tape(problem.loss) as tape:
                problem.forward(steps=6 + (it % 5 == 4) + 2 * (it > 2 * ITERATIONS), middle=more)
            seen += problem.state()
            problem.descend()
        return seen, tape

    assert compare(run)[1][0] > ITERATIONS


def test_exceptions_in_the_block():
    def run():
        problem, seen = Problem(), []
        for it in range(ITERATIONS + 8):

            def fail(t, it=it):
                if it % 9 == 8 and t == it // 9:
                    raise ArithmeticError

            try:
                with ti.ad.Tape(problem.loss) as tape:
                    problem.forward(middle=fail)
                problem.descend()
            except ArithmeticError:
                seen.append(problem.x.to_numpy())
            seen += problem.state()
        return seen, tape

    assert compare(run)[1][0] > ITERATIONS // 2


def test_two_tapes_and_the_sweep_of_one_within_the_other():
    def run():
        one, two, seen = Problem(), Problem(4, TARGET[::-1].copy()), []
        for it in range(2 * ITERATIONS):
            with ti.ad.Tape(one.loss) as first:
                one.forward()
            with ti.ad.Tape(two.loss) as second:
                two.forward()
                if it % 8 == 5:
                    first.grad()
            for problem in (one, two):
                problem.descend(0.05)
                seen += problem.state()
            second.replay()
            seen += two.state()
        return seen, second

    assert compare(run)[1][0] > ITERATIONS


def test_sweeps_that_come_later_or_never():
    def run():
        problem, seen = Problem(), []
        for it in range(ITERATIONS):
            with ti.ad.Tape() as tape:
                problem.loss[None] = 0
                problem.forward()
            if it % 3 == 0:
                problem.x[0, 0] += 0  # waits
            if it % 6 != 5:
                problem.loss.grad[None] = 1.0
                tape.grad()
            problem.descend()
            seen += problem.state()
        return seen, tape

    assert compare(run)[1][0] > ITERATIONS // 2


def test_values_that_are_overwritten():
    """Steps in place: the tape keeps the former values, at the same addresses each time."""

    def run():
        w = ti.field(ti.f64, shape=N, needs_grad=True)
        y = ti.field(ti.f64, shape=N, needs_grad=True)
        z = ti.field(ti.f64, shape=(3, N), needs_grad=True)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def begin():
            for i in range(N):
                y[i] = w[i]
                z[1, i] = 0.5

        @ti.kernel
        def step(dt: ti.f64):
            for i in range(N):
                y[i] += dt * ti.sin(y[i]) * z[1, i]

        @ti.kernel
        def turn():
            for i in range(N):
                z[1, i] = y[(i + 1) % N] * z[1, i]

        @ti.kernel
        def total():
            for i in range(N):
                loss[None] += y[i] ** 2

        w.from_numpy(START)
        seen = []
        for it in range(2 * ITERATIONS):
            with ti.ad.Tape(loss) as tape:
                begin()
                for _ in range(4 + (it == 30)):
                    step(0.1)
                    turn()
                total()
            seen += [loss[None], w.grad.to_numpy(), y.to_numpy(), tape.stats().saved_bytes]
        return seen, tape

    seen, (taken, _) = compare(run)
    assert taken > ITERATIONS
    assert seen[3] > 0


def test_addresses_of_what_is_kept_stay():
    ti.init(offline_cache=False, deterministic=True, default_fp=ti.f64)
    y = ti.field(ti.f64, shape=N, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def step():
        for i in range(N):
            y[i] = ti.sin(y[i])

    @ti.kernel
    def total():
        for i in range(N):
            loss[None] += y[i] ** 2

    y.from_numpy(START)
    for _ in range(ITERATIONS):
        with ti.ad.Tape(loss) as tape:
            for _ in range(6):
                step()
            total()
    assert tape.stats().saved_bytes > 0
    changed = [int(n) for n in re.findall(r"run \d+ times, (\d+) of them with new", tape.explain())]
    # The first of them still have other memory.
    assert max(changed) <= 2


@pytest.mark.parametrize("checkpoint", ["periodic", "binomial", 3])
def test_checkpoints(checkpoint):
    def run():
        problem, seen = Problem(), []
        for _ in range(ITERATIONS):
            with ti.ad.Tape(problem.loss, checkpoint=checkpoint) as tape:
                problem.forward()
            problem.descend()
            seen += problem.state()
        return seen, tape

    compare(run)


def test_sparse_fields_with_changing_activity():
    def run():
        x = ti.field(ti.f64, needs_grad=True)
        w = ti.field(ti.f64, shape=N, needs_grad=True)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)
        block = ti.root.pointer(ti.i, 16)
        block.dense(ti.i, 4).place(x, x.grad)

        @ti.kernel
        def scatter(at: ti.i32):
            for i in range(N):
                x[(5 * i + at) % 64] += w[i]

        @ti.kernel
        def grow():
            for i in x:
                loss[None] += x[i] ** 2

        w.from_numpy(START)
        seen = []
        for it in range(ITERATIONS):
            if it % 5 == 4:
                block.deactivate_all()
            with ti.ad.Tape(loss) as tape:
                for k in range(3):
                    scatter(7 * k + (it // 8))
                grow()
            seen += [loss[None], w.grad.to_numpy()]
        return seen, tape

    compare(run)


def test_returned_values_and_host_functions():
    def run():
        problem, seen = Problem(), []
        x = problem.x

        @ti.kernel
        def largest(t: ti.i32) -> ti.f64:
            most = -1e9
            for i in range(N):
                ti.atomic_max(most, x[t, i])
            return most

        @ti.ad.no_grad
        def look():
            seen.append(largest(3))

        for it in range(ITERATIONS):
            with ti.ad.Tape(problem.loss) as tape:
                problem.forward(middle=lambda t, it=it: look() if t == 3 and it % 4 < 2 else None)
            problem.descend()
            seen += problem.state()
        return seen, tape

    compare(run)


def test_arrays_of_the_host():
    def run():
        problem, seen = Problem(), []
        w = problem.w

        @ti.kernel
        def take(a: ti.types.ndarray()):
            for i in range(N):
                w[i] += a[i]

        @ti.kernel
        def give(t: ti.i32, a: ti.types.ndarray()):
            for i in range(N):
                a[i] = w[i] * t

        for it in range(ITERATIONS):
            given, taken = np.full(N, it / 128), np.zeros(N)
            take(given)
            with ti.ad.Tape(problem.loss) as tape:
                problem.forward()
            give(it, taken)
            seen += [taken, *problem.state()]
            problem.descend()
        return seen, tape

    compare(run)


def test_fields_that_go_and_come():
    def run():
        problem, seen = Problem(), []
        for it in range(ITERATIONS):
            builder = ti.FieldsBuilder()
            extra = ti.field(ti.f64)
            builder.dense(ti.i, N + it % 2).place(extra)
            tree = builder.finalize()
            extra.fill(it)
            with ti.ad.Tape(problem.loss) as tape:
                problem.forward()
                if it % 6 == 5:
                    tree.destroy()
            seen += problem.state()
            problem.descend()
            if it % 6 != 5:
                seen.append(extra.to_numpy()[:N])
                tree.destroy()
        return seen, tape

    compare(run)


def test_kernels_that_go_and_come():
    def run():
        problem, seen = Problem(), []
        x = problem.x
        for it in range(ITERATIONS):
            factor = 0.5 + it / 8

            @ti.kernel
            def scale(t: ti.i32):
                for i in range(N):
                    x[t + 1, i] = x[t, i] * ti.static(factor)  # noqa: B023

            with ti.ad.Tape(problem.loss) as tape:
                problem.begin()
                for t in range(4):
                    scale(t)
                problem.total(4)
            seen += problem.state()
            del scale, tape
            if it % 2:
                problem.descend(0.01)
        with ti.ad.Tape(problem.loss) as tape:
            problem.forward()
        return seen, tape

    compare(run)


def test_memory_that_is_shared():
    if not is_emulated():
        pytest.skip("NumPy takes no memory of a GPU")
    ti.init(offline_cache=False, deterministic=True, default_fp=ti.f64)
    problem = Problem()
    for _ in range(6):
        with ti.ad.Tape(problem.loss) as tape:
            problem.forward()
    taken = counts(tape)[0]
    assert taken > 0
    x = np.from_dlpack(problem.x)
    with ti.ad.Tape(problem.loss) as tape:
        problem.begin()
        before = x[0].copy()
        problem.step(0, 0.75)
        np.testing.assert_allclose(x[1], 0.75 * before + 0.25 * np.roll(before, -1), rtol=1e-14)
        for t in range(1, 6):
            problem.step(t, 0.75)
        problem.total(6)
    assert counts(tape)[0] == taken
    np.testing.assert_allclose(problem.loss[None], np.sum(x[6] ** 2), rtol=1e-12)


def test_the_profiler_times_each_launch():
    ti.init(offline_cache=False, deterministic=True, default_fp=ti.f64, kernel_profiler=True)
    problem = Problem()
    for _ in range(6):
        with ti.ad.Tape(problem.loss) as tape:
            problem.forward()
    assert counts(tape) == (0, 0)
    rows = ti.profiler.get_stats()
    assert sum(row.counter for row in rows if row.name.startswith("step")) >= 36


def test_the_device_takes_its_time(monkeypatch):
    """By the clock: whatever is decided, the same comes of it."""
    monkeypatch.delenv("TAI_COLLECT_RECORDINGS")

    def run():
        problem, seen = Problem(), []
        for _ in range(2 * ITERATIONS):
            with ti.ad.Tape(problem.loss) as tape:
                problem.forward()
            problem.descend()
            seen += problem.state()
        return seen, tape

    compare(run)
