"""The health report: chaos, flat landscapes, NaN and overflow are named with their kernels."""

import inspect
import math
import warnings
from fractions import Fraction

import numpy as np
import pytest
import tai as ti


class Logistic:
    """x[t + 1] = 4 x[t] (1 - x[t]), one kernel for each step."""

    def __init__(self, dtype=ti.f64, steps=100):
        ti.init(default_fp=dtype, offline_cache=False)
        x = self.x = ti.field(dtype, shape=steps + 1, needs_grad=True)
        loss = self.loss = ti.field(dtype, shape=(), needs_grad=True)

        @ti.kernel
        def step(t: ti.i32):
            for _ in range(1):
                x[t + 1] = 4 * x[t] * (1 - x[t])

        @ti.kernel
        def last(n: ti.i32):
            loss[None] += x[n]

        self.step, self.last = step, last

    def run(self, n, **options):
        self.x[0] = 0.3125  # exact in binary
        with ti.ad.Tape(self.loss, **options) as tape:
            for t in range(n):
                self.step(t)
            self.last(n)
        return tape


def logistic_derivative(n):
    """By rational numbers, rounded to 400 bits at each step."""
    bits = 400
    x, slope = Fraction(5, 16), Fraction(1)
    for _ in range(n):
        x, slope = 4 * x * (1 - x), slope * 4 * (1 - 2 * x)
        x = Fraction(round(x * 2**bits), 2**bits)
        slope = Fraction(round(slope * 2**bits), 2**bits)
    return float(slope)


@pytest.mark.parametrize(("n", "bound"), [(20, 1e-9), (40, 1e-4)])
def test_chaos_is_right_while_it_can_be(n, bound):
    program = Logistic()
    program.run(n)
    assert program.x.grad[0] == pytest.approx(logistic_derivative(n), rel=bound)


@pytest.mark.parametrize("n", [20, 40, 100])
def test_chaos_is_flagged(n):
    program = Logistic()
    report = program.run(n, health=True).health()
    assert not report
    step = next(k for k in report.kernels if k.kernel == "step")
    assert step.replays == n
    assert step.growth == pytest.approx(math.log(2), abs=0.1)
    finding = next(f for f in report.findings if f.kind == "growth")
    assert finding.kernel == "step"
    assert finding.filename == __file__
    # The field has a time axis: each row of the report is the norm of one step's slab.
    assert [row.record for row in report.rows[:3]] == [n, n - 1, n - 2]
    assert report.rows[0].norm == 1.0


def test_what_contracts_is_healthy():
    program = Logistic()
    x, loss = program.x, program.loss

    @ti.kernel
    def decay(t: ti.i32):
        for _ in range(1):
            x[t + 1] = 0.9 * x[t]

    x[0] = 1.0
    with ti.ad.Tape(loss, health=True) as tape:
        for t in range(50):
            decay(t)
        program.last(50)
    report = tape.health()
    assert report, str(report)
    decay_row = next(k for k in report.kernels if k.kernel == "decay")
    assert decay_row.growth == pytest.approx(math.log(0.9), abs=1e-6)
    assert "good" in str(report)


def test_overflow_in_f32():
    program = Logistic(ti.f32, 200)
    report = program.run(200, health=True).health()
    assert any(f.kind in ("overflow", "nan") for f in report.findings)
    assert report.first_nan.kernel == "step"


def test_asked_for_afterwards():
    """Without health=True the sweep runs once more, and the gradients stay."""
    program = Logistic()
    tape = program.run(30)
    before = program.x.grad.to_numpy().tobytes()
    later = tape.health()
    assert program.x.grad.to_numpy().tobytes() == before
    now = program.run(30, health=True).health()
    assert later.to_dict() == now.to_dict()


def make_fields():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=3, needs_grad=True, name="x")
    y = ti.field(ti.f64, shape=3, needs_grad=True, name="y")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")
    return x, y, loss


