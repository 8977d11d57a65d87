"""Programs that ranks run in tests, and that one process runs without a mesh."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import tai as ti


def begin(transport: Any, fp: Any) -> None:
    mesh = None
    if transport is not None:
        mesh = ti.mesh("x", transport.size, transport)
    ti.init(arch=ti.cpu, default_fp=fp, mesh=mesh, offline_cache=False, cpu_max_num_threads=1)


def root(transport: Any, axis: Any) -> Any:
    return ti.root if transport is None else ti.root.shard(axis)


def _noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(-1, 1, shape)


def wave(transport: Any, fp: Any, n: int = 24, steps: int = 6) -> dict[str, Any]:
    """A wave over a time axis, with a loss over a part of the field and a parameter."""
    begin(transport, fp)
    u = ti.field(fp)
    target, loss, c = ti.field(fp), ti.field(fp), ti.field(fp)
    root(transport, ti.j).dense(ti.ij, (steps, n)).place(u)
    root(transport, ti.j).dense(ti.j, n).place(target)
    ti.root.place(loss, c)
    ti.root.lazy_grad()

    @ti.kernel
    def step(t: ti.i32):
        for i in range(1, n - 1):
            bend = u[t - 1, i - 1] - 2 * u[t - 1, i] + u[t - 1, i + 1]
            u[t, i] = 2 * u[t - 1, i] - u[t - 2, i] + c[None] * bend

    @ti.kernel
    def measure(t: ti.i32):
        for i in range(n // 4, n):
            loss[None] += (u[t, i] - target[i]) ** 2

    start = np.zeros((steps, n))
    start[0] = start[1] = _noise(n)
    u.from_numpy(start)
    target.from_numpy(_noise(n)[::-1].copy())
    c[None] = 0.2
    with ti.ad.Tape(loss):
        for t in range(2, steps):
            step(t)
        measure(steps - 1)
    return {"loss": loss[None], "u": u.to_numpy(), "gradient": u.grad.to_numpy()[:2],
            "c": c.grad[None], "element": u[steps - 1, n - 2]}  # fmt: skip


def heat(transport: Any, fp: Any, n: int = 12, steps: int = 3) -> dict[str, Any]:
    """A stencil in two dimensions on vectors, reads that stop at the border, steps in place."""
    begin(transport, fp)
    a, b = (ti.Vector.field(2, fp) for _ in range(2))
    loss = ti.field(fp)
    rows = root(transport, ti.i)
    for field in (a, b):
        rows.dense(ti.ij, (n, n)).place(field)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def smooth(x: ti.template(), y: ti.template()):
        for i, j in x:
            s = x[i, j] * 4.0
            s += x[ti.max(i - 1, 0), j] + x[ti.min(i + 1, n - 1), j]
            s += x[i, ti.max(j - 1, 0)] * x[i, j]
            y[i, j] = s / 8.0

    @ti.kernel
    def total():
        for i, j in a:
            loss[None] += a[i, j][0] * a[i, j][1]

    first = _noise(n, n, 2)
    a.from_numpy(first)
    with ti.ad.Tape(loss):
        for _ in range(steps):
            smooth(a, b)
            smooth(b, a)
        total()
    return {"loss": loss[None], "a": a.to_numpy(), "gradient": a.grad.to_numpy(),
            "element": np.array(a[n // 2, 1])}  # fmt: skip


def scatter(transport: Any, fp: Any, n: int = 12) -> dict[str, Any]:
    """Additions across borders, minima and maxima, and their gradients."""
    begin(transport, fp)
    x, y = ti.field(fp), ti.field(fp)
    loss, top, low, count = ti.field(fp), ti.field(fp), ti.field(fp), ti.field(ti.i32)
    rows = root(transport, ti.i)
    for field in (x, y):
        rows.dense(ti.i, n).place(field)
    ti.root.place(loss, top, low, count)
    ti.root.lazy_grad()

    @ti.kernel
    def spread():
        for i in range(n - 1):
            y[i + 1] += x[i] * x[i]
            y[i] += 0.5 * x[i]
            if x[i] > 0:
                count[None] += 1

    @ti.kernel
    def measure():
        for i in y:
            loss[None] += y[i] * y[i]

    @ti.kernel
    def extremes():
        for i in x:
            ti.atomic_max(top[None], x[i])
            ti.atomic_min(low[None], x[i])

    x.from_numpy(_noise(n))
    with ti.ad.Tape(loss):
        spread()
        measure()
    extremes()
    return {"loss": loss[None], "y": y.to_numpy(), "gradient": x.grad.to_numpy(),
            "top": top[None], "low": low[None], "count": count[None]}  # fmt: skip


def _blur(transport: Any, reach: int) -> tuple[Any, Any]:
    begin(transport, ti.f32)
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    root(transport, ti.i).dense(ti.i, 12).place(x, y)

    @ti.kernel
    def blur():
        for i in range(2, 10):
            y[i] = x[i - reach] + x[i + reach]

    return x, blur


def different(transport: Any) -> str:
    """Ranks run kernels that reach differently far."""
    _, blur = _blur(transport, 1 + transport.rank)
    try:
        blur()
    except ti.TaiError as error:
        return str(error)
    return "no error"


def _failure(run: Any) -> str:
    try:
        run()
    except ti.TaiError as error:
        return str(error)
    return "no error"


def ending(transport: Any) -> str:
    """Rank 1 ends after the first launch."""
    _, blur = _blur(transport, 1)
    blur()
    if transport.rank == 1:
        os._exit(3)
    return _failure(blur)


def hanging(transport: Any) -> tuple[str, str]:
    """The last rank hangs after the first launch; the others launch again until they fail."""
    x, blur = _blur(transport, 1)
    blur()
    transport.patience = 0.5
    if transport.rank == transport.size - 1:
        transport.hang()
        return "hung", ""
    for _ in range(transport.size):
        message = _failure(blur)
        if message != "no error":
            break
    return message, _failure(x.to_numpy)


def astray(transport: Any) -> str:
    """Rank 1 launches another kernel than the others, all of which have run before."""
    x, blur = _blur(transport, 1)
    y = ti.field(ti.f32)
    ti.root.shard(ti.i).dense(ti.i, 12).place(y)

    @ti.kernel
    def move():
        for i in range(1, 12):
            y[i] = x[i - 1] + x[ti.min(i + 1, 11)]

    blur()
    move()
    transport.patience = 5
    return _failure(move if transport.rank == 1 else blur)


def alone(transport: Any) -> str:
    """Rank 0 reads an element, which all ranks must read."""
    x, blur = _blur(transport, 1)
    blur()
    transport.patience = 0.5
    return _failure((lambda: x[3]) if transport.rank == 0 else blur)


def refused(transport: Any, ranks: int, rows: int) -> str:
    """A mesh of `ranks` ranks that divide a field of `rows` rows."""

    def begin() -> None:
        ti.init(arch=ti.cpu, mesh=ti.mesh("x", ranks, transport))
        ti.root.shard(ti.i).dense(ti.i, rows)

    return _failure(begin)


def versions(transport: Any) -> str:
    """Rank 1 has another name for the mesh, as it could have another version of tai."""
    name = "y" if transport.rank == 1 else "x"
    mesh = ti.mesh(name, transport.size, transport)
    return _failure(lambda: ti.init(arch=ti.cpu, mesh=mesh))


SCENES = {"wave": wave, "heat": heat, "scatter": scatter}


def run(transport: Any, name: str, fp: str) -> dict[str, Any]:
    """The results of a scene."""
    return SCENES[name](transport, getattr(ti, fp))
