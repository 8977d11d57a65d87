"""`ti.ad.diagnose`: one table of all diagnostics of a gradient."""

import numpy as np
import pytest
import tai as ti

ROWS = ["gradient", "health", "rules", "precision", "types"]


@pytest.fixture
def program():
    ti.init(default_fp=ti.f64)
    x = ti.field(ti.f64, shape=50, needs_grad=True, name="x")
    y = ti.field(ti.f64, shape=50, needs_grad=True, name="y")
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")

    @ti.kernel
    def evaluate(scale: ti.f64):
        for i in x:
            y[i] = ti.sin(scale * x[i])

    @ti.kernel
    def total():
        for i in x:
            loss[None] += y[i] ** 2

    def run(scale=1.0):
        evaluate(scale)
        total()

    x.from_numpy(np.linspace(0.1, 1.0, 50))
    return x, y, loss, run


def test_a_good_program_has_five_good_rows(program):
    x, y, loss, run = program
    y.fill(7.0)
    x.grad.fill(3.0)
    found = ti.ad.diagnose(run, 2.0, loss=loss, wrt=[x], error=1e-3)
    assert found and [row.name for row in found.rows] == ROWS
    assert [row.verdict for row in found.rows] == ["good"] * 4 + ["note"]
    assert found["gradient"].report.error < 1e-7
    assert found["health"].report.findings == []
    assert found["rules"].report == []
    assert found["precision"].report.relative < 1e-3
    assert found["types"].report.types and "x: " in found["types"].summary
    assert str(found).startswith("diagnosis: good\n  gradient   good ")
    # Fields and gradients are as they were.
    assert (y.to_numpy() == 7).all() and (x.grad.to_numpy() == 3).all() and loss[None] == 0


def test_overwritten_elements_are_a_note(program):
    x, y, loss, run = program

    @ti.kernel
    def again():
        for i in x:
            y[i] = y[i] * 0.5

    def overwrites():
        run()
        again()
        again()

    found = ti.ad.diagnose(overwrites, loss=loss, wrt=x, only="rules")
    assert found and found["rules"].verdict == "note"
    assert "'y'[0]" in found["rules"].summary and found["rules"].report[0].field == "y"


def test_a_wrong_gradient_and_nan_are_bad(program):
    x, y, loss, run = program

    @ti.ad.grad_replaced
    def wrong():
        run()

    @ti.ad.grad_for(wrong)
    def gradient():
        x.grad.fill(1.0)

    found = ti.ad.diagnose(wrong, loss=loss, wrt=[x], only=["gradient"])
    assert not found and found["gradient"].verdict == "BAD"
    assert "is off by" in found["gradient"].summary
    assert str(found).startswith("diagnosis: NOT GOOD")

    @ti.kernel
    def root():
        for i in x:
            loss[None] += ti.sqrt(x[i])

    x[3] = 0.0
    found = ti.ad.diagnose(root, loss=loss, wrt=[x], only=["health"])
    assert not found and "overflow" in found["health"].summary


@pytest.mark.filterwarnings("ignore::tai.errors.TaiGradientWarning")
def test_rounding_beyond_the_error_is_bad(program):
    x, _, loss, run = program
    found = ti.ad.diagnose(run, loss=loss, wrt=[x], error=1e-14, only=("precision", "types"))
    assert [row.verdict for row in found.rows][0] == "BAD"
    x[3] = float("nan")
    found = ti.ad.diagnose(run, loss=loss, wrt=[x], only="precision")
    assert not found and found["precision"].verdict == "FAILED"
    assert isinstance(found["precision"].report, ti.errors.TaiAutodiffError)


@pytest.mark.filterwarnings("ignore::tai.errors.TaiGradientWarning")
def test_bad_arguments(program):
    x, _, loss, run = program
    with pytest.raises(ti.errors.TaiRuntimeTypeError, match="takes a kernel or a function"):
        ti.ad.diagnose(3, loss=loss)
    with pytest.raises(ti.errors.TaiRuntimeTypeError, match="has no row 'speed'"):
        ti.ad.diagnose(run, loss=loss, only=["speed"])
    with pytest.raises(ti.errors.TaiError, match="loss"):
        ti.ad.diagnose(run, loss=3.0)
    with ti.ad.Tape(loss), pytest.raises(ti.errors.TaiRuntimeError, match="inside a tape"):
        ti.ad.diagnose(run, loss=loss)
    with pytest.raises(KeyError):
        ti.ad.diagnose(run, loss=loss, only=[])["health"]
