"""The serial order that random loops are compared with, and the comparison.

`make fuzz` runs thousands of loops; see `test/fuzz/run_updates.py`.
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "fuzz"))

import run_updates  # noqa: E402
import serial_order  # noqa: E402
import shared_programs  # noqa: E402
from shared_programs import Line, Program  # noqa: E402


def written(lines, loop="field"):
    found = [Line(text, (name, family) if name else None) for text, name, family in lines]
    return Program(loop, "fields", found)


@pytest.mark.parametrize(("lines", "races"), [
    ([("y[i] = x[i]", None, None)], set()),
    ([("y[p[i]] = x[i] - y[p[i]]", None, None)], set()),
    ([("y[q[i]] = x[i]", None, None)], {"stores"}),
    ([("y[i] = 0.5 * y[(i + 1) % N]", None, None)], {"reads"}),
    ([("h[g[i]] = h[g[i]] + x[i]", "h", "+")], set()),
    ([("h[g[i]] = h[g[i]] + x[i]", "h", "+"), ("y[i] = h[2]", None, None)], {"sums"}),
    ([("h[g[i]] = min(h[g[i]], x[i])", "h", "<"), ("y[i] = h[2]", None, None)], {"extrema"}),
    ([("h[g[i]] = h[g[i]] + x[i]", "h", "+"), ("h[2] *= 2.0", "h", "*")], {"updates"}),
    ([("{a} = x[i]", None, None)], {"stores"}),
])  # fmt: skip
def test_the_serial_order_finds_races(lines, races):
    program = written(lines, "range")
    data = run_updates.Data(1, 33, "f64")
    assert run_updates.run_in_order(program, data, 33, True).log.races() == races


def test_the_serial_order_has_derivatives():
    """Differences of the loss agree with the slope."""
    lines = [("y[i] = ti.sin(x[i]) * y[i]", None, None), ("h[g[i]] *= 1 + 0.1 * y[i]", "h", "*")]
    program = written(lines, "backwards")
    data = run_updates.Data(1, 33, "f64")

    def loss(step):
        moved = run_updates.Data(1, 33, "f64")
        moved.start = {key: data.start[key] + step * data.along[key] for key in data.start}
        values = run_updates.run_in_order(program, moved, 33, False).values
        return sum(
            float(np_values @ run_updates.weights(*key, len(np_values)))
            for key, np_values in values.items()
            if key[0] in shared_programs.FLOATS
        )

    slope = run_updates.run_in_order(program, data, 33, True).slope
    assert (loss(1e-5) - loss(-1e-5)) / 2e-5 == pytest.approx(slope, rel=1e-7)


def test_another_value_is_seen(tmp_path, monkeypatch):
    """A program that is not the one whose serial order is taken, for a wrong compiler."""
    program = written([("h[g[i]] = h[g[i]] + x[i]", "h", "+")])
    other = written([("h[g[i]] = h[g[i]] + 1.0001 * x[i]", "h", "+")])
    case = run_updates.parse("cpu-2t-O1-33n,f64")
    monkeypatch.setattr(program, "body", other.body)
    assert run_updates.judge(program, case, 0, tmp_path)[:2] == ("FAIL", "a value is wrong")


def test_a_refusal_without_a_race_is_seen(tmp_path, monkeypatch):
    program = written([("{a} = x[i] - {a}", None, None)])
    case = run_updates.parse("cpu-2t-O1-33n,f64")
    assert run_updates.judge(program, case, 0, tmp_path)[0] == "refused"
    monkeypatch.setattr(serial_order.Log, "races", lambda log: set())
    kind, reason, _ = run_updates.judge(program, case, 0, tmp_path)
    assert kind == "FAIL" and reason.startswith("run: TaiTypeError")
