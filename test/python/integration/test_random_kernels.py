"""Random kernels: the gradient agrees with forward mode and differences, or is refused at a line.

`make fuzz` runs thousands of them; these are a few dozen, and all that ever failed. Each runs in a
configuration that its seed draws: target, threads, level of optimisation, number of elements.
"""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

FUZZ = Path(__file__).parents[2] / "fuzz"
sys.path.insert(0, str(FUZZ))

import configurations  # noqa: E402
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
    where = configurations.draw(seed, configurations.default_targets())
    found = outcome.judge(text, seed, kinked, tmp_path_factory.mktemp("drawn"), where)
    assert found.kind != "FAIL", f"{where}: {found.reason}\n{found.detail}\n{text}"


@pytest.mark.parametrize("word", ["cpu-1t-O1-5n", "cpu-3t-O3-1031n", "emulated-64t-O2-67n"])
@pytest.mark.parametrize("file", REGRESSIONS, ids=lambda file: file.stem)
def test_what_failed_once(file, word, tmp_path):
    """The first line says at which point: `# seed 32, kinked`."""
    text = file.read_text()
    words = text.splitlines()[0].replace(",", "").split()
    assert words[:2] == ["#", "seed"]
    where = configurations.parse(word)
    seed, kinked = int(words[2]), "kinked" in words
    found = outcome.judge(programs.HEADER + text, seed, kinked, tmp_path, where)
    assert found.kind != "FAIL", f"{found.reason}\n{found.detail}"


def test_configurations_reach_every_threshold():
    """A few seeds reach each target, level, number of threads and size, written as one word."""
    drawn = [configurations.draw(seed, ("cpu", "emulated")) for seed in range(1000)]
    assert {c.arch for c in drawn} == {"cpu", "emulated"}
    assert {c.level for c in drawn} == {0, 1, 2, 3}
    assert {c.threads for c in drawn if c.arch == "cpu"} == {1, 2, 3, 4}
    assert max(c.threads for c in drawn if c.arch == "emulated") > 64
    assert {c.elements for c in drawn} == set(configurations.SIZES)
    assert all(configurations.parse(str(c)) == c for c in drawn)


def test_another_value_in_another_configuration_is_seen(tmp_path):
    """A program that depends on where it runs, in the place of a compiler that is wrong there."""
    text = """

@ti.kernel
def inner(a: ti.f64):
    for i in range(N):
        y[i] = a * ti.sin(x[i])


def run():
    inner(1.0 + 1e-6 * (ti.lang.impl.current_cfg().cpu_max_num_threads == 3))
    total()
"""
    where = configurations.parse("cpu-3t-O1-33n")
    found = outcome.judge(programs.HEADER + text, 0, False, tmp_path, where)
    assert found.kind == "FAIL" and "plain configuration" in found.reason
    where = configurations.parse("cpu-2t-O1-33n")
    assert outcome.judge(programs.HEADER + text, 0, False, tmp_path, where).kind == "agree"


def test_rounding_of_equal_terms_is_measured(tmp_path):
    """All of them are rounded to one side: the sum is off by more than one of other terms."""
    text = """

@ti.kernel
def inner(a: ti.f64):
    for i in x:
        for j in range(41):
            ti.atomic_add(s[None], ti.tanh(a) + ti.sin(0.1))


@ti.kernel
def outer():
    for i in x:
        loss[None] += 0.3 * ti.cos(ti.sin(s[None]))


def run():
    inner(-1.85)
    outer()
    total()
"""
    where = configurations.parse("emulated-1t-O0-20011n")
    found = outcome.judge(programs.HEADER + text, 0, False, tmp_path, where)
    assert found.kind == "agree", found


def test_rounding_of_parts_that_cancel_is_measured(tmp_path):
    """The derivative of this program by `s` is 8.3, as the difference of parts of 819 and 825."""
    where = configurations.parse("cpu-3t-O1-67n")
    found = outcome.judge(programs.program(3204), 3204, False, tmp_path, where)
    assert found.kind in ("agree", "undecided"), found


def test_a_chaotic_loss_decides_nothing(tmp_path):
    """Where `y * sin(y)` is repeated, equal sums of 4,099 terms in another order end elsewhere.

    A field of small noise reads it through a comparison alone.
    """
    where = configurations.parse("cpu-3t-O3-4099n")
    found = outcome.judge(programs.program(4546), 4546, False, tmp_path, where)
    assert found.kind == "undecided", found
    assert found.reason == "rounding decides the loss"


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
    # No sum rounds that much here: with exact ones the modes differ as before.
    last = outcome.judge(programs.HEADER + wrong.replace("1e-4", "1e-10"), 0, False, tmp_path)
    assert (last.kind, "last digits" in last.reason) == ("FAIL", True)
    right = wrong.replace("1e-4", "0.0")
    assert outcome.judge(programs.HEADER + right, 0, False, tmp_path).kind == "agree"
    nan = wrong.replace("x.grad[2] * (1 + 1e-4)", "float('nan')")
    found = outcome.judge(programs.HEADER + nan, 0, True, tmp_path)
    assert (found.kind, found.reason) == ("FAIL", "the gradient is not finite, but the slopes are")
