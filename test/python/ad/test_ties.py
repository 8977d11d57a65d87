"""The second operand of max and min wins a tie, also where one is a constant."""

import math

import pytest
import tai as ti


@pytest.mark.parametrize(
    ("case", "at", "value", "slope"),
    [
        ("max(x, 0)", 0.0, 0.0, 0.0),
        ("max(0, x)", 0.0, 0.0, 1.0),
        ("min(x, 0)", 0.0, 0.0, 0.0),
        ("min(0, x)", 0.0, 0.0, 1.0),
        ("max(0, x)", 2.0, 2.0, 1.0),
        ("max(0, x)", -2.0, 0.0, 0.0),
        ("max(x, 0)", math.nan, 0.0, 0.0),
        ("max(0, x)", math.nan, 0.0, 0.0),
        ("max(x, nan)", -2.0, -2.0, 1.0),
        ("min(nan, x)", -2.0, -2.0, 1.0),
        ("clamp", 0.0, 0.0, 1.0),
        ("clamp", 1.0, 1.0, 1.0),
        ("clamp", 1.5, 1.0, 0.0),
    ],
)
def test_constant_operand(case: str, at: float, value: float, slope: float):
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        if ti.static(case == "max(x, 0)"):
            loss[None] += ti.max(x[None], 0.0)
        elif ti.static(case == "max(0, x)"):
            loss[None] += ti.max(0.0, x[None])
        elif ti.static(case == "min(x, 0)"):
            loss[None] += ti.min(x[None], 0.0)
        elif ti.static(case == "min(0, x)"):
            loss[None] += ti.min(0.0, x[None])
        elif ti.static(case == "max(x, nan)"):
            loss[None] += ti.max(x[None], math.nan)
        elif ti.static(case == "min(nan, x)"):
            loss[None] += ti.min(math.nan, x[None])
        else:
            loss[None] += ti.math.clamp(x[None], 0.0, 1.0)

    x[None] = at
    with ti.ad.Tape(loss):
        run()
    assert loss[None] == value
    assert x.grad[None] == slope
