"""How much of a simulation must be kept to go back through it? Five answers, side by side.

A block of jelly (MLS-MPM) is thrown so that its middle ends up at a given place; the unknown is
its velocity at the start. The reverse sweep needs states of the forward pass:

    stored    every step keeps its particles and a grid of its own
    grid      one grid: the gradient of a step fills it again first (by hand)
    segments  and particles of the first step of each segment alone: the gradient of a segment
              runs it again first (by hand)
    tape      all in place, one slot and one grid: the tape saves the overwritten values
    budget    in place, within --budget megabytes: the tape keeps snapshots, and recomputes

    python examples/checkpointing.py                    # memory and time of each, same gradient
    python examples/checkpointing.py --scheme segments  # descent by one of them
"""

import time
from typing import Any

import numpy as np
import tai as ti

import studio

SCHEMES = ["stored", "grid", "segments", "tape", "budget"]

parser = studio.options(__doc__, "checkpointing", iterations=30, steps=1024, rate=10.0)
parser.add_argument("--scheme", choices=["all", *SCHEMES], default="all", help="one of them (all)")
text = "particles along a side (80); 180 reach the wall"
parser.add_argument("--side", type=studio.at_least(1, most=180), default=80, help=text)
text = "steps of a segment (32, the root of 1024)"
parser.add_argument("--segment", type=studio.at_least(1), default=32, help=text)
text = "megabytes that the tape may keep (50)"
parser.add_argument(
    "--budget", type=studio.at_least(0.001, float, most=1e12), default=50.0, help=text
)
args = parser.parse_args()
studio.start(args)

STEPS, SIDE, SEGMENT = args.steps, args.side, min(args.segment, args.steps - 1)
N = SIDE * SIDE
N_GRID = 120
DX = 1 / N_GRID
DT = 3e-4
STIFFNESS = 100.0  # both Lamé parameters
GRAVITY = 9.8
BOUND = 3
TARGET = (0.3, 0.6)

push = ti.Vector.field(2, float, shape=(), needs_grad=True)  # the unknown
middle = ti.Vector.field(2, float, shape=(), needs_grad=True)
loss = ti.field(float, shape=(), needs_grad=True)


@ti.func
def around(position: Any):
    """The first of the nine nodes around a particle, its place from there, and the weights.

    The nodes are of the grid also where too large a rate has thrown the particle out of it.
    """
    base = ti.math.clamp(ti.cast(position / DX - 0.5, ti.i32), 0, N_GRID - 3)
    fx = position / DX - base
    return base, fx, [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]


