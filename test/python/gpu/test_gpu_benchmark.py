"""The benchmark for a GPU, tried out without one; and what its report does not let pass."""

import csv
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "benchmarks" / "gpu"), str(ROOT / "scripts")]

import gpu_report as report  # noqa: E402

import run as benchmark  # noqa: E402
import test_gpu as script  # noqa: E402

# Where the tests themselves run does not matter here.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k not in ("TI_ARCH", "TAI_CUDA_EMULATION")}


def measure(options: list) -> subprocess.CompletedProcess:
    command = [sys.executable, ROOT / "benchmarks/gpu/run.py", "--arch", "cpu", "--small"]
    command += ["--peers", "", "--no-floors", "--name", "try", *options]
    return subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT)


def test_all_programs_run(tmp_path):
    only = ["diffmpm", "diffmpm_large", "launch", "chain", "bandwidth", "sparse"]
    done = measure(["--quick", "--out", tmp_path, "--only", ",".join(only)])
    assert done.returncode == 0, done.stdout + done.stderr
    with (tmp_path / "gpu-try.csv").open() as stream:
        records = list(csv.DictReader(stream))
    assert {r["scene"] for r in records} == set(only)
    assert not [r for r in records if r["reason"]]
    exact = [r for r in records if r["scene"] in ("bandwidth", "sparse")]
    assert len(exact) == 10 and all(float(r["grad_rel_err"]) == 0.0 for r in exact)
    text = (tmp_path / "gpu-try.md").read_text()
    # A machine without a GPU meets no bar.
    assert "no measurement of a GPU" in text and "| met |" not in text


def test_a_program_that_fails_does_not_stop_the_others(tmp_path):
    # The limit of 0.6 seconds is too short for any program.
    done = measure(["--out", tmp_path, "--only", "smoke,launch", "--minutes", "0.01"])
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
    ours["gradient_norm"], other = 0.0132, scene("floor", 1.0, variant="graph")
    assert not report.disagreements([ours, {**other, "gradient_norm": 0.0133}])
    assert len(report.disagreements([ours, {**other, "gradient_norm": 0.0140}])) == 1


XML = """<testsuites><testsuite><testcase classname="a" name="good"/>
<testcase classname="a" name="bad"><failure message="&#10;assert 1 == 2&#10;more"/></testcase>
<testcase classname="a" name="worse"><error message="no device"/></testcase>
<testcase classname="a" name="left"><skipped message="not yet"/></testcase>
</testsuite></testsuites>"""

# The output of pytest with one process and with many, before it is stopped.
OUTPUT = """test/python/test_a.py::test_good PASSED [ 1%]
[gw1] [  2%] FAILED test/python/test_a.py::test_bad[x-1]
[gw0] [  2%] PASSED test/python/test_b.py::test_other
[gw0] [  3%] SKIPPED test/python/test_b.py::test_left
"""


def test_outcomes_of_tests_are_counted(tmp_path):
    junit = tmp_path / "tests.xml"
    junit.write_text(XML)
    counts, failures, reasons = script.cases(junit, "")
    assert reasons == Counter({"not yet": 1})
    assert counts == Counter(passed=1, failed=2, skipped=1)
    assert failures == ["`a::bad`: assert 1 == 2", "`a::worse`: no device"]


def test_outcomes_are_counted_of_a_runner_that_was_stopped(tmp_path):
    counts, failures, _ = script.cases(tmp_path / "none.xml", OUTPUT)
    assert counts == Counter(passed=2, failed=1, skipped=1)
    assert failures == ["`test/python/test_a.py::test_bad[x-1]`"]
