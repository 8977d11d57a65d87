"""Where must the cue ball start, and how fast, for the last ball to reach the pocket?

Eleven balls collide by impulses, with time of impact: overlaps of a step are mended in the
very step. The unknowns are position and velocity of the cue ball at the start.

    python examples/billiards.py
    python examples/billiards.py --scan               # loss and gradient by the angle of the cue
    python examples/billiards.py --state compare

`--scan` shows a limit of gradients: where the last ball is never hit, the loss is flat, and
its gradient exactly 0. No descent leaves such a plain. (The paper speaks of kinetic energy
that is conserved; the coefficient of restitution is 0.8 in its program, and here.)
"""

import math
from typing import Any

import numpy as np
import tai as ti

import studio

options = studio.options(__doc__, "billiards", iterations=200, steps=1024, rate=0.01)
options.add_argument("--scan", action="store_true", help="no descent: loss and gradient by angle")
text = "of the scan, over a half circle and over 0.23 of it (1000)"
options.add_argument("--samples", type=studio.at_least(2), default=1000, help=text)
studio.add_states(options)
args = options.parse_args()

STEPS, DT = args.steps, 0.003
LAYERS, RADIUS, RESTITUTION = 4, 0.03, 0.8
POCKET = (0.9, 0.75)
CUE, PUSH = (0.1, 0.5), (0.3, 0.0)
RACK = [
    (0.5 + 2 * RADIUS * i, 0.5 + 2 * RADIUS * j - 0.7 * RADIUS * i)
    for i in range(LAYERS)
    for j in range(i + 1)
]
N = 1 + len(RACK)

studio.start(args)

SLOTS = 1 if args.in_place else STEPS
x = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
v = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
impulse = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
shift = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
cue = ti.Vector.field(2, float, shape=(), needs_grad=True)
push = ti.Vector.field(2, float, shape=(), needs_grad=True)
rack = ti.Vector.field(2, float, shape=N - 1)
loss = ti.field(float, shape=(), needs_grad=True)


@ti.func
def at(t: int):
    """The slot of a time."""
    return 0 if ti.static(args.in_place) else t


@ti.kernel
def place_balls():
    x[0, 0] = cue[None]
    v[0, 0] = push[None]
    for i in rack:
        x[0, i + 1] = rack[i]
        v[0, i + 1] = [0.0, 0.0]


@ti.kernel
def collide(t: int):
    """The pushes that each ball gets from all others in the step that leads to t."""
    for i in range(N):
        gained, moved = ti.Vector([0.0, 0.0]), ti.Vector([0.0, 0.0])
        xi, vi = x[at(t - 1), i], v[at(t - 1), i]
        for j in range(N):
            if i != j:
                xj, vj = x[at(t - 1), j], v[at(t - 1), j]
                way = (xi + DT * vi) - (xj + DT * vj)
                distance = way.norm()
                if distance < 2 * RADIUS:
                    normal = way / (distance + 1e-6)
                    speed = normal.dot(vi - vj)
                    if speed < 0:
                        kick = -0.5 * (1 + RESTITUTION) * speed * normal
                        toi = (distance - 2 * RADIUS) / ti.min(-1e-3, speed)
                        gained += kick
                        moved += ti.min(toi - DT, 0.0) * kick
        impulse[at(t), i] = gained
        shift[at(t), i] = moved


@ti.kernel
def integrate(t: int):
    for i in range(N):
        speed = v[at(t - 1), i] + impulse[at(t), i]
        x[at(t), i] = x[at(t - 1), i] + DT * speed + shift[at(t), i]
        v[at(t), i] = speed


@ti.kernel
def measure(t: int):
    loss[None] = (x[at(t), N - 1] - ti.Vector(POCKET)).norm_sqr()


def forward():
    place_balls()
    for t in range(1, STEPS):
        collide(t)
        integrate(t)
    measure(STEPS - 1)


def gradient():
    """The loss, and its gradients by position and velocity of the cue ball."""
    with studio.tape(args, loss):
        forward()
    return loss[None], cue.grad.to_numpy(), push.grad.to_numpy()


def iteration(_: int):
    value, by_place, by_speed = gradient()
    cue.from_numpy(cue.to_numpy() - args.rate * by_place)
    push.from_numpy(push.to_numpy() - args.rate * by_speed)
    slopes = zip(("dx", "dy", "dvx", "dvy"), [*by_place, *by_speed])
    return {"loss": value} | dict(slopes)


def set_up():
    rack.from_numpy(np.array(RACK))
    cue[None], push[None] = CUE, PUSH


def optimise():
    return studio.optimise(args, iteration, cue=cue, push=push)


def scan(part: float) -> tuple[Any, Any, Any]:
    """Loss and its derivative by the angle of the push, over a part of a half circle."""
    count: int = args.samples
    angles = ((np.arange(count) + 0.5) / count - 0.5) * math.pi * part
    losses: list[float] = []
    slopes: list[float] = []
    for angle in ti.tools.Progress(angles, f"scan {part}"):
        push[None] = 0.3 * math.cos(angle), 0.3 * math.sin(angle)
        value, _, (by_vx, by_vy) = gradient()
        losses.append(value)
        slopes.append(0.3 * (by_vy * math.cos(angle) - by_vx * math.sin(angle)))
    return np.degrees(angles), np.array(losses), np.array(slopes)


def show_scan(part: float):
    angles, losses, slopes = scan(part)
    flat = np.abs(losses - math.dist(RACK[-1], POCKET) ** 2) < 1e-6
    best = losses.argmin()
    text = f"{flat.sum()} of {len(flat)} angles never hit the last ball"
    if flat.any():
        text += f"; the largest slope among them is {np.abs(slopes[flat]).max():g}"
    print(f"scan     {text}")
    print(f"         least loss {losses[best]:.5f} at {angles[best]:.3f} degrees")
    name = f"scan_{part:g}"
    studio.table(args, name, angle=angles, loss=losses, slope=slopes)
    curve = {"loss": (angles, losses)}
    title = f"{flat.mean():.0%} of the angles miss the last ball"
    studio.plot(args, name, curve, x="angle of the cue (degrees)", y="loss", title=title, dots=True)


def ask_health():
    """The health report of a tape for a push that misses."""
    push[None] = 0.0, 0.3
    with ti.ad.Tape(loss, health=True) as tape:
        forward()
    for finding in tape.health().findings:
        print(f"health   {finding.message}")


def film():
    forward()
    place_balls()
    for t in range(1, STEPS):
        collide(t)
        integrate(t)
        if t % 8 == 0:
            yield x.to_numpy()[0 if args.in_place else t]


def draw(gui: ti.GUI, points: Any):
    gui.circle(POCKET, radius=22, color=studio.SOFT)
    gui.circles(points, radius=RADIUS * 480, color=studio.BLUE)
    gui.circle(points[0], radius=RADIUS * 480, color=studio.INK)
    gui.circle(points[-1], radius=RADIUS * 480, color=studio.RED)


def main():
    set_up()
    if args.scan:
        show_scan(1.0)
        show_scan(0.23)
        ask_health()
        return
    losses = optimise()
    (a, b), (c, d) = cue[None], push[None]
    print(f"cue      at ({a:.4f}, {b:.4f}) with velocity ({c:.4f}, {d:.4f})")
    studio.report_memory(args, x, v, impulse, shift)
    studio.plot_losses(args, losses, log=True)
    if args.picture:
        studio.animate(args, draw, film())


if __name__ == "__main__":
    main()
