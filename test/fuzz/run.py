"""Differentiates random kernels, in several processes, and counts what becomes of them.

    python test/fuzz/run.py --count 5000 --jobs 2 --log build/fuzz.jsonl
    python test/fuzz/run.py --seed 17            # one seed, in this process, with its program
    python test/fuzz/run.py --count 99 --targets cuda

Each seed draws where it runs: target, threads, level of optimisation and number of elements; see
configurations.py. `--configuration` takes one of them for all seeds.

A seed that stands in the log is not run again, so a run can be stopped and resumed. A process
that dies is a failure of the seed it was at.
"""

from __future__ import annotations

import argparse
import functools
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import configurations
import workers


def configure(seed: int, targets: tuple[str, ...], fixed: str | None) -> str:
    """The configuration of a seed, as a word."""
    return fixed or str(configurations.draw(seed, targets))


def judge_seed(seed: int, folder: Path, configure: Callable[[int], str]) -> dict:
    import outcome
    import random_kernels as programs

    kinked = programs.is_kinked(seed)
    configuration = configurations.parse(configure(seed))
    found = outcome.judge(programs.program(seed), seed, kinked, folder, configuration)
    return {"seed": seed, "kind": found.kind, "reason": found.reason, "detail": found.detail}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=5000, help="how many seeds")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--log", type=Path, help="file of outcomes, one JSON object for each")
    parser.add_argument("--kinked", action="store_true", help="only programs at kinks")
    parser.add_argument("--seed", type=int, help="run one seed and print its program")
    parser.add_argument(
        "--targets", nargs="+", choices=["cpu", "emulated", "cuda", "python"],
        default=configurations.default_targets(), help="where seeds run",
    )  # fmt: skip
    parser.add_argument("--configuration", help="the one for all seeds, as failures report it")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after that long")
    parser.add_argument("--brief", action="store_true", help="with --seed: not the program")
    args = parser.parse_args()
    where = functools.partial(configure, targets=tuple(args.targets), fixed=args.configuration)
    judge = functools.partial(judge_seed, configure=where)
    if args.seed is not None:
        import random_kernels as programs

        if not args.brief:
            print(programs.program(args.seed))
        with tempfile.TemporaryDirectory() as folder:
            found = judge(args.seed, Path(folder))
        print(f"seed {args.seed}, {where(args.seed)}: {found['kind']}: {found['reason']}")
        print(found["detail"])
        return 1 if found["kind"] == "FAIL" else 0
    seeds = list(range(args.first, args.first + args.count))
    if args.kinked:
        import random_kernels as programs

        seeds = [s for s in seeds if programs.is_kinked(s)]
    rows = workers.judge_all(judge, seeds, args.jobs, args.log, where, 60 * args.minutes)
    print(workers.summary(rows))
    return 1 if any(row["kind"] == "FAIL" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
