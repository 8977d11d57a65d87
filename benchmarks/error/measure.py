"""Measures one scene in one mode of one system, in a process of its own; see run.py.

Answers requests, lines of JSON on standard input, by lines of JSON on standard output:

- at the start, when the program has run twice: version, clock, and seconds of a run
- `errors`: against the reference at its inputs, an ulp apart; how many results there are
- `warm`: runs until times are steady
- `time`: the median time of runs during a slice of time
- `end`: the loss after steps of descent, and the most memory
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import os
import resource
import statistics
import sys
import time
import traceback
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import modes
import references

HERE = Path(__file__).resolve().parent
# On a GPU the first iterations try how launches are best made into graphs and programs. Runs are
# timed once three in a row took about the least time so far, or after so many seconds.
STEADY = 1.3
# Inputs whose errors are measured, even where there is little time.
LEAST_INPUTS = 4


def start(system: str, mode: modes.Mode, arch: str, threads: int, cache: Path):
    """Starts a system in a mode; a name that looks like `tai` is there afterwards."""
    if system in ("tai", "taichi", "quadrants"):
        library = __import__(system)
        # Modules that import tai get this one.
        sys.modules["tai"] = library
        options = dict(mode.options)
        if "default_fp" in options:
            options["default_fp"] = getattr(library, options["default_fp"])
        options |= {
            "arch": getattr(library, arch), "offline_cache": True,
            "offline_cache_file_path": str(cache),
        }  # fmt: skip
        if threads:
            options["cpu_max_num_threads"] = threads
        if system != "tai":
            options["log_level"] = library.ERROR
        initialise = library.init
        initialise(**options)
        # Examples start by themselves: in this mode, whatever they ask for.
        library.init = lambda *_, **__: initialise(**options)
        import tai_scenes

        tai_scenes.elements_whole = arch == "cuda" and system == "tai"
        return
    real = {32: "float32", 64: "float64"}[mode.bits]
    if system == "jax":
        flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
        if threads == 1:
            os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()
        import jax

        jax.config.update("jax_platforms", arch)
        jax.config.update("jax_enable_x64", mode.bits == 64)
        from peers import peer_jax

        peer_jax.REAL = real
    elif system == "torch":
        import torch

        if arch == "cuda" and not torch.cuda.is_available():
            raise ImportError("torch sees no GPU")
        torch.set_default_device(arch)
        torch.set_default_dtype(getattr(torch, real))
        if threads:
            torch.set_num_threads(threads)
    else:
        import warp

        warp.config.quiet = True
        warp.init()
        warp.set_device("cuda:0" if arch == "cuda" else "cpu")


def version_of(system: str) -> str:
    for name in (system, {"warp": "warp-lang"}.get(system, system)):
        try:
            return importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return "in tree"


def cosine(found: np.ndarray, expected: np.ndarray) -> float:
    found, expected = found.astype(np.float64), np.asarray(expected, np.float64)
    norms = np.linalg.norm(found) * np.linalg.norm(expected)
    return float(found @ expected / norms) if norms and np.isfinite(norms) else float("nan")


def worst_ulp(found: np.ndarray, expected: np.ndarray, bits: int) -> float:
    """The greatest distance in units of the last place of the expected number."""
    digits = {32: np.finfo(np.float32), 64: np.finfo(np.float64)}[bits]
    exponent = np.frexp(np.asarray(expected, np.float64))[1] - 1
    ulp = np.ldexp(np.longdouble(1), np.maximum(exponent, digits.minexp) - digits.nmant)
    return float(np.max(np.abs(np.asarray(found, np.longdouble) - expected) / ulp))


def fields_of(program) -> tuple:
    """The field of the loss, and pairs of an unknown field and its part, of a program of tai."""
    if hasattr(program, "module"):
        return program.module.loss, [(u, lambda array: array) for u in program.unknowns]
    return program._loss, program._unknowns


def launches_of(program) -> int | None:
    tape = getattr(program, "tape", None) or getattr(program, "_tape", None)
    return getattr(tape, "num_records", None)


class Measurement:
    """A program, and the answers to requests about it."""

    def __init__(self, given: argparse.Namespace, mode: modes.Mode):
        import cases

        self.given, self.mode, self.cases = given, mode, cases
        self.program = cases.make(given.scene, given.system, given.size)
        if self.program is None:
            raise ImportError("no program for this scene")
        self.program.run()
        begin = time.monotonic()
        self.program.run()
        self.seconds = time.monotonic() - begin

    def errors(self, reference: str, seconds: float, distinct: int) -> dict:
        """Medians and ranges of errors over inputs, as many as there is time for."""
        known = references.Reference(Path(reference))
        micro = self.cases.micro
        data = None
        if self.given.scene in micro.NAMES:
            data = micro.data_of(self.given.scene, self.given.size)
        found: dict = {}
        pairs = []
        begin = time.monotonic()
        # The first input comes last: afterwards the program is as it was.
        for number in [*known.numbers[1:], 0]:
            late = time.monotonic() - begin > seconds
            if late and number and len(pairs) >= LEAST_INPUTS - 1:
                continue
            self.program.assign(references.perturbed(known.base, number))
            self.program.run()
            expected = known.load(number)
            if data is not None:
                expected["gradient"] = data.expand(expected["gradient"])
            loss = self.program.loss()
            gradient = np.asarray(self.program.gradient(), np.float64)
            pairs.append(
                (references.relative(np.atleast_1d(loss), np.atleast_1d(expected["loss"])),
                 references.relative(gradient, expected["gradient"]))
            )  # fmt: skip
        found["loss"] = loss
        found["grad_cos"] = cosine(gradient, expected["gradient"])
        found["nan_count"] = int(np.sum(~np.isfinite(gradient)) + (not np.isfinite(loss)))
        if "values" in expected and hasattr(self.program, "values"):
            values = np.asarray(self.program.values(), np.float64)
            found["max_ulp"] = worst_ulp(values, expected["values"], self.mode.bits)
            found["nan_count"] += int(np.sum(~np.isfinite(values)))
        both = [max(pair) for pair in pairs]
        found["inputs"] = len(both)
        found["error"], found["error_low"], found["error_high"] = (
            statistics.median(both), min(both), max(both)
        )  # fmt: skip
        found["loss_rel"], found["grad_rel"] = (
            statistics.median(column) for column in zip(*pairs, strict=True)
        )
        found["distinct"], found["runs"] = self.distinct(distinct, seconds / 2)
        found["launches"] = launches_of(self.program)
        return found

    def distinct(self, runs: int, budget: float) -> tuple[int, int]:
        """How many results there are in many runs, and how many runs there was time for."""
        seen, count = set(), 0
        begin = time.monotonic()
        while count < runs and (count < 3 or time.monotonic() - begin < budget):
            self.program.run()
            parts = [
                np.asarray(self.program.gradient()).tobytes(),
                np.float64(self.program.loss()).tobytes(),
            ]
            if hasattr(self.program, "values"):
                parts.append(np.asarray(self.program.values()).tobytes())
            seen.add(hashlib.sha256(b"".join(parts)).hexdigest())
            count += 1
        return len(seen), count

    def warm(self, seconds: float) -> dict:
        """Runs until three in a row took about the least time, or the time is up."""
        taken: list[float] = []
        begin = time.monotonic()
        while time.monotonic() - begin < seconds:
            taken.append(sum(self.program.run()))
            if len(taken) >= 3 and self.given.arch == "cpu":
                break
            if len(taken) > 6 and max(taken[-3:]) < STEADY * min(taken):
                break
        return {"runs": len(taken)}

    def time(self, seconds: float) -> dict:
        """The median time of runs during a slice of time: of one, if that is longer.

        The process was stopped until now, and its caches are cold: a short run is not timed.
        """
        if self.seconds < seconds:
            self.program.run()
        taken: list[float] = []
        begin = time.monotonic()
        while not taken or time.monotonic() - begin < seconds:
            taken.append(1e3 * sum(self.program.run()))
        return {"ms": statistics.median(taken), "least": min(taken), "n": len(taken)}

    def end(self, steps: int) -> dict:
        """The loss after steps of descent, where the scene has some, and the most memory."""
        found: dict = {}
        if steps and hasattr(self.program, "descend"):
            self.program.descend(steps)
            self.program.run()
            found["final_loss"], found["final_steps"] = self.program.loss(), steps
        found["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        return found


def failure_of(error: Exception) -> dict:
    """The row of a failed measurement."""
    if isinstance(error, ImportError):
        return {"status": "missing", "reason": str(error)}
    traceback.print_exc()
    lines = str(error).strip().splitlines() or [""]
    status = "missing" if modes.lacks(error) else "failed"
    reason = "this build has no such mode" if status == "missing" else lines[0]
    return {"status": status, "reason": f"{type(error).__name__}: {reason}"[:200]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("scene", "system", "mode", "size"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--arch", default="cpu")
    parser.add_argument("--threads", type=int, default=1, help="0: all")
    parser.add_argument("--cache", type=Path, default=Path("/tmp"))
    given = parser.parse_args()
    # Libraries print; only answers may reach standard output.
    stream = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def say(answer: dict) -> None:
        print(json.dumps(answer), file=stream, flush=True)

    mode = modes.find(given.system, given.mode)
    try:
        import harness

        # The time of one thread is the processor's, which other programs do not lengthen much.
        is_one = given.threads == 1 and given.arch == "cpu"
        harness.clock = time.process_time if is_one else time.perf_counter
        start(given.system, mode, given.arch, given.threads, given.cache)
        measurement = Measurement(given, mode)
        clock = "processor" if is_one else "wall"
        about = {"version": version_of(given.system), "clock": clock}
        say({"status": "ok", "seconds": measurement.seconds} | about)
        for line in sys.stdin:
            request = json.loads(line)
            say(getattr(measurement, request.pop("do"))(**request))
    except Exception as error:
        say(failure_of(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
