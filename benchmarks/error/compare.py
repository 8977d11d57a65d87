"""Compares errors and times of two builds, in turns: `make bench-error-gate ARGS=/path/to/base`.

    .venv/bin/python benchmarks/error/compare.py BASE [--scenes wave,exp] [--modes "f32;f64"]

BASE is a checkout of another commit with its own build, whose results in f64 are the reference of
scenes. Both sides run this checkout's scenes, each mode in a process of its own, and take turns;
times are the processor's, of one thread. Fails (exit status 1) where the median error over inputs
that are an ulp apart has grown by more than half a digit, or where the median of the times is more
than 5 % greater and the quartiles of the two sides do not overlap. Errors below 1e-15 count as
that. A row that one side cannot measure fails, too. It stops after --seconds; a row without two
rounds is not judged, and says so.
"""

from __future__ import annotations

import argparse
import math
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import modes
import rows
from mode_workers import Crowd, Worker, environment_of

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# Half a digit of error, and 5 % of time.
MOST_DIGITS, MOST_TIME = 0.5, 1.05
SCENES = "sum_ill,scatter,stencil,exp,wave,smoke,diffmpm,billiards"
LEAST_ROUNDS = 2


def judge(base: dict, new: dict) -> tuple[str, str]:
    """The outcome of two sides, "ok", "FAILS" or "not judged", and the figures.

    A side has `failure`, or `error` and `times`.
    """
    for side, found in (("base", base), ("new", new)):
        if found.get("failure"):
            return "FAILS", f"{side}: {found['failure']['reason']}"
    count = min(len(base["times"]), len(new["times"]))
    if count < LEAST_ROUNDS:
        return "not judged", f"{count} rounds"
    errors = [max(rows.FLOOR, side["error"]) for side in (base, new)]
    if math.isinf(errors[1]):
        digits = 0.0 if math.isinf(errors[0]) else math.inf
    else:
        digits = math.log10(errors[1] / errors[0])
    quarters = [statistics.quantiles(side["times"], n=4, method="inclusive")
                for side in (base, new)]  # fmt: skip
    ratio = quarters[1][1] / quarters[0][1]
    text = f"error {errors[0]:.1e} to {errors[1]:.1e}, time {ratio:.3f} of {quarters[0][1]:.3g} ms"
    is_slower = ratio > MOST_TIME and quarters[1][0] > quarters[0][2]
    return ("FAILS" if digits > MOST_DIGITS or is_slower else "ok"), f"{text}, {count} rounds"


class Pair:
    """A scene in a mode, on both sides."""

    def __init__(self, given: argparse.Namespace, scene: str, mode: str, work: Path, log):
        self.given, self.scene, self.mode = given, scene, mode
        self.sides: dict[str, dict] = {}
        self.workers: dict[str, Worker] = {}
        self.crowd = Crowd()
        for side, tree in (("base", given.base), ("new", ROOT)):
            cache = work / side / mode.replace(" ", "_")
            cache.mkdir(parents=True, exist_ok=True)
            arguments = ["--scene", scene, "--system", modes.OURS, "--mode", mode]
            arguments += ["--size", given.size, "--threads", "1", "--cache", str(cache)]
            python = Path(sys.executable)
            self.workers[side] = Worker(arguments, python, tree, log, self.crowd)
            self.workers[side].answer(given.timeout)

    def errors(self, reference: Path, seconds: float) -> None:
        for side, worker in self.workers.items():
            said = worker.ask("errors", self.given.timeout, reference=str(reference),
                              seconds=seconds, distinct=1)  # fmt: skip
            self.sides[side] = {"error": said and said["error"], "times": []}
            worker.ask("warm", self.given.timeout, seconds=2)

    def round(self, number: int) -> None:
        with self.crowd.stopped():
            for side in ("base", "new") if number % 2 == 0 else ("new", "base"):
                said = self.workers[side].ask_alone("time", self.given.timeout, seconds=0.1)
                if said:
                    self.sides[side]["times"].append(said["ms"])

    def end(self) -> tuple[str, str]:
        for side, worker in self.workers.items():
            worker.close()
            self.sides[side]["failure"] = worker.failure
        return judge(self.sides["base"], self.sides["new"])


def make_reference(base: Path, scene: str, size: str, out: Path) -> None:
    """That of the base: an error of the new f64 shows, too. Kernels are computed in NumPy."""
    command = [sys.executable, str(HERE / "references.py"), "--scene", scene, "--size", size]
    command += ["--how", "f64", "--out", str(out), "--cache", str(out)]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, env=environment_of(base), check=False
    )
    if done.returncode:
        raise SystemExit(f"{scene}: no reference:\n{done.stderr[-2000:]}\n{base} needs its build")


def main(arguments: list[str] | None = None) -> int:
    import cases

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("base", type=Path, help="a checkout of another commit, with its build")
    parser.add_argument("--scenes", default=SCENES, help="comma-separated")
    parser.add_argument("--modes", default="f32;f64;f32 compensated", help="semicolons between")
    parser.add_argument("--size", choices=cases.SIZES, default="quick")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=600, help="for all of it (600)")
    parser.add_argument("--timeout", type=float, default=120, help="seconds until an answer")
    given = parser.parse_args(arguments)
    given.base = given.base.resolve()
    if not (given.base / "python" / "tai").is_dir():
        parser.error(f"{given.base} is no checkout of tai: it has no python/tai")
    known = {mode.name for mode in modes.TAI}
    places = [(s, m) for s in given.scenes.split(",") for m in given.modes.split(";")]
    for scene, mode in places:
        if scene not in cases.NAMES:
            parser.error(f"unknown scene '{scene}', known are {', '.join(cases.NAMES)}")
        if mode not in known:
            parser.error(f"unknown mode '{mode}', known are {'; '.join(sorted(known))}")
    outcomes = []
    end = time.monotonic() + given.seconds
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        with (work / "log.txt").open("w") as log:
            for number, (scene, mode) in enumerate(places):
                share = (end - time.monotonic()) / (len(places) - number)
                begin = time.monotonic()
                if share <= 0:
                    outcomes.append("not judged")
                    print(f"not judged {scene}, {mode}: no time was left", flush=True)
                    continue
                reference = work / f"reference-{scene}"
                if not reference.exists():
                    make_reference(given.base, scene, given.size, reference)
                pair = Pair(given, scene, mode, work, log)
                pair.errors(reference, min(10, share / 4))
                for turn in range(given.rounds):
                    if turn >= LEAST_ROUNDS and time.monotonic() - begin > share:
                        break
                    pair.round(turn)
                outcome, text = pair.end()
                outcomes.append(outcome)
                print(f"{outcome:10} {scene}, {mode}: {text}", flush=True)
        if "FAILS" in outcomes:
            failed = (work / "log.txt").read_text().splitlines()
            print("\n".join(line for line in failed if "Error" in line), file=sys.stderr)
    return int("FAILS" in outcomes or "ok" not in outcomes)


if __name__ == "__main__":
    sys.exit(main())
