"""Which ripple, let go now, will be a picture in a moment?

A wave runs over a square of water. Its initial height is found by gradient descent so that
after 256 steps the water shows the yin-yang sign.

    python examples/wave.py
    python examples/wave.py --n 256 --iterations 200
"""

import argparse
from pathlib import Path

import numpy as np
import tai as ti

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--n", type=int, default=128, help="cells along a side (128)")
parser.add_argument("--steps", type=int, default=256, help="time slots (256)")
parser.add_argument("--iterations", type=int, default=100, help="steps of descent (100)")
parser.add_argument("--rate", type=float, default=1.0, help="learning rate (1)")
parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the picture")
args = parser.parse_args()

N, STEPS = args.n, args.steps
DX = 1 / N
SPEED = 340.0
DAMPING = 0.0
# The largest stable step, with a margin: (c dt)² = dx²/3 without damping.
DT = ((DAMPING**2 + DX**2 / 3) ** 0.5 - DAMPING) / SPEED

ti.init(arch=ti.cpu)

u = ti.field(ti.f32, shape=(STEPS, N, N), needs_grad=True)
target = ti.field(ti.f32, shape=(N, N))
loss = ti.field(ti.f32, shape=(), needs_grad=True)


@ti.func
def height(t, i, j):
    """The water's height, and zero outside of the square."""
    return u[t, i, j] if 0 <= i < N and 0 <= j < N else 0.0


@ti.func
def laplacian(t, i, j):
    neighbours = height(t, i - 1, j) + height(t, i + 1, j)
    neighbours += height(t, i, j - 1) + height(t, i, j + 1)
    return (neighbours - 4 * u[t, i, j]) / DX**2


@ti.kernel
def step(t: ti.i32):
    """The wave equation in time and space, by central differences."""
    for i, j in ti.ndrange(N, N):
        now = SPEED**2 * DT**2 + SPEED * DAMPING * DT
        before = SPEED * DAMPING * DT
        u[t, i, j] = (
            2 * u[t - 1, i, j]
            + now * laplacian(t - 1, i, j)
            - u[t - 2, i, j]
            - before * laplacian(t - 2, i, j)
        )


@ti.kernel
def compute_loss():
    for i, j in target:
        loss[None] += DX**2 * (target[i, j] - u[STEPS - 1, i, j]) ** 2


@ti.kernel
def descend(rate: ti.f32):
    for i, j in target:
        u[0, i, j] -= rate * u.grad[0, i, j]


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
    for t in range(2, STEPS):
        step(t)
    compute_loss()


def optimise():
    """Gradient descent on the initial height; returns the losses."""
    losses = []
    bar = ti.tools.Progress(range(args.iterations), "wave")
    for _ in bar:
        with ti.ad.Tape(loss):
            forward()
        losses.append(loss[None])
        descend(args.rate)
        bar.note(f"loss {losses[-1]:.4f}")
    return losses


def animate(path):
    """The wave from first to last slot as a GIF, grey for still water."""
    forward()
    heights = u.to_numpy()
    scale = 2 * np.abs(heights[-1]).max()
    frames = []
    for t in [*range(0, STEPS, 4), STEPS - 1]:
        grey = np.clip(heights[t] / scale + 0.5, 0, 1)
        pixels = np.repeat(np.repeat((255 * grey).astype(np.uint8), 2, axis=0), 2, axis=1)
        frames.append(np.stack([pixels] * 3, axis=-1))
    ti.tools.write_gif(frames + frames[-1:] * 30, str(path), framerate=24)


def main():
    sign = yin_yang(N)
    target.from_numpy(sign - sign.mean())
    losses = optimise()
    print(f"loss     {losses[0]:.6f} -> {losses[-1]:.6f}")
    args.out.mkdir(parents=True, exist_ok=True)
    picture = args.out / "wave.gif"
    animate(picture)
    print(f"picture  {picture.resolve()}")


if __name__ == "__main__":
    main()
