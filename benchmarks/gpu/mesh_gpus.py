"""Programs on several GPUs: their results against those of one GPU, and their times.

    torchrun --standalone --nproc-per-node 2 benchmarks/gpu/mesh_gpus.py

Each process first runs scenes of test/python/ranks alone and then together with the others. Then
it times a wave, a smoke solver and material points, forward and backward: on one GPU, with the same
size on all GPUs (strong scaling), and with as many rows for each GPU as one has alone (weak
scaling). "host" is the time until the forward run is queued. The part `jax` runs the wave and the
smoke of mesh_jax.py on the same GPUs.
"""

import argparse
import gc
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

RANK, WORLD = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--arch", default="cuda", choices=["cuda", "cpu", "emulated"])
parser.add_argument("--only", default="tests,wave,smoke,mpm", help="the parts to run")
parser.add_argument("--wave", type=int, default=16384, help="rows of the wave (16384)")
parser.add_argument("--smoke", type=int, default=8192, help="rows of the smoke (8192)")
parser.add_argument("--particles", type=int, default=1 << 24, help="material points (16777216)")
parser.add_argument("--steps", type=int, default=8, help="time steps (8)")
parser.add_argument("--repeat", type=int, default=5, help="timed runs (5)")
args = parser.parse_args()
ALL_GPUS = os.environ.get("CUDA_VISIBLE_DEVICES")
os.environ["TI_ARCH"] = "cpu" if args.arch == "cpu" else "cuda"
if args.arch == "emulated":
    os.environ["TAI_CUDA_EMULATION"] = "1"
elif args.arch == "cuda" and "LOCAL_RANK" in os.environ:
    # Before anything opens CUDA.
    listed = (ALL_GPUS or "").split(",")
    local = int(os.environ["LOCAL_RANK"])
    os.environ["CUDA_VISIBLE_DEVICES"] = listed[local] if len(listed) > 1 else str(local)

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "test/python/ranks"))

import numpy as np  # noqa: E402
import tai as ti  # noqa: E402
from tai._impl.base import torch_ranks  # noqa: E402

import rank_particles  # noqa: E402
import rank_scenes  # noqa: E402

TRANSPORT = torch_ranks.connect("gpus", WORLD, 300, args.arch == "cuda")


def say(text: str) -> None:
    if RANK == 0:
        print(text, flush=True)


def start(together: bool) -> None:
    """Begins a program on all GPUs, or one on each."""
    mesh = ti.mesh("x", WORLD, TRANSPORT, timeout=300) if together else None
    ti.init(arch=ti.cuda, mesh=mesh, offline_cache=True)


def rows(together: bool, axis: Any) -> Any:
    return ti.root.shard(axis) if together else ti.root


def test() -> int:
    """Compares scenes; the number of those that differ."""
    bad = 0
    names = [(rank_scenes, n) for n in ("wave", "heat", "scatter", "peak", "host")]
    names += [(rank_particles, n) for n in ("mpm", "sph", "everywhere")]
    for module, name in names:
        for fp in ("f32", "f64"):
            whole = module.run(None, name, fp)
            try:
                found = module.run(TRANSPORT, name, fp)
            except ti.TaiError as error:
                say(f"{name} {fp}: FAILED: {error}")
                bad += 1
                continue
            error = 0.0
            for key, value in whole.items():
                if key != "moves":
                    scale = max(1.0, np.abs(value).max())
                    difference = np.abs(np.asarray(found[key], np.float64) - value).max()
                    error = max(error, float(difference / scale))
            # Sums in another order: particles of one rank, and halos.
            good = error <= (1e-11 if fp == "f64" else 5e-6)
            bad += not good
            say(f"{name} {fp}: largest difference {error:.2g}{'' if good else '  TOO LARGE'}")
    n = 12012
    bits = rank_scenes.fixed(None, 1, n)
    equal = bits == rank_scenes.fixed(TRANSPORT, 1, n)
    say(f"deterministic mode: the bits are {'those of one GPU' if equal else 'DIFFERENT'}")
    return bad + (not equal)


