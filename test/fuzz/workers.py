"""Judges seeds in several processes, and keeps a log by which a run can be resumed."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

SECONDS = 180  # of computing, for one seed: two million elements on a GPU take 70

# Takes a seed and a folder to write to; returns a row of the log: seed, kind, reason, detail.
Judge = Callable[[int, Path], dict]


def work(judge: Judge, seeds: list[int], answers) -> None:
    """A worker: says which seed it begins, then what became of it."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            answers.send(("begin", seed))
            # The default actions end the process; the second is for one that waits.
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            signal.alarm(10 * SECONDS)
            found = judge(seed, Path(folder))
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.alarm(0)
            answers.send(("end", found))
    # So that only the death of a process ends the pipe early.
    answers.send(("done", None))


class Worker:
    """A process with a share of the seeds; a new one takes over where it dies."""

    def __init__(self, judge: Judge, seeds: list[int]):
        self.judge = judge
        self.seeds = seeds
        self.current: int | None = None
        self.start()

    def start(self) -> None:
        self.over = False
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe(duplex=False)
        # Not too many in one process: memory of old programs would add up.
        self.share = self.seeds[:200]
        self.process = context.Process(target=work, args=(self.judge, self.share, other))
        self.process.start()
        other.close()

    def poll(self) -> list[dict]:
        """Returns results that have come in; may replace the process."""
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
                late = code in (-signal.SIGALRM, -signal.SIGPROF)
                what = "timeout" if late else f"the process died ({code})"
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


def judge_all(
    judge: Judge, seeds: list[int], jobs: int, log: Path | None,
    configure: Callable[[int], str] | None = None, seconds: float = math.inf,
) -> list[dict]:  # fmt: skip
    """The rows of the seeds; those that stand in the log are not judged again.

    `configure` says in which configuration a seed runs. After so many seconds it stops.
    """
    deadline = time.monotonic() + seconds
    rows: list[dict] = []
    if log and log.exists():
        rows = [json.loads(line) for line in log.read_text().splitlines()]
        rows = [row for row in rows if row["seed"] in set(seeds)]
    done = {row["seed"] for row in rows}
    seeds = [seed for seed in seeds if seed not in done]
    jobs = max(1, min(jobs, len(seeds)))
    workers = [Worker(judge, seeds[n::jobs]) for n in range(jobs)] if seeds else []
    file = log.open("a") if log else None
    while not all(worker.finished for worker in workers):
        for worker in workers:
            for row in worker.poll():
                if configure:
                    row["configuration"] = configure(row["seed"])
                rows.append(row)
                if file:
                    file.write(json.dumps(row) + "\n")
                    file.flush()
                if row["kind"] == "FAIL":
                    print(f"seed {row['seed']}: {row['reason']}{_command(row)}", flush=True)
        if time.monotonic() > deadline:
            for worker in workers:
                worker.process.kill()
            break
        time.sleep(0.02)
    return rows


def _command(row: dict) -> str:
    """The command that runs this seed again."""
    if "configuration" not in row:
        return ""
    script = Path(sys.argv[0]).name
    return f"\n  {script} --seed {row['seed']} --configuration {row['configuration']}"


def summary(rows: list[dict]) -> str:
    """Counts for each outcome, and for each reason."""
    kinds = Counter(row["kind"] for row in rows)
    lines = [f"{len(rows)} programs: " + ", ".join(f"{n} {k}" for k, n in kinds.most_common())]
    reasons = Counter((row["kind"], row["reason"]) for row in rows if row["reason"])
    for (kind, reason), count in reasons.most_common():
        examples = [row["seed"] for row in rows if (row["kind"], row["reason"]) == (kind, reason)]
        lines.append(f"  {count:5d} {kind}: {reason} (seeds {', '.join(map(str, examples[:4]))})")
    return "\n".join(lines)
