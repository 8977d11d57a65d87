"""How must the air be stirred so that a chequered smoke becomes a sign?

A smoke solver in two dimensions: advection by bilinear look-up, then a few Jacobi sweeps
that make the velocity (almost) free of divergence. The unknown is the velocity at the start; its
gradient runs back through a hundred steps.

    python examples/smoke.py                             # 128², 10 sweeps, to the yin-yang sign
    python examples/smoke.py --setting stripes-peace     # as the paper timed it on a CPU
    python examples/smoke.py --setting stripes-yin-yang  # and on a GPU
    python examples/smoke.py --state compare             # memory: a slot for each step, or none
"""

from pathlib import Path
from typing import Any

import numpy as np
import tai as ti

import signs
import studio

SETTINGS = {
    "chequers": {"n": 128, "sweeps": 10, "rate": 400.0, "iterations": 240},
    "stripes-peace": {"n": 110, "sweeps": 6, "rate": 100.0, "iterations": 150},
    "stripes-yin-yang": {"n": 110, "sweeps": 6, "rate": 100.0, "iterations": 150},
}

parser = studio.options(__doc__, "smoke", iterations=240, steps=100, rate=400.0)
parser.add_argument("--n", type=studio.at_least(2), default=128, help="cells along a side (128)")
text = "Jacobi sweeps in a step (10)"
parser.add_argument("--sweeps", type=studio.at_least(1), default=10, help=text)
text = "smoke at the start, and what it should become; sets defaults of other options (chequers)"
parser.add_argument("--setting", choices=SETTINGS, default="chequers", help=text)
parser.add_argument("--target", type=Path, help="a picture (the sign of the setting)")
studio.add_states(parser)
parser.set_defaults(**SETTINGS[parser.parse_args().setting])
args = parser.parse_args()
studio.start(args)

N, STEPS, SWEEPS = args.n, args.steps, args.sweeps
DX = 1 / N

# A slot for each step and each sweep. In place there is one, and values computed from old values of
# the neighbours take turns between two fields.
SLOTS, PRESSURES, TURNS = (1, 1, 2) if args.in_place else (STEPS, STEPS * SWEEPS + 1, 1)


def real_field(slots: int):
    return ti.field(float, shape=(slots, N, N), needs_grad=True)


# The velocity in cells per step, before and after the projection; smoke; pressure by sweep.
velocity = ti.Vector.field(2, float, shape=(SLOTS, N, N), needs_grad=True)
advected = ti.Vector.field(2, float, shape=(SLOTS, N, N), needs_grad=True)
divergence = real_field(SLOTS)
smoke = [real_field(SLOTS) for _ in range(TURNS)]
pressure = [real_field(PRESSURES) for _ in range(TURNS)]
start = ti.Vector.field(2, float, shape=(N, N), needs_grad=True)  # the velocity, to be found
smoke_at_start = ti.field(float, shape=(N, N))
target = ti.field(float, shape=(N, N))
loss = ti.field(float, shape=(), needs_grad=True)


@ti.func
def before(i: int):
    """The cell before, around the edge."""
    return i - 1 if i > 0 else N - 1


@ti.func
def after(i: int):
    return i + 1 if i < N - 1 else 0


@ti.func
def at(t: int):
    """The slot of a step or sweep."""
    return 0 if ti.static(args.in_place) else t


@ti.func
def backtrace(q: ti.template, slot: int, w: Any, i: int, j: int):
    """The quantity q at the former place of the matter that is now in cell (i, j)
    (semi-Lagrangian)."""
    x, y = i - w[0], j - w[1]
    x0, y0 = ti.floor(x), ti.floor(y)
    fx, fy = x - x0, y - y0
    i0, j0 = ti.cast(x0, ti.i32) % N, ti.cast(y0, ti.i32) % N
    i1, j1 = after(i0), after(j0)
    near = (1 - fy) * q[slot, i0, j0] + fy * q[slot, i0, j1]
    far = (1 - fy) * q[slot, i1, j0] + fy * q[slot, i1, j1]
    return (1 - fx) * near + fx * far


@ti.kernel
def begin(density: ti.template):
    for i, j in start:
        velocity[0, i, j] = start[i, j]
        density[0, i, j] = smoke_at_start[i, j]


@ti.kernel
def advect_velocity(t: ti.i32):
    for i, j in ti.ndrange(N, N):
        last, now = at(t - 1), at(t)
        w = velocity[last, i, j]
        advected[now, i, j] = backtrace(velocity, last, w, i, j)


