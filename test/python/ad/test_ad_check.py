"""`ti.ad.check` and `Tape(grad_check=…)` accept right gradients, catch wrong ones and name the
kernel at fault; all fields are restored."""

import inspect
import math

import numpy as np
import pytest
import tai as ti
import tai.testing
from tai._impl.ad import probe
from tai._impl.ad.probe import relative_error


class Chain:
    """y = sin(x) |v|, z = y exp(y), loss = sum of z²; with wrong gradients on demand."""

    def __init__(self, dtype=ti.f64):
        ti.init(default_fp=dtype, offline_cache=False)
        x = self.x = ti.field(dtype, shape=5, needs_grad=True)
        v = self.v = ti.Vector.field(3, dtype, shape=5, needs_grad=True)
        y = self.y = ti.field(dtype, shape=5, needs_grad=True)
        z = self.z = ti.field(dtype, shape=5, needs_grad=True)
        loss = self.loss = ti.field(dtype, shape=(), needs_grad=True)
        self.count = ti.field(ti.i32, shape=())

        @ti.kernel
        def first():
            for i in x:
                y[i] = ti.sin(x[i]) * v[i].norm()

        @ti.kernel
        def second():
            for i in y:
                z[i] = y[i] * ti.exp(y[i])

        @ti.kernel
        def third():
            for i in z:
                loss[None] += z[i] ** 2

        @ti.ad.grad_replaced
        def wrong_second():
            second()

        @ti.ad.grad_for(wrong_second)
        def gradient():
            second.grad()
            y.grad[3] = y.grad[3] * 1.001

        self.first, self.second, self.third = first, second, third
        self.wrong_second = wrong_second
        generator = np.random.default_rng(0)
        x.from_numpy(generator.uniform(0.2, 1, 5).astype(dtype.numpy))
        v.from_numpy(generator.uniform(-1, 1, (5, 3)).astype(dtype.numpy))

    def run(self):
        self.first()
        self.second()
        self.third()

    def run_wrong(self):
        self.first()
        self.wrong_second()
        self.third()

    def contents(self):
        fields = [self.x, self.v, self.y, self.z, self.loss]
        return [f.to_numpy().tobytes() + f.grad.to_numpy().tobytes() for f in fields]


def test_a_right_gradient_agrees():
    chain = Chain()
    before = chain.contents()
    result = ti.ad.check(chain.run, loss=chain.loss)
    assert result, str(result)
    assert [f.name for f in result.fields] == ["x", "v"]
    assert result.error < 1e-7
    for field in result.fields:
        differences = [p for p in field.probes if p.method == "differences"]
        assert len(differences) == 4
        assert [rung.step for rung in differences[0].ladder] == [10.0**-k for k in range(2, 11)]
    assert "agrees" in str(result)
    assert chain.contents() == before


def test_a_kernel_alone():
    chain = Chain()
    result = ti.ad.check(chain.second)
    assert result, str(result)
    assert [f.name for f in result.fields] == ["y"]


def test_a_kernel_with_arguments():
    chain = Chain()
    x, y = chain.x, chain.y

    @ti.kernel
    def scaled(a: ti.f64, n: ti.i32):
        for i in range(n):
            y[i] += a * x[i] ** 3

    result = ti.ad.check(scaled, 0.7, 4, wrt=x)
    assert result, str(result)


def test_a_tape():
    chain = Chain()
    with ti.ad.Tape(chain.loss) as tape:
        chain.run()
    before = chain.contents()
    assert ti.ad.check(tape)
    assert ti.ad.check(tape, wrt=[chain.v])
    assert chain.contents() == before


def test_a_tape_whose_start_is_gone():
    chain = Chain()
    with ti.ad.Tape(chain.loss) as tape:
        chain.run()
    chain.x.fill(0.123)
    with pytest.raises(ti.TaiRuntimeError, match="do not hold any more"):
        ti.ad.check(tape)


def test_random_numbers_of_a_tape_are_drawn_again():
    chain = Chain()
    x, loss = chain.x, chain.loss

    @ti.kernel
    def noisy():
        for i in x:
            loss[None] += x[i] ** 2 * ti.random(ti.f64)

    with ti.ad.Tape(loss) as tape:
        noisy()
    assert ti.ad.check(tape)
    with pytest.raises(ti.TaiRuntimeError, match="another result"):
        ti.ad.check(noisy, loss=loss)


