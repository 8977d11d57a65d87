"""`ti.solve_to` where differences of the loss are noise, and where only a short step shows a slope.

Results are compared with closed forms and with 60 digits.
"""

from decimal import Decimal, getcontext

import numpy as np
import pytest
import tai as ti
from tai._impl.ad.slopes import Slopes
from tai.errors import TaiAutodiffError

VALUES = np.random.default_rng(1).uniform(0.5, 1, 64)


def fields(values):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=len(values), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.asarray(values))
    return x, loss


def off(found, loss, gradient):
    norm = np.linalg.norm
    return max(
        abs(found.loss / loss - 1), norm(found.gradients[0] - gradient) / norm(gradient)
    )  # fmt: skip


def cancelling_sum(large):
    x, loss = fields(VALUES)

    @ti.kernel
    def add(number: ti.f64):
        loss[None] += number

    @ti.kernel
    def squares():
        for i in x:
            loss[None] += x[i] ** 2

    def run():
        add(large)
        squares()
        add(-large)

    return run, loss, x, np.sum(VALUES**2), 2 * VALUES


def cosines(scale):
    x, loss = fields(VALUES * scale)

    @ti.kernel
    def run():
        for i in x:
            loss[None] += 1 - ti.cos(x[i])

    angles = VALUES * scale
    return run, loss, x, np.sum(2 * np.sin(angles / 2) ** 2), np.sin(angles)


def rounded_values(large):
    x, loss = fields(VALUES)

    @ti.kernel
    def run():
        for i in x:
            y = large + x[i]
            loss[None] += (y - large) ** 2

    return run, loss, x, np.sum(VALUES**2), 2 * VALUES


def roots(scale):
    """Half of the square roots lie in the middle of two numbers of f64, and go down."""
    x, loss = fields(np.random.default_rng(0).uniform(0.5, 1.5, 1000))

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.sqrt(1 + scale * x[i]) - 1

    wide = np.sqrt(1 + scale * x.to_numpy())
    return run, loss, x, np.sum(scale * x.to_numpy() / (wide + 1)), 0.5 * scale / wide


def variance(shift):
    values = shift + VALUES
    x, loss = fields(values)
    sums = ti.field(ti.f64, shape=2, needs_grad=True)
    n = len(values)

    @ti.kernel
    def add():
        for i in x:
            sums[0] += x[i] / n
            sums[1] += x[i] * x[i] / n

    @ti.kernel
    def combine():
        loss[None] = sums[1] - sums[0] ** 2

    def run():
        sums.fill(0)
        add()
        combine()

    apart = values - shift
    apart -= apart.mean()
    return run, loss, x, np.mean(apart**2), 2 * apart / n


def logistic(steps):
    getcontext().prec = 60
    x, loss = fields([0.3])

    @ti.kernel
    def run():
        for _ in range(1):
            z = x[0]
            for _ in range(steps):
                z = 3.75 * z * (1 - z)
            loss[None] += z

    z, slope = Decimal(0.3), Decimal(1)
    for _ in range(steps):
        z, slope = Decimal("3.75") * z * (1 - z), Decimal("3.75") * (1 - 2 * z) * slope
    return run, loss, x, float(z), np.array([float(slope)])


ANSWERED = [
    (cancelling_sum, 1e10, 1e-5),  # differences of a short step are noise of f64
    (cancelling_sum, 1e11, 1e-2),
    (cosines, 1e-5, 1e-5),
    (cosines, 1e-6, 1e-2),
    (cosines, 3e-7, 1e-2),
    (rounded_values, 1e10, 1e-5),
    (roots, 1e-9, 3e-7),
    (roots, 1e-7, 1e-8),
    (variance, 1e3, 1e-5),
    (variance, 1e4, 1e-2),
    (logistic, 40, 1e-2),  # differences of a long step are not the slope
    (logistic, 40, 1e-5),
]


@pytest.mark.parametrize("make, parameter, error", ANSWERED)
def test_a_slope_that_one_step_does_not_show(make, parameter, error):
    run, loss, x, exact, gradient = make(parameter)
    found = ti.solve_to(run, loss=loss, wrt=[x], error=error)
    assert off(found, exact, gradient) <= found.error <= error
    assert found.iterations <= 20


REFUSED = [
    # In f32 these have no digits, so that only near inputs show what f64 loses.
    (rounded_values, 1e10, 1e-7, "not kept by any mode: f64: .* expected"),
    (cosines, 3e-7, 1e-6, "not kept by any mode: f64: .* expected"),
    # The results of near inputs are off in the same way: only shadows show it.
    (roots, 1e-9, 1e-7, "not kept by any mode: f64: .* expected"),
    (logistic, 60, 1e-9, "magnifies changes of its inputs .* as chaos does"),
]


@pytest.mark.parametrize("make, parameter, error, reason", REFUSED)
def test_an_error_below_what_near_inputs_show(make, parameter, error, reason):
    run, loss, x, _, _ = make(parameter)
    with pytest.raises(TaiAutodiffError, match=reason) as caught:
        ti.solve_to(run, loss=loss, wrt=[x], error=error)
    assert caught.value.hint


def slopes_of(function, slope, error=1e-3):
    def at(h):
        return function(h), np.array([slope])

    return Slopes(at, at(0.0), slope, error)


def test_reasons_of_slopes():
    def trouble(function, slope=1.0):
        found = slopes_of(function, slope).find_trouble(0.0, "line 7")
        return found and found[0]

    noise = np.random.default_rng(3)
    assert trouble(lambda h: 2 + h) is None
    assert trouble(lambda h: 2 + h + 1e-7 * noise.normal()) is None
    assert trouble(lambda h: 1 + np.sin(1e5 * h) / 1e5) is None
    assert trouble(lambda h: 1 + np.sin(3e9 * h), 3e9) is None
    assert "is outside of kernels" in trouble(lambda h: 2 + 1.5 * h)
    assert "at a kink" in trouble(lambda h: 2 + h + abs(h), 2.0)
    assert "jumps" in trouble(lambda h: 2 + h + 1e-3 * (h > 0))
    assert "rounding in f64" in trouble(lambda h: 2 + h + 1e-2 * noise.normal())
    assert "line 7" in trouble(lambda h: 2 + h + 1e-2 * noise.normal())
    assert "as chaos does" in trouble(lambda h: 1 + 0.1 * noise.normal(), 1e9)


def test_the_spread_of_near_results():
    noise = np.random.default_rng(3)
    rough = slopes_of(lambda h: 2 + h + 1e-7 * noise.normal(), 1.0)
    rough.find_trouble(0.0, "")
    assert 2e-8 < rough.spread(4) < 2e-6
    curved = slopes_of(lambda h: 2 + h + 1e3 * h**2, 1.0)
    assert curved.find_trouble(0.0, "") is None
    assert curved.spread(4) < 1e-8
    straight = slopes_of(lambda h: 2 + h, 1.0)
    assert straight.find_trouble(0.0, "") is None
    assert straight.spread(0) < 1e-14
    assert straight.magnified() == ""
