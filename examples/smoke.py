"""How must the air be stirred so that a chequered smoke becomes a sign?

A smoke solver in two dimensions: advection by bilinear look-up, then a few Jacobi sweeps
that make the wind (almost) free of divergence. The unknown is the wind at the start; its
gradient runs back through a hundred steps.

    python examples/smoke.py
    python examples/smoke.py --iterations 240
"""

import argparse
from pathlib import Path

import numpy as np
import tai as ti

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--n", type=int, default=128, help="cells along a side (128)")
parser.add_argument("--steps", type=int, default=100, help="time slots (100)")
parser.add_argument("--sweeps", type=int, default=10, help="Jacobi sweeps in a step (10)")
parser.add_argument("--iterations", type=int, default=60, help="steps of descent (60)")
parser.add_argument("--rate", type=float, default=400.0, help="learning rate (400)")
parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the picture")
args = parser.parse_args()

N, STEPS, SWEEPS = args.n, args.steps, args.sweeps
DX = 1 / N

ti.init(arch=ti.cpu)

# The wind in cells per step, before and after the projection; smoke; pressure by sweep.
wind = ti.Vector.field(2, ti.f32, shape=(STEPS, N, N), needs_grad=True)
advected = ti.Vector.field(2, ti.f32, shape=(STEPS, N, N), needs_grad=True)
smoke = ti.field(ti.f32, shape=(STEPS, N, N), needs_grad=True)
divergence = ti.field(ti.f32, shape=(STEPS, N, N), needs_grad=True)
pressure = ti.field(ti.f32, shape=(STEPS * SWEEPS + 1, N, N), needs_grad=True)
target = ti.field(ti.f32, shape=(N, N))
loss = ti.field(ti.f32, shape=(), needs_grad=True)


@ti.func
def before(i):
    """The cell before, around the edge."""
    return i - 1 if i > 0 else N - 1


@ti.func
def after(i):
    return i + 1 if i < N - 1 else 0


@ti.func
def carried(q: ti.template(), t, wind_t, i, j):
    """The quantity q at the place from which the wind blew into cell (i, j)."""
    w = wind[wind_t, i, j]
    x, y = float(i) - w[0], float(j) - w[1]
    x0, y0 = ti.floor(x), ti.floor(y)
    fx, fy = x - x0, y - y0
    i0, j0 = ti.cast(x0, ti.i32) % N, ti.cast(y0, ti.i32) % N
    i1, j1 = (i0 + 1) % N, (j0 + 1) % N
    near = (1 - fy) * q[t, i0, j0] + fy * q[t, i0, j1]
    far = (1 - fy) * q[t, i1, j0] + fy * q[t, i1, j1]
    return (1 - fx) * near + fx * far


@ti.kernel
def advect_wind(t: ti.i32):
    for i, j in ti.ndrange(N, N):
        advected[t, i, j] = carried(wind, t - 1, t - 1, i, j)


@ti.kernel
def compute_divergence(t: ti.i32):
    for i, j in ti.ndrange(N, N):
        along_i = advected[t, after(i), j][0] - advected[t, before(i), j][0]
        along_j = advected[t, i, after(j)][1] - advected[t, i, before(j)][1]
        divergence[t, i, j] = -0.5 * DX * (along_i + along_j)


@ti.kernel
def sweep(s: ti.i32, t: ti.i32):
    """One Jacobi sweep of the pressure equation, from slot s to slot s + 1."""
    for i, j in ti.ndrange(N, N):
        around = pressure[s, before(i), j] + pressure[s, after(i), j]
        around += pressure[s, i, before(j)] + pressure[s, i, after(j)]
        pressure[s + 1, i, j] = (divergence[t, i, j] + around) / 4


@ti.kernel
def project(t: ti.i32):
    """Takes the gradient of the pressure (of the step before) out of the wind."""
    for i, j in ti.ndrange(N, N):
        s = t * SWEEPS - 1
        push = ti.Vector(
            [
                pressure[s, after(i), j] - pressure[s, before(i), j],
                pressure[s, i, after(j)] - pressure[s, i, before(j)],
            ]
        )
        wind[t, i, j] = advected[t, i, j] - 0.5 * push / DX


@ti.kernel
def advect_smoke(t: ti.i32):
    for i, j in ti.ndrange(N, N):
        smoke[t, i, j] = carried(smoke, t - 1, t, i, j)


@ti.kernel
def compute_loss():
    for i, j in target:
        loss[None] += (target[i, j] - smoke[STEPS - 1, i, j]) ** 2 / N**2


@ti.kernel
def descend(rate: ti.f32):
    for i, j in target:
        wind[0, i, j] -= rate * wind.grad[0, i, j]


def yin_yang(n):
    """The sign, white 1 and black 0, drawn by its circles; rows run downward."""
    row, col = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    x, y = (col + 0.5) / n - 0.5, (row + 0.5) / n - 0.5
    upper, lower = x**2 + (y + 0.235) ** 2, x**2 + (y - 0.235) ** 2
    radius = x**2 + y**2
    rules = [
        (radius > 0.5**2, 1),
        (radius >= 0.47**2, 0),
        (upper < 0.07**2, 0),
        (lower < 0.07**2, 1),
        (upper < 0.235**2, 1),
        (lower < 0.235**2, 0),
        (x > 0, 0),
    ]
    return np.select([rule for rule, _ in rules], [value for _, value in rules], 1).astype(float)


def forward():
    loss[None] = 0.0
    for t in range(1, STEPS):
        advect_wind(t)
        compute_divergence(t)
        for s in range(t * SWEEPS, (t + 1) * SWEEPS):
            sweep(s, t)
        project(t)
        advect_smoke(t)
    compute_loss()


def optimise():
    """Gradient descent on the wind at the start; returns the losses."""
    losses = []
    bar = ti.tools.Progress(range(args.iterations), "smoke")
    for _ in bar:
        with ti.ad.Tape(loss):
            forward()
        losses.append(loss[None])
        descend(args.rate)
        bar.note(f"loss {losses[-1]:.4f}")
    return losses


def animate(path):
    """The smoke from first to last slot as a GIF."""
    forward()
    slots = np.clip(smoke.to_numpy(), 0, 1)
    frames = []
    for t in [*range(0, STEPS, 2), STEPS - 1]:
        pixels = np.repeat(np.repeat((255 * slots[t]).astype(np.uint8), 3, axis=0), 3, axis=1)
        frames.append(np.stack([pixels] * 3, axis=-1))
    ti.tools.write_gif(frames + frames[-1:] * 20, str(path), framerate=20)


def main():
    tile = max(1, N // 8)
    i, j = np.meshgrid(np.arange(N) // tile, np.arange(N) // tile, indexing="ij")
    start = np.zeros((STEPS, N, N), np.float32)
    start[0] = (i + j) % 2
    smoke.from_numpy(start)
    target.from_numpy(yin_yang(N))
    losses = optimise()
    print(f"loss     {losses[0]:.6f} -> {losses[-1]:.6f}")
    args.out.mkdir(parents=True, exist_ok=True)
    picture = args.out / "smoke.gif"
    animate(picture)
    print(f"picture  {picture.resolve()}")


if __name__ == "__main__":
    main()
