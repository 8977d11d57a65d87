"""A three-dimensional crawler of elastic blocks, with or without a body of liquid on it."""

import argparse
import math
import random

import numpy as np
import tai as ti
from results import report

real = ti.f32
ti.init(arch=ti.cuda, default_fp=real, flatten_if=True, device_memory_GB=7, kernel_profiler=True)

dim = 3
n_grid = 64
dx = 1 / n_grid
inv_dx = 1 / dx
dt = 2e-3
p_vol = 1
E = 10
mu = E
la = E
max_steps = 512
steps = 512
gravity = 10
n_particles = 0
n_solid_particles = 0
n_actuators = 0
n_sin_waves = 4
act_strength = 5
actuation_omega = 40
bound = 3
coeff = 1.5

scalar = lambda: ti.field(dtype=real)  # noqa: E731
vec = lambda: ti.Vector.field(dim, dtype=real)  # noqa: E731
mat = lambda: ti.Matrix.field(dim, dim, dtype=real)  # noqa: E731

actuator_id = ti.field(ti.i32)
particle_type = ti.field(ti.i32)
x, v = vec(), vec()
grid_v_in, grid_m_in = vec(), scalar()
grid_v_out = vec()
C, F = mat(), mat()
loss = scalar()
weights, bias = scalar(), scalar()
x_avg = vec()
actuation = scalar()


