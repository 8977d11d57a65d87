"""The examples, on reduced sizes."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name, tmp_path, *options):
    """What an example prints; its picture must be an animation."""
    command = [sys.executable, EXAMPLES / f"{name}.py", *options, "--out", tmp_path]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True)
    picture = re.search(r"picture\s+(\S+)", done.stdout).group(1)
    assert Image.open(picture).n_frames > 10
    return done.stdout


def losses(output):
    first, last = re.search(r"loss\s+(\S+) -> (\S+)", output).groups()
    return float(first), float(last)


@pytest.mark.parametrize("name", ["mass_spring_simple", "wave", "smoke", "diffmpm"])
def test_help(name):
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "--iterations" in done.stdout and "python examples/" in done.stdout


@pytest.mark.parametrize(
    "target, iterations, lengths",
    [(0.1, 25, "[0.600, 0.600, 0.529]"), (0.2, 200, "[0.858, 0.858, 0.762]")],
)
def test_mass_spring_simple(tmp_path, target, iterations, lengths):
    options = ["--target", target, "--iterations", iterations]
    output = run("mass_spring_simple", tmp_path, *options)
    assert lengths in output
    first, last = losses(output)
    assert first == pytest.approx(0.009026 if target == 0.1 else 0.03803, rel=1e-3)
    assert last < 2e-8


def test_wave(tmp_path):
    first, last = losses(run("wave", tmp_path, "--iterations", 4))
    assert first == pytest.approx(0.246378, rel=5e-4)
    assert last == pytest.approx(0.193836, rel=5e-4)


def test_smoke(tmp_path):
    first, last = losses(run("smoke", tmp_path, "--iterations", 4))
    assert first == pytest.approx(0.5, rel=5e-4)
    assert last == pytest.approx(0.185877, rel=2e-3)


def test_diffmpm(tmp_path):
    first, last = losses(run("diffmpm", tmp_path, "--iterations", 3))
    assert first == pytest.approx(-0.250387, abs=2e-5)
    assert last == pytest.approx(-0.263767, abs=2e-4)
