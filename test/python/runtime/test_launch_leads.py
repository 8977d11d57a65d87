"""Launches between the replays of a tape, which become part of the next replay.

Whether and for how long launches are kept, fields have the values that they have on the CPU, and
that NumPy computes.
"""

import gc
import os
import re

import numpy as np
import pytest
import tai as ti

N = 12
TARGET = np.linspace(-1.0, 2.0, N)
START = np.random.default_rng(7).random(N)


@pytest.fixture(autouse=True)
def device(monkeypatch, request):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if request.config.getoption("--arch") != "cuda":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    # Long enough that the clock decides nothing here.
    monkeypatch.setenv("TAI_KEEP_LAUNCHES_US", "1000000000")


def is_emulated():
    return os.environ.get("TAI_CUDA_EMULATION") == "1"


def init(fuse=True, arch=None):
    if arch:
        os.environ["TI_ARCH"] = arch
    # In strict mode, too, sums have the same bits on the CPU.
    ti.init(
        offline_cache=False, deterministic=True, strict=True, fuse_launches=fuse, default_fp=ti.f64
    )


def counts(tape):
    """How often launches were part of a replay, and how often they were kept for nothing."""
    found = re.search(r"between replays: (\d+) times .*, (\d+) times", tape.explain())
    return (int(found[1]), int(found[2])) if found else (0, 0)


class Problem:
    """The sum of squares of w - target, by way of two more arrays; momentum."""

    def __init__(self, target=TARGET):
        w = ti.field(ti.f64, shape=N, needs_grad=True)
        d = ti.field(ti.f64, shape=N, needs_grad=True)
        s = ti.field(ti.f64, shape=N, needs_grad=True)
        goal = ti.field(ti.f64, shape=N)
        v = ti.field(ti.f64, shape=N)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def distance():
            for i in range(N):
                d[i] = w[i] - goal[i]

        @ti.kernel
        def square():
            for i in range(N):
                s[i] = d[i] * d[i]

        @ti.kernel
        def total():
            for i in range(N):
                loss[None] += s[i]

        @ti.kernel
        def push(mu: ti.f64):
            for i in range(N):
                v[i] = mu * v[i] + w.grad[i]

        @ti.kernel
        def move(rate: ti.f64):
            for i in range(N):
                w[i] -= rate * v[i]

        self.w, self.v, self.loss = w, v, loss
        self.push, self.move = push, move
        goal.from_numpy(target)
        w.from_numpy(START)
        with ti.ad.Tape(loss) as tape:
            distance()
            square()
            total()
        self.tape = tape


def descend(iterations, target=TARGET, rates=None):
    """The same in NumPy: w and v after so many steps, and the loss before each."""
    w, v, losses = START.copy(), np.zeros(N), []
    for it in range(iterations):
        losses.append(np.sum((w - target) ** 2))
        v = 0.5 * v + 2 * (w - target)
        w = w - (rates[it] if rates else 0.1) * v
    return w, v, losses


ITERATIONS = 20
RATES = [0.1 / (1 + it / 4) for it in range(ITERATIONS)]


def train(problem, read_every=0, read_first=False):
    losses = {}
    for it in range(ITERATIONS):
        problem.tape.replay()
        wanted = read_every and it % read_every == 0
        if wanted and read_first:
            losses[it] = problem.loss[None]
        problem.push(0.5)
        problem.move(RATES[it])
        if wanted and not read_first:
            losses[it] = problem.loss[None]
    return losses


