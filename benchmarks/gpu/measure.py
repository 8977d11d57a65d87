"""Time programs of tai that are not scenes, in this process; print lines of JSON.

    measure.py launch|chain|bandwidth|sparse [--arch cuda] [--quick] [--small]

Queued work is timed in batches, with one wait at the end of each. The data of bandwidth and
sparse are chosen so that all results are exact in f32.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import tai as ti

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from harness import clock, statistics_of

CHAIN = 1000
BLOCK = 8


def value_of_x(i, j):
    return ((i * 7 + j * 3) & 255) / 256.0


def value_of_y(i, j):
    return ((i * 5 + j * 11) & 255) / 256.0


def report(scene: str, variant: str, phase: str, **values) -> None:
    record = {"peer": "tai", "scene": scene, "variant": variant, "phase": phase, **values}
    print(json.dumps(record), flush=True)


def batches(run, count: int, rounds: int) -> list[float]:
    """Seconds of one of `count` runs that are queued together, for each of the rounds."""
    for _ in range(3):
        run()
    ti.sync()
    times = []
    for _ in range(rounds):
        start = clock()
        for _ in range(count):
            run()
        ti.sync()
        times.append((clock() - start) / count)
    return times


def launch(_options) -> None:
    """A compiled kernel with one argument: queueing it, and waiting for it as well."""
    value = ti.field(dtype=ti.f32, shape=())

    @ti.kernel
    def bump(t: ti.i32):
        value[None] += t

    for _ in range(200):
        bump(1)
    ti.sync()
    queued, waited = [], []
    for _ in range(30):
        start = clock()
        for _ in range(200):
            bump(1)
        middle = clock()
        ti.sync()
        queued.append((middle - start) / 200)
    for _ in range(100):
        start = clock()
        bump(1)
        ti.sync()
        waited.append(clock() - start)
    expected = 200 + 30 * 200 + 100
    if value[None] != expected:
        raise RuntimeError(f"the kernel ran {value[None]} times of {expected}")
    report("launch", "", "enqueue", **statistics_of(queued))
    report("launch", "", "round_trip", **statistics_of(waited))


def chain(_options) -> None:
    """A tape of launches that do next to nothing, replayed: the cost of a launch."""
    width = 64
    x = ti.field(ti.f32, shape=(CHAIN + 1, width), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(width):
            x[t + 1, i] = x[t, i] + 0.001 * x[t, i] * x[t, i]

    @ti.kernel
    def total():
        for i in range(width):
            loss[None] += x[CHAIN, i]

    start_values = np.linspace(0.1, 0.5, width)
    x.from_numpy(np.concatenate([start_values[None], np.zeros((CHAIN, width))]).astype(np.float32))
    with ti.ad.Tape(loss) as tape:
        for t in range(CHAIN):
            step(t)
        total()
    if not hasattr(tape, "replay"):
        raise RuntimeError("this build has no replay of tapes")
    launches = 2 * (CHAIN + 1)
    queued, whole = [], []
    for _ in range(3):
        tape.replay()
    ti.sync()
    for _ in range(20):
        start = clock()
        loss[None] = 0.0
        tape.replay()
        middle = clock()
        ti.sync()
        queued.append((middle - start) / launches)
        whole.append((clock() - start) / launches)
    values, slope = start_values, np.ones(width)
    for _ in range(CHAIN):
        slope *= 1.0 + 0.002 * values
        values = values + 0.001 * values * values
    error = np.linalg.norm(x.grad.to_numpy()[0] - slope) / np.linalg.norm(slope)
    exact = {"loss": float(loss[None]), "grad_rel_err": float(error)}
    report("chain", "", "enqueue", **statistics_of(queued), **exact)
    report("chain", "", "replay", **statistics_of(whole), **exact)


def _row_error(found: np.ndarray, expected: np.ndarray) -> dict[str, float]:
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    return {"loss": float(np.sum(found, dtype=np.float64)), "grad_rel_err": float(error)}


def bandwidth(options) -> None:
    """Copy, map, stencil and its adjoint on arrays that no cache holds."""
    n = 256 if options.small else 8192 if options.quick else 16384
    bytes_of_array = 4.0 * n * n
    x = ti.field(ti.f32, shape=(n, n), needs_grad=True)
    y = ti.field(ti.f32, shape=(n, n), needs_grad=True)

    @ti.kernel
    def fill():
        for i, j in x:
            x[i, j] = ti.cast((i * 7 + j * 3) & 255, ti.f32) / 256.0
            y[i, j] = ti.cast((i * 5 + j * 11) & 255, ti.f32) / 256.0

    @ti.kernel
    def fill_adjoints():
        for i, j in x:
            x.grad[i, j] = ti.cast((i * 7 + j * 3) & 255, ti.f32) / 256.0
            y.grad[i, j] = ti.cast((i * 5 + j * 11) & 255, ti.f32) / 256.0

    @ti.kernel
    def copy():
        for i, j in x:
            y[i, j] = x[i, j]

    @ti.kernel
    def map_():
        for i, j in x:
            y[i, j] = 2.0 * x[i, j] + y[i, j]

    @ti.kernel
    def stencil():
        for i, j in x:
            if 0 < i < n - 1 and 0 < j < n - 1:
                near = x[i - 1, j] + x[i + 1, j] + x[i, j - 1] + x[i, j + 1]
                y[i, j] = 0.5 * x[i, j] + 0.125 * near

    @ti.kernel
    def stencil_in_ranges():
        for i, j in ti.ndrange((1, n - 1), (1, n - 1)):
            near = x[i - 1, j] + x[i + 1, j] + x[i, j - 1] + x[i, j + 1]
            y[i, j] = 0.5 * x[i, j] + 0.125 * near

    @ti.kernel
    def row_of_y(out: ti.types.ndarray()):
        for j in range(n):
            out[j] = y[n // 2 + 1, j]

    @ti.kernel
    def row_of_adjoint(out: ti.types.ndarray()):
        for j in range(n):
            out[j] = x.grad[n // 2 + 1, j]

    i, j = n // 2 + 1, np.arange(n)
    inside = (j > 0) & (j < n - 1)
    near = value_of_x(i - 1, j) + value_of_x(i + 1, j)
    near = near + value_of_x(i, j - 1) + value_of_x(i, j + 1)
    stencil_row = np.where(inside, 0.5 * value_of_x(i, j) + 0.125 * near, value_of_y(i, j))
    bar = np.where(inside, value_of_y(i, j), 0.0)
    above, below = (np.where(inside, value_of_y(r, j), 0.0) for r in (i - 1, i + 1))
    beside = np.concatenate([bar[1:], [0.0]]) + np.concatenate([[0.0], bar[:-1]])
    adjoint_row = value_of_x(i, j) + 0.5 * bar + 0.125 * (above + below + beside)
    variants = [
        ("copy", 2, copy, fill, row_of_y, value_of_x(i, j)),
        ("map", 3, map_, fill, row_of_y, 2.0 * value_of_x(i, j) + value_of_y(i, j)),
        ("stencil", 2, stencil, fill, row_of_y, stencil_row),
        ("adjoint", 3, stencil.grad, fill_adjoints, row_of_adjoint, adjoint_row),
        ("stencil-ranges", 2, stencil_in_ranges, fill, row_of_y, stencil_row),
        (
            *("adjoint-ranges", 3, stencil_in_ranges.grad),
            *(fill_adjoints, row_of_adjoint, adjoint_row),
        ),
    ]
    fill()
    for name, arrays, run, prepare, row_of, expected in variants:
        times = batches(run, 10, 10)
        prepare()
        run()
        row = np.zeros(n, np.float32)
        row_of(row)
        statistics = statistics_of(times)
        speed = arrays * bytes_of_array / statistics["ms"] * 1e-6
        found = _row_error(row.astype(np.float64), expected)
        report("bandwidth", name, "forward", **statistics, gb_per_s=speed, **found)


def sparse(options) -> None:
    """The five-point stencil on a square that covers a share of a box, against the dense one."""
    n = 256 if options.small else 8192 if options.quick else 16384
    variants = [("dense", 1.0), ("active-1", 0.01), ("active-10", 0.1), ("active-100", 1.0)]
    for name, share in variants:
        ti.init(**options.init)
        _sparse_variant(n, name, share)


def _sparse_variant(n: int, name: str, share: float) -> None:
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    if name == "dense":
        ti.root.dense(ti.ij, n).place(x)
        ti.root.dense(ti.ij, n).place(y)
    else:
        outer = ti.root.pointer(ti.ij, n // BLOCK)
        outer.dense(ti.ij, BLOCK).place(x)
        outer.dense(ti.ij, BLOCK).place(y)
    side = round(n * share**0.5 / BLOCK) * BLOCK
    middle = side // 2

    @ti.kernel
    def fill():
        for i, j in ti.ndrange(side, side):
            x[i, j] = ti.cast((i * 7 + j * 3) & 255, ti.f32) / 256.0
            y[i, j] = 0.0

    @ti.kernel
    def step():
        for i, j in x:
            if 0 < i < n - 1 and 0 < j < n - 1:
                near = x[i - 1, j] + x[i + 1, j] + x[i, j - 1] + x[i, j + 1]
                y[i, j] = 0.5 * x[i, j] + 0.125 * near

    @ti.kernel
    def row_of_y(out: ti.types.ndarray()):
        for j in range(side):
            out[j] = y[middle, j]

    fill()
    times = batches(step, 20, 10)
    row = np.zeros(side, np.float32)
    row_of_y(row)
    j = np.arange(side)
    left = np.where(j > 0, value_of_x(middle, j - 1), 0.0)
    right = np.where(j < side - 1, value_of_x(middle, j + 1), 0.0)
    near = value_of_x(middle - 1, j) + value_of_x(middle + 1, j) + left + right
    inside = (j > 0) & (j < n - 1)
    expected = np.where(inside, 0.5 * value_of_x(middle, j) + 0.125 * near, 0.0)
    found = _row_error(row.astype(np.float64), expected)
    report("sparse", name, "forward", **statistics_of(times), **found)


PROGRAMS = {"launch": launch, "chain": chain, "bandwidth": bandwidth, "sparse": sparse}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", choices=PROGRAMS)
    parser.add_argument("--arch", default="cuda", choices=["cpu", "cuda"])
    parser.add_argument("--quick", action="store_true", help="arrays a fourth of the size")
    parser.add_argument("--small", action="store_true", help="tiny, to try the program")
    options = parser.parse_args()
    options.init = {"arch": getattr(ti, options.arch), "offline_cache": False}
    ti.init(**options.init)
    used = ti.lang.impl.current_cfg().arch
    if used != options.arch:
        raise SystemExit(f"asked for arch={options.arch}, and got {used}")
    PROGRAMS[options.program](options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
