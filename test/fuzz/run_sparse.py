"""Random trees and random sequences of activations, writes and loops against a model.

    python test/fuzz/run_sparse.py --count 10000 --jobs 2 --log build/fuzz-sparse.jsonl
    python test/fuzz/run_sparse.py --seed 17     # one tree, in this process, with its program

A seed is a tree, on which a number of sequences run, and where they run: target, threads and level
of optimisation; see configurations.py. One that stands in the log is not run
again, so a run can be stopped and resumed. A failing sequence is reduced before it is shown.
"""

from __future__ import annotations

import argparse
import functools
import os
import re
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import configurations
import workers

SEQUENCES = 20  # for each tree


def configure(seed: int, targets: tuple[str, ...], fixed: str | None) -> str:
    """The configuration of a seed, as a word; trees have sizes of their own."""
    return fixed or str(replace(configurations.draw(seed, targets), elements=0))


def judge_seed(seed: int, folder: Path, configure: Callable[[int], str]) -> dict:
    import sparse_sequences as sequences

    where = configurations.parse(configure(seed))
    row = {"seed": seed, "kind": "agree", "reason": "", "detail": "", "sequences": SEQUENCES}
    try:
        with where.chosen():
            sequences.run_seed(seed, SEQUENCES, folder, offline_cache=False, **where.options)
    except Exception as error:  # a crash of the compiler is one as well
        text = str(error).splitlines()[0] if str(error) else ""
        reason = re.sub(r"\d+", "N", text.partition(": ")[2] or text)[:100]
        row.update(kind="FAIL", reason=f"{type(error).__name__}: {reason}", sequences=0)
        row["detail"] = str(error)
        if not isinstance(error, sequences.Mismatch):
            row["detail"] = traceback.format_exc(limit=-3)
    return row


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10000, help="how many sequences")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--log", type=Path, help="file of outcomes, one JSON object for each tree")
    parser.add_argument("--seed", type=int, help="run one seed and print its program")
    parser.add_argument(
        "--targets", nargs="+", choices=["cpu", "emulated", "cuda"],
        default=configurations.default_targets(), help="where seeds run",
    )  # fmt: skip
    parser.add_argument("--configuration", help="the one for all seeds, as failures report it")
    args = parser.parse_args()
    where = functools.partial(configure, targets=tuple(args.targets), fixed=args.configuration)
    judge = functools.partial(judge_seed, configure=where)
    if args.seed is not None:
        with tempfile.TemporaryDirectory() as folder:
            row = judge(args.seed, Path(folder))
            print((Path(folder) / f"sparse_{args.seed}.py").read_text())
        print(f"seed {args.seed}, {where(args.seed)}: {row['kind']}\n{row['detail']}")
        return 1 if row["kind"] == "FAIL" else 0
    trees = -(-args.count // SEQUENCES)
    seeds = list(range(args.first, args.first + trees))
    rows = workers.judge_all(judge, seeds, args.jobs, args.log, where)
    print(workers.summary(rows))
    for row in rows:
        if row["kind"] == "FAIL":
            print(f"{row['detail']}")
    failed = sum(row["kind"] == "FAIL" for row in rows)
    print(f"{sum(row.get('sequences', 0) for row in rows)} sequences agree, {failed} trees fail")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