def test_a_wrong_gradient_is_caught_and_located():
    chain = Chain()
    before = chain.contents()
    result = ti.ad.check(chain.run_wrong, loss=chain.loss)
    assert not result
    wrong = {f.name for f in result.fields if not f.passed}
    assert "x" in wrong
    assert 1e-5 < result.error < 1e-1
    culprit = result.culprit
    assert (culprit.record, culprit.kernel) == (1, "wrong_second")
    assert culprit.filename == __file__
    assert culprit.lineno == inspect.unwrap(chain.wrong_second).__code__.co_firstlineno
    assert [f.name for f in culprit.fields] == ["y"]
    text = str(result)
    assert "DISAGREES" in text
    assert "wrong_second" in text
    assert "1e-06" in text  # the ladder
    assert chain.contents() == before


def test_without_bisection():
    chain = Chain()
    result = ti.ad.check(chain.run_wrong, loss=chain.loss, bisect=False)
    assert not result
    assert result.culprit is None


def test_errors_below_the_bound_of_differences_pass():
    """The bound is the documented one, 1e-7."""
    chain = Chain()
    y, second = chain.y, chain.second
    for factor, expected in ((1e-9, True), (1e-5, False)):

        @ti.ad.grad_replaced
        def slightly_wrong():
            second()

        @ti.ad.grad_for(slightly_wrong)
        def gradient(factor=factor):
            second.grad()
            for i in range(5):
                y.grad[i] = y.grad[i] * (1 + factor)

        def run(inner=slightly_wrong):
            chain.first()
            inner()
            chain.third()

        assert bool(ti.ad.check(run, loss=chain.loss, bisect=False)) is expected


def test_a_gradient_that_is_missing_is_caught():
    chain = Chain()

    def run():
        chain.first()
        ti.ad.no_grad(chain.second)()
        chain.third()

    result = ti.ad.check(run, loss=chain.loss)
    assert not result
    assert result.culprit.kernel == "second"


def test_f32():
    chain = Chain(ti.f32)
    assert ti.ad.check(chain.run, loss=chain.loss)
    y, second = chain.y, chain.second

    @ti.ad.grad_for(chain.wrong_second)
    def gradient():
        second.grad()
        y.grad[3] = y.grad[3] * 1.5

    assert not ti.ad.check(chain.run_wrong, loss=chain.loss, bisect=False)


def test_kinks_and_jumps():
    chain = Chain()
    x, loss = chain.x, chain.loss
    x.fill(1.0)

    @ti.kernel
    def kink():
        for i in x:
            loss[None] += ti.max(x[i] - 1, 0) * 2 + x[i] ** 2

    @ti.kernel
    def jump():
        for i in x:
            if x[i] >= 1:
                loss[None] += x[i] + 3

    result = ti.ad.check(kink, loss=loss)
    assert result, str(result)
    assert result.fields[0].kink
    assert "a kink is suspected" in str(result)
    result = ti.ad.check(jump, loss=loss)
    assert not result
    assert any(p.jump for p in result.fields[0].probes)
    assert "jumps" in str(result)


def test_nan_is_never_right():
    chain = Chain()
    x, loss = chain.x, chain.loss
    x[2] = -1.0

    @ti.kernel
    def logarithm():
        for i in x:
            loss[None] += x[i] * ti.log(x[i])

    result = ti.ad.check(logarithm, loss=loss)
    assert not result
    assert "IS NAN" in str(result)


def test_what_is_overwritten_before_it_is_read_is_no_input():
    chain = Chain()
    result = ti.ad.check(chain.run, loss=chain.loss, wrt=[chain.x, chain.y])
    assert result
    assert result.fields[1].skipped == "it is overwritten before it is read"


