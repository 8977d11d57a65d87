"""Measures one scene in one mode of one system, in a process of its own; see run.py.

Prints a line of JSON: times, errors against the reference, distinct results, memory.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import math
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

HERE = Path(__file__).resolve().parent
WARM_UPS = 3
# On a GPU the first iterations try how launches are best made into graphs and programs. Runs are
# timed once three in a row took about the least time so far, or after so many seconds.
STEADY, MOST_SECONDS = 1.3, 20.0
DISTINCT_RUNS = 20


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


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Relative distance by L2; infinite where something is not finite."""
    found, expected = np.asarray(found, np.longdouble), np.asarray(expected, np.longdouble)
    if found.shape != expected.shape or not np.all(np.isfinite(found)):
        return float("inf")
    size = np.sqrt((expected**2).sum())
    return float(np.sqrt(((found - expected) ** 2).sum()) / (size or 1))


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


def warm_up(program, arch: str) -> None:
    taken = [sum(program.run()) for _ in range(WARM_UPS)]
    begin = time.monotonic()
    while arch == "cuda" and time.monotonic() - begin < MOST_SECONDS:
        if len(taken) > 6 and max(taken[-3:]) < STEADY * min(taken):
            break
        taken.append(sum(program.run()))


def launches_of(program) -> int | None:
    tape = getattr(program, "tape", None) or getattr(program, "_tape", None)
    return getattr(tape, "num_records", None)


def final_loss(program, steps: int) -> float | None:
    """The loss after steps of descent, where the scene has some."""
    if hasattr(program, "descend"):
        program.descend(steps)
        program.run()
        return program.loss()
    return None


def errors(program, mode: modes.Mode, expected) -> dict:
    loss, gradient = program.loss(), np.asarray(program.gradient(), np.float64)
    found = {
        "loss": loss,
        "loss_rel": relative(np.array(loss), expected["loss"]),
        "grad_rel": relative(gradient, expected["gradient"]),
        "grad_cos": cosine(gradient, expected["gradient"]),
        "nan_count": int(np.sum(~np.isfinite(gradient)) + (not np.isfinite(loss))),
    }
    if "values" in expected and hasattr(program, "values"):
        values = np.asarray(program.values(), np.float64)
        found["max_ulp"] = worst_ulp(values, expected["values"], mode.bits)
        found["nan_count"] += int(np.sum(~np.isfinite(values)))
    return found


def times(program, runs: int, budget: float) -> dict:
    taken = []
    begin = time.monotonic()
    while len(taken) < runs and (len(taken) < 5 or time.monotonic() - begin < budget):
        taken.append(1e3 * sum(program.run()))
    p10, p90 = np.percentile(taken, [10, 90])
    return {
        "ms": statistics.median(taken), "p10": float(p10), "p90": float(p90), "least": min(taken),
        "n": len(taken),
    }  # fmt: skip


def median_error(program, sets: list[np.ndarray]) -> float:
    """That of the loss, over many sets of numbers."""
    found = []
    for numbers in sets:
        program.fill(numbers)
        program.run()
        found.append(relative(np.array(program.loss()), np.array(math.fsum(numbers))))
    return statistics.median(found)


def digest(program) -> str:
    parts = [np.asarray(program.gradient()).tobytes(), np.float64(program.loss()).tobytes()]
    if hasattr(program, "values"):
        parts.append(np.asarray(program.values()).tobytes())
    return hashlib.sha256(b"".join(parts)).hexdigest()


def distinct(program, runs: int, budget: float) -> tuple[int, int]:
    """How many results there are in many runs, and how many runs there was time for."""
    seen, count = set(), 0
    begin = time.monotonic()
    while count < runs and (count < 5 or time.monotonic() - begin < budget):
        program.run()
        seen.add(digest(program))
        count += 1
    return len(seen), count


def measure(given: argparse.Namespace) -> dict:
    mode = modes.find(given.system, given.mode)
    import harness

    # The time of one thread is the processor's, which other programs do not lengthen much.
    is_one = given.threads == 1 and given.arch == "cpu"
    harness.clock = time.process_time if is_one else time.perf_counter
    found = {"version": version_of(given.system), "clock": "processor" if is_one else "wall"}
    start(given.system, mode, given.arch, given.threads, given.cache)
    import cases

    program = cases.make(given.scene, given.system, given.size)
    if program is None:
        return found | {"status": "missing", "reason": "no program for this scene"}
    warm_up(program, given.arch)
    if given.keep:
        np.savez(given.keep, loss=program.loss(), gradient=program.gradient())
        return found | {"status": "ok"}
    expected = cases.exact(given.scene, given.size)
    if expected is None:
        with np.load(given.reference) as file:
            expected = dict(file)
    found |= errors(program, mode, expected)
    found |= times(program, given.runs, given.budget)
    found["distinct"], found["runs"] = distinct(program, given.distinct, given.budget)
    found["launches"] = launches_of(program)
    sets = cases.sets(given.scene, given.size)
    if sets:
        found["loss_rel"] = median_error(program, sets)
    if given.steps:
        found["final_loss"], found["final_steps"] = final_loss(program, given.steps), given.steps
    found["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return found | {"status": "ok"}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("scene", "system", "mode", "size"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--arch", default="cpu")
    parser.add_argument("--threads", type=int, default=1, help="0: all")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--distinct", type=int, default=DISTINCT_RUNS)
    parser.add_argument("--budget", type=float, default=10.0, help="seconds of timed runs")
    parser.add_argument("--steps", type=int, default=0, help="of descent")
    parser.add_argument("--cache", type=Path, default=Path("/tmp"))
    parser.add_argument("--reference", type=Path, help="a file that --keep wrote")
    parser.add_argument("--keep", type=Path, help="no times: writes loss and gradient there")
    given = parser.parse_args()
    # Libraries print; only the result may reach standard output.
    stream = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    try:
        found = measure(given)
    except ImportError as error:
        found = {"status": "missing", "reason": str(error)}
    except Exception as error:
        traceback.print_exc()
        lines = str(error).strip().splitlines() or [""]
        status = "missing" if modes.lacks(error) else "failed"
        reason = "this build has no such mode" if status == "missing" else lines[0]
        found = {"status": status, "reason": f"{type(error).__name__}: {reason}"[:200]}
    print(json.dumps(found), file=stream, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
