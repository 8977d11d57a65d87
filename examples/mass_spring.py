"""Robots of springs learn to walk.

Point masses and springs; some springs are muscles, whose rest lengths a small neural network
sets in each time step, from where the points are and from a few waves that keep time. Gradient
descent through all steps, collisions with the floor among them, finds the weights that carry
point 0 furthest to the right.

A point that meets the floor stays there. `--toi` (the default) moves it up to the very instant
of the impact; `--no-toi` lets it fall through the floor for a part of a step. The heights
differ by next to nothing, the gradients by a lot.

    python examples/mass_spring.py
    python examples/mass_spring.py --robot 3 --no-toi
    python examples/mass_spring.py --state compare    # memory: time slots, or updates in place

The paper speaks of 2048 steps, its program runs 682. Each step of descent has the same length
(0.2), whatever the length of the gradient.
"""

import math
from argparse import BooleanOptionalAction
from typing import Any

import numpy as np
import tai as ti

import studio

# Points, and springs as pairs of them; a star marks a muscle.
ROBOT_1 = """ .225,.125 .2,.15 .25,.15 .125,.125 .1,.15 .15,.15 .1,.2 .15,.2 .1,.25 .15,.25 .2,.2
    .2,.25 .25,.2 .25,.25 """
SPRINGS_1 = """ 0-1 0-2 1-2 3-4 3-5 4-5 4-6* 5-7* 4-7 6-5 6-7 6-8 7-9 6-9 8-7 8-9 10-11 7-10 7-11
    9-10 9-11 1-10* 2-12* 1-12 10-2 10-12 12-13 10-13 11-12 11-13 """
ROBOT_2 = """ .2,.1 .2,.15 .25,.1 .25,.15 .1,.1 .1,.15 .15,.1 .15,.15 .1,.2 .15,.2 .1,.25 .15,.25
    .2,.2 .2,.25 .25,.2 .25,.25 .2,.3 .25,.3 .2,.35 .25,.35 """
SPRINGS_2 = """ 0-1* 2-3* 0-2 0-3 1-2 1-3 4-5* 6-7* 4-6 4-7 5-6 5-7 5-8* 7-9* 5-9 8-7 8-9 8-10 9-11
    8-11 10-9 10-11 12-13 9-12 9-13 11-12 11-13 1-12* 3-14* 1-14 12-3 12-14 14-15 12-15 13-14
    13-15 13-16 15-17 13-17 16-15 16-17 16-18 17-19 16-19 18-17 18-19 """
ROBOTS = [
    (
        " .2,.1 .3,.13 .4,.1 .2,.2 .3,.2 .4,.2 ",
        " 0-1* 1-2* 3-4* 4-5* 0-3* 2-5* 0-4* 1-4* 2-4* 3-1* 5-1* ",
    ),
    (ROBOT_1, SPRINGS_1),
    (ROBOT_2, SPRINGS_2),
    (
        ROBOT_2 + " .3,.15 .3,.2 .3,.1 .35,.1 .35,.15 .35,.2 ",
        SPRINGS_2
        + """ 20-21 3-20 3-21 14-20 14-21 22-20* 23-24* 22-23 22-24 20-23 20-24 24-25*
            20-25 21-24 21-25 """,
    ),
]

options = studio.options(__doc__, "mass_spring", iterations=100, steps=682, rate=0.2)
add = options.add_argument
add("--robot", type=int, choices=range(4), default=1, help="which (1); 0 is small and stiff")
add("--toi", action=BooleanOptionalAction, default=True, help="time of impact (yes)")
studio.add_states(options)
args = options.parse_args()

STEPS, DT = args.steps, 0.004
GRAVITY, FLOOR, DAMPING = -4.8, 0.1, 15.0
GOAL = (0.9, 0.2)
STIFFNESS, STRENGTH = (14000.0, 0.1) if args.robot == 0 else (30000.0, 0.15)
N_WAVES, N_HIDDEN = 10, 32


