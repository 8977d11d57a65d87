"""Reconstruct a density from pictures of it taken from several sides."""

import argparse
import math

import numpy as np
import tai as ti
from results import report

ti.init(arch=ti.cpu)

density_res = 128
inv_density_res = 1.0 / density_res
res = 64
n_views = 3
num_samples = 120
dx = 0.02

field = ti.field(dtype=ti.f32)
loss = ti.field(dtype=ti.f32)
images = ti.field(dtype=ti.f32)
target_images = ti.field(dtype=ti.f32)


def allocate_fields():
    ti.root.dense(ti.ijk, density_res).place(field)
    ti.root.dense(ti.i, n_views).dense(ti.jk, (res, res)).place(images, target_images)
    ti.root.place(loss)
    ti.root.lazy_grad()


@ti.func
def in_box(p):
    return p.x >= -0.5 and p.x < 0.5 and -0.5 <= p.y < 0.5 and p.z >= -0.5 and p.z < 0.5


@ti.func
def get_voxel(pos):
    # the density is stored as (z, y, x)
    s = pos + ti.Vector([0.5, 0.5, 0.5])
    i = ti.max(ti.min(ti.cast(ti.floor(s[0] * density_res), ti.i32), density_res - 1), 0)
    j = ti.max(ti.min(ti.cast(ti.floor(s[1] * density_res), ti.i32), density_res - 1), 0)
    k = ti.max(ti.min(ti.cast(ti.floor(s[2] * density_res), ti.i32), density_res - 1), 0)
    return k, j, i


@ti.func
def rotate(p, angle):
    c = ti.cos(angle)
    s = ti.sin(angle)
    return ti.Vector([p[0] * c + p[2] * s, p[1], -p[0] * s + p[2] * c])


@ti.kernel
def render(out: ti.template(), angle: ti.f32, view: ti.i32):
    for a, b in ti.ndrange(res, res):
        direction = ti.Vector([a / res * 2.0 - 1.0, b / res * 2.0 - 1.0, -1.0]).normalized()
        direction = rotate(direction, angle)
        origin = ti.Vector([ti.sin(angle), 0.0, ti.cos(angle)])
        for k in range(num_samples):
            p = origin + (k + 1) * dx * direction
            contribution = 0.0
            if in_box(p):
                m, n, l = get_voxel(p)
                contribution = field[m, n, l]
            out[view, b, a] += contribution


@ti.kernel
def compute_loss(view: ti.i32):
    for i, j in ti.ndrange(res, res):
        loss[None] += (images[view, i, j] - target_images[view, i, j]) ** 2 * (1.0 / (res * res))


@ti.kernel
def clear_images():
    for v, i, j in images:
        images[v, i, j] = 0


@ti.kernel
def apply_grad():
    for i, j, k in field:
        field[i, j, k] -= learning_rate * field.grad[i, j, k]
        field[i, j, k] = ti.max(field[i, j, k], 0.0)


@ti.kernel
def load(values: ti.types.ndarray()):
    for i, j, k in field:
        field[i, j, k] = values[i, density_res - 1 - j, k]


learning_rate = 15


def bodies():
    """Three bodies of density 1/128 in a cube, axes (z, y, x)."""
    c = (np.arange(density_res) + 0.5) / density_res - 0.5
    z, y, x = np.meshgrid(c, c, c, indexing="ij")
    inside = x**2 + (1.2 * y) ** 2 + (1.1 * z) ** 2 < 0.08
    inside |= (5 * (x - 0.1)) ** 2 + (2.5 * (y - 0.28)) ** 2 + (5 * z) ** 2 < 0.16
    inside |= (x + 0.1) ** 2 + (y - 0.2) ** 2 + (z - 0.05) ** 2 < 0.02
    return inside.astype(np.float32) / 128


def angle_of(view):
    return math.pi * view / n_views - math.pi / 2


def main():
    global res
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--res", type=int, default=64)
    parser.add_argument("--iterations", type=int, default=3)
    args = parser.parse_args()
    res = args.res
    allocate_fields()
    load(bodies())
    for view in range(n_views):
        render(target_images, angle_of(view), view)
    field.fill(0)
    losses, norms = [], []
    for _ in range(args.iterations):
        clear_images()
        with ti.ad.Tape(loss):
            for view in range(n_views):
                render(images, angle_of(view), view)
                compute_loss(view)
        losses.append(loss[None])
        norms.append(float(np.linalg.norm(field.grad.to_numpy())))
        apply_grad()
    report(losses=losses, norms=norms)


if __name__ == "__main__":
    main()
