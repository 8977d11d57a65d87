"""Gradients against central differences: f64, a ladder of steps, accepted at 1e-7."""

from fractions import Fraction

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def scalar_loss():
    return ti.field(ti.f64, shape=(), needs_grad=True, name="loss")


def ternary(x, y):
    return x * x if x < 0.5 else ti.exp(y)


# Functions of a number in (0.2, 0.9) and a second one in (1.1, 1.9). Plain Python functions
# are traced, a `ti.func` is compiled.
SCALAR = {
    "sum": lambda x, y: x + y * 3 - x * y,
    "quotient": lambda x, y: x / y + 1 / x,
    "powers": lambda x, y: x**2 + x**-1 + x**3.5 + y**x + x**0.5,
    "trigonometry": lambda x, y: ti.sin(x) * ti.cos(y) + ti.tan(x) + ti.tanh(y),
    "inverse": lambda x, y: ti.asin(x) + ti.acos(x * 0.5) + ti.atan2(x, y),
    "exponentials": lambda x, y: ti.exp(x) * ti.log(y) + ti.sqrt(x) + ti.rsqrt(y),
    "extremes": lambda x, y: ti.max(x, y * 0.5) + ti.min(x, y, 0.7) + abs(x - y),
    "select": lambda x, y: ti.select(x > 0.5, x * x, ti.sin(y)),
    "rounding": lambda x, y: x * ti.floor(y * 3) + ti.ceil(x) * y + ti.round(y) * x,
    "remainder": lambda x, y: (7.3 * x) % y + (7.3 * x) // y * x,
    "ternary": ti.func(ternary),
    "clamp": lambda x, y: ti.math.clamp(x * 2, 0.5, 1.5) * y + ti.math.mix(x, y, 0.3),
    "cast": lambda x, y: x * ti.cast(y * 10, int) + ti.cast(ti.cast(x * 10, ti.i32), float) * y,
}