def allocate_fields():
    ti.root.dense(ti.ij, (n_actuators, n_sin_waves)).place(weights)
    ti.root.dense(ti.i, n_actuators).place(bias)
    ti.root.dense(ti.ij, (max_steps, n_actuators)).place(actuation)
    ti.root.dense(ti.i, n_particles).place(actuator_id, particle_type)
    ti.root.dense(ti.k, max_steps).dense(ti.l, n_particles).place(x, v, C, F)
    ti.root.dense(ti.ijk, n_grid // 4).dense(ti.ijk, 4).place(grid_v_in, grid_m_in, grid_v_out)
    ti.root.place(loss, x_avg)
    ti.root.lazy_grad()


def zero_vec():
    return [0.0, 0.0, 0.0]


def zero_matrix():
    return [zero_vec(), zero_vec(), zero_vec()]


@ti.kernel
def clear_grid():
    for i, j, k in grid_m_in:
        grid_v_in[i, j, k] = [0, 0, 0]
        grid_m_in[i, j, k] = 0
        grid_v_in.grad[i, j, k] = [0, 0, 0]
        grid_m_in.grad[i, j, k] = 0
        grid_v_out.grad[i, j, k] = [0, 0, 0]


@ti.kernel
def clear_particle_grad():
    # for all time steps and all particles
    for f, i in x:
        x.grad[f, i] = zero_vec()
        v.grad[f, i] = zero_vec()
        C.grad[f, i] = zero_matrix()
        F.grad[f, i] = zero_matrix()


@ti.kernel
def clear_actuation_grad():
    for t, i in actuation:
        actuation[t, i] = 0.0


@ti.kernel
def p2g(f: ti.i32):
    for p in range(0, n_particles):
        base = ti.cast(x[f, p] * inv_dx - 0.5, ti.i32)
        fx = x[f, p] * inv_dx - ti.cast(base, real)
        w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
        new_F = (ti.Matrix.diag(dim=dim, val=1) + dt * C[f, p]) @ F[f, p]
        J = (new_F).determinant()
        if particle_type[p] == 0:  # fluid
            sqrtJ = ti.sqrt(J)
            # a stand-in for the cube root
            new_F = ti.Matrix([[sqrtJ, 0, 0], [0, sqrtJ, 0], [0, 0, 1]])

        F[f + 1, p] = new_F
        act_id = actuator_id[p]
        act = actuation[f, ti.max(0, act_id)] * act_strength
        if act_id == -1:
            act = 0.0

        A = ti.Matrix([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) * act
        cauchy = ti.Matrix(zero_matrix())
        mass = 0.0
        ident = ti.Matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        if particle_type[p] == 0:
            mass = 4
            cauchy = ident * (J - 1.0) * E
        else:
            mass = 1
            cauchy = mu * (new_F @ new_F.transpose()) + ident * (la * ti.log(J) - mu)
        cauchy += new_F @ A @ new_F.transpose()
        stress = -(dt * p_vol * 4 * inv_dx * inv_dx) * cauchy
        affine = stress + mass * C[f, p]
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                for k in ti.static(range(3)):
                    offset = ti.Vector([i, j, k])
                    dpos = (ti.cast(ti.Vector([i, j, k]), real) - fx) * dx
                    weight = w[i][0] * w[j][1] * w[k][2]
                    ti.atomic_add(
                        grid_v_in[base + offset], weight * (mass * v[f, p] + affine @ dpos)
                    )
                    ti.atomic_add(grid_m_in[base + offset], weight * mass)


@ti.kernel
def grid_op():
    for i, j, k in grid_m_in:
        inv_m = 1 / (grid_m_in[i, j, k] + 1e-10)
        v_out = inv_m * grid_v_in[i, j, k]
        v_out[1] -= dt * gravity
        if i < bound and v_out[0] < 0:
            v_out = ti.Vector([0.0, 0.0, 0.0])
        if i > n_grid - bound and v_out[0] > 0:
            v_out = ti.Vector([0.0, 0.0, 0.0])
        if k < bound and v_out[2] < 0:
            v_out = ti.Vector([0.0, 0.0, 0.0])
        if k > n_grid - bound and v_out[2] > 0:
            v_out = ti.Vector([0.0, 0.0, 0.0])
        if j < bound and v_out[1] < 0:
            v_out = ti.Vector([0.0, 0.0, 0.0])
            normal = ti.Vector([0.0, 1.0, 0.0])
            lin = v_out.dot(normal)
            if lin < 0:
                vit = v_out - lin * normal
                lit = vit.norm() + 1e-10
                if lit + coeff * lin <= 0:
                    v_out = ti.Vector([0.0, 0.0, 0.0])
                else:
                    v_out = (1 + coeff * lin / lit) * vit
        if j > n_grid - bound and v_out[1] > 0:
            v_out = ti.Vector([0.0, 0.0, 0.0])
        grid_v_out[i, j, k] = v_out


@ti.kernel
def g2p(f: ti.i32):
    for p in range(0, n_particles):
        base = ti.cast(x[f, p] * inv_dx - 0.5, ti.i32)
        fx = x[f, p] * inv_dx - ti.cast(base, real)
        w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]
        new_v = ti.Vector(zero_vec())
        new_C = ti.Matrix(zero_matrix())
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                for k in ti.static(range(3)):
                    dpos = ti.cast(ti.Vector([i, j, k]), real) - fx
                    g_v = grid_v_out[base[0] + i, base[1] + j, base[2] + k]
                    weight = w[i][0] * w[j][1] * w[k][2]
                    new_v += weight * g_v
                    new_C += 4 * weight * g_v.outer_product(dpos) * inv_dx
        v[f + 1, p] = new_v
        x[f + 1, p] = x[f, p] + dt * v[f + 1, p]
        C[f + 1, p] = new_C


@ti.kernel
def compute_actuation(t: ti.i32):
    for i in range(n_actuators):
        act = 0.0
        for j in ti.static(range(n_sin_waves)):
            act += weights[i, j] * ti.sin(actuation_omega * t * dt + 2 * math.pi / n_sin_waves * j)
        act += bias[i]
        actuation[t, i] = ti.tanh(act)


@ti.kernel
def compute_x_avg():
    for i in range(n_particles):
        contrib = 0.0
        if particle_type[i] == 1:
            contrib = 1.0 / n_solid_particles
        ti.atomic_add(x_avg[None], contrib * x[steps - 1, i])


@ti.kernel
def compute_loss():
    dist = x_avg[None][0]
    loss[None] = -dist


def forward(total_steps):
    # simulation
    for s in range(total_steps - 1):
        clear_grid()
        compute_actuation(s)
        p2g(s)
        grid_op()
        g2p(s)
    x_avg[None] = [0, 0, 0]
    compute_x_avg()
    compute_loss()
    return loss[None]


def backward():
    clear_particle_grad()
    x_avg.grad[None] = [0, 0, 0]
    weights.grad.fill(0)
    bias.grad.fill(0)
    actuation.grad.fill(0)
    loss.grad[None] = 1
    compute_loss.grad()
    compute_x_avg.grad()
    for s in reversed(range(steps - 1)):
        # the grid of this step is not kept: make it again
        clear_grid()
        p2g(s)
        grid_op()
        g2p.grad(s)
        grid_op.grad()
        p2g.grad(s)
        compute_actuation.grad(s)


class Scene:
    def __init__(self):
        self.n_particles = 0
        self.n_solid_particles = 0
        self.x = []
        self.actuator_id = []
        self.particle_type = []
        self.offset_x, self.offset_y, self.offset_z = 0.1, 0.05, 0.3
        self.num_actuators = 0

    def new_actuator(self):
        self.num_actuators += 1
        return self.num_actuators - 1

    def add_rect(self, x, y, z, w, h, d, actuation, ptype=1, density=3):
        w_count, h_count, d_count = (int(side / dx * density) for side in (w, h, d))
        real_dx, real_dy, real_dz = w / w_count, h / h_count, d / d_count
        for i in range(w_count):
            for j in range(h_count):
                for k in range(d_count):
                    if ptype == 1:
                        self.x.append([
                            x + (i + 0.5) * real_dx + self.offset_x,
                            y + (j + 0.5) * real_dy + self.offset_y,
                            z + (k + 0.5) * real_dz + self.offset_z,
                        ])  # fmt: skip
                    else:
                        self.x.append([
                            x + random.random() * w + self.offset_x,
                            y + random.random() * h + self.offset_y,
                            z + random.random() * d + self.offset_z,
                        ])  # fmt: skip
                    self.actuator_id.append(actuation)
                    self.particle_type.append(ptype)
                    self.n_particles += 1
                    self.n_solid_particles += int(ptype == 1)


def robot(scene, block, density):
    """Four legs of four muscles each, and a body of three parts."""
    for leg in range(4):
        at_x, at_z = 2 * block * (leg // 2), 2 * block * (leg % 2)
        for part in range(4):
            scene.add_rect(
                at_x + block / 2 * (part // 2), 0.35 * block * (part % 2), at_z,
                block / 2, 0.35 * block, block, scene.new_actuator(), density=density,
            )  # fmt: skip
    for part in range(3):
        scene.add_rect(part * block, 0, block, block, 0.7 * block, block, -1, density=density)


def main():
    global n_particles, n_solid_particles, n_actuators, steps, max_steps
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=512)
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--density", type=float, default=3, help="particles per cell and axis")
    parser.add_argument("--liquid", action="store_true")
    parser.add_argument("--particles", action="store_true", help="report the scene as well")
    args = parser.parse_args()
    steps = max_steps = args.steps
    scene = Scene()
    np.random.seed(0)
    random.seed(0)
    robot(scene, 0.08 if args.liquid else 0.1, args.density)
    if args.liquid:
        scene.add_rect(0.1, 0.15, 0.1, 0.2, 0.05, 0.2, -1, ptype=0, density=args.density)
    n_particles, n_solid_particles = scene.n_particles, scene.n_solid_particles
    n_actuators = scene.num_actuators
    print("particles", n_particles)
    allocate_fields()

    for i in range(n_actuators):
        for j in range(n_sin_waves):
            if args.liquid:
                weights[i, j] = np.random.randn() * 0.01
            else:
                weights[i, j] = 0.01 * math.sin(12.9898 * i + 78.233 * j)
    for i in range(scene.n_particles):
        x[0, i] = scene.x[i]
        F[0, i] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
        actuator_id[i] = scene.actuator_id[i]
        particle_type[i] = scene.particle_type[i]

    scene_numbers = {}
    if args.particles:
        scene_numbers = {"x": x.to_numpy()[0], "muscle": scene.actuator_id,
                         "solid": scene.particle_type, "weights": weights.to_numpy()}  # fmt: skip
    losses, norms = [], []
    learning_rate = 10 if args.liquid else 30
    for _ in range(args.iterations):
        losses.append(forward(steps))
        backward()
        if args.particles and not norms:
            scene_numbers.update(dweights=weights.grad.to_numpy(), dbias=bias.grad.to_numpy())
        norms.append([float(np.linalg.norm(p.grad.to_numpy())) for p in (weights, bias)])
        for i in range(n_actuators):
            for j in range(n_sin_waves):
                weights[i, j] -= learning_rate * weights.grad[i, j]
            bias[i] -= learning_rate * bias.grad[i]
    ti.sync()
    ti.profiler.print_kernel_profiler_info()
    ti.profiler.clear_kernel_profiler_info()
    report(losses=losses, norms=norms, **scene_numbers)


if __name__ == "__main__":
    main()
