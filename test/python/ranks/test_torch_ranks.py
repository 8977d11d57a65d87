"""The example on processes that torch.distributed starts and connects, with gloo."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="ranks communicate by torch.distributed, and torch is missing")

EXAMPLE = Path(__file__).resolve().parents[3] / "examples/sharded_wave.py"


def run(*options, ranks=0):
    """The output of the example."""
    start = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(ranks)]
    command = [sys.executable, *(start if ranks else []), str(EXAMPLE), "--size", "12"]
    done = subprocess.run(
        [*command, "--steps", "8", *options], capture_output=True, text=True, check=True
    )
    return [line for line in done.stdout.splitlines() if line.startswith(("iter", "grad"))]


def test_torch_ranks_give_the_losses_of_one_process():
    losses = [[line.split(",")[0] for line in run("--iterations", "2", ranks=n)] for n in (0, 2, 3)]
    assert len(losses[0]) == 2 and losses[0] == losses[1] == losses[2]


def test_torch_ranks_give_a_true_gradient():
    assert len(run("--check", ranks=2)) == 1
