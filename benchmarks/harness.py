"""Shared parts of the benchmark's programs: clock, statistics, command line.

A peer script makes a `Program` per scene and calls `main`. Each measurement is one JSON
line on standard output; everything a peer's own library prints goes to standard error.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path

import numpy as np

from problems import LARGE_PROBLEMS, PROBLEMS

clock = time.perf_counter

# A scene stops after this many seconds of timed runs, but not before MINIMUM_RUNS.
TIME_BUDGET = 20.0
MINIMUM_RUNS = 5
WARM_UPS = 3
# How many replays go to the device before the host waits for it, where that is timed.
BATCH = 10


def machine() -> str:
    """Model and core count of the processor."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    return f"{model}, {len(os.sched_getaffinity(0))} cores"


class Program(ABC):
    """One scene written for one peer, ready to run."""

    @abstractmethod
    def run(self) -> tuple[float, float]:
        """Forward and backward once; the seconds that each took."""

    @abstractmethod
    def loss(self) -> float:
        """Loss of the last run."""

    @abstractmethod
    def gradient(self) -> np.ndarray:
        """Flat gradient of the last run, in the order that problems.py defines."""

    def inputs(self) -> np.ndarray:
        """The flat values of the unknowns, in the order of the gradient."""
        raise NotImplementedError

    def assign(self, flat: np.ndarray) -> None:
        """Writes the values of the unknowns."""
        raise NotImplementedError

    def replay(self) -> float | None:
        """Seconds of one forward and backward as a single native call, if there is such."""
        return None

    def queue(self) -> bool:
        """Queues what `replay` does, without waiting; False if that cannot be done."""
        return False

    def sync(self) -> None:
        """Waits for the queued work."""
        return None


Maker = Callable[[object], Program]


def combined_run(forward: Callable[[], object], both: Callable[[], object]) -> tuple[float, float]:
    """Times of a peer whose gradient is one call that holds the forward pass as well."""
    start = clock()
    forward()
    middle = clock()
    both()
    end = clock()
    return middle - start, (end - middle) - (middle - start)


def statistics_of(seconds: list[float], units: float = 1.0) -> dict[str, float]:
    """Median, tenth and ninetieth percentile in milliseconds per unit, and the count."""
    values = np.array(seconds) * 1e3 / units
    p10, p90 = np.percentile(values, [10, 90])
    rounded = {"ms": statistics.median(values), "p10": p10, "p90": p90}
    return {**{name: float(f"{v:.5g}") for name, v in rounded.items()}, "n": len(seconds)}


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """Relative L2 distance; infinite when shapes differ or values are not finite."""
    if found.shape != expected.shape or not np.all(np.isfinite(found)):
        return float("inf")
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def probe(gradient: np.ndarray) -> float:
    """A weighted sum of a flat gradient that depends on the order of its elements."""
    return float(np.sum(gradient * np.sin(1.0 + 0.1 * np.arange(len(gradient)))))


class Reporter:
    """Prints measurements of one peer."""

    def __init__(self, peer: str, version: str, stream):
        self.head = {"peer": peer, "version": version}
        self.stream = stream

    def __call__(self, scene: str, phase: str, **values: object) -> None:
        record = {**self.head, "scene": scene, "phase": phase, **values}
        print(json.dumps(record), file=self.stream, flush=True)


def _accuracy(program: Program, expected: tuple[float, np.ndarray] | None) -> dict:
    """Loss and gradient of the last run, and how far they are off."""
    gradient = np.asarray(program.gradient(), dtype=np.float64)
    found = {
        "loss": program.loss(),
        "gradient_norm": float(np.linalg.norm(gradient)),
        "gradient_probe": probe(gradient),
    }
    if expected:
        found["loss_rel_err"] = abs(found["loss"] - expected[0]) / abs(expected[0])
        found["grad_rel_err"] = relative_error(gradient, expected[1])
    return found


