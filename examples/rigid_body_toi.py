"""A ball falls onto the floor and bounces. If it starts a little higher, where does it end?

A little lower: it still has less of its way up behind it. So the derivative of the height at
the end by the height at the start is -1. A simulator that reverses the speed in the step after
the impact gets nearly the same heights, and the derivative +1: in which step the ball is
reversed does not change when it starts a little higher, until it does, and then the height
jumps. Reversing it at the very instant of the impact mends both.

    python examples/rigid_body_toi.py
"""

from typing import Any

import numpy as np
import tai as ti

import studio

options = studio.options(__doc__, "rigid_body_toi", steps=204)
args = options.parse_args()

STEPS, DT, FLOOR = args.steps, 2e-3, 0.1
START, SPEED = (0.7, 0.5), (-1.0, -2.0)
LIFTS = 0.02 * np.arange(15)
CLOSE_UP = 0.26 + 1e-4 * np.arange(400)
WAYS = ("naive", "toi")
lifts = np.concatenate([LIFTS, CLOSE_UP])
N = len(lifts)

studio.start(args)

# Many balls at once, which do not meet.
x = ti.Vector.field(2, float, shape=(STEPS, N), needs_grad=True)
v = ti.Vector.field(2, float, shape=(STEPS, N), needs_grad=True)
loss = ti.field(float, shape=(), needs_grad=True)


@ti.kernel
def move_naively(t: int):
    for i in range(N):
        speed = v[t - 1, i]
        if x[t - 1, i][1] < FLOOR and speed[1] < 0:
            speed[1] = -speed[1]
        v[t, i] = speed
        x[t, i] = x[t - 1, i] + DT * speed


@ti.kernel
def move_with_toi(t: int):
    for i in range(N):
        old = v[t - 1, i]
        height = x[t - 1, i][1] - FLOOR
        new, toi = old, 0.0
        if height + DT * old[1] < 0 and old[1] < 0:
            new[1] = -old[1]
            toi = -height / old[1]
        v[t, i] = new
        x[t, i] = x[t - 1, i] + toi * old + (DT - toi) * new


@ti.kernel
def measure():
    for i in range(N):
        loss[None] += x[STEPS - 1, i][1]


def bounce(way: str):
    """Heights at the end, and their derivatives by height and vertical speed at the start."""
    move = move_with_toi if way == "toi" else move_naively
    with ti.ad.Tape(loss):
        for t in range(1, STEPS):
            move(t)
        measure()
    # The balls do not meet: the gradient of the sum holds the derivative of each.
    by_height, by_speed = x.grad.to_numpy()[0, :, 1], v.grad.to_numpy()[0, :, 1]
    return x.to_numpy()[STEPS - 1, :, 1], by_height, by_speed


def set_up():
    places = np.zeros((STEPS, N, 2))
    places[0] = np.add(START, np.outer(lifts, [0, 1]))
    x.from_numpy(places)
    v.from_numpy(np.broadcast_to(SPEED, (STEPS, N, 2)))


def main():
    set_up()
    columns: dict[str, Any] = {"lift": lifts}
    far: dict[str, Any] = {}
    near: dict[str, Any] = {}
    count = len(LIFTS)
    for way in WAYS:
        height, by_height, by_speed = bounce(way)
        columns |= {way: height, f"{way} by y": by_height, f"{way} by vy": by_speed}
        far[way], near[way] = (LIFTS, height[:count]), (CLOSE_UP, height[count:])
        slopes = sorted({round(float(slope), 5) for slope in by_height})
        print(f"{way:8} height {height[0]:.6f} -> {height[count - 1]:.6f}, by y {slopes}")
    studio.table(args, "heights", **columns)
    axes: dict[str, Any] = {"x": "height added at the start", "y": "height at the end"}
    studio.plot(args, "heights", far, **axes)
    studio.plot(args, "close_up", near, **axes, title="400 balls, 1e-4 apart", dots=True)


if __name__ == "__main__":
    main()
