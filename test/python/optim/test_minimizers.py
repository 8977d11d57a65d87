"""L-BFGS, Gauss-Newton and SciPy's methods on fields."""

import gc
import pickle
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import tai as ti
from scipy import optimize


class Rosenbrock:
    """Its minimum is 0 at (1, 1, …)."""

    def __init__(self, n=2, dtype=ti.f64):
        self.x = x = ti.field(dtype, shape=n, needs_grad=True, needs_dual=True)
        self.loss = loss = ti.field(dtype, shape=(), needs_grad=True, needs_dual=True)
        self.r = r = ti.field(dtype, shape=2 * n - 2, needs_grad=True, needs_dual=True)

        @ti.kernel
        def compute():
            for i in range(n - 1):
                loss[None] += (1 - x[i]) ** 2 + 100 * (x[i + 1] - x[i] ** 2) ** 2

        @ti.kernel
        def residuals():
            for i in range(n - 1):
                r[2 * i] = 1 - x[i]
                r[2 * i + 1] = 10 * (x[i + 1] - x[i] ** 2)

        self.compute, self.residuals = compute, residuals
        self.start = np.where(np.arange(n) % 2, 1.0, -1.2)
        x.from_numpy(self.start.astype(x.dtype.numpy))

    def record(self):
        with ti.ad.Tape(self.loss) as tape:
            self.compute()
        return tape


@pytest.mark.parametrize("n", [2, 3, 64])
def test_lbfgs_of_rosenbrock(n):
    ti.init()
    p = Rosenbrock(n)
    result = ti.optim.LBFGS([p.x]).minimize(p.record(), max_iterations=500, gtol=1e-8)
    assert result.converged and result.reason == "gradient"
    np.testing.assert_allclose(p.x.to_numpy(), optimize.rosen(np.ones(n)) + 1, rtol=1e-6)
    assert result.loss == p.loss[None]
    reference = optimize.minimize(
        optimize.rosen, p.start, jac=optimize.rosen_der, method="L-BFGS-B",
        options={"gtol": 1e-8, "ftol": 0},
    )  # fmt: skip
    assert result.evaluations < 2 * reference.nfev


def test_lbfgs_in_f32():
    ti.init()
    p = Rosenbrock(2, ti.f32)
    result = ti.optim.LBFGS(p.x).minimize(p.record(), gtol=1e-3)
    assert result.converged
    np.testing.assert_allclose(p.x.to_numpy(), 1, rtol=1e-2)


