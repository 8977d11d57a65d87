"""R17: a training that goes on for long neither grows nor drifts.

The robot of examples/diffmpm.py learns to crawl, twice, in deterministic mode: the two curves of
the loss must be equal bit for bit, and memory must stay as it is after the first tenth.

    python test/reliability/r17_soak.py [--short] [--count ITERATIONS]
"""

import argparse
import gc
import runpy
import sys
from pathlib import Path

import tai as ti

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--short", action="store_true", help="30 iterations of 80 steps")
parser.add_argument("--count", type=int, default=None, help="iterations of each run (400)")
args = parser.parse_args()

MOST_GROWTH = 1.0  # % of the resident memory
COUNT = args.count or (30 if args.short else 400)
STEPS = 80 if args.short else 256
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "diffmpm.py"


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def train():
    """The curve of the loss, and how much memory has grown since the first tenth, in %."""
    begin, ti.init = ti.init, lambda **options: begin(**{**options, "deterministic": True})
    before, sys.argv = sys.argv, [str(EXAMPLE), "--steps", str(STEPS)]
    try:
        robot = runpy.run_path(str(EXAMPLE))
    finally:
        sys.argv, ti.init = before, begin
    robot["set_up"]()
    losses, start = [], 0
    for iteration in range(COUNT):
        with ti.ad.Tape(robot["loss"]):
            robot["forward"]()
        robot["descend"](0.1)
        losses.append(robot["loss"][None])
        if iteration == max(12, COUNT // 10):
            gc.collect()
            start = resident()
    gc.collect()
    return losses, 100.0 * (resident() - start) / start


def main():
    first, growth = train()
    second, again = train()
    differing = sum(a != b for a, b in zip(first, second, strict=True))
    if first[0] == first[-1]:
        print("  the robot learns nothing")
    growth = max(growth, again)
    print(f"R17 soak: 2 runs of {COUNT} iterations, {differing} losses differ (bar 0), "
          f"RSS {growth:+.1f} % (bar {MOST_GROWTH:.0f} %)")  # fmt: skip
    return int(differing > 0 or growth > MOST_GROWTH or first[0] == first[-1])


if __name__ == "__main__":
    sys.exit(main())
