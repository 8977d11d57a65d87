"""Condition numbers of losses and gradients, and losses that their sums cancel."""

import math
import os

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiAutodiffError, TaiRuntimeError


def both(shape=(), dtype=ti.f64):
    return ti.field(dtype, shape=shape, needs_grad=True, needs_dual=True)


def weighted_squares(x, loss):
    @ti.kernel
    def run():
        for i in x:
            loss[None] += (i + 1) * x[i] ** 2

    return run


@pytest.mark.parametrize("n", [1, 3, 1000])
def test_sums_of_squares(n):
    """x · 2 w x over w x² is 2; the gradient is linear, so its condition is 1."""
    ti.init(default_fp=ti.f64)
    x, loss = both(n), both()
    x.from_numpy(np.random.default_rng(0).standard_normal(n) + 0.1)
    run = weighted_squares(x, loss)
    with ti.ad.Tape(loss) as tape:
        run()
    before = x.grad.to_numpy()
    found = tape.condition()
    assert found.loss == pytest.approx(2) and found.gradient == pytest.approx(1)
    assert found.fields == {"x": found.loss} and not found.overwritten
    np.testing.assert_array_equal(x.grad.to_numpy(), before)
    assert str(found).startswith("condition: 2 of the loss, 1 of the gradient")


def test_the_gradient_of_coupled_inputs():
    """Beside ‖H diag(x)‖ / ‖g‖ of the whole Hessian."""
    ti.init(default_fp=ti.f64)
    n = 40
    x, loss = both(n), both()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.exp(x[i] - x[(i + 1) % n]) * x[(i + 2) % n]

    x.from_numpy(np.random.default_rng(1).standard_normal(n))
    with ti.ad.Tape(loss) as tape:
        run()
    gradient, values = x.grad.to_numpy(), x.to_numpy()
    right = np.linalg.norm(ti.ad.hessian(run, loss, x) * values) / np.linalg.norm(gradient)
    found = tape.condition()
    assert right / 2 < found.gradient < 2 * right
    assert found.loss == pytest.approx(np.abs(values * gradient).sum() / abs(loss[None]))


def test_relative_changes_change_the_loss_as_said():
    """200 random changes by at most u change the loss by no more than the condition says."""
    ti.init(default_fp=ti.f64)
    x, y, loss = both(30), both(30), both()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.sin(3 * x[i]) * y[i]

    generator = np.random.default_rng(2)
    start = generator.standard_normal((2, 30))
    x.from_numpy(start[0]), y.from_numpy(start[1])
    with ti.ad.Tape(loss) as tape:
        run()
    value, found = loss[None], tape.condition()
    assert set(found.fields) == {"x", "y"} and sum(found.fields.values()) == pytest.approx(
        found.loss
    )
    u, worst = 1e-7, 0.0
    for _ in range(200):
        moved = start * (1 + u * generator.choice([-1, 1], start.shape))
        x.from_numpy(moved[0]), y.from_numpy(moved[1])
        loss[None] = 0
        run()
        worst = max(worst, abs(loss[None] - value) / abs(value))
    assert 0.05 * found.loss * u < worst < 1.001 * found.loss * u


def test_inputs_that_are_overwritten_are_named():
    ti.init(default_fp=ti.f64)
    x, y, loss = both(3), both(3), both()
    run = weighted_squares(x, loss)

    @ti.kernel
    def square():
        for i in x:
            x[i] = x[i] * x[i] + y[i]

    x.from_numpy(np.array([1.0, 2, 3]))
    y.fill(0.5)
    with ti.ad.Tape(loss) as tape:
        square()
        run()
    found = tape.condition()
    assert found.overwritten == ["x"] and found.gradient is None and set(found.fields) == {"y"}
    assert "at least" in str(found) and "left out, overwritten: x" in str(found)


def test_fields_that_the_host_fills_are_no_inputs():
    ti.init(default_fp=ti.f64)
    x, cell, loss = both(6), both(2), both()

    @ti.kernel
    def scatter():
        for i in x:
            cell[i % 2] += x[i]

    run = weighted_squares(cell, loss)
    x.fill(1.0)
    with ti.ad.Tape(loss) as tape:
        cell.fill(0)
        scatter()
        run()
    found = tape.condition()
    assert found.overwritten == [] and list(found.fields) == ["x"]
    assert found.loss == pytest.approx(2)


def ill_conditioned(n=100_000):
    """Pairs that cancel, but for one unit in the last place of one of them."""
    generator = np.random.default_rng(0)
    half = (generator.standard_normal(n // 2) * 1e3).astype(np.float32)
    values = np.concatenate([half, -half])
    generator.shuffle(values)
    values[7] = np.nextafter(values[7], np.float32(np.inf))
    return values, math.fsum(values.astype(np.float64))


@pytest.mark.parametrize("sums", ["default", "compensated"])
def test_a_sum_that_keeps_no_digit_is_named(sums):
    # The error of the sum depends on the number of partial sums.
    ti.init(sums=sums, cpu_max_num_threads=2)
    values, right = ill_conditioned()
    x = ti.field(ti.f32, shape=len(values), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    x.from_numpy(values)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    with ti.ad.Tape(loss, precision=True) as tape:
        total()
    health, report, condition = tape.health(), tape.precision_report(), tape.condition()
    weight = np.abs(values.astype(np.float64)).sum()
    assert condition.loss == pytest.approx(weight / abs(loss[None]), rel=1e-5)
    assert condition.gradient is None  # no duals
    if sums == "compensated":
        assert loss[None] == np.float32(right) and condition.loss > 1e12
        assert health and report.relative < 1e-6
        return
    error = abs(loss[None] - right)
    if os.environ.get("TI_ARCH") == "cuda":
        # A GPU adds up f32 in f64.
        assert error <= 1e-6 * abs(right)
        return
    assert error > right  # the sum is wrong in all digits
    assert not health
    (finding,) = health.findings
    assert finding.kind == "cancellation" and "'x' above all" in finding.message
    assert "sums='compensated'" in finding.message
    # The report gives the standard deviation of the error, and names the sum. One draw is below a
    # fortieth of that in 2 % of all orders, and above ten times that in none.
    assert error / 10 < report.expected < 40 * error
    assert "the sum in 'loss'" in str(report)


def test_sums_that_keep_their_digits_are_healthy():
    ti.init()
    x = ti.field(ti.f32, shape=1000, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    x.from_numpy(np.random.default_rng(3).standard_normal(1000).astype(np.float32))
    run = weighted_squares(x, loss)
    with ti.ad.Tape(loss) as tape:
        run()
    assert tape.health()
    x.fill(0)  # a loss of 0 whose gradient is 0 has no condition
    with ti.ad.Tape(loss) as tape:
        run()
    assert not [f for f in tape.health().findings if f.kind == "cancellation"]
    assert tape.condition().loss == 0


def test_mistakes():
    ti.init(default_fp=ti.f64)
    x, loss = both(3), both()
    run = weighted_squares(x, loss)
    with pytest.raises(TaiRuntimeError, match="the tape holds nothing yet"):
        ti.ad.Tape(loss).condition()
    with ti.ad.Tape() as tape:
        run()
    with pytest.raises(TaiAutodiffError, match="needs a tape with a loss of one number"):
        tape.condition()
