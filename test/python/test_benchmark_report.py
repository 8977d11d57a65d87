"""The benchmark's table and verdict: ratios, missing peers, wrong gradients."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import numpy as np

import harness
import report
import run


def record(peer: str, phase: str, ms: float, **values) -> dict:
    return {"peer": peer, "scene": "wave", "phase": phase, "ms": ms, **values}


def test_table_shows_ratios_and_what_is_missing():
    records = [
        record("tai", "forward", 2.0, grad_rel_err=1e-6),
        record("tai", "backward", 3.0, grad_rel_err=1e-6),
        record("jax", "forward", 4.0, grad_rel_err=2e-6),
        record("jax", "backward", 16.0, grad_rel_err=2e-6),
        run.problem_record("torch", "wave", "missing", "not installed"),
    ]
    text = report.table(records, ["wave"], ["tai", "jax", "torch"], "tai")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    assert ["wave", "forward", "2", "4 (2x)", "missing"] in rows
    assert ["wave", "both", "5", "20 (4x)", "missing"] in rows
    assert ["wave", "gradient error", "1.0e-06", "2.0e-06", "-"] in rows
    assert "torch, wave: missing: not installed" in text


def test_rounds_are_combined_by_their_median():
    records = [record("tai", "forward", ms) for ms in (9.0, 2.0, 3.0)]
    assert report.time_of(records, "tai", "wave", "forward") == 3.0


def test_a_wrong_loss_is_a_failure():
    right = record("jax", "forward", 1.0, loss_rel_err=1e-6)
    assert run.judged(right) == right
    for error in (0.1, float("nan")):
        wrong = run.judged(record("jax", "forward", 1.0, loss_rel_err=error))
        assert wrong["phase"] == "failed"


def test_complaints_are_about_our_own_side():
    good = record("tai", "forward", 1.0, grad_rel_err=1e-6)
    assert run.complaints([good], ["wave"]) == []
    bad = record("tai", "backward", 1.0, grad_rel_err=0.5)
    missing = run.problem_record("tai", "wave", "missing", "no module")
    assert len(run.complaints([good, bad, missing], ["wave"])) == 2
    others = record("jax", "forward", 1.0, grad_rel_err=0.5)
    assert run.complaints([good, others], ["wave"]) == []


def test_relative_error_of_nonsense_is_infinite():
    expected = np.ones(3)
    assert harness.relative_error(np.array([1.0, 1.0, 1.1]), expected) < 0.06
    assert harness.relative_error(np.array([1.0, np.nan, 1.0]), expected) == float("inf")
    assert harness.relative_error(np.ones(4), expected) == float("inf")
