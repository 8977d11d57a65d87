"""Launches whose elements no later launch brings to the loss: by fixed indices along any set of
dimensions, with the same bits as when they run."""

import random

import numpy as np
import pytest
import tai as ti

T, B = 6, 3


def counters():
    return ti.profiler.skips()["dead-launches"]


def place(layout, kind, n, *fields):
    """Fields of T + 1 x B x n elements."""
    if layout == "shape":
        ti.root.dense(ti.ijk, (T + 1, B, n)).place(*fields)
    elif layout == "soa":
        for field in fields:
            ti.root.dense(ti.ijk, (T + 1, B, n)).place(field)
    elif layout == "inner time":
        ti.root.dense(ti.k, n).dense(ti.j, B).dense(ti.i, T + 1).place(*fields)
    else:
        ti.root.pointer(ti.ij, (T + 1, B)).dense(ti.k, n).place(*fields)


class Program:
    """Kernels with arguments for indices, and sequences of their launches."""

    def __init__(self, layout, n, kind="scalar", **options):
        ti.init(default_fp=ti.f64, deterministic=True, **options)
        self.n = n
        if kind == "vector":
            x, y = ti.Vector.field(2, ti.f64), ti.Vector.field(2, ti.f64)
        else:
            x, y = ti.field(ti.f64), ti.field(ti.f64)
        # The gradient has its own place: that of sparse fields shares their cells.
        if layout == "pointer":
            place(layout, kind, n, x, x.grad, y, y.grad)
        else:
            place(layout, kind, n, x, y)
            ti.root.lazy_grad()
        loss = ti.field(ti.f64, shape=(), needs_grad=True)
        where = ti.field(ti.i32, shape=n)
        self.x, self.y, self.loss, self.where = x, y, loss, where
        one = ti.Vector([1.0, 0.5]) if kind == "vector" else 1.0

        @ti.func
        def part(value):
            result = 0.0
            if ti.static(kind == "vector"):
                result = value[0] * value[1]
            else:
                result = value * value
            return result

        @ti.kernel
        def step(t: ti.i32, b: ti.i32):
            for i in range(n):
                x[t + 1, b, i] = 0.9 * x[t, b, i] + 0.1 * ti.sin(x[t, b, (i + 1) % n])

        @ti.kernel
        def step_all(t: ti.i32):
            for b, i in ti.ndrange(B, n):
                x[t + 1, b, i] = x[t, b, i] + 0.1 * ti.exp(-x[t, b, i]) * x[t, (b + 1) % B, i]

        @ti.kernel
        def across(t: ti.i32, b: ti.i32, c: ti.i32):
            for i in range(n):
                y[t, b, i] += x[t, c, i] * x[t, b, i]

        @ti.kernel
        def back(t: ti.i32, s: ti.i32, b: ti.i32):
            for i in range(n):
                x[t, b, i] = 0.5 * y[s, b, i] + one

        @ti.kernel
        def in_place(t: ti.i32, b: ti.i32):
            for s, c, i in ti.ndrange((t, t + 1), (b, b + 1), n):
                x[s, c, i] *= 1.01

        @ti.kernel
        def scatter(t: ti.i32, b: ti.i32):
            for i in range(n):
                y[t, b, where[i]] += ti.cos(x[t, b, i])

        @ti.kernel
        def anywhere(t: ti.i32):
            for i in range(n):
                x[where[i] % (T + 1), 1, i] += 0.25 * y[t, where[i] % B, i]

        @ti.kernel
        def some(t: ti.i32, b: ti.i32, m: ti.i32):
            for c, i in ti.ndrange((b, b + 1), m):
                x[t, c, i] = 0.3 * one

        @ti.kernel
        def element(t: ti.i32):
            x[t, 2, 0] = x[t, 1, 0] * 1.5

        @ti.kernel
        def energy(t: ti.i32, b: ti.i32):
            for i in range(n):
                loss[None] += part(x[t, b, i])

        @ti.kernel
        def energy_of_range(t: ti.i32, b: ti.i32, c: ti.i32):
            for d, i in ti.ndrange((b, c), n):
                loss[None] += part(x[t, d, i])

        @ti.kernel
        def energy_of_next(t: ti.i32, b: ti.i32):
            for d, i in ti.ndrange((b, b + 1), n):
                loss[None] += part(x[t, d, i])

        @ti.kernel
        def energy_of_one(t: ti.i32):
            for d, i in ti.ndrange((1, 2), n):
                loss[None] += part(x[t, d, i])

        @ti.kernel
        def energy_of_none(t: ti.i32):
            for d, i in ti.ndrange((1, 1), n):
                loss[None] += part(x[t, d, i])

        @ti.kernel
        def energy_of_inner(t: ti.i32, b: ti.i32):
            for i in range(n):
                for d in range(b, b + 1):
                    for e in range(d, d + 1):
                        loss[None] += part(x[t, e, i])

        @ti.kernel
        def energy_of_two(t: ti.i32):
            for d, i in ti.ndrange((1, 3), n):
                loss[None] += part(x[t, d, i])

        @ti.kernel
        def energy_of_y(t: ti.i32):
            for b, i in ti.ndrange(B, n):
                loss[None] += part(y[t, b, i])

        self.step, self.step_all = step, step_all
        self.energy, self.energy_of_y = energy, energy_of_y
        # Losses on body 1, by ranges that have one iteration or none; and by other ranges.
        self.single = {
            "argument": lambda t: energy_of_next(t, 1), "inner": lambda t: energy_of_inner(t, 1),
            "constant": energy_of_one, "none": energy_of_none,
        }  # fmt: skip
        self.longer = {"two": energy_of_two, "unknown": lambda t: energy_of_range(t, 1, 2)}
        self.others = {
            "across": across, "back": back, "in_place": in_place, "scatter": scatter,
            "anywhere": anywhere, "some": some, "element": element,
        }  # fmt: skip

    def reset(self):
        rng = np.random.default_rng(5)
        self.x.from_numpy(rng.uniform(0.1, 1, self.x.to_numpy().shape))
        self.y.from_numpy(rng.uniform(0.1, 1, self.y.to_numpy().shape))
        self.where.from_numpy(rng.integers(0, self.n, self.n).astype(np.int32))

    def launch(self, sequence, writes):
        t_of, b_of = lambda: sequence.randrange(T), lambda: sequence.randrange(B)
        steps = {
            "step": lambda: self.step(t_of(), b_of()),
            "step_all": lambda: self.step_all(t_of()),
            "across": lambda: self.others["across"](t_of(), b_of(), b_of()),
            "back": lambda: self.others["back"](t_of(), t_of(), b_of()),
            "in_place": lambda: self.others["in_place"](t_of(), b_of()),
            "scatter": lambda: self.others["scatter"](t_of(), b_of()),
            "anywhere": lambda: self.others["anywhere"](t_of()),
            "some": lambda: self.others["some"](t_of(), b_of(), sequence.randrange(self.n + 1)),
            "element": lambda: self.others["element"](t_of()),
            "write": lambda: writes and self.x.__setitem__((t_of(), b_of(), 0), 0.7),
            "fill": lambda: writes and sequence.random() < 0.2 and self.y.fill(0.4),
        }  # fmt: skip
        names = sequence.choices(list(steps), k=3)
        for _ in range(30):
            steps[sequence.choice(names)]()
        if sequence.random() < 0.7:
            self.energy(t_of(), b_of())
        if sequence.random() < 0.5:
            self.energy_of_y(t_of())

    def run(self, number, writes=True, accumulates=False, **options):
        """The values and gradients of a random sequence."""
        sequence = random.Random(number)
        self.reset()
        with ti.ad.Tape(self.loss, **options):
            self.launch(sequence, writes)
        if accumulates:
            with ti.ad.Tape(self.loss, clear_gradients=False, **options):
                self.launch(sequence, writes)
        return [f.to_numpy() for f in (self.loss, self.x, self.y, self.x.grad, self.y.grad)]


