"""Runs the 44 stress cases and prints the outcome and measurements of each.

python scripts/stress.py                    all, at the sizes of the table
python scripts/stress.py --only S22 S26     some of them
python scripts/stress.py --short            small sizes, as in the normal test run
python scripts/stress.py --arch emulated    as on a GPU
python scripts/stress.py --write            writes docs/reports/stress.md, too

Exits with 1 if a test fails. Expected failures are listed with their reasons.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import re
import sys
import textwrap
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
TESTS = ROOT / "test/python"
FOLDER = TESTS / "stress"
PAGE = ROOT / "docs/reports/stress.md"
sys.path[:0] = [str(ROOT / "python"), str(FOLDER)]

from stress_cases import CASES, cases_of  # noqa: E402

TREES = "test_expression_trees"


class Collector:
    """Keeps the tests of the cases, and what came of them."""

    def __init__(self, only: set[int]):
        self.only = only
        self.outcomes: dict[int, list[str]] = defaultdict(list)
        self.modules: dict[int, set[str]] = defaultdict(set)
        self.figures: dict[int, dict[str, tuple[str, float, float]]] = defaultdict(dict)
        self.known: dict[str, str] = {}
        self.trees: list[str] = []

    @staticmethod
    def parts(nodeid: str) -> tuple[str, str]:
        file, _, test = nodeid.partition("::")
        return Path(file).stem, test

    def pytest_collection_modifyitems(self, config: Any, items: list[Any]) -> None:
        del config
        items[:] = [item for item in items if self._chosen(*self.parts(item.nodeid))]

    def _chosen(self, module: str, test: str) -> bool:
        found = cases_of(module, test)
        if self.only:
            return bool(found & self.only)
        return bool(found) or module == TREES

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when != "call" and not (report.when == "setup" and report.outcome != "passed"):
            return
        module, test = self.parts(report.nodeid)
        known = hasattr(report, "wasxfail")
        outcome = "known" if known and report.skipped else report.outcome
        if outcome == "known":
            self.known[f"{module}::{test}"] = report.wasxfail.removeprefix("reason: ")
        if module == TREES:
            self.trees.append(outcome)
        for case in cases_of(module, test):
            self.outcomes[case].append(outcome)
            self.modules[case].add(module)
            for name, value in report.user_properties:
                if name == "measured" and outcome == "passed":
                    self._keep(case, test, *value)

    def _keep(self, case: int, test: str, what: str, value: float, bound: float) -> None:
        dtype = re.search(r"\bf(32|64)\b", test)
        key = f"{what}, {dtype[0]}" if dtype else what
        old = self.figures[case].get(key)
        if old is None or share(value, bound) > share(*old[1:]):
            self.figures[case][key] = (key, value, bound)

    def result(self, case: int) -> str:
        outcomes = self.outcomes[case]
        counts = [(name, outcomes.count(name)) for name in ("passed", "known", "failed", "skipped")]
        words = {"known": "known to fail"}
        return ", ".join(f"{n} {words.get(name, name)}" for name, n in counts if n) or "not run"

    def measured(self, case: int) -> str:
        figures = sorted(self.figures[case].values())
        return "; ".join(f"{key}: {value:.2g} ≤ {bound:.2g}" for key, value, bound in figures)

    @property
    def failed(self) -> int:
        return sum(o == "failed" for all_ in [*self.outcomes.values(), self.trees] for o in all_)


def share(value: float, bound: float) -> float:
    return value / bound if bound else value


def files() -> list[str]:
    """The files with tests of cases, wherever they are."""
    named = {name.partition("::")[0] for case in CASES.values() for name in case.elsewhere}
    return [str(FOLDER), *sorted(str(p) for p in TESTS.rglob("test_*.py") if p.stem in named)]


INTRODUCTION = """
    Kinks, long loops, ill-conditioned sums, contacts, degenerate matrices, denormals:
    the expected values and gradients there, and the measured ones. Kinks and matrices are tested in
    f32 and f64 and in reverse and forward mode; solves, checkpoints, storage and sums as their rows
    say, in reverse mode. `make stress` runs all at the sizes of the table and prints it
    (`ARGS=--short`: the small sizes of the normal test run; `ARGS="--arch emulated"`: as on a GPU;
    `ARGS="--only S22"`: some of them), and `make stress ARGS=--write` writes this page. The tests
    state bounds with their reasons."""


def wrap(text: str) -> str:
    return textwrap.fill(" ".join(text.split()), 99, break_on_hyphens=False)


def page(collector: Collector, size: str) -> str:
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("NumPy", "mpmath")]
    about = f"""
        Measured at {size} size on {platform.machine()} with {os.cpu_count()} cores,
        {" and ".join(versions)}. A figure is the one that is nearest to its bound, of all tests of
        the case; where there is none, results are compared exactly or by the test alone."""
    lines = ["# Stress cases", "", wrap(INTRODUCTION), "", wrap(about), ""]
    lines += ["| id | case | expected | tested in | result | measured ≤ bound |"]
    lines += ["|---|---|---|---|---|---|"]
    for number, case in CASES.items():
        modules = ", ".join(
            f"`{name.removeprefix('test_')}`" for name in sorted(collector.modules[number])
        )
        lines.append(
            f"| S{number} | {case.name} | {case.expected} | {modules} | "
            f"{collector.result(number)} | {collector.measured(number)} |"
        )
    trees = f"""
        Besides, expression trees over all operations, each once and then drawn at random
        (hypothesis), are differentiated in both modes at zeros of both signs, ties, denormals, huge
        numbers and NaN: the modes agree, and nothing is NaN where the value is finite and mpmath
        finds finite slopes ({collector.trees.count("passed")} tests)."""
    lines += ["", wrap(trees), "", "## Known to fail", ""]
    if not collector.known:
        return "\n".join([*lines, "No test is known to fail on the CPU."]) + "\n"
    lines += ["Each is a strict expected failure: the run fails when it passes.", ""]
    lines += ["| tests | why |", "|---|---|"]
    grouped: dict[str, list[str]] = defaultdict(list)
    for test, reason in sorted(collector.known.items()):
        grouped[reason].append(test)
    for reason, tests in grouped.items():
        more = f" and {len(tests) - 1} more" if len(tests) > 1 else ""
        lines.append(f"| `{tests[0]}`{more} | {reason} |")
    return "\n".join(lines) + "\n"


def report(collector: Collector) -> None:
    for number, case in CASES.items():
        if collector.only and number not in collector.only:
            continue
        result, measured = collector.result(number), collector.measured(number)
        print(f"S{number:<3} {case.name:45.45} {result:32} {measured}")
    if collector.trees:
        print(f"     expression trees: {collector.trees.count('passed')} passed")
    for test, reason in sorted(collector.known.items()):
        print(f"known to fail: {test}: {reason}")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="S22")
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--arch", choices=["cpu", "cuda", "emulated"], default="cpu")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    only = {int(name.lstrip("Ss")) for name in options.only}
    if unknown := only - set(CASES):
        parser.error(f"there is no case {', '.join(f'S{n}' for n in sorted(unknown))}")
    if options.write and (only or options.arch != "cpu"):
        parser.error("the page is about all cases, on the CPU")
    collector = Collector(only)
    arguments = ["-q", "--tb=short", "--timeout=1200", "-p", "no:cacheprovider", *files()]
    if options.arch != "cpu":
        arguments.append(f"--arch={options.arch}")
    if not options.short:
        arguments.append("--long")
    status = pytest.main(arguments, plugins=[collector])
    report(collector)
    if options.write:
        PAGE.write_text(page(collector, "small" if options.short else "full"))
    return 1 if collector.failed else int(status)


if __name__ == "__main__":
    sys.exit(main())
