"""The benchmark for a GPU, tried out without one; and what its report does not let pass."""

import csv
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks" / "gpu"))

import gpu_report as report  # noqa: E402

import run as benchmark  # noqa: E402


def test_all_programs_run(tmp_path):
    command = [sys.executable, ROOT / "benchmarks/gpu/run.py", "--arch", "cpu", "--small"]
    command += ["--quick", "--peers", "", "--no-floors", "--name", "try", "--out", tmp_path]
    only = ["diffmpm", "diffmpm_large", "launch", "chain", "bandwidth", "sparse"]
    done = subprocess.run([*command, "--only", ",".join(only)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    with (tmp_path / "gpu-try.csv").open() as stream:
        records = list(csv.DictReader(stream))
    assert {r["scene"] for r in records} == set(only)
    assert not [r for r in records if r["reason"]]
    exact = [r for r in records if r["scene"] in ("bandwidth", "sparse")]
    assert len(exact) == 8 and all(float(r["grad_rel_err"]) == 0.0 for r in exact)
    text = (tmp_path / "gpu-try.md").read_text()
    # A machine without a GPU meets no bar.
    assert "no measurement of a GPU" in text and "| met |" not in text


def test_a_program_that_fails_does_not_stop_the_others(tmp_path):
    command = [sys.executable, ROOT / "benchmarks/gpu/run.py", "--arch", "cpu", "--small"]
    command += ["--peers", "", "--no-floors", "--name", "try", "--out", tmp_path]
    # No time is left for anything.
    done = subprocess.run(
        [*command, "--only", "smoke,launch", "--minutes", "0.01"], capture_output=True, text=True
    )
    assert done.returncode == 1
    text = (tmp_path / "gpu-try.md").read_text()
    assert "smoke, tai: not run: the time was up" in text
    assert "launch, tai: not run: the time was up" in text


def scene(peer: str, ms: float, **more) -> dict:
    phase = {"tai": "queued", "floor": "both"}[peer]
    record = {"peer": peer, "scene": "smoke", "phase": phase, "ms": ms, "loss": 0.367, **more}
    return benchmark.judged(record)


def verdict(records: list[dict], what: str) -> str:
    """The last column of the row that follows the one with the floor."""
    lines = report.figures(records, ["smoke"], "NVIDIA H200", True)
    return next(line for line in lines if what in line).split("|")[-2].strip()


def test_bars():
    floor = scene("floor", 2.5, variant="graph")
    assert verdict([scene("tai", 2.7), floor], "ours / that floor") == "met"
    assert verdict([scene("tai", 2.8), floor], "ours / that floor") == "**missed**"
    assert verdict([floor], "ours / that floor") == "not measured"
    assert verdict([scene("tai", 1.5)], "the same") == "met"


def test_a_wrong_gradient_meets_no_bar():
    wrong = scene("tai", 0.5, grad_rel_err=0.2)
    assert "gradient is off" in wrong["reason"]
    assert verdict([wrong], "the same") == "not measured"
    assert "reason" not in scene("tai", 0.5, grad_rel_err=1e-4)
    assert "reason" in scene("tai", 0.5, grad_rel_err=float("nan"))


def test_a_floor_that_computes_something_else_is_named():
    ours = scene("tai", 0.5)
    assert not report.disagreements([ours, scene("floor", 1.0, variant="graph")])
    other = {**scene("floor", 1.0, variant="graph"), "loss": 0.4}
    assert len(report.disagreements([ours, other])) == 1
