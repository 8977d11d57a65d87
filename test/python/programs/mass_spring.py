"""Robots of springs that a small neural network actuates; their gait is optimised."""

import argparse

import numpy as np
import tai as ti
from results import report

real = ti.f32
ti.init(default_fp=real, arch=ti.cpu, flatten_if=True)

max_steps = 4096
dt = 0.004
spring_omega = 10
damping = 15
gravity = -4.8
ground_height = 0.1
n_sin_waves = 10
n_hidden = 32

# Indices of points, and whether a spring is active, in the order of its outputs.
robot1_springs = (
    "0-1 0-2 1-2 3-4 3-5 4-5 4-6* 5-7* 4-7 6-5 6-7 6-8 7-9 6-9 8-7 8-9 10-11 7-10 7-11 9-10 "
    "9-11 1-10* 2-12* 1-12 10-2 10-12 12-13 10-13 11-12 11-13"
)
robot2_springs = (
    "0-1* 2-3* 0-2 0-3 1-2 1-3 4-5* 6-7* 4-6 4-7 5-6 5-7 5-8* 7-9* 5-9 8-7 8-9 8-10 9-11 8-11 "
    "10-9 10-11 12-13 9-12 9-13 11-12 11-13 1-12* 3-14* 1-14 12-3 12-14 14-15 12-15 13-14 13-15 "
    "13-16 15-17 13-17 16-15 16-17 16-18 17-19 16-19 18-17 18-19"
)


def make_robot(robot):
    """Positions, and springs (a, b, rest length, stiffness, actuation)."""
    if robot == 0:
        points = [(0.2, 0.1), (0.3, 0.13), (0.4, 0.1), (0.2, 0.2), (0.3, 0.2), (0.4, 0.2)]
        pairs = "0-1 1-2 3-4 4-5 0-3 2-5 0-4 1-4 2-4 3-1 5-1".split()
        springs = [(*map(int, pair.split("-")), 14000, 0.1) for pair in pairs]
    else:
        if robot == 1:
            points = [(.225, .125), (.2, .15), (.25, .15), (.125, .125), (.1, .15), (.15, .15),
                      (.1, .2), (.15, .2), (.1, .25), (.15, .25), (.2, .2), (.2, .25),
                      (.25, .2), (.25, .25)]  # fmt: skip
            pairs = robot1_springs
        else:
            points = [(.2, .1), (.2, .15), (.25, .1), (.25, .15), (.1, .1), (.1, .15),
                      (.15, .1), (.15, .15), (.1, .2), (.15, .2), (.1, .25), (.15, .25),
                      (.2, .2), (.2, .25), (.25, .2), (.25, .25), (.2, .3), (.25, .3),
                      (.2, .35), (.25, .35)]  # fmt: skip
            pairs = robot2_springs
        springs = []
        for pair in pairs.split():
            a, b = map(int, pair.rstrip("*").split("-"))
            springs.append((a, b, 30000, 0.15 if pair.endswith("*") else 0))
    points = np.array(points)
    return points, [
        (a, b, float(np.hypot(*(points[a] - points[b]))), k, s) for a, b, k, s in springs
    ]


scalar = lambda: ti.field(dtype=real)  # noqa: E731
vec = lambda: ti.Vector.field(2, dtype=real)  # noqa: E731

loss = scalar()
x, v, v_inc = vec(), vec(), vec()
head_id = 0
goal = vec()
n_objects = 0
ground_height = 0.1
n_springs = 0
spring_anchor_a = ti.field(ti.i32)
spring_anchor_b = ti.field(ti.i32)
spring_length, spring_stiffness, spring_actuation = scalar(), scalar(), scalar()
weights1, bias1 = scalar(), scalar()
weights2, bias2 = scalar(), scalar()
hidden = scalar()
center = vec()
act = scalar()


def n_input_states():
    return n_sin_waves + 4 * n_objects + 2


