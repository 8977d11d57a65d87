"""The cost of guards of derivatives: forward and backward, with and without them.

A guard keeps an infinite partial derivative away from a zero adjoint: see
docs/reference/derivatives.md.
The compiler was not tuned on these programs: shallow water with ghost cells
behind branches, a lattice Boltzmann flow, elastic triangles, rays through a haze, smoothed
particles, cloth with bending, bodies that attract each other, microfacets under lamps, vortices
with two kinds of cores.

    python benchmarks/micro/guards.py                 # all programs, f64 and one thread
    python benchmarks/micro/guards.py lbm --dtype f32
    python benchmarks/micro/guards.py --code          # instructions of adjoints: no times

One process per measurement, in turns; each prints the least of its sweeps. The ratio is that
of the medians. With --check the exit code says whether all ratios are within the bar, 1.02.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import tai as ti

BAR = 1.02
STEPS = 20


def scalar(real):
    return ti.field(real, shape=(), needs_grad=True)


def trajectory(real, width, *shape):
    """The vectors of all time steps."""
    return ti.Vector.field(width, real, shape=(STEPS + 1, *shape), needs_grad=True)


def start_with(field, state):
    """Sets the first time step, and zero in the others."""
    start = np.zeros((*field.shape, field.n))
    start[0] = state
    field.from_numpy(start)


def steps_of(step, measure):
    """All time steps, and the loss at the end."""

    def run():
        for t in range(STEPS):
            step(t)
        measure()

    return run


def shallow_water(real):
    """Height and momentum on a grid; walls reflect by branches in the flux."""
    n, dt, g = 192, 1e-3, 9.8
    state = trajectory(real, 3, n, n)
    loss = scalar(real)

    @ti.func
    def cell(t, i, j):
        q = ti.Vector([0.0, 0.0, 0.0])
        if i < 0:
            q = state[t, 0, j] * ti.Vector([1.0, -1.0, 1.0])
        elif i >= n:
            q = state[t, n - 1, j] * ti.Vector([1.0, -1.0, 1.0])
        elif j < 0:
            q = state[t, i, 0] * ti.Vector([1.0, 1.0, -1.0])
        elif j >= n:
            q = state[t, i, n - 1] * ti.Vector([1.0, 1.0, -1.0])
        else:
            q = state[t, i, j]
        return q

    @ti.func
    def flux_x(q):
        u = q[1] / q[0]
        return ti.Vector([q[1], q[1] * u + 0.5 * g * q[0] ** 2, q[2] * u])

    @ti.func
    def flux_y(q):
        v = q[2] / q[0]
        return ti.Vector([q[2], q[1] * v, q[2] * v + 0.5 * g * q[0] ** 2])

    @ti.func
    def rusanov_x(a, b):
        speed = ti.max(
            ti.abs(a[1] / a[0]) + ti.sqrt(g * a[0]), ti.abs(b[1] / b[0]) + ti.sqrt(g * b[0])
        )
        return 0.5 * (flux_x(a) + flux_x(b)) - 0.5 * speed * (b - a)

    @ti.func
    def rusanov_y(a, b):
        speed = ti.max(
            ti.abs(a[2] / a[0]) + ti.sqrt(g * a[0]), ti.abs(b[2] / b[0]) + ti.sqrt(g * b[0])
        )
        return 0.5 * (flux_y(a) + flux_y(b)) - 0.5 * speed * (b - a)

    @ti.kernel
    def step(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            q = cell(t, i, j)
            west, east = cell(t, i - 1, j), cell(t, i + 1, j)
            south, north = cell(t, i, j - 1), cell(t, i, j + 1)
            change = rusanov_x(west, q) - rusanov_x(q, east)
            change += rusanov_y(south, q) - rusanov_y(q, north)
            state[t + 1, i, j] = q + dt * n * change

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, n):
            loss[None] += (state[STEPS, i, j][0] - 1.0) ** 2 / (n * n)

    x = (np.arange(n) + 0.5) / n
    bump = np.exp(-80 * ((x[:, None] - 0.4) ** 2 + (x[None, :] - 0.6) ** 2))
    start_with(state, (1 + 0.3 * bump)[..., None] * np.array([1, 0, 0]))

    return steps_of(step, measure), loss, state


def lbm(real):
    """D2Q9 lattice Boltzmann, collision and streaming in one kernel, periodic."""
    n, tau = 160, 0.6
    ex, ey = [0, 1, 0, -1, 0, 1, -1, -1, 1], [0, 0, 1, 0, -1, 1, 1, -1, -1]
    weight = [4 / 9] + [1 / 9] * 4 + [1 / 36] * 4
    f = trajectory(real, 9, n, n)
    loss = scalar(real)

    @ti.kernel
    def step(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            q = ti.Vector([0.0] * 9)
            for k in ti.static(range(9)):
                q[k] = f[t, (i - ex[k] + n) % n, (j - ey[k] + n) % n][k]
            rho, mx, my = 0.0, 0.0, 0.0
            for k in ti.static(range(9)):
                rho += q[k]
                mx += ex[k] * q[k]
                my += ey[k] * q[k]
            ux, uy = mx / rho, my / rho
            out = ti.Vector([0.0] * 9)
            for k in ti.static(range(9)):
                eu = ex[k] * ux + ey[k] * uy
                rest = weight[k] * rho * (1 + 3 * eu + 4.5 * eu**2 - 1.5 * (ux**2 + uy**2))
                out[k] = q[k] - (q[k] - rest) / tau
            f[t + 1, i, j] = out

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, n):
            total = 0.0
            for k in ti.static(range(9)):
                total += ex[k] * f[STEPS, i, j][k]
            loss[None] += total**2

    x = 2 * np.pi * np.arange(n) / n
    rng = np.random.default_rng(0)
    shear = 0.05 * np.sin(x)[None, :, None] * np.array(ex) * 3
    start_with(f, np.array(weight) * (1 + shear) * (1 + 0.01 * rng.random((n, n, 1))))

    return steps_of(step, measure), loss, f


def fem(real):
    """Neo-Hookean triangles: energy, its gradient written by hand, explicit steps."""
    n, dt = 64, 1e-3
    corners, rest = [], []
    for i in range(n):
        for j in range(n):
            a, b, c, d = (
                i * (n + 1) + j,
                (i + 1) * (n + 1) + j,
                (i + 1) * (n + 1) + j + 1,
                i * (n + 1) + j + 1,
            )
            corners += [(a, b, c), (a, c, d)]
    points = np.array([(i / n, j / n) for i in range(n + 1) for j in range(n + 1)])
    corners = np.array(corners, np.int32)
    for a, b, c in corners:
        rest.append(np.linalg.inv(np.stack([points[b] - points[a], points[c] - points[a]], 1)))
    triangles, vertices = len(corners), len(points)
    x = trajectory(real, 2, vertices)
    v = trajectory(real, 2, vertices)
    force = ti.Vector.field(2, real, shape=(STEPS, vertices), needs_grad=True)
    inverse = ti.Matrix.field(2, 2, real, shape=triangles)
    corner = ti.Vector.field(3, ti.i32, shape=triangles)
    loss = scalar(real)

    @ti.kernel
    def forces(t: ti.i32):
        for e in range(triangles):
            a, b, c = corner[e][0], corner[e][1], corner[e][2]
            D = ti.Matrix.cols([x[t, b] - x[t, a], x[t, c] - x[t, a]])
            F = D @ inverse[e]
            J = F.determinant()
            inverse_t = F.inverse().transpose()
            P = 10.0 * (F - inverse_t) + 10.0 * ti.log(J) * inverse_t
            H = -0.5 / (n * n) * P @ inverse[e].transpose()
            fb, fc = ti.Vector([H[0, 0], H[1, 0]]), ti.Vector([H[0, 1], H[1, 1]])
            force[t, b] += fb
            force[t, c] += fc
            force[t, a] -= fb + fc

    @ti.kernel
    def move(t: ti.i32):
        for p in range(vertices):
            v[t + 1, p] = 0.999 * v[t, p] + dt * n * n * force[t, p]
            x[t + 1, p] = x[t, p] + dt * v[t + 1, p]

    @ti.kernel
    def clear():
        for t, p in force:
            force[t, p] = ti.Vector([0.0, 0.0])

    @ti.kernel
    def measure():
        for p in range(vertices):
            loss[None] += x[STEPS, p].norm_sqr() / vertices

    corner.from_numpy(corners)
    inverse.from_numpy(np.array(rest))
    start_with(x, points * [1.2, 0.9])

    def run():
        clear()
        for t in range(STEPS):
            forces(t)
            move(t)
        measure()

    return run, loss, x


def rays(real):
    """Rays through a haze of spheres: transmittance along each, carried over the samples."""
    size, samples, spheres = 128, 48, 5
    center = ti.Vector.field(3, real, shape=spheres, needs_grad=True)
    radius = ti.field(real, shape=spheres, needs_grad=True)
    image = ti.field(real, shape=(size, size), needs_grad=True)
    loss = scalar(real)

    @ti.kernel
    def render():
        for i, j in image:
            way = ti.Vector([(i + 0.5) / size - 0.5, (j + 0.5) / size - 0.5, 1.0]).normalized()
            light, depth = 1.0, 0.0
            for s in range(samples):
                p = way * (0.5 + s * 0.05)
                density = 0.0
                for k in ti.static(range(spheres)):
                    d = (p - center[k]).norm() / radius[k]
                    density += 1.0 / (1.0 + ti.exp(8.0 * (d - 1.0)))
                light *= ti.exp(-0.05 * density)
                depth += light * 0.05
            image[i, j] = depth / ti.sqrt(1.0 + light)

    @ti.kernel
    def measure():
        for i, j in image:
            loss[None] += (image[i, j] - 0.5) ** 2 / (size * size)

    rng = np.random.default_rng(1)
    center.from_numpy(rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 2.0], (spheres, 3)))
    radius.from_numpy(rng.uniform(0.15, 0.3, spheres))

    def run():
        render()
        measure()

    return run, loss, center


def sph(real):
    """Weakly compressible SPH: a cubic kernel over lists of neighbours, Tait pressure."""
    n, most, h = 1600, 24, 0.06
    x = trajectory(real, 2, n)
    v = trajectory(real, 2, n)
    density = ti.field(real, shape=(STEPS, n), needs_grad=True)
    neighbor = ti.field(ti.i32, shape=(n, most))
    count = ti.field(ti.i32, shape=n)
    loss = scalar(real)

    @ti.func
    def cubic(r):
        q = r / h
        w = 0.0
        if q < 0.5:
            w = 6.0 * (q**3 - q**2) + 1.0
        elif q < 1.0:
            w = 2.0 * (1.0 - q) ** 3
        return w * 40.0 / (7.0 * np.pi * h * h)

    @ti.kernel
    def densities(t: ti.i32):
        for i in range(n):
            total = 0.0
            for k in range(count[i]):
                total += cubic((x[t, i] - x[t, neighbor[i, k]]).norm())
            density[t, i] = total / n + 1e-3

    @ti.func
    def pressure(rho):
        return 50.0 * (ti.pow(rho / 1.0, 7.0) - 1.0)

    @ti.kernel
    def move(t: ti.i32):
        for i in range(n):
            a = ti.Vector([0.0, -9.8])
            rho = density[t, i]
            for k in range(count[i]):
                j = neighbor[i, k]
                d = x[t, i] - x[t, j]
                r = d.norm()
                if r > 1e-6:
                    other = density[t, j]
                    shared = pressure(rho) / rho**2 + pressure(other) / other**2
                    slope = ti.max(1.0 - r / h, 0.0)
                    a += 0.01 / n * shared * slope * d / r
                    a += 0.1 / n * (v[t, j] - v[t, i]) / other * slope
            v[t + 1, i] = v[t, i] + 1e-4 * a
            x[t + 1, i] = x[t, i] + 1e-4 * v[t + 1, i]

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += x[STEPS, i].norm_sqr() / n

    side = int(np.sqrt(n))
    rng = np.random.default_rng(2)
    points = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) / side
    points = points + 0.2 / side * rng.random(points.shape)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=-1)
    lists = [np.flatnonzero(row < 1.2 * h)[:most] for row in gaps]
    table = np.zeros((n, most), np.int32)
    for i, found in enumerate(lists):
        table[i, : len(found)] = found
    neighbor.from_numpy(table)
    count.from_numpy(np.array([len(found) for found in lists], np.int32))
    start_with(x, points)

    def run():
        for t in range(STEPS):
            densities(t)
            move(t)
        measure()

    return run, loss, x


def cloth(real):
    """Cloth: springs with rest lengths, and bending by the angle between two triangles."""
    n = 48
    x = trajectory(real, 3, n, n)
    v = trajectory(real, 3, n, n)
    energy = scalar(real)
    loss = scalar(real)

    @ti.kernel
    def step(t: ti.i32):
        for i, j in ti.ndrange(n, n):
            force = ti.Vector([0.0, -9.8, 0.0])
            for k in ti.static(range(4)):
                a, b = i + [1, -1, 0, 0][k], j + [0, 0, 1, -1][k]
                if a >= 0 and a < n and b >= 0 and b < n:
                    d = x[t, a, b] - x[t, i, j]
                    force += 2e3 * (d.norm() - 1.0 / n) * d.normalized()
            v[t + 1, i, j] = (v[t, i, j] + 1e-3 * force) * ti.exp(-1e-3)
            x[t + 1, i, j] = x[t, i, j] + 1e-3 * v[t + 1, i, j]

    @ti.kernel
    def bend():
        for i, j in ti.ndrange((1, n - 1), (1, n - 1)):
            p = x[STEPS, i, j]
            e1, e2 = x[STEPS, i + 1, j] - p, x[STEPS, i, j + 1] - p
            e3, e4 = x[STEPS, i - 1, j] - p, x[STEPS, i, j - 1] - p
            n1, n2 = e1.cross(e2).normalized(), e3.cross(e4).normalized()
            c = ti.min(ti.max(n1.dot(n2), -1.0), 1.0)
            angle = ti.acos(c)
            twist = ti.atan2(n1.cross(n2).norm(), n1.dot(n2))
            energy[None] += angle**2 + 0.1 * twist**2

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, n):
            loss[None] += (x[STEPS, i, j] - ti.Vector([0.5, 0.0, 0.5])).norm() / (n * n)
        loss[None] += 1e-3 * energy[None]

    grid = np.arange(n) / n
    height = 0.05 * np.sin(7 * grid)[:, None] * np.cos(5 * grid)[None, :]
    across, along = np.meshgrid(grid, grid, indexing="ij")
    start_with(x, np.stack([across, height, along], -1))

    def run():
        energy[None] = 0
        for t in range(STEPS):
            step(t)
        bend()
        measure()

    return run, loss, x


def nbody(real):
    """Bodies that attract all others, with softening, and a collision term without one."""
    n = 160
    x = trajectory(real, 3, n)
    v = trajectory(real, 3, n)
    mass = ti.field(real, shape=n, needs_grad=True)
    loss = scalar(real)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            a = ti.Vector([0.0, 0.0, 0.0])
            for j in range(n):
                if i != j:
                    d = x[t, j] - x[t, i]
                    a += mass[j] * d / ti.sqrt(d.norm_sqr() + 1e-4) ** 3
                    a -= 1e-6 * d / d.norm() ** 4
            v[t + 1, i] = v[t, i] + 1e-3 * a
            x[t + 1, i] = x[t, i] + 1e-3 * v[t + 1, i]

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += x[STEPS, i].norm() / n

    rng = np.random.default_rng(3)
    start_with(x, rng.normal(size=(n, 3)))
    mass.from_numpy(rng.uniform(0.5, 1.5, n) / n)

    return steps_of(step, measure), loss, x


def brdf(real):
    """Pixels lit by lamps: microfacets (GGX), Fresnel by a power, tone by a power."""
    size, lamps = 160, 4
    normal = ti.Vector.field(3, real, shape=(size, size), needs_grad=True)
    rough = ti.field(real, shape=(size, size), needs_grad=True)
    base = ti.Vector.field(3, real, shape=(size, size), needs_grad=True)
    lamp = ti.Vector.field(3, real, shape=lamps, needs_grad=True)
    loss = scalar(real)

    @ti.kernel
    def shade():
        for i, j in normal:
            n = normal[i, j].normalized()
            view = ti.Vector([(i + 0.5) / size - 0.5, (j + 0.5) / size - 0.5, -1.0]).normalized()
            color = ti.Vector([0.0, 0.0, 0.0])
            a = rough[i, j] ** 2
            for k in range(lamps):
                to = lamp[k] - ti.Vector([i / size, j / size, 0.0])
                light = to.normalized()
                half = (light - view).normalized()
                nl, nv = ti.max(n.dot(light), 0.0), ti.max(-n.dot(view), 1e-4)
                nh = ti.max(n.dot(half), 0.0)
                d = a**2 / (np.pi * ((nh**2) * (a**2 - 1.0) + 1.0) ** 2)
                g = nl / (nl * (1.0 - a / 2) + a / 2)
                g *= nv / (nv * (1.0 - a / 2) + a / 2)
                f = base[i, j] + (1.0 - base[i, j]) * ti.pow(1.0 - ti.max(half.dot(light), 0.0), 5)
                color += (d * g * f / (4 * nv) + base[i, j] * nl / np.pi) / to.norm_sqr()
            tone = (color / (1.0 + color)) ** (1 / 2.2)
            loss[None] += (tone - 0.4).norm_sqr() / (size * size)

    rng = np.random.default_rng(4)
    bumps = rng.normal(size=(size, size, 3)) * 0.2 + np.array([0.0, 0.0, 1.0])
    normal.from_numpy(bumps)
    rough.from_numpy(rng.uniform(0.2, 0.9, (size, size)))
    base.from_numpy(rng.uniform(0.1, 0.9, (size, size, 3)))
    lamp.from_numpy(rng.uniform([0, 0, 0.5], [1, 1, 1.5], (lamps, 3)))

    def run():
        for _ in range(STEPS // 4):
            shade()

    return run, loss, normal


def vortices(real, has_gaussian_cores=False):
    """Vortices that carry each other along; a quotient has a positive denominator, or none."""
    n = 200
    x = trajectory(real, 2, n)
    strength = ti.field(real, shape=n, needs_grad=True)
    loss = scalar(real)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            u = ti.Vector([0.0, 0.0])
            for j in range(n):
                if i != j:
                    d = x[t, i] - x[t, j]
                    around = strength[j] * ti.Vector([-d[1], d[0]])
                    if ti.static(has_gaussian_cores):
                        u += around * (1.0 - ti.exp(-50.0 * d.norm_sqr())) / d.norm_sqr()
                    else:
                        u += around / (d.norm_sqr() + 1e-3)
            x[t + 1, i] = x[t, i] + 1e-3 * u

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += x[STEPS, i].norm_sqr() / n

    rng = np.random.default_rng(5)
    start_with(x, rng.normal(size=(n, 2)))
    strength.from_numpy(rng.uniform(-1, 1, n))

    return steps_of(step, measure), loss, x


def vortex_blobs(real):
    return vortices(real, has_gaussian_cores=True)


PROGRAMS = {
    "shallow_water": shallow_water,
    "lbm": lbm,
    "fem": fem,
    "rays": rays,
    "sph": sph,
    "cloth": cloth,
    "nbody": nbody,
    "brdf": brdf,
    "vortices": vortices,
    "vortex_blobs": vortex_blobs,
}


def measure_here(name: str, dtype: str, guards: bool, rounds: int) -> dict:
    real = getattr(ti, dtype)
    ti.init(arch=ti.cpu, default_fp=real, ad_guards=guards, cpu_max_num_threads=1)
    run, loss, field = PROGRAMS[name](real)
    times = []
    for _ in range(rounds + 2):
        loss[None] = 0
        begin = time.process_time()
        with ti.ad.Tape(loss):
            run()
        times.append(time.process_time() - begin)
    gradient = field.grad.to_numpy().astype(np.float64)
    return {
        "ms": 1e3 * min(times[2:]),
        "loss": float(loss[None]),
        "norm": float(np.linalg.norm(gradient)),
    }


def count_instructions(name: str, dtype: str, guards: bool) -> tuple[int, int]:
    """Instructions and divisions in the machine code of all adjoints of a program."""
    code = (
        "import sys, guards, tai as ti\n"
        "name, dtype, on = sys.argv[1:]\n"
        "ti.init(default_fp=getattr(ti, dtype), ad_guards=on == 'True', offline_cache=False,\n"
        "        cpu_max_num_threads=1, print_ir='asm')\n"
        "run, loss, _ = guards.PROGRAMS[name](getattr(ti, dtype))\n"
        "with ti.ad.Tape(loss): run()\n"
    )
    command = [sys.executable, "-c", code, name, dtype, str(guards)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=Path(__file__).parent
    )
    parts = re.split(r"// -----// (.*) //----- //\n", done.stdout + done.stderr)
    adjoints = [text for title, text in zip(parts[1::2], parts[2::2], strict=True)
                if "the adjoint of" in title]  # fmt: skip
    lines = [line for text in adjoints for line in text.splitlines() if re.match(r"\t[a-z]", line)]
    return len(lines), sum("div" in line.split("\t")[1] for line in lines)


def compare_code(names: list[str], dtype: str) -> None:
    print(f"{'program':<16}{'guarded':>12}{'bare':>12}{'divisions':>14}")
    for name in names:
        on, off = (count_instructions(name, dtype, guards) for guards in (True, False))
        print(f"{name:<16}{on[0]:>12}{off[0]:>12}{f'{on[1]}, {off[1]}':>14}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("programs", nargs="*", help=f"of {', '.join(PROGRAMS)}; all by default")
    parser.add_argument("--dtype", default="f64", choices=("f32", "f64"))
    parser.add_argument("--processes", type=int, default=3, help="of each kind (3)")
    parser.add_argument("--rounds", type=int, default=10, help="sweeps in a process (10)")
    parser.add_argument("--check", action="store_true", help=f"fail above {BAR} times")
    parser.add_argument("--code", action="store_true", help="count instructions of adjoints")
    parser.add_argument("--one", choices=("on", "off"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    names = args.programs or list(PROGRAMS)
    if unknown := [name for name in names if name not in PROGRAMS]:
        parser.error(f"no program {unknown[0]!r}; there are {', '.join(PROGRAMS)}")
    if args.one:
        print(json.dumps(measure_here(names[0], args.dtype, args.one == "on", args.rounds)))
        return 0
    if args.code:
        compare_code(names, args.dtype)
        return 0
    missed = 0
    print(f"{'program':<16}{'guarded ms':>12}{'bare ms':>12}{'ratio':>8}  gradient norms")
    for name in names:
        found: dict[str, list[dict]] = {"on": [], "off": []}
        for _ in range(args.processes):
            for kind, rows in found.items():
                command = [sys.executable, __file__, name, "--one", kind, "--dtype", args.dtype]
                command += ["--rounds", str(args.rounds)]
                result = subprocess.run(command, capture_output=True, text=True)
                if result.returncode:
                    print(result.stderr, file=sys.stderr)
                    return 2
                rows.append(json.loads(result.stdout.strip().splitlines()[-1]))
        on, off = (statistics.median(row["ms"] for row in found[kind]) for kind in found)
        norms = f"{found['on'][0]['norm']:.9g} {found['off'][0]['norm']:.9g}"
        print(f"{name:<16}{on:>12.2f}{off:>12.2f}{on / off:>8.3f}  {norms}", flush=True)
        missed += on / off > BAR
    return 1 if args.check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
