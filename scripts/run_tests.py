"""Runs all tests: lit, GoogleTest, pytest and the style checks.

Each kind ends with its own count, and the last line has the total. A runner that crashes or
finds no test counts as a failure.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from sanitizers import SANITIZERS, Sanitizer, find_reports

ROOT = Path(__file__).resolve().parent.parent
# Tests that the list of the slowest has.
SLOWEST = 10
LLVM_BIN = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))


@dataclass
class Result:
    """The result of one runner."""

    kind: str
    passed: int = 0
    failed: int = 0
    failures: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    # Seconds of each test, as its runner counts them, and of the runner.
    times: dict[str, float] = field(default_factory=dict)
    seconds: float = 0

    def add_junit(self, path: Path) -> None:
        """Adds the test cases of a JUnit XML file, as lit and pytest write it."""
        for case in ElementTree.parse(path).getroot().iter("testcase"):
            name = f"{case.get('classname', '')}.{case.get('name', '')}".strip(".")
            skip = case.find("skipped")
            self.times[name] = float(case.get("time") or 0)
            if case.find("failure") is not None or case.find("error") is not None:
                self.fail(name)
            elif skip is not None:
                reason = " ".join([skip.get("message") or "", skip.text or ""]).strip()
                self.skipped.append(f"{name}: {reason or 'no reason given'}")
            else:
                self.passed += 1

    def fail(self, what: str) -> None:
        self.failed += 1
        self.failures.append(what)

    def close(self, status: int) -> Result:
        """Counts a runner that died or that found nothing, and prints the count."""
        if status != 0 and self.failed == 0:
            self.fail(f"the runner ended with status {status}")
        elif self.passed + self.failed == 0:
            self.fail("no test ran")
        for line in self.skipped:
            print(f"SKIP {self.kind}: {line}")
        for line in self.failures:
            print(f"FAIL {self.kind}: {line}")
        skipped = f", {len(self.skipped)} skipped" if self.skipped else ""
        print(f"{self.kind}: {self.passed} passed, {self.failed} failed{skipped}\n", flush=True)
        return self


def call(command: list[object], environment: dict[str, str] | None = None) -> int:
    """Runs a runner with its output on ours; `environment` is added to what there is."""
    print("$", *command, flush=True)
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=ROOT, env=os.environ | (environment or {})).returncode


def sample_of_lit() -> list[Path]:
    """The first lit test of each folder, and each fourth of the others."""
    folders: dict[Path, list[Path]] = {}
    for path in sorted((ROOT / "test").rglob("*")):
        parts = path.relative_to(ROOT / "test").parts
        if path.suffix in (".mlir", ".test") and not {"Inputs", "python", "fuzz"} & {*parts}:
            folders.setdefault(path.parent, []).append(path)
    return [path for paths in folders.values() for path in paths[::4]]


def run_lit(build: Path, jobs: int, out: Path, quick: bool = False) -> Result:
    result = Result("lit")
    xml = out / "lit.xml"
    lit = [sys.executable, LLVM_BIN / "lit", "-s", "-v"]
    chosen = [build / "test"]
    if quick:
        # Names of sources, which the script of the build folder takes.
        lit, chosen = [build / "bin/tai-lit", "-s", "-v"], sample_of_lit()
    status = call([*lit, f"-j{jobs}", f"--xunit-xml-output={xml}", *chosen])
    if xml.exists():
        result.add_junit(xml)
    return result.close(status)


def run_gtest(build: Path, out: Path, environment: dict[str, str] | None = None) -> Result:
    result = Result("gtest")
    program, report = build / "bin/tai-unit-tests", out / "gtest.json"
    if not program.exists():
        result.fail(f"{program} was not built")
        return result.close(1)
    status = call([program, "--gtest_brief=1", f"--gtest_output=json:{report}"], environment)
    if report.exists():
        for suite in json.loads(report.read_text())["testsuites"]:
            for case in suite["testsuite"]:
                name = f"{suite['name']}.{case['name']}"
                result.times[name] = float(case.get("time", "0s").rstrip("s"))
                if case.get("failures"):
                    result.fail(name)
                elif case.get("result") == "SKIPPED":
                    reasons = [s.get("message", "") for s in case.get("skipped", [])]
                    result.skipped.append(f"{name}: {' '.join(reasons) or 'no reason given'}")
                elif case.get("status") == "RUN":
                    result.passed += 1
    return result.close(status)


def find_files(names: list[str]) -> list[Path]:
    """The files of test/python with these names, in whatever folder they are."""
    found = {path.stem: path.relative_to(ROOT) for path in (ROOT / "test/python").rglob("*.py")}
    missing = [name for name in names if f"test_{name}" not in found]
    if missing:
        raise SystemExit(f"test/python has no test_{missing[0]}.py")
    return [found[f"test_{name}"] for name in names]


def run_pytest(jobs: int, out: Path, quick: bool = False) -> Result:
    result = Result("pytest")
    xml = out / "pytest.xml"
    command = [sys.executable, "-m", "pytest", "-q", "--tb=short", f"--junitxml={xml}"]
    if jobs > 1:
        command += ["-n", str(jobs)]
    if quick:
        command += ["--quick"]
    status = call([*command, "test/python"])
    if xml.exists():
        result.add_junit(xml)
    return result.close(status)


def run_sanitized(
    sanitizer: Sanitizer, build: Path, jobs: int, out: Path, rooms: list[str]
) -> list[Result]:
    """The tests of a preset with a sanitizer; each of its reports is a failure.

    Args:
        rooms: folders of test/python that run in the place of the preset's files.
    """
    reports = out / "reports"
    reports.mkdir()
    results = []
    if "lit" in sanitizer.kinds:
        results.append(run_lit(build, jobs, out))
    results.append(run_gtest(build, out, sanitizer.environment(reports)))
    files = list(sanitizer.files)
    if sanitizer.name == "asan":
        files += EMULATED
    result = Result("pytest")
    xml = out / "pytest.xml"
    command = [sys.executable, "-m", "pytest", "-q", "--tb=short", f"--junitxml={xml}"]
    # Its handler of signals would take crashes from the sanitizer. All is slower.
    command += ["-p", "no:faulthandler", "--timeout", "1200"]
    if jobs > 1:
        command += ["-n", str(jobs)]
    command += [f"test/python/{room}" for room in rooms] or find_files(sorted(set(files)))
    status = call(command, sanitizer.python_environment(build, reports))
    if xml.exists():
        result.add_junit(xml)
    results.append(result.close(status))
    found = Result("reports", passed=1)
    for line in find_reports(reports):
        found.fail(line)
    for path in sorted(reports.iterdir()):
        print(path.read_text(errors="replace"))
    return [*results, found.close(0)]


# Tests that the normal run repeats as on a GPU; `pytest --arch=emulated` takes all.
EMULATED = """
    access_rules ad_check ad_memory ad_seeds api argument_gradients arithmetic array_gradients
    benchmark_scenes control_flow fields forward_mode gradients loop_gradients matrices
    overwrites_in_kernel semantics_overwriting sparse_api structs
