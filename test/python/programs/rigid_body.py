"""Boxes tied by springs and joints that a neural network actuates; they learn to walk."""

import argparse
import math

import numpy as np
import tai as ti
from results import report

real = ti.f32
ti.init(default_fp=real, flatten_if=True)

max_steps = 4096
dt = 0.001
n_hidden = 32
n_sin_waves = 10
spring_omega = 30
gravity = -9.8
ground_height = 0.1
friction = 1.0
elasticity = 0.0
damping = 10
default_actuation = 0.05
actuation_coef = 0.05

scalar = lambda: ti.field(dtype=real)  # noqa: E731
vec = lambda: ti.Vector.field(2, dtype=real)  # noqa: E731

loss = scalar()
use_toi = True
x, v, rotation, omega = vec(), vec(), scalar(), scalar()
halfsize = vec()
inverse_mass, inverse_inertia = scalar(), scalar()
v_inc, x_inc = vec(), vec()
rotation_inc, omega_inc = scalar(), scalar()
head_id = 0
goal = vec()
n_objects = 0
n_springs = 0
spring_anchor_a = ti.field(ti.i32)
spring_anchor_b = ti.field(ti.i32)
spring_length = scalar()
spring_offset_a, spring_offset_b = vec(), vec()
spring_phase = scalar()
spring_actuation, spring_stiffness = scalar(), scalar()
weights1, bias1, weights2, bias2 = scalar(), scalar(), scalar(), scalar()
hidden, actuation = scalar(), scalar()


def n_input_states():
    return n_sin_waves + 6 * n_objects + 2


def allocate_fields():
    ti.root.dense(ti.i, max_steps).dense(ti.j, n_objects).place(
        x, v, rotation, rotation_inc, omega, v_inc, x_inc, omega_inc
    )
    ti.root.dense(ti.i, n_objects).place(halfsize, inverse_mass, inverse_inertia)
    ti.root.dense(ti.i, n_springs).place(
        spring_anchor_a, spring_anchor_b, spring_length, spring_offset_a, spring_offset_b,
        spring_stiffness, spring_phase, spring_actuation,
    )  # fmt: skip
    ti.root.dense(ti.ij, (n_hidden, n_input_states())).place(weights1)
    ti.root.dense(ti.ij, (n_springs, n_hidden)).place(weights2)
    ti.root.dense(ti.i, n_hidden).place(bias1)
    ti.root.dense(ti.i, n_springs).place(bias2)
    ti.root.dense(ti.ij, (max_steps, n_springs)).place(actuation)
    ti.root.dense(ti.ij, (max_steps, n_hidden)).place(hidden)
    ti.root.place(loss, goal)
    ti.root.lazy_grad()


@ti.kernel
def nn1(t: ti.i32):
    for i in range(n_hidden):
        act = 0.0
        for j in ti.static(range(n_sin_waves)):
            act += weights1[i, j] * ti.sin(spring_omega * t * dt + 2 * math.pi / n_sin_waves * j)
        for j in ti.static(range(n_objects)):
            offset = x[t, j] - x[t, head_id]
            # 0.05 scales everything to about one
            act += weights1[i, j * 6 + n_sin_waves] * offset[0] * 0.05
            act += weights1[i, j * 6 + n_sin_waves + 1] * offset[1] * 0.05
            act += weights1[i, j * 6 + n_sin_waves + 2] * v[t, j][0] * 0.05
            act += weights1[i, j * 6 + n_sin_waves + 3] * v[t, j][1] * 0.05
            act += weights1[i, j * 6 + n_sin_waves + 4] * rotation[t, j] * 0.05
            act += weights1[i, j * 6 + n_sin_waves + 5] * omega[t, j] * 0.05
        act += weights1[i, n_objects * 6 + n_sin_waves] * goal[None][0]
        act += weights1[i, n_objects * 6 + n_sin_waves + 1] * goal[None][1]
        act += bias1[i]
        act = ti.tanh(act)
        hidden[t, i] = act


