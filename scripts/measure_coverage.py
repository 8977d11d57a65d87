"""Measures how much of the code the tests run, in lines and branches.

    make coverage                                   # both, with all tests
    make coverage ARGS="--only python"
    make coverage ARGS="--only cpp --rooms ad tapes"        # part of the Python tests
    make coverage ARGS="--only cpp --folders AD Analysis"   # counters there alone

Python is counted by coverage.py over all of test/python, programs that tests start included;
bodies of kernels do not count, since the compiler and not Python runs them. C++ is counted by
clang in a build of its own, the preset `coverage`, over lit, the unit tests and the Python tests.

The numbers go into benchmarks/results/coverage.csv, and from there into docs/reliability.md.
`--uncovered FILE` writes the branches of lib that no test takes.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "test/reliability"))

TABLE = ROOT / "benchmarks/results/coverage.csv"
COLUMNS = ["part", "lines", "lines_run", "branches", "branches_run", "tests", "date", "machine",
           "commit"]  # fmt: skip
LLVM = Path(os.environ.get("TAI_LLVM_BIN", "/usr/lib/llvm-22/bin"))
BUILD = ROOT / "build-coverage"
# Folders of lib with a row of their own, beside that of all.
FOLDERS = ("AD", "Analysis", "Runtime/Tape")
# These judge times, or build whole programs; they run little that others do not.
LEFT_OUT = ("tools/test_reliability.py", "integration/test_gallery.py")

Counts = dict[str, int]


def call(command: Iterable[object], **more: object) -> int:
    words = [str(word) for word in command]
    print("$", *words, flush=True)
    return subprocess.run(words, cwd=ROOT, **more).returncode  # type: ignore[call-overload]


def pytest_command(jobs: int, rooms: list[str]) -> list[object]:
    command: list[object] = ["-m", "pytest", "-q", "--tb=line", "--timeout=1500"]
    command += ["-n", jobs] if jobs > 1 else []
    command += [f"--ignore=test/python/{name}" for name in LEFT_OUT]
    return [*command, *(f"test/python/{room}" for room in rooms or [""])]


def measure_python(jobs: int) -> dict[str, Counts]:
    folder = ROOT / "build/coverage"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    # A test that fails is counted as far as it went; `make test` says that it fails.
    coverage = [sys.executable, "-m", "coverage"]
    call([*coverage, "run", *pytest_command(jobs, [])])
    call([*coverage, "combine", "-q"])
    return read_python(folder)


def read_python(folder: Path) -> dict[str, Counts]:
    """The counts of a run, whose data are combined in a folder."""
    report = folder / "coverage.json"
    command = [sys.executable, "-m", "coverage", "json", "-q", f"--data-file={folder / 'data'}"]
    if call([*command, "-o", report]) != 0:
        raise SystemExit("there are no counts of Python")
    totals = json.loads(report.read_text())["totals"]
    return {"python/tai": {
        "lines": totals["num_statements"], "lines_run": totals["covered_lines"],
        "branches": totals["num_branches"], "branches_run": totals["covered_branches"],
    }}  # fmt: skip


def build_cpp(jobs: int, folders: list[str]) -> None:
    configure = ["cmake", "--preset", "coverage", f"-DTAI_COVERAGE={';'.join(folders) or 'all'}"]
    if call(configure, stdout=subprocess.DEVNULL) or call(["ninja", "-C", BUILD, f"-j{jobs}"]):
        raise SystemExit("the preset coverage does not build")


def run_cpp(jobs: int, rooms: list[str]) -> None:
    """Runs the tests; each process adds to the counts in the build."""
    profiles = BUILD / "profiles"
    shutil.rmtree(profiles, ignore_errors=True)
    profiles.mkdir()
    environment = os.environ | {
        "PYTHONPATH": str(BUILD / "python"), "TAI_BUILD_DIR": str(BUILD), "TAI_VERIFY_EACH": "1",
    }  # fmt: skip
    call([sys.executable, LLVM / "lit", "-q", f"-j{jobs}", BUILD / "test"], env=environment)
    call([BUILD / "bin/tai-unit-tests", "--gtest_brief=1"], env=environment)
    call([sys.executable, *pytest_command(jobs, rooms)], env=environment)


def export_cpp(folders: list[str]) -> dict:
    """The report of llvm-cov on each source."""
    merged = BUILD / "profiles/all.profdata"
    raw = sorted((BUILD / "profiles").glob("*.profraw"))
    if not raw or call([LLVM / "llvm-profdata", "merge", "-sparse", *raw, "-o", merged]):
        raise SystemExit("there are no counts of C++")
    command = [LLVM / "llvm-cov", "export", f"-instr-profile={merged}", BUILD / "lib/libtai.so"]
    command += [ROOT / "lib" / folder for folder in folders or [""]]
    found = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True)
    return json.loads(found.stdout)["data"][0]


def read_cpp(data: dict, folders: list[str]) -> dict[str, Counts]:
    """The counts of all folders together, and those of some folders."""
    counts: dict[str, Counts] = defaultdict(lambda: dict.fromkeys(COLUMNS[1:5], 0))
    whole = "lib" if not folders else f"lib/{{{','.join(folders)}}}"
    for file in data["files"]:
        relative = file["filename"].removeprefix(f"{ROOT}/lib/")
        parts = [f"lib/{name}" for name in FOLDERS if relative.startswith(f"{name}/")]
        for part in [whole, *parts]:
            for name in ("lines", "branches"):
                counts[part][name] += file["summary"][name]["count"]
                counts[part][f"{name}_run"] += file["summary"][name]["covered"]
    return dict(counts)


def uncovered(data: dict) -> list[str]:
    """The branches that were never taken, of conditions that were evaluated."""
    found = []
    for file in data["files"]:
        lines = Path(file["filename"]).read_text().splitlines()
        seen: dict[tuple[int, int, int, int], list[int]] = defaultdict(lambda: [0, 0])
        for begin, column, end, last, taken, not_taken, *_ in file["branches"]:
            counts = seen[begin, column, end, last]
            counts[0] += taken
            counts[1] += not_taken
        name = file["filename"].removeprefix(f"{ROOT}/")
        for (begin, column, _, _), (taken, not_taken) in sorted(seen.items()):
            if taken and not_taken:
                continue
            what = "never reached" if not taken and not not_taken else (
                "never true" if not taken else "never false")  # fmt: skip
            found.append(f"{name}:{begin}:{column}: {what}: {lines[begin - 1].strip()}")
    return found


def write(counts: dict[str, Counts], tests: str, commit: str) -> None:
    import soak

    rows = {}
    if TABLE.exists():
        with TABLE.open(newline="") as file:
            rows = {row["part"]: row for row in csv.DictReader(file)}
    for part, numbers in counts.items():
        rows[part] = {"part": part, "tests": tests, "date": date.today().isoformat(),
                      "machine": soak.machine("cpu"), "commit": commit or soak.commit(),
                      **{name: str(count) for name, count in numbers.items()}}  # fmt: skip
        line = "{lines_run} of {lines} lines, {branches_run} of {branches} branches"
        print(f"{part}: {line.format(**numbers)}")
    order = sorted(rows.values(), key=lambda row: (not row["part"].startswith("python"),
                                                   len(re.split("[/,]", row["part"]))))  # fmt: skip
    with TABLE.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(order)
    soak.PAGE.write_text(soak.make_page())


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--only", choices=["python", "cpp"])
    add("--jobs", type=int, default=os.cpu_count() or 1)
    add("--rooms", nargs="+", default=[], help="of C++: folders or files of test/python; all")
    add("--folders", nargs="+", default=[], help="folders of lib to count in; all without it")
    add("--uncovered", type=Path, help="file for the branches of lib that no test takes")
    add("--kept", action="store_true", help="run nothing: read the counts of the last run")
    add("--commit", default="", help="of what was run, in place of that of this checkout")
    args = parser.parse_args()
    if args.only != "cpp":
        folder = ROOT / "build/coverage"
        counts = read_python(folder) if args.kept else measure_python(args.jobs)
        write(counts, "all Python tests", args.commit)
    if args.only != "python":
        if not args.kept:
            build_cpp(args.jobs, args.folders)
            run_cpp(args.jobs, args.rooms)
        data = export_cpp(args.folders)
        tests = f"those of {', '.join(args.rooms)}" if args.rooms else "all Python tests"
        write(read_cpp(data, args.folders), f"lit, unit tests, {tests}", args.commit)
        if args.uncovered:
            args.uncovered.write_text("\n".join(uncovered(data)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
