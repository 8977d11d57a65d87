"""Differentiates random kernels, in several processes, and counts what becomes of them.

    python test/fuzz/run.py --count 5000 --jobs 2 --log build/fuzz.jsonl
    python test/fuzz/run.py --seed 17            # one seed, in this process, with its program

A seed that stands in the log is not run again, so a run can be stopped and resumed. A process
that dies is a failure of the seed it was at.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

SECONDS = 60  # for one seed


def judge_seed(seed: int, folder: Path) -> dict:
    import outcome
    import random_kernels as programs

    kinked = programs.is_kinked(seed)
    found = outcome.judge(programs.program(seed), seed, kinked, folder)
    return {"seed": seed, "kind": found.kind, "reason": found.reason, "detail": found.detail}


def work(seeds: list[int], answers) -> None:
    """A worker: says which seed it begins, then what became of it."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            answers.send(("begin", seed))
            signal.alarm(SECONDS)  # the default action ends the process
            found = judge_seed(seed, Path(folder))
            signal.alarm(0)
            answers.send(("end", found))
    # So that only the death of a process ends the pipe early.
    answers.send(("done", None))


class Worker:
    """A process with a share of the seeds; a new one takes over where it dies."""

    def __init__(self, seeds: list[int]):
        self.seeds = seeds
        self.current: int | None = None
        self.start()

    def start(self) -> None:
        self.over = False
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe(duplex=False)
        # Not too many in one process: memory of old programs would add up.
        self.share = self.seeds[:200]
        self.process = context.Process(target=work, args=(self.share, other))
        self.process.start()
        other.close()

    def poll(self) -> list[dict]:
        """What came in; may replace the process."""
        found = []
        if self.finished:
            return found
        try:
            while self.pipe.poll(0):
                kind, payload = self.pipe.recv()
                if kind == "begin":
                    self.current = payload
                elif kind == "end":
                    found.append(payload)
                    self.seeds.remove(payload["seed"])
                    self.current = None
                else:
                    self.process.join()
                    self.over = True
                    if self.seeds:
                        self.start()
                    return found
        except EOFError:
            self.process.join()
            code = self.process.exitcode
            if self.current is not None:
                what = "timeout" if code == -signal.SIGALRM else f"the process died ({code})"
                found.append({"seed": self.current, "kind": "FAIL", "reason": what, "detail": ""})
                self.seeds.remove(self.current)
                self.current = None
            self.over = True
            if self.seeds:
                self.start()
        return found

    @property
    def finished(self) -> bool:
        return self.over and not self.seeds


def summary(rows: list[dict]) -> str:
    """Counts for each outcome, and for each reason."""
    kinds = Counter(row["kind"] for row in rows)
    lines = [f"{len(rows)} programs: " + ", ".join(f"{n} {k}" for k, n in kinds.most_common())]
    reasons = Counter((row["kind"], row["reason"]) for row in rows if row["reason"])
    for (kind, reason), count in reasons.most_common():
        examples = [row["seed"] for row in rows if (row["kind"], row["reason"]) == (kind, reason)]
        lines.append(f"  {count:5d} {kind}: {reason} (seeds {', '.join(map(str, examples[:4]))})")
    return "\n".join(lines)


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
    rows: list[dict] = []
    if args.log and args.log.exists():
        rows = [json.loads(line) for line in args.log.read_text().splitlines()]
        rows = [r for r in rows if args.first <= r["seed"] < args.first + args.count]
    done = {row["seed"] for row in rows}
    seeds = [s for s in range(args.first, args.first + args.count) if s not in done]
    if args.kinked:
        import random_kernels as programs

        seeds = [s for s in seeds if programs.is_kinked(s)]
    jobs = max(1, min(args.jobs, len(seeds)))
    workers = [Worker(seeds[n::jobs]) for n in range(jobs)] if seeds else []
    log = args.log.open("a") if args.log else None
    while not all(worker.finished for worker in workers):
        for worker in workers:
            for row in worker.poll():
                rows.append(row)
                if log:
                    log.write(json.dumps(row) + "\n")
                    log.flush()
                if row["kind"] == "FAIL":
                    print(f"seed {row['seed']}: {row['reason']}", flush=True)
        time.sleep(0.02)
    print(summary(rows))
    return 1 if any(row["kind"] == "FAIL" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
