"""A soft robot with four muscles learns to crawl.

The body is elastic and simulated by the material point method (MLS-MPM): particles carry
mass, velocity and deformation, a grid carries the forces between them. The muscles follow
sine waves whose weights are found by gradient descent, so that the robot gets as far to the
right as it can in a second.

One grid serves all steps. Its values are gone when the reverse sweep needs them, so the
gradient of a step first repeats what filled the grid: `grad_replaced` and `grad_for`.

    python examples/diffmpm.py --iterations 30
    python examples/diffmpm.py                      # the paper's: 100 steps of descent
"""

import math

import numpy as np
import tai as ti

import studio

parser = studio.options(__doc__, "diffmpm", iterations=100, steps=1024, rate=0.1)
args = parser.parse_args()
studio.start(args)

N_GRID = 128
DX = 1 / N_GRID
DT = 1e-3
STEPS = args.steps
STIFFNESS = 10.0  # both Lamé parameters
GRAVITY = 3.8
BOUND = 3  # cells at each side in which nothing moves outward
N_WAVES = 4
FREQUENCY = 20.0
STRENGTH = 4.0  # of the muscles

# The robot: boxes (x, y, width, height), and the muscle of each, -1 for none.
BODY = [
    ((0.0, 0.1, 0.3, 0.1), -1),
    ((0.0, 0.0, 0.05, 0.1), 0),
    ((0.05, 0.0, 0.05, 0.1), 1),
    ((0.2, 0.0, 0.05, 0.1), 2),
    ((0.25, 0.0, 0.05, 0.1), 3),
]
N_MUSCLES = 4


def build_robot():
    """Positions of the particles and their muscles; two particles per cell and axis."""
    positions: list[tuple[float, float]] = []
    muscles: list[int] = []
    for (x0, y0, width, height), muscle in BODY:
        n, m = 2 * int(width / DX), 2 * int(height / DX)
        for i in range(n):
            for j in range(m):
                px, py = x0 + (i + 0.5) * width / n, y0 + (j + 0.5) * height / m
                positions.append((px + 0.1, py + 0.03))
                muscles.append(muscle)
    return np.array(positions, np.float32), np.array(muscles, np.int32)


start, muscle_of = build_robot()
N = len(start)

# Particles, one slot for each step: position, velocity, velocity gradient, deformation.
x = ti.Vector.field(2, float, shape=(STEPS, N), needs_grad=True)
v = ti.Vector.field(2, float, shape=(STEPS, N), needs_grad=True)
C = ti.Matrix.field(2, 2, float, shape=(STEPS, N), needs_grad=True)
F = ti.Matrix.field(2, 2, float, shape=(STEPS, N), needs_grad=True)
muscle = ti.field(ti.i32, shape=N)

grid_v_in = ti.Vector.field(2, float, shape=(N_GRID, N_GRID), needs_grad=True)  # momentum
grid_m_in = ti.field(float, shape=(N_GRID, N_GRID), needs_grad=True)
grid_v_out = ti.Vector.field(2, float, shape=(N_GRID, N_GRID), needs_grad=True)

weights = ti.field(float, shape=(N_MUSCLES, N_WAVES), needs_grad=True)
bias = ti.field(float, shape=N_MUSCLES, needs_grad=True)
actuation = ti.field(float, shape=(STEPS, N_MUSCLES), needs_grad=True)
mean_x = ti.field(float, shape=(), needs_grad=True)
loss = ti.field(float, shape=(), needs_grad=True)


@ti.kernel
def clear_grid():
    for i, j in grid_m_in:
        grid_v_in[i, j] = [0.0, 0.0]
        grid_m_in[i, j] = 0.0


@ti.kernel
def clear_grid_gradient():
    for i, j in grid_m_in:
        grid_v_in.grad[i, j] = [0.0, 0.0]
        grid_m_in.grad[i, j] = 0.0
        grid_v_out.grad[i, j] = [0.0, 0.0]


@ti.kernel
def actuate(t: ti.i32):
    """The muscles follow a weighted sum of waves."""
    for i in range(N_MUSCLES):
        drive = bias[i]
        for j in ti.static(range(N_WAVES)):
            drive += weights[i, j] * ti.sin(FREQUENCY * t * DT + 2 * math.pi / N_WAVES * j)
        actuation[t, i] = ti.tanh(drive)


