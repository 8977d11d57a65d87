"""A soft robot of thirty thousand particles, with sixteen muscles in four legs, learns to walk.

The material point method (MLS-MPM) in three dimensions: particles carry mass, velocity and
deformation, a grid of 64³ nodes carries the forces between them. The muscles follow sine waves
whose weights are found by gradient descent, so that the robot gets as far along x as it can.

One grid serves all steps. Its values are gone when the reverse sweep needs them, so the gradient
of a step first repeats what filled the grid: `grad_replaced` and `grad_for`.

    python examples/diffmpm3d.py --steps 128 --iterations 10
    python examples/diffmpm3d.py                               # the paper's: 512 slots, 100 steps
"""

import math
import random
from argparse import Namespace
from collections.abc import Callable
from typing import Any

import numpy as np
import tai as ti

import studio
from splatter import Place, Splatter

N_GRID = 64
DX = 1 / N_GRID
DT = 2e-3
STIFFNESS = 10.0  # both Lamé parameters, and the bulk modulus of liquid
GRAVITY = 10.0
BOUND = 3  # nodes at each side in which nothing moves outward
N_WAVES = 4
FREQUENCY = 40.0
STRENGTH = 5.0  # of the muscles, which pull along z
SOLID_MASS, LIQUID_MASS = 1.0, 4.0