@pytest.mark.parametrize("read_every, read_first", [(0, False), (1, True), (1, False), (5, False)])
def test_training_with_momentum(read_every, read_first):
    results = {}
    for name, fuse, arch in [("kept", True, None), ("queued", False, None), ("cpu", True, "cpu")]:
        init(fuse, arch)
        problem = Problem()
        losses = train(problem, read_every, read_first)
        taken, lost = counts(problem.tape)
        results[name] = (losses, problem.w.to_numpy(), problem.v.to_numpy())
        w, v, expected = descend(ITERATIONS, rates=RATES)
        np.testing.assert_allclose(results[name][1], w, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(results[name][2], v, rtol=1e-12, atol=1e-13)
        for it, value in losses.items():
            np.testing.assert_allclose(value, expected[it], rtol=1e-12)
        if name != "kept" or (read_every == 1 and not read_first):
            assert (taken, lost) == (0, 0)
        else:
            assert taken >= ITERATIONS // 2
            assert lost <= (ITERATIONS // read_every if read_every > 1 else 1)
            assert re.search(r"with push\S*, move\S* before it: \d+ times", problem.tape.explain())
    # Sums of a GPU may differ in code that was not compared on one.
    for other in ("queued", "cpu") if is_emulated() else ("queued",):
        assert results["kept"][0] == results[other][0]
        np.testing.assert_array_equal(results["kept"][1], results[other][1])
        np.testing.assert_array_equal(results["kept"][2], results[other][2])


def learnt():
    """A problem whose launches are kept, after 20 steps, and one more that waits."""
    init()
    problem = Problem()
    train(problem)
    assert counts(problem.tape)[0] > 0
    problem.tape.replay()
    problem.push(0.5)
    problem.move(0.1)
    return problem


def expected_after_learning():
    return descend(ITERATIONS + 1, rates=[*RATES, 0.1])[0]


def test_a_tape_that_goes_leaves_its_step():
    problem = learnt()
    problem.tape = None
    gc.collect()
    np.testing.assert_allclose(problem.w.to_numpy(), expected_after_learning(), rtol=1e-12)


def test_kernels_that_go_leave_their_step():
    problem = learnt()
    w = problem.w
    del problem
    gc.collect()
    np.testing.assert_allclose(w.to_numpy(), expected_after_learning(), rtol=1e-12)


def test_a_program_that_ends_with_a_step_to_come():
    learnt()
    ti.reset()
    problem = learnt()
    np.testing.assert_allclose(problem.w.to_numpy(), expected_after_learning(), rtol=1e-12)


def test_a_shared_field_shows_each_step():
    problem = learnt()
    if not is_emulated():
        pytest.skip("NumPy takes no memory of a GPU")
    taken = counts(problem.tape)[0]
    w, v, _ = descend(ITERATIONS + 1, rates=[*RATES, 0.1])
    shared = np.from_dlpack(problem.w)
    np.testing.assert_allclose(shared, w, rtol=1e-12)
    for _ in range(5):
        problem.tape.replay()
        problem.push(0.5)
        problem.move(0.05)
        v = 0.5 * v + 2 * (w - TARGET)
        w = w - 0.05 * v
        np.testing.assert_allclose(shared, w, rtol=1e-11, atol=1e-13)
    assert counts(problem.tape)[0] == taken


def test_an_element_that_the_host_writes_before_and_behind_the_step():
    problem = learnt()
    w, v, _ = descend(ITERATIONS + 1, rates=[*RATES, 0.1])
    for it in range(6):
        problem.w[2] = w[2] = 0.25 * it
        problem.tape.replay()
        problem.push(0.5)
        v = 0.5 * v + 2 * (w - TARGET)
        problem.v[1] = v[1] = 3.0
        problem.move(0.05)
        w = w - 0.05 * v
    np.testing.assert_allclose(problem.w.to_numpy(), w, rtol=1e-11, atol=1e-13)


def test_a_loss_that_the_host_clears():
    init()
    problem = Problem()
    for it in range(ITERATIONS):
        problem.loss[None] = 0
        problem.tape.replay()
        problem.push(0.5)
        problem.move(RATES[it])
    assert counts(problem.tape)[0] >= ITERATIONS // 2
    w, _, losses = descend(ITERATIONS, rates=RATES)
    np.testing.assert_allclose(problem.w.to_numpy(), w, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(problem.loss[None], losses[-1], rtol=1e-12)


def test_another_sequence_of_steps():
    problem = learnt()
    w, v, _ = descend(ITERATIONS + 1, rates=[*RATES, 0.1])
    for it in range(12):
        problem.tape.replay()
        v = 0.5 * v + 2 * (w - TARGET)
        problem.push(0.5)
        for _ in range(1 + it // 4):
            problem.move(0.03)
            w = w - 0.03 * v
    np.testing.assert_allclose(problem.w.to_numpy(), w, rtol=1e-11, atol=1e-13)


def test_two_tapes_in_turns():
    init()
    one, two = Problem(), Problem(TARGET[::-1].copy())
    for it in range(ITERATIONS):
        for problem in (one, two):
            problem.tape.replay()
            problem.push(0.5)
            problem.move(RATES[it])
    assert counts(one.tape)[0] > ITERATIONS
    for problem, target in ((one, TARGET), (two, TARGET[::-1])):
        w, v, _ = descend(ITERATIONS, target, RATES)
        np.testing.assert_allclose(problem.w.to_numpy(), w, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(problem.v.to_numpy(), v, rtol=1e-12, atol=1e-13)


def test_recording_again_behind_a_step():
    problem = learnt()
    expected = expected_after_learning()
    other = ti.field(ti.f64, shape=(), needs_grad=True)
    w = problem.w

    @ti.kernel
    def cubes():
        for i in range(N):
            other[None] += w[i] ** 3

    with ti.ad.Tape(other):
        cubes()
    np.testing.assert_allclose(w.grad.to_numpy(), 3 * expected**2, rtol=1e-11)
    np.testing.assert_allclose(other[None], np.sum(expected**3), rtol=1e-11)


def test_an_exception_behind_a_step():
    problem = learnt()
    with pytest.raises((TypeError, ti.TaiError)):
        problem.move("fast")
    np.testing.assert_allclose(problem.w.to_numpy(), expected_after_learning(), rtol=1e-12)


def test_sums_in_scratch_memory():
    """A step with a sum of its own, and one that it is read from."""
    init()
    problem = Problem()
    norm = ti.field(ti.f64, shape=())
    w, v = problem.w, problem.v

    @ti.kernel
    def measure():
        total = 0.0
        for i in range(N):
            total += v[i] * v[i]
        norm[None] = total

    @ti.kernel
    def move(rate: ti.f64):
        for i in range(N):
            w[i] -= rate * v[i] / (1.0 + norm[None])

    here, speed = START.copy(), np.zeros(N)
    for it in range(ITERATIONS):
        problem.tape.replay()
        problem.push(0.5)
        measure()
        move(RATES[it])
        speed = 0.5 * speed + 2 * (here - TARGET)
        here = here - RATES[it] * speed / (1 + np.sum(speed**2))
    assert counts(problem.tape)[0] > 0
    np.testing.assert_allclose(w.to_numpy(), here, rtol=1e-12, atol=1e-13)
