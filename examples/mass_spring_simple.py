"""Three masses, three springs, and one question: how long must the springs be at rest
for the triangle to cover a given area after a second?

The simulator is a few lines; the compiler makes its gradient, and gradient descent on the
three rest lengths does the rest.

    python examples/mass_spring_simple.py                # area 0.1
    python examples/mass_spring_simple.py --target 0.2 --iterations 200
    python examples/mass_spring_simple.py --wall

The paper's text speaks of an area of 0.2 and 200 steps of descent; the rest lengths that it
prints, [0.600, 0.600, 0.529], are those of area 0.1 after 25. Its program has a wall besides,
at x = 0.4, which stops what moves to the right beyond it: `--wall`.
"""

import math

import tai as ti

import studio

options = studio.options(__doc__, "mass_spring_simple", iterations=25, steps=1024, rate=5.0)
options.add_argument(
    "--target", type=studio.at_least(0, float), default=0.1, help="area wanted (0.1)"
)
options.add_argument("--wall", action="store_true", help="with the wall of the paper's program")
args = options.parse_args()

N_POINTS, N_SPRINGS = 3, 3
STEPS = args.steps
DT = 1e-3
STIFFNESS = 10.0
DAMPING = 20.0
WALL, FRICTION = 0.4, 0.01

POINTS = [(0.3, 0.5), (0.3, 0.4), (0.4, 0.4)]
SPRINGS = [(0, 1, 0.1), (1, 2, 0.1), (2, 0, 0.1 * math.sqrt(2))]

studio.start(args)

# State: one slot for each step, so that the reverse sweep finds every value it needs.
x = ti.Vector.field(2, float)
v = ti.Vector.field(2, float)
force = ti.Vector.field(2, float)
ti.root.dense(ti.i, STEPS).dense(ti.j, N_POINTS).place(x, v, force)

anchor_a = ti.field(ti.i32)
anchor_b = ti.field(ti.i32)
rest_length = ti.field(float)
ti.root.dense(ti.i, N_SPRINGS).place(anchor_a, anchor_b, rest_length)

target = ti.field(float)
loss = ti.field(float)
ti.root.place(target, loss)
ti.root.lazy_grad()


@ti.kernel
def clear_forces():
    for t, i in force:
        force[t, i] = ti.Vector([0.0, 0.0])


@ti.kernel
def apply_springs(t: int):
    """Hooke's law, from the positions of the step before."""
    for i in range(N_SPRINGS):
        a, b = anchor_a[i], anchor_b[i]
        way = x[t - 1, a] - x[t - 1, b]
        length = way.norm() + 1e-4
        f = STIFFNESS * (length - rest_length[i]) / length * way
        force[t, a] -= f
        force[t, b] += f


@ti.kernel
def integrate(t: int):
    for i in range(N_POINTS):
        v[t, i] = math.exp(-DT * DAMPING) * v[t - 1, i] + DT * force[t, i]
        x[t, i] = x[t - 1, i] + DT * v[t, i]
        if ti.static(args.wall):
            if x[t, i][0] > WALL and v[t, i][0] > 0:
                rub = FRICTION * v[t, i][0]
                v[t, i] = [0.0, v[t, i][1] - ti.max(ti.min(v[t, i][1], rub), -rub)]


@ti.kernel
def compute_loss():
    """The squared difference between the triangle's area and the one that we want."""
    a = x[STEPS - 1, 1] - x[STEPS - 1, 0]
    b = x[STEPS - 1, 2] - x[STEPS - 1, 0]
    area = 0.5 * ti.abs(a.cross(b))
    loss[None] = (area - target[None]) ** 2


def forward():
    clear_forces()
    for t in range(1, STEPS):
        apply_springs(t)
        integrate(t)
    compute_loss()


def set_up(area: float):
    for i, position in enumerate(POINTS):
        x[0, i] = position
        v[0, i] = (0.0, 0.0)
    for i, (a, b, length) in enumerate(SPRINGS):
        anchor_a[i], anchor_b[i], rest_length[i] = a, b, length
    target[None] = area


def iteration(_: int):
    with ti.ad.Tape(loss):
        forward()
    for i in range(N_SPRINGS):
        rest_length[i] -= args.rate * rest_length.grad[i]
    return loss[None]


def optimise():
    return studio.optimise(args, iteration, rest_length=rest_length)


def draw(gui: ti.GUI, t: int):
    """The triangle at step t; springs are red when stretched and blue when pressed."""
    points = x.to_numpy()[t]
    if args.wall:
        gui.line((WALL, 0), (WALL, 1), radius=1, color=studio.SOFT)
    for i in range(N_SPRINGS):
        a, b = points[anchor_a[i]], points[anchor_b[i]]
        strain = math.dist(a, b) / rest_length[i] - 1
        gui.line(a, b, radius=3, color=int(studio.signed(4 * strain)))
    gui.circles(points, radius=7, color=studio.INK)
    gui.text(f"t = {t * DT:.2f} s", (0.03, 0.97), font_size=18, color=studio.INK)


def main():
    set_up(args.target)
    losses = optimise()
    lengths = [rest_length[i] for i in range(N_SPRINGS)]
    print(f"rest lengths  [{', '.join(f'{length:.3f}' for length in lengths)}]")
    studio.plot_losses(args, losses, log=True)
    if args.picture:
        forward()
        studio.animate(args, draw, range(0, STEPS, 16), res=(360, 360), framerate=20)


if __name__ == "__main__":
    main()
