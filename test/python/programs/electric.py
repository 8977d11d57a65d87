"""Eight charged electrodes that a network controls drag a ball along a path."""

import argparse
import random

import numpy as np
import tai as ti
from results import report

real = ti.f32
ti.init(default_fp=real, flatten_if=True, device_memory_GB=1.0)

gravitation_position = [[0.1, 0.1], [0.1, 0.9], [0.9, 0.9], [0.9, 0.1],
                        [0.5, 0.9], [0.5, 0.1], [0.1, 0.5], [0.9, 0.5]]  # fmt: skip
max_steps = 512
segments = 2
seg_size = 256
n_gravitation = 8
n_hidden = 64
n_input = 8
damping = 0.2
dt = 0.03
K = 1e-3
lagged = True

scalar = lambda: ti.field(dtype=real)  # noqa: E731
vec = lambda: ti.Vector.field(2, dtype=real)  # noqa: E731
loss = scalar()
x, v = vec(), vec()
goal, goal_v = vec(), vec()
gravitation = scalar()
hidden = scalar()
weight1, bias1 = scalar(), scalar()
weight2, bias2 = scalar(), scalar()


def allocate_fields():
    ti.root.dense(ti.i, max_steps).place(x, v, goal, goal_v)
    ti.root.dense(ti.j, max_steps).dense(ti.l, n_gravitation).place(gravitation)
    ti.root.dense(ti.ij, (max_steps, n_hidden)).place(hidden)
    ti.root.dense(ti.ij, (n_input, n_hidden)).place(weight1)
    ti.root.dense(ti.ij, (n_hidden, n_gravitation)).place(weight2)
    ti.root.dense(ti.i, n_hidden).place(bias1)
    ti.root.dense(ti.i, n_gravitation).place(bias2)
    ti.root.place(loss)
    ti.root.lazy_grad()


@ti.kernel
def nn1(t: ti.i32, source: ti.i32):
    for i in range(n_hidden):
        act = 0.0
        act += (x[source][0] - 0.5) * weight1[0, i]
        act += (x[source][1] - 0.5) * weight1[1, i]
        act += v[source][0] * weight1[2, i]
        act += v[source][1] * weight1[3, i]
        act += (goal[t][0] - 0.5) * weight1[4, i]
        act += (goal[t][1] - 0.5) * weight1[5, i]
        act += (goal_v[t][0] - 0.5) * weight1[6, i]
        act += (goal_v[t][1] - 0.5) * weight1[7, i]
        act += bias1[i]
        hidden[t, i] = ti.tanh(act)


@ti.kernel
def nn2(t: ti.i32):
    for i in range(n_gravitation):
        act = 0.0
        for j in ti.static(range(n_hidden)):
            act += hidden[t, j] * weight2[j, i]
        act += bias2[i]
        gravitation[t, i] = ti.tanh(act)


@ti.kernel
def advance(t: ti.i32):
    for _ in range(1):  # parallelized over nothing
        gravitational_force = ti.Vector([0.0, 0.0])
        for i in ti.static(range(n_gravitation)):
            r = x[t - 1] - ti.Vector(gravitation_position[i])
            len_r = ti.max(r.norm(), 1e-1)
            gravitational_force += K * gravitation[t, i] / (len_r * len_r * len_r) * r
        v[t] = v[t - 1] * ti.exp(-dt * damping) + dt * gravitational_force
        x[t] = x[t - 1] + dt * v[t]


@ti.kernel
def compute_loss(t: ti.i32):
    ti.atomic_add(loss[None], dt * (x[t] - goal[t]).norm_sqr())


def rand():
    return [0.2 + random.random() * 0.6 for _ in range(2)]


def new_path():
    points = [rand() for _ in range(segments + 1)]
    for i in range(segments):
        for j in range(seg_size):
            w = j / seg_size
            k = seg_size * i + j
            if k < max_steps:
                goal[k] = [
                    points[i][0] * (1 - w) + points[i + 1][0] * w,
                    points[i][1] * (1 - w) + points[i + 1][1] * w,
                ]
                goal_v[k] = [points[i + 1][0] - points[i][0], points[i + 1][1] - points[i][1]]
    x[0] = points[0]
    v[0] = [0, 0]


def forward(steps):
    for t in range(1, steps):
        nn1(t, t if lagged else t - 1)
        nn2(t)
        advance(t)
        compute_loss(t)


def main():
    global lagged
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=512)
    parser.add_argument("--iterations", type=int, default=3)
    parser.add_argument("--sane", action="store_true", help="the controller reads slot t - 1")
    args = parser.parse_args()
    lagged = not args.sane
    random.seed(0)
    allocate_fields()
    for _ in range(40):
        random.random()
    for i in range(n_input):
        for j in range(n_hidden):
            weight1[i, j] = (random.random() - 0.5) * 0.3
    for i in range(n_hidden):
        for j in range(n_gravitation):
            weight2[i, j] = (random.random() - 0.5) * 0.3
    new_path()
    forward(args.steps)
    losses, norms = [], []
    for _ in range(args.iterations):
        new_path()
        with ti.ad.Tape(loss):
            forward(args.steps)
        losses.append(loss[None])
        parts = (weight1, weight2, bias1, bias2)
        norms.append([float(np.linalg.norm(part.grad.to_numpy())) for part in parts])
        learning_rate = 2e-2
        for part in parts:
            part.from_numpy(part.to_numpy() - learning_rate * part.grad.to_numpy())
    report(losses=losses, norms=norms)


if __name__ == "__main__":
    main()
