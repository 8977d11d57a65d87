"""Three masses, three springs, and one question: how long must the springs be at rest
for the triangle to cover a given area after a second?

The simulator is a few lines; the compiler makes its gradient, and gradient descent on the
three rest lengths does the rest.

    python examples/mass_spring_simple.py                # area 0.1
    python examples/mass_spring_simple.py --target 0.2
"""

import argparse
import math
from pathlib import Path

import tai as ti

N_POINTS, N_SPRINGS = 3, 3
STEPS = 1024
DT = 1e-3
STIFFNESS = 10.0
DAMPING = 20.0

POINTS = [(0.3, 0.5), (0.3, 0.4), (0.4, 0.4)]
SPRINGS = [(0, 1, 0.1), (1, 2, 0.1), (2, 0, 0.1 * math.sqrt(2))]

ti.init(arch=ti.cpu)

# State: one slot for each step, so that the reverse sweep finds every value it needs.
x = ti.Vector.field(2, ti.f32)
v = ti.Vector.field(2, ti.f32)
force = ti.Vector.field(2, ti.f32)
ti.root.dense(ti.i, STEPS).dense(ti.j, N_POINTS).place(x, v, force)

anchor_a = ti.field(ti.i32)
anchor_b = ti.field(ti.i32)
rest_length = ti.field(ti.f32)
ti.root.dense(ti.i, N_SPRINGS).place(anchor_a, anchor_b, rest_length)

target = ti.field(ti.f32)
loss = ti.field(ti.f32)
ti.root.place(target, loss)
ti.root.lazy_grad()


@ti.kernel
def clear_forces():
    for t, i in force:
        force[t, i] = ti.Vector([0.0, 0.0])


@ti.kernel
def apply_springs(t: ti.i32):
    """Hooke's law, from the positions of the step before."""
    for i in range(N_SPRINGS):
        a, b = anchor_a[i], anchor_b[i]
        way = x[t - 1, a] - x[t - 1, b]
        length = way.norm() + 1e-4
        f = STIFFNESS * (length - rest_length[i]) / length * way
        force[t, a] -= f
        force[t, b] += f


@ti.kernel
def integrate(t: ti.i32):
    for i in range(N_POINTS):
        v[t, i] = math.exp(-DT * DAMPING) * v[t - 1, i] + DT * force[t, i]
        x[t, i] = x[t - 1, i] + DT * v[t, i]


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


def set_up(area):
    for i, position in enumerate(POINTS):
        x[0, i] = position
        v[0, i] = (0.0, 0.0)
    for i, (a, b, length) in enumerate(SPRINGS):
        anchor_a[i], anchor_b[i], rest_length[i] = a, b, length
    target[None] = area


def optimise(iterations, learning_rate):
    """Gradient descent on the rest lengths; returns the losses."""
    losses = []
    bar = ti.tools.Progress(range(iterations), "mass_spring_simple")
    for _ in bar:
        with ti.ad.Tape(loss):
            forward()
        losses.append(loss[None])
        for i in range(N_SPRINGS):
            rest_length[i] -= learning_rate * rest_length.grad[i]
        bar.note(f"loss {losses[-1]:.2e}")
    return losses


def draw(gui, t):
    """The triangle at step t; springs are red when stretched and blue when pressed."""
    points = x.to_numpy()[t]
    for i in range(N_SPRINGS):
        a, b = points[anchor_a[i]], points[anchor_b[i]]
        strain = float(math.dist(a, b) / rest_length[i] - 1)
        color = ti.rgb_to_hex((0.45 + 2 * strain, 0.45, 0.45 - 2 * strain))
        gui.line(a, b, radius=3, color=color)
    gui.circles(points, radius=7, color=0x2B3A55)
    gui.text(f"t = {t * DT:.2f} s", (0.03, 0.97), font_size=18, color=0x2B3A55)


def animate(path):
    """One simulation with the rest lengths that were found, as a GIF."""
    forward()
    gui = ti.GUI("mass_spring_simple", res=360, background_color=0xF4F1EA)
    frames = []
    for t in range(0, STEPS, 16):
        draw(gui, t)
        frames.append(gui.picture())
        gui.show()
    ti.tools.write_gif(frames + frames[-1:] * 15, str(path), framerate=20)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--target", type=float, default=0.1, help="area wanted (0.1)")
    parser.add_argument("--iterations", type=int, default=25, help="steps of descent (25)")
    parser.add_argument("--rate", type=float, default=5.0, help="learning rate (5)")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the picture")
    args = parser.parse_args()

    set_up(args.target)
    losses = optimise(args.iterations, args.rate)
    lengths = [rest_length[i] for i in range(N_SPRINGS)]
    print(f"loss          {losses[0]:.3e} -> {losses[-1]:.3e}")
    print(f"rest lengths  [{', '.join(f'{length:.3f}' for length in lengths)}]")

    args.out.mkdir(parents=True, exist_ok=True)
    picture = args.out / "mass_spring_simple.gif"
    animate(picture)
    print(f"picture       {picture.resolve()}")


if __name__ == "__main__":
    main()
