"""The tables of docs/reliability.md beside that of the bars: interrupts, coverage, mutants."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

INTERRUPTS = """\
## Interrupts of large copies

`test/reliability/interrupt_latency.py` sends SIGINT at random moments of an operation and counts
the time to the `KeyboardInterrupt`. The operation takes `whole` without an interrupt. A sweep that
is interrupted puts the last values back before it answers.
"""
COVERAGE = """\
## Coverage

`make coverage` counts the lines and branches that the tests run (`scripts/measure_coverage.py`);
each side of a condition is a branch. Bodies of kernels do not count: Python does not run them.
"""
MUTANTS = """\
## Mutants

A mutant is the code with one small change: another comparison, a condition negated, a statement or
a constant changed. `test/mutation/mutate.py` draws a sample by the seed and runs the tests that
reach it. A killed one fails a test or never ends. For each explained one,
[survivors.csv](../test/mutation/survivors.csv) says why no test can tell it from the code. The rate
is that of killed and explained ones among all of the sample, those that no test runs included.
"""


def read(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def share(part: str, whole: str) -> str:
    return f"{100 * int(part) / int(whole):.1f} %" if int(whole) else ""


def table(columns: list[str], rows: list[list[str]]) -> list[str]:
    lines = [columns, ["---"] * len(columns), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]


def origin(row: dict[str, str], show_age: Callable[[list[str]], str]) -> list[str]:
    where = f"{row['date']}, {row['machine']}, {row['commit']}"
    return [where, show_age(row["commit"].split())]


def interrupts(path: Path, show_age: Callable[[list[str]], str]) -> list[str]:
    rows = [[row["operation"], row["where"], row["mb"], f"{row['takes_ms']} ms",
             f"{row['median_ms']} ms", f"{row['worst_ms']} ms", row["interrupts"],
             *origin(row, show_age)] for row in read(path)]  # fmt: skip
    columns = ["operation", "on", "MB", "whole", "median", "worst", "interrupts",
               "date, machine, commit", "commits since"]  # fmt: skip
    return ["", INTERRUPTS, *table(columns, rows)] if rows else []


def coverage(path: Path, show_age: Callable[[list[str]], str]) -> list[str]:
    rows = [[row["part"], share(row["lines_run"], row["lines"]), row["lines"],
             share(row["branches_run"], row["branches"]), row["branches"], row["tests"],
             *origin(row, show_age)] for row in read(path)]  # fmt: skip
    columns = ["part", "lines run", "of", "branches run", "of", "tests", "date, machine, commit",
               "commits since"]  # fmt: skip
    return ["", COVERAGE, *table(columns, rows)] if rows else []


def mutants(path: Path, show_age: Callable[[list[str]], str]) -> list[str]:
    rows = []
    for row in read(path):
        noticed = str(int(row["killed"]) + int(row["explained"]))
        numbers = [row[name] for name in ("killed", "explained", "survived", "not_run")]
        sample = f"{row['sample']} of {row['mutants']}, seed {row['seed']}"
        rows.append([row["part"], sample, share(noticed, row["sample"]), *numbers,
                     *origin(row, show_age)])  # fmt: skip
    columns = ["part", "sample", "rate", "killed", "explained", "survived", "run by no test",
               "date, machine, commit", "commits since"]  # fmt: skip
    return ["", MUTANTS, *table(columns, rows)] if rows else []
