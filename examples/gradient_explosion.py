"""Why damping helps to learn: the longer a rollout, the larger its gradient.

A mass is pushed along a line; in each step its speed is multiplied by D = exp(-dt alpha). The
way after N steps grows as N^2 without damping, and so does its derivative by the push; with
damping both grow as N. The derivative by D shows it best.

    python examples/gradient_explosion.py
    python examples/gradient_explosion.py --steps 10000 --every 500
    python examples/gradient_explosion.py --descend

`--descend` looks for the push that carries the mass to 1 in N slots, by descent at a fixed rate.
Without damping it flies off, unless the gradient is clipped.
"""

import math
from collections.abc import Callable
from typing import Any

import tai as ti

import studio

ALPHAS = (0.0, 1.0, 3.0, 10.0)

options = studio.options(__doc__, "gradient_explosion", steps=1000, quick={"steps": 300})
add = options.add_argument
add("--every", type=studio.at_least(1), default=150, help="distance of the lengths N (150)")
add("--descend", action="store_true", help="descent, with and without clipping")
add("--iterations", type=studio.at_least(1), default=300, help="steps of descent (300)")
add("--rate", type=studio.at_least(0, float), default=1e-4, help="learning rate (1e-4)")
add("--clip", type=studio.at_least(0, float), default=0.5, help="longest gradient (0.5)")
args = options.parse_args()

DT = 1e-3
lengths = range(min(50, args.steps), args.steps + 1, args.every)

studio.start(args)

x = ti.field(float, shape=args.steps, needs_grad=True)
v = ti.field(float, shape=args.steps, needs_grad=True)
push = ti.field(float, shape=(), needs_grad=True)
decay = ti.field(float, shape=(), needs_grad=True)
loss = ti.field(float, shape=(), needs_grad=True)


@ti.kernel
def move(t: int):
    v[t] = decay[None] * v[t - 1] + push[None]
    x[t] = x[t - 1] + DT * v[t]


@ti.kernel
def way(t: int):
    loss[None] = x[t]


@ti.kernel
def miss(t: int):
    loss[None] = (x[t] - 1) ** 2


def gradient(length: int, measure: Callable[[int], None]):
    """The loss after so many slots, and its derivatives by the push and by the decay."""
    with ti.ad.Tape(loss):
        for t in range(1, length):
            move(t)
        measure(length - 1)
    return loss[None], push.grad[None], decay.grad[None]


def descend(alpha: float, clip: float) -> list[float]:
    """The losses of a descent that begins without a push; it ends early if it flies off."""
    decay[None], push[None] = math.exp(-DT * alpha), 0.0
    losses: list[float] = []
    while len(losses) < args.iterations and (not losses or losses[-1] < 1e6):
        value, slope, _ = gradient(args.steps, miss)
        push[None] -= args.rate * max(-clip, min(clip, slope))
        losses.append(value)
    return losses


def show_growth():
    columns: dict[str, Any] = {"N": lengths}
    curves: dict[str, Any] = {}
    for alpha in ALPHAS:
        decay[None], push[None] = math.exp(-DT * alpha), 1.0
        rows = [gradient(length, way) for length in lengths]
        names = (f"{what}, alpha {alpha:g}" for what in ("way", "by push", "by decay"))
        columns |= dict(zip(names, zip(*rows)))
        curves[f"alpha {alpha:g}"] = lengths, [slope for _, slope, _ in rows]
        print(f"alpha {alpha:<3g} way {rows[-1][0]:.6g} after {lengths[-1]} slots", end="; ")
        print(f"by push {rows[-1][1]:.6g}, by decay {rows[-1][2]:.6g}")
    studio.table(args, "growth", **columns)
    axes: dict[str, Any] = {"x": "time slots N", "y": "derivative of the way by the push"}
    studio.plot(args, "growth", curves, **axes, log=True)


def show_descent():
    curves: dict[str, Any] = {}
    for alpha in (0.0, 10.0):
        for clip in (math.inf, args.clip):
            name = f"alpha {alpha:g}, " + ("not clipped" if clip == math.inf else f"clip {clip:g}")
            losses = curves[name] = descend(alpha, clip)
            end = "" if losses[-1] < 1e6 else ", flew off"
            print(f"{name}: loss {losses[0]:.4g} -> {losses[-1]:.4g} in {len(losses)}{end}")
    studio.plot(args, "descent", curves, x="iteration", y="loss", log=True)


def main():
    show_descent() if args.descend else show_growth()


if __name__ == "__main__":
    main()
