"""S22 to S24, S28, S39: loops of any length, chains of many steps, chaos."""

from fractions import Fraction

import numpy as np
import pytest
import tai as ti

from points import MODES, TYPES, number


def gradient_of(run, loss, x, mode):
    """The derivative of `loss` by the number in `x`."""
    if mode == "reverse":
        with ti.ad.Tape(loss):
            run()
        return x.grad[None]
    with ti.ad.FwdMode(loss=loss, param=x, seed=[1.0]):
        run()
    return loss.dual[None]


def make(shape, dtype, mode):
    kind = {"needs_grad": True} if mode == "reverse" else {"needs_dual": True}
    return ti.field(TYPES[dtype], shape=shape, **kind)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("from_field", [False, True], ids=["constant", "field"])
@pytest.mark.parametrize("trips", [30, 31, 100, 5000, 10**6])
def test_s22_powers(trips, from_field, dtype, mode, measure):
    """c^n and n c^(n-1): no depth is built in. f32: n roundings, each of half an ulp."""
    ti.init(offline_cache=False)
    n = ti.field(ti.i32, shape=())
    c, loss = make((), dtype, mode), make((), dtype, mode)
    n[None] = trips
    at = float(number(dtype)(1 - 1 / (3 * trips)))
    c[None] = at

    @ti.kernel
    def power():
        for _ in range(1):
            y = ti.cast(1, TYPES[dtype])
            for _ in range(n[None] if ti.static(from_field) else trips):
                y *= c[None]
            loss[None] = y

    slope = gradient_of(power, loss, c, mode)
    bound = 1e-10 if dtype == "f64" else 2 * trips * 2.0**-24
    exact = at ** (trips - 1)
    measure("value", abs(loss[None] / (exact * at) - 1), bound)
    measure("slope", abs(slope / (trips * exact) - 1), bound)


@pytest.mark.parametrize("history", [2**12, 2**16])
def test_s22_recomputed_in_parts(history, measure):
    """1e5 trips recorded at once, or run again in parts of `ad_history_bytes`: the same bits."""
    found = {}
    for bytes_ in (2**26, history):
        ti.init(offline_cache=False, default_fp=ti.f64, ad_history_bytes=bytes_, deterministic=True)
        x, loss = make((), "f64", "reverse"), make((), "f64", "reverse")
        x[None] = 0.5

        @ti.kernel
        def turn():
            for _ in range(1):
                y = x[None]
                for _ in range(100000):
                    y = ti.sin(y) + 0.125 * y
                loss[None] = y

        found[bytes_] = [gradient_of(turn, loss, x, "reverse") for _ in range(3)]
    distinct = {value for values in found.values() for value in values}
    measure("distinct gradients", len(distinct), 1)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("count", [1, 5, 1000])