def allocate_fields():
    ti.root.dense(ti.i, max_steps).dense(ti.j, n_objects).place(x, v, v_inc)
    ti.root.dense(ti.i, n_springs).place(
        spring_anchor_a, spring_anchor_b, spring_length, spring_stiffness, spring_actuation
    )
    ti.root.dense(ti.ij, (n_hidden, n_input_states())).place(weights1)
    ti.root.dense(ti.i, n_hidden).place(bias1)
    ti.root.dense(ti.ij, (n_springs, n_hidden)).place(weights2)
    ti.root.dense(ti.i, n_springs).place(bias2)
    ti.root.dense(ti.ij, (max_steps, n_hidden)).place(hidden)
    ti.root.dense(ti.ij, (max_steps, n_springs)).place(act)
    ti.root.dense(ti.i, max_steps).place(center)
    ti.root.place(loss, goal)
    ti.root.lazy_grad()


@ti.kernel
def compute_center(t: ti.i32):
    for _ in range(1):
        c = ti.Vector([0.0, 0.0])
        for i in ti.static(range(n_objects)):
            c += x[t, i]
        center[t] = (1.0 / n_objects) * c


@ti.kernel
def nn1(t: ti.i32):
    for i in range(n_hidden):
        actuation = 0.0
        for j in ti.static(range(n_sin_waves)):
            actuation += weights1[i, j] * ti.sin(
                spring_omega * t * dt + 2 * np.pi / n_sin_waves * j
            )
        for j in ti.static(range(n_objects)):
            offset = x[t, j] - center[t]
            actuation += weights1[i, j * 4 + n_sin_waves] * offset[0] * 0.05
            actuation += weights1[i, j * 4 + n_sin_waves + 1] * offset[1] * 0.05
            actuation += weights1[i, j * 4 + n_sin_waves + 2] * v[t, j][0] * 0.05
            actuation += weights1[i, j * 4 + n_sin_waves + 3] * v[t, j][1] * 0.05
        actuation += weights1[i, n_objects * 4 + n_sin_waves] * (goal[None][0] - center[t][0])
        actuation += weights1[i, n_objects * 4 + n_sin_waves + 1] * (goal[None][1] - center[t][1])
        actuation += bias1[i]
        actuation = ti.tanh(actuation)
        hidden[t, i] = actuation


@ti.kernel
def nn2(t: ti.i32):
    for i in range(n_springs):
        actuation = 0.0
        for j in ti.static(range(n_hidden)):
            actuation += weights2[i, j] * hidden[t, j]
        actuation += bias2[i]
        actuation = ti.tanh(actuation)
        act[t, i] = actuation


@ti.kernel
def apply_spring_force(t: ti.i32):
    for i in range(n_springs):
        a = spring_anchor_a[i]
        b = spring_anchor_b[i]
        dist = x[t, a] - x[t, b]
        length = dist.norm() + 1e-4
        target_length = spring_length[i] * (1.0 + spring_actuation[i] * act[t, i])
        impulse = dt * (length - target_length) * spring_stiffness[i] / length * dist
        ti.atomic_add(v_inc[t + 1, a], -impulse)
        ti.atomic_add(v_inc[t + 1, b], impulse)


use_toi = True


@ti.kernel
def advance_toi(t: ti.i32):
    for i in range(n_objects):
        s = ti.exp(-dt * damping)
        old_v = s * v[t - 1, i] + dt * gravity * ti.Vector([0.0, 1.0]) + v_inc[t, i]
        old_x = x[t - 1, i]
        new_x = old_x + dt * old_v
        toi = 0.0
        new_v = old_v
        if new_x[1] < ground_height and old_v[1] < -1e-4:
            toi = -(old_x[1] - ground_height) / old_v[1]
            new_v = ti.Vector([0.0, 0.0])
        new_x = old_x + toi * old_v + (dt - toi) * new_v
        v[t, i] = new_v
        x[t, i] = new_x


