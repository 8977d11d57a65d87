"""The tests of C++ mutants: which of them reach a mutant, and whether they kill it."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from cpp_mutants import numbers_in

LLVM = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))
# A test with a mutant on gets this many times its own seconds, and some more.
PATIENCE = 5
MORE_SECONDS = 30


class Test(NamedTuple):
    """A test that passes in the build without any mutant."""

    kind: str
    name: str
    seconds: float


class Build:
    """The build of a copy of the tree that holds all mutants."""

    def __init__(self, copy: Path):
        self.copy, self.build = copy, copy / "build"
        self.count = len(json.loads((copy / "mutants.json").read_text()))

    def seen(self) -> Path:
        """The file of the mutants that a test of this thread reaches."""
        return self.copy / f"seen-{threading.get_ident()}"

    def environment(self, mutant: int | None) -> dict[str, str]:
        """Compiled code of one mutant is not that of another: the cache starts empty."""
        cache = self.copy / f"cache-{threading.get_ident()}"
        shutil.rmtree(cache, ignore_errors=True)
        variables = os.environ | {
            "TAI_MUTANT_CACHE": str(cache), "TAI_CACHE_DIR": str(cache),
            "PYTHONPATH": os.pathsep.join([str(self.copy / "python"), str(Path(__file__).parent)]),
            "TAI_BUILD_DIR": str(self.build), "TAI_VERIFY_EACH": "1",
        }  # fmt: skip
        if mutant is None:
            self.seen().write_bytes(bytes(self.count))
            return variables | {"TAI_MUTANT_SEEN": str(self.seen())}
        return variables | {"TAI_MUTANT": str(mutant)}

    def run(self, command: list[object], environment: dict[str, str], limit: float) -> int | None:
        """The exit status, or None after the time."""
        process = subprocess.Popen(
            list(map(str, command)), cwd=self.copy, env=environment, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            return process.wait(limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return None

    def lit(self, names: list[str]) -> list[object]:
        files = [self.build / "test" / name for name in names]
        return [sys.executable, LLVM / "lit", "-q", "-j1", "--max-failures=1", *files]

    def gtest(self, names: list[str]) -> list[object]:
        program = self.build / "bin/tai-unit-tests"
        return [
            program,
            "--gtest_brief=1",
            "--gtest_fail_fast",
            f"--gtest_filter={':'.join(names)}",
        ]

    def pytest(self, names: list[str]) -> list[object]:
        return [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "--tb=no",
            "-p",
            "no:cacheprovider",
            *names,
        ]

    def command(self, kind: str, names: list[str]) -> list[object]:
        return {"lit": self.lit, "gtest": self.gtest, "pytest": self.pytest}[kind](names)

    def patch_lit(self) -> None:
        """Lets lit pass on what switches mutants, and keep each one's code apart."""
        path = self.copy / "test/lit.cfg.py"
        text = path.read_text()
        if "TAI_MUTANT" not in text:
            text = text.replace('["HOME", ', '["HOME", "TAI_MUTANT", "TAI_MUTANT_SEEN", ')
            text += '\nif "TAI_MUTANT_CACHE" in os.environ:\n'
            text += '    config.environment["TAI_CACHE_DIR"] = os.environ["TAI_MUTANT_CACHE"]\n'
            path.write_text(text)

    def names_of(self, kind: str) -> list[str]:
        if kind == "lit":
            found = [p for p in (self.copy / "test").rglob("*") if p.suffix in (".mlir", ".test")]
            names = [str(p.relative_to(self.copy / "test")) for p in found]
            skipped = r"(^|/)(Inputs|python|unit|fuzz)/|^(Downstream|CAPI)/"
            return sorted(name for name in names if not re.search(skipped, name))
        program = self.build / "bin/tai-unit-tests"
        listing = subprocess.run([program, "--gtest_list_tests"], capture_output=True, text=True)
        names, suite = [], ""
        for line in listing.stdout.splitlines():
            word = line.split("#")[0].rstrip()
            if word.endswith(".") and not word.startswith(" "):
                suite = word
            elif word.startswith("  ") and suite:
                names.append(suite + word.strip())
        return names

    def reach(self, kind: str, notes: Path, jobs: int) -> None:
        """Runs each test by itself, and notes its mutants."""

        def run(name: str) -> dict[str, object]:
            begun = time.monotonic()
            status = self.run(self.command(kind, [name]), self.environment(None), 300)
            return {"kind": kind, "test": name, "seconds": time.monotonic() - begun,
                    "passed": status == 0,
                    "numbers": list(numbers_in(self.seen().read_bytes()))}  # fmt: skip

        with notes.open("a") as file, ThreadPoolExecutor(jobs) as pool:
            for row in pool.map(run, self.names_of(kind)):
                file.write(json.dumps(row) + "\n")
                file.flush()

    def reach_pytest(self, files: list[str], notes: Path, jobs: int) -> None:
        environment = self.environment(None) | {"TAI_MUTANT_NOTES": str(notes)}
        command = self.pytest(files)
        command.remove("-x")
        command += ["-n", str(jobs)] if jobs > 1 else []
        self.run([*command, "-p", "seen_plugin"], environment, 7200)


class Reached:
    """The tests that reach each mutant, quick ones first."""

    def __init__(self, notes: list[Path]):
        self.tests: dict[int, list[Test]] = defaultdict(list)
        for path in notes:
            for line in path.read_text().splitlines() if path.exists() else []:
                row = json.loads(line)
                if row["passed"]:
                    test = Test(row.get("kind", "pytest"), row["test"], row["seconds"])
                    for number in row["numbers"]:
                        self.tests[number].append(test)
        for tests in self.tests.values():
            tests.sort(key=lambda test: test.seconds)

    def choose(self, number: int, kind: str, budget: float) -> list[Test]:
        chosen, taken = [], 0.0
        for test in self.tests.get(number, []):
            if test.kind == kind:
                taken += test.seconds
                if taken > budget and chosen:
                    break
                chosen.append(test)
        return chosen


def judge(build: Build, reached: Reached, number: int, budget: float) -> dict[str, object]:
    """Runs the tests of a mutant until one fails: lit, unit tests, then Python."""
    if not reached.tests.get(number):
        return {"outcome": "not run by any test", "tests": 0}
    count = 0
    begun = time.monotonic()
    for kind in ("lit", "gtest", "pytest"):
        tests = reached.choose(number, kind, budget)
        # A few first: most mutants die there.
        for part in (tests[:8], tests[8:]):
            if not part:
                continue
            count += len(part)
            limit = MORE_SECONDS + PATIENCE * sum(test.seconds for test in part)
            command = build.command(kind, [test.name for test in part])
            status = build.run(command, build.environment(number), limit)
            if status != 0:
                outcome = "timeout" if status is None else "killed"
                seconds = round(time.monotonic() - begun, 1)
                return {"outcome": outcome, "by": kind, "tests": count, "seconds": seconds}
    seconds = round(time.monotonic() - begun, 1)
    return {"outcome": "survived", "tests": count, "seconds": seconds}
