"""R17: a training that goes on for long neither grows nor drifts.

The robot of examples/diffmpm.py learns to crawl, twice, in deterministic mode: the two curves of
the loss must be equal bit for bit, and memory must stay as it is after the first tenth.
"""

import gc
import math
import runpy
import sys
import time

import tai as ti
from bars import ROOT, Bar, resident

MOST_GROWTH = 1.0  # % of the resident memory
EXAMPLE = ROOT / "examples" / "diffmpm.py"

bar = Bar(
    "R17", "a long training, twice", full=400, short=14,
    target="no growth of memory beyond 1 %, and equal losses bit for bit",
    miss="a loss of the second run with other bits, memory that grows, or a robot that learns "
    "nothing",
    archs=("cpu", "emulated", "cuda"),
)  # fmt: skip
args = bar.parse()
COUNT = args.count
STEPS = 80 if args.short else 256


def first_tenth(count):
    return max(10, count // 10)


def train(count, seconds):
    """The curve of the loss, and how much memory has grown since the first tenth, in %.

    Ends after so many iterations, or after so many seconds.
    """
    begin, ti.init = ti.init, lambda **options: begin(**{**options, "deterministic": True})
    before, sys.argv = sys.argv, [str(EXAMPLE), "--steps", str(STEPS)]
    sys.path.insert(0, str(EXAMPLE.parent))
    try:
        robot = runpy.run_path(str(EXAMPLE))
    finally:
        sys.argv, ti.init = before, begin
        sys.path.remove(str(EXAMPLE.parent))
    robot["set_up"]()
    losses, start = [], 0
    end = time.monotonic() + seconds
    for iteration in range(count):
        if time.monotonic() > end and iteration > first_tenth(count):
            break
        with ti.ad.Tape(robot["loss"]):
            robot["forward"]()
        robot["descend"](0.1)
        losses.append(robot["loss"][None])
        if iteration == first_tenth(count):
            gc.collect()
            start = resident()
    gc.collect()
    return losses, 100.0 * (resident() - start) / start


def main():
    first, growth = train(COUNT, bar.left() / 2)
    second, again = train(len(first), math.inf)
    differing = sum(a != b for a, b in zip(first, second, strict=True))
    learned = first[0] != first[-1]
    growth = max(growth, again)
    most = 3 * MOST_GROWTH if args.short else MOST_GROWTH
    bar.report(
        f"{len(first)} iterations of {STEPS} steps on {args.arch}, twice",
        f"{differing} losses differ, RSS {growth:+.1f} %{'' if learned else ', nothing learned'}",
        met=differing == 0 and learned and growth <= most,
        bar=f"0, {most:.0f} %",
    )  # fmt: skip


if __name__ == "__main__":
    main()