@ti.kernel
def compute_divergence(t: ti.i32):
    for i, j in ti.ndrange(N, N):
        now = at(t)
        along_i = advected[now, after(i), j][0] - advected[now, before(i), j][0]
        along_j = advected[now, i, after(j)][1] - advected[now, i, before(j)][1]
        divergence[now, i, j] = -0.5 * DX * (along_i + along_j)


@ti.kernel
def project(p: ti.template, number: ti.i32, t: ti.i32):
    """Takes the gradient of the pressure out of the velocity."""
    for i, j in ti.ndrange(N, N):
        now, s = at(t), at(number)
        push = ti.Vector(
            [
                p[s, after(i), j] - p[s, before(i), j],
                p[s, i, after(j)] - p[s, i, before(j)],
            ]
        )
        velocity[now, i, j] = advected[now, i, j] - 0.5 * push / DX


@ti.kernel
def sweep(old: ti.template, new: ti.template, number: ti.i32, t: ti.i32):
    """One Jacobi sweep of the pressure equation."""
    for i, j in ti.ndrange(N, N):
        s = at(number)
        around = old[s, before(i), j] + old[s, after(i), j]
        around += old[s, i, before(j)] + old[s, i, after(j)]
        new[at(number + 1), i, j] = (divergence[at(t), i, j] + around) / 4


@ti.kernel
def advect_smoke(old: ti.template, new: ti.template, t: ti.i32):
    for i, j in ti.ndrange(N, N):
        now = at(t)
        w = velocity[now, i, j]
        new[now, i, j] = backtrace(old, at(t - 1), w, i, j)


@ti.kernel
def compute_loss(density: ti.template):
    for i, j in target:
        last = at(STEPS - 1)
        loss[None] += (target[i, j] - density[last, i, j]) ** 2 / N**2


def buffer_of(fields: list[ti.ScalarField], number: int):
    return fields[number % len(fields)]


def simulate():
    """Yields the times when they are reached."""
    begin(smoke[0])
    for field in pressure:
        if args.in_place:
            field.fill(0.0)
    for t in range(1, STEPS):
        advect_velocity(t)
        compute_divergence(t)
        # As in the published program: by the last but one sweep of the step before.
        first = t * SWEEPS
        project(buffer_of(pressure, first - 1), first - 1, t)
        for s in range(first, first + SWEEPS):
            sweep(buffer_of(pressure, s), buffer_of(pressure, s + 1), s, t)
        advect_smoke(buffer_of(smoke, t - 1), buffer_of(smoke, t), t)
        yield t


@ti.kernel
def descend(rate: float):
    for i, j in start:
        start[i, j] -= rate * start.grad[i, j]


def iteration(_: int):
    with studio.tape(args, loss):
        for _ in simulate():
            pass
        compute_loss(buffer_of(smoke, STEPS - 1))
    norm = np.linalg.norm(start.grad.to_numpy())
    descend(args.rate)
    return {"loss": loss[None], "|dv|": norm}


def film():
    """Pictures of the smoke from first to last slot, light where it is dense."""
    slots = [smoke_at_start.to_numpy()]
    for t in simulate():
        if t % 2 == 0 or t == STEPS - 1:
            slots.append(buffer_of(smoke, t).to_numpy()[0 if args.in_place else t])
    for slot in slots:
        colours = studio.shades(slot, 0, 1, (studio.INK, studio.SOFT, studio.PAPER))
        yield (255 * colours.repeat(3, 0).repeat(3, 1)).astype(np.uint8)


def main():
    i: Any
    j: Any
    i, j = np.indices((N, N))
    if args.setting == "chequers":
        tile = max(1, N // 8)
        smoke_at_start.from_numpy((i // tile + j // tile) % 2)
    else:
        smoke_at_start.from_numpy(i * 11 // N % 4 == 1)  # three stripes
    sign = signs.peace if args.setting == "stripes-peace" else signs.yin_yang
    target.from_numpy(signs.from_file(args.target, N) if args.target else sign(N))
    losses = studio.optimise(args, iteration, start=start)
    studio.report_memory(args, velocity, advected, divergence, *smoke, *pressure)
    studio.plot_losses(args, losses)
    if args.picture:
        studio.movie(args, list(film()), framerate=20)


if __name__ == "__main__":
    main()
