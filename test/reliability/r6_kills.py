"""R6: processes are killed while they compile, and leave nothing that harms those that follow.

A process compiles some kernels into a cache and is killed after a random time of the processor,
which is the same share of its work however busy the machine is; in half of the cases another
process wants the same kernels at the same time. A later process must get the right numbers, wait
for no lock of the dead one, find the entries that were whole, and complain of none.
"""

from __future__ import annotations

import random
import tempfile
import time
from collections import Counter
from pathlib import Path

import cold_kernels
from bars import Bar

KERNELS = 4
SECONDS = 50  # a claim that nobody gives back ends after 60


def judge(first: int, cache: Path, delay: float, with_another: bool, counts: Counter) -> list[str]:
    """The faults after one kill."""
    killed = cold_kernels.Process(first, KERNELS, cache)
    another = cold_kernels.Process(first, KERNELS, cache) if with_another else None
    while killed.seconds() < delay and not killed.has_ended():
        time.sleep(0.0005)
    killed.kill()
    problems = []
    if another and (problem := another.wait(SECONDS).problem):
        problems.append(f"the other process {problem}")
    begun = killed.wait()
    counts["in the midst"] += 0 < begun.compiled.total() < KERNELS * cold_kernels.ENTRIES
    kept = {path.name for path in cold_kernels.entries(cache)}
    ended = cold_kernels.Process(first, KERNELS, cache).wait(SECONDS)
    if ended.problem:
        problems.append(f"the next process {ended.problem}")
    if ended.warnings:
        problems.append(f"the next process says {ended.warnings[0]}")
    wanted = KERNELS * cold_kernels.ENTRIES
    made = {path.name for path in cold_kernels.entries(cache)} - kept
    if ended.hits + ended.compiled.total() != wanted or len(made) != ended.compiled.total():
        problems.append(f"{len(made)} entries were missing, {ended.compiled.total()} compiled")
    if with_another and ended.compiled:
        problems.append("the next process compiled what the other one had")
    return problems


def measure(first: int, cache: Path) -> tuple[float, float]:
    """Seconds of the processor until there is an entry, and until all are there."""
    process = cold_kernels.Process(first, KERNELS, cache)
    known = len(cold_kernels.entries(cache))
    begin = end = 0.0
    while not process.has_ended():
        end = process.seconds()
        if not begin and len(cold_kernels.entries(cache)) > known:
            begin = end
        time.sleep(0.0005)
    if problem := process.wait(SECONDS).problem:
        raise RuntimeError(problem)
    return begin, end


def main() -> None:
    bar = Bar(
        "R6", "kills while the cache is cold", full=1000, short=6, adds=True,
        target="1,000 kills: the next run right, no stale lock, entries kept",
        miss="a run after a kill that fails, waits, warns, or compiles what an entry holds",
    )  # fmt: skip
    args = bar.parse()
    choose = random.Random(args.seed)
    counts: Counter[str] = Counter()
    wrong = done = 0
    with tempfile.TemporaryDirectory() as folder:
        usual = [measure(KERNELS * n, Path(folder) / "first") for n in range(3)]
        begin = min(begin for begin, _ in usual)
        end = max(end for _, end in usual)
        while done < args.count and bar.left() > 0:
            # The remains of many kills are in one folder.
            cache = Path(folder) / f"cache-{done // 50}"
            # A tenth before anything is compiled, and some when all is.
            delay = choose.uniform(0.7 * begin if choose.random() < 0.9 else 0, 1.05 * end)
            problems = judge(1000 + done * KERNELS, cache, delay, choose.random() < 0.5, counts)
            for problem in problems:
                print(f"kill {done} after {delay:.3f} s: {problem}", flush=True)
            wrong += bool(problems)
            done += 1
        left = sum(len(list(Path(folder).glob(f"*/{name}"))) for name in (".lock-*", ".tmp-*"))
    bar.report(
        f"{done} kills, {counts['in the midst']} while some kernels were compiled",
        f"{wrong} with errors, {left} locks and temporary files left for pruning",
        met=not wrong and done > 0,
    )  # fmt: skip


if __name__ == "__main__":
    main()
