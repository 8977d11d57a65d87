"""Values that are overwritten: the tape saves some, and computes others again."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
DT = 0.1


@pytest.fixture(autouse=True)
def deterministic():
    ti.init(arch=ti.cpu, default_fp=ti.f64, deterministic=True)


def real_field(*shape):
    return ti.field(ti.f64, shape=shape, needs_grad=True)


class Pendulums:
    """x += dt v, v -= dt sin x, in place, with a sum of energies along the way."""

    def __init__(self, n=6, noise=False):
        self.n = n
        self.x, self.v = x, v = real_field(n), real_field(n)
        self.loss = loss = real_field()

        @ti.kernel
        def kick(weight: ti.f64):
            for i in x:
                v[i] -= DT * ti.sin(x[i]) * weight

        @ti.kernel
        def drift():
            for i in x:
                x[i] += DT * v[i]

        @ti.kernel
        def shake():
            for i in x:
                v[i] += ti.random() * x[i]

        @ti.kernel
        def energy():
            for i in x:
                loss[None] += v[i] * v[i] * (i + 1) - ti.cos(x[i])

        self.kick, self.drift, self.shake, self.energy = kick, drift, shake, energy
        self.noise = noise

    def start(self):
        self.x.from_numpy(0.3 + 0.2 * np.arange(self.n))
        self.v.from_numpy(np.linspace(-0.5, 0.4, self.n))

    def run(self, steps):
        for t in range(steps):
            self.kick(1 + 0.01 * t)
            if self.noise and t % 3 == 1:
                self.shake()
            self.drift()
            if t % 4 == 3:
                self.energy()
        self.energy()

    def gradient(self):
        return np.concatenate([self.x.grad.to_numpy(), self.v.grad.to_numpy()])

    def state(self):
        return np.concatenate([self.x.to_numpy(), self.v.to_numpy()])


def pendulum_gradient(x, v, factor, steps):
    """The derivative of the sum by the first x and v: a small forward mode."""
    x, v = (x, 1.0, 0.0), (v, 0.0, 1.0)

    def sine(a, scale):
        return [scale * math.sin(a[0])] + [scale * math.cos(a[0]) * d for d in a[1:]]

    total = np.zeros(2)

    def energy():
        nonlocal total
        total = total + [2 * factor * v[0] * v[k] + math.sin(x[0]) * x[k] for k in (1, 2)]

    for t in range(steps):
        v = [a - b for a, b in zip(v, sine(x, DT * (1 + 0.01 * t)), strict=True)]
        x = [a + DT * b for a, b in zip(x, v, strict=True)]
        if t % 4 == 3:
            energy()
    energy()
    return total


def expected(model, steps):
    x, v = 0.3 + 0.2 * np.arange(model.n), np.linspace(-0.5, 0.4, model.n)
    each = [pendulum_gradient(x[i], v[i], i + 1, steps) for i in range(model.n)]
    return np.array(each).T.ravel()


def test_state_without_time():
    model, steps = Pendulums(), 25
    model.start()
    with ti.ad.Tape(model.loss) as tape:
        model.run(steps)
    last = model.state()
    np.testing.assert_allclose(model.gradient(), expected(model, steps), rtol=1e-12)
    # Once more, from the saved values, and again after a forward replay.
    tape.grad()
    np.testing.assert_allclose(model.gradient(), expected(model, steps), rtol=1e-12)
    assert (model.state() == last).all()
    model.start()
    tape.replay()
    np.testing.assert_allclose(model.gradient(), expected(model, steps), rtol=1e-12)
    assert (model.state() == last).all()
    # x in each step, v where the energy has read it.
    reads = steps // 4
    assert tape.stats().saved_bytes == 8 * model.n * (steps + reads)
    assert "saved 48 B" in tape.explain()


def test_a_time_axis_saves_nothing():
    steps = 12
    x, loss = real_field(steps + 1, 4), real_field()

    @ti.kernel
    def advance(t: ti.i32):
        for i in range(4):
            x[t + 1, i] = ti.sin(x[t, i])

    @ti.kernel
    def total():
        for i in range(4):
            loss[None] += x[steps, i]

    for _ in range(2):  # the second time over old values
        x.fill(0.7)
        with ti.ad.Tape(loss) as tape:
            for t in range(steps):
                advance(t)
            total()
        assert tape.stats().peak_bytes == 0


def test_linear_updates_save_nothing():
    x, v, loss = real_field(4), real_field(4), real_field()

    @ti.kernel
    def drift():
        for i in x:
            x[i] += DT * v[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    with ti.ad.Tape(loss) as tape:
        for _ in range(10):
            drift()
        total()
    np.testing.assert_allclose(v.grad.to_numpy(), 10 * DT)
    assert tape.stats().peak_bytes == 0


def test_indices_and_masks_that_change():
    """Fields that select the stored elements are read in reverse as well."""
    x, y, loss = real_field(4), real_field(4), real_field()
    order = ti.field(ti.i32, shape=4)
    mask = ti.field(ti.i32, shape=4)

    @ti.kernel
    def turn():
        for i in order:
            order[i] = (i + 1) % 4
            mask[i] = 1 - i % 2

    @ti.kernel
    def gather(a: ti.f64):
        for i in x:
            y[i] += a * x[order[i]]

    @ti.kernel
    def cut():
        for i in y:
            if mask[i] == 1:
                y[i] = 0

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i]

    order.from_numpy(np.array([0, 0, 0, 0], np.int32))
    mask.from_numpy(np.array([1, 0, 0, 0], np.int32))
    with ti.ad.Tape(loss):
        gather(1.0)
        cut()  # y[0]
        turn()
        gather(10.0)
        cut()  # y[0] and y[2]
        total()
    # y[1], y[3]: 1 of x[0] each, and 10 of x[2] and x[0].
    assert x.grad.to_numpy().tolist() == [2 + 10, 0, 10, 0]


def test_writes_of_the_host():
    x, y, loss = real_field(3), real_field(3), real_field()
    u = ti.Vector.field(2, ti.f64, shape=3, needs_grad=True)

    @ti.kernel
    def square():
        for i in x:
            y[i] += x[i] * x[i] + u[i].norm_sqr()

    @ti.kernel
    def total():
        for i in x:
            loss[None] += y[i]

    x.from_numpy(np.array([1.0, 2, 3]))
    u.fill(1.0)
    with ti.ad.Tape(loss) as tape:
        square()
        x[1] = 5
        u[0] = [7, 8]
        square()
        x.fill(10)
        square()
        total()
    assert x.grad.to_numpy().tolist() == [4, 4, 12]
    assert u.grad.to_numpy().tolist() == [[2, 2], [6, 6], [6, 6]]
    assert x.to_numpy().tolist() == [10, 10, 10]
    assert loss[None] == 1 + 4 + 9 + 1 + 25 + 9 + 300 + 3 * 6 + 2 * (113 - 2)
    x.fill(2)
    u.fill(0)
    tape.replay()
    assert x.grad.to_numpy().tolist() == [8, 4, 8]


def schedules(n):
    root = math.isqrt(n)
    return [
        {"checkpoint": 1}, {"checkpoint": root}, {"checkpoint": n}, {"checkpoint": "periodic"},
        {"checkpoint": "binomial"}, {"checkpoint": "mixed"}, {"memory_budget": 900},
        {"memory_budget": 4000, "checkpoint": "periodic"},
    ]  # fmt: skip


@pytest.mark.parametrize("number", range(8))
@pytest.mark.parametrize("noise", [False, True])
def test_recomputed_gradients_are_the_same(number, noise):
    model, steps = Pendulums(noise=noise), 30
    ti.init(arch=ti.cpu, default_fp=ti.f64, deterministic=True, random_seed=7)
    model = Pendulums(noise=noise)
    results = []
    options = schedules(2 * steps)[number]
    for extra in ({}, options):
        model.start()
        get_seed(11)
        with ti.ad.Tape(model.loss, **extra) as tape:
            model.run(steps)
        results.append((model.gradient(), model.state(), model.loss[None]))
    (gradient, state, loss), (again, state_again, loss_again) = results
    assert np.abs(gradient).max() > 0
    assert (gradient == again).all()
    assert (state == state_again).all() and loss == loss_again
    stats = tape.stats()
    assert stats.recomputed > 0
    if "memory_budget" in options and "checkpoint" not in options:
        assert stats.peak_bytes <= options["memory_budget"]
    assert "recomputed" in tape.explain()
    # The tape can be used again.
    tape.grad()
    assert (gradient == model.gradient()).all()
    assert (state == model.state()).all()


def get_seed(seed):
    """Starts the random numbers anew."""
    from tai._impl.base import state

    state.program.context.set_option("seed", str(seed))


@pytest.mark.parametrize("snapshots", [2, 5, 20])
def test_recomputation_is_near_the_optimum(snapshots):
    model, steps = Pendulums(), 400
    model.start()
    with ti.ad.Tape(model.loss, checkpoint=snapshots) as tape:
        model.run(steps)
    stats = tape.stats()
    assert stats.snapshots <= snapshots
    # Each record runs once more than if the end had been known when it came.
    n = tape.num_records
    assert stats.optimum <= stats.recomputed <= stats.optimum + n
    # The memory holds snapshots, the end, and the values of one record.
    state = stats.snapshot_bytes
    assert state == 8 * (2 * model.n + 1)
    assert stats.peak_bytes <= 1.1 * (snapshots + 2) * state


def test_periodic_snapshots():
    model, steps = Pendulums(), 500
    model.start()
    with ti.ad.Tape(model.loss, checkpoint="periodic") as tape:
        model.run(steps)
    stats, n = tape.stats(), tape.num_records
    assert math.sqrt(n) / 2 <= stats.snapshots <= 2 * math.sqrt(n)
    assert stats.recomputed == n
    model.start()
    with ti.ad.Tape(model.loss) as tape:
        model.run(steps)
    everything = tape.stats().peak_bytes
    # The memory holds snapshots, the end, and the values saved in the longest segment.
    longest = 2 * n / stats.snapshots
    formula = (stats.snapshots + 1) * stats.snapshot_bytes + everything * longest / n
    assert stats.peak_bytes <= 1.1 * formula
    assert stats.peak_bytes < everything / 4


def test_a_budget_alone_is_kept_with_many_snapshots():
    """It asks for no number of them. A tape without options computes nothing again."""
    model = Pendulums()
    model.start()
    with ti.ad.Tape(model.loss) as tape:
        model.run(200)
    everything = tape.stats()
    assert everything.recomputed == everything.snapshots == 0
    model.start()
    with ti.ad.Tape(model.loss, memory_budget=everything.peak_bytes // 6) as tape:
        model.run(200)
    stats = tape.stats()
    assert stats.peak_bytes <= everything.peak_bytes // 6
    assert stats.snapshots > 10 and 0 < stats.recomputed < 1000


def test_budgets_that_are_too_small():
    model = Pendulums()
    model.start()
    with (
        pytest.raises(ti.TaiMemoryError, match="memory budget of 100 B is too small"),
        ti.ad.Tape(model.loss, memory_budget=100),
    ):
        model.run(5)
    # After the error, the next tape gives right gradients.
    model.start()
    with ti.ad.Tape(model.loss):
        model.run(5)
    np.testing.assert_allclose(model.gradient(), expected(model, 5), rtol=1e-12)


@pytest.mark.parametrize(
    "options, what",
    [
        ({"checkpoint": "often"}, "none of 'periodic'"),
        ({"checkpoint": 0}, "at least one snapshot"),
        ({"memory_budget": -3}, "holds nothing"),
        ({"memory_budget": 0.5}, "number of bytes"),
    ],
)
def test_options_that_make_no_sense(options, what):
    with pytest.raises(ti.TaiRuntimeTypeError, match=what):
        ti.ad.Tape(real_field(), **options)


def run_example(*options):
    command = [sys.executable, str(EXAMPLES / "in_place_springs.py"), *map(str, options)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = dict(line.split(None, 1) for line in done.stdout.replace("by ", "by_").splitlines())
    return rows, int(rows["memory"].split()[0])


def test_ten_thousand_steps_in_place():
    saving, everything = run_example()
    budget, kept = run_example("--by", "budget", "--budget", 50_000)
    for key in ("loss", "by_rest", "by_x[0]"):
        assert saving[key] == budget[key]
    assert kept <= 50_000 < everything / 20
    assert int(budget["recomputed"]) > 0


def test_recomputing_by_hand():
    saving, _ = run_example("--steps", 400)
    hand, _ = run_example("--steps", 400, "--by", "hand")
    assert saving["loss"] == hand["loss"]
    for key in ("by_rest", "by_x[0]"):
        numbers = [np.array(rows[key].split(), float) for rows in (saving, hand)]
        np.testing.assert_allclose(*numbers, rtol=1e-9)


def complex_step(function, start):
    """The gradient of a numpy function of one array."""
    result = np.zeros(start.shape)
    for index in np.ndindex(*start.shape):
        point = start.astype(complex)
        point[index] += 1e-30j
        result[index] = function(point).imag / 1e-30
    return result


@pytest.mark.parametrize("options", [{}, {"checkpoint": 2}, {"checkpoint": "periodic"}])
@pytest.mark.parametrize("which", ["square", "clamp", "row", "loops", "scale"])
def test_kernels_that_overwrite_what_they_read(which, options):
    n = 4
    x, loss = real_field(n), real_field()

    @ti.kernel
    def square(t: ti.f64):
        for i in x:
            x[i] = x[i] * x[i] * t

    @ti.kernel
    def clamp(t: ti.f64):
        for i in x:
            if x[i] * t > 1.0:
                x[i] = ti.sin(x[i])

    @ti.kernel
    def row(t: ti.f64):
        ti.loop_config(serialize=True)
        for i in range(1, n):
            x[i] = x[i] * x[i - 1] + t

    @ti.kernel
    def loops(t: ti.f64):
        for i in x:
            x[i] = x[i] * x[i] * t
        for i in x:
            x[i] = ti.sin(x[i])

    @ti.kernel
    def scale(t: ti.f64):
        for i in x:
            x[i] *= t

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] * x[i] * (i + 1)

    def in_numpy(values):
        z = values.copy()
        for t in times:
            if which == "square":
                z = z * z * t
            elif which == "clamp":
                z = np.where(z.real * t > 1.0, np.sin(z), z)
            elif which == "row":
                for i in range(1, n):
                    z[i] = z[i] * z[i - 1] + t
            elif which == "loops":
                z = np.sin(z * z * t)
            else:
                z = z * t
        return (z * z * np.arange(1, n + 1)).sum()

    kernel = {"square": square, "clamp": clamp, "row": row, "loops": loops, "scale": scale}[which]
    times = [1.1, 0.9, 1.2, 1.05]
    start = np.array([0.7, 1.3, 0.4, 1.1])
    x.from_numpy(start)
    with ti.ad.Tape(loss, **options) as tape:
        for t in times:
            kernel(t)
        total()
    wanted = complex_step(in_numpy, start)
    assert loss[None] == pytest.approx(in_numpy(start), rel=1e-13)
    np.testing.assert_allclose(x.grad.to_numpy(), wanted, rtol=1e-11)
    x.from_numpy(start)
    tape.replay()
    np.testing.assert_allclose(x.grad.to_numpy(), wanted, rtol=1e-11)


def test_slots_that_are_read_before_they_are_written():
    """Each step reads a value that the last run left in the slot, and then writes the slot."""
    steps = 8
    x, weight, loss = real_field(steps), real_field(), real_field()

    @ti.kernel
    def advance(t: ti.i32):
        for _ in range(1):
            x[t] = x[t - 1] + 0.3

    @ti.kernel
    def control(t: ti.i32):
        for _ in range(1):
            loss[None] += ti.tanh(weight[None] * x[t]) * x[t - 1]

    old = np.sin(np.arange(steps))
    x.from_numpy(old)
    weight[None] = 0.7
    with ti.ad.Tape(loss):
        for t in range(1, steps):
            control(t)
            advance(t)
    new = 0.3 * np.arange(steps)
    slopes = 1 / np.cosh(0.7 * old[1:]) ** 2 * old[1:] * new[:-1]
    assert weight.grad[None] == pytest.approx(slopes.sum(), rel=1e-13)


def test_overwriting_by_hand_needs_a_tape():
    x = real_field(3)

    @ti.kernel
    def square():
        for i in x:
            x[i] = x[i] * x[i]

    square()
    with pytest.raises(ti.TaiRuntimeError, match="needs values that the kernel itself overwrites"):
        square.grad()
