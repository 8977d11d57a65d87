"""Checks, or with --fix repairs, the style of the tracked C++ and Python files.

Each check prints its findings and counts as one test of `make test`.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import house
import lock_discipline
import measured_commits
import prose
import rooms
import rooms_python
import tidy

ROOT = Path(__file__).resolve().parent.parent
LICENSE_TAG = "SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception"
MAX_LINES = 800


def tracked(*patterns: str) -> list[str]:
    """Files of the checkout that match, tracked or about to be."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return sorted(name for name in set(output.splitlines()) if (ROOT / name).is_file())


def run(command: list[str]) -> str:
    """Runs `command`; returns its output if it failed, and "" if it passed."""
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    return "" if result.returncode == 0 else (result.stdout + result.stderr).strip() or "failed"


def clang_format(fix: bool) -> str:
    files = tracked("*.cpp", "*.h", "*.cu")
    mode = ["-i"] if fix else ["--dry-run", "-Werror"]
    return run(["clang-format-22", *mode, *files]) if files else ""


def ruff_format(fix: bool) -> str:
    mode = [] if fix else ["--check"]
    return run([sys.executable, "-m", "ruff", "format", "-q", *mode, "."])


def ruff_check(fix: bool) -> str:
    mode = ["--fix"] if fix else []
    return run([sys.executable, "-m", "ruff", "check", "-q", *mode, "."])


def license_headers(_fix: bool) -> str:
    """Every C++ file names its licence."""
    bad = [
        name
        for name in tracked("*.cpp", "*.h", "*.cu")
        if LICENSE_TAG not in (ROOT / name).read_text()
    ]
    return "\n".join(f"{name}: no licence header" for name in bad)


def file_sizes(_fix: bool) -> str:
    """A file that cannot be read in one sitting should be two."""
    bad = []
    for name in tracked("*.cpp", "*.h", "*.cu", "*.td", "*.py"):
        lines = (ROOT / name).read_text().count("\n")
        if lines > MAX_LINES:
            bad.append(f"{name}: {lines} lines, at most {MAX_LINES}")
    return "\n".join(bad)


def lit_run_lines(_fix: bool) -> str:
    """Every lit test runs something and checks the outcome."""
    bad = []
    for name in tracked("test/*.mlir"):
        if "/Inputs/" in name or name.startswith("test/python/"):
            continue
        text = (ROOT / name).read_text()
        if not re.search(r"^\s*//\s*RUN:", text, re.M):
            bad.append(f"{name}: no RUN line")
    return "\n".join(bad)


def python_types(_fix: bool) -> str:
    """Types of the package; `[tool.mypy]` of pyproject.toml says of which modules."""
    if importlib.util.find_spec("mypy") is None:
        print("lint: types are not checked: no mypy; scripts/setup.sh installs it")
        return ""
    return run([sys.executable, "-m", "mypy", "--no-error-summary"])


def python_rooms(_fix: bool) -> str:
    """Packages of `python/tai` import from those below them, at the top of a module; no crowds."""
    package = ROOT / "python" / "tai"
    found = rooms_python.problems(package) + rooms_python.crowds(package, ROOT / "test/python")
    return "\n".join(found)


def rooms_of_sources(_fix: bool) -> str:
    """Includes go one way, classes are not cut into slices, folders are not crowded."""
    return "\n".join(rooms.check())


def house_rules(fix: bool) -> str:
    """Passes have tests in their rooms; the counts of each subject's places do not rise."""
    if fix:
        house.lower_bars()
        return ""
    return "\n".join(house.check())


def python_lock(_fix: bool) -> str:
    """The extension module takes Python's lock back after each call of libtai."""
    return "\n".join(lock_discipline.check())


def plain_prose(_fix: bool) -> str:
    """Sentences of comments, docstrings and pages begin with a noun or a verb."""
    return "\n".join(prose.check())


def commits_of_results(_fix: bool) -> str:
    """The rows of docs/reliability.md name commits of the history; old ones are listed."""
    if reason := measured_commits.why_unknown():
        print(f"lint: commits of measured rows are not checked: {reason}")
        return ""
    if old := measured_commits.old():
        names = ", ".join(f"{name} ({count})" for name, count in old)
        print(f"lint: rows measured more than {measured_commits.OLD} commits ago: {names}")
    return "\n".join(measured_commits.problems())


# Each takes some 8 seconds of a core.
MOST_TIDIED = 8


def clang_tidy(_fix: bool) -> str:
    """clang-tidy over sources and headers that are not committed; `make tidy` takes more."""
    names = tidy.changed(committed=False)
    if not names:
        return ""
    build = ROOT / "build"
    if lacks := tidy.why_not(build):
        print(f"lint: changed sources are not checked: {lacks}")
        return ""
    sources = tidy.to_look_at(names, tidy.compiled(build))
    if len(sources) > MOST_TIDIED:
        print(f"lint: {len(sources)} sources have changed, which are left to `make tidy`")
        return ""
    return "\n".join(tidy.findings(sources, build, jobs=2))


CHECKS: dict[str, Callable[[bool], str]] = {
    "clang-format": clang_format,
    "ruff format": ruff_format,
    "ruff check": ruff_check,
    "licence headers": license_headers,
    "file sizes": file_sizes,
    "RUN lines": lit_run_lines,
    "Python rooms": python_rooms,
    "Python types": python_types,
    "rooms": rooms_of_sources,
    "house": house_rules,
    "Python's lock": python_lock,
    "prose": plain_prose,
    "measured commits": commits_of_results,
    "clang-tidy": clang_tidy,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fix", action="store_true", help="repair what can be repaired")
    fix = parser.parse_args().fix
    failed = 0
    for name, check in CHECKS.items():
        problem = check(fix)
        if problem:
            failed += 1
            print(f"FAIL lint: {name}\n{problem}")
    print(f"lint: {len(CHECKS) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