def test_s23_while_in_a_branch(count, mode, measure):
    """The data decides the number of steps: differences of the same steps, 1e-7."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    x, y = make(count, "f64", mode), make(count, "f64", mode)
    total = make((), "f64", mode)
    at = np.random.default_rng(2).uniform(-2.0, 9.0, count)
    x.from_numpy(at)

    @ti.kernel
    def halve():
        for i in x:
            value = 0.0
            if x[i] > 1:
                value = x[i]
                while value > 1.25:
                    value = 0.5 * value + 0.1 * ti.sin(x[i])
            y[i] = value

    @ti.kernel
    def add():
        for i in y:
            total[None] += y[i]

    def steps(a):
        value = a
        while value > 1.25:
            value = 0.5 * value + 0.1 * np.sin(a)
        return value if a > 1 else 0.0

    h = 1e-5
    slopes = np.array([(steps(a + h) - steps(a - h)) / (2 * h) for a in at])
    if mode == "reverse":
        with ti.ad.Tape(total):
            halve()
            add()
        found = x.grad.to_numpy()
    else:
        with ti.ad.FwdMode(loss=y, param=x, seed=[1.0] * count):
            halve()
        found = y.dual.to_numpy()
    np.testing.assert_allclose(y.to_numpy(), [steps(a) for a in at], rtol=1e-14)
    # A point whose number of steps changes within h has no derivative.
    smooth = np.array([abs(steps(a + h) - steps(a - h)) < 1e-3 for a in at])
    measure("gradient", np.abs(found - slopes)[smooth].max(initial=0.0), 1e-7)


@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 16, 25])
def test_s24_fibonacci_indices(n, dtype):
    """Forward mode of gathers and scatters at Fibonacci numbers: whole numbers, exactly."""
    ti.init(offline_cache=False)
    numbers = [1, 1]
    while len(numbers) < n:
        numbers.append(sum(numbers[-2:]))
    size = numbers[-1] + 1
    index = ti.field(ti.i32, shape=n)
    index.from_numpy(np.array(numbers, np.int32))
    x, y = (ti.field(TYPES[dtype], shape=size, needs_dual=True, needs_grad=True) for _ in "xy")
    loss = ti.field(TYPES[dtype], shape=(), needs_dual=True, needs_grad=True)
    x.from_numpy((np.arange(size) % 7).astype(number(dtype)))
    seed = (np.arange(size) % 5 - 2).astype(float)

    @ti.kernel
    def scatter():
        for i in range(n):
            y[index[i]] += x[index[n - 1 - i]] * (i + 1)

    @ti.kernel
    def gather():
        for i in range(n):
            loss[None] += y[index[i]] * (i % 3 + 1)

    def run():
        y.fill(0)
        loss[None] = 0
        scatter()
        gather()

    with ti.ad.FwdMode(loss=loss, param=x, seed=seed.tolist()):
        run()
    weight = np.zeros(size)
    for i in range(n):
        weight[numbers[i]] += i % 3 + 1
    slope = np.zeros(size)
    for i in range(n):
        slope[numbers[n - 1 - i]] += weight[numbers[i]] * (i + 1)
    assert loss.dual[None] == slope @ seed
    assert loss[None] == slope @ (np.arange(size) % 7)


def logistic(n):
    """The derivative of x[n] by x[0] of x -> 4 x (1 - x), by numbers of 400 bits."""
    bits = 400
    x, slope = Fraction(5, 16), Fraction(1)
    for _ in range(n):
        x, slope = 4 * x * (1 - x), slope * 4 * (1 - 2 * x)
        x = Fraction(round(x * 2**bits), 2**bits)
        slope = Fraction(round(slope * 2**bits), 2**bits)
    return float(slope)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("n", "bound"), [(20, 1e-9), (40, 1e-4)])
def test_s28_logistic_map_in_one_kernel(n, bound, mode, measure):
    """f64 has 16 digits, of which chaos takes one in 3.3 steps; at 100 none is left (flagged)."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    x, loss = make((), "f64", mode), make((), "f64", mode)
    x[None] = 0.3125

    @ti.kernel
    def steps():
        for _ in range(1):
            y = x[None]
            for _ in range(n):
                y = 4 * y * (1 - y)
            loss[None] = y

    measure("slope", abs(gradient_of(steps, loss, x, mode) / logistic(n) - 1), bound)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("where", ["one kernel", "a launch a step"])
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-11), ("f32", 1e-4)])
def test_s39_damped_spring(dtype, bound, where, mode, measure, long):
    """A contraction forgets its roundings: 1e5 steps, against numbers of 60 bits and more.

    Relative to the greatest of the gradients of the mean over the last tenth.
    """
    steps = 10**5 if long or where == "one kernel" else 2 * 10**4
    ti.init(offline_cache=False)
    k, c, dt = 4.0, 0.002, float(number(dtype)(0.01))
    real = TYPES[dtype]
    x0, loss = make((), dtype, mode), make((), dtype, mode)
    x, v = make(steps + 1, dtype, mode), make(steps + 1, dtype, mode)
    x0[None] = 1.0

    @ti.kernel
    def whole():
        for _ in range(1):
            p, q = x0[None], ti.cast(0, real)
            for _ in range(steps):
                q += dt * (-k * p - c * q)
                p += dt * q
            loss[None] = p * p + q * q / k

    @ti.kernel
    def begin():
        x[0] = x0[None]

    @ti.kernel
    def step(t: ti.i32):
        for _ in range(1):
            v[t + 1] = v[t] + dt * (-k * x[t] - c * v[t])
            x[t + 1] = x[t] + dt * v[t + 1]

    @ti.kernel
    def last():
        loss[None] = x[steps] * x[steps] + v[steps] * v[steps] / k

    def run():
        if where == "one kernel":
            whole()
        else:
            begin()
            for t in range(steps):
                step(t)
            last()

    slope = gradient_of(run, loss, x0, mode)
    exact_loss, exact = spring(steps, k, c, dt)
    measure("energy", abs(loss[None] / exact_loss - 1), bound)
    measure("gradient", abs(slope / exact - 1), bound)


def spring(steps, k, c, dt):
    """Energy of the damped spring after so many steps and its slope, by NumPy's f80 or mpmath.

    The step is linear, so that the loss is a quadratic form of the start.
    """
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workprec(200):
        dt, k, c = mpmath.mpf(dt), mpmath.mpf(k), mpmath.mpf(c)
        # Python's numbers of f32 are exact, and so are the constants as f64.
        a, b = 1 - dt * c, -dt * k
        power = mpmath.matrix([[1 + dt * b, dt * a], [b, a]]) ** steps
        energy = power[0, 0] ** 2 + power[1, 0] ** 2 / k
        return float(energy), float(2 * energy)
