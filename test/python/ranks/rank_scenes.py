"""Programs that ranks run in tests, and that one process runs without a mesh."""

from __future__ import annotations

import os
import pickle
from typing import Any

import numpy as np
import tai as ti
from tai._impl.base.program import get_program


def begin(transport: Any, fp: Any, **options: Any) -> None:
    mesh = None
    if transport is not None:
        mesh = ti.mesh("x", transport.size, transport)
    options = {"cpu_max_num_threads": 1, "offline_cache": False, **options}
    ti.init(arch=ti.cpu, default_fp=fp, mesh=mesh, **options)


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
    x, y = ti.field(ti.f32, name="x"), ti.field(ti.f32, name="y")
    root(transport, ti.i).dense(ti.i, 12).place(x, y)

    @ti.kernel
    def blur():
        for i in range(2, 10):
            y[i] = x[i - reach] + x[i + reach]

    def run() -> None:
        x.fill(1)  # The halos are current no longer.
        blur()

    return x, run


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
    transport.patience = 4
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
    x.fill(2)
    transport.patience = 5
    return _failure(move if transport.rank == 1 else blur)


def failing(transport: Any) -> tuple[str, str]:
    """The last loop of a launch fails on rank 1, and no exchange of the launch follows."""
    begin(transport, ti.f32, debug=True)
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    root(transport, ti.i).dense(ti.i, 12).place(x, y)

    @ti.kernel
    def check():
        for i in x:
            assert i < 9, "row nine"
            x[i] = i

    @ti.kernel
    def blur():
        for i in range(1, 11):
            y[i] = x[i - 1] + x[i + 1]

    transport.patience = 20
    return _failure(check), _failure(blur)


def alone(transport: Any) -> str:
    """Rank 0 reads an element, which all ranks must read."""
    x, blur = _blur(transport, 1)
    blur()
    transport.patience = 4
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


def _chain(transport: Any, n: int = 12, **options: Any) -> tuple[Any, Any, Any, Any]:
    """Fields, and a function that adds across borders, reads neighbours, and measures a part."""
    begin(transport, ti.f64, **options)
    x, y, z = (ti.field(ti.f64, needs_grad=True, needs_dual=True) for _ in range(3))
    loss = ti.field(ti.f64, needs_grad=True, needs_dual=True)
    root(transport, ti.i).dense(ti.i, n).place(x, y, z)
    ti.root.place(loss)

    @ti.kernel
    def spread():
        for i in range(n - 1):
            y[i + 1] += x[i] * x[i]
            y[i] += 0.5 * x[i]

    @ti.kernel
    def bend():
        for i in range(n):
            z[i] = y[ti.max(i - 1, 0)] * y[i] + ti.sin(y[ti.min(i + 1, n - 1)])

    @ti.kernel
    def measure():
        for i in range(3, n - 2):
            loss[None] += z[i] ** 2

    def run() -> None:
        y.fill(0)
        loss[None] = 0
        spread()
        bend()
        measure()

    x.from_numpy(_noise(n))
    return x, z, loss, run


def forward(transport: Any, fp: Any) -> dict[str, Any]:
    """Derivatives forward through exchanges, and second derivatives."""
    x, z, loss, run = _chain(transport)
    along = _noise(12)[::-1].copy()
    (first,) = ti.ad.jvp(run, [x], [along], [z])
    (slope,) = ti.ad.jvp(run, [x], [along], [loss])
    (second,) = ti.ad.hvp(run, loss, [x], [along])
    return {"jvp": first, "slope": slope, "hvp": second}


def checked(transport: Any, fp: Any) -> dict[str, Any]:
    """Whether the checks of gradients ran, or the reason why they are refused."""
    x, _, loss, run = _chain(transport)

    def on_tape() -> None:
        with ti.ad.Tape(loss, grad_check=[x]):
            run()

    results: dict[str, Any] = {}
    for name, check in {
        "function": lambda: bool(ti.ad.check(run, loss=loss, wrt=[x])),
        "tape": on_tape,
    }.items():
        try:
            results[name] = check()
        except ti.TaiRuntimeError as error:
            results[name] = str(error)
    return results