def test_refusals():
    chain = Chain()
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes a kernel, a function or a tape"):
        ti.ad.check(3)
    with pytest.raises(ti.TaiRuntimeTypeError, match="wrt takes fields"):
        ti.ad.check(chain.run, loss=chain.loss, wrt=["x"])
    with pytest.raises(ti.TaiAutodiffError, match="not a float"):
        ti.ad.check(chain.run, loss=chain.loss, wrt=[chain.count])
    with pytest.raises(ti.TaiAutodiffError, match="nothing was launched"):
        ti.ad.check(lambda: None, loss=chain.loss)
    with (
        pytest.raises(ti.TaiRuntimeError, match="inside a tape"),
        ti.ad.Tape(chain.loss),
    ):
        ti.ad.check(chain.run, loss=chain.loss)
    assert ti.ad.check(chain.run, loss=chain.loss)  # and it works after all of this


class TestGradCheck:
    def test_passes(self, capsys):
        chain = Chain()
        with ti.ad.Tape(chain.loss, grad_check=[chain.x, chain.v]):
            chain.run()
        gradient = chain.x.grad.to_numpy()
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) == 2
        assert "'x' passes" in lines[0]
        with ti.ad.Tape(chain.loss):
            chain.run()
        assert chain.x.grad.to_numpy().tobytes() == gradient.tobytes()

    def test_raises(self):
        chain = Chain()
        with (
            pytest.raises(AssertionError, match="wrong_second") as caught,
            ti.ad.Tape(chain.loss, grad_check=[chain.x]),
        ):
            chain.run_wrong()
        assert caught.value.result.culprit.record == 1
        assert isinstance(caught.value, ti.TaiAutodiffError)

    def test_needs_a_list_of_f64(self):
        chain = Chain()
        with pytest.raises(ti.TaiRuntimeTypeError, match="list of fields"):
            ti.ad.Tape(chain.loss, grad_check=True)
        chain = Chain(ti.f32)
        with pytest.raises(ti.TaiAutodiffError, match="needs f64"):
            ti.ad.Tape(chain.loss, grad_check=[chain.x])


@pytest.mark.parametrize("derivatives", [(0.0, np.nan), (np.nan, 0.0), (np.inf, 0.0)])
def test_a_derivative_that_is_no_number_is_an_error(derivatives):
    """Beside a zero, whose scale is zero."""
    assert np.isnan(relative_error(*derivatives, 0.0))
    assert relative_error(0.0, 0.0, 0.0) == 0.0


# Nothing checked is a failure of the check


def unchecked(result, why):
    assert not result
    assert result.unchecked is not None and why in result.unchecked
    assert "NOT CHECKED" in str(result) and why in str(result)
    assert "agrees" not in str(result).splitlines()[0]
    with pytest.raises(ti.ad.GradientCheckError, match="NOT CHECKED"):
        result.raise_if_wrong()


def square_of(x, loss):
    @ti.kernel
    def square():
        for i in x:
            loss[None] += x[i] ** 2

    return square


def total_field(dtype=ti.f64, **options):
    return ti.field(dtype, shape=(), needs_grad=True, name="loss", **options)


@pytest.mark.parametrize("dual", [False, True])
def test_no_field_with_a_gradient_is_read(dual):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=3)
    loss = total_field(needs_dual=dual)
    unchecked(ti.ad.check(square_of(x, loss), loss=loss), "reads no field that has a gradient")


def test_only_half_precision_is_read():
    ti.init(default_fp=ti.f32, offline_cache=False)
    x = ti.field(ti.f16, shape=3, needs_grad=True, name="x")
    loss = total_field(ti.f32)
    for wrt in (None, [x]):
        result = ti.ad.check(square_of(x, loss), loss=loss, wrt=wrt)
        unchecked(result, "'x': differences need f64 or f32")
        assert not result.fields[0].passed


def test_all_that_is_read_was_overwritten():
    chain = Chain()

    @ti.kernel
    def overwrite():
        for i in chain.x:
            chain.x[i] = 2.0
        for i in chain.v:
            chain.v[i] = 3.0

    def run():
        overwrite()
        chain.run()

    unchecked(ti.ad.check(run, loss=chain.loss), "overwritten before it is read")
    unchecked(
        ti.ad.check(run, loss=chain.loss, wrt=[chain.x]), "it is overwritten before it is read"
    )


