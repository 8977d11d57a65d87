"""Compares errors and times of two builds, in turns: `make bench-error-gate ARGS=/path/to/base`.

    .venv/bin/python benchmarks/error/compare.py BASE [--scenes wave,exp] [--modes "f32;f64"]

BASE is a checkout of another commit with its own build. Both sides run this checkout's scenes, each
measurement in a process of its own and in turns; times are the processor's, of one thread. Fails
(exit status 1) where an error has grown by more than half a digit, or where the median of the times
is more than 5 % greater and the quartiles of the two sides do not overlap. Errors below 1e-15 count
as that. A row that one side cannot measure fails, too. It stops after --seconds and judges the
rounds that it has; a row without two rounds is not judged, and says so.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import modes

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# Half a digit of error, 5 % of time, and errors that are as good as none.
MOST_DIGITS, MOST_TIME, FLOOR = 0.5, 1.05, 1e-15
SCENES = "sum_ill,scatter,stencil,exp,wave,smoke,diffmpm,billiards"
LEAST_ROUNDS = 2


def quartiles(times: list[float]) -> tuple[float, float, float]:
    """The first quartile, the median and the third one."""
    if len(times) < 2:
        return times[0], times[0], times[0]
    low, middle, high = statistics.quantiles(times, n=4, method="inclusive")
    return low, middle, high


def error_of(row: dict) -> float:
    """The greater of the errors of loss and gradient; infinite if one is not finite."""
    found = row["loss_rel"], row["grad_rel"]
    return max(found) if all(map(math.isfinite, found)) else math.inf


def judge(base: list[dict], new: list[dict]) -> tuple[str, str]:
    """The outcome of two lists of rows, "ok", "FAILS" or "not judged", and the figures."""
    for side, found in (("base", base), ("new", new)):
        for row in found:
            if row["status"] != "ok":
                return "FAILS", f"{side}: {row['reason']}"
    if min(len(base), len(new)) < LEAST_ROUNDS:
        return "not judged", f"{min(len(base), len(new))} rounds"
    errors = [max(FLOOR, *map(error_of, found)) for found in (base, new)]
    digits = math.inf if math.isinf(errors[1]) else math.log10(errors[1] / errors[0])
    times = [quartiles([row["ms"] for row in found]) for found in (base, new)]
    ratio = times[1][1] / times[0][1]
    text = f"error {errors[0]:.1e} to {errors[1]:.1e}, time {ratio:.3f} of {times[0][1]:.3g} ms"
    is_slower = ratio > MOST_TIME and times[1][0] > times[0][2]
    return ("FAILS" if digits > MOST_DIGITS or is_slower else "ok"), text


def measure(tree: Path, command: list[str], timeout: float) -> dict:
    """A row of measure.py with the package of a checkout."""
    environment = dict(os.environ, PYTHONPATH=str(tree / "python"))
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=timeout,
            check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"status": "failed", "reason": f"longer than {timeout:.0f} s"}
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if not lines:
        return {"status": "failed", "reason": f"exit status {done.returncode}"}
    return json.loads(lines[-1])


def main(arguments: list[str] | None = None) -> int:
    import cases

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("base", type=Path, help="a checkout of another commit, with its build")
    parser.add_argument("--scenes", default=SCENES, help="comma-separated")
    parser.add_argument("--modes", default="f32;f64;f32 compensated", help="semicolons between")
    parser.add_argument("--size", choices=cases.SIZES, default="quick")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=600, help="for all rounds (600)")
    parser.add_argument("--timeout", type=float, default=120, help="seconds of a measurement")
    given = parser.parse_args(arguments)
    if not (given.base / "python" / "tai").is_dir():
        parser.error(f"{given.base} is no checkout of tai: it has no python/tai")
    known = {mode.name for mode in modes.TAI}
    places = [(s, m) for s in given.scenes.split(",") for m in given.modes.split(";")]
    for scene, mode in places:
        if scene not in cases.NAMES:
            parser.error(f"unknown scene '{scene}', known are {', '.join(cases.NAMES)}")
        if mode not in known:
            parser.error(f"unknown mode '{mode}', known are {'; '.join(sorted(known))}")
    found: dict[tuple, tuple[list, list]] = {place: ([], []) for place in places}
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as work:
        references: dict[str, Path] = {}

        def command_of(scene: str, mode: str, side: str) -> list[str]:
            cache = Path(work) / side / mode.replace(" ", "_")
            cache.mkdir(parents=True, exist_ok=True)
            command = [sys.executable, str(HERE / "measure.py"), "--system", modes.OURS]
            command += ["--scene", scene, "--mode", mode, "--size", given.size, "--threads", "1"]
            return [*command, "--cache", str(cache)]

        for number in range(given.rounds):
            for scene, mode in places:
                if time.monotonic() - begin > given.seconds:
                    break
                if scene not in references:
                    # That of the base: an error of the new f64 shows, too.
                    references[scene] = Path(work) / f"{scene}.npz"
                    command = command_of(scene, modes.REFERENCE, "base")
                    kept = [*command, "--keep", str(references[scene])]
                    measure(given.base, kept, given.timeout)
                sides = [("base", given.base), ("new", ROOT)]
                for side, tree in sides if number % 2 == 0 else sides[::-1]:
                    command = command_of(scene, mode, side)
                    command += ["--reference", str(references[scene]), "--runs", "5"]
                    command += ["--budget", "0.5", "--distinct", "1"]
                    rows = found[scene, mode][side == "new"]
                    rows.append(measure(tree, command, given.timeout))
    outcomes = []
    for (scene, mode), (base, new) in found.items():
        outcome, text = judge(base, new)
        outcomes.append(outcome)
        print(f"{outcome:10} {scene}, {mode}: {text}", flush=True)
    return int("FAILS" in outcomes or "ok" not in outcomes)


if __name__ == "__main__":
    sys.exit(main())
