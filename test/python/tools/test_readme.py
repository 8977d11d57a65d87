"""The README's program, in Python and as IR, prints the gradient that the README shows."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
README = (ROOT / "README.md").read_text()
BIN = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build")) / "bin"


def block(start: str) -> str:
    """The first fenced block of the README that starts with `start`."""
    return next(b for b in re.findall(r"```\w*\n(.*?)```", README, re.S) if b.startswith(start))


PROMISED = json.loads(block("[0.0"))


def test_python_program(tmp_path: Path):
    program = tmp_path / "energy.py"
    program.write_text(block("import tai as ti\n\nti.init()"))
    run = subprocess.run(
        [sys.executable, program], check=True, capture_output=True, text=True, cwd=tmp_path
    )
    assert json.loads(run.stdout.splitlines()[-1]) == PROMISED


@pytest.mark.parametrize("through_opt", [False, True])
def test_ir_program(tmp_path: Path, through_opt: bool):
    path = ROOT / "examples" / "energy.mlir"
    if through_opt:
        text = subprocess.run(
            [BIN / "tai-opt", path, "--tai-autodiff"], check=True, capture_output=True, text=True
        ).stdout
        assert "tai.kernel @energy_grad" in text
        path = tmp_path / "autodiff.mlir"
        path.write_text(text)
    run = subprocess.run(
        [BIN / "tai-run", path, "--print-field=@x_grad"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    numbers = json.loads(run.stdout[run.stdout.index("[") :])
    assert numbers == PROMISED