def wave(together: bool, n: int, m: int) -> Callable[[], tuple[float, float, float]]:
    """A wave on n×m points, of which all steps are kept."""
    steps = args.steps
    start(together)
    u, loss = ti.field(ti.f32), ti.field(ti.f32)
    rows(together, ti.j).dense(ti.ijk, (steps + 2, n, m)).place(u)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def fill():
        for i, j in ti.ndrange(n, m):
            u[0, i, j] = ti.exp(-1e-4 * ((i - n / 2) ** 2 + (j - m / 2) ** 2))
            u[1, i, j] = u[0, i, j]

    @ti.kernel
    def step(t: ti.i32):
        for i, j in ti.ndrange((1, n - 1), (1, m - 1)):
            around = u[t - 1, i - 1, j] + u[t - 1, i + 1, j]
            around += u[t - 1, i, j - 1] + u[t - 1, i, j + 1]
            here = u[t - 1, i, j]
            u[t, i, j] = 2 * here - u[t - 2, i, j] + 0.2 * (around - 4 * here)

    @ti.kernel
    def measure():
        for i, j in ti.ndrange(n, m):
            loss[None] += u[steps + 1, i, j] ** 2

    fill()

    def run() -> None:
        for t in range(2, steps + 2):
            step(t)
        measure()

    return timed(loss, run)


def smoke(together: bool, n: int, m: int) -> Callable[[], tuple[float, float, float]]:
    """Smoke on n×m cells: advection up to 4 rows, 10 steps of Jacobi for the pressure."""
    start(together)
    reach = 4
    v, w = (ti.Vector.field(2, ti.f32) for _ in range(2))
    p, q, div, dye, ink = (ti.field(ti.f32) for _ in range(5))
    loss = ti.field(ti.f32)
    # A tree for each field, as arrays are: in one tree, their elements would be interleaved, and a
    # step for the pressure would load all of them.
    for field in (v, w, p, q, div, dye, ink):
        rows(together, ti.i).dense(ti.ij, (n, m)).place(field)
    ti.root.place(loss)
    ti.root.lazy_grad()

    @ti.kernel
    def fill():
        for i, j in v:
            v[i, j] = ti.Vector([ti.sin(j * 0.01), ti.cos(i * 0.01)])
            dye[i, j] = ti.sin(i * 0.02) * ti.cos(j * 0.02)

    @ti.func
    def sample(f, i, j, d):
        x = ti.max(0.0, ti.min(i - ti.max(-3.0, ti.min(d[0], 3.0)), n - 1.001))
        y = ti.max(0.0, ti.min(j - ti.max(-3.0, ti.min(d[1], 3.0)), m - 1.001))
        a, b = ti.cast(ti.floor(x), ti.i32), ti.cast(ti.floor(y), ti.i32)
        s, t = x - a, y - b
        low = f[a, b] * (1 - t) + f[a, b + 1] * t
        high = f[a + 1, b] * (1 - t) + f[a + 1, b + 1] * t
        return low * (1 - s) + high * s

    @ti.kernel
    def advect():
        ti.loop_config(halo=reach)
        for i, j in v:
            w[i, j] = sample(v, i, j, v[i, j])
            ink[i, j] = sample(dye, i, j, v[i, j])

    @ti.kernel
    def diverge():
        for i, j in ti.ndrange((1, n - 1), (1, m - 1)):
            d = w[i + 1, j][0] - w[i - 1, j][0] + w[i, j + 1][1] - w[i, j - 1][1]
            div[i, j] = 0.5 * d
            p[i, j] = 0.0

    @ti.kernel
    def relax(a: ti.template(), b: ti.template()):
        for i, j in ti.ndrange((1, n - 1), (1, m - 1)):
            b[i, j] = 0.25 * (a[i - 1, j] + a[i + 1, j] + a[i, j - 1] + a[i, j + 1] - div[i, j])

    @ti.kernel
    def project():
        for i, j in ti.ndrange((1, n - 1), (1, m - 1)):
            slope = ti.Vector([p[i + 1, j] - p[i - 1, j], p[i, j + 1] - p[i, j - 1]])
            v[i, j] = w[i, j] - 0.5 * slope
            dye[i, j] = ink[i, j]

    @ti.kernel
    def measure():
        for i, j in dye:
            loss[None] += dye[i, j] ** 2

    fill()

    def run() -> None:
        for _ in range(args.steps):
            advect()
            diverge()
            for _ in range(5):
                relax(p, q)
                relax(q, p)
            project()
        measure()

    return timed(loss, run)


