"""Finds a ripple that, let go now, will be a picture in a moment.

A wave runs over a square of water. Its initial height is found by gradient descent so that
after 256 steps the water shows the yin-yang sign, or a picture of yours.

    python examples/wave.py                     # the paper's 128²
    python examples/wave.py --n 256             # as in its published program
    python examples/wave.py --state compare     # memory: a slot for each step, or updates in place
"""

from pathlib import Path

import numpy as np
import tai as ti

import signs
import studio

parser = studio.options(__doc__, "wave", iterations=200, steps=256, rate=1.0, least_steps=3)
parser.add_argument("--n", type=studio.at_least(2), default=128, help="cells along a side (128)")
parser.add_argument("--target", type=Path, help="a picture (the yin-yang sign)")
studio.add_states(parser)
args = parser.parse_args()
studio.start(args)

N, STEPS = args.n, args.steps
DX = 1 / N
SPEED = 340.0
DT = DX / 3**0.5 / SPEED  # the largest stable step, with a margin
LAST = 0 if args.in_place else STEPS - 1

start = ti.field(float, shape=(N, N), needs_grad=True)  # the height at the start, to be found
u = ti.field(float, shape=(LAST + 1, N, N), needs_grad=True)
change = ti.field(float, shape=(N, N), needs_grad=True)  # in place: the last step's increment
target = ti.field(float, shape=(N, N))
loss = ti.field(float, shape=(), needs_grad=True)


@ti.func
def height(t: int, i: int, j: int):
    """The water's height, and zero outside of the square."""
    return u[t, i, j] if 0 <= i < N and 0 <= j < N else 0.0


@ti.func
def laplacian_step(t: int, i: int, j: int):
    """The increment of a step by the Laplacian, by central differences."""
    neighbours = height(t, i - 1, j) + height(t, i + 1, j)
    neighbours += height(t, i, j - 1) + height(t, i, j + 1)
    return (SPEED * DT / DX) ** 2 * (neighbours - 4 * u[t, i, j])


@ti.kernel
def initialise():
    for i, j in start:
        u[0, i, j] = start[i, j]


@ti.kernel
def step(t: ti.i32):
    """The wave equation in time and space."""
    for i, j in start:
        u[t, i, j] = 2 * u[t - 1, i, j] - u[t - 2, i, j] + laplacian_step(t - 1, i, j)


# The same in place. All updates are linear and add to the state: the reverse sweep needs no values,
# and the tape keeps none.


@ti.kernel
def initialise_in_place():
    """The state in slot 1, where all heights are 0."""
    for i, j in start:
        change[i, j] = -start[i, j]
        u[0, i, j] = 0.0


@ti.kernel
def add_laplacian_in_place():
    for i, j in start:
        change[i, j] += laplacian_step(0, i, j)


@ti.kernel
def integrate_in_place():
    for i, j in start:
        u[0, i, j] += change[i, j]


@ti.kernel
def compute_loss():
    for i, j in target:
        loss[None] += DX**2 * (target[i, j] - u[LAST, i, j]) ** 2


@ti.kernel
def descend(rate: float):
    for i, j in start:
        start[i, j] -= rate * start.grad[i, j]


def simulate():
    """Yields the times when they are reached."""
    if args.in_place:
        initialise_in_place()
    else:
        initialise()
    for t in range(2, STEPS):
        if args.in_place:
            add_laplacian_in_place()
            integrate_in_place()
        else:
            step(t)
        yield t


def iteration(_: int):
    with studio.tape(args, loss):
        for _ in simulate():
            pass
        compute_loss()
    norm = np.linalg.norm(start.grad.to_numpy())
    descend(args.rate)
    return {"loss": loss[None], "|du|": norm}


def film():
    """Pictures of the wave from first to last slot: dark troughs, light crests."""
    heights = [start.to_numpy()]
    for t in simulate():
        if t % 4 == 0 or t == STEPS - 1:
            heights.append(u.to_numpy()[min(t, LAST)])
    scale = np.abs(heights[-1]).max() or 1
    for still in heights:
        colours = studio.shades(still, -scale, scale, (studio.INK, studio.BLUE, studio.PAPER))
        yield (255 * colours.repeat(2, 0).repeat(2, 1)).astype(np.uint8)


def main():
    sign = signs.from_file(args.target, N, centred=True) if args.target else signs.yin_yang(N)
    target.from_numpy(sign if args.target else sign - sign.mean())
    losses = studio.optimise(args, iteration, start=start)
    studio.report_memory(args, u, change)
    studio.plot_losses(args, losses)
    if args.picture:
        studio.movie(args, list(film()))


if __name__ == "__main__":
    main()