@ti.data_oriented
class Block:
    """The block, with as many slots and grids as a scheme keeps."""

    def __init__(self, scheme: str):
        self.scheme = scheme
        self.slots = {"stored": STEPS, "grid": STEPS, "segments": SEGMENT + 1}.get(scheme, 1)
        self.grids = STEPS - 1 if scheme == "stored" else 1
        self.ahead = int(self.slots > 1)  # from a step's slot to the next one
        self.last = STEPS - 1 if scheme in ("stored", "grid") else 0
        self.segments = -(-(STEPS - 1) // SEGMENT) if scheme == "segments" else 0
        shape, grid = (self.slots, N), (self.grids, N_GRID, N_GRID)
        self.x, self.v = (ti.Vector.field(2, float, shape, needs_grad=True) for _ in range(2))
        self.C, self.F = (ti.Matrix.field(2, 2, float, shape, needs_grad=True) for _ in range(2))
        self.momentum, self.velocity = (
            ti.Vector.field(2, float, grid, needs_grad=True) for _ in range(2)
        )
        self.mass = ti.field(float, grid, needs_grad=True)
        if self.segments:
            kept = (self.segments, N)
            self.kept_x, self.kept_v = (ti.Vector.field(2, float, kept) for _ in range(2))
            self.kept_C, self.kept_F = (ti.Matrix.field(2, 2, float, kept) for _ in range(2))
        size = 8 if args.double else 4
        numbers = 12 * N * (2 * self.slots + self.segments) + 2 * 5 * N_GRID**2 * self.grids
        self.megabytes = size * numbers / 1e6

    @ti.kernel
    def throw(self):
        for p in range(N):
            place = ti.Vector([0.5 * (p // SIDE) + 10, 0.5 * (p % SIDE) + 25])
            self.x[0, p] = DX * place
            self.v[0, p] = push[None]
            self.C[0, p] = ti.Matrix.zero(float, 2, 2)
            self.F[0, p] = ti.Matrix.identity(float, 2)

    @ti.kernel
    def clear_grid(self, g: ti.i32):
        for i, j in ti.ndrange(N_GRID, N_GRID):
            self.momentum[g, i, j] = [0.0, 0.0]
            self.mass[g, i, j] = 0.0

    @ti.kernel
    def particles_to_grid(self, s: ti.i32, g: ti.i32):
        for p in range(N):
            base, fx, w = around(self.x[s, p])
            F = (ti.Matrix.identity(float, 2) + DT * self.C[s, p]) @ self.F[s, p]
            J = F.determinant()
            R, _ = ti.polar_decompose(F)
            stress = 2 * STIFFNESS * (F - R) @ F.transpose()
            stress += STIFFNESS * (J - 1) * J * ti.Matrix.identity(float, 2)
            affine = -DT * 4 / DX * stress + DX * self.C[s, p]
            corner = self.v[s, p] - affine @ fx  # the momentum for the first node
            self.F[s + self.ahead, p] = F
            for i, j in ti.static(ti.ndrange(3, 3)):
                weight = w[i][0] * w[j][1]
                momentum = weight * (corner + affine @ ti.Vector([i, j]))
                self.momentum[g, base[0] + i, base[1] + j] += momentum
                self.mass[g, base[0] + i, base[1] + j] += weight

    @ti.kernel
    def update_grid(self, g: ti.i32):
        """Momentum becomes velocity; gravity; the walls let slip."""
        for i, j in ti.ndrange(N_GRID, N_GRID):
            vel = self.momentum[g, i, j] / (self.mass[g, i, j] + 1e-10)
            vel[1] -= DT * GRAVITY
            if (i < BOUND and vel[0] < 0) or (i > N_GRID - BOUND and vel[0] > 0):
                vel[0] = 0.0
            if (j < BOUND and vel[1] < 0) or (j > N_GRID - BOUND and vel[1] > 0):
                vel[1] = 0.0
            self.velocity[g, i, j] = vel

    @ti.kernel
    def grid_to_particles(self, s: ti.i32, g: ti.i32):
        for p in range(N):
            base, fx, w = around(self.x[s, p])
            v, new_C = ti.Vector.zero(float, 2), ti.Matrix.zero(float, 2, 2)
            for i, j in ti.static(ti.ndrange(3, 3)):
                share = w[i][0] * w[j][1] * self.velocity[g, base[0] + i, base[1] + j]
                v += share
                new_C += share.outer_product(ti.Vector([i, j]))
            self.v[s + self.ahead, p] = v
            self.C[s + self.ahead, p] = 4 / DX * (new_C - v.outer_product(fx))
            self.x[s + self.ahead, p] = self.x[s, p] + DT * v

    @ti.kernel
    def find_middle(self, s: ti.i32):
        for p in range(N):
            middle[None] += self.x[s, p] / N

    def step(self, s: int, g: int):
        self.clear_grid(g)
        self.particles_to_grid(s, g)
        self.update_grid(g)
        self.grid_to_particles(s, g)

    # One grid, by hand.

    def step_in_reverse(self, s: int):
        """Fills the grid as it was, then goes back through the step."""
        self.clear_grid(0)
        self.clear_grid_gradient()
        self.particles_to_grid(s, 0)
        self.update_grid(0)

        self.grid_to_particles.grad(s, 0)
        self.update_grid.grad(0)
        self.particles_to_grid.grad(s, 0)

    @ti.kernel
    def clear_grid_gradient(self):
        for i, j in ti.ndrange(N_GRID, N_GRID):
            self.momentum.grad[0, i, j] = [0.0, 0.0]
            self.mass.grad[0, i, j] = 0.0
            self.velocity.grad[0, i, j] = [0.0, 0.0]

    # Segments, by hand: a segment begins in slot 0, and its end goes back there.

    def segment(self, number: int):
        self.keep(number)
        for s in range(self.length(number)):
            self.step(s, 0)
        self.carry(self.length(number))

    def segment_in_reverse(self, number: int):
        """Runs the segment again, then goes back through its steps."""
        length = self.length(number)
        self.restore(number)
        for s in range(length):
            self.step(s, 0)
        self.carry_gradient(length)
        for s in reversed(range(length)):
            self.step_in_reverse(s)

    def length(self, number: int):
        return min(SEGMENT, STEPS - 1 - number * SEGMENT)

    @ti.kernel
    def keep(self, number: ti.i32):
        for p in range(N):
            self.kept_x[number, p], self.kept_v[number, p] = self.x[0, p], self.v[0, p]
            self.kept_C[number, p], self.kept_F[number, p] = self.C[0, p], self.F[0, p]

    @ti.kernel
    def restore(self, number: ti.i32):
        for p in range(N):
            self.x[0, p], self.v[0, p] = self.kept_x[number, p], self.kept_v[number, p]
            self.C[0, p], self.F[0, p] = self.kept_C[number, p], self.kept_F[number, p]

    @ti.kernel
    def carry(self, s: ti.i32):
        for p in range(N):
            self.x[0, p], self.v[0, p] = self.x[s, p], self.v[s, p]
            self.C[0, p], self.F[0, p] = self.C[s, p], self.F[s, p]

    @ti.kernel
    def carry_gradient(self, s: ti.i32):
        """The gradient that came back to slot 0 belongs to the end of the segment."""
        for p in range(N):
            self.x.grad[s, p], self.v.grad[s, p] = self.x.grad[0, p], self.v.grad[0, p]
            self.C.grad[s, p], self.F.grad[s, p] = self.C.grad[0, p], self.F.grad[0, p]
            for r in range(s):
                self.x.grad[r, p], self.v.grad[r, p] = [0.0, 0.0], [0.0, 0.0]
                self.C.grad[r, p] = ti.Matrix.zero(float, 2, 2)
                self.F.grad[r, p] = ti.Matrix.zero(float, 2, 2)

    # All schemes.

    def forward(self):
        middle[None] = [0.0, 0.0]
        self.throw()
        if self.scheme == "segments":
            for number in range(self.segments):
                self.segment(number)
        else:
            for t in range(STEPS - 1):
                self.step(t * self.ahead, t if self.scheme == "stored" else 0)
        self.find_middle(self.last)
        compute_loss()

    def reverse(self):
        """Does by hand the work of a tape."""
        ti.ad.clear_all_gradients()
        loss.grad[None] = 1.0
        compute_loss.grad()
        self.find_middle.grad(self.last)
        if self.scheme == "segments":
            for number in reversed(range(self.segments)):
                self.segment_in_reverse(number)
        else:
            for t in reversed(range(STEPS - 1)):
                self.step_in_reverse(t)
        self.throw.grad()

    def gradient(self):
        """Forward and back; the megabytes that the tape had kept at most."""
        if self.scheme in ("grid", "segments"):
            self.forward()
            self.reverse()
            return 0.0
        budget = int(args.budget * 1e6) if self.scheme == "budget" else None
        with ti.ad.Tape(loss, memory_budget=budget) as tape:
            self.forward()
        return tape.stats().peak_bytes / 1e6


@ti.kernel
def compute_loss():
    loss[None] = 0.5 * (middle[None] - ti.Vector(TARGET)).norm_sqr()


def compare():
    """One gradient by each scheme."""
    for scheme in SCHEMES:
        push[None] = [0.0, 0.0]
        block = Block(scheme)
        block.gradient()  # compiles
        begin = time.perf_counter()
        kept = block.gradient()
        ti.sync()
        seconds = time.perf_counter() - begin
        memory = f"{block.megabytes:8.1f} MB of fields, {kept:6.1f} MB on the tape"
        slope = " ".join(f"{number:.6f}" for number in push.grad[None])
        print(f"{scheme:9}{memory}, {seconds:6.2f} s, loss {loss[None]:.6f}, gradient {slope}")


def optimise(block: Block):
    """Gradient descent on the velocity; returns the losses."""

    def iteration(_: int):
        block.gradient()
        slope = np.array(push.grad[None])
        push[None] = np.array(push[None]) - args.rate * slope
        return {"loss": loss[None], "|dv|": np.linalg.norm(slope)}

    return studio.optimise(args, iteration, push=push)


def main():
    if args.scheme == "all":
        compare()
        return
    losses = optimise(Block(args.scheme))
    studio.plot_losses(args, losses, log=True)


if __name__ == "__main__":
    main()