def build_robot(points: str, springs: str):
    """Positions; pairs of points; how far each spring can change its rest length."""
    places = np.array([point.split(",") for point in points.split()], float)
    pairs = [spring.strip("*").split("-") for spring in springs.split()]
    strengths = [STRENGTH * spring.endswith("*") for spring in springs.split()]
    return places, np.array(pairs, np.int32), np.array(strengths)


start, pairs, strengths = build_robot(*ROBOTS[args.robot])
N, N_SPRINGS = len(start), len(pairs)
N_INPUTS = N_WAVES + 4 * N + 2

studio.start(args)

# State and controller: a slot for each step (twice as many for the film), or a single one.
SLOTS = 1 if args.in_place else 2 * STEPS if args.picture else STEPS
x = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
v = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
impulse = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
centre = ti.Vector.field(2, float, shape=SLOTS, needs_grad=True)
seen = ti.field(float, shape=(SLOTS, N_INPUTS), needs_grad=True)
hidden = ti.field(float, shape=(SLOTS, N_HIDDEN), needs_grad=True)
drive = ti.field(float, shape=(SLOTS, N_SPRINGS), needs_grad=True)

w1 = ti.field(float, shape=(N_HIDDEN, N_INPUTS), needs_grad=True)
b1 = ti.field(float, shape=N_HIDDEN, needs_grad=True)
w2 = ti.field(float, shape=(N_SPRINGS, N_HIDDEN), needs_grad=True)
b2 = ti.field(float, shape=N_SPRINGS, needs_grad=True)
WEIGHTS = {"w1": w1, "b1": b1, "w2": w2, "b2": b2}
loss = ti.field(float, shape=(), needs_grad=True)

end = ti.Vector.field(2, int, shape=N_SPRINGS)
rest_length = ti.field(float, shape=N_SPRINGS)
strength = ti.field(float, shape=N_SPRINGS)


@ti.func
def at(t: int):
    """The slot of a time."""
    return 0 if ti.static(args.in_place) else t


@ti.kernel
def clear_impulses():
    for s, i in impulse:
        impulse[s, i] = [0.0, 0.0]


@ti.kernel
def find_centre(t: int):
    total = ti.Vector([0.0, 0.0])
    for i in range(N):
        total += x[at(t), i]
    centre[at(t)] = total / N


@ti.kernel
def gather_inputs(t: int):
    """The inputs of the network: waves, the points around their centre, the goal."""
    for j in range(N_WAVES):
        seen[at(t), j] = ti.sin(10.0 * t * DT + 2 * math.pi / N_WAVES * j)
    for j in range(N):
        for k in ti.static(range(2)):
            seen[at(t), N_WAVES + 4 * j + k] = 0.05 * (x[at(t), j][k] - centre[at(t)][k])
            seen[at(t), N_WAVES + 4 * j + 2 + k] = 0.05 * v[at(t), j][k]
    for k in ti.static(range(2)):
        seen[at(t), N_INPUTS - 2 + k] = GOAL[k] - centre[at(t)][k]


@ti.kernel
def hidden_layer(t: int):
    """The hidden layer of the network."""
    for i in range(N_HIDDEN):
        total = b1[i]
        for j in range(N_INPUTS):
            total += w1[i, j] * seen[at(t), j]
        hidden[at(t), i] = ti.tanh(total)


@ti.kernel
def output_layer(t: int):
    """The output layer: the command of each muscle, from -1 to 1."""
    for i in range(N_SPRINGS):
        total = b2[i]
        for j in range(N_HIDDEN):
            total += w2[i, j] * hidden[at(t), j]
        drive[at(t), i] = ti.tanh(total)


@ti.kernel
def apply_springs(t: int):
    for i in range(N_SPRINGS):
        a, b = end[i][0], end[i][1]
        way = x[at(t), a] - x[at(t), b]
        length = way.norm() + 1e-4
        wanted = rest_length[i] * (1 + strength[i] * drive[at(t), i])
        push = DT * (length - wanted) * STIFFNESS / length * way
        impulse[at(t + 1), a] -= push
        impulse[at(t + 1), b] += push