def test_lbfgs_of_an_ill_conditioned_quadratic():
    ti.init()
    n = 100
    x = ti.Vector.field(2, ti.f64, shape=(n // 4), needs_grad=True)
    y = ti.ndarray(ti.f64, n // 2, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def compute(y: ti.types.ndarray()):
        for i in x:
            for c in ti.static(range(2)):
                loss[None] += 0.5 * 10 ** (4.0 * (2 * i + c) / n) * (x[i][c] - 1) ** 2
        for i in range(y.shape[0]):
            loss[None] += 0.5 * 10 ** (4.0 * (i + n // 2) / n) * (y[i] - 2) ** 2

    with ti.ad.Tape(loss) as tape:
        compute(y)
    result = ti.optim.LBFGS([x, y], history=20).minimize(tape, max_iterations=1000, gtol=1e-7)
    assert result.reason == "gradient"
    np.testing.assert_allclose(x.to_numpy(), 1, atol=1e-6)
    np.testing.assert_allclose(y.to_numpy(), 2, atol=1e-6)


def test_lbfgs_of_a_function_and_steps():
    ti.init()
    p = Rosenbrock(2)

    def evaluate():
        with ti.ad.Tape(p.loss):
            p.compute()
        return p.loss[None]

    optimizer = ti.optim.LBFGS(p.x)
    losses = [optimizer.step(evaluate).loss for _ in range(60)]
    assert all(b <= a for a, b in zip(losses, losses[1:], strict=False))
    assert losses[-1] < 1e-10


def test_lbfgs_steps_over_a_singularity():
    # log is not finite for x <= 0, where the first long step ends.
    ti.init()
    x = ti.field(ti.f64, shape=1, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def compute():
        for i in x:
            loss[None] += 1e3 * x[i] - ti.log(x[i])

    x[0] = 0.01
    with ti.ad.Tape(loss) as tape:
        compute()
    result = ti.optim.LBFGS(x).minimize(tape, gtol=1e-6)
    assert result.converged
    assert x[0] == pytest.approx(1e-3, rel=1e-6)
    x[0] = -1.0
    with pytest.raises(ti.TaiAutodiffError, match="the loss is -?nan at the start"):
        ti.optim.LBFGS(x).minimize(tape)
    assert x[0] == -1


def test_lbfgs_goes_on_from_its_state():
    ti.init()
    p = Rosenbrock(8)
    tape = p.record()
    first = ti.optim.LBFGS(p.x, history=5)
    first.minimize(tape, max_iterations=12)
    middle, state = p.x.to_numpy(), pickle.loads(pickle.dumps(first.state_dict()))
    first.minimize(tape, max_iterations=5)
    expected = p.x.to_numpy()
    p.x.from_numpy(middle)
    second = ti.optim.LBFGS(p.x, history=5)
    second.load_state_dict(state)
    second.minimize(tape, max_iterations=5)
    np.testing.assert_allclose(p.x.to_numpy(), expected, rtol=1e-8)
    with pytest.raises(ti.TaiRuntimeTypeError, match="belongs to 8 numbers"):
        ti.optim.LBFGS(p.r).load_state_dict(state)


@pytest.mark.parametrize("n", [2, 16])
def test_gauss_newton_of_rosenbrock(n):
    ti.init()
    p = Rosenbrock(n)
    result = ti.optim.GaussNewton([p.x], p.r).minimize(p.residuals)
    assert result.converged
    np.testing.assert_allclose(p.x.to_numpy(), 1, rtol=1e-5)


@pytest.mark.parametrize("as_tape", [False, True])
def test_gauss_newton_fits_a_curve(as_tape):
    # y = a exp(-b t) + c, with noise: SciPy's answer.
    ti.init()
    t = np.linspace(0, 4, 40)
    rng = np.random.default_rng(3)
    data = 2.5 * np.exp(-1.3 * t) + 0.5 + 0.05 * rng.normal(size=40)
    a = ti.Vector.field(2, ti.f64, shape=(), needs_grad=True, needs_dual=True)
    c = ti.field(ti.f64, shape=1, needs_grad=True, needs_dual=True)
    r = ti.field(ti.f64, shape=40, needs_grad=True, needs_dual=True)
    times, values = ti.field(ti.f64, shape=40), ti.field(ti.f64, shape=40)
    times.from_numpy(t)
    values.from_numpy(data)

    @ti.kernel
    def fit():
        for i in r:
            r[i] += a[None][0] * ti.exp(-a[None][1] * times[i]) + c[0] - values[i]

    a[None] = [1.0, 0.5]
    function = fit
    if as_tape:
        with ti.ad.Tape() as function:
            fit()
    result = ti.optim.GaussNewton([a, c], [r]).minimize(function)
    reference = optimize.least_squares(
        lambda p: p[0] * np.exp(-p[1] * t) + p[2] - data, [1, 0.5, 0], method="lm", xtol=1e-14
    )
    assert result.converged
    np.testing.assert_allclose([*a.to_numpy(), c[0]], reference.x, rtol=1e-6)
    assert result.loss == pytest.approx(reference.cost, rel=1e-9)


def test_gauss_newton_of_residuals_with_a_pole():
    ti.init()
    x = ti.field(ti.f64, shape=1, needs_grad=True, needs_dual=True)
    r = ti.field(ti.f64, shape=1, needs_grad=True, needs_dual=True)

    @ti.kernel
    def compute():
        for i in x:
            r[i] = ti.log(x[i]) + 3

    x[0] = 10.0  # The first full step leads to negative numbers.
    result = ti.optim.GaussNewton(x, r, damping=1e-9).minimize(compute)
    assert result.converged
    assert x[0] == pytest.approx(np.exp(-3), rel=1e-6)
    x[0] = -1.0
    with pytest.raises(ti.TaiAutodiffError, match="the loss is -?nan at the start"):
        ti.optim.GaussNewton(x, r).minimize(compute)


def test_gauss_newton_is_at_the_minimum():
    ti.init()
    p = Rosenbrock(2)
    p.x.fill(1)
    optimizer = ti.optim.GaussNewton(p.x, p.r)
    result = optimizer.minimize(p.residuals)
    assert (result.reason, result.iterations) == ("gradient", 0)
    state = pickle.loads(pickle.dumps(optimizer.state_dict()))
    optimizer.load_state_dict(state)


def test_gauss_newton_where_squares_underflow():
    """There the loss is zero, and no step can make it less."""
    ti.init()
    x = ti.field(ti.f64, shape=1, needs_grad=True, needs_dual=True)
    r = ti.field(ti.f64, shape=1, needs_grad=True, needs_dual=True)

    @ti.kernel
    def compute():
        r[0] = x[0]

    x[0] = 1e-170
    result = ti.optim.GaussNewton(x, r).minimize(compute, gtol=0)
    assert result.loss == 0 and abs(x[0]) <= 1e-170


@pytest.mark.parametrize("count", [0, 1, 3])
def test_as_many_iterations_as_are_allowed(count):
    ti.init()
    p = Rosenbrock(4)
    result = ti.optim.LBFGS([p.x]).minimize(p.record(), max_iterations=count)
    assert (result.iterations, result.reason) == (count, "iterations")
    q = Rosenbrock(4)
    result = ti.optim.GaussNewton(q.x, q.r).minimize(q.residuals, max_iterations=count)
    assert (result.iterations, result.reason) == (count, "iterations")


@pytest.mark.parametrize("method", ["L-BFGS-B", "BFGS", "CG", "Newton-CG", "trust-ncg"])
def test_scipy(method):
    ti.init()
    p = Rosenbrock(4)
    result = ti.optim.scipy_minimize(p.record(), [p.x], method=method, tol=1e-10)
    np.testing.assert_allclose(p.x.to_numpy(), 1, rtol=1e-3)
    np.testing.assert_array_equal(p.x.to_numpy(), result.x)


def test_scipy_with_bounds_and_arrays():
    ti.init()
    x = ti.Vector.ndarray(2, ti.f32, 2, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def compute(x: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += (x[i] - 2.0).norm_sqr()

    with ti.ad.Tape(loss) as tape:
        compute(x)
    ti.optim.scipy_minimize(tape, x, bounds=[(0, 1)] * 3 + [(None, None)])
    np.testing.assert_allclose(x.to_numpy(), [[1, 1], [1, 2]], rtol=1e-5)


def test_refusals():
    ti.init()
    x = ti.field(ti.f32, shape=3, needs_grad=True, name="x")
    r = ti.field(ti.f32, shape=3, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    many = ti.field(ti.f32, shape=2, needs_grad=True, name="many")
    array = ti.ndarray(ti.f32, 3, needs_grad=True)
    sparse = ti.field(ti.f32, name="sparse")
    ti.root.pointer(ti.i, 4).place(sparse)
    ti.root.lazy_grad()

    @ti.kernel
    def compute():
        for i in x:
            loss[None] += x[i] ** 2

    with ti.ad.Tape(loss) as tape:
        compute()
    with ti.ad.Tape() as free:
        compute()
    kind = ti.TaiRuntimeTypeError
    cases = [
        (lambda: ti.optim.LBFGS(sparse), ti.TaiRuntimeError, "'sparse' is sparse"),
        (lambda: ti.optim.LBFGS(x, history=0), kind, "history must be"),
        (lambda: ti.optim.LBFGS(x).minimize(free), kind, "a tape with one loss"),
        (lambda: ti.optim.LBFGS(x).minimize(3), kind, "takes a tape or a function, but got 3"),
        (lambda: ti.optim.LBFGS(x).minimize(lambda: many), kind, "the loss must be one number"),
        (lambda: ti.optim.GaussNewton(array, r), kind, "arrays have no tangents"),
        (lambda: ti.optim.GaussNewton(x, r), ti.TaiAutodiffError, "'x' has no dual"),
        (lambda: ti.optim.GaussNewton(r, many), ti.TaiAutodiffError, "'many' has no dual"),
        (lambda: ti.optim.scipy_minimize(tape, sparse), ti.TaiRuntimeError, "is sparse"),
        (lambda: ti.optim.scipy_minimize(tape, x, jac=True), kind, "gives 'jac' to SciPy"),
        (
            lambda: ti.optim.scipy_minimize(tape, x, method="trust-ncg"),
            ti.TaiAutodiffError,
            "needs second derivatives",
        ),
    ]
    for call, error, message in cases:
        with pytest.raises(error, match=message):
            call()
    for minimize in (ti.optim.LBFGS(x).minimize, lambda f: ti.optim.scipy_minimize(f, x)):
        with pytest.raises(kind, match="got kernel 'compute'") as caught:
            minimize(compute)
        assert "with ti.ad.Tape(loss) as tape: compute()" in caught.value.hint
        with pytest.raises(kind, match="one number, but got None") as caught:
            minimize(lambda: None)
        assert "run a tape in the function" in caught.value.hint
    with pytest.raises(ti.TaiAutodiffError, match="while a tape records"), ti.ad.Tape(loss):
        ti.optim.LBFGS(x).minimize(compute)


@pytest.mark.parametrize("form", ["tape", "function", "array", "component"])
@pytest.mark.parametrize("user", ["LBFGS", "scipy_minimize", "Adam", "SGD"])
def test_a_loss_among_the_parameters(user, form):
    ti.init()
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    x.fill(2)
    whole = ti.Vector.field(2, ti.f64, shape=(), needs_grad=True, layout=ti.Layout.SOA)
    loss = {
        "array": ti.ndarray(ti.f64, (), needs_grad=True),
        "component": whole.get_scalar_field(1),
    }.get(form, ti.field(ti.f64, shape=(), needs_grad=True, name="loss"))

    @ti.kernel
    def compute():
        for i in x:
            loss[None] += x[i] ** 2

    @ti.kernel
    def compute_array(out: ti.types.ndarray()):
        for i in x:
            out[None] += x[i] ** 2

    def record():
        with ti.ad.Tape(loss) as tape:
            compute_array(loss) if form == "array" else compute()
        return tape

    def run():
        record()
        return loss

    given = [x, whole if form == "component" else loss]
    with pytest.raises(ti.TaiAutodiffError, match="is a parameter and also the loss") as caught:
        if user in ("Adam", "SGD"):
            optimizer = getattr(ti.optim, user)(given, lr=0.1)
            run()
            optimizer.step()
        elif user == "LBFGS":
            ti.optim.LBFGS(given).minimize(run if form == "function" else record())
        else:
            ti.optim.scipy_minimize(run if form == "function" else record(), given)
    assert f"ti.optim.{user}" in str(caught.value)
    assert (x.to_numpy() == 2).all()
    # Without the loss all of them work.
    if user in ("Adam", "SGD"):
        optimizer = getattr(ti.optim, user)([x], lr=0.1)
        optimizer.step()
        assert (x.to_numpy() < 2).all()
    elif user == "LBFGS":
        assert ti.optim.LBFGS([x]).minimize(record()).loss < 1e-8
    else:
        assert ti.optim.scipy_minimize(record(), [x]).fun < 1e-8


@pytest.mark.parametrize("user", ["LBFGS", "scipy_minimize"])
def test_a_function_whose_gradient_is_zero(user):
    """A tape that ran is noted even if it has left zeros in all gradients."""
    ti.init()
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def compute():
        for i in x:
            loss[None] += x[i] ** 2 + 1

    def run():
        with ti.ad.Tape(loss):
            compute()
        return loss

    if user == "LBFGS":
        assert ti.optim.LBFGS([x]).minimize(run).loss == 3
    else:
        assert ti.optim.scipy_minimize(run, [x]).fun == 3


def test_a_state_that_is_seeded_may_be_a_parameter():
    """Only losses of one number are set to zero: a state may be the input and the output."""
    ti.init()
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    x.fill(1)

    @ti.kernel
    def double():
        for i in x:
            x[i] *= 2

    with ti.ad.Tape(x, seed=np.ones(3)):
        double()
    ti.optim.SGD([x], lr=0.5).step()
    assert (x.to_numpy() == 1).all()


def test_a_residual_among_the_parameters():
    ti.init()
    x = ti.Vector.field(2, ti.f64, shape=3, needs_grad=True, needs_dual=True, layout=ti.Layout.SOA)
    for residuals in (x, [x], x.get_scalar_field(1)):
        with pytest.raises(ti.TaiAutodiffError, match="is a parameter and also a residual"):
            ti.optim.GaussNewton([x], residuals)
    one, other = x.get_scalar_field(0), x.get_scalar_field(1)
    ti.optim.GaussNewton([one], other)  # They share no element.


@pytest.mark.parametrize("user", ["LBFGS", "scipy_minimize"])
def test_functions_without_a_gradient(user):
    """Zeros, or the gradient of an earlier tape, must not be taken for that of the function."""
    ti.init()
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    minimize = {
        "LBFGS": lambda f: ti.optim.LBFGS(x).minimize(f),
        "scipy_minimize": lambda f: ti.optim.scipy_minimize(f, x),
    }[user]

    @ti.kernel
    def compute():
        for i in x:
            loss[None] += (x[i] - i - 1) ** 2

    def measure():
        loss[None] = 0
        compute()
        return loss[None]

    for earlier in (False, True):
        if earlier:
            with ti.ad.Tape(loss):
                compute()
        with pytest.raises(ti.TaiAutodiffError, match="ran no tape, so its loss has no gradient"):
            minimize(measure)
        assert not x.to_numpy().any()

    def by_hand():
        value = measure()
        x.grad.fill(0)
        loss.grad[None] = 1
        compute.grad()
        return value

    minimize(by_hand)
    np.testing.assert_allclose(x.to_numpy(), [1, 2, 3], rtol=1e-6)
    # At a minimum the gradient is zero, and the tape says so.
    with ti.ad.Tape(loss) as tape:
        compute()

    def again():
        tape.replay()
        return loss[None]

    minimize(again)
    np.testing.assert_allclose(x.to_numpy(), [1, 2, 3], rtol=1e-6)


PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "optimizers.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.parametrize("number", range(5))
def test_programs_of_the_page(number, tmp_path):
    assert len(PROGRAMS) == 5
    if "torch" in PROGRAMS[number]:
        pytest.importorskip("torch", reason="the program needs torch")
    file = tmp_path / "program.py"
    file.write_text(PROGRAMS[number])
    subprocess.run([sys.executable, "-W", "error::UserWarning", str(file)], check=True)


@pytest.mark.parametrize(
    "method, options, error",
    [
        (ti.optim.LBFGS, {}, "a tape with one loss"),
        (ti.optim.LBFGS, {"gtol": -1.0}, "a tape with one loss"),
        (ti.optim.GaussNewton, {"gtol": -1.0}, "gtol"),
        (ti.optim.GaussNewton, {}, "not finite"),
    ],
)
def test_no_word_about_the_tape_of_a_minimisation_that_failed(method, options, error):
    ti.init()
    p = Rosenbrock()
    p.x.fill(float("nan"))
    with ti.ad.Tape() as tape:
        p.residuals()
    made = method([p.x], [p.r]) if method is ti.optim.GaussNewton else method([p.x])
    with warnings.catch_warnings(record=True) as seen:
        with pytest.raises(ti.TaiError, match=error):
            made.minimize(tape, **options)
        del tape
        gc.collect()
    assert not seen


def test_no_word_about_the_own_tape_of_a_minimisation_that_failed():
    ti.init()
    p = Rosenbrock()
    p.x.fill(float("nan"))
    method = ti.optim.GaussNewton([p.x], [p.r])
    with warnings.catch_warnings(record=True) as seen:
        with pytest.raises(ti.TaiError, match="not finite"):
            method.minimize(p.residuals)
        gc.collect()
    assert not seen
