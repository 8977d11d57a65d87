"""Parallel loops around serial sums: products of matrices, all pairs, iterations of elements, and
rows of uneven length.

    python benchmarks/micro/serial_sums.py                      # tai alone
    python benchmarks/micro/serial_sums.py --peers-venv FOLDER  # taichi and quadrants in turns

The same file runs on each of the modules, on one thread, with and without `fast_math` (the default
of both peers), and prints the least processor time of a launch in microseconds; for peers, the
ratio to tai in brackets. Without `fast_math` sums are evaluated in the order of the program.
"""

from __future__ import annotations

import argparse
import importlib
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROUNDS = 3
N, WIDE, MOST = 1000, 96, 48


def programs(ti, real):
    """Kernels by name."""
    a, b, c = (ti.field(real, (WIDE, WIDE)) for _ in range(3))
    rows, vector, out = ti.field(real, (N, 116)), ti.field(real, 116), ti.field(real, N)
    place, pull = ti.Vector.field(3, real, N), ti.Vector.field(3, real, N)
    steps, count, near = ti.field(ti.i32, N), ti.field(ti.i32, N), ti.field(ti.i32, (N, MOST))
    table, first = ti.field(real, (N, N)), ti.field(ti.i32, N + 1)
    column, value = ti.field(ti.i32, 30 * N), ti.field(real, 30 * N)
    random = np.random.RandomState(0)
    for field in (a, b, rows, vector, place, table, value):
        shape = field.shape + ((3,) if field is place else ())
        field.from_numpy(random.standard_normal(shape).astype(np.float32))
    count.from_numpy(random.binomial(MOST, 0.6, N).astype(np.int32))
    near.from_numpy(random.randint(0, N, (N, MOST)).astype(np.int32))
    begins = np.sort(random.randint(0, 30 * N, N + 1))
    begins[0], begins[-1] = 0, 30 * N
    first.from_numpy(begins.astype(np.int32))
    column.from_numpy(random.randint(0, N, 30 * N).astype(np.int32))

    @ti.kernel
    def multiply():
        for i, j in c:
            total = 0.0
            for k in range(WIDE):
                total += a[i, k] * b[k, j]
            c[i, j] = total

    @ti.kernel
    def layer():
        for i in range(N):
            total = 0.0
            for j in range(116):
                total += rows[i, j] * vector[j]
            out[i] = total

    @ti.kernel
    def bodies():
        for i in range(N):
            force = ti.Vector([0.0, 0.0, 0.0])
            for j in range(N):
                way = place[j] - place[i]
                square = way.dot(way) + 1e-3
                force += way / (square * ti.sqrt(square))
            pull[i] = force

    @ti.kernel
    def pairs():
        for i in range(N):
            force = ti.Vector([0.0, 0.0, 0.0])
            for j in range(N):
                way = place[j] - place[i]
                square = way.dot(way)
                if i != j and square < 1.0:
                    s = (0.01 / square) ** 3
                    force += (2 * s * s - s) / square * way
            pull[i] = force

    @ti.kernel
    def escape():
        for i in range(N):
            re, im, count = 0.0, 0.0, 0
            for _ in range(100):
                if re * re + im * im < 4.0:
                    re, im = re * re - im * im + place[i][0], 2 * re * im + place[i][1]
                    count += 1
            steps[i] = count

    @ti.kernel
    def triangle():
        for i in range(N):
            total = 0.0
            for j in range(i):
                total += table[i, j] * table[0, j]
            out[i] = total

    @ti.kernel
    def near_by():
        for i in range(N):
            force = ti.Vector([0.0, 0.0, 0.0])
            for k in range(count[i]):
                way = place[near[i, k]] - place[i]
                square = way.dot(way) + 1e-3
                force += way / (square * ti.sqrt(square))
            pull[i] = force

    @ti.kernel
    def padded():
        for i in range(N):
            total = 0.0
            for k in range(count[i]):
                total += table[i, k] * vector[k]
            out[i] = total

    @ti.kernel
    def sparse():
        for i in range(N):
            total = 0.0
            for k in range(first[i], first[i + 1]):
                total += value[k] * table[0, column[k]]
            out[i] = total

    return [multiply, layer, bodies, pairs, escape, triangle, near_by, padded, sparse]


def measure(module: str, dtype: str, fast: bool) -> None:
    ti = importlib.import_module(module)
    real = getattr(ti, dtype)
    ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=real, fast_math=fast, log_level=ti.ERROR)
    for kernel in programs(ti, real):
        kernel()
        best = float("inf")
        for _ in range(20):
            begin = time.process_time_ns()
            for _ in range(5):
                kernel()
            best = min(best, (time.process_time_ns() - begin) / 5e3)
        print(json.dumps([kernel.__name__, best]), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--dtype", default="f32", choices=["f32", "f64"])
    parser.add_argument("--peers-venv", type=Path, help="where taichi and quadrants are installed")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    parser.add_argument("--fast", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        return measure(args.measure, args.dtype, args.fast)
    systems = {"tai": sys.executable}
    if args.peers_venv:
        systems |= dict.fromkeys(["taichi", "quadrants"], str(args.peers_venv / "bin" / "python"))
    columns = [(system, fast) for fast in (False, True) for system in systems]
    best: dict[tuple[str, bool], dict[str, float]] = {column: {} for column in columns}
    for _ in range(ROUNDS):
        for system, fast in columns:
            command = [systems[system], __file__, "--dtype", args.dtype, "--measure", system]
            command += ["--fast"] if fast else []
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                sys.exit(f"{system}: {done.stderr.strip()[-400:]}")
            for line in done.stdout.splitlines():
                if line.startswith('["'):  # the peers say other things, too
                    name, us = json.loads(line)
                    best[system, fast][name] = min(us, best[system, fast].get(name, us))
    titles = [f"{system}{', fast' if fast else ''}" for system, fast in columns]
    print(f"{'':10}" + "".join(f"{title:>18}" for title in titles))
    for name in best["tai", False]:
        cells = []
        for system, fast in columns:
            us = best[system, fast][name]
            ratio = f" ({us / best['tai', fast][name]:.2f})" if system != "tai" else ""
            cells.append(f"{us:.1f}{ratio}")
        print(f"{name:10}" + "".join(f"{cell:>18}" for cell in cells))


if __name__ == "__main__":
    main()
