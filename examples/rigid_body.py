"""Robots of boxes, springs and joints learn to walk.

Rigid boxes meet the floor with their corners, by impulses with friction, and are held together
by springs and joints. A small neural network sets the rest lengths of the springs, from where
the bodies are and from a few waves that keep time; gradient descent through all steps brings
the head of the robot to the goal.

    python examples/rigid_body.py
    python examples/rigid_body.py --robot 2 --iterations 40
    python examples/rigid_body.py --no-toi

With `--toi` (the default) the impulse of a contact acts from the very instant of the impact,
not from the end of the step. (The paper's program computes a penalty for corners below the
floor, too, and multiplies it by zero; it is left out here. Robot 0's gradient is of size 1e10:
chaotic, so that its loss hardly moves. With 160 slots it is well-behaved.)
"""

import math
from argparse import BooleanOptionalAction
from collections.abc import Sequence
from typing import Any

import numpy as np
import tai as ti

import studio

# Bodies: centre, half size, angle in degrees. Springs: two bodies, the places on them, rest
# length (JOINT: the places coincide), stiffness, and by how much a muscle changes its length.
Place = tuple[float, float]
Spring = tuple[int, int, Place, Place, float, float, float]
Body = tuple[Place, Place, float]
Robot = tuple[int, Sequence[Body], Sequence[Spring]]
JOINT = -1.0
LEG_BODIES: list[Body] = [
    ((0.319101, 0.471671), (0.02, 0.11), 10),
    ((0.319101, 0.255014), (0.02, 0.11), -10),
    ((0.38, 0.146685), (0.08, 0.02), 0),
]


def leg_springs(thigh: int, calf: int, foot: int) -> list[Spring]:
    return [
        (0, thigh, (0, 0.028), (0, -0.11), 0.396, 5, 0.05),
        (thigh, calf, (0, 0.11), (0, -0.11), 0.396, 20, 0.08),
        (calf, foot, (0, 0), (0.08, 0), 0.135915, 40, 0.05),
        (0, thigh, (0, -0.07), (0, 0.11), JOINT, 200, 0.05),
        (thigh, calf, (0, -0.11), (0, 0.11), JOINT, 200, 0.05),
        (calf, foot, (0, -0.11), (-0.08, 0), JOINT, 200, 0.05),
    ]


# The head, by which the way is measured; bodies; springs.
ROBOTS: list[Robot] = [
    (
        0,
        [((0.3, 0.25), (0.15, 0.03), 0)]
        + [((0.1 + 0.1 * i, 0.15), (0.03, 0.02), 0) for i in (1, 2, 3)]
        + [((0.4, 0.3), (0.005, 0.03), 0)],
        [
            (0, foot, (place, 0), (0, 0), 0.12, 15, 0.05)
            for foot, place in ((1, -0.03), (1, -0.1), (2, -0.03), (2, 0.03), (3, 0.03), (3, 0.1))
        ]
        + [(0, 4, (0.1, 0), (0, -0.05), JOINT, 15, 0.05)],
    ),
    (
        0,
        [
            ((0.15, 0.25), (0.1, 0.03), 0),
            ((0.08, 0.22), (0.03, 0.1), 0),
            ((0.22, 0.22), (0.03, 0.1), 0),
        ],
        [
            (0, 1, (0.08, 0.02), (0, -0.08), 0.22, 50, 0.03),
            (0, 2, (-0.08, 0.02), (0, -0.08), 0.22, 50, 0.03),
            (0, 1, (-0.08, 0), (0, 0.03), JOINT, 50, 0.05),
            (0, 2, (0.08, 0), (0, 0.03), JOINT, 50, 0.05),
        ],
    ),
    (
        3,
        [((0.3, 0.65), (0.06, 0.08), 0), *LEG_BODIES, *LEG_BODIES],
        leg_springs(1, 2, 3) + leg_springs(4, 5, 6),
    ),
]

options = studio.options(__doc__, "rigid_body", iterations=20, steps=2048, rate=0.2)
add = options.add_argument
add("--robot", type=int, choices=range(3), default=2, help="which (2): a crab, a table, legs")
add("--toi", action=BooleanOptionalAction, default=True, help="time of impact (yes)")
studio.add_states(options)
args = options.parse_args()

