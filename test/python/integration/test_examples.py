"""The examples, on reduced sizes."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def run(name, tmp_path, *options):
    """The printed output of an example; its picture must be an animation."""
    command = [sys.executable, EXAMPLES / f"{name}.py", *options, "--out", tmp_path]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True)
    picture = re.search(r"picture\s+(\S+)", done.stdout).group(1)
    assert Image.open(picture).n_frames > 10
    return done.stdout


def losses(output):
    first, last = re.search(r"loss\s+(\S+) -> (\S+)", output).groups()
    return float(first), float(last)


@pytest.mark.parametrize("name", ["mass_spring_simple", "wave", "smoke", "diffmpm", "sparse_mpm"])
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


def numbers(output, line):
    """The numbers in the lines of the output that begin with a word."""
    found = [text for text in output.splitlines() if text.startswith(line)]
    return [list(map(float, re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text))) for text in found]


def test_sparse_mpm(tmp_path):
    options = ["--steps", 220, "--iterations", 3, "--large", 4096, "--double", "--check"]
    output = run("sparse_mpm", tmp_path, *options)
    large, small = numbers(output, "room")
    # The same blocks and the same loss, in a room of 1024 times as many blocks.
    assert (large[0], small[0], large[3], small[3]) == (4096, 128, 512**2, 256)
    assert large[2] == small[2] < 40 and large[4] == small[4]
    for slope, difference in numbers(output, "check"):
        assert slope == pytest.approx(difference, rel=1e-5)
    first, last = losses(output)
    assert last < first


def test_neighbours(tmp_path):
    output = run("neighbours", tmp_path, "--points", 400, "--iterations", 30, "--check")
    (pairs, listed), (energy, expected), (error,) = numbers(output, "check")
    assert pairs == listed > 400
    assert energy == pytest.approx(expected, rel=1e-9)
    assert error < 1e-9
    first, last = losses(output)
    assert last < 0.5 * first
    before, after = re.search(r"gap\s+(\S+) -> (\S+)", output).groups()
    assert float(after) > max(0.4, 5 * float(before))


def test_sleeping(tmp_path):
    options = ["--columns", 40, "--iterations", 3]
    output = run("sleeping", tmp_path, *options, "--check")
    assert numbers(output, "check")[1][0] < 1e-5
    ((most, total),) = numbers(output, "awake")
    assert total == 201 and 6 <= most < 40
    first, last = losses(output)
    assert last < first
    # Balls at rest would creep a little.
    everything = run("sleeping", tmp_path, *options, "--awake")
    assert numbers(everything, "awake") == [[201, 201]]
    assert losses(everything)[0] == pytest.approx(first, rel=0.05)


def test_active_blocks(tmp_path):
    sparse = run("active_blocks", tmp_path, "--n", 256, "--steps", 800)
    dense = run("active_blocks", tmp_path, "--n", 256, "--steps", 800, "--dense")
    most, total, visited = numbers(sparse, "blocks")[0]
    assert total == 32**2 and visited < 0.5 * total and most < total
    assert numbers(dense, "blocks")[0][2] == total
    # Leaving out cells at rest does not change the wave.
    for one, other in zip(numbers(sparse, "wave")[0], numbers(dense, "wave")[0], strict=True):
        assert one == pytest.approx(other, rel=1e-3) and other > 100
    picture = Image.open(tmp_path / "active_blocks.png")
    assert picture.size == (256, 256)


@pytest.mark.parametrize(
    "words, line",
    [
        (["active_blocks", "--n", 65], "--n: 65 is no multiple of 64"),
        (["checkpointing", "--budget", 0], "argument --budget: 0 is impossible"),
        (["implicit_elastic", "--steps", 0], "argument --steps: 0 is impossible"),
        (["neighbours", "--points", 23], "argument --points: 23 is impossible; at least 24"),
        (["sparse_mpm", "--steps", 0], "argument --steps: 0 is impossible"),
    ],
    ids=lambda v: v[0] if isinstance(v, list) else "",
)
def test_impossible_sizes(words, line):
    name, *options = map(str, words)
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *options]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith(f"{name}: {line}")
    assert done.stderr.count("\n") == 1
