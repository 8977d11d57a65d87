"""R14: reports of compute-sanitizer over tests of kernels on a GPU.

Runs the stage `sanitize` of scripts/test_gpu.py, from the portable bundle, under memcheck,
racecheck, initcheck and synccheck, and counts the reports. The machine needs a GPU, the CUDA
toolkit, a C++ compiler, and a Python with NumPy, pytest and pybind11; it needs no LLVM.

    python3 test/reliability/r14_compute_sanitizer.py --seconds 280 | tee r14.log
    python test/reliability/soak.py --lines r14.log --arch cuda --commit COMMIT \\
        --machine "NVIDIA H100 80GB HBM3"       # where the table is kept

The tests that the time allows are the cases: a process whose time is up ends after the test that
runs. One that had to be stopped still counts with the reports that it wrote until then.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from typing import NamedTuple

from bars import ROOT, Bar

TOOLS = ("memcheck", "racecheck", "initcheck", "synccheck")
# A test counts once under each tool.
FULL = 50 * len(TOOLS)
DEFAULT_SECONDS = 280


class ToolResult(NamedTuple):
    """The counts of one tool."""

    tool: str
    reports: int
    summaries: int
    passed: int
    failed: int


def read_tool(line: str) -> ToolResult | None:
    """The counts in a line of the stage `sanitize`."""
    found = re.match(
        rf"- ({'|'.join(TOOLS)}): (\d+) errors in (\d+) of \d+ processes that have a summary; "
        r"of \d+ tests (\d+) passed, (\d+) failed",
        line,
    )
    if not found:
        return None
    before = re.search(r"(\d+) errors before that$", line)
    reports = int(found[2]) + (int(before[1]) if before else 0)
    return ToolResult(found[1], reports, int(found[3]), int(found[4]), int(found[5]))


def judge(found: list[ToolResult]) -> tuple[str, str, bool]:
    """The cases, the numbers that were seen, and whether the bar is met.

    A tool that ran no test to its end shows nothing, so that the bar is missed.
    """
    passed = sum(one.passed for one in found)
    reports = sum(one.reports for one in found)
    failed = sum(one.failed for one in found)
    silent = [tool for tool in TOOLS if not any(
        one.tool == tool and one.passed and one.summaries for one in found)]  # fmt: skip
    parts = ", ".join(f"{one.tool} {one.passed}" for one in found)
    seen = f"{reports} reports, {failed} tests failed"
    if silent:
        seen += f", no result of {', '.join(silent)}"
    return f"{passed} tests passed ({parts or 'none'})", seen, not (reports or failed or silent)


def main() -> None:
    bar = Bar(
        "R14", "compute-sanitizer", full=FULL, short=0, archs=("cuda",), apart=True,
        target="50 tests under each of memcheck, racecheck, initcheck and synccheck: no report",
        miss="a report of the tool, or a test that fails under it",
    )  # fmt: skip
    add = bar.parser.add_argument
    add("--jobs", type=int, default=os.cpu_count() or 4, help="processes, all tools together")
    add("--bundle", help="the archive; the newest of dist/ without it")
    add("--tests", help="which tests, as pytest takes -k; scripts/test_gpu.py has a choice")
    args = bar.parse()
    seconds = args.seconds if math.isfinite(args.seconds) else DEFAULT_SECONDS
    command = [sys.executable, ROOT / "scripts/test_gpu.py", "--sanitize", "--jobs", str(args.jobs),
               "--minutes", f"{seconds / 60:.2f}"]  # fmt: skip
    command += ["--bundle", args.bundle] if args.bundle else []
    command += ["-k", args.tests] if args.tests else []
    found = []
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    for line in process.stdout:
        print(line, end="", file=sys.stderr, flush=True)
        if one := read_tool(line):
            found.append(one)
    process.wait()
    cases, seen, met = judge(found)
    bar.report(cases, seen, met=met)


if __name__ == "__main__":
    main()