STEPS, DT = args.steps, 1e-3
GRAVITY, FLOOR, DAMPING = -9.8, 0.1, 10.0
RESTITUTION, FRICTION = 0.0, 1.0
GOAL = (0.9, 0.15)
N_WAVES, N_HIDDEN = 10, 32
HEAD, bodies, springs = ROBOTS[int(args.robot)]
N, N_SPRINGS = len(bodies), len(springs)
N_INPUTS = N_WAVES + 6 * N + 2
DECAY = math.exp(-DT * DAMPING)

studio.start(args)

# State: a slot for each step (twice as many for the film), or a single one; what contacts and
# springs add to it in a step.
SLOTS = 1 if args.in_place else 2 * STEPS if args.picture else STEPS
x = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
v = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
angle = ti.field(float, shape=(SLOTS, N), needs_grad=True)
spin = ti.field(float, shape=(SLOTS, N), needs_grad=True)
delta_x = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
delta_v = ti.Vector.field(2, float, shape=(SLOTS, N), needs_grad=True)
delta_angle = ti.field(float, shape=(SLOTS, N), needs_grad=True)
delta_spin = ti.field(float, shape=(SLOTS, N), needs_grad=True)
seen = ti.field(float, shape=(SLOTS, N_INPUTS), needs_grad=True)
hidden = ti.field(float, shape=(SLOTS, N_HIDDEN), needs_grad=True)
drive = ti.field(float, shape=(SLOTS, N_SPRINGS), needs_grad=True)

w1 = ti.field(float, shape=(N_HIDDEN, N_INPUTS), needs_grad=True)
b1 = ti.field(float, shape=N_HIDDEN, needs_grad=True)
w2 = ti.field(float, shape=(N_SPRINGS, N_HIDDEN), needs_grad=True)
b2 = ti.field(float, shape=N_SPRINGS, needs_grad=True)
WEIGHTS = {"w1": w1, "b1": b1, "w2": w2, "b2": b2}
loss = ti.field(float, shape=(), needs_grad=True)

half = ti.Vector.field(2, float, shape=N)
end = ti.Vector.field(2, int, shape=N_SPRINGS)
place_a = ti.Vector.field(2, float, shape=N_SPRINGS)
place_b = ti.Vector.field(2, float, shape=N_SPRINGS)
rest_length = ti.field(float, shape=N_SPRINGS)
stiffness = ti.field(float, shape=N_SPRINGS)
strength = ti.field(float, shape=N_SPRINGS)


@ti.func
def at(t: int):
    """The slot of a time."""
    return 0 if ti.static(args.in_place) else t


@ti.func
def inverse_mass(i: int):
    return 1 / (4 * half[i][0] * half[i][1])


@ti.func
def inverse_inertia(i: int):
    return 1 / (4 / 3 * half[i][0] * half[i][1] * half[i].norm_sqr())


@ti.func
def rotation(t: int, i: int):
    c, s = ti.cos(angle[at(t), i]), ti.sin(angle[at(t), i])
    return ti.Matrix([[c, -s], [s, c]])


@ti.func
def velocity_at(t: int, i: int, r: Any):
    return v[at(t), i] + spin[at(t), i] * ti.Vector([-r[1], r[0]])


@ti.func
def inverse_effective_mass(i: int, r: Any, way: Any):
    """Speed that a unit impulse along `way` gives to the place at the end of r."""
    return inverse_mass(i) + r.cross(way) ** 2 * inverse_inertia(i)


@ti.func
def apply_impulse(t: int, i: int, r: Any, impulse: Any, toi: Any):
    """An impulse at the end of r, some time into the step to t."""
    late = ti.min(ti.max(toi, 0.0), DT)
    by_speed = inverse_mass(i) * impulse
    by_spin = inverse_inertia(i) * r.cross(impulse)
    delta_v[at(t), i] += by_speed
    delta_spin[at(t), i] += by_spin
    if ti.static(args.toi):
        delta_x[at(t), i] -= late * by_speed
        delta_angle[at(t), i] -= late * by_spin