@pytest.mark.parametrize("name", SCALAR)
def test_functions_of_numbers(name):
    function = SCALAR[name]
    x = ti.field(ti.f64, shape=7, needs_grad=True)
    y = ti.field(ti.f64, shape=7, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += (i + 1) * function(x[i], y[i])

    generator = np.random.default_rng(2)
    x.from_numpy(generator.uniform(0.2, 0.9, 7))
    y.from_numpy(generator.uniform(1.1, 1.9, 7))

    def run():
        loss[None] = 0
        kernel()

    assert ti.ad.check(run, loss=loss, wrt=[x, y])


@pytest.mark.parametrize("mode", ["reverse", "forward"])
def test_remainder_just_below_a_multiple(mode):
    """The quotient rounds to the next whole number; the remainder, which is exact, does not."""
    generator = np.random.default_rng(0)
    divisors = generator.uniform(1.0, 2.0, 500)
    numbers = divisors * generator.integers(2, 60, 500)
    wholes = [int(Fraction(a) // Fraction(b)) for a, b in zip(numbers, divisors, strict=True)]
    assert sum(np.trunc(numbers / divisors) != wholes) > 50
    x = ti.field(ti.f64, shape=500)
    y = ti.field(ti.f64, shape=500, needs_grad=True, needs_dual=True)
    rest = ti.field(ti.f64, shape=500, needs_grad=True, needs_dual=True)
    x.from_numpy(numbers)
    y.from_numpy(divisors)

    @ti.kernel
    def remainder():
        for i in x:
            rest[i] = ti.raw_mod(x[i], y[i])

    if mode == "reverse":
        rest.grad.fill(1.0)
        remainder.grad()
        found = y.grad
    else:
        with ti.ad.FwdMode(loss=rest, param=y, seed=[1.0] * 500):
            remainder()
        found = rest.dual
    np.testing.assert_array_equal(found.to_numpy(), -np.array(wholes))


@pytest.mark.parametrize(("dtype", "at"), [(ti.f64, 1e-100), (ti.f32, 1e-12)])
def test_negative_powers_of_small_numbers(dtype, at):
    """If the value and the derivative are finite, all intermediate results are finite, too."""
    x = ti.field(dtype, shape=(), needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)

    @ti.kernel
    def power():
        loss[None] += x[None] ** -2

    x[None] = at
    with ti.ad.Tape(loss):
        power()
    assert loss[None] == pytest.approx(x[None] ** -2.0, rel=1e-6)
    assert x.grad[None] == pytest.approx(-2 * x[None] ** -3.0, rel=1e-6)


MATRIX = {
    "arithmetic": lambda a, u: (a * a + 2 * a - 1 / (a + 5)).sum(),
    "product": lambda a, u: (a @ a @ u).dot(u),
    "transpose": lambda a, u: (a.transpose() @ a).trace(),
    "determinant": lambda a, u: a.determinant() ** 2,
    "inverse": lambda a, u: (a.inverse() @ u).dot(u),
    "norm": lambda a, u: u.norm() + a.norm() + u.norm(0.5),
    "normalized": lambda a, u: (a @ u.normalized())[0] + u.normalized(0.1)[1],
    "outer": lambda a, u: (u.outer_product(a @ u) * a).sum(),
    "components": lambda a, u: a[0, 1] * u[1] + a[1, :].dot(u) + u.yx.x,
    "functions": lambda a, u: (ti.sin(a) * ti.exp(a * 0.3)).sum() + ti.sqrt(u * u + 1).sum(),
    "extremes": lambda a, u: a.max() * u.min() + ti.max(u, 0.3).sum(),
    "built": lambda a, u: ti.Matrix([[u[0], a[0, 0]], [1.0, u[1]]]).determinant(),
    "solve": lambda a, u: ti.solve(a, u).dot(u),
}


@pytest.mark.parametrize("name", MATRIX)
def test_functions_of_matrices(name):
    function = MATRIX[name]
    a = ti.Matrix.field(2, 2, ti.f64, shape=5, needs_grad=True)
    u = ti.Vector.field(2, ti.f64, shape=5, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def kernel():
        for i in a:
            loss[None] += (i + 1) * function(a[i], u[i])

    generator = np.random.default_rng(3)
    a.from_numpy(generator.uniform(-1, 1, (5, 2, 2)) + 2 * np.eye(2))
    u.from_numpy(generator.uniform(0.2, 1, (5, 2)))

    def run():
        loss[None] = 0
        kernel()

    assert ti.ad.check(run, loss=loss, wrt=[a, u])


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("name", ["polar", "svd"])
def test_decompositions(name, size):
    a = ti.Matrix.field(size, size, ti.f64, shape=4, needs_grad=True)
    w = ti.Matrix.field(size, size, ti.f64, shape=4)
    loss = scalar_loss()

    @ti.kernel
    def polar():
        for i in a:
            r, s = ti.polar_decompose(a[i])
            loss[None] += (r * w[i]).sum() + (s * w[i]).norm()

    @ti.kernel
    def singular():
        for i in a:
            u, sigma, v = ti.svd(a[i])
            loss[None] += (sigma * w[i]).sum() + (u @ v.transpose() * w[i]).sum()

    generator = np.random.default_rng(4)
    a.from_numpy(generator.standard_normal((4, size, size)) + np.diag(np.arange(1, size + 1)))
    w.from_numpy(generator.standard_normal((4, size, size)))
    kernel = polar if name == "polar" else singular

    def run():
        loss[None] = 0
        kernel()

    assert ti.ad.check(run, loss=loss, wrt=[a])


def test_branches():
    x = ti.field(ti.f64, shape=20, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def kernel():
        for i in x:
            v = x[i]
            if v > 0:
                if v > 0.5:
                    v = v * v
                else:
                    v = ti.sqrt(v)
                loss[None] += v
            else:
                v = ti.sin(v) * 2
            loss[None] += v * (i + 1)

    x.from_numpy(np.random.default_rng(5).uniform(-1, 1, 20))

    def run():
        loss[None] = 0
        kernel()

    assert ti.ad.check(run, loss=loss, wrt=[x])


def test_untaken_branch_leaks_nothing():
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += ti.sqrt(x[i]) if x[i] > 0 else 0.0
            loss[None] += ti.select(x[i] > 0, ti.sqrt(x[i]), 0.0)

    x.from_numpy(np.array([-1.0, 0.0, 4.0]))
    with ti.ad.Tape(loss):
        kernel()
    assert x.grad.to_numpy().tolist() == [0, 0, 0.5]


def test_serial_loops():
    x = ti.field(ti.f64, shape=6, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def kernel():
        for i in x:
            total = 0.0
            for j in range(i + 1):
                total += x[j] * x[i]
            for j in range(3):
                for k in range(j):
                    total += x[k] * (j + k)
            loss[None] += total

    x.from_numpy(np.random.default_rng(6).uniform(0.5, 1.5, 6))

    def run():
        loss[None] = 0
        kernel()

    assert ti.ad.check(run, loss=loss, wrt=[x])


def test_linear_gather_and_scatter():
    n = 8
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    y = ti.field(ti.f64, shape=n, needs_grad=True)
    to = ti.field(ti.i32, shape=n)
    loss = scalar_loss()

    @ti.kernel
    def scatter():
        for i in x:
            y[to[i]] += x[i] * x[(i + 1) % n]

    @ti.kernel
    def energy():
        for i in y:
            loss[None] += y[i] ** 2

    generator = np.random.default_rng(7)
    x.from_numpy(generator.uniform(-1, 1, n))
    to.from_numpy(generator.integers(0, n, n).astype(np.int32))

    def run():
        loss[None] = 0
        y.fill(0)
        scatter()
        energy()

    assert ti.ad.check(run, loss=loss, wrt=[x])


def test_time_steps():
    steps = 30
    x = ti.Vector.field(2, ti.f64, shape=steps, needs_grad=True)
    v = ti.Vector.field(2, ti.f64, shape=steps, needs_grad=True)
    k = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def step(t: ti.i32, dt: ti.f64):
        for _ in range(1):
            force = -k[None] * x[t - 1] * x[t - 1].norm()
            v[t] = v[t - 1] + dt * force
            x[t] = x[t - 1] + dt * v[t]

    @ti.kernel
    def finish():
        loss[None] = (x[steps - 1] - ti.Vector([0.3, -0.2])).norm_sqr()

    x[0], v[0], k[None] = [1.0, 0.5], [0.0, 1.0], 2.0

    def run():
        for t in range(1, steps):
            step(t, 0.05)
        finish()

    assert ti.ad.check(run, loss=loss, wrt=[k])
    with ti.ad.Tape(loss):
        run()
    first = x.grad[0].to_numpy(), v.grad[0].to_numpy()
    for field, gradient in zip((x, v), first, strict=True):
        for component in range(2):
            start = field[0][component]
            values = []
            for h in (1e-5, -1e-5):
                field[0][component] = start + h
                run()
                values.append(loss[None])
            field[0][component] = start
            assert (values[0] - values[1]) / 2e-5 == pytest.approx(gradient[component], rel=1e-7)


def test_local_sums_have_gradients():
    x = ti.field(ti.f64, shape=10, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def kernel():
        total = 0.0
        for i in x:
            total += x[i] * x[i]
        loss[None] = total * 0.5

    x.from_numpy(np.linspace(-1, 2, 10))
    with ti.ad.Tape(loss):
        kernel()
    np.testing.assert_allclose(x.grad.to_numpy(), x.to_numpy(), rtol=1e-14)


def test_kernel_grad():
    x = ti.field(ti.f64, shape=4, needs_grad=True)
    y = ti.field(ti.f64, shape=4, needs_grad=True)

    @ti.kernel
    def kernel(a: ti.f64):
        for i in x:
            y[i] = a * x[i] ** 2

    x.from_numpy(np.arange(4.0))
    kernel(3.0)
    y.grad.fill(1)
    kernel.grad(3.0)
    assert x.grad.to_numpy().tolist() == [0, 6, 12, 18]
    ti.ad.clear_all_gradients()
    assert x.grad.to_numpy().tolist() == [0] * 4


def test_methods_have_gradients():
    @ti.data_oriented
    class Model:
        def __init__(self):
            self.x = ti.field(ti.f64, shape=3, needs_grad=True)
            self.loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def energy(self, a: ti.f64):
            for i in self.x:
                self.loss[None] += a * self.x[i] ** 3

    model = Model()
    model.x.from_numpy(np.array([1.0, 2, 3]))
    with ti.ad.Tape(model.loss):
        model.energy(2.0)
    assert model.x.grad.to_numpy().tolist() == [6, 24, 54]
    ti.clear_all_gradients()
    model.loss.grad[None] = 1
    model.energy.grad(1.0)
    assert model.x.grad.to_numpy().tolist() == [3, 12, 27]


def test_no_grad():
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def add(a: ti.f64):
        loss[None] += a * x[None]

    @ti.ad.no_grad
    def silent():
        add(10.0)

    x[None] = 2
    with ti.ad.Tape(loss):
        add(1.0)
        silent()
        add(3.0)
    assert loss[None] == 28 and x.grad[None] == 4


def test_custom_gradient():
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = scalar_loss()
    calls = []

    @ti.kernel
    def add(a: ti.f64):
        loss[None] += a * x[None]

    @ti.ad.grad_replaced
    def forward(a):
        add(a)

    @ti.ad.grad_for(forward)
    def backward(a):
        calls.append(a)
        add.grad(100 * a)

    x[None] = 2
    with ti.ad.Tape(loss):
        forward(1.0)
        forward(a=2.0)
    assert loss[None] == 6 and x.grad[None] == 300
    assert calls == [2.0, 1.0]


def test_custom_gradient_of_a_method():
    @ti.data_oriented
    class Model:
        def __init__(self):
            self.x = ti.field(ti.f64, shape=(), needs_grad=True)
            self.loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def add(self, a: ti.f64):
            self.loss[None] += a * self.x[None]

        @ti.ad.complex_kernel
        def forward(self, a):
            self.add(a)

        @ti.ad.complex_kernel_grad(forward)
        def backward(self, a):
            self.add.grad(-a)

    model = Model()
    with ti.ad.Tape(model.loss):
        model.forward(5.0)
    assert model.x.grad[None] == -5


def test_missing_custom_gradient():
    loss = scalar_loss()

    @ti.ad.grad_replaced
    def forward():
        pass

    with pytest.raises(ti.TaiAutodiffError, match="grad_for"), ti.ad.Tape(loss):
        forward()


def test_replay():
    steps = 5
    x = ti.field(ti.f64, shape=steps, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def step(t: ti.i32):
        for _ in range(1):
            x[t] = x[t - 1] ** 2 + 0.1 * t

    @ti.kernel
    def finish():
        loss[None] = x[steps - 1]

    def run():
        for t in range(1, steps):
            step(t)
        finish()

    def record(start):
        x[0] = start
        with ti.ad.Tape(loss) as tape:
            run()
        return tape, loss[None], x.grad[0]

    tape, _, _ = record(0.4)
    for start in (0.3, 0.7):
        x[0] = start
        tape.replay()
        replayed = loss[None], x.grad[0]
        _, value, gradient = record(start)
        assert replayed == (value, gradient)
    assert tape.num_records == steps
    assert "step" in tape.explain()


def test_a_replay_inside_of_another_tape_is_refused_before_it_changes_anything():
    x, loss = ti.field(float, 3, needs_grad=True), ti.field(float, (), needs_grad=True)

    @ti.kernel
    def square():
        for i in x:
            loss[None] += x[i] ** 2

    x.fill(3)
    with ti.ad.Tape(loss) as first:
        square()
    with ti.ad.Tape(loss) as second:
        square()
        x.grad.fill(7)
        with pytest.raises(
            ti.TaiRuntimeError, match="replayed while another one records"
        ) as caught:
            first.replay()
        assert "after the `with` block" in caught.value.hint
        assert x.grad.to_numpy().tolist() == [7] * 3
    # A tape clears gradients where it begins.
    assert x.grad.to_numpy().tolist() == [7 + 6] * 3 and loss[None] == 27
    x.fill(2)
    for tape in (first, second):
        tape.replay()
        assert x.grad.to_numpy().tolist() == [4] * 3 and loss[None] == 12


def test_replay_runs_custom_gradients():
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def square():
        loss[None] += x[None] ** 2

    @ti.ad.grad_replaced
    def forward():
        square()

    @ti.ad.grad_for(forward)
    def backward():
        square.grad()

    x[None] = 3
    with ti.ad.Tape(loss) as tape:
        forward()
    assert x.grad[None] == 6
    x[None], loss[None] = 5, 0
    tape.replay()
    assert loss[None] == 25 and x.grad[None] == 10


def test_error_inside_a_tape_leaves_no_tape():
    loss = scalar_loss()
    with pytest.raises(ZeroDivisionError), ti.ad.Tape(loss):
        _ = 1 / 0
    with ti.ad.Tape(loss):
        pass


def test_error_in_a_custom_gradient():
    loss = scalar_loss()

    @ti.ad.grad_replaced
    def forward():
        pass

    @ti.ad.grad_for(forward)
    def backward():
        raise KeyError("lost")

    with pytest.raises(KeyError, match="lost"), ti.ad.Tape(loss):
        forward()


def test_gradients_are_cleared_by_the_tape():
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def kernel():
        loss[None] = x[None] * 3

    for _ in range(3):
        with ti.ad.Tape(loss):
            kernel()
    assert x.grad[None] == 3
    with ti.ad.Tape(loss, clear_gradients=False):
        kernel()
    assert x.grad[None] == 6


def test_kinks():
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)
    u = ti.Vector.field(3, ti.f64, shape=(), needs_grad=True)
    loss = scalar_loss()

    def gradient(function, fields):
        @ti.kernel
        def kernel():
            loss[None] = function(x[None], y[None], u[None])

        with ti.ad.Tape(loss):
            kernel()
        return [field.grad[None] for field in fields]

    assert gradient(lambda x, y, u: abs(x), [x]) == [0]
    assert gradient(lambda x, y, u: x * ti.sqrt(x), [x]) == [0]
    assert gradient(lambda x, y, u: u.norm(), [u])[0].to_list() == [0, 0, 0]
    assert gradient(lambda x, y, u: ti.atan2(x, y), [x, y]) == [0, 0]
    x[None] = y[None] = 1
    assert gradient(lambda x, y, u: ti.max(x, y), [x, y]) == [0, 1]
    assert gradient(lambda x, y, u: ti.min(x, y), [x, y]) == [0, 1]


def test_single_precision_agrees_with_double():
    def run(dtype):
        ti.init(default_fp=dtype, offline_cache=False)
        x = ti.field(dtype, shape=100, needs_grad=True)
        loss = ti.field(dtype, shape=(), needs_grad=True)

        @ti.kernel
        def kernel():
            for i in x:
                loss[None] += ti.sin(x[i] * x[(i + 1) % 100]) * ti.exp(-x[i])

        x.from_numpy(np.linspace(0, 2, 100))
        with ti.ad.Tape(loss):
            kernel()
        return x.grad.to_numpy()

    np.testing.assert_allclose(run(ti.f32), run(ti.f64), rtol=1e-4, atol=1e-6)


def test_a_check_finds_a_wrong_one():
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = scalar_loss()

    @ti.kernel
    def add():
        for i in x:
            loss[None] += x[i] ** 2

    @ti.ad.grad_replaced
    def forward():
        add()

    @ti.kernel
    def wrong():
        for i in x:
            x.grad[i] += 2.001 * x[i] * loss.grad[None]

    @ti.ad.grad_for(forward)
    def backward():
        wrong()

    def run():
        loss[None] = 0
        forward()

    x.from_numpy(np.array([1.0, 2, 3]))
    result = ti.ad.check(run, loss=loss, wrt=[x])
    assert not result and "'x'" in str(result)
    assert loss[None] == 0


def test_gradients_that_are_called_by_mistake():
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def scale(a: ti.f32, b: ti.f32):
        for i in x:
            loss[None] += a * b * x[i]

    for call in (lambda: scale.grad(), lambda: scale.grad(1, 2, 3), lambda: scale.grad(c=1)):
        with pytest.raises(ti.TaiRuntimeTypeError) as caught:
            call()
        assert caught.value.hint == "its parameters: a, b; scale.grad takes the same arguments"
    with pytest.raises(ti.TaiRuntimeTypeError) as caught:
        scale()
    assert caught.value.hint == "its parameters: a, b"


def test_a_gradient_that_starts_from_nothing():
    x = ti.field(ti.f32, shape=(), needs_grad=True)
    y = ti.field(ti.f32, shape=(), needs_grad=True)
    plain = ti.field(ti.f32, shape=())
    x[None] = 3

    @ti.kernel
    def square() -> ti.f32:
        plain[None] = x[None]
        return x[None] ** 2

    @ti.kernel
    def both() -> ti.f32:
        y[None] = 2 * x[None]
        return x[None] ** 2

    with pytest.raises(ti.TaiAutodiffError, match="it returns a number") as caught:
        square.grad()
    assert "tape.backward(y)" in caught.value.hint
    with ti.ad.Tape() as tape:
        result = square()
    tape.backward(result)  # as the hint says
    assert x.grad[None] == 6
    x.grad[None], y.grad[None] = 0, 1
    both.grad()
    assert x.grad[None] == 2