@ti.kernel
def nn2(t: ti.i32):
    for i in range(n_springs):
        act = 0.0
        for j in ti.static(range(n_hidden)):
            act += weights2[i, j] * hidden[t, j]
        act += bias2[i]
        act = ti.tanh(act)
        actuation[t, i] = act


@ti.func
def rotation_matrix(r):
    return ti.Matrix([[ti.cos(r), -ti.sin(r)], [ti.sin(r), ti.cos(r)]])


@ti.func
def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


@ti.func
def initialize_properties_of(i):
    h = halfsize[i]
    inverse_mass[i] = 1.0 / (4 * h[0] * h[1])
    inverse_inertia[i] = 1.0 / (4 / 3 * h[0] * h[1] * (h[0] * h[0] + h[1] * h[1]))


@ti.kernel
def initialize_properties():
    for i in range(n_objects):
        initialize_properties_of(i)


@ti.func
def to_world(t, i, rela_x):
    rot = rotation[t, i]
    rot_matrix = rotation_matrix(rot)
    rela_pos = rot_matrix @ rela_x
    rela_v = omega[t, i] * ti.Vector([-rela_pos[1], rela_pos[0]])
    world_x = x[t, i] + rela_pos
    world_v = v[t, i] + rela_v
    return world_x, world_v, rela_pos


@ti.func
def apply_impulse(t, i, impulse, location, toi_input):
    # The impulse acts at the time of impact, which moves the body as well.
    delta_v = impulse * inverse_mass[i]
    delta_omega = cross(location - x[t, i], impulse) * inverse_inertia[i]
    toi = ti.min(ti.max(0.0, toi_input), dt)
    ti.atomic_add(x_inc[t + 1, i], toi * (-delta_v))
    ti.atomic_add(rotation_inc[t + 1, i], toi * (-delta_omega))
    ti.atomic_add(v_inc[t + 1, i], delta_v)
    ti.atomic_add(omega_inc[t + 1, i], delta_omega)


