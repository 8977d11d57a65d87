"""Aim the cue ball so that another ball ends at a given place."""

import argparse
import math
import os

import numpy as np
import tai as ti
from results import report

real = ti.f32
ti.init(default_fp=real, flatten_if=True)

max_steps = 2048
vis_resolution = 256
dt = 0.003
radius = 0.03
elasticity = 0.8
n_layers = 4
n_balls = 1 + (1 + n_layers) * n_layers // 2
target_ball = n_balls - 1
goal = [0.9, 0.75]

scalar = lambda: ti.field(dtype=real)  # noqa: E731
vec = lambda: ti.Vector.field(2, dtype=real)  # noqa: E731
loss = scalar()
init_x, init_v = vec(), vec()
x, x_inc, v, impulse = vec(), vec(), vec(), vec()

ti.root.dense(ti.i, max_steps).dense(ti.j, n_balls).place(x, v, x_inc, impulse)
ti.root.place(init_x, init_v)
ti.root.place(loss)
ti.root.lazy_grad()


@ti.kernel
def collide(t: ti.i32):
    for i in range(n_balls):
        for j in range(i):
            imp = ti.Vector([0.0, 0.0])
            x_inc_contrib = ti.Vector([0.0, 0.0])
            if i != j:
                dist = (x[t, i] + dt * v[t, i]) - (x[t, j] + dt * v[t, j])
                dist_norm = dist.norm()
                rela_v = v[t, i] - v[t, j]
                if dist_norm < 2 * radius:
                    direction = ti.Vector.normalized(dist, 1e-6)
                    projected_v = direction.dot(rela_v)
                    if projected_v < 0:
                        imp = -(1 + elasticity) * 0.5 * projected_v * direction
                        toi = (dist_norm - 2 * radius) / min(-1e-3, projected_v)
                        x_inc_contrib = min(toi - dt, 0) * imp
            x_inc[t + 1, i] += x_inc_contrib
            impulse[t + 1, i] += imp

    for i in range(n_balls):
        for j in range(i + 1, n_balls):
            imp = ti.Vector([0.0, 0.0])
            x_inc_contrib = ti.Vector([0.0, 0.0])
            if i != j:
                dist = (x[t, i] + dt * v[t, i]) - (x[t, j] + dt * v[t, j])
                dist_norm = dist.norm()
                rela_v = v[t, i] - v[t, j]
                if dist_norm < 2 * radius:
                    direction = ti.Vector.normalized(dist, 1e-6)
                    projected_v = direction.dot(rela_v)
                    if projected_v < 0:
                        imp = -(1 + elasticity) * 0.5 * projected_v * direction
                        toi = (dist_norm - 2 * radius) / min(-1e-3, projected_v)
                        x_inc_contrib = min(toi - dt, 0) * imp
            x_inc[t + 1, i] += x_inc_contrib
            impulse[t + 1, i] += imp


@ti.kernel
def advance(t: ti.i32):
    for i in range(n_balls):
        v[t, i] = v[t - 1, i] + impulse[t, i]
        x[t, i] = x[t - 1, i] + dt * v[t, i] + x_inc[t, i]


@ti.kernel
def compute_loss(t: ti.i32):
    loss[None] = (x[t, target_ball][0] - goal[0]) ** 2 + (x[t, target_ball][1] - goal[1]) ** 2


@ti.kernel
def initialize():
    x[0, 0] = init_x[None]
    v[0, 0] = init_v[None]


@ti.kernel
def clear():
    for t, i in ti.ndrange(max_steps, n_balls):
        impulse[t, i] = ti.Vector([0.0, 0.0])
        x_inc[t, i] = ti.Vector([0.0, 0.0])


def forward(steps, picture=None):
    initialize()
    if picture:
        gui = ti.GUI("Billiards", (vis_resolution, vis_resolution), background_color=0x3C733F)
    interval = 256
    for t in range(1, steps):
        collide(t - 1)
        advance(t)
        if picture and (t + 1) % interval == 0:
            gui.clear()
            gui.circle((goal[0], goal[1]), 0x00000, radius=8)
            for i in range(n_balls):
                color = 0xCCCCCC if i == 0 else (0x3344CC if i == target_ball else 0xF20530)
                gui.circle((x[t, i][0], x[t, i][1]), color, radius=8)
            gui.line(begin=(0, 0), end=(1, 1), color=0x333333, radius=2)
            gui.show(f"{picture}/{t:04d}.png")
    loss[None] = 0
    compute_loss(steps - 1)


def place_balls():
    count = 0
    for i in range(n_layers):
        for j in range(i + 1):
            count += 1
            x[0, count] = [i * 2 * radius + 0.5, j * 2 * radius + 0.5 - i * radius * 0.7]


def optimize(steps, iterations, picture):
    init_x[None] = [0.1, 0.5]
    init_v[None] = [0.3, 0.0]
    clear()
    losses, gradient = [], None
    for iteration in range(iterations):
        clear()
        with ti.ad.Tape(loss):
            forward(steps, picture if iteration == 0 else None)
        losses.append(loss[None])
        if gradient is None:
            gradient = [init_x.grad[None][d] for d in range(2)]
            gradient += [init_v.grad[None][d] for d in range(2)]
        learning_rate = 0.01
        for d in range(2):
            init_x[None][d] -= learning_rate * init_x.grad[None][d]
            init_v[None][d] -= learning_rate * init_v.grad[None][d]
    return losses, gradient, [init_x[None][0], init_x[None][1], init_v[None][0], init_v[None][1]]


def scan(steps, zoom, samples):
    """Losses over the angle of the shot."""
    losses = []
    for m in samples:
        init_x[None] = [0.1, 0.5]
        angle = ((m + 0.5) / 1000 - 0.5) * math.pi * zoom
        init_v[None] = [0.3 * math.cos(angle), 0.3 * math.sin(angle)]
        clear()
        forward(steps)
        losses.append(loss[None])
    return losses


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1024)
    parser.add_argument("--iterations", type=int, default=6)
    parser.add_argument("--picture")
    args = parser.parse_args()
    if args.picture:
        os.makedirs(args.picture, exist_ok=True)
    place_balls()
    losses, gradient, final = optimize(args.steps, args.iterations, args.picture)
    samples = [400, 450, 500, 550, 600]
    report(losses=losses, gradient=gradient, final=final,
           scan=[scan(args.steps, zoom, samples) for zoom in (1.0, 0.23)])  # fmt: skip
    assert np.isfinite(x.to_numpy()).all()


if __name__ == "__main__":
    main()