def peak(transport: Any, fp: Any, n: int = 12) -> dict[str, Any]:
    """The gradients of a minimum and of a maximum that two ranks attain."""
    begin(transport, fp)
    x, y, top, low = ti.field(fp), ti.field(fp), ti.field(fp), ti.field(fp)
    root(transport, ti.i).dense(ti.i, n).place(x, y)
    ti.root.place(top, low)
    ti.root.lazy_grad()

    @ti.kernel
    def square():
        for i in x:
            y[i] = x[i] * x[ti.max(i - 1, 0)]

    @ti.kernel
    def extremes():
        for i in y:
            ti.atomic_max(top[None], y[i])
            ti.atomic_min(low[None], y[i])

    first = _noise(n)
    first[:2] = first[-2:] = 1.5
    x.from_numpy(first)
    found = {}
    for name, loss in (("top", top), ("low", low)):
        top[None] = low[None] = 0
        with ti.ad.Tape(loss):
            square()
            extremes()
        found |= {name: loss[None], f"{name} gradient": x.grad.to_numpy()}
    return found


def host(transport: Any, fp: Any, n: int = 12) -> dict[str, Any]:
    """Copies, fills, prints and pickles, in a tape as well."""
    begin(transport, fp)
    x, y, v, loss = ti.field(fp), ti.field(fp), ti.Vector.field(2, fp), ti.field(fp)
    rows = root(transport, ti.i)
    for field in (x, y, v):
        rows.dense(ti.i, n).place(field)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def measure():
        for i in range(1, n):
            loss[None] += y[i] * y[i - 1] * v[i - 1][1]

    x.from_numpy(_noise(n))
    v.fill(2)
    v[n - 1] = [1, 3]
    v.get_scalar_field(1).fill(0.5)
    found = {}
    with ti.ad.Tape(loss):
        y.copy_from(x)
        measure()
    found["copied"] = x.grad.to_numpy()
    y.fill(3)
    with ti.ad.Tape(loss):
        y.from_numpy(_noise(n)[::-1].copy())
        measure()
    found |= {"loss": loss[None], "v": v.to_numpy(), "gradient": v.grad.to_numpy()}
    found |= {"text": len(str(y)), "pickled": pickle.loads(pickle.dumps(v)).to_numpy()}
    found |= {"element": np.array(v[n - 1]), "array": np.array(x.to_numpy(ti.f32))}
    return found