def mpm(together: bool, n: int, count: int) -> Callable[[], tuple[float, float, float]]:
    """`count` material points on a grid of n×n cells, 8 to a cell."""
    start(together)
    m = max(64, count // (8 * n))
    ranks = WORLD if together else 1
    particles = ti.Particles(count // ranks + count // 256 + 4096, max(4096, count // 64))
    x, v = (ti.Vector.field(2, ti.f32, needs_grad=True) for _ in range(2))
    C, J = ti.Matrix.field(2, 2, ti.f32, needs_grad=True), ti.field(ti.f32, needs_grad=True)
    particles.place(x, v, C, J)
    grid_v, grid_m = ti.Vector.field(2, ti.f32), ti.field(ti.f32)
    loss = ti.field(ti.f32)
    rows(together, ti.i).dense(ti.ij, (n, m)).place(grid_v, grid_m)
    ti.root.place(loss)
    ti.root.lazy_grad()
    live, dt = particles.live, 1e-3

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
                base = ti.cast(ti.floor(x[r, s] - 0.5), ti.i32)
                fx = x[r, s] - base
                w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
                stress = -dt * 10 * (J[r, s] - 1)
                affine = ti.Matrix([[stress, 0.0], [0.0, stress]]) + C[r, s]
                for a, b in ti.static(ti.ndrange(3, 3)):
                    offset = ti.Vector([a, b])
                    part = w[a][0] * w[b][1]
                    grid_v[base + offset] += part * (v[r, s] + affine @ (offset - fx))
                    grid_m[base + offset] += part

    @ti.kernel
    def forces():
        for i, j in grid_m:
            if grid_m[i, j] > 1e-6:
                fast = grid_v[i, j] / grid_m[i, j]
                if i < 3 or i > n - 4:
                    fast[0] = 0.0
                if j < 3 or j > m - 4:
                    fast[1] = 0.0
                grid_v[i, j] = fast

    @ti.kernel
    def gather():
        ti.loop_config(halo=3)
        for r, s in live:
            if live[r, s] != 0:
                base = ti.cast(ti.floor(x[r, s] - 0.5), ti.i32)
                fx = x[r, s] - base
                w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
                new_v = ti.Vector([0.0, 0.0])
                new_C = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
                for a, b in ti.static(ti.ndrange(3, 3)):
                    offset = ti.Vector([a, b])
                    g = w[a][0] * w[b][1] * grid_v[base + offset]
                    new_v += g
                    new_C += 4 * g.outer_product(offset - fx)
                v[r, s] = new_v
                x[r, s] += dt * new_v
                J[r, s] *= 1 + dt * new_C.trace()
                C[r, s] = new_C

    @ti.kernel
    def measure():
        for r, s in live:
            if live[r, s] != 0:
                loss[None] += x[r, s].dot(x[r, s]) + J[r, s]

    draw = np.random.default_rng(1)
    at = (3 + draw.random((count, 2), np.float32) * [n - 7, m - 7]).astype(np.float32)
    speed = np.stack([np.sin(0.1 * at[:, 1]), np.cos(0.1 * at[:, 0])], 1)
    particles.set({x: at, v: speed, C: np.zeros((count, 2, 2), np.float32),
                   J: np.ones(count, np.float32)}, at[:, 0], n)  # fmt: skip

    def run() -> None:
        for step in range(args.steps):
            clear()
            scatter()
            forces()
            gather()
            if step % 4 == 3:
                particles.migrate(x, n)
        measure()

    return timed(loss, run)


def timed(loss: Any, run: Callable[[], None]) -> Callable[[], tuple[float, float, float]]:
    """A function that returns the seconds of a run: forward, backward, and queueing forward."""

    def once() -> tuple[float, float, float]:
        TRANSPORT.all_gather(np.zeros(1))
        loss[None] = 0
        loss.grad[None] = 1
        begin = time.perf_counter()
        tape = ti.ad.Tape(loss)
        tape.__enter__()
        run()
        queued = time.perf_counter()
        ti.sync()
        middle = time.perf_counter()
        tape.__exit__(None, None, None)
        ti.sync()
        return middle - begin, time.perf_counter() - middle, queued - begin

    def measured() -> tuple[float, float, float]:
        once()
        found = [once() for _ in range(args.repeat)]
        ways = [statistics.median(way) for way in zip(*found, strict=True)]
        # The slowest rank.
        most = np.array(ways)
        TRANSPORT.all_reduce(most, "max")
        return float(most[0]), float(most[1]), float(most[2])

    return measured


def time_scene(name: str, make: Callable, size: tuple[int, int], weak: tuple[int, int]) -> None:
    """Times a scene alone, on all GPUs, and on all GPUs with WORLD times as much work."""
    found = {}
    for label, together, shape in (
        ("one", False, size), ("strong", True, size), ("weak", True, weak)
    ):  # fmt: skip
        try:
            found[label] = make(together, *shape)()
        except ti.TaiError as error:
            say(f"{name} {label}: FAILED: {error}")
            return
        counts = rank_particles.mesh_counts() if together else ""
        say(f"{name} {label} {shape}: forward {1e3 * found[label][0]:.2f} ms, "
            f"backward {1e3 * found[label][1]:.2f} ms, host {1e3 * found[label][2]:.2f} ms "
            f"{counts}")  # fmt: skip
        ti.reset()
        gc.collect()
    one, strong, weak_time = (sum(found[key][:2]) for key in ("one", "strong", "weak"))
    say(f"{name}: strong scaling {one / (WORLD * strong):.1%}, weak {one / weak_time:.1%}")


def run_jax() -> None:
    """Runs the same scenes in JAX, one process with all GPUs, while the other ranks wait."""
    if RANK == 0:
        environment = dict(os.environ)
        if args.arch == "cuda":
            environment.pop("CUDA_VISIBLE_DEVICES", None)
            if ALL_GPUS is not None:
                environment["CUDA_VISIBLE_DEVICES"] = ALL_GPUS
        command = [sys.executable, str(Path(__file__).with_name("mesh_jax.py"))]
        for name in ("wave", "smoke", "steps", "repeat"):
            command += [f"--{name}", str(getattr(args, name))]
        command += ["--devices", str(WORLD), *(["--cpu"] if args.arch != "cuda" else [])]
        done = subprocess.run(command, env=environment, timeout=280, check=False)
        say(f"jax ended with {done.returncode}" if done.returncode else "jax done")
    TRANSPORT.all_gather(np.zeros(1))


def main() -> None:
    parts = args.only.split(",")
    bad = test() if "tests" in parts else 0
    if "wave" in parts:
        n = args.wave
        time_scene("wave", wave, (n, n), (n * WORLD, n))
    if "smoke" in parts:
        n = args.smoke
        time_scene("smoke", smoke, (n, n), (n * WORLD, n))
    if "mpm" in parts:
        n = 16 * max(16, int((args.particles / 8) ** 0.5) // 16)
        time_scene("mpm", mpm, (n, args.particles), (n * WORLD, args.particles * WORLD))
    if "jax" in parts:
        run_jax()
    say("done" if not bad else f"{bad} scenes differ")
    ti.reset()
    torch_ranks.dist.barrier()
    torch_ranks.dist.destroy_process_group()
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