def measure_scene(
    report: Reporter, scene: str, make: Maker, options: argparse.Namespace, cold: bool
) -> None:
    """Times of forward, backward and compilation of a scene, and its gradient's error."""
    problem = (PROBLEMS | LARGE_PROBLEMS)[scene](options.small)
    runs, budget = options.runs, options.budget
    start = clock()
    program = make(problem)
    program.run()
    first = clock() - start
    for _ in range(WARM_UPS - 1):
        program.run()
    times = []
    begin = clock()
    while len(times) < runs:
        times.append(program.run())
        if clock() - begin > budget and len(times) >= MINIMUM_RUNS:
            break
    # The large problems have no f64 adjoint: it would take minutes.
    expected = problem.reference() if scene in PROBLEMS else None
    accuracy = _accuracy(program, expected)
    forward = [t[0] for t in times]
    backward = [t[1] for t in times]
    report(scene, "forward", **statistics_of(forward, problem.units), **accuracy)
    report(scene, "backward", **statistics_of(backward, problem.units), **accuracy)
    replays = _measure_replay(program, runs, budget)
    if replays:
        accuracy = _accuracy(program, expected)
        report(scene, "replay", **statistics_of(replays, problem.units), **accuracy)
        # On a CPU there is no queue, unless somebody tries the program out.
        batches = []
        if options.arch != "cpu" or options.small:
            batches = _measure_batches(program, runs, budget)
        if batches:
            accuracy = _accuracy(program, expected)
            report(scene, "queued", **statistics_of(batches, problem.units), **accuracy)
    # Building and running once, less the time of a run when everything is compiled. In a short
    # measurement, most runs may be those in which ways to run a sequence are tried.
    usual = min(f + b for f, b in times)
    phase = "compile_cold" if cold else "compile_warm"
    report(scene, phase, **statistics_of([max(first - usual, 0.0)]))


def _measure_replay(program: Program, runs: int, budget: float) -> list[float]:
    first = program.replay()
    if first is None:
        return []
    times = []
    begin = clock()
    while len(times) < runs:
        times.append(program.replay())
        if clock() - begin > budget and len(times) >= MINIMUM_RUNS:
            break
    return times


def _measure_batches(program: Program, runs: int, budget: float) -> list[float]:
    """Seconds of a replay among many that are queued one behind the other."""
    if not program.queue():
        return []
    program.sync()
    times = []
    begin = clock()
    while len(times) * BATCH < max(runs, BATCH * MINIMUM_RUNS):
        start = clock()
        for _ in range(BATCH):
            program.queue()
        program.sync()
        times.append((clock() - start) / BATCH)
        if clock() - begin > budget and times:
            break
    return times


def measure_launch(report: Reporter, launch: Callable[[], object], sync: Callable[[], object]):
    """Cost of calling a compiled kernel that does next to nothing, per call."""
    for _ in range(200):
        launch()
    sync()
    batches = []
    for _ in range(30):
        start = clock()
        for _ in range(200):
            launch()
        sync()
        batches.append((clock() - start) / 200)
    report("launch", "launch", **statistics_of(batches))


def main(
    peer: str,
    load: Callable[[Path, str], tuple[str, dict[str, Maker], Callable]],
    arguments: list[str] | None = None,
) -> int:
    """Command line of a peer script.

    `load` imports the peer for "cpu" or "cuda", points its cache at the given folder, and
    returns the version, a maker per scene and a function that returns (launch, sync).
    """
    parser = argparse.ArgumentParser(description=f"benchmark of {peer}")
    scenes = [*PROBLEMS, *LARGE_PROBLEMS, "launch"]
    parser.add_argument("--scene", default="smoke", choices=scenes)
    parser.add_argument("--arch", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--budget", type=float, default=TIME_BUDGET, help="seconds of timed runs")
    parser.add_argument("--small", action="store_true", help="tiny scenes, to try the program")
    parser.add_argument("--cache", type=Path, default=None, help="folder of compiled code")
    options = parser.parse_args(arguments)
    size = "small" if options.small else "full"
    folder = f"cache-{size}" if options.arch == "cpu" else f"cache-{size}-{options.arch}"
    cache = options.cache or Path("build/bench") / folder / peer / options.scene
    cold = not cache.exists() or not any(cache.iterdir())
    cache.mkdir(parents=True, exist_ok=True)

    # Libraries print banners; only measurements may reach standard output.
    stream = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    start = clock()
    try:
        version, makers, launcher = load(cache.resolve(), options.arch)
    except ImportError as error:
        Reporter(peer, "", stream)(options.scene, "missing", reason=str(error))
        return 0
    except Exception as error:
        traceback.print_exc()
        reason = f"{type(error).__name__}: {error}"[:300]
        Reporter(peer, "", stream)(options.scene, "failed", reason=reason)
        return 1
    report = Reporter(peer, version, stream)
    report(options.scene, "import", **statistics_of([clock() - start]))
    try:
        if options.scene == "launch":
            measure_launch(report, *launcher())
        elif options.scene not in makers:
            report(options.scene, "missing", reason="no program for this scene")
        else:
            maker = makers[options.scene]
            measure_scene(report, options.scene, maker, options, cold)
    except Exception as error:
        traceback.print_exc()
        report(options.scene, "failed", reason=f"{type(error).__name__}: {error}"[:300])
        return 1
    return 0


if __name__ == "__main__":
    sys.exit("this module is used by the scripts in benchmarks/peers")
