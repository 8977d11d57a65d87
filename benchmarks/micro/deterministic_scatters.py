"""Scatters in deterministic mode: the cost of a fixed result over atomic additions in any order.

    python benchmarks/micro/deterministic_scatters.py --arch cuda
    python benchmarks/micro/deterministic_scatters.py --sizes 6400 --modes default,deterministic

Contended scatters go to one cell of 4096, or to all of them; sparse ones to as many cells as there
are particles, or to 10^6; `particles` add a mass and a momentum to nine neighbours of a 256 x 256
grid; `gather` is the adjoint of a lookup in 10^6 cells. Each mode is a process of its own, in turn;
a launch is the time of a batch of launches up to the end of its last, divided by their number, and
the least of the rounds counts. In brackets stands the ratio to the default. Then comes the largest
error against sums in f64, relative to the largest sum of absolute values of an element, and a star
where the bits of five launches differ.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time

import numpy as np
import tai as ti

MODES = {
    "default": {},
    "deterministic": {"deterministic": True},
    "strict": {"deterministic": True, "math": "strict"},
    "apart": {"combine_scatters": False},
}
PROGRAMS = ["one", "4096", "sparse", "million", "particles", "gather"]
GRID = 256


def scatter(real, n, cells, reached):
    """Numbers to the first cells, which an index names."""
    x, at, grid = ti.field(real, n), ti.field(ti.i32, n), ti.field(real, cells)
    where = np.random.RandomState(0).randint(0, reached, n)
    values = np.random.RandomState(1).standard_normal(n)
    x.from_numpy(values.astype(np.float32))
    at.from_numpy(where.astype(np.int32))

    @ti.kernel
    def run():
        for i in x:
            grid[at[i]] += x[i]

    def error():
        grid.fill(0)
        run()
        kept = x.to_numpy().astype(np.float64)
        exact = np.bincount(where, kept, cells)
        most = np.bincount(where, np.abs(kept), cells).max()
        return float(np.abs(grid.to_numpy() - exact).max() / most), grid.to_numpy().tobytes()

    return run, error


def particles(real, n):
    """Mass and momentum to nine neighbours."""
    x, v = ti.Vector.field(2, real, n), ti.Vector.field(2, real, n)
    mass, momentum = ti.field(real, (GRID, GRID)), ti.Vector.field(2, real, (GRID, GRID))
    random = np.random.RandomState(0)
    x.from_numpy((0.05 + 0.9 * random.random_sample((n, 2))).astype(np.float32))
    v.from_numpy(random.standard_normal((n, 2)).astype(np.float32))

    @ti.kernel
    def run():
        for p in x:
            base = ti.cast(x[p] * GRID - 0.5, ti.i32)
            f = x[p] * GRID - ti.cast(base, real)
            w = [0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2]
            for i, j in ti.static(ti.ndrange(3, 3)):
                weight = w[i][0] * w[j][1]
                momentum[base + ti.Vector([i, j])] += weight * v[p]
                mass[base + ti.Vector([i, j])] += weight

    def error():
        mass.fill(0)
        run()
        found = mass.to_numpy()
        return float(abs(found.sum(dtype=np.float64) / n - 1)), found.tobytes()

    return run, error


def gather(real, n):
    """The adjoint of a lookup."""
    cells = 1_000_000
    grid = ti.field(real, cells, needs_grad=True)
    y = ti.field(real, n, needs_grad=True)
    at = ti.field(ti.i32, n)
    where = np.random.RandomState(0).randint(0, cells, n)
    at.from_numpy(where.astype(np.int32))
    y.grad.from_numpy(np.random.RandomState(1).standard_normal(n).astype(np.float32))

    @ti.kernel
    def look():
        for i in y:
            y[i] += grid[at[i]]

    def run():
        look.grad()

    def error():
        grid.grad.fill(0)
        run()
        kept = y.grad.to_numpy().astype(np.float64)
        exact = np.bincount(where, kept, cells)
        most = np.bincount(where, np.abs(kept), cells).max()
        found = grid.grad.to_numpy()
        return float(np.abs(found - exact).max() / most), found.tobytes()

    return run, error


def make(name, real, n):
    if name == "particles":
        return particles(real, n)
    if name == "gather":
        return gather(real, n)
    cells = {"one": 4096, "4096": 4096, "sparse": n, "million": 1_000_000}[name]
    return scatter(real, n, cells, 1 if name == "one" else cells)


def measure(args) -> None:
    real = getattr(ti, args.dtype)
    ti.init(arch=getattr(ti, args.arch), default_fp=real, log_level=ti.ERROR, **MODES[args.measure])
    for name in args.programs.split(","):
        for n in map(int, args.sizes.split(",")):
            run, error = make(name, real, n)
            for _ in range(3):
                run()
            ti.sync()
            begin = time.perf_counter()
            run()
            ti.sync()
            once = max(time.perf_counter() - begin, 1e-6)
            batch = max(1, min(50, int(0.05 / once)))
            best = float("inf")
            for _ in range(7):
                begin = time.perf_counter()
                for _ in range(batch):
                    run()
                ti.sync()
                best = min(best, (time.perf_counter() - begin) / batch)
            results = [error() for _ in range(5)]
            differ = len({bits for _, bits in results}) > 1
            print(json.dumps([name, n, best * 1e6, results[0][0], differ]), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arch", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--dtype", default="f32", choices=["f32", "f64"])
    parser.add_argument("--sizes", default="6400,200000,1000000")
    parser.add_argument(
        "--programs", default=",".join(PROGRAMS), help="some of " + ",".join(PROGRAMS)
    )
    parser.add_argument("--modes", default=",".join(MODES), help="some of " + ",".join(MODES))
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        return measure(args)
    modes = args.modes.split(",")
    best: dict[tuple, float] = {}
    errors: dict[tuple, str] = {}
    for _ in range(args.rounds):
        for mode in modes:
            command = [sys.executable, __file__, "--measure", mode]
            for option in ("arch", "dtype", "sizes", "programs"):
                command += [f"--{option}", getattr(args, option)]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                sys.exit(f"{mode}: {done.stderr.strip()[-2000:]}")
            for line in done.stdout.splitlines():
                if line.startswith('["'):
                    name, n, us, error, differ = json.loads(line)
                    best[name, n, mode] = min(us, best.get((name, n, mode), us))
                    errors[name, n, mode] = f"{error:.0e}{'*' if differ else ' '}"
    print(f"{'':20}" + "".join(f"{mode + ', us':>30}" for mode in modes))
    for name in args.programs.split(","):
        for n in map(int, args.sizes.split(",")):
            row = ""
            for mode in modes:
                us, error = best[name, n, mode], errors[name, n, mode]
                ratio = ""
                if mode != "default" and "default" in modes:
                    ratio = f" ({us / best[name, n, 'default']:.2f})"
                row += f"{f'{us:.1f}{ratio} {error}':>30}"
            print(f"{name:10}{n:>10}{row}")


if __name__ == "__main__":
    main()
