"""A charged ball is led along a path by eight electrodes, whose charges a network sets.

Each iteration has a new random path of two straight lines. The network sees where the ball and
the goal are and how they move; gradient descent through the whole flight teaches it.

    python examples/electric.py
    python examples/electric.py --controller published
    python examples/electric.py --controller published --gradient reread
    python examples/electric.py --controller published --double --check

The paper's program calls the network for a slot before that slot is computed, so that it sees
the ball where the run before this one left it. `--controller published` does so, too. The states
that the network has seen are overwritten afterwards; the tape keeps them, and the gradient is
right. `--gradient reread` goes back by hand and reads the slots as they are then, as Taichi does: a
gradient that is off by some per cent at once, and the numbers of the paper's program. (The paper's
program asks for 200 000 iterations.)
"""

import math
import random
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import tai as ti

import studio

options = studio.options(
    __doc__, "electric", iterations=1000, steps=512, rate=0.02, quick={"iterations": 10}
)
add = options.add_argument
add("--controller", choices=["before", "published"], default="before", help="sees the slot before")
add("--gradient", choices=["tape", "reread"], default="tape", help="reread: as Taichi has it")
add("--check", action="store_true", help="no descent: both gradients against a difference")
args = options.parse_args()
if args.steps % 2:
    options.error("--steps: the path has two halves, so their number is even")

STEPS: int = args.steps
DT = 0.03
ELECTRODES = [
    (0.1, 0.1), (0.1, 0.9), (0.9, 0.9), (0.9, 0.1),
    (0.5, 0.9), (0.5, 0.1), (0.1, 0.5), (0.9, 0.5),
]  # fmt: skip
N, N_HIDDEN, N_INPUTS = len(ELECTRODES), 64, 8
CHARGE, DECAY = 1e-3, math.exp(-0.2 * DT)
SEES_OLD = args.controller == "published"

studio.start(args)

x = ti.Vector.field(2, float, shape=STEPS, needs_grad=True)
v = ti.Vector.field(2, float, shape=STEPS, needs_grad=True)
hidden = ti.field(float, shape=(STEPS, N_HIDDEN), needs_grad=True)
charge = ti.field(float, shape=(STEPS, N), needs_grad=True)
goal = ti.Vector.field(2, float, shape=STEPS)
goal_way = ti.Vector.field(2, float, shape=STEPS)
electrode = ti.Vector.field(2, float, shape=N)

w1 = ti.field(float, shape=(N_INPUTS, N_HIDDEN), needs_grad=True)
b1 = ti.field(float, shape=N_HIDDEN, needs_grad=True)
w2 = ti.field(float, shape=(N_HIDDEN, N), needs_grad=True)
b2 = ti.field(float, shape=N, needs_grad=True)
WEIGHTS = {"w1": w1, "b1": b1, "w2": w2, "b2": b2}
loss = ti.field(float, shape=(), needs_grad=True)


@ti.kernel
def hidden_layer(t: int):
    """The hidden layer of the network."""
    seen = t if ti.static(SEES_OLD) else t - 1
    for i in range(N_HIDDEN):
        total = b1[i]
        for k in ti.static(range(2)):
            total += w1[k, i] * (x[seen][k] - 0.5) + w1[2 + k, i] * v[seen][k]
            total += w1[4 + k, i] * (goal[t][k] - 0.5) + w1[6 + k, i] * (goal_way[t][k] - 0.5)
        hidden[t, i] = ti.tanh(total)


@ti.kernel
def output_layer(t: int):
    """The output layer: a charge for each electrode."""
    for i in range(N):
        total = b2[i]
        for j in range(N_HIDDEN):
            total += w2[j, i] * hidden[t, j]
        charge[t, i] = ti.tanh(total)


@ti.kernel
def integrate(t: int):
    force = ti.Vector([0.0, 0.0])
    for i in range(N):
        r = x[t - 1] - electrode[i]
        force += CHARGE * charge[t, i] * r / ti.max(r.norm(), 0.1) ** 3
    v[t] = DECAY * v[t - 1] + DT * force
    x[t] = x[t - 1] + DT * v[t]


@ti.kernel
def measure():
    for t in range(1, STEPS):
        loss[None] += DT * (x[t] - goal[t]).norm_sqr()


@ti.kernel
def descend(rate: float):
    for i, j in w1:
        w1[i, j] -= rate * w1.grad[i, j]
    for i in b1:
        b1[i] -= rate * b1.grad[i]
    for i, j in w2:
        w2[i, j] -= rate * w2.grad[i, j]
    for i in b2:
        b2[i] -= rate * b2.grad[i]


def forward():
    for t in range(1, STEPS):
        hidden_layer(t)
        output_layer(t)
        integrate(t)
    measure()


def by_tape():
    with ti.ad.Tape(loss):
        forward()


