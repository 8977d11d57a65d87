"""The programs of docs/guides/sparse.md run as they stand, and print what their comments say."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "guides" / "sparse.md").read_text()
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("number", range(len(PROGRAMS)))
def test_program(number, tmp_path):
    program = PROGRAMS[number]
    file = tmp_path / "program.py"
    file.write_text(program)
    run = [sys.executable, str(file)]
    done = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    promised = re.findall(r"^print\(.*#\s*([^:\n]*)", program, re.MULTILINE)
    assert done.stdout.splitlines() == [line.strip() for line in promised]


def test_there_are_programs():
    assert len(PROGRAMS) == 4
