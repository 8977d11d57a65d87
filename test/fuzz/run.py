"""Differentiates random kernels, in several processes, and counts what becomes of them.

    python test/fuzz/run.py --count 5000 --jobs 2 --log build/fuzz.jsonl
    python test/fuzz/run.py --seed 17            # one seed, in this process, with its program

A seed that stands in the log is not run again, so a run can be stopped and resumed. A process
that dies is a failure of the seed it was at.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import workers


def judge_seed(seed: int, folder: Path) -> dict:
    import outcome
    import random_kernels as programs

    kinked = programs.is_kinked(seed)
    found = outcome.judge(programs.program(seed), seed, kinked, folder)
    return {"seed": seed, "kind": found.kind, "reason": found.reason, "detail": found.detail}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=5000, help="how many seeds")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--log", type=Path, help="file of outcomes, one JSON object for each")
    parser.add_argument("--kinked", action="store_true", help="only programs at kinks")
    parser.add_argument("--seed", type=int, help="run one seed and print its program")
    args = parser.parse_args()
    if args.seed is not None:
        import random_kernels as programs

        print(programs.program(args.seed))
        with tempfile.TemporaryDirectory() as folder:
            found = judge_seed(args.seed, Path(folder))
        print(f"seed {args.seed}: {found['kind']}: {found['reason']}\n{found['detail']}")
        return 1 if found["kind"] == "FAIL" else 0
    seeds = list(range(args.first, args.first + args.count))
    if args.kinked:
        import random_kernels as programs

        seeds = [s for s in seeds if programs.is_kinked(s)]
    rows = workers.judge_all(judge_seed, seeds, args.jobs, args.log)
    print(workers.summary(rows))
    return 1 if any(row["kind"] == "FAIL" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
