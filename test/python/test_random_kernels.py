"""Random kernels: the gradient agrees with forward mode and differences, or is refused at a line.

`make fuzz` runs thousands of them; these are a few dozen, and all that ever failed.
"""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

FUZZ = Path(__file__).parents[1] / "fuzz"
sys.path.insert(0, str(FUZZ))

import outcome  # noqa: E402
import random_kernels as programs  # noqa: E402

REGRESSIONS = sorted((FUZZ / "regressions").glob("*.py"))


@pytest.mark.slow
def test_a_few_dozen(tmp_path):
    """In processes of their own: a crash is a failure too."""
    command = [sys.executable, str(FUZZ / "run.py"), "--count", "24", "--jobs", "2"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.splitlines()[-1]
    assert "24 programs" in run.stdout
    agreed = int(run.stdout.split(" agree")[0].split()[-1])
    assert agreed >= 6  # or hardly anything was tested


@pytest.mark.slow
@settings(
    max_examples=5, deadline=None, database=None, derandomize=True,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(st.randoms(use_true_random=False), st.booleans(), st.integers(0, 2**31))
def test_drawn_by_hypothesis(tmp_path_factory, rng, kinked, seed):
    text = programs.draw(rng, kinked)
    found = outcome.judge(text, seed, kinked, tmp_path_factory.mktemp("drawn"))
    assert found.kind != "FAIL", f"{found.reason}\n{found.detail}\n{text}"


@pytest.mark.parametrize("file", REGRESSIONS, ids=lambda file: file.stem)
def test_what_failed_once(file, tmp_path):
    """The first line says at which point: `# seed 32, kinked`."""
    text = file.read_text()
    words = text.splitlines()[0].replace(",", "").split()
    assert words[:2] == ["#", "seed"]
    found = outcome.judge(programs.HEADER + text, int(words[2]), "kinked" in words, tmp_path)
    assert found.kind != "FAIL", f"{found.reason}\n{found.detail}"


def test_the_oracle_can_fail(tmp_path):
    """A custom gradient that is wrong, in the place of a compiler that is."""
    wrong = """

@ti.kernel
def inner():
    for i in range(N):
        y[i] = ti.sin(x[i])


@ti.ad.grad_replaced
def step():
    inner()


@ti.ad.grad_for(step)
def gradient():
    inner.grad()
    x.grad[2] = x.grad[2] * (1 + 1e-4)


def run():
    step()
    total()
"""
    found = outcome.judge(programs.HEADER + wrong, 0, False, tmp_path)
    assert found.kind == "FAIL"
    right = wrong.replace("1e-4", "0.0")
    assert outcome.judge(programs.HEADER + right, 0, False, tmp_path).kind == "agree"
    nan = wrong.replace("x.grad[2] * (1 + 1e-4)", "float('nan')")
    found = outcome.judge(programs.HEADER + nan, 0, True, tmp_path)
    assert (found.kind, found.reason) == ("FAIL", "the gradient is not finite, but the slopes are")