def test_flat():
    """Balls that do not meet: the loss is not zero, and its gradient is exactly zero."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    steps = 16
    start = ti.Vector.field(2, ti.f64, shape=(), needs_grad=True, name="start")
    position = ti.Vector.field(2, ti.f64, shape=(steps, 2), needs_grad=True, name="position")
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def begin():
        position[0, 0] = start[None]
        position[0, 1] = ti.Vector([1.0, 0.5])

    @ti.kernel
    def move(t: ti.i32):
        for i in range(2):
            d = position[t - 1, 1] - position[t - 1, 0]
            push = ti.Vector([0.0, 0.0])
            if d.norm() < 0.1:
                push = d * (2 * i - 1)
            position[t, i] = position[t - 1, i] + push

    @ti.kernel
    def miss(t: ti.i32):
        loss[None] += (position[t, 1] - ti.Vector([0.75, 0.5])).norm_sqr()

    with ti.ad.Tape(loss, health=True) as tape:
        begin()
        for t in range(1, steps):
            move(t)
        miss(steps - 1)
    assert loss[None] == 0.0625
    assert start.grad[None][0] == 0.0
    report = tape.health()
    assert not report
    assert report.flat == ["start"]
    assert "the loss does not depend on 'start'" in str(report)


def test_nan_is_traced_to_its_kernel_and_line():
    x, y, loss = make_fields()

    @ti.kernel
    def inner():
        for i in x:
            scaled = 2 * x[i]
            y[i] = scaled * ti.log(x[i])

    @ti.kernel
    def outer():
        for i in y:
            loss[None] += y[i] if i != 1 else 3 * x[i]

    x.from_numpy(np.array([1.0, 2.0, -1.0]))
    with ti.ad.Tape(loss, health=True) as tape:
        inner()
        outer()
    report = tape.health()
    finding = report.first_nan
    lines, start = inspect.getsourcelines(inner.__wrapped__)
    log_line = start + next(n for n, text in enumerate(lines) if "ti.log" in text)
    assert (finding.record, finding.kernel) == (0, "inner")
    assert finding.filename == __file__
    assert finding.lineno == log_line
    rows = [row for row in report.rows if row.nans]
    assert rows[0].kernel == "inner"
    assert rows[0].field == "x"
    assert rows[0].nans == 1
    assert "NaN" in str(report)
    first = next(f.message for f in report.findings if "adjoint of 'x'" in f.message)
    assert "; the kernel reads or changes what is not finite: 'y'; suspects" in first


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_field_that_is_not_finite_at_the_start_is_named(bad):
    """Once, with its element, the kernel that reads it and its line; a gradient or none."""
    x, y, loss = make_fields()
    w = ti.field(ti.f64, shape=(3, 2))

    @ti.kernel
    def weigh():
        for i in x:
            y[i] = x[i] * w[i, 1]

    @ti.kernel
    def add():
        for i in y:
            loss[None] += y[i]

    def sweep():
        with ti.ad.Tape(loss):
            weigh()
            add()

    x.fill(1)
    w.fill(2)
    w[0, 0] = bad  # nobody reads it
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sweep()
    w[2, 1] = bad
    line = weigh.__wrapped__.__code__.co_firstlineno
    with pytest.warns(ti.ad.TaiGradientWarning, match="the loss") as said:
        sweep()
    assert len(said) == 1
    assert said[0].filename == __file__
    text = str(said[0].message)
    assert f"held {bad} when the tape began, at [2, 1]" in text
    assert "kernel 'weigh' (" in text and f":{line}) reads it" in text
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(10):
            sweep()


def test_a_kernel_that_leaves_what_is_not_finite_is_named():
    x, y, loss = make_fields()

    @ti.kernel
    def root():
        for i in x:
            y[i] = ti.log(x[i])

    @ti.kernel
    def add():
        for i in y:
            loss[None] += y[i]

    x.from_numpy(np.array([1.0, -2.0, 3.0]))
    with pytest.warns(ti.ad.TaiGradientWarning) as said, ti.ad.Tape(loss):
        root()
        add()
    text = str(said[0].message)
    assert "the loss" in text and "itself is nan" in text and "kernel 'root'" in text
    line = root.__wrapped__.__code__.co_firstlineno + 3
    assert f"; suspects: line {line}: y[i] = ti.log(x[i])" in text


def test_a_kernel_that_reads_a_gradient_as_data_is_named_for_its_own_mistake():
    """The gradient was zero as the tape began; the sweep has put NaN there."""
    x, y, loss = make_fields()

    @ti.kernel
    def root():
        for i in x:
            y[i] = ti.sqrt(x[i]) + x.grad[i]

    @ti.kernel
    def add():
        for i in y:
            loss[None] += y[i]

    x.from_numpy(np.array([1.0, -2.0, 3.0]))
    with pytest.warns(ti.ad.TaiGradientWarning) as said, ti.ad.Tape(loss):
        root()
        add()
    text = str(said[0].message)
    assert "the loss" in text and "itself is nan" in text and "kernel 'root'" in text
    assert "when the tape began" not in text


def test_a_kernel_without_suspects_names_none():
    x, y, loss = make_fields()

    @ti.kernel
    def square():
        for i in x:
            y[i] = x[i] * x[i]

    @ti.kernel
    def add():
        for i in y:
            loss[None] += y[i] - y[i]

    x.fill(1e300)  # the square of it overflows
    with pytest.warns(ti.ad.TaiGradientWarning) as said, ti.ad.Tape(loss):
        square()
        add()
    text = str(said[0].message)
    assert "kernel 'square'" in text and "suspects" not in text


def test_host_functions_are_examined():
    x, y, loss = make_fields()

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    @ti.ad.grad_replaced
    def custom():
        total()

    @ti.ad.grad_for(custom)
    def gradient():
        x.grad[1] = float("nan")

    with ti.ad.Tape(loss, health=True) as tape:
        custom()
    report = tape.health()
    assert report.first_nan.kernel == "custom"
    assert y.grad[0] == 0.0


@pytest.mark.parametrize("shape", [(), 1, 3, (2, 1)])
@pytest.mark.parametrize("watched", [False, True])
def test_parameters_of_any_shape(shape, watched):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=shape, needs_grad=True, name="x")
    y = ti.field(ti.f64, shape=shape, needs_grad=True, name="y")
    unused = ti.field(ti.f64, shape=shape, needs_grad=True, name="unused")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")

    @ti.kernel
    def square():
        for index in ti.grouped(y):
            y[index] = x[index] * x[index] + 0 * ti.floor(unused[index])

    @ti.kernel
    def square_of_one():
        y[None] = x[None] * x[None] + 0 * ti.floor(unused[None])

    @ti.kernel
    def total():
        for index in ti.grouped(y):
            loss[None] += y[index]

    @ti.kernel
    def total_of_one():
        loss[None] += y[None]

    x.fill(2.0)
    with ti.ad.Tape(loss, health=watched) as tape:
        square_of_one() if shape == () else square()
        total_of_one() if shape == () else total()
    report = tape.health()
    assert report.flat == ["unused"]
    assert {row.field for row in report.rows} >= {"x", "y"}
    x.fill(0.0)
    with ti.ad.Tape(loss, health=watched) as tape:
        square_of_one() if shape == () else square()
        total_of_one() if shape == () else total()
    assert sorted(tape.health().flat) == ["unused", "x"]


def chaos_in_one_kernel(dtype, trips, form):
    """The logistic map inside one kernel; the tape, the field of the start, and the line."""
    ti.init(default_fp=dtype, offline_cache=False)
    x = ti.field(dtype, shape=5, needs_grad=True)
    y = ti.field(dtype, shape=5, needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)

    @ti.kernel
    def into_loss(n: ti.i32):
        for i in x:
            v = x[i]
            for _ in range(n):
                v = 4 * v * (1 - v)
            loss[None] += v

    @ti.kernel
    def into_field(n: ti.i32):
        for i in x:
            v = x[i]
            for _ in range(n):
                v = 4 * v * (1 - v)
            y[i] = v

    @ti.kernel
    def add():
        for i in y:
            loss[None] += y[i]

    x.from_numpy(np.linspace(0.2, 0.7, 5).astype(x.to_numpy().dtype))
    with ti.ad.Tape(loss) as tape:
        if form == "loss":
            into_loss(trips)
        else:
            into_field(trips)
            add()
    return tape, x


@pytest.mark.parametrize("form", ["loss", "field"])
@pytest.mark.parametrize("dtype, trips", [(ti.f64, 100), (ti.f32, 60)])
def test_chaos_inside_one_kernel_is_flagged(dtype, trips, form):
    tape, x = chaos_in_one_kernel(dtype, trips, form)
    assert np.abs(x.grad.to_numpy()).max() > 1e15
    report = tape.health()
    [found] = report.findings
    assert found.kind == "growth" and not report
    assert found.kernel == f"into_{form}" and found.filename == __file__
    assert "rounding 'x' alone changes the loss" in found.message


@pytest.mark.parametrize("form", ["loss", "field"])
@pytest.mark.parametrize("dtype, trips", [(ti.f64, 10), (ti.f32, 8)])
def test_a_short_loop_is_no_chaos(dtype, trips, form):
    tape, _ = chaos_in_one_kernel(dtype, trips, form)
    assert tape.health().findings == []


@pytest.mark.parametrize("offset", [0.0, 1e-3])
def test_large_factors_are_no_chaos(offset):
    ti.init(default_fp=ti.f32)
    x = ti.field(ti.f32, shape=7, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def stiff(offset: ti.f32):
        for i in x:
            loss[None] += (1e7 * (x[i] + offset)) ** 2

    x.fill(0.75)
    with ti.ad.Tape(loss) as tape:
        stiff(offset)
    assert x.grad[3] > 1e14
    assert tape.health().findings == []
