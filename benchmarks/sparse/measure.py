"""Time one program on one layout in one system, in this process; print a line of JSON.

    measure.py tai stencil pointer 0.01
    measure.py tai bodies pointer 1
    measure.py tai band pointer 512

The programs are written in the part of the language that tai and Taichi share.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from pathlib import Path

N, B = 2048, 8
WARM_UPS, SECONDS, FEWEST = 3, 1.5, 15


def least(run, ti) -> float:
    """Milliseconds of the fastest of many runs, which a busy machine disturbs least."""
    for _ in range(WARM_UPS):
        run()
    ti.sync()
    times, begin = [], time.perf_counter()
    while len(times) < FEWEST or time.perf_counter() - begin < SECONDS:
        start = time.perf_counter()
        run()
        ti.sync()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def place(ti, layout: str, fields: list, size: int = N) -> None:
    """Each field in blocks of its own below a common sparse level; dense: one after another.

    `aos`: side by side in one cell. `apart`: in trees of their own.
    """
    kind, _, how = layout.partition("-")
    groups = {"": [fields], "aos": [fields], "apart": [[field] for field in fields]}[how]
    for group in groups:
        if kind == "dense":
            levels = [ti.root.dense(ti.ij, size)] if how == "aos" else []
            blocks = levels or [ti.root.dense(ti.ij, size) for _ in group]
        else:
            if kind == "blocks":
                outer = ti.root.dense(ti.ij, size // B)
            elif kind == "pointer2":
                outer = ti.root.pointer(ti.ij, size // B // 8).pointer(ti.ij, 8)
            else:
                outer = getattr(ti.root, kind)(ti.ij, size // B)
            count = 1 if how == "aos" else len(group)
            blocks = [outer.dense(ti.ij, B) for _ in range(count)]
        for k, block in enumerate(blocks):
            block.place(*(group if len(blocks) == 1 else [group[k]]))


def stencil(ti, layout: str, share: float) -> dict:
    """The five-point stencil on a square that covers a share of the field."""
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    place(ti, layout, [x, y])
    side = round(N * share**0.5 / B) * B

    @ti.kernel
    def fill():
        for i, j in ti.ndrange(side, side):
            x[i, j] = 0.01 * i + j
            y[i, j] = 0.0

    @ti.kernel
    def step():
        for i, j in x:
            if 0 < i < N - 1 and 0 < j < N - 1:
                near = x[i - 1, j] + x[i + 1, j] + x[i, j - 1] + x[i, j + 1]
                y[i, j] = 0.5 * x[i, j] + 0.125 * near

    fill()
    forward = least(step, ti)
    at = side // 2
    expected = 0.01 * at + at
    assert abs(y[at, at] - expected) < 1e-3 * expected, (y[at, at], expected)
    return {"cells": side * side, "ms": forward}


def adjoint(ti, layout: str, share: float) -> dict:
    """The adjoint of that stencil."""
    x, y = (ti.field(ti.f32, needs_grad=True) for _ in range(2))
    place(ti, layout, [x, y, x.grad, y.grad])
    side = round(N * share**0.5 / B) * B

    @ti.kernel
    def fill():
        for i, j in ti.ndrange(side, side):
            x[i, j] = 0.01 * i + j
            y.grad[i, j] = 1.0

    @ti.kernel
    def step():
        for i, j in x:
            if 0 < i < N - 1 and 0 < j < N - 1:
                near = x[i - 1, j] + x[i + 1, j] + x[i, j - 1] + x[i, j + 1]
                y[i, j] = 0.5 * x[i, j] + 0.125 * near

    fill()
    step.grad()
    at = side // 2
    assert abs(x.grad[at, at] - 1.0) < 1e-5, x.grad[at, at]
    return {"cells": side * side, "ms": least(step.grad, ti)}


def bodies(ti, layout: str, count: float) -> dict:
    """Reverse sweep of ten elastic discs that do not touch; the loss looks at some of them."""
    n, steps = 1024, 4
    x, y = (ti.field(ti.f32, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    place(ti, layout, [x, y], n)
    side, looked = 96, int(count)

    @ti.kernel
    def fill():
        for body, i, j in ti.ndrange(10, side, side):
            x[i + 64, j + body * 100 + 8] = 0.5 + 0.001 * (i + j)
            y[i + 64, j + body * 100 + 8] = 0.0

    @ti.kernel
    def step():
        for i, j in x:
            if 0 < i < n - 1 and 0 < j < n - 1:
                near = x[i - 1, j] + x[i + 1, j] + x[i, j - 1] + x[i, j + 1]
                y[i, j] += 0.01 * ti.sin(x[i, j]) * near

    @ti.kernel
    def look():
        for body, i, j in ti.ndrange(looked, side, side):
            loss[None] += y[i + 64, j + body * 100 + 8]

    fill()
    with ti.ad.Tape(loss) as tape:
        for _ in range(steps):
            step()
        look()

    def reverse():
        ti.ad.clear_all_gradients()
        loss.grad[None] = 1.0
        tape.grad()

    return {"cells": 10 * side * side, "ms": least(reverse, ti)}


def band(ti, layout: str, size: float) -> dict:
    """A band of four cells around a sphere in a box of size³: its memory."""
    n = int(size)
    x = ti.field(ti.f32)
    getattr(ti.root, layout)(ti.ijk, n // B).dense(ti.ijk, B).place(x)
    radius = 0.4 * n

    def resident() -> int:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1]) << 10
        return 0

    @ti.kernel
    def fill():
        for i, j in ti.ndrange(n, n):
            a, b = i - 0.5 * n, j - 0.5 * n
            square = radius * radius - a * a - b * b
            if square > 0:
                height = ti.sqrt(square)
                for k in range(2):
                    middle = int(0.5 * n + (height if k == 0 else -height))
                    for d in range(-2, 2):
                        if 0 <= middle + d < n:
                            x[i, j, middle + d] = 1.0

    @ti.kernel
    def count() -> int:
        cells = 0
        for _i, _j, _k in x:
            cells += 1
        return cells

    @ti.kernel
    def relax():
        for i, j, k in x:
            x[i, j, k] = 0.9 * x[i, j, k] + 0.1

    count()  # compiled before the memory is looked at
    relax()
    before = resident()
    fill()
    cells = count()
    taken = resident() - before
    return {"cells": cells, "bytes": taken, "ms": least(relax, ti)}


def main() -> None:
    system, program, layout, size = sys.argv[1:]
    ti = importlib.import_module(system)
    options = {"log_level": ti.ERROR} if system != "tai" else {}
    ti.init(arch=ti.cpu, offline_cache=False, **options)
    result = globals()[program](ti, layout, float(size))
    print(
        json.dumps(
            {"system": system, "program": program, "layout": layout, "size": float(size), **result}
        )
    )


if __name__ == "__main__":
    main()
