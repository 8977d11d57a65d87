"""R4: the gradients of random Python kernels agree with forward mode and with differences.

The programs are those of test/fuzz: each seed draws a program and where it runs (target, threads,
level of optimisation, number of elements). A program that cannot be differentiated must be refused
at its line. A process that dies or hangs is a failure of the seed it was at; test/fuzz/run.py
--seed shows one.
"""

from __future__ import annotations

import functools
import math
import os
import sys
from collections import Counter

from bars import ROOT, Bar

sys.path.insert(0, str(ROOT / "test/fuzz"))

import configurations  # noqa: E402
import workers  # noqa: E402

import run  # noqa: E402

LEAST_AGREEING = 0.4  # of the programs, or hardly anything was compared


def main() -> None:
    bar = Bar(
        "R4", "random Python kernels", full=5000, short=16, adds=True,
        target="5,000 programs: no gradient that forward mode or differences contradict",
        miss="a gradient that disagrees, an error that names no line, a crash or a hang",
    )  # fmt: skip
    add = bar.parser.add_argument
    add("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    add("--targets", nargs="+", default=configurations.default_targets())
    args = bar.parse()
    where = functools.partial(run.configure, targets=tuple(args.targets), fixed=None)
    judge = functools.partial(run.judge_seed, configure=where)
    seeds = list(range(args.seed, args.seed + args.count))
    seconds = bar.left() if math.isfinite(bar.left()) else 1e9
    rows = workers.judge_all(judge, seeds, args.jobs, None, where, seconds)
    kinds = Counter(row["kind"] for row in rows)
    agreeing = kinds["agree"] + kinds["kink"]
    others = ", ".join(f"{n} {kind}" for kind, n in kinds.most_common() if kind != "FAIL")
    bar.report(
        f"{len(rows)} programs ({others})", f"{kinds['FAIL']} disagreements and crashes",
        met=not kinds["FAIL"] and agreeing >= LEAST_AGREEING * len(rows) > 0,
    )  # fmt: skip


if __name__ == "__main__":
    main()
