"""R7: many processes begin at once on one cold cache, and share the work.

All want the same kernels, in orders of their own. Each must get the right numbers, and no kernel
may be compiled more than twice. The wall time is that of the kernels after everything was imported.
It may be 1.5 times that of one process, or that of as many on a warm cache where this is longer:
what all must do in any case, loading the code, is divided among the cores. The same holds of the
time that processors work for all, which other programs change little: it may be 1.5 times that of
one process and of as many on a warm cache together. Where other programs take a tenth of the
machine, that alone is judged; in the short form no time is.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from pathlib import Path

import cold_kernels
from bars import BUSY, Bar, own_seconds

MOST_COMPILED = 2
MOST_TIME = 1.5


def run_together(processes: int, first: int, count: int, cache: Path | None):
    """How they ended, the seconds that took, and those that processors worked for them."""
    begun, worked = time.monotonic(), own_seconds()
    running = [cold_kernels.Process(first, count, cache) for _ in range(processes)]
    ended = [process.wait(600) for process in running]
    return ended, time.monotonic() - begun, own_seconds() - worked


def main() -> None:
    bar = Bar(
        "R7", "processes on one cold cache", full=64, short=8,
        target="64 processes, 50 kernels: no error, each compiled at most twice, in 1.5 times the "
        "time of one, or of all on a warm cache",
        miss="a process that fails or warns, a kernel that is compiled more than twice, or a "
        "longer time",
    )  # fmt: skip
    bar.parser.add_argument(
        "--kernels", type=int, help="how many each runs; 50, or 10 with --short"
    )
    args = bar.parse()
    kernels = args.kernels or (10 if args.short else 50)
    with tempfile.TemporaryDirectory() as folder:
        _, alone, once = run_together(1, 0, kernels, Path(folder) / "alone")
        _, loading, warm = run_together(args.count, 0, kernels, Path(folder) / "alone")
        ended, together, cold = run_together(args.count, 0, kernels, Path(folder) / "shared")
    problems = [one.problem or one.warnings[0] for one in ended if one.problem or one.warnings]
    compiled: Counter[str] = sum((one.compiled for one in ended), Counter())
    for problem in problems[:5]:
        print(problem)
    most = max(compiled.values())
    ratio = together / max(alone, loading)
    work = cold / (once + warm)
    others = bar.others()
    busy = others > BUSY
    in_time = args.short or (work <= MOST_TIME and (busy or ratio <= MOST_TIME))
    bar.report(
        f"{args.count} processes of {kernels} kernels",
        f"{len(problems)} errors, each function compiled at most {most} times; "
        f"{together:.1f} s, one process {alone:.1f} s, all on a warm cache {loading:.1f} s, "
        f"{ratio:.2f} times the longer of these{' (not judged)' if busy else ''}, and "
        f"{work:.2f} times their processor time, on {os.cpu_count()} cores of which others took "
        f"{100 * others:.0f} %",
        met=not problems and most <= MOST_COMPILED and in_time,
        bar=f"0, {MOST_COMPILED}" + ("" if args.short else f", {MOST_TIME}"),
    )  # fmt: skip


if __name__ == "__main__":
    main()
