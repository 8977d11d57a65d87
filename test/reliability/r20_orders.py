"""R20: the tests pass in any order, several at a time.

The Python tests run with `--shuffle` and as many workers as the bar asks for, those of lit and
GoogleTest in random orders. A test that fails is run again by itself, in its usual order: one that
then passes is a flake, one that fails again is broken. Both are counted as failures.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from bars import ROOT, Bar

LIT = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin")) / "lit"
# The tests of a short run: many small tests that share a process.
FEW = ("test_api", "test_errors", "test_fields", "test_control_flow")


def failures(junit: Path) -> tuple[int, list[str]]:
    """How many tests a JUnit file holds, and those that failed, as `file::name`."""
    if not junit.exists():
        return 0, ["the runner died"]
    failed, number = [], 0
    for case in ElementTree.parse(junit).getroot().iter("testcase"):
        number += 1
        if case.find("failure") is not None or case.find("error") is not None:
            path = (case.get("classname") or "").replace(".", "/")
            failed.append(f"{path}.py::{case.get('name')}")
    return number, failed


def run_pytest(seed: int, workers: int, files: list[str]) -> tuple[int, list[str], list[str]]:
    """How many tests ran in an order, which failed, and which of these fail again alone."""
    with tempfile.TemporaryDirectory() as folder:
        junit = Path(folder) / "junit.xml"
        command = [sys.executable, "-m", "pytest", "-q", "--tb=short", f"--junitxml={junit}"]
        order = [f"--shuffle={seed}", "-n", str(workers)]
        subprocess.run([*command, *order, *files], cwd=ROOT, capture_output=True)
        number, failed = failures(junit)
        again = []
        if failed and number:
            junit.unlink()
            subprocess.run([*command, *failed], cwd=ROOT, capture_output=True)
            again = failures(junit)[1]
    return number, failed, again


def run_gtest(build: Path, seed: int, times: int) -> tuple[int, list[str]]:
    program = build / "bin/tai-unit-tests"
    command = [program, "--gtest_brief=1", "--gtest_shuffle", f"--gtest_random_seed={seed + 1}"]
    run = subprocess.run([*command, f"--gtest_repeat={times}"], capture_output=True, text=True)
    failed = re.findall(r"^\[  FAILED  \] (\S+?)[, ].*\(\d+ ms\)$", run.stdout, re.MULTILINE)
    ran = sum(map(int, re.findall(r"^\[==========\] (\d+) tests? from", run.stdout, re.MULTILINE)))
    if run.returncode != 0 and not failed:
        failed = [f"GoogleTest ended with {run.returncode}"]
    return ran, failed


def run_lit(build: Path, workers: int) -> tuple[int, list[str]]:
    command = [sys.executable, LIT, "-q", "--order=random", f"-j{workers}", build / "test"]
    run = subprocess.run(command, capture_output=True, text=True)
    failed = re.findall(r"^  tai :: (\S+)", run.stdout, re.MULTILINE)
    if run.returncode != 0 and not failed:
        failed = [f"lit ended with {run.returncode}"]
    return len(list((ROOT / "test").glob("**/*.mlir"))), failed


def main() -> None:
    bar = Bar(
        "R20", "tests in random order", full=20, short=1, adds=True,
        target="20 runs of the suite with 8 workers: 0 flakes",
        miss="a test that fails in one order and passes by itself, or that fails in both",
    )  # fmt: skip
    bar.parser.add_argument("--workers", type=int, default=8)
    bar.parser.add_argument("--files", nargs="+", help="files of tests; all without it")
    args = bar.parse()
    workers = 2 if args.short else args.workers
    files = args.files or ["test/python"]
    if args.short:
        files = [str(p) for name in FEW for p in (ROOT / "test/python").rglob(f"{name}.py")]
    runs = tests = flakes = broken = 0
    while runs < args.count and (bar.left() > 0 or runs == 0):
        seed = args.seed + runs
        number, failed, again = run_pytest(seed, workers, files)
        tests += number
        if not args.short and not args.files:
            for more, bad in (run_gtest(args.build, seed, 3), run_lit(args.build, workers)):
                tests += more
                failed += bad
        for name in failed:
            what = "broken" if name in again else "flake"
            print(f"seed {seed}: {what}: {name}", flush=True)
        broken += sum(name in again for name in failed)
        flakes += sum(name not in again for name in failed)
        runs += 1
    some = f"of {len(files)} files alone" if args.short or args.files else "of the whole suite"
    bar.report(
        f"{runs} runs with {workers} workers, {tests} tests in all, {some}",
        f"{flakes} flakes, {broken} broken", met=not flakes and not broken and tests > 0,
    )  # fmt: skip


if __name__ == "__main__":
    main()
