"""The programs of guides run as they stand."""

import re
import runpy
from pathlib import Path

import pytest
import tai as ti

GUIDES = Path(__file__).resolve().parents[3] / "docs/guides"
PAGES = ["checkpoints", "jacobians", "numpy", "python-in-kernels", "solve-to"]


def _programs():
    for page in PAGES:
        text = (GUIDES / f"{page}.md").read_text()
        for number, program in enumerate(re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)):
            yield pytest.param(program, id=f"{page}-{number}")


@pytest.mark.parametrize("program", list(_programs()))
def test_program(program, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "program.py"
    path.write_text(program)
    try:
        runpy.run_path(str(path), run_name="__main__")
    finally:
        ti.reset()
    assert not capsys.readouterr().err
