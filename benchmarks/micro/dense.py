"""Times of dense scenes of which a loss needs a part, and of the needed part alone.

    python benchmarks/micro/dense.py                  # all rows, some minutes
    python benchmarks/micro/dense.py sum --threads 2 --csv dense.csv

Each row is a program, and another one that does the needed part only. `ms` and
`needed_ms` are an iteration of both, forward and in reverse, or the sweep alone where the row
says so; `without_ms` is the first one without the skip of the row, if there is one. Each column is
the least of the rounds of several processes: processor time on one thread, else the clock.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tai as ti

ROUNDS, SECONDS = 12, 0.02
STEPS, BODIES, N = 40, 16, 4096
MANY = 1_000_000
ROWS: dict[str, tuple[str, Callable]] = {}


def row(skip=""):
    def note(function):
        ROWS[function.__name__] = (skip, function)
        return function

    return note


def real(*shape, needs_grad=True):
    field = ti.field(ti.f32, shape=shape, needs_grad=needs_grad)
    field.from_numpy(np.random.default_rng(0).random(shape, dtype=np.float32))
    return field


class Bodies:
    """Steps of many bodies with a time axis, and a loss of one of them or of all."""

    def __init__(self):
        x = real(STEPS + 1, BODIES, N)
        loss = self.loss = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def step(t: ti.i32):
            for b, i in ti.ndrange(BODIES, N):
                x[t + 1, b, i] = x[t, b, i] + 0.1 * ti.sin(3.0 * x[t, b, i])

        @ti.kernel
        def step_one(t: ti.i32, b: ti.i32):
            for i in range(N):
                x[t + 1, b, i] = x[t, b, i] + 0.1 * ti.sin(3.0 * x[t, b, i])

        @ti.kernel
        def total(t: ti.i32):
            for b, i in ti.ndrange(BODIES, N):
                loss[None] += x[t, b, i]

        @ti.kernel
        def total_one(t: ti.i32, b: ti.i32):
            for i in range(N):
                loss[None] += x[t, b, i]

        @ti.kernel
        def total_of_a_range(t: ti.i32):
            for b, i in ti.ndrange((3, 4), N):
                loss[None] += x[t, b, i]

        self.step, self.step_one = step, step_one
        self.total, self.total_one = total, total_one
        self.total_of_a_range = total_of_a_range

    def sweep(self, *launches):
        """The sweep of a tape of these launches."""
        with ti.ad.Tape(self.loss) as tape:
            for kernel, *args in launches:
                kernel(*args)
        return tape.grad


@row("dead-launches")
def half_of_the_time_axis():
    """The sweep of a loss at half of the steps."""
    scene, other, half = Bodies(), Bodies(), STEPS // 2
    return (
        scene.sweep(*((scene.step, t) for t in range(STEPS)), (scene.total, half)),
        other.sweep(*((other.step, t) for t in range(half)), (other.total, half)),
    )


@row("zero-adjoints")
def one_body_of_sixteen():
    """The sweep of a loss of one body, which each launch moves with all others."""
    scene, other = Bodies(), Bodies()
    return (
        scene.sweep(*((scene.step, t) for t in range(STEPS)), (scene.total_one, STEPS, 3)),
        other.sweep(*((other.step_one, t, 3) for t in range(STEPS)), (other.total_one, STEPS, 3)),
    )


@row("dead-launches")
def one_body_by_launches():
    """The same, if each launch moves one body."""
    scene, other = Bodies(), Bodies()
    every = [(scene.step_one, t, b) for t in range(STEPS) for b in range(BODIES)]
    return (
        scene.sweep(*every, (scene.total_one, STEPS, 3)),
        other.sweep(*((other.step_one, t, 3) for t in range(STEPS)), (other.total_one, STEPS, 3)),
    )


@row("dead-launches")
def one_body_by_a_range():
    """The same, with the loss over a range of one body."""
    scene, other = Bodies(), Bodies()
    every = [(scene.step_one, t, b) for t in range(STEPS) for b in range(BODIES)]
    return (
        scene.sweep(*every, (scene.total_of_a_range, STEPS)),
        other.sweep(*((other.step_one, t, 3) for t in range(STEPS)), (other.total_one, STEPS, 3)),
    )


def taped(loss, *kernels, incremental=False):
    def run():
        with ti.ad.Tape(loss, incremental=incremental):
            for kernel in kernels:
                kernel()

    return run


@row("unread-zeros")
def sum_of_a_field():
    """Its two kernels are needed, and no clear."""
    x, loss = real(MANY), ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    def needed():
        total()
        total.grad()

    return taped(loss, total), needed


@row()
def map_and_sum():
    """The same with an exponential, which both kernels compute."""
    x, loss = real(MANY), ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += ti.exp(-x[i] * x[i])

    return taped(loss, total), total


@row("unchanged-launches")
def fixed_inputs():
    """Features of numbers that never change, weighed by those that do."""
    x, h = real(MANY, needs_grad=False), real(MANY, needs_grad=False)
    w, loss = real(MANY), ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def feature():
        for i in x:
            v = x[i]
            for _ in range(12):
                v = ti.sin(v) + 0.5 * ti.cos(3.0 * v)
            h[i] = v

    @ti.kernel
    def weigh():
        for i in w:
            loss[None] += w[i] * h[i]

    return taped(loss, feature, weigh, incremental=True), taped(loss, weigh)


def least(run, clock):
    for _ in range(3):
        run()
    best = np.inf
    for _ in range(ROUNDS):
        begin, count = clock(), 0
        while clock() - begin < SECONDS:
            run()
            count += 1
        best = min(best, (clock() - begin) / count)
    return 1e3 * best


def in_process(name, skip, threads):
    words = [sys.executable, __file__, name, "--threads", str(threads), "--one", skip]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def measure(name, skip, threads):
    ti.init(skip=skip, cpu_max_num_threads=threads)
    clock = time.process_time if threads == 1 else time.perf_counter
    return [least(run, clock) for run in ROWS[name][1]()]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", help="names of rows")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--processes", type=int, default=3, help="for each column")
    parser.add_argument("--csv", type=Path, help="write the rows to this file")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        print(json.dumps(measure(args.rows[0], args.one, args.threads)))
        return
    lines = ["row,threads,skip,without_ms,ms,needed_ms,times"]
    for name in args.rows or ROWS:
        skip = ROWS[name][0]
        on, off = [], []
        for _ in range(args.processes):
            on.append(in_process(name, "all", args.threads))
            if skip:
                off.append(in_process(name, f"all,-{skip}", args.threads)[0])
        now, needed = (min(column) for column in zip(*on, strict=True))
        without = f"{min(off):.3f}" if off else ""
        lines.append(
            f"{name},{args.threads},{skip},{without},{now:.3f},{needed:.3f},{now / needed:.2f}"
        )
        print(lines[-1], flush=True)
    if args.csv:
        args.csv.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