@ti.kernel
def particles_to_grid(t: ti.i32):
    for p in range(N):
        base = ti.cast(x[t, p] / DX - 0.5, ti.i32)
        fx = x[t, p] / DX - base
        w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
        new_F = (ti.Matrix.identity(float, 2) + DT * C[t, p]) @ F[t, p]
        F[t + 1, p] = new_F
        J = new_F.determinant()
        R, _ = ti.polar_decompose(new_F)
        stress = 2 * STIFFNESS * (new_F - R) @ new_F.transpose()
        stress += STIFFNESS * (J - 1) * J * ti.Matrix.identity(float, 2)
        pull = 0.0
        if muscle[p] >= 0:
            pull = STRENGTH * actuation[t, muscle[p]]
        along_y = ti.Matrix([[0.0, 0.0], [0.0, 1.0]]) * pull
        stress += new_F @ along_y @ new_F.transpose()
        affine = -DT * 4 / DX * stress + DX * C[t, p]
        corner = v[t, p] - affine @ fx  # the momentum for the first node
        for i, j in ti.static(ti.ndrange(3, 3)):
            offset = ti.Vector([i, j])
            weight = w[i][0] * w[j][1]
            grid_v_in[base + offset] += weight * (corner + affine @ offset)
            grid_m_in[base + offset] += weight


@ti.kernel
def update_grid():
    """Momentum becomes velocity; gravity; the walls are sticky."""
    for i, j in grid_m_in:
        vel = grid_v_in[i, j] / (grid_m_in[i, j] + 1e-10)
        vel[1] -= DT * GRAVITY
        if i < BOUND and vel[0] < 0:
            vel = ti.Vector([0.0, 0.0])
        if i > N_GRID - BOUND and vel[0] > 0:
            vel = ti.Vector([0.0, 0.0])
        if j < BOUND and vel[1] < 0:
            vel = ti.Vector([0.0, 0.0])
        if j > N_GRID - BOUND and vel[1] > 0:
            vel = ti.Vector([0.0, 0.0])
        grid_v_out[i, j] = vel


@ti.kernel
def grid_to_particles(t: ti.i32):
    for p in range(N):
        base = ti.cast(x[t, p] / DX - 0.5, ti.i32)
        fx = x[t, p] / DX - base
        w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
        new_v = ti.Vector([0.0, 0.0])
        new_C = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
        for i, j in ti.static(ti.ndrange(3, 3)):
            offset = ti.Vector([i, j])
            share = w[i][0] * w[j][1] * grid_v_out[base + offset]
            new_v += share
            new_C += share.outer_product(offset)
        v[t + 1, p] = new_v
        x[t + 1, p] = x[t, p] + DT * new_v
        C[t + 1, p] = 4 / DX * (new_C - new_v.outer_product(fx))


@ti.kernel
def compute_mean():
    for p in range(N):
        mean_x[None] += x[STEPS - 1, p][0] / N


@ti.kernel
def compute_loss():
    loss[None] = -mean_x[None]


@ti.kernel
def descend(rate: float):
    for i, j in weights:
        weights[i, j] -= rate * weights.grad[i, j]
    for i in bias:
        bias[i] -= rate * bias.grad[i]


@ti.ad.grad_replaced
def advance(t: int):
    clear_grid()
    actuate(t)
    particles_to_grid(t)
    update_grid()
    grid_to_particles(t)


@ti.ad.grad_for(advance)
def advance_gradient(t: int):
    """Fills the grid again as it was in step t, then goes back through the step."""
    clear_grid()
    clear_grid_gradient()
    particles_to_grid(t)
    update_grid()

    grid_to_particles.grad(t)
    update_grid.grad()
    particles_to_grid.grad(t)
    actuate.grad(t)


def forward():
    mean_x[None] = 0.0
    for t in range(STEPS - 1):
        advance(t)
    compute_mean()
    compute_loss()


def set_up():
    for p in range(N):
        x[0, p] = start[p]
        F[0, p] = [[1.0, 0.0], [0.0, 1.0]]
    muscle.from_numpy(muscle_of)
    np.random.seed(args.seed)
    weights.from_numpy(0.01 * np.random.randn(N_MUSCLES, N_WAVES))


def optimise():
    """Gradient descent on the weights of the waves; returns the losses."""

    def iteration(_: int):
        with ti.ad.Tape(loss):
            forward()
        norms = [np.linalg.norm(learned.grad.to_numpy()) for learned in (weights, bias)]
        descend(args.rate)
        return {"loss": loss[None], "|dw|": norms[0], "|db|": norms[1]}

    return studio.optimise(args, iteration, weights=weights, bias=bias)


def animate():
    """The robot's second; muscles are red when they pull and blue when they push."""
    if not args.picture:
        return
    forward()
    positions, pulls = x.to_numpy(), actuation.to_numpy()

    def draw(gui: ti.GUI, t: int):
        pull = np.where(muscle_of >= 0, pulls[min(t, STEPS - 2), muscle_of], 0.0)
        gui.line((0, 2 * DX * BOUND), (1, 2 * DX * BOUND), radius=1, color=studio.SOFT)
        gui.circles(positions[t] * [1.0, 2.0], radius=1.6, color=studio.signed(2 * pull))

    studio.animate(args, draw, range(0, STEPS, 12), res=(640, 320))


def main():
    set_up()
    losses = optimise()
    print(f"way      {-losses[0] - 0.25:.4f} -> {-losses[-1] - 0.25:.4f} (mean x - 0.25)")
    studio.plot_losses(args, losses)
    animate()


if __name__ == "__main__":
    main()