@pytest.mark.parametrize("dual", [False, True])
def test_the_loss_depends_on_nothing_that_is_checked(dual):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=3, needs_grad=True, needs_dual=dual, name="x")
    y = ti.field(ti.f64, shape=3, needs_grad=True, needs_dual=dual, name="y")
    loss = total_field(needs_dual=dual)

    @ti.kernel
    def constant():
        for i in x:
            loss[None] += ti.floor(x[i] + 0.25)

    @ti.kernel
    def round_all():
        for i in x:
            y[i] = ti.floor(x[i] + 0.25)

    unchecked(ti.ad.check(constant, loss=loss, wrt=[x]), "the loss does not depend on 'x' here")
    unchecked(ti.ad.check(round_all), "what it changes does not depend on 'x' here")


def test_no_element_is_there():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, name="x")
    ti.root.pointer(ti.i, 4).place(x, x.grad)
    loss = total_field()
    unchecked(ti.ad.check(square_of(x, loss), loss=loss, wrt=[x]), "none of its cells is active")


def test_a_minimum_is_checked():
    """The gradient is zero there, but the loss depends on the checked field."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = total_field()
    assert ti.ad.check(square_of(x, loss), loss=loss)


def test_a_tape_that_checks_nothing_raises():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=3, needs_grad=True, name="x")
    y = ti.field(ti.f64, shape=3, needs_grad=True, name="y")
    y.fill(1.0)
    loss = total_field()
    square = square_of(y, loss)
    with (
        pytest.raises(ti.ad.GradientCheckError, match="not depend on 'x'"),
        ti.ad.Tape(loss, grad_check=[x]),
    ):
        square()
    with ti.ad.Tape(loss, grad_check=[x, y]):
        square()


def test_a_loss_that_the_program_never_clears():
    """The kernel of the tutorial adds to the loss; each difference begins with 0."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=16, needs_grad=True, name="x")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")
    x.from_numpy(np.arange(16.0))

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += (x[i] - 3) ** 2

    measure()
    for run in (ti.ad.check, tai.testing.check_gradient):
        result = run(measure, loss=loss, wrt=[x])
        assert result and result.error < 1e-9, str(result)
    # The loss is put back, too.
    assert loss[None] == ((np.arange(16) - 3) ** 2).sum()


def test_a_heat_problem_whose_loss_is_never_cleared():
    ti.init(default_fp=ti.f64, offline_cache=False)
    n, steps = 32, 40
    u = ti.field(ti.f64, shape=(steps + 1, n), needs_grad=True, name="u")
    k = ti.field(ti.f64, shape=n, needs_grad=True, name="k")
    loss = total_field()
    u.from_numpy(np.zeros((steps + 1, n)))
    k.from_numpy(np.linspace(0.1, 0.3, n))
    for i in range(n):
        u[0, i] = np.sin(i / 3)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(1, n - 1):
            u[t + 1, i] = u[t, i] + k[i] * (u[t, i + 1] - 2 * u[t, i] + u[t, i - 1])

    @ti.kernel
    def total():
        for i in range(n):
            loss[None] += (u[steps, i] - 0.5) ** 2

    def run():
        for t in range(steps):
            step(t)
        total()

    run()
    result = tai.testing.check_gradient(run, loss=loss, wrt=[k])
    assert result, str(result)


def test_the_other_name():
    assert tai.testing.check_gradient is ti.ad.check
    ti.init(default_fp=ti.f64, offline_cache=False)
    loss = total_field()
    with pytest.raises(ti.TaiRuntimeTypeError, match="a kernel, a function or a tape") as caught:
        tai.testing.check_gradient(loss, [loss], lambda: None)
    assert "ti.ad.check(run, loss=loss, wrt=[x])" in caught.value.hint


# Rounding


def noisy_program(dtype, offset, wrong=1.0):
    """x² + offset - offset, with the rounding errors of the sum."""
    x = ti.field(dtype, shape=5, needs_grad=True, name="x")
    loss = ti.field(dtype, shape=(), needs_grad=True, name="loss")
    x.from_numpy(np.linspace(0.5, 1.5, 5).astype(dtype.numpy))

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += (x[i] ** 2 + offset) - offset

    @ti.ad.grad_replaced
    def run():
        measure()

    @ti.kernel
    def gradient():
        for i in x:
            x.grad[i] += 2 * x[i] * wrong * loss.grad[None]

    @ti.ad.grad_for(run)
    def backward():
        gradient()

    return x, loss, measure if wrong == 1.0 else run