def compare(programs):
    found = {}
    for skip in ("all", "all,-dead-launches"):
        found[skip] = programs(skip)
    skipped = 0
    for number, (on, off) in enumerate(zip(*found.values(), strict=True)):
        for a, b in zip(on[0], off[0], strict=True):
            assert np.isfinite(a).all()
            assert a.tobytes() == b.tobytes(), number
        skipped += on[1] - off[1]
    assert skipped > 0


def runs(program, count, **options):
    results = []
    for number in range(count):
        ti.profiler.clear_skips()
        values = program.run(number, **options)
        results.append((values, counters()["skipped"]))
    return results


LAYOUTS = [("shape", 1), ("soa", 37), ("inner time", 16), ("pointer", 37)]


@pytest.mark.parametrize("layout, n", LAYOUTS)
def test_random_sequences_have_the_same_bits(layout, n):
    compare(lambda skip: runs(Program(layout, n, skip=skip), 25))


OTHERWISE = [{"accumulates": True}, {"checkpoint": 3}, {"checkpoint": "periodic"}]


@pytest.mark.parametrize("options", OTHERWISE)
def test_random_sequences_have_the_same_bits_otherwise(options):
    def programs(skip):
        return runs(Program("shape", 37, skip=skip), 20, **options)

    compare(programs)


def test_vectors_on_two_threads_have_the_same_bits():
    compare(lambda skip: runs(Program("shape", 501, "vector", skip=skip, cpu_max_num_threads=2), 8))