@ti.kernel
def collide(t: ti.i32):
    for i in range(n_objects):
        hs = halfsize[i]
        for k in ti.static(range(4)):
            # corner k of the box
            offset_scale = ti.Vector([k % 2 * 2 - 1, k // 2 % 2 * 2 - 1])
            corner_x, corner_v, rela_pos = to_world(t, i, offset_scale * hs)
            corner_v = corner_v + dt * gravity * ti.Vector([0.0, 1.0])
            # where the corner will be
            new_corner_x = corner_x + dt * corner_v
            normal = ti.Vector([0.0, 1.0])
            tao = ti.Vector([1.0, 0.0])
            rn = cross(rela_pos, normal)
            rt = cross(rela_pos, tao)
            impulse_contribution = inverse_mass[i] + rn**2 * inverse_inertia[i]
            timpulse_contribution = inverse_mass[i] + rt**2 * inverse_inertia[i]
            rela_v_ground = normal.dot(corner_v)
            impulse = 0.0
            timpulse = 0.0
            toi = 0.0
            if rela_v_ground < 0 and new_corner_x[1] < ground_height:
                impulse = -(1 + elasticity) * rela_v_ground / impulse_contribution
                if impulse > 0:
                    # friction within its cone
                    timpulse = -corner_v.dot(tao) / timpulse_contribution
                    timpulse = ti.min(friction * impulse, ti.max(-friction * impulse, timpulse))
                    if corner_x[1] > ground_height:
                        toi = -(corner_x[1] - ground_height) / ti.min(corner_v[1], -1e-3)
            apply_impulse(t, i, impulse * normal + timpulse * tao, new_corner_x, toi)


@ti.kernel
def apply_spring_force(t: ti.i32):
    for i in range(n_springs):
        a = spring_anchor_a[i]
        b = spring_anchor_b[i]
        pos_a, vel_a, rela_a = to_world(t, a, spring_offset_a[i])
        pos_b, vel_b, rela_b = to_world(t, b, spring_offset_b[i])
        dist = pos_a - pos_b
        length = dist.norm() + 1e-4
        act = actuation[t, i]
        is_joint = spring_length[i] == -1
        target_length = spring_length[i] * (1.0 + spring_actuation[i] * act)
        if is_joint:
            target_length = 0.0
        impulse = dt * (length - target_length) * spring_stiffness[i] / length * dist
        if is_joint:
            rela_vel = vel_a - vel_b
            rela_vel_norm = rela_vel.norm() + 1e-1
            impulse_dir = rela_vel / rela_vel_norm
            impulse_contribution = (
                inverse_mass[a]
                + cross(impulse_dir, rela_a) ** 2 * inverse_inertia[a]
                + inverse_mass[b]
                + cross(impulse_dir, rela_b) ** 2 * inverse_inertia[b]
            )
            # a joint also takes the relative velocity away
            impulse += rela_vel_norm / impulse_contribution * impulse_dir
        apply_impulse(t, a, -impulse, pos_a, 0.0)
        apply_impulse(t, b, impulse, pos_b, 0.0)


@ti.kernel
def advance_toi(t: ti.i32):
    for i in range(n_objects):
        s = math.exp(-dt * damping)
        v[t, i] = s * v[t - 1, i] + v_inc[t, i] + dt * gravity * ti.Vector([0.0, 1.0])
        x[t, i] = x[t - 1, i] + dt * v[t, i] + x_inc[t, i]
        omega[t, i] = s * omega[t - 1, i] + omega_inc[t, i]
        rotation[t, i] = rotation[t - 1, i] + dt * omega[t, i] + rotation_inc[t, i]


@ti.kernel
def advance_no_toi(t: ti.i32):
    for i in range(n_objects):
        s = math.exp(-dt * damping)
        v[t, i] = s * v[t - 1, i] + v_inc[t, i] + dt * gravity * ti.Vector([0.0, 1.0])
        x[t, i] = x[t - 1, i] + dt * v[t, i]
        omega[t, i] = s * omega[t - 1, i] + omega_inc[t, i]
        rotation[t, i] = rotation[t - 1, i] + dt * omega[t, i]


@ti.kernel
def compute_loss(t: ti.i32):
    loss[None] = (x[t, head_id] - goal[None]).norm()


@ti.kernel
def clear_states():
    for t in range(0, max_steps):
        for i in range(0, n_objects):
            v_inc[t, i] = ti.Vector([0.0, 0.0])
            x_inc[t, i] = ti.Vector([0.0, 0.0])
            rotation_inc[t, i] = 0.0
            omega_inc[t, i] = 0.0


def forward(steps):
    for t in range(1, steps):
        nn1(t - 1)
        nn2(t - 1)
        collide(t - 1)
        apply_spring_force(t - 1)
        if use_toi:
            advance_toi(t)
        else:
            advance_no_toi(t)
    compute_loss(steps - 1)


def make_robot(robot):
    """Bodies (centre, half size, angle), springs and the index of the head."""
    bodies, springs = [], []

    def spring(a, b, offset_a, offset_b, length, stiffness, act=default_actuation):
        springs.append([a, b, offset_a, offset_b, length, stiffness, act])

    def joint(a, b, offset_a, offset_b, stiffness):
        spring(a, b, offset_a, offset_b, -1, stiffness)

    if robot == 0:
        head = 0
        bodies = [((.3, .25), (.15, .03), 0), ((.2, .15), (.03, .02), 0),
                  ((.3, .15), (.03, .02), 0), ((.4, .15), (.03, .02), 0),
                  ((.4, .3), (.005, .03), 0)]  # fmt: skip
        for b, at in ((1, -0.03), (1, -0.1), (2, -0.03), (2, 0.03), (3, 0.03), (3, 0.1)):
            spring(0, b, (at, 0), (0, 0), 0.12, 15)
        joint(0, 4, (0.1, 0), (0, -0.05), 15)
    elif robot == 1:
        head = 0
        bodies = [((.15, .25), (.1, .03), 0), ((.08, .22), (.03, .1), 0),
                  ((.22, .22), (.03, .1), 0)]  # fmt: skip
        spring(0, 1, (0.08, 0.02), (0, -0.08), 0.22, 50, 0.03)
        spring(0, 2, (-0.08, 0.02), (0, -0.08), 0.22, 50, 0.03)
        joint(0, 1, (-0.08, 0), (0, 0.03), 50)
        joint(0, 2, (0.08, 0), (0, 0.03), 50)
    else:
        head = 3
        tilt = math.radians(10)
        bodies = [((0.3, 0.65), (0.06, 0.08), 0)]
        for leg in range(2):
            bodies += [((.319101, .471671), (.02, .11), tilt),
                       ((.319101, .255014), (.02, .11), -tilt),
                       ((.38, .146685), (.08, .02), 0)]  # fmt: skip
            thigh, calf, foot = (1 + 3 * leg, 2 + 3 * leg, 3 + 3 * leg)
            spring(0, thigh, (0, 0.028), (0, -0.11), 0.396, 5)
            spring(thigh, calf, (0, 0.11), (0, -0.11), 0.396, 20, 0.08)
            spring(calf, foot, (0, 0), (0.08, 0), 0.7 * math.hypot(0.11, 0.16), 40)
            joint(0, thigh, (0, -0.07), (0, 0.11), 200)
            joint(thigh, calf, (0, -0.11), (0, 0.11), 200)
            joint(calf, foot, (0, -0.11), (-0.08, 0), 200)
    return bodies, springs, head


def setup_robot(bodies, springs, head):
    global n_objects, n_springs, head_id
    head_id = head
    n_objects = len(bodies)
    n_springs = len(springs)
    allocate_fields()
    for i in range(n_objects):
        x[0, i] = bodies[i][0]
        halfsize[i] = bodies[i][1]
        rotation[0, i] = bodies[i][2]
    initialize_properties()
    for i in range(n_springs):
        s = springs[i]
        spring_anchor_a[i] = s[0]
        spring_anchor_b[i] = s[1]
        spring_offset_a[i] = s[2]
        spring_offset_b[i] = s[3]
        spring_length[i] = s[4]
        spring_stiffness[i] = s[5]
        spring_actuation[i] = s[6]


def main():
    global max_steps, use_toi
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", type=int, nargs="?", default=0)
    parser.add_argument("--steps", type=int, default=2048)
    parser.add_argument("--iterations", type=int, default=3)
    parser.add_argument("--no-toi", action="store_true")
    args = parser.parse_args()
    max_steps, use_toi = args.steps, not args.no_toi
    np.random.seed(0)
    setup_robot(*make_robot(args.robot))
    goal[None] = [0.9, 0.15]
    for i in range(n_hidden):
        for j in range(n_input_states()):
            weights1[i, j] = np.random.randn() * math.sqrt(2 / (n_hidden + n_input_states())) * 0.5
    for i in range(n_springs):
        for j in range(n_hidden):
            # (spring, hidden unit)
            weights2[i, j] = np.random.randn() * math.sqrt(2 / (n_hidden + n_springs)) * 1

    losses, norms = [], []
    each = None
    for iteration in range(args.iterations):
        clear_states()
        with ti.ad.Tape(loss):
            forward(args.steps)
        total_norm_sqr = 0
        parts = (weights1, bias1, weights2, bias2)
        for part in parts:
            total_norm_sqr += float((part.grad.to_numpy().astype(np.float64) ** 2).sum())
        losses.append(loss[None])
        norms.append(total_norm_sqr)
        if each is None:
            each = [float(np.linalg.norm(part.grad.to_numpy())) for part in parts]
        print("iteration", iteration, "loss", loss[None], "squared norm", total_norm_sqr)
        scale = min(1.0, 0.2 / (total_norm_sqr**0.5 + 1e-4))
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
