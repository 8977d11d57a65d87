"""Loops whose iterations share memory: random ones, and all that ever failed.

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

# Programs that failed once, reduced: the lines, the memory that each one updates, and how.
FAILED = {
    # The loop was refused: `v` behind another condition was no minimum.
    "component behind a condition": [
        ("if x[i] > -0.8 and v[None][0] < 0.5 * x[i]:", "v", "<"),
        ("    v[None][0] = 0.5 * x[i]", "v", "<"),
    ],
    # With several threads, updates were lost.
    "element behind a condition": [
        ("if n[i] > 3 and h[g[i]] > x[i]:", "h", ">"),
        ("    h[g[i]] = x[i]", "h", ">"),
    ],
    # With several threads, updates were lost: the minimum is chosen by several conditions.
    "chosen by several conditions": [
        ("h[g[i]] = x[i] if (n[i] > 3 and x[i] < h[g[i]]) else h[g[i]]", "h", "<"),
        ("s[g[i] % 5].a = s[g[i] % 5].a if n[i] < 3 or s[g[i] % 5].a >= x[i] else x[i]", "s", ">"),
        ("w[g[i]] = ti.select((n[i] > w[g[i]]) & (x[i] > 0.1), n[i], w[g[i]])", "w", ">"),
    ],
    # The second update was atomic, and the first one was not.
    "own and shared elements": [
        ("h[i % 7] = h[i % 7] * (1 + 1e-4 * x[i])", "h", "*"),
        ("h[g[i]] = (1 + 1e-4 * x[i]) * h[g[i]]", "h", "*"),
    ],
    # Refused, because iterations meet in elements that are their own by either index alone.
    "neighbours": [
        ("k[i] = max(n[i], k[i])", "k", "<"),
        ("k[(i + 1) % N] = max(3, k[(i + 1) % N])", "k", "<"),
    ],
    # The stack of the compiler ran over.
    "one element in two branches": [
        ("if n[i] != 4:", None, None),
        ("    t = n[i]", None, None),
        ("    if not (w[i % 5] >= t):", "w", ">"),
        ("        w[i % 5] = t", "w", ">"),
        ("t1 = n[i]", None, None),
        ("if not (w[i % 5] >= t1):", "w", ">"),
        ("    w[i % 5] = t1", "w", ">"),
    ],
    # It was no maximum, because the loop writes the compared field, if not in between.
    "compared with a field that is written": [
        ("y[i] = 0.5 * y[i] + x[i]", None, None),
        ("h[g[i]] = ti.select(0.5 * y[i] > h[g[i]], 0.5 * y[i], h[g[i]])", "h", ">"),
    ],
}


def written(lines, loop="field"):
    found = [Line(text, (name, family) if name else None) for text, name, family in lines]
    return Program(loop, "fields", found)


@pytest.mark.parametrize("word", [
    "cpu-1t-O3-17n,f64", "cpu-2t-O3-1031n-deterministic,f32", "cpu-3t-O1-261n,f64,debug",
    "emulated-64t-O1-261n,f64,strict", "python-1t-O1-17n,f64",
])  # fmt: skip
@pytest.mark.parametrize("name", FAILED)
def test_what_failed_once(name, word, tmp_path):
    case = run_updates.parse(word)
    found = run_updates.judge(written(FAILED[name]), case, 3, tmp_path)
    assert found == ("agree", "", ""), found


@pytest.mark.parametrize("first", [0, 100])
def test_some_at_random(first, tmp_path):
    """A few seeds of few iterations."""
    kinds = []
    for seed in range(first, first + 10):
        case = run_updates.draw_case(seed)
        if case.where.elements > 1031:
            continue
        kind, *why = run_updates.judge(shared_programs.draw(seed), case, seed, tmp_path)
        assert kind != "FAIL", f"run_updates.py --seed {seed}: {why}"
        kinds.append(kind)
    assert kinds.count("agree") >= 3  # or hardly anything was tested


@pytest.mark.parametrize("word", ["cpu-2t-O3-65537n,f64"])
def test_many_iterations(word, tmp_path):
    lines = FAILED["element behind a condition"] + [("o[None] = x[i] + o[None]", "o", "+")]
    found = run_updates.judge(written(lines), run_updates.parse(word), 5, tmp_path)
    assert found == ("agree", "", ""), found


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
