"""Finds the body that casts given shadows. A density is found from pictures of it.

Rays pass through a unit box of voxels and add up the density on their way; seven cameras stand
around it. The unknown is the density of each of two million voxels: gradient descent makes its
pictures equal to those of the true body.

    python examples/volume_renderer.py --n 64 --res 128 --samples 120 --views 5
    python examples/volume_renderer.py                     # the paper's 128³, 7 views of 512²
    python examples/volume_renderer.py --volume bunny.raw  # a file of n³ f32 numbers, or .npy
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import tai as ti

import studio

parser = studio.options(
    __doc__, "volume_renderer", iterations=100, rate=15.0,
    quick={"res": 64, "views": 3, "iterations": 10},
)  # fmt: skip
parser.add_argument("--n", type=studio.at_least(2), default=128, help="voxels along a side (128)")
parser.add_argument("--res", type=studio.at_least(2), default=512, help="pixels along a side (512)")
parser.add_argument("--views", type=studio.at_least(1), default=7, help="cameras (7)")
text = "steps of 0.02 along a ray (1000; after some 90 it has left the box)"
parser.add_argument("--samples", type=studio.at_least(1), default=1000, help=text)
parser.add_argument("--torus", action="store_true", help="a ring instead of three ellipsoids")
parser.add_argument("--volume", type=Path, help="a body from a file instead")
args = parser.parse_args()
studio.start(args)

N, RES, SAMPLES = args.n, args.res, args.samples
VIEWS: int = args.views
STEP = 0.02

density = ti.field(float, shape=(N, N, N), needs_grad=True)
image = ti.field(float, shape=(VIEWS, RES, RES), needs_grad=True)
target = ti.field(float, shape=(VIEWS, RES, RES))
loss = ti.field(float, shape=(), needs_grad=True)


@ti.func
def ray(view: int, column: int, row: int):
    """Where a pixel's ray begins, and its direction of length 1; (x, y, z)."""
    angle = math.pi / VIEWS * view - math.pi / 2
    c, s = ti.cos(angle), ti.sin(angle)
    way = ti.Vector([2.0 * column / RES - 1, 2.0 * row / RES - 1, -1.0]).normalized()
    turned = ti.Vector([way[0] * c + way[2] * s, way[1], way[2] * c - way[0] * s])
    return ti.Vector([s, 0.0, c]), turned


@ti.kernel
def render():
    """Each pixel is the sum of the densities along its ray."""
    for view, row, column in image:
        origin, way = ray(view, column, row)
        # The box lies in a ball of radius √3/2; outside of it there is nothing to add.
        middle = -origin.dot(way)
        half = ti.sqrt(ti.max(0.75 - origin.norm_sqr() + middle**2, 0.0))
        first, last = int((middle - half) / STEP) - 1, int((middle + half) / STEP) + 1
        total = 0.0
        for k in range(ti.max(first, 0), ti.min(last, SAMPLES)):
            place = origin + (k + 1) * STEP * way + 0.5
            if 0 <= place.min() and place.max() < 1:
                voxel = ti.math.clamp(ti.cast(ti.floor(place * N), ti.i32), 0, N - 1)
                total += density[voxel[2], voxel[1], voxel[0]]
        image[view, row, column] = total


@ti.kernel
def compute_loss():
    for pixel in ti.grouped(image):
        loss[None] += (image[pixel] - target[pixel]) ** 2 / RES**2


@ti.kernel
def descend(rate: float):
    """Down the gradient; no density is negative."""
    for voxel in ti.grouped(density):
        density[voxel] = ti.max(density[voxel] - rate * density.grad[voxel], 0.0)


def read_volume(path: Path):
    try:
        body = np.load(path) if path.suffix == ".npy" else np.fromfile(path, np.float32)
        return body.reshape(N, N, N)[:, ::-1].astype(np.float32)
    except (OSError, ValueError) as error:
        studio.fail(f"--volume {path}: not {N}³ numbers ({error})")


def make_volume() -> Any:
    """The body to be found, with axes (z, y, x)."""
    if args.volume:
        return read_volume(args.volume)
    if args.torus:  # as the published program has it: no half cell, the axis along x
        z, y, x = np.indices((N, N, N)) / N - 0.5
        return (((np.hypot(y, z) - 0.4) ** 2 + x**2 < 0.1**2) / 128).astype(np.float32)
    z, y, x = (np.indices((N, N, N)) + 0.5) / N - 0.5
    body = x**2 + (1.2 * y) ** 2 + (1.1 * z) ** 2 < 0.08
    body |= (5 * (x - 0.1)) ** 2 + (2.5 * (y - 0.28)) ** 2 + (5 * z) ** 2 < 0.16
    body |= (x + 0.1) ** 2 + (y - 0.2) ** 2 + (z - 0.05) ** 2 < 0.02
    return (body[:, ::-1] / 128).astype(np.float32)


def optimise():
    def iteration(_: int):
        with ti.ad.Tape(loss):
            render()
            compute_loss()
        norm = np.linalg.norm(density.grad.to_numpy())
        descend(args.rate)
        return {"loss": loss[None], "|d density|": norm}

    return studio.optimise(args, iteration, density=density)


def compare():
    """The pictures of the true body, and below them those of the one that was found."""
    render()
    found, true = image.to_numpy(), target.to_numpy()
    shown = sorted({round(k * (VIEWS - 1) / 3) for k in range(4)})
    middle = slice(RES // 5, RES - RES // 5)
    rows = [np.hstack(list(views[shown, middle, middle][:, ::-1])) for views in (true, found)]
    studio.picture(args, studio.shades(np.vstack(rows), 0, true.max() or 1))


def main():
    density.from_numpy(make_volume())
    render()
    target.copy_from(image)
    density.fill(0.0)
    losses = optimise()
    studio.plot_losses(args, losses, log=True)
    compare()


if __name__ == "__main__":
    main()
