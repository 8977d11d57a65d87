"""The commits at which the numbers of docs/reliability.md were measured.

A number says little about code that nobody can get. Each table below names the commits of its
rows, which have to be in the history of the checkout; a row is old if more than `OLD` commits
came after the oldest of its commits.
"""

from __future__ import annotations

import csv
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
# Tables with a column "commit", whose first column names the row.
TABLES = ("reliability-cpu", "reliability-gpu", "interrupts", "coverage", "mutants")
OLD = 200


class Row(NamedTuple):
    """A row of a table, and its commits."""

    table: str
    name: str
    commits: list[str]


def git(root: Path, *words: str) -> str | None:
    """The output of git, or nothing if it fails or is not there."""
    try:
        done = subprocess.run(["git", "-C", root, *words], capture_output=True, text=True)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def why_unknown(root: Path = ROOT) -> str:
    """The reason for which the history cannot be asked, or nothing."""
    shallow = git(root, "rev-parse", "--is-shallow-repository")
    if shallow is None:
        return "this is no checkout of git, or there is no git"
    return "the clone is shallow: its history ends early" if shallow == "true" else ""


def age(commit: str, root: Path = ROOT) -> int | None:
    """How many commits came after one; nothing if it is not in the history of HEAD."""
    if git(root, "merge-base", "--is-ancestor", commit, "HEAD") is None:
        return None
    count = git(root, "rev-list", "--count", f"{commit}..HEAD")
    return int(count) if count else None


def age_of(commits: list[str], root: Path = ROOT) -> int | None:
    """The age of the oldest of some commits, or nothing if one is not known."""
    ages = [age(commit, root) for commit in commits]
    return None if not ages or None in ages else max(a for a in ages if a is not None)


def rows(root: Path = ROOT) -> Iterator[Row]:
    for table in TABLES:
        path = root / f"benchmarks/results/{table}.csv"
        if not path.exists():
            continue
        with path.open(newline="") as file:
            for row in csv.DictReader(file, restval=""):
                yield Row(table, next(iter(row.values())), row["commit"].split())


def problems(root: Path = ROOT) -> list[str]:
    """Rows without a commit in the history of HEAD."""
    found = []
    for table, name, commits in rows(root):
        where = f"benchmarks/results/{table}.csv: {name}"
        if not commits:
            found.append(f"{where}: no commit")
        found += [f"{where}: the history of HEAD has no commit {one}; measure the row again"
                  for one in commits if age(one, root) is None]  # fmt: skip
    return found


def old(root: Path = ROOT) -> list[tuple[str, int]]:
    """Rows that are old, and how many commits came after them."""
    ages = [(row.name, age_of(row.commits, root)) for row in rows(root)]
    return [(name, count) for name, count in ages if count is not None and count > OLD]
