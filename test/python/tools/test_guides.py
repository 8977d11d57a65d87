"""The programs of guides that have no test of their own run as they stand.

A comment behind a `print` is the line that it prints.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGES = {
    "guides/from-taichi.md": 2,
    "guides/from-warp.md": 1,
    "guides/from-jax.md": 1,
    "guides/from-pytorch.md": 1,
    "guides/robots.md": 2,
    "guides/windows.md": 2,
}


def programs(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)


CASES = [(page, number) for page in PAGES for number in range(len(programs(page)))]


@pytest.mark.parametrize(("page", "number"), CASES)
def test_program(page, number, tmp_path):
    program = programs(page)[number]
    file = tmp_path / "program.py"
    file.write_text(program)
    run = [sys.executable, "-W", "error::UserWarning", str(file)]
    done = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    promised = re.findall(r"^print\(.*\)  # (.*)", program, re.MULTILINE)
    assert done.stdout.splitlines() == promised
    assert promised or "assert" in program


@pytest.mark.parametrize("page", PAGES)
def test_there_are_programs(page):
    assert len(programs(page)) == PAGES[page]
