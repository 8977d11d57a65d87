"""The page of the simulators: its programs exist, and take the options that it names."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
PAGE = DOCS / "start" / "examples.md"
TEXT = PAGE.read_text()


def commands():
    """Programs and the options after them, in commands and in rows of tables."""
    found = {}
    for name, rest in re.findall(r"(?:examples/|`)(\w+\.py)((?: +--?[\w-]+(?: \S+)?)*)", TEXT):
        found.setdefault(name, set()).update(re.findall(r"--[a-z-]+", rest))
    for row in re.findall(r"^\| `(\w+\.py)`.*$", TEXT, re.M):
        line = next(text for text in TEXT.splitlines() if text.startswith(f"| `{row}`"))
        found[row] |= set(re.findall(r"--[a-z-]+", line))
    return sorted(found.items())


@pytest.mark.parametrize("name, options", commands())
def test_programs_and_their_options(name, options):
    path = ROOT / ("scripts" if name == "line_counts.py" else "examples") / name
    assert path.is_file()
    if not options:
        return
    done = subprocess.run([sys.executable, path, "--help"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    known = set(re.findall(r"--[a-z-]+", done.stdout))
    assert options <= known, options - known


def test_no_program_is_left_out():
    listed = set(re.findall(r"`(\w+\.py)`", TEXT))
    programs = [path for path in (ROOT / "examples").glob("*.py") if "__main__" in path.read_text()]
    assert len(programs) > 20 and {path.name for path in programs} <= listed


def test_pictures():
    shown = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", TEXT)
    assert len(shown) >= 3
    for name in shown:
        path = PAGE.parent / name
        assert path.is_file() and path.stat().st_size < 150_000
    pages = "".join(page.read_text() for page in [ROOT / "README.md", *DOCS.rglob("*.md")])
    for path in DOCS.glob("*/pictures/*"):
        assert f"pictures/{path.name})" in pages, f"no page shows {path.name}"
