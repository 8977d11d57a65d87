"""The bars of reliability in their short form; see test/reliability/README.md."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = sorted((ROOT / "test/reliability").glob("r[0-9]*_*.py"))
BARS = [path for path in SCRIPTS if "Bar(" in path.read_text()]


@pytest.mark.parametrize("script", BARS, ids=lambda path: path.stem)
def test_bar(script):
    environment = os.environ | {"PYTHONPATH": str(ROOT / "python")}
    command = [sys.executable, script, "--short"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=200)
    assert result.returncode == 0, result.stdout + result.stderr
    name = script.stem.split("_")[0].upper()
    assert re.search(rf"^{name} .+: .+; .+ \(bar .+\)$", result.stdout, re.MULTILINE), result.stdout


@pytest.mark.parametrize("program, kind", [("while True: pass", "late"), ("input()", "hang")])
def test_a_tool_ends_with_the_time_of_the_run(program, kind):
    """One that computes may be slow on this machine; one that waits would wait for ever."""
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import r1_text_mutants as r1

    reader, writer = os.pipe()
    command = [sys.executable, "-c", program]
    ended = r1.run_limited(command, seconds=100, left=1, stdin=reader, stdout=subprocess.DEVNULL)
    os.close(reader), os.close(writer)
    assert ended[0] == kind


def test_the_page_is_that_of_the_scripts():
    """docs/reliability.md is made of the scripts and of what is kept of their runs."""
    sys.path.insert(0, str(ROOT / "test/reliability"))
    import soak

    assert set(soak.SECONDS) == set(soak.scripts())
    assert sum(soak.SECONDS.values()) <= 90 * 60
    assert soak.make_page() == soak.PAGE.read_text()