""".split()


def run_emulated(jobs: int, out: Path) -> Result:
    """Tests of kernels on the emulated device."""
    result = Result("emulated GPU")
    xml = out / "emulated.xml"
    command = [sys.executable, "-m", "pytest", "-q", "--tb=short", f"--junitxml={xml}"]
    command += ["--arch=emulated"]
    if jobs > 1:
        command += ["-n", str(jobs)]
    status = call([*command, *find_files(EMULATED)])
    if xml.exists():
        result.add_junit(xml)
    return result.close(status)


def run_layouts(build: Path, jobs: int, out: Path) -> list[Result]:
    """The tests of kernels on every layout: those of pytest, and whole programs in MLIR."""
    result = Result("layouts")
    xml = out / "layouts.xml"
    layouts = ["pointer", "bitmasked", "hash"]
    command = [sys.executable, "-m", "pytest", "-q", "--tb=short", f"--junitxml={xml}"]
    command += [f"--layout={name}" for name in layouts]
    if jobs > 1:
        command += ["-n", str(jobs)]
    status = call([*command, "test/python"])
    if xml.exists():
        result.add_junit(xml)
    programs = Result("programs on layouts")
    tools = [build / "bin/tai-run", build / "bin/tai-opt", LLVM_BIN / "FileCheck", LLVM_BIN / "not"]
    folder = ROOT / "test/Integration"
    again = call(
        [sys.executable, folder / "layouts.py", folder / "CPU", out / "layouts"]
        + ["--layouts", ",".join(layouts), "--jobs", jobs, "--log", out / "programs.xml", *tools]
    )
    if (out / "programs.xml").exists():
        programs.add_junit(out / "programs.xml")
    return [result.close(status), programs.close(again)]


def run_lint() -> Result:
    # Imported here: the other kinds do not depend on it.
    import lint

    result = Result("lint")
    for name, check in lint.CHECKS.items():
        problem = check(False)
        if problem:
            print(problem)
            result.fail(name)
        else:
            result.passed += 1
    return result.close(0)


def timed(runner: Callable[[], Result]) -> Result:
    begin = time.monotonic()
    result = runner()
    result.seconds = time.monotonic() - begin
    return result


def print_times(results: list[Result]) -> None:
    """Where the time went: by kind, and the slowest tests of all."""
    spent = ", ".join(f"{result.kind} {result.seconds:.0f} s" for result in results)
    print(f"time: {spent}")
    each = [(t, f"{result.kind}: {name}") for result in results for name, t in result.times.items()]
    for seconds, name in sorted(each, reverse=True)[:SLOWEST]:
        print(f"  {seconds:6.1f} s  {name}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", type=Path, default=Path("build"), help="build folder")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--layouts", action="store_true", help="the tests on every layout")
    parser.add_argument("--sanitizer", choices=SANITIZERS, help="with which BUILD was made")
    parser.add_argument(
        "--rooms", nargs="+", default=[], help="with a sanitizer: these folders of test/python"
    )
    parser.add_argument(
        "--quick", action="store_true",
        help="a part that has something of every room: some lit tests of each folder, all unit "
        "tests, one test of each file of pytest, the style checks",
    )  # fmt: skip
    parser.add_argument("--only", nargs="+", choices=["lit", "gtest", "pytest", "emulated", "lint"])
    args = parser.parse_args()
    build = (ROOT / args.build).resolve()
    # Verifiers after each pass; pytest and lit ask for them, too, when they run by themselves.
    os.environ.setdefault("TAI_VERIFY_EACH", "1")
    everything = ["lit", "gtest", "pytest", "emulated", "lint"]
    if args.quick:
        everything.remove("emulated")
    kinds = args.only or everything

    # With PYTHONDONTWRITEBYTECODE, each of the programs that tests start would compile the package.
    compileall.compile_dir(ROOT / "python/tai", quiet=2)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        runners = {
            "lit": lambda: run_lit(build, args.jobs, out, args.quick),
            "gtest": lambda: run_gtest(build, out),
            "pytest": lambda: run_pytest(args.jobs, out, args.quick),
            "emulated": lambda: run_emulated(args.jobs, out),
            "lint": run_lint,
        }
        if args.sanitizer:
            sanitizer = SANITIZERS[args.sanitizer]
            results = run_sanitized(sanitizer, build, args.jobs, out, args.rooms)
        elif args.layouts:
            results = run_layouts(build, args.jobs, out)
        else:
            results = [timed(runners[kind]) for kind in kinds]
            print_times(results)
    passed = sum(result.passed for result in results)
    failed = sum(result.failed for result in results)
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
