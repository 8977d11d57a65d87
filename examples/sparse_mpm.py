"""How hard must a ball of jelly be thrown to land where it should, in a room of any size?

The ball is elastic and simulated by the material point method (MLS-MPM). Its grid covers the
whole room, but only blocks of 8×8 nodes that the ball touches are in use: a `pointer` level
above a `dense` one. The time of a step follows the ball, and not the room, which the program
shows with two rooms.

The unknown is the velocity at the start, and the ball bounces before it lands. One grid serves all
steps, and its blocks are dropped after each: the tape keeps the overwritten values, and goes back
through the same blocks.

    python examples/sparse_mpm.py
    python examples/sparse_mpm.py --room 1024 --large 65536
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
import tai as ti

import studio

parser = studio.plain(__doc__)
add, least = parser.add_argument, studio.at_least
add("--room", type=least(8), default=128, help="nodes along a side (128)")
add("--large", type=least(8), default=16384, help="those of the large room (16384)")
add("--steps", type=least(2), default=400, help="time slots (400)")
add("--iterations", type=least(1), default=12, help="steps of descent (12)")
add("--rate", type=least(0, float), default=2.0, help="learning rate (2)")
add("--double", action="store_true", help="64-bit numbers")
add("--check", action="store_true", help="compare with finite differences")
add("--out", type=Path, default=Path("out"), help="folder of the picture")
args = parser.parse_args()

STEPS, BLOCK = args.steps, 8
DX, DT = 1 / 64, 1e-3
STIFFNESS, GRAVITY = 20.0, 9.8
FLOOR = 3  # nodes at the walls in which nothing moves outward
CENTRE, RADIUS, TARGET = np.array([0.3, 0.35]), 0.12, (1.25, 0.35)
REAL = ti.f64 if args.double else ti.f32


class Ball:
    """The simulation in a room of `nodes` × `nodes`."""

    def __init__(self, nodes: int):
        ti.init(arch=ti.cpu)
        side = np.arange(-RADIUS, RADIUS, DX / 2) + DX / 4
        grid = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
        self.start = CENTRE + grid[(grid**2).sum(1) < RADIUS**2]
        self.nodes, count = nodes, len(self.start)
        # Particles, one slot for each step.
        x, v = (ti.Vector.field(2, REAL, (STEPS, count), needs_grad=True) for _ in range(2))
        C, F = (ti.Matrix.field(2, 2, REAL, (STEPS, count), needs_grad=True) for _ in range(2))
        push = ti.Vector.field(2, REAL, (), needs_grad=True)
        mean = ti.Vector.field(2, REAL, (), needs_grad=True)
        loss = ti.field(REAL, (), needs_grad=True)
        # The grid: momentum, mass, velocity.
        momentum, velocity = (ti.Vector.field(2, REAL) for _ in range(2))
        mass = ti.field(REAL)
        blocks = ti.root.pointer(ti.ij, -(-nodes // BLOCK))
        blocks.dense(ti.ij, BLOCK).place(momentum, mass, velocity)
        blocks.dense(ti.ij, BLOCK).place(momentum.grad, mass.grad, velocity.grad)
        self.x, self.F, self.push, self.loss, self.blocks = x, F, push, loss, blocks

        @ti.func
        def weights(fx: Any):
            return [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]

        @ti.kernel
        def throw():
            for p in range(count):
                v[0, p] = push[None]

        @ti.kernel
        def to_grid(t: ti.i32):
            """Writing to a node makes its block active."""
            for p in range(count):
                base = ti.cast(x[t, p] / DX - 0.5, ti.i32)
                fx = x[t, p] / DX - ti.cast(base, REAL)
                w = weights(fx)
                new_F = (ti.Matrix.identity(REAL, 2) + DT * C[t, p]) @ F[t, p]
                F[t + 1, p] = new_F
                J = new_F.determinant()
                R, _ = ti.polar_decompose(new_F)
                stress = 2 * STIFFNESS * (new_F - R) @ new_F.transpose()
                stress += STIFFNESS * (J - 1) * J * ti.Matrix.identity(REAL, 2)
                affine = -DT * 4 / DX**2 * stress + C[t, p]
                for i, j in ti.static(ti.ndrange(3, 3)):
                    way = (ti.Vector([i, j]) - fx) * DX
                    weight = w[i][0] * w[j][1]
                    momentum[base + ti.Vector([i, j])] += weight * (v[t, p] + affine @ way)
                    mass[base + ti.Vector([i, j])] += weight

        @ti.kernel
        def on_grid():
            """Over the active blocks: momentum becomes velocity; gravity; walls."""
            for i, j in mass:
                if mass[i, j] > 0:
                    out = momentum[i, j] / mass[i, j]
                    out[1] -= DT * GRAVITY
                    if i < FLOOR:
                        out[0] = ti.max(out[0], 0)
                    if i > nodes - FLOOR:
                        out[0] = ti.min(out[0], 0)
                    if j < FLOOR:
                        out[1] = ti.max(out[1], 0)
                    if j > nodes - FLOOR:
                        out[1] = ti.min(out[1], 0)
                    velocity[i, j] = out

        @ti.kernel
        def to_particles(t: ti.i32):
            for p in range(count):
                base = ti.cast(x[t, p] / DX - 0.5, ti.i32)
                fx = x[t, p] / DX - ti.cast(base, REAL)
                w = weights(fx)
                new_v = ti.Vector.zero(REAL, 2)
                new_C = ti.Matrix.zero(REAL, 2, 2)
                for i, j in ti.static(ti.ndrange(3, 3)):
                    node = velocity[base + ti.Vector([i, j])]
                    weight = w[i][0] * w[j][1]
                    new_v += weight * node
                    new_C += 4 / DX * weight * node.outer_product(ti.Vector([i, j]) - fx)
                v[t + 1, p] = new_v
                x[t + 1, p] = x[t, p] + DT * new_v
                C[t + 1, p] = new_C

        @ti.kernel
        def find_mean():
            for p in range(count):
                mean[None] += x[STEPS - 1, p] / count

        @ti.kernel
        def find_loss():
            loss[None] = (mean[None] - ti.Vector(TARGET)).norm_sqr()

        def forward():
            mean[None] = [0, 0]
            throw()
            for t in range(STEPS - 1):
                blocks.deactivate_all()
                to_grid(t)
                on_grid()
                to_particles(t)
            find_mean()
            find_loss()

        self.forward = forward
        slots = np.zeros((STEPS, count, 2))
        slots[0] = self.start
        x.from_numpy(slots)
        F.from_numpy(np.broadcast_to(np.eye(2), (STEPS, count, 2, 2)))

    def gradient(self, push: Any):
        """The loss of a throw, and its derivative."""
        self.push[None] = push
        with ti.ad.Tape(self.loss):
            self.forward()
        return self.loss[None], self.push.grad.to_numpy()

    def loss_of(self, push: Any):
        self.push[None] = push
        self.forward()
        return self.loss[None]


def measure(nodes: int, push: Any):
    """A simulation, and the cost of a step."""
    ball = Ball(nodes)
    ball.gradient(push)
    begin = time.perf_counter()
    value, slope = ball.gradient(push)
    took = (time.perf_counter() - begin) / STEPS
    used, all_blocks = ball.blocks.peak_active, (-(-nodes // BLOCK)) ** 2
    print(
        f"room     {nodes:6d}²: {1e3 * took:.3f} ms per step and its gradient, "
        f"at most {used} of {all_blocks} blocks, loss {value:.6f}"
    )
    return ball, value, slope


def check(ball: Ball, push: Any, slope: Any):
    """The gradient against central differences."""
    step = 1e-6 if args.double else 1e-2
    for axis in range(2):
        ends = [ball.loss_of(push + side * step * np.eye(2)[axis]) for side in (-1, 1)]
        difference = (ends[1] - ends[0]) / (2 * step)
        print(f"check    along {'xy'[axis]}: {slope[axis]:.8f}, differences {difference:.8f}")


def animate(ball: Ball, path: Path):
    """The flight as a GIF, over the blocks that are in use."""
    width = 2.0
    gui = ti.GUI("sparse_mpm", res=(640, 320), background_color=studio.PAPER)
    frames: list[Any] = []
    for t in range(0, STEPS, max(1, STEPS // 40)):
        points = ball.x.to_numpy()[t]
        # The nodes that the particles touch, and their blocks.
        base = (points / DX - 0.5).astype(int)
        touched = {tuple(b) for shift in (0, 2) for b in ((base + shift) // BLOCK).tolist()}
        span = BLOCK * DX / width * np.array([1, 2])
        for block in touched:
            gui.rect(np.array(block) * span, (np.array(block) + 1) * span, color=studio.SOFT)
        gui.line((0, 2 * FLOOR * DX / width), (1, 2 * FLOOR * DX / width), color=studio.SOFT)
        gui.circle(np.array(TARGET) / width * [1, 2], radius=4, color=studio.RED)
        gui.circles(points / width * [1, 2], radius=1.4, color=studio.BLUE)
        frames.append(gui.picture())
        gui.show()
    ti.tools.write_gif(frames + frames[-1:] * 10, str(path), framerate=20)


def main():
    push = np.array([1.5, -1.0])
    measure(args.large, push)
    ball, value, slope = measure(args.room, push)
    if args.check:
        check(ball, push, slope)
    first = value
    for _ in ti.tools.Progress(range(args.iterations), "sparse_mpm"):
        push = push - args.rate * slope
        value, slope = ball.gradient(push)
    print(f"throw    ({push[0]:.4f}, {push[1]:.4f})")
    print(f"loss     {first:.6f} -> {value:.6f}")
    args.out.mkdir(parents=True, exist_ok=True)
    picture = args.out / "sparse_mpm.gif"
    animate(ball, picture)
    print(f"picture  {picture.resolve()}")
    ti.profiler.print_skips()


if __name__ == "__main__":
    main()