@ti.kernel
def integrate(t: int):
    """From the slot before t to t. A point that meets the floor stays."""
    for i in range(N):
        place = x[at(t - 1), i]
        fall = math.exp(-DT * DAMPING) * v[at(t - 1), i]
        fall += DT * ti.Vector([0.0, GRAVITY]) + impulse[at(t), i]
        after = fall
        toi = 0.0
        if ti.static(args.toi):
            if place[1] + DT * fall[1] < FLOOR and fall[1] < -1e-4:
                toi = -(place[1] - FLOOR) / fall[1]
                after = ti.Vector([0.0, 0.0])
        else:
            if place[1] < FLOOR and fall[1] < 0:
                after = ti.Vector([0.0, 0.0])
        v[at(t), i] = after
        x[at(t), i] = place + toi * fall + (DT - toi) * after


@ti.kernel
def measure(t: int):
    loss[None] = -x[at(t), 0][0]


def advance(t: int):
    if args.in_place:
        clear_impulses()
    find_centre(t - 1)
    gather_inputs(t - 1)
    hidden_layer(t - 1)
    output_layer(t - 1)
    apply_springs(t - 1)
    integrate(t)


def begin():
    if args.in_place:
        x.from_numpy(start[None])
        v.fill(0)
    else:
        clear_impulses()


def forward():
    begin()
    for t in range(1, STEPS):
        advance(t)
    measure(STEPS - 1)


def set_up():
    places = np.zeros((SLOTS, N, 2))
    places[0] = start
    x.from_numpy(places)
    end.from_numpy(pairs)
    rest_length.from_numpy(np.linalg.norm(start[pairs[:, 0]] - start[pairs[:, 1]], axis=1))
    strength.from_numpy(strengths)
    random = np.random.RandomState(args.seed)
    for w, gain in ((w1, 2), (w2, 3)):
        scale = gain * math.sqrt(2 / (N_HIDDEN + (N_INPUTS if w is w1 else N_SPRINGS)))
        w.from_numpy(scale * random.standard_normal(w.shape))


def iteration(_: int):
    with studio.tape(args, loss):
        forward()
    slopes = {name: w.grad.to_numpy() for name, w in WEIGHTS.items()}
    lengths = {name: float(np.linalg.norm(slope)) for name, slope in slopes.items()}
    pace = args.rate / (math.hypot(*lengths.values()) + 1e-6)
    for name, w in WEIGHTS.items():
        w.from_numpy(w.to_numpy() - pace * slopes[name])
    return {"loss": loss[None]} | {f"|d{name}|": length for name, length in lengths.items()}


def optimise():
    return studio.optimise(args, iteration, **WEIGHTS)


def film():
    """Each eighth state of a run twice as long as those of the descent."""
    begin()
    for t in range(1, 2 * STEPS):
        advance(t)
        if t % 8 == 0:
            slot = 0 if args.in_place else t
            pulls = drive.to_numpy()[max(slot - 1, 0)] * (strengths > 0)
            yield t, x.to_numpy()[slot], pulls


UP = [1, 2]  # the picture is twice as wide as high


def draw(gui: ti.GUI, frame: tuple[int, Any, Any]):
    """Muscles are red when long and blue when short."""
    t, points, pulls = frame
    gui.line((0, 2 * FLOOR - 0.015), (1, 2 * FLOOR - 0.015), radius=1, color=studio.SOFT)
    gui.circle(np.multiply(GOAL, UP), radius=5, color=studio.GOLD)
    points = points * UP
    gui.lines(points[pairs[:, 0]], points[pairs[:, 1]], radius=2, color=studio.signed(pulls))
    gui.circles(points, radius=3.5, color=studio.INK)
    gui.text(f"robot {args.robot}   t = {t * DT:.2f} s", (0.02, 0.96), color=studio.INK)


def main():
    set_up()
    losses = optimise()
    print(f"way      {-losses[0] - start[0][0]:.4f} -> {-losses[-1] - start[0][0]:.4f}")
    studio.report_memory(args, x, v, impulse, centre, seen, hidden, drive)
    studio.plot_losses(args, losses)
    if args.picture:
        studio.take_best(**WEIGHTS)
        studio.animate(args, draw, film(), res=(640, 320))


if __name__ == "__main__":
    main()