class Scene:
    """Boxes of particles, three to a cell and axis."""

    def __init__(self, density: float = 3):
        self.position: list[list[float]] = []
        self.muscle: list[int] = []
        self.solid: list[bool] = []
        self.density = density

    def box(self, corner: Place, size: Place, muscle: int = -1):
        """An elastic box; its muscle, -1 for none."""
        counts = [int(self.density * side / DX) for side in size]
        for cell in np.ndindex(*counts):
            where = [(c + 0.5) * side / n for c, side, n in zip(cell, size, counts, strict=True)]
            self._add(corner, where, muscle, solid=True)

    def pool(self, corner: Place, size: Place):
        """Liquid, at random places in a box."""
        for _ in range(math.prod(int(self.density * side / DX) for side in size)):
            self._add(corner, [random.random() * side for side in size], -1, solid=False)

    def _add(self, corner: Place, where: list[float], muscle: int, solid: bool):
        offset = (0.1, 0.05, 0.3)
        self.position.append([c + w + o for c, w, o in zip(corner, where, offset, strict=True)])
        self.muscle.append(muscle)
        self.solid.append(solid)

    def robot(self, block: float):
        """Four legs of four muscles each, and three boxes between them, without."""
        for leg in range(4):
            x, z = 2 * block * (leg // 2), 2 * block * (leg % 2)
            for part in range(4):
                corner = (x + block / 2 * (part // 2), 0.35 * block * (part % 2), z)
                self.box(corner, (block / 2, 0.35 * block, block), 4 * leg + part)
        for part in range(3):
            self.box((part * block, 0, block), (block, 0.7 * block, block))


@ti.func
def around(position: Any):
    """The first of the 27 nodes around a particle, and the particle's place from there.

    The nodes are of the grid also where too large a rate has thrown the particle out of it.
    """
    base = ti.math.clamp(ti.cast(position / DX - 0.5, ti.i32), 0, N_GRID - 3)
    return base, position / DX - base


@ti.func
def splines(fx: Any):
    """Weights of the three nodes along each axis: quadratic B-splines."""
    return [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]


@ti.data_oriented
class Simulation:
    """The fields of a scene, and its steps forward and in reverse."""

    def __init__(self, scene: Scene, steps: int):
        self.steps, self.count = steps, len(scene.position)
        self.muscles = max(scene.muscle) + 1
        self.solids = sum(scene.solid)
        # Particles, one slot for each step: position, velocity, velocity gradient, deformation.
        slots = (steps, self.count)
        self.x, self.v = (ti.Vector.field(3, float, slots, needs_grad=True) for _ in range(2))
        self.C, self.F = (ti.Matrix.field(3, 3, float, slots, needs_grad=True) for _ in range(2))
        self.muscle, self.solid = (ti.field(ti.i32, self.count) for _ in range(2))
        # The grid: momentum and mass, then velocity.
        nodes = (N_GRID, N_GRID, N_GRID)
        self.momentum, self.velocity = (
            ti.Vector.field(3, float, nodes, needs_grad=True) for _ in range(2)
        )
        self.mass = ti.field(float, nodes, needs_grad=True)
        # The parameters of the descent: the waves that a muscle follows.
        self.weights = ti.field(float, (self.muscles, N_WAVES), needs_grad=True)
        self.bias = ti.field(float, self.muscles, needs_grad=True)
        self.actuation = ti.field(float, (steps, self.muscles), needs_grad=True)
        self.loss = ti.field(float, (), needs_grad=True)

        self.load(np.array(scene.position), np.array(scene.muscle), np.array(scene.solid))

    @ti.kernel
    def load(
        self,
        position: ti.types.ndarray,
        muscle: ti.types.ndarray,
        solid: ti.types.ndarray,
    ):
        for p in range(self.count):
            self.x[0, p] = ti.Vector([position[p, 0], position[p, 1], position[p, 2]])
            self.F[0, p] = ti.Matrix.identity(float, 3)
            self.muscle[p] = ti.cast(muscle[p], ti.i32)
            self.solid[p] = ti.cast(solid[p], ti.i32)

    @ti.kernel
    def clear_grid(self):
        for node in ti.grouped(self.mass):
            self.momentum[node] = [0.0, 0.0, 0.0]
            self.mass[node] = 0.0

    @ti.kernel
    def clear_grid_gradient(self):
        for node in ti.grouped(self.mass):
            self.momentum.grad[node] = [0.0, 0.0, 0.0]
            self.mass.grad[node] = 0.0
            self.velocity.grad[node] = [0.0, 0.0, 0.0]

    @ti.kernel
    def actuate(self, t: ti.i32):
        """The muscles follow a weighted sum of waves."""
        for i in range(self.muscles):
            drive = self.bias[i]
            for j in ti.static(range(N_WAVES)):
                wave = ti.sin(FREQUENCY * t * DT + 2 * math.pi / N_WAVES * j)
                drive += self.weights[i, j] * wave
            self.actuation[t, i] = ti.tanh(drive)

    @ti.kernel
    def particles_to_grid(self, t: ti.i32):
        for p in range(self.count):
            base, fx = around(self.x[t, p])
            w = splines(fx)
            new_F = (ti.Matrix.identity(float, 3) + DT * self.C[t, p]) @ self.F[t, p]
            J = new_F.determinant()
            stress = ti.Matrix.zero(float, 3, 3)
            mass = 0.0
            if self.solid[p] == 1:  # neo-Hookean, and the pull of the muscle along z
                mass = SOLID_MASS
                stress = STIFFNESS * new_F @ new_F.transpose()
                pressure = STIFFNESS * (ti.log(J) - 1)
                for d in ti.static(range(3)):
                    stress[d, d] += pressure
                if self.muscle[p] >= 0:
                    along = ti.Vector([new_F[0, 2], new_F[1, 2], new_F[2, 2]])
                    pull = STRENGTH * self.actuation[t, self.muscle[p]]
                    stress += pull * along.outer_product(along)
            else:  # liquid forgets its shape, and keeps its volume
                mass = LIQUID_MASS
                root = ti.sqrt(J)
                new_F = ti.Matrix([[root, 0.0, 0.0], [0.0, root, 0.0], [0.0, 0.0, 1.0]])
                for d in ti.static(range(3)):
                    stress[d, d] = STIFFNESS * (J - 1)
            self.F[t + 1, p] = new_F
            affine = -DT * 4 / DX * stress + mass * DX * self.C[t, p]
            corner = mass * self.v[t, p] - affine @ fx  # the momentum for the first node
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                weight = w[i][0] * w[j][1] * w[k][2]
                self.momentum[base + offset] += weight * (corner + affine @ offset)
                self.mass[base + offset] += weight * mass

    @ti.kernel
    def update_grid(self):
        """Momentum becomes velocity; gravity; the walls are sticky."""
        for node in ti.grouped(self.mass):
            vel = self.momentum[node] / (self.mass[node] + 1e-10)
            vel[1] -= DT * GRAVITY
            for d in ti.static((0, 2, 1)):
                if node[d] < BOUND and vel[d] < 0:
                    vel = ti.Vector([0.0, 0.0, 0.0])
                if node[d] > N_GRID - BOUND and vel[d] > 0:
                    vel = ti.Vector([0.0, 0.0, 0.0])
            self.velocity[node] = vel

    @ti.kernel
    def grid_to_particles(self, t: ti.i32):
        for p in range(self.count):
            base, fx = around(self.x[t, p])
            w = splines(fx)
            v, new_C = ti.Vector.zero(float, 3), ti.Matrix.zero(float, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                share = w[i][0] * w[j][1] * w[k][2] * self.velocity[base + offset]
                v += share
                new_C += share.outer_product(offset)
            self.v[t + 1, p] = v
            self.C[t + 1, p] = 4 / DX * (new_C - v.outer_product(fx))
            self.x[t + 1, p] = self.x[t, p] + DT * v

    @ti.kernel
    def compute_loss(self):
        """How far the solids are, on average."""
        for p in range(self.count):
            if self.solid[p] == 1:
                self.loss[None] -= self.x[self.steps - 1, p][0] / self.solids

    @ti.kernel
    def descend(self, rate: float):
        for i, j in self.weights:
            self.weights[i, j] -= rate * self.weights.grad[i, j]
        for i in self.bias:
            self.bias[i] -= rate * self.bias.grad[i]

    @ti.ad.grad_replaced
    def advance(self, t: int):
        self.clear_grid()
        self.actuate(t)
        self.particles_to_grid(t)
        self.update_grid()
        self.grid_to_particles(t)

    @ti.ad.grad_for(advance)
    def advance_gradient(self, t: int):
        """Fills the grid again as it was in step t, then goes back through the step."""
        self.clear_grid()
        self.clear_grid_gradient()
        self.particles_to_grid(t)
        self.update_grid()

        self.grid_to_particles.grad(t)
        self.update_grid.grad()
        self.particles_to_grid.grad(t)
        self.actuate.grad(t)

    def forward(self):
        for t in range(self.steps - 1):
            self.advance(t)
        self.compute_loss()


def options(doc: str | None, name: str, iterations: int, rate: float) -> studio.Options:
    parser = studio.options(
        doc, name, iterations=iterations, steps=512, rate=rate, quick={"iterations": 2, "steps": 32}
    )
    text = "particles in a cell, along each axis (3); memory and time follow its cube"
    parser.add_argument("--density", type=studio.at_least(0.8, float), default=3, help=text)
    text = "weights at the start: random, or sines that need no generator (random)"
    parser.add_argument("--start", choices=["random", "sines"], default="random", help=text)
    text = "plays the result in a window, whose camera the mouse and W, A, S, D, E, Q move"
    parser.add_argument("--show", action="store_true", help=text)
    return parser


def learn(args: Namespace, simulation: Simulation):
    """Gradient descent on the waves."""
    i, j = np.arange(simulation.muscles)[:, None], np.arange(N_WAVES)
    np.random.seed(args.seed)
    start = np.random.randn(simulation.muscles, N_WAVES)
    if args.start == "sines":
        start = np.sin(12.9898 * i + 78.233 * j)
    simulation.weights.from_numpy(0.01 * start)
    weights, bias = simulation.weights, simulation.bias

    def iteration(_: int):
        with ti.ad.Tape(simulation.loss):
            simulation.forward()
        norms = [np.linalg.norm(learned.grad.to_numpy()) for learned in (weights, bias)]
        simulation.descend(args.rate)
        return {"loss": simulation.loss[None], "|dw|": norms[0], "|db|": norms[1]}

    losses = studio.optimise(args, iteration, weights=weights, bias=bias)
    studio.plot_losses(args, losses)


def animate(args: Namespace, simulation: Simulation):
    """The result as a movie; muscles are red when they pull and blue when they push."""
    if not (args.picture or args.show):
        return
    simulation.forward()
    positions, pulls = simulation.x.to_numpy(), simulation.actuation.to_numpy()
    muscle, solid = simulation.muscle.to_numpy(), simulation.solid.to_numpy()
    gloss = np.where(solid == 1, 0.1, 0.5)
    times = range(0, args.steps, 8)

    def colours(t: int) -> np.ndarray:
        pull = np.where(muscle >= 0, pulls[min(t, args.steps - 2), muscle], 0.0)
        rgb = ti.hex_to_rgb(np.where(solid == 1, studio.signed(1.5 * pull), studio.BLUE))
        return np.stack([*rgb, gloss], axis=-1).astype(np.float32)

    if args.picture:
        splatter = Splatter()
        frames = [splatter.picture(positions[t], colours(t)) for t in times]
        studio.movie(args, frames, framerate=20)
    if args.show:
        show(args, positions, colours, times)


def show(args: Namespace, positions: Any, colours: Callable[[int], Any], times: range):
    """Plays the result again and again until the window is closed; once where no window is."""
    window = ti.ui.Window(args.name, (960, 540), fps_limit=20, max_frames=len(times))
    canvas, scene, camera = window.get_canvas(), ti.ui.Scene(), ti.ui.Camera()
    canvas.set_background_color(ti.hex_to_rgb(studio.PAPER))
    camera.position(0.0, 0.62, 1.75)
    camera.lookat(0.35, 0.13, 0.45)
    camera.fov(35)
    ground = ti.hex_to_rgb(int(studio.blend(studio.PAPER, studio.SOFT, 0.4)))
    floor = np.array([[-1, 0, -1], [-1, 0, 2], [2, 0, 2], [2, 0, -1]]) + [0, BOUND * DX, 0]
    while window.running:
        t = times[window.frame % len(times)]
        camera.track_user_inputs(window, movement_speed=0.005, hold_key=ti.ui.LMB)
        scene.set_camera(camera)
        scene.ambient_light((0.55, 0.55, 0.55))
        scene.point_light(pos=(-1, 3, 2), color=(0.5, 0.5, 0.5))
        scene.particles(positions[t], 0.006, per_vertex_color=colours(t))
        scene.mesh(floor, np.array([0, 1, 2, 0, 2, 3]), color=ground)
        canvas.scene(scene)
        window.show()


def main():
    args = options(__doc__, "diffmpm3d", iterations=100, rate=30.0).parse_args()
    studio.start(args)
    scene = Scene(args.density)
    scene.robot(block=0.1)
    simulation = Simulation(scene, args.steps)
    print(f"robot    {simulation.count} particles, {simulation.muscles} muscles")
    learn(args, simulation)
    animate(args, simulation)


if __name__ == "__main__":
    main()