def test_a_device_finds_the_same_bits(monkeypatch):
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    compare(lambda skip: runs(Program("shape", 37, skip=skip, arch=ti.cuda), 8))


# Sequences of known numbers


def steps_of(program, order):
    if order == "time first":
        return [(t, b) for t in range(T) for b in range(B)]
    return [(t, b) for b in range(B) for t in range(T)]


@pytest.mark.parametrize("order", ["time first", "bodies first"])
@pytest.mark.parametrize("layout", ["shape", "soa", "inner time"])
def test_a_loss_on_one_body_skips_the_others(layout, order):
    program = Program(layout, 37, skip="all")
    program.reset()
    with ti.ad.Tape(program.loss) as tape:
        for t, b in steps_of(program, order):
            program.step(t, b)
        program.energy(T, 1)
    assert counters() == {"recorded": T * B + 1, "replayed": T + 1, "skipped": T * (B - 1)}
    grad = program.x.grad.to_numpy()
    assert np.all(grad[0, 1] != 0)
    assert not grad[:, 0].any() and not grad[:, 2].any()
    # No launch changes elements that the adjoint of an earlier one reads.
    assert tape.stats().peak_bytes == 0


def gradient_of_steps(program, loss):
    program.reset()
    with ti.ad.Tape(program.loss):
        for t, b in steps_of(program, "time first"):
            program.step(t, b)
        loss(T)
    return program.x.grad.to_numpy().tobytes()


@pytest.mark.parametrize("name", ["constant", "argument", "inner", "none"])
def test_a_range_with_one_iteration_is_a_fixed_index(name):
    program = Program("shape", 37, skip="all")
    found = gradient_of_steps(program, program.single[name])
    assert counters() == {"recorded": T * B + 1, "replayed": T + 1, "skipped": T * (B - 1)}
    program = Program("shape", 37, skip="all,-dead-launches")
    assert found == gradient_of_steps(program, program.single[name])


@pytest.mark.parametrize("name", ["two", "unknown"])
def test_a_range_with_more_iterations_is_none(name):
    program = Program("shape", 37, skip="all")
    gradient_of_steps(program, program.longer[name])
    assert counters() == {"recorded": T * B + 1, "replayed": T * B + 1, "skipped": 0}


@pytest.mark.parametrize("when", [0, 1, T // 2, T])
def test_a_loss_at_some_time_skips_the_later_steps(when):
    program = Program("shape", 37, skip="all")
    program.reset()
    with ti.ad.Tape(program.loss):
        for t in range(T):
            program.step_all(t)
        program.energy(when, 1)
    assert counters() == {"recorded": T + 1, "replayed": when + 1, "skipped": T - when}


def test_a_whole_overwrite_ends_what_came_before():
    ti.init()
    a, b, c = (ti.field(ti.f64, shape=16, needs_grad=True) for _ in range(3))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def copy(scale: ti.f64):
        for i in a:
            b[i] = scale * a[i]

    @ti.kernel
    def use():
        for i in b:
            c[i] = b[i] * b[i]

    @ti.kernel
    def energy():
        for i in b:
            loss[None] += b[i]

    a.fill(1.0)
    with ti.ad.Tape(loss) as tape:
        copy(2.0)
        use()
        copy(3.0)
        energy()
    assert np.all(a.grad.to_numpy() == 3.0)
    lines = tape.explain().splitlines()
    assert [": skipped" in line for line in lines[:4]] == [True, True, False, False]


def test_a_seed_of_the_host_is_of_the_whole_field():
    program = Program("shape", 5, skip="all")
    program.reset()
    with ti.ad.Tape(None) as tape:
        for t, b in steps_of(program, "time first"):
            program.step(t, b)
    program.x.grad[2, 1, 0] = 1.0
    tape.grad()
    assert counters()["skipped"] == 0
    assert program.x.grad.to_numpy()[0, 1].any()


def test_explain_names_the_elements():
    program = Program("shape", 5, skip="all")
    program.reset()
    with ti.ad.Tape(program.loss) as tape:
        program.step(0, 1)
        program.step_all(2)
        program.energy(1, 0)
    lines = tape.explain().splitlines()
    assert "skipped: no adjoint reaches @" in lines[0] and "[1, 1, :]" in lines[0]
    assert "[3, :, :]" in lines[1]


def test_an_index_beyond_the_field_counts_as_any():
    ti.init()
    x = ti.field(ti.f64, shape=(4, 3), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(3):
            if t < 3:
                x[t + 1, i] = 2 * x[t, i]

    @ti.kernel
    def energy(t: ti.i32):
        for i in range(3):
            if t < 4:
                loss[None] += x[t, i]

    x.fill(1.0)
    with ti.ad.Tape(loss):
        for t in range(5):
            step(t)
        energy(7)
        energy(3)
    assert np.all(x.grad.to_numpy()[0] == 8.0)