@pytest.mark.parametrize("offset", [1e5, 1e7, 1e8, 1e9])
def test_rounding_noise_is_no_jump(offset):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss, run = noisy_program(ti.f64, offset)
    result = ti.ad.check(run, loss=loss, wrt=[x], directions=8)
    assert result, str(result)
    assert not any(p.jump for p in result.fields[0].probes)
    assert "jumps" not in str(result)


def test_rounding_noise_of_f32():
    ti.init(offline_cache=False)
    x, loss, run = noisy_program(ti.f32, 2000.0)
    result = ti.ad.check(run, loss=loss, wrt=[x], directions=8)
    assert result, str(result)
    assert not any(p.jump for p in result.fields[0].probes)


@pytest.mark.parametrize("offset, wrong", [(1e5, 1.00001), (1e7, 1.001), (1e8, 1.01), (1e9, 1.1)])
def test_noise_hides_no_greater_error(offset, wrong):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss, run = noisy_program(ti.f64, offset, wrong)
    result = ti.ad.check(run, loss=loss, wrt=[x], bisect=False)
    assert not result
    assert "jumps" not in str(result)


@pytest.mark.parametrize("height", [1e-4, 1.0])
def test_a_jump_among_noise(height):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=(), needs_grad=True, name="x")
    loss = total_field()
    x[None] = 1.0

    @ti.kernel
    def run():
        loss[None] += (x[None] ** 2 + 1e7) - 1e7
        if x[None] >= 1:
            loss[None] += height

    result = ti.ad.check(run, loss=loss, wrt=[x])
    assert not result
    assert all(p.jump for p in result.fields[0].probes if p.method == "differences")
    assert "jumps" in str(result)


def test_the_noise_of_a_function():
    generator = np.random.default_rng(2)
    assert probe.measure_noise(np.sin, 1e-6) < 1e-15
    found = [
        probe.measure_noise(lambda h: np.sin(h) + 1e-6 * generator.standard_normal(), 1e-6)
        for _ in range(200)
    ]
    assert 0.3e-6 < np.median(found) < 1e-6
    assert max(found) < 3e-6
    # Smooth on both sides of a jump; not a number.
    assert probe.measure_noise(lambda h: float(h >= 0), 1e-6) == 0
    assert probe.measure_noise(lambda h: np.nan, 1e-6) == 0


def test_elements_that_are_stored_by_one_launch_and_read_by_another():
    """Some of a field are inputs, and some are stored by the program before it reads them."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=(4, 3), needs_grad=True)
    x.fill(0.5)
    loss = total_field()

    @ti.kernel
    def step(t: ti.i32):
        for i in range(3):
            x[t + 1, i] = ti.sin(x[t, i])

    @ti.kernel
    def total():
        for i in range(3):
            loss[None] += x[3, i] * x[0, i]

    def run():
        for t in range(3):
            step(t)
        total()

    assert ti.ad.check(run, loss=loss, wrt=[x])
    assert ti.ad.check(run, loss=loss)


def test_programs_that_write_arrays_from_python():
    """The check records them, but they are no part of a tape."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    x.fill(0.5)
    weights = ti.ndarray(ti.f64, 3)
    loss = total_field()

    @ti.kernel
    def weigh(w: ti.types.ndarray()):
        for i in x:
            loss[None] += w[i] * ti.sin(x[i])

    def run():
        weights[1] = 2.0
        weigh(weights)

    assert ti.ad.check(run, loss=loss)


def test_functions_of_python_are_tried_near_the_present_point():
    """A run at another point shows which fields they change. The arc cosine ends at 1."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    y = ti.field(ti.f64, shape=3, needs_grad=True)
    x.fill(0.99)
    loss = total_field()

    @ti.kernel
    def add():
        for i in y:
            loss[None] += y[i] ** 2

    @ti.ad.grad_replaced
    def arcs():
        for i in range(3):
            y[i] = math.acos(x[i])

    @ti.ad.grad_for(arcs)
    def gradient():
        for i in range(3):
            x.grad[i] -= y.grad[i] / math.sqrt(1 - x[i] ** 2)

    def run():
        arcs()
        add()

    assert ti.ad.check(run, loss=loss)
