"""The cost of bounds checks: milliseconds for each mode of `bounds`, and the ratio to "off".

    bounds.py [--package PATH] [--rounds N]

A five-point stencil with guards and its adjoint, a gather by indices from a field, and the
scene diffmpm; then nanoseconds of a launch whose loop has an argument for its bound. Modes take
turns, each in a process of its own with one thread, and the least time of the processor counts.
With `--package`, a build from before the option is measured too, as "before" and "before,
debug".
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
MODES = {
    "off": {},
    "clamp": {"bounds": "clamp"},
    "check": {"bounds": "check"},
    "debug": {"debug": True},
}


def least(run, seconds: float = 1.0) -> float:
    """The least time of a call, in seconds."""
    run()
    best, end = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.process_time()
        run()
        best = min(best, time.process_time() - start)
    return best


def child(options: dict) -> None:
    """Prints the times of one mode."""
    sys.path.insert(0, str(HERE.parent))
    import numpy as np
    import tai as ti

    ti.init(arch=ti.cpu, default_fp=ti.f32, cpu_max_num_threads=1, offline_cache=False, **options)
    import harness
    import tai_scenes

    n = 512
    x = ti.field(ti.f32, (n, n), needs_grad=True)
    y = ti.field(ti.f32, (n, n), needs_grad=True)
    k = ti.field(ti.i32, n)
    k.from_numpy(np.random.default_rng(0).permutation(n).astype(np.int32))

    @ti.kernel
    def stencil():
        for i, j in x:
            s = -4 * x[i, j]
            if i > 0:
                s += x[i - 1, j]
            if i < n - 1:
                s += x[i + 1, j]
            if j > 0:
                s += x[i, j - 1]
            if j < n - 1:
                s += x[i, j + 1]
            y[i, j] = s

    @ti.kernel
    def gather():
        for i, j in x:
            y[i, j] = x[k[i], j] + x[i, k[j]]

    @ti.kernel
    def prefix(m: ti.i32):
        for i in range(m):
            k[i] += 1

    def launches():
        for _ in range(1000):
            prefix(8)

    program = tai_scenes.make_mpm(harness.PROBLEMS["diffmpm"](False))
    found = {
        "stencil": 1e3 * least(stencil),
        "adjoint": 1e3 * least(stencil.grad),
        "gather": 1e3 * least(gather),
        "diffmpm": 1e3 * least(program.run, 4.0),
        "launch, ns": 1e6 * least(launches),
    }
    print(json.dumps(found))


def measure(package: str, options: dict) -> dict[str, float]:
    """Times of one mode, in a process of its own.

    Raises:
        CalledProcessError: the process fails.
    """
    command = [sys.executable, __file__, "--child", json.dumps(options)]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": package}, check=True, capture_output=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--package", help="a build from before the option")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--child", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child is not None:
        child(json.loads(chosen.child))
        return
    ours = str(HERE.parent.parent / "python")
    runs = {mode: (ours, options) for mode, options in MODES.items()}
    if chosen.package:
        runs["before"] = (chosen.package, {})
        runs["before, debug"] = (chosen.package, {"debug": True})
    best: dict[str, dict[str, float]] = {mode: {} for mode in runs}
    for _ in range(chosen.rounds):
        for mode, (package, options) in runs.items():
            for case, value in measure(package, options).items():
                best[mode][case] = min(value, best[mode].get(case, value))
    cases = list(best["off"])
    print("".ljust(18), *(f"{mode:>16}" for mode in runs))
    for case in cases:
        row = (f"{best[m][case]:9.3g} {best[m][case] / best['off'][case]:5.2f}x" for m in runs)
        print(case.ljust(18), *(f"{cell:>16}" for cell in row))


if __name__ == "__main__":
    main()