def reread():
    """Goes back by hand. `hidden_layer` reads the present slots, not the ones it saw."""
    loss[None] = 0
    forward()
    for field in (x, v, hidden, charge, *WEIGHTS.values()):
        field.grad.fill(0)
    loss.grad[None] = 1
    measure.grad()
    for t in reversed(range(1, STEPS)):
        integrate.grad(t)
        output_layer.grad(t)
        hidden_layer.grad(t)


def paths(generator: random.Random) -> Iterator[Any]:
    """Without end: three points, a straight line from each to the next."""
    while True:
        yield np.array([[0.2 + 0.6 * generator.random() for _ in range(2)] for _ in range(3)])


def set_path(path: Any):
    """Sets the goal of each slot, and puts the ball at the first one."""
    half = STEPS // 2
    share = (np.arange(STEPS) % half / half)[:, None]
    begin, way = np.repeat(path[:-1], half, 0), np.repeat(np.diff(path, axis=0), half, 0)
    goal.from_numpy(begin + share * way)
    goal_way.from_numpy(way)
    x[0], v[0] = path[0], (0.0, 0.0)


# Set when the weights are.
numbered_paths: Iterator[tuple[int, Any]]


def path_of(number: int):
    """The path of an iteration; those of iterations before are drawn and forgotten."""
    return next(path for index, path in numbered_paths if index == number + 1)


def set_up():
    """Weights; a first flight, whose slots the network sees in the next."""
    global numbered_paths
    generator = random.Random(args.seed)
    for _ in range(40):  # as the paper's program, for the numbers that come afterwards
        generator.random()
    for w in (w1, w2):
        count = math.prod(w.shape)
        numbers = [0.3 * generator.random() - 0.15 for _ in range(count)]
        w.from_numpy(np.reshape(numbers, w.shape))
    numbered_paths = enumerate(paths(generator))
    electrode.from_numpy(np.array(ELECTRODES))
    set_path(next(numbered_paths)[1])
    forward()


def iteration(number: int):
    set_path(path_of(number))
    by_tape() if args.gradient == "tape" else reread()
    lengths = {f"|d{n}|": np.linalg.norm(w.grad.to_numpy()) for n, w in WEIGHTS.items()}
    descend(args.rate)
    return {"loss": loss[None]} | lengths


def slopes(gradient: Callable[[], None], seen: tuple[Any, Any]):
    """The loss of the first path and its gradients, where the network sees the first states."""
    for field, values in zip((x, v), seen):
        field.from_numpy(values)
    gradient()
    return loss[None], [w.grad.to_numpy() for w in WEIGHTS.values()]


def check():
    """Derivatives along a random direction of all weights: a difference, and both gradients."""
    set_path(path_of(0))
    seen = x.to_numpy(), v.to_numpy()
    generator = np.random.RandomState(args.seed)
    way = [generator.standard_normal(w.shape) for w in WEIGHTS.values()]
    centre = [w.to_numpy() for w in WEIGHTS.values()]
    size = 1e-6 if args.double else 1e-3
    losses: list[float] = []
    for sign in (1, -1, 0):
        for w, c, d in zip(WEIGHTS.values(), centre, way):
            w.from_numpy(c + sign * size * d)
        losses.append(slopes(by_tape, seen)[0])
    difference = (losses[0] - losses[1]) / (2 * size)
    print(f"difference {difference:.9g}")
    for name, gradient in (("tape", by_tape), ("reread", reread)):
        slope = sum((g * d).sum() for g, d in zip(slopes(gradient, seen)[1], way))
        print(f"{name:10} {slope:.9g}, off by {abs(slope / difference - 1):.1e}")


def optimise():
    return studio.optimise(args, iteration, **WEIGHTS, x=x, v=v)


def draw(gui: ti.GUI, t: int):
    """Electrodes are red when they push and blue when they pull; the goal is golden."""
    places, goals, charges = x.to_numpy(), goal.to_numpy(), charge.to_numpy()
    gui.circles(goals[::8], radius=1.5, color=studio.SOFT)
    sizes = 9 + 9 * np.abs(charges[t])
    gui.circles(ELECTRODES, radius=sizes, color=studio.signed(charges[t]))
    gui.circle(goals[t], radius=6, color=studio.GOLD)
    gui.circles(places[max(0, t - 60) : t + 1 : 4], radius=2.5, color=studio.TEAL)
    gui.circle(places[t], radius=8, color=studio.INK)


def main():
    set_up()
    if args.check:
        check()
        return
    losses = optimise()
    count = min(100, len(losses))
    first, last = np.mean(losses[:count]), np.mean(losses[-count:])
    print(f"mean     {first:.4g} -> {last:.4g} (of {count} iterations)")
    means = [np.mean(losses[max(0, i - count + 1) : i + 1]) for i in range(len(losses))]
    curves = {"loss of one path": losses, f"mean of {count}": means}
    studio.plot(args, "losses", curves, x="iteration", y="loss", log=True)
    if args.picture:
        studio.animate(args, draw, range(1, STEPS, 4))


if __name__ == "__main__":
    main()