@ti.kernel
def clear():
    for s, i in delta_v:
        delta_x[s, i] = [0.0, 0.0]
        delta_v[s, i] = [0.0, 0.0]
        delta_angle[s, i] = 0.0
        delta_spin[s, i] = 0.0


@ti.kernel
def gather_inputs(t: int):
    """The inputs of the network: waves, the bodies around the head, the goal."""
    for j in range(N_WAVES):
        seen[at(t), j] = ti.sin(30.0 * t * DT + 2 * math.pi / N_WAVES * j)
    for j in range(N):
        first = N_WAVES + 6 * j
        for k in ti.static(range(2)):
            seen[at(t), first + k] = 0.05 * (x[at(t), j][k] - x[at(t), HEAD][k])
            seen[at(t), first + 2 + k] = 0.05 * v[at(t), j][k]
        seen[at(t), first + 4] = 0.05 * angle[at(t), j]
        seen[at(t), first + 5] = 0.05 * spin[at(t), j]
    for k in ti.static(range(2)):
        seen[at(t), N_INPUTS - 2 + k] = GOAL[k]


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
def collide(t: int):
    """Corners that would be below the floor at the end of the step."""
    for i in range(N):
        turn = rotation(t, i)
        for k in range(4):
            r = turn @ (half[i] * ti.Vector([k % 2 * 2 - 1, k // 2 * 2 - 1]))
            speed = velocity_at(t, i, r) + DT * ti.Vector([0.0, GRAVITY])
            height = x[at(t), i][1] + r[1] - FLOOR
            if speed[1] < 0 and height + DT * speed[1] < 0:
                up = (
                    -(1 + RESTITUTION)
                    * speed[1]
                    / inverse_effective_mass(i, r, ti.Vector([0.0, 1.0]))
                )
                along = -speed[0] / inverse_effective_mass(i, r, ti.Vector([1.0, 0.0]))
                along = ti.min(ti.max(along, -FRICTION * up), FRICTION * up)
                toi = 0.0
                if height > 0:
                    toi = -height / ti.min(speed[1], -1e-3)
                apply_impulse(t + 1, i, r + DT * speed, ti.Vector([along, up]), toi)


@ti.kernel
def apply_springs(t: int):
    for i in range(N_SPRINGS):
        a, b = end[i][0], end[i][1]
        ra, rb = rotation(t, a) @ place_a[i], rotation(t, b) @ place_b[i]
        way = x[at(t), a] + ra - x[at(t), b] - rb
        length = way.norm() + 1e-4
        wanted = rest_length[i] * (1 + strength[i] * drive[at(t), i])
        if rest_length[i] < 0:
            wanted = 0.0
        impulse = DT * (length - wanted) * stiffness[i] / length * way
        if rest_length[i] < 0:
            # A joint also stops what its ends do against one another.
            slip = velocity_at(t, a, ra) - velocity_at(t, b, rb)
            slip_speed = slip.norm() + 1e-1
            along = slip / slip_speed
            impulse += (
                slip_speed
                / (inverse_effective_mass(a, ra, along) + inverse_effective_mass(b, rb, along))
                * along
            )
        apply_impulse(t + 1, a, ra, -impulse, 0.0)
        apply_impulse(t + 1, b, rb, impulse, 0.0)


@ti.kernel
def integrate(t: int):
    """From the slot before t to t."""
    for i in range(N):
        speed = DECAY * v[at(t - 1), i] + delta_v[at(t), i] + DT * ti.Vector([0.0, GRAVITY])
        turn = DECAY * spin[at(t - 1), i] + delta_spin[at(t), i]
        x[at(t), i] = x[at(t - 1), i] + DT * speed + delta_x[at(t), i]
        angle[at(t), i] = angle[at(t - 1), i] + DT * turn + delta_angle[at(t), i]
        v[at(t), i] = speed
        spin[at(t), i] = turn


@ti.kernel
def measure(t: int):
    loss[None] = (x[at(t), HEAD] - ti.Vector(GOAL)).norm()


def advance(t: int):
    if args.in_place:
        clear()
    gather_inputs(t - 1)
    hidden_layer(t - 1)
    output_layer(t - 1)
    collide(t - 1)
    apply_springs(t - 1)
    integrate(t)


def begin():
    """Nothing of an earlier run is left."""
    if args.in_place:
        rest()
    else:
        clear()


def forward():
    begin()
    for t in range(1, STEPS):
        advance(t)
    measure(STEPS - 1)


def rest():
    """The robot in the first slot, as it is at the start."""
    places, angles = np.zeros((SLOTS, N, 2)), np.zeros((SLOTS, N))
    places[0] = [centre for centre, _, _ in bodies]
    angles[0] = [math.radians(degrees) for _, _, degrees in bodies]
    x.from_numpy(places)
    angle.from_numpy(angles)
    v.fill(0)
    spin.fill(0)


def set_up():
    rest()
    half.from_numpy(np.array([size for _, size, _ in bodies]))
    columns = (
        np.array(column) for column in zip(*[(spring[:2], *spring[2:]) for spring in springs])
    )
    for field, column in zip((end, place_a, place_b, rest_length, stiffness, strength), columns):
        field.from_numpy(column)
    random = np.random.RandomState(args.seed)
    w1.from_numpy(0.5 * math.sqrt(2 / (N_HIDDEN + N_INPUTS)) * random.standard_normal(w1.shape))
    w2.from_numpy(math.sqrt(2 / (N_HIDDEN + N_SPRINGS)) * random.standard_normal(w2.shape))


def iteration(_: int):
    with studio.tape(args, loss):
        forward()
    slopes = {name: w.grad.to_numpy() for name, w in WEIGHTS.items()}
    lengths = {name: float(np.linalg.norm(slope)) for name, slope in slopes.items()}
    pace = min(1, args.rate / (math.hypot(*lengths.values()) + 1e-4))
    for name, w in WEIGHTS.items():
        w.from_numpy(w.to_numpy() - pace * slopes[name])
    return {"loss": loss[None]} | {f"|d{name}|": length for name, length in lengths.items()}


def optimise():
    return studio.optimise(args, iteration, **WEIGHTS)


def film():
    """States of a run twice as long as those of the descent."""
    begin()
    for t in range(1, 2 * STEPS):
        advance(t)
        if t % 32 == 0:
            slot = 0 if args.in_place else t
            pulls = drive.to_numpy()[max(slot - 1, 0)]
            yield t, x.to_numpy()[slot], angle.to_numpy()[slot], pulls


def draw(gui: ti.GUI, frame: tuple[int, Any, Any, Any]):
    """Muscles are red when long and blue when short, joints are dots."""
    t, places, angles, pulls = frame

    def world(body: int, place: Any) -> Any:
        c, s = math.cos(angles[body]), math.sin(angles[body])
        return places[body] + np.array([[c, -s], [s, c]]) @ place

    gui.line((0, FLOOR), (1, FLOOR), radius=1, color=studio.SOFT)
    gui.circle(GOAL, radius=5, color=studio.GOLD)
    for i, (_, (w, h), _) in enumerate(bodies):
        a, b, c, d = (world(i, corner) for corner in ((-w, -h), (w, -h), (w, h), (-w, h)))
        color = studio.PLUM if i == HEAD else studio.TEAL
        gui.triangles([a, a], [b, c], [c, d], color=color)
        gui.lines([a, b, c, d], [b, c, d, a], radius=1, color=studio.INK)
    for (a, b, on_a, on_b, length, _, _), pull in zip(springs, pulls):
        if length == JOINT:
            gui.circle(world(a, on_a), radius=3, color=studio.INK)
        else:
            color = int(studio.signed(pull))
            gui.line(world(a, on_a), world(b, on_b), radius=2, color=color)
    gui.text(f"robot {args.robot}   t = {t * DT:.2f} s", (0.03, 0.97), color=studio.INK)


def main():
    set_up()
    losses = optimise()
    print(f"best     {min(losses):.4f} from the goal")
    state = (x, v, angle, spin, delta_x, delta_v, delta_angle, delta_spin, seen, hidden, drive)
    studio.report_memory(args, *state)
    studio.plot_losses(args, losses)
    if args.picture:
        studio.take_best(**WEIGHTS)
        studio.animate(args, draw, film())


if __name__ == "__main__":
    main()
