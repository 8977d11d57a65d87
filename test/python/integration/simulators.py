"""Runs a simulator of `examples` as its user would, and reads its output."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

# Two runs on a GPU add up in other orders.
ROUNDING = 1e-5 if os.environ.get("TI_ARCH") == "cuda" else 0
EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def start(name: str, folder: Path, *options, pictures=False) -> subprocess.CompletedProcess:
    """In a folder of its own; its end may be an error."""
    command = [sys.executable, EXAMPLES / f"{name}.py", *options, "--out", folder]
    command += [] if pictures else ["--no-picture"]
    return subprocess.run([str(word) for word in command], capture_output=True, text=True)


def printed(name: str, folder: Path, *options) -> str:
    done = start(name, folder, *options)
    assert done.returncode == 0, done.stderr
    return done.stdout


def table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a CSV file by their names."""
    with path.open(newline="") as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, np.array(rows, float).T, strict=True))


def descent(name: str, folder: Path, *options) -> dict[str, np.ndarray]:
    """Loss and the lengths of gradients by iteration; what depends on the clock is left out."""
    printed(name, folder, *options)
    columns = table(folder / f"{name}.losses.csv")
    columns.pop("seconds")
    return columns
