"""The cost of a precision report: 400 short launches under `ti.ad.Tape(loss, precision=True)`.

    python benchmarks/micro/precision.py [--sizes 4,32,256] [--rounds 15]

Three programs: steps along a time axis; three kernels in turns; sums that steps read. Prints the
processor time of one thread for recording, the sweep and the report, next to that of a tape without
the report: quartiles over rounds in turns are the lower ones, since other programs only add time.
"""

from __future__ import annotations

import argparse
import time

import tai as ti

LAUNCHES = 400


def build(kind: str, n: int):
    """The program of a kind, as a function that runs it once and returns its seconds."""
    ti.init(arch=ti.cpu, cpu_max_num_threads=1)
    x, v, f = (ti.field(float, (LAUNCHES + 1, n), needs_grad=True) for _ in range(3))
    y, w = (ti.field(float, n, needs_grad=True) for _ in range(2))
    total, loss = (ti.field(float, (), needs_grad=True) for _ in range(2))

    @ti.kernel
    def step(t: int):
        for i in range(n):
            v[t + 1, i] = v[t, i] - 0.01 * ti.sin(x[t, i])
            x[t + 1, i] = x[t, i] + 0.01 * v[t + 1, i]

    @ti.kernel
    def force(t: int):
        for i in range(n - 1):
            pull = 10.0 * (x[t, i + 1] - x[t, i] - 0.1)
            f[t, i] += pull
            f[t, i + 1] -= pull

    @ti.kernel
    def move(t: int):
        for i in range(n):
            v[t + 1, i] = ti.exp(-0.01) * v[t, i] + 0.01 * f[t, i]
            x[t + 1, i] = x[t, i] + 0.01 * v[t + 1, i]

    @ti.kernel
    def follow(t: int):
        for i in range(n):
            w[i] = 0.999 * w[i] + 0.001 * v[t, i]

    @ti.kernel
    def add():
        for i in range(n):
            total[None] += 0.01 * ti.sin(y[i])

    @ti.kernel
    def pull():
        for i in range(n):
            y[i] -= 0.01 * total[None]

    @ti.kernel
    def measure(t: int):
        for i in range(n):
            loss[None] += x[t, i] ** 2 + w[i] ** 2 + y[i] ** 2

    def launches() -> None:
        if kind == "time axis":
            for t in range(LAUNCHES):
                step(t)
        elif kind == "three kernels":
            for t in range(LAUNCHES // 3):
                force(t)
                move(t)
                follow(t)
        else:
            for _ in range(LAUNCHES // 2):
                add()
                pull()
        measure(LAUNCHES // 3 if kind == "three kernels" else LAUNCHES)

    def once(precision: bool) -> float:
        for field, value in ((x, 0.3), (v, 0.1), (f, 0.0), (y, 0.4), (w, 0.1), (total, 0.5)):
            field.fill(value)
        loss.fill(0.0)
        begin = time.process_time()
        with ti.ad.Tape(loss, precision=precision) as tape:
            launches()
        if precision:
            tape.precision_report()
        return time.process_time() - begin

    return once


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="4,32,256", help="iterations of a launch")
    parser.add_argument("--rounds", type=int, default=15)
    args = parser.parse_args()
    for kind in ("time axis", "three kernels", "sums"):
        for n in map(int, args.sizes.split(",")):
            once = build(kind, n)
            for precision in (False, True, False, True):
                once(precision)
            pairs = [(once(False), once(True)) for _ in range(args.rounds)]
            plain, probed = (sorted(times)[len(times) // 4] for times in zip(*pairs, strict=True))
            print(f"{kind:14} {n:5}: {1e3 * plain:6.2f} ms, {1e3 * probed:6.2f} with a report: "
                  f"{probed / plain:.2f} times", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