@ti.kernel
def advance_no_toi(t: ti.i32):
    for i in range(n_objects):
        s = ti.exp(-dt * damping)
        old_v = s * v[t - 1, i] + dt * gravity * ti.Vector([0.0, 1.0]) + v_inc[t, i]
        old_x = x[t - 1, i]
        new_v = old_v
        depth = old_x[1] - ground_height
        if depth < 0 and new_v[1] < 0:
            new_v[0] = 0
            new_v[1] = 0
        x[t, i] = old_x + dt * new_v
        v[t, i] = new_v


@ti.kernel
def compute_loss(t: ti.i32):
    loss[None] = -x[t, head_id][0]


@ti.kernel
def clear_increments():
    for t in range(0, max_steps):
        for i in range(0, n_objects):
            v_inc[t, i] = ti.Vector([0.0, 0.0])


def forward(steps):
    for t in range(1, steps):
        compute_center(t - 1)
        nn1(t - 1)
        nn2(t - 1)
        apply_spring_force(t - 1)
        if use_toi:
            advance_toi(t)
        else:
            advance_no_toi(t)
    loss[None] = 0
    compute_loss(steps - 1)


def setup_robot(points, springs):
    global n_objects, n_springs
    n_objects = len(points)
    n_springs = len(springs)
    allocate_fields()
    for i in range(n_objects):
        x[0, i] = points[i]
    for i in range(n_springs):
        s = springs[i]
        spring_anchor_a[i] = s[0]
        spring_anchor_b[i] = s[1]
        spring_length[i] = s[2]
        spring_stiffness[i] = s[3]
        spring_actuation[i] = s[4]


def main():
    global max_steps, use_toi
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", type=int, nargs="?", default=0)
    parser.add_argument("--steps", type=int, default=2048 // 3)
    parser.add_argument("--iterations", type=int, default=3)
    parser.add_argument("--no-toi", action="store_true")
    args = parser.parse_args()
    max_steps, use_toi = args.steps, not args.no_toi

    np.random.seed(0)
    setup_robot(*make_robot(args.robot))
    goal[None] = [0.9, 0.2]
    for i in range(n_hidden):
        for j in range(n_input_states()):
            weights1[i, j] = np.random.randn() * np.sqrt(2 / (n_hidden + n_input_states())) * 2
    for i in range(n_springs):
        for j in range(n_hidden):
            weights2[i, j] = np.random.randn() * np.sqrt(2 / (n_hidden + n_springs)) * 3

    losses, norms = [], []
    for iteration in range(args.iterations):
        clear_increments()
        with ti.ad.Tape(loss):
            forward(args.steps)
        total_norm_sqr = 0.0
        for i in range(n_hidden):
            for j in range(n_input_states()):
                total_norm_sqr += weights1.grad[i, j] ** 2
            total_norm_sqr += bias1.grad[i] ** 2
        for i in range(n_springs):
            for j in range(n_hidden):
                total_norm_sqr += weights2.grad[i, j] ** 2
            total_norm_sqr += bias2.grad[i] ** 2
        losses.append(loss[None])
        norms.append(total_norm_sqr)
        if iteration == 0:
            each = [
                float(np.linalg.norm(part.grad.to_numpy()))
                for part in (weights1, bias1, weights2, bias2)
            ]
        print("iteration", iteration, "loss", loss[None], "squared norm", total_norm_sqr)
        scale = 0.2 / (total_norm_sqr**0.5 + 1e-6)
        for i in range(n_hidden):
            for j in range(n_input_states()):
                weights1[i, j] -= scale * weights1.grad[i, j]
            bias1[i] -= scale * bias1.grad[i]
        for i in range(n_springs):
            for j in range(n_hidden):
                weights2[i, j] -= scale * weights2.grad[i, j]
            bias2[i] -= scale * bias2.grad[i]
    report(losses=losses, squared_norms=norms, norms=each)


if __name__ == "__main__":
    main()
