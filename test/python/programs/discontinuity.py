"""A box meets the ground: with friction the loss jumps where the corner that hits changes."""

import argparse
import math

import tai as ti
from results import report

real = ti.f32
ti.init(default_fp=real, flatten_if=True)

max_steps = 2048
dt = 2e-4
ground_height = 0.1
elasticity = 0.3
penalty = 1e4
gravity = 0.0
n_objects = 1

scalar = lambda: ti.field(dtype=real)  # noqa: E731
vec = lambda: ti.Vector.field(2, dtype=real)  # noqa: E731
loss = scalar()
friction = scalar()
x, v, rotation, omega = vec(), vec(), scalar(), scalar()
v_inc, omega_inc = vec(), scalar()
halfsize = vec()
inverse_mass, inverse_inertia = scalar(), scalar()


@ti.func
def rotation_matrix(r):
    return ti.Matrix([[ti.cos(r), -ti.sin(r)], [ti.sin(r), ti.cos(r)]])


@ti.kernel
def initialize_properties():
    for i in range(n_objects):
        inverse_mass[i] = 1.0 / (4 * halfsize[i][0] * halfsize[i][1])
        inverse_inertia[i] = 1.0 / (
            4 / 3 * halfsize[i][0] * halfsize[i][1]
            * (halfsize[i][0] * halfsize[i][0] + halfsize[i][1] * halfsize[i][1])
        )  # fmt: skip


@ti.func
def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


@ti.func
def to_world(t, i, rela_x):
    rot = rotation[t, i]
    rot_matrix = rotation_matrix(rot)
    rela_pos = rot_matrix @ rela_x
    rela_v = omega[t, i] * ti.Vector([-rela_pos[1], rela_pos[0]])
    return x[t, i] + rela_pos, v[t, i] + rela_v, rela_pos


@ti.func
def apply_impulse(t, i, impulse, location):
    v_inc[t + 1, i] += impulse * inverse_mass[i]
    omega_inc[t + 1, i] += cross(location - x[t, i], impulse) * inverse_inertia[i]


@ti.kernel
def collide(t: ti.i32):
    for i in range(n_objects):
        hs = halfsize[i]
        for k in ti.static(range(4)):
            offset_scale = ti.Vector([k % 2 * 2 - 1, k // 2 % 2 * 2 - 1])
            corner_x, corner_v, rela_pos = to_world(t, i, offset_scale * hs)
            corner_v = corner_v + dt * gravity * ti.Vector([0.0, 1.0])
            normal = ti.Vector([0.0, 1.0])
            tao = ti.Vector([1.0, 0.0])
            rn = cross(rela_pos, normal)
            rt = cross(rela_pos, tao)
            impulse_contribution = inverse_mass[i] + (rn) ** 2 * inverse_inertia[i]
            timpulse_contribution = inverse_mass[i] + (rt) ** 2 * inverse_inertia[i]
            rela_v_ground = normal.dot(corner_v)
            impulse = 0.0
            timpulse = 0.0
            if rela_v_ground < 0 and corner_x[1] < ground_height:
                impulse = -(1 + elasticity) * rela_v_ground / impulse_contribution
                if impulse > 0:
                    timpulse = -corner_v.dot(tao) / timpulse_contribution
                    timpulse = min(
                        friction[None] * impulse, max(-friction[None] * impulse, timpulse)
                    )
            if corner_x[1] < ground_height:
                impulse -= dt * penalty * (corner_x[1] - ground_height) / impulse_contribution
            apply_impulse(t, i, impulse * normal + timpulse * tao, corner_x)


@ti.kernel
def advance(t: ti.i32):
    for i in range(n_objects):
        v[t, i] = v[t - 1, i] + v_inc[t, i] + dt * gravity * ti.Vector([0.0, 1.0])
        x[t, i] = x[t - 1, i] + dt * v[t, i]
        omega[t, i] = omega[t - 1, i] + omega_inc[t, i]
        rotation[t, i] = rotation[t - 1, i] + dt * omega[t, i]


@ti.kernel
def compute_loss(t: ti.i32, axis: ti.template()):
    loss[None] = x[t, 0][axis]


@ti.kernel
def clear_states():
    for t in range(0, max_steps):
        for i in range(0, n_objects):
            v_inc[t, i] = ti.Vector([0.0, 0.0])
            omega_inc[t, i] = 0.0


ti.root.dense(ti.i, max_steps).dense(ti.j, n_objects).place(x, v, rotation, omega, v_inc, omega_inc)
ti.root.dense(ti.i, n_objects).place(halfsize, inverse_mass, inverse_inertia)
ti.root.place(loss, friction)
ti.root.lazy_grad()


def run(index, mu, axis):
    friction[None] = mu
    x[0, 0] = [0.7, 0.5]
    v[0, 0] = [-1, -2]
    rotation[0, 0] = (index + 0.5) * 0.001
    omega[0, 0] = 0
    halfsize[0] = [0.1, 0.1]
    initialize_properties()
    clear_states()
    with ti.ad.Tape(loss=loss):
        for t in range(1, max_steps):
            collide(t - 1)
            advance(t)
        compute_loss(max_steps - 1, axis)
    assert math.isfinite(loss[None])
    return loss[None], omega.grad[0, 0], x.grad[0, 0][0]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--indices", default="-20,-2,-1,0,1,19")
    args = parser.parse_args()
    indices = [int(index) for index in args.indices.split(",")]
    report(
        indices=indices,
        x0=[run(i, 0.0, 0) for i in indices],
        x1=[run(i, 1.0, 0) for i in indices],
        y1=[run(i, 1.0, 1)[0] for i in indices],
    )


if __name__ == "__main__":
    main()
