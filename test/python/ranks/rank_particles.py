"""Scenes with particles that ranks run in tests, and that one process runs without a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
import tai as ti

from rank_scenes import _failure, begin, mesh_of_program, root


class Scene:
    """Particles with a number each, and their gradients in the order of these numbers."""

    def __init__(self, capacity: int, room: int):
        self.particles = ti.Particles(capacity, room)
        self.ident = ti.field(ti.i32, name="ident")
        self.particles.place(self.ident)

    def set(self, values: dict, places: Any, rows: int) -> None:
        count = len(places)
        self.particles.set({self.ident: np.arange(count), **values}, places, rows)
        self._start = self.particles.live.to_numpy() != 0, self.ident.to_numpy()

    def ordered(self, field: Any) -> np.ndarray:
        """The values of the particles where they are now."""
        order, values = self.particles.take(self.ident, field)
        return values[np.argsort(order)]

    def gradient(self, field: Any) -> np.ndarray:
        """The gradients with respect to the values that were set."""
        live, ident = self._start
        return field.grad.to_numpy()[live][np.argsort(ident[live])]

    def moves(self) -> int:
        """The number of particles on other ranks than at the start."""
        live, ident = self._start
        now = self.particles.live.to_numpy() != 0
        ranks = np.arange(self.particles.ranks)[:, None]
        at = np.empty(live.sum(), np.int64)
        was, at_now = np.empty_like(at), np.empty_like(at)
        was[ident[live]] = np.broadcast_to(ranks, live.shape)[live]
        at_now[self.ident.to_numpy()[now]] = np.broadcast_to(ranks, now.shape)[now]
        return int((was != at_now).sum())


def mpm(transport: Any, fp: Any, **options: Any) -> dict[str, Any]:
    """A fluid of material points that spreads: scatter to a grid, forces there, gather."""
    begin(transport, fp, **options)
    n, count, steps, dt = 24, 150, 10, 4e-3
    scale, weight, stiff = float(n), 1.0, 40.0
    scene = Scene(count, 60)
    live = scene.particles.live
    x, v = (ti.Vector.field(2, fp, needs_grad=True) for _ in range(2))
    C = ti.Matrix.field(2, 2, fp, needs_grad=True)
    J = ti.field(fp, needs_grad=True)
    scene.particles.place(x, v, C, J)
    grid_v = ti.Vector.field(2, fp, needs_grad=True)
    grid_m, loss = ti.field(fp, needs_grad=True), ti.field(fp, needs_grad=True)
    root(transport, ti.i).dense(ti.ij, (n, n)).place(grid_v, grid_v.grad, grid_m, grid_m.grad)
    ti.root.place(loss, loss.grad)

    @ti.kernel
    def clear():
        for i, j in grid_m:
            grid_m[i, j] = 0
            grid_v[i, j] = ti.Vector([0.0, 0.0])

    @ti.kernel
    def scatter():
        ti.loop_config(halo=3)
        for r, s in live:
            if live[r, s] != 0:
                base = ti.cast(ti.floor(x[r, s] * scale - 0.5), ti.i32)
                fx = x[r, s] * scale - base
                w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
                stress = -dt * stiff * (J[r, s] - 1)
                affine = ti.Matrix([[stress, 0.0], [0.0, stress]]) + weight * C[r, s]
                for a, b in ti.static(ti.ndrange(3, 3)):
                    offset = ti.Vector([a, b])
                    dpos = (offset - fx) / scale
                    part = w[a][0] * w[b][1]
                    grid_v[base + offset] += part * (weight * v[r, s] + affine @ dpos)
                    grid_m[base + offset] += part * weight

    @ti.kernel
    def forces():
        for i, j in grid_m:
            if grid_m[i, j] > 1e-6:
                fast = grid_v[i, j] / grid_m[i, j]
                fast[1] -= dt * 2.0
                if i < 3 and fast[0] < 0 or i > n - 4 and fast[0] > 0:
                    fast[0] = 0.0
                if j < 3 and fast[1] < 0 or j > n - 4 and fast[1] > 0:
                    fast[1] = 0.0
                grid_v[i, j] = fast

    @ti.kernel
    def gather():
        ti.loop_config(halo=3)
        for r, s in live:
            if live[r, s] != 0:
                base = ti.cast(ti.floor(x[r, s] * scale - 0.5), ti.i32)
                fx = x[r, s] * scale - base
                w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
                new_v = ti.Vector([0.0, 0.0])
                new_C = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
                for a, b in ti.static(ti.ndrange(3, 3)):
                    offset = ti.Vector([a, b])
                    dpos = (offset - fx) / scale
                    part = w[a][0] * w[b][1]
                    g = grid_v[base + offset]
                    new_v += part * g
                    new_C += 4 * part * g.outer_product(dpos) * scale * scale
                v[r, s] = new_v
                x[r, s] += dt * new_v
                J[r, s] *= 1 + dt * new_C.trace()
                C[r, s] = new_C

    @ti.kernel
    def measure():
        for r, s in live:
            if live[r, s] != 0:
                loss[None] += (x[r, s] ** 2).sum() + 0.1 * v[r, s][0] * J[r, s]

    draw = np.random.default_rng(3)
    start = draw.uniform(0.3, 0.7, (count, 2))
    speed = np.stack([8 * (start[:, 0] - 0.5) + 1, draw.uniform(-1, 1, count)], 1)
    scene.set({x: start, v: speed, C: np.zeros((count, 2, 2)), J: np.ones(count)},
              start[:, 0] * scale, n)  # fmt: skip
    with ti.ad.Tape(loss):
        for step in range(steps):
            clear()
            scatter()
            forces()
            gather()
            if step % 2 == 1:
                scene.particles.migrate(x, n, scale)
        measure()
    return {"loss": loss[None], "x": scene.ordered(x), "v": scene.ordered(v),
            "x gradient": scene.gradient(x), "v gradient": scene.gradient(v),
            "J gradient": scene.gradient(J), "moves": scene.moves()}  # fmt: skip


def sph(transport: Any, fp: Any, **options: Any) -> dict[str, Any]:
    """A gas of particles that repel their neighbours, which lists of cells find."""
    begin(transport, fp, **options)
    n, count, steps, most, dt = 16, 120, 6, 24, 0.1
    scene = Scene(count, 60)
    live = scene.particles.live
    x, v = (ti.Vector.field(2, fp, needs_grad=True) for _ in range(2))
    rho = ti.field(fp, needs_grad=True)
    slot = ti.field(ti.i32)
    scene.particles.place(x, v, rho, slot)
    number = ti.field(ti.i32)
    cell_x, cell_rho = ti.Vector.field(2, fp, needs_grad=True), ti.field(fp, needs_grad=True)
    loss = ti.field(fp, needs_grad=True)
    rows = root(transport, ti.i)
    rows.dense(ti.ij, (n, n)).place(number)
    rows.dense(ti.ijk, (n, n, most)).place(cell_x, cell_x.grad, cell_rho, cell_rho.grad)
    ti.root.place(loss, loss.grad)

    @ti.func
    def cell_of(p):
        return ti.cast(ti.floor(p), ti.i32)

    @ti.kernel
    def clear():
        for i, j in number:
            number[i, j] = 0

    @ti.kernel
    def sort():
        ti.loop_config(halo=0)
        for r, s in live:
            if live[r, s] != 0:
                slot[r, s] = ti.atomic_add(number[cell_of(x[r, s])], 1)

    @ti.kernel
    def fill():
        ti.loop_config(halo=0)
        for r, s in live:
            if live[r, s] != 0:
                i, j = cell_of(x[r, s])
                cell_x[i, j, slot[r, s]] = x[r, s]

    @ti.kernel
    def densities():
        ti.loop_config(halo=1)
        for r, s in live:
            if live[r, s] != 0:
                i, j = cell_of(x[r, s])
                total = 0.0
                for di, dj in ti.static(ti.ndrange((-1, 2), (-1, 2))):
                    for k in range(number[i + di, j + dj]):
                        d = x[r, s] - cell_x[i + di, j + dj, k]
                        q = 1 - d.dot(d)
                        if q > 0:
                            total += q * q * q
                rho[r, s] = total

    @ti.kernel
    def spread():
        ti.loop_config(halo=0)
        for r, s in live:
            if live[r, s] != 0:
                i, j = cell_of(x[r, s])
                cell_rho[i, j, slot[r, s]] = rho[r, s]

    @ti.kernel
    def forces():
        ti.loop_config(halo=1)
        for r, s in live:
            if live[r, s] != 0:
                i, j = cell_of(x[r, s])
                push = ti.Vector([0.0, 0.0])
                for di, dj in ti.static(ti.ndrange((-1, 2), (-1, 2))):
                    for k in range(number[i + di, j + dj]):
                        d = x[r, s] - cell_x[i + di, j + dj, k]
                        q = 1 - d.dot(d)
                        if q > 0:
                            push += (rho[r, s] + cell_rho[i + di, j + dj, k]) * q * q * d
                v[r, s] += dt * 0.3 * push

    @ti.kernel
    def move():
        for r, s in live:
            if live[r, s] != 0:
                x[r, s] += dt * v[r, s]

    @ti.kernel
    def measure():
        for r, s in live:
            if live[r, s] != 0:
                loss[None] += 0.01 * x[r, s].dot(x[r, s]) + v[r, s][0]

    draw = np.random.default_rng(5)
    start = draw.uniform(5, 11, (count, 2))
    speed = draw.uniform(-1, 1, (count, 2))
    scene.set({x: start, v: speed}, start[:, 0], n)
    with ti.ad.Tape(loss):
        for _ in range(steps):
            scene.particles.migrate(x, n)
            clear()
            sort()
            fill()
            densities()
            spread()
            forces()
            move()
        measure()
    return {"loss": loss[None], "x": scene.ordered(x), "v": scene.ordered(v),
            "x gradient": scene.gradient(x), "v gradient": scene.gradient(v),
            "moves": scene.moves()}  # fmt: skip


def everywhere(transport: Any, fp: Any) -> dict[str, Any]:
    """Rows of any rank that data choose, read and added to."""
    begin(transport, fp)
    n = 12
    x, y, z, loss = (ti.field(fp, needs_grad=True) for _ in range(4))
    index = ti.field(ti.i32)
    root(transport, ti.i).dense(ti.i, n).place(x, x.grad, y, y.grad, z, z.grad, index)
    ti.root.place(loss, loss.grad)

    @ti.kernel
    def read():
        ti.loop_config(halo="all")
        for i in y:
            y[i] = x[index[i]] * (i + 1)

    @ti.kernel
    def add():
        ti.loop_config(halo="all")
        for i in y:
            z[index[i]] += y[i] * y[i]

    @ti.kernel
    def measure():
        for i in z:
            loss[None] += z[i] * z[i]

    order = np.random.default_rng(2).integers(0, n, n)
    index.from_numpy(order.astype(np.int32))
    x.from_numpy(np.random.default_rng(4).uniform(-1, 1, n))
    with ti.ad.Tape(loss):
        read()
        add()
        measure()
    return {"loss": loss[None], "y": y.to_numpy(), "gradient": x.grad.to_numpy()}


def too_far(transport: Any) -> list[str]:
    """Errors of particles that do not fit, and of rows that are beyond the halo."""
    begin(transport, ti.f32)
    particles = ti.Particles(6, 2)
    x, grid = ti.field(ti.f32, name="x"), ti.field(ti.f32, name="grid")
    particles.place(x)
    root(transport, ti.i).dense(ti.i, 12).place(grid)
    live = particles.live

    @ti.kernel
    def scatter():
        ti.loop_config(halo=1)
        for r, s in live:
            if live[r, s] != 0:
                grid[ti.cast(x[r, s], ti.i32)] += 1.0

    def start(*places: float) -> None:
        particles.set({x: np.array(places)}, np.array(places), 12)

    def move(by: float) -> None:
        x.from_numpy(x.to_numpy() + np.float32(by))
        particles.migrate(x, 12)

    errors = []
    size = 12 // particles.ranks
    start(*[size - 0.5] * 4)
    errors.append(_failure(lambda: move(1)))
    start(*[size + 0.5] * 5, size - 0.5, size - 0.5)
    x.from_numpy(np.where(x.to_numpy() < size, size + 0.5, x.to_numpy()).astype(np.float32))
    errors.append(_failure(lambda: particles.migrate(x, 12)))
    start(0.5)
    x.fill(size + 1.5)
    errors.append(_failure(scatter))
    return errors


def run(transport: Any, name: str, fp: str, options: dict | None = None) -> dict[str, Any]:
    scene = {"mpm": mpm, "sph": sph, "everywhere": everywhere}[name]
    return scene(transport, getattr(ti, fp), **(options or {}))


def mesh_counts() -> dict[str, int]:
    """The exchanges of the program."""
    return dict(mesh_of_program().counts)