def stencil(transport: Any, n: int, threads: int, deterministic: bool) -> dict[str, Any]:
    """The gradient of stencils on n rows of 8 points, with the exchanges of the reverse sweep."""
    begin(transport, ti.f32, cpu_max_num_threads=threads, deterministic=deterministic)
    u, v, w, loss = (ti.field(ti.f32) for _ in range(4))
    root(transport, ti.j).dense(ti.ijk, (3, n, 8)).place(u)
    root(transport, ti.i).dense(ti.ij, (n, 8)).place(v, w)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def step(t: ti.i32):
        for i, j in ti.ndrange((1, n - 1), (1, 7)):
            around = u[t - 1, i - 1, j] + u[t - 1, i + 1, j]
            around += u[t - 1, i, j - 1] + u[t - 1, i, j + 1]
            u[t, i, j] = 0.2 * around - u[t - 2, i, j]

    @ti.kernel
    def bend():
        for i, j in ti.ndrange(n, 8):
            v[i, j] = u[2, i, j] * u[2, ti.max(i - 1, 0), j]

    @ti.kernel
    def meet():
        for i, j in ti.ndrange((0, n - 1), 8):
            w[i, j] = v[i, j] * v[i + 1, j] + v[i, j]

    @ti.kernel
    def measure():
        for i, j in ti.ndrange((n // 2, n), (2, 5)):
            loss[None] += w[i, j] * w[i, j]

    u.from_numpy(_noise(3, n, 8).astype(np.float32))
    mesh = mesh_of_program()
    with ti.ad.Tape(loss):
        step(2)
        bend()
        meet()
        measure()
        before = dict(mesh.counts) if mesh else {}
    after = dict(mesh.counts) if mesh else {}
    made = {key: after[key] - before.get(key, 0) for key in after}
    return {"loss": loss[None], "gradient": u.grad.to_numpy(), "v": v.grad.to_numpy(),
            "made": {key: count for key, count in made.items() if count}}  # fmt: skip


def fixed(transport: Any, threads: int, n: int) -> dict[str, bytes]:
    """The bits of sums and gradients in deterministic mode."""
    begin(transport, ti.f32, deterministic=True, cpu_max_num_threads=threads)
    x, y, c, loss = (ti.field(ti.f32) for _ in range(4))
    for field in (x, y):
        root(transport, ti.i).dense(ti.ij, (n, 7)).place(field)
    ti.root.place(c, loss)
    ti.root.lazy_grad()

    @ti.kernel
    def scale():
        for i, j in x:
            y[i, j] = c[None] * x[ti.max(i - 1, 0), j] + x[i, j]

    @ti.kernel
    def measure():
        for i, j in y:
            loss[None] += y[i, j] * y[i, j] * 0.37

    x.from_numpy(_noise(n, 7).astype(np.float32))
    c[None] = 0.7
    with ti.ad.Tape(loss):
        scale()
        measure()
    found = {"y": y, "x gradient": x.grad, "c gradient": c.grad, "loss": loss}
    return {name: field.to_numpy().tobytes() for name, field in found.items()}


def reuse(transport: Any, fp: Any, n: int = 12) -> dict[str, Any]:
    """Loops that read the same halos: with the exchanges that each launch makes."""
    begin(transport, ti.f64)
    x, y, z = ti.field(ti.f64), ti.field(ti.f64), ti.field(ti.f64)
    u, loss = ti.field(ti.f64, needs_grad=True), ti.field(ti.f64, needs_grad=True)
    rows = root(transport, ti.i)
    for field in (x, y, z):
        rows.dense(ti.i, n).place(field)
    root(transport, ti.j).dense(ti.ij, (4, n)).place(u, u.grad)
    ti.root.place(loss, loss.grad)

    @ti.kernel
    def near(to: ti.template()):
        for i in range(2, n - 2):
            to[i] = x[i - 1] - x[i + 1]

    @ti.kernel
    def far():
        for i in range(2, n - 2):
            z[i] = x[i - 2] * x[i + 2]

    @ti.kernel
    def change():
        for i in x:
            x[i] += 1.0 / (i + 1)

    @ti.kernel
    def march(t: ti.i32):
        for i in range(1, n - 1):
            u[t, i] = u[t - 1, i - 1] + 0.5 * u[t - 1, i + 1]

    @ti.kernel
    def both(t: ti.i32):
        for i in range(1, n):
            loss[None] += u[t, i] * u[t - 1, i - 1]

    steps = []

    def note(name: str, run: Any) -> None:
        before = ti_mesh.counts if ti_mesh else {}
        run()
        after = ti_mesh.counts if ti_mesh else {}
        made = [after.get(key, 0) - before.get(key, 0) for key in ("fetch", "left out")]
        steps.append((name, *made, y.to_numpy().tobytes() + z.to_numpy().tobytes()))

    ti_mesh = mesh_of_program()
    x.from_numpy(_noise(n))
    note("first", lambda: near(y))
    note("same", lambda: near(z))
    note("wider", far)
    note("narrower", lambda: near(y))
    note("change", change)
    note("changed", lambda: near(y))
    x[n // 2] = 5
    note("written", lambda: near(z))
    x.fill(3)
    note("filled", far)
    x.from_numpy(_noise(n)[::-1].copy())
    note("copied", far)
    start = np.zeros((4, n))
    start[0] = _noise(n)
    u.from_numpy(start)
    for _ in range(2):
        with ti.ad.Tape(loss):
            for t in range(1, 4):
                march(t)
            both(3)
            both(3)
    note("step", lambda: both(3))
    note("step again", lambda: both(3))
    note("other step", lambda: march(3))
    return {"steps": steps, "u": u.to_numpy(), "gradient": u.grad.to_numpy()}


def mesh_of_program() -> Any:
    """The mesh of the program, or None."""
    return get_program().options.mesh


SCENES = {"wave": wave, "heat": heat, "scatter": scatter, "forward": forward,
          "peak": peak, "host": host}  # fmt: skip


def run(transport: Any, name: str, fp: str) -> dict[str, Any]:
    """The results of a scene."""
    return SCENES[name](transport, getattr(ti, fp))
