"""R13: reports of sanitizers over the tests of the presets asan and tsan.

Builds each preset and runs its tests, as `make test PRESET=asan` does, and counts the results and
reports at the end. Takes long: most of it is the build, which is kept. With `--rooms`, whole
folders of test/python run in the place of the files that scripts/sanitizers.py names.

    python test/reliability/r13_sanitizers.py [--presets asan] [--jobs 2] [--rooms tapes interop]

It is no part of a soak of all: `make soak ARGS="--only R13"` writes its row.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter

from bars import ROOT, Bar

PRESETS = ("asan", "tsan")
KINDS = ("lit", "gtest", "pytest")
# The targets that the tests of a preset need, if not all.
TARGETS = {"tsan": ["_core", "tai-unit-tests"]}


def build(preset: str, jobs: int) -> bool:
    folder = ROOT / f"build-{preset}"
    commands = [["ninja", "-C", folder, f"-j{jobs}", *TARGETS.get(preset, [])]]
    if not (folder / "build.ninja").exists():
        commands.insert(0, ["cmake", "--preset", preset])
    return all(
        subprocess.run(command, cwd=ROOT, stdout=sys.stderr).returncode == 0 for command in commands
    )


def count_line(line: str) -> tuple[str, int, int] | None:
    """The kind of tests, how many passed and how many failed, of a line of run_tests.py."""
    found = re.match(rf"({'|'.join(KINDS)}|reports): (\d+) passed, (\d+) failed", line)
    return (found[1], int(found[2]), int(found[3])) if found else None


def run(preset: str, jobs: int, rooms: list[str]) -> dict[str, tuple[int, int]]:
    """For each kind of tests, how many passed and failed; the reports are those that failed."""
    if not build(preset, jobs):
        return {}
    command = [sys.executable, ROOT / "scripts/run_tests.py", "--build", ROOT / f"build-{preset}",
               "--jobs", str(jobs), "--sanitizer", preset]  # fmt: skip
    if rooms:
        command += ["--rooms", *rooms]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    counted = {}
    for line in process.stdout:
        print(line, end="", file=sys.stderr, flush=True)
        if found := count_line(line):
            counted[found[0]] = found[1:]
    process.wait()
    return counted


def main() -> None:
    bar = Bar(
        "R13", "sanitizers", full=len(PRESETS), short=0, apart=True,
        target="the tests under ASan and UBSan, JIT code under ASan, threads under TSan: no report",
        miss="a report that no suppression names, or a test that fails there alone",
    )  # fmt: skip
    add = bar.parser.add_argument
    add("--presets", nargs="+", choices=PRESETS, default=PRESETS)
    add("--jobs", type=int, default=os.cpu_count() or 1)
    add("--rooms", nargs="+", default=[], help="folders of test/python that run instead")
    args = bar.parse()
    whole = 0
    words, totals = [], Counter()
    for preset in args.presets:
        counted = run(preset, args.jobs, args.rooms)
        # A run that did not end shows nothing about reports.
        whole += "reports" in counted and not args.rooms
        totals["missing"] += "reports" not in counted
        totals["reports"] += counted.pop("reports", (0, 0))[1]
        totals["failed"] += sum(failed for _, failed in counted.values())
        kinds = ", ".join(f"{passed} of {kind}" for kind, (passed, _) in counted.items())
        words.append(f"{preset}: {kinds or 'did not run'}")
    where = f" in {', '.join(args.rooms)}" if args.rooms else ""
    bar.report(
        f"{whole} presets in full ({' and '.join(words)}{where})",
        f"{totals['reports']} reports, {totals['failed']} tests failed",
        met=not totals["reports"] and not totals["failed"] and not totals["missing"],
    )


if __name__ == "__main__":
    main()
