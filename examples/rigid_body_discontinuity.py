"""A box falls onto one of its corners. How does it end, by how far it was turned?

With friction, nothing mends the jump at the angle 0: which of the two corners meets the floor
first decides to which side the box is thrown. The derivative is right on both sides of the
jump, and says nothing of it.

    python examples/rigid_body_discontinuity.py
    python examples/rigid_body_discontinuity.py --loss y

(The paper's caption speaks of the height at the end; its program takes the x coordinate, of a
body that does not exist. Here it is the only body, and `--loss` says which coordinate.)
"""

from typing import Any

import numpy as np
import tai as ti

import studio

options = studio.options(__doc__, "rigid_body_discontinuity", steps=2048)
add = options.add_argument
add("--loss", choices=["x", "y"], default="x", help="coordinate of the centre at the end (x)")
add("--samples", type=studio.at_least(1), default=20, help="angles on either side of 0 (20)")
args = options.parse_args()

STEPS, DT = args.steps, 2e-4
FLOOR, RESTITUTION, PENALTY = 0.1, 0.3, 1e4
HALF = 0.1
MASS, INERTIA = 4 * HALF**2, 4 / 3 * HALF**2 * 2 * HALF**2
START, SPEED = (0.7, 0.5), (-1.0, -2.0)
FRICTIONS = (0.0, 1.0)
SAMPLES: int = args.samples
angles = 1e-3 * (np.arange(-SAMPLES, SAMPLES) + 0.5)
N = len(angles)

studio.start(args)

# Many boxes at once, which do not meet.
x = ti.Vector.field(2, float, shape=(STEPS, N), needs_grad=True)
v = ti.Vector.field(2, float, shape=(STEPS, N), needs_grad=True)
angle = ti.field(float, shape=(STEPS, N), needs_grad=True)
spin = ti.field(float, shape=(STEPS, N), needs_grad=True)
loss = ti.field(float, shape=(), needs_grad=True)


@ti.func
def inverse_effective_mass(r: Any, way: Any):
    return 1 / MASS + r.cross(way) ** 2 / INERTIA


@ti.kernel
def move(t: int, friction: float):
    for i in range(N):
        c, s = ti.cos(angle[t - 1, i]), ti.sin(angle[t - 1, i])
        delta_v, delta_spin = ti.Vector([0.0, 0.0]), 0.0
        for k in range(4):
            a, b = HALF * (k % 2 * 2 - 1), HALF * (k // 2 * 2 - 1)
            r = ti.Vector([c * a - s * b, s * a + c * b])
            speed = v[t - 1, i] + spin[t - 1, i] * ti.Vector([-r[1], r[0]])
            depth = x[t - 1, i][1] + r[1] - FLOOR
            if depth < 0:
                up, along = 0.0, 0.0
                hard = inverse_effective_mass(r, ti.Vector([0.0, 1.0]))
                if speed[1] < 0:
                    up = -(1 + RESTITUTION) * speed[1] / hard
                    along = -speed[0] / inverse_effective_mass(r, ti.Vector([1.0, 0.0]))
                    along = ti.min(ti.max(along, -friction * up), friction * up)
                # A corner below the floor is lifted, whether it goes down or up.
                up -= DT * PENALTY * depth / hard
                impulse = ti.Vector([along, up])
                delta_v += impulse / MASS
                delta_spin += r.cross(impulse) / INERTIA
        v[t, i] = v[t - 1, i] + delta_v
        spin[t, i] = spin[t - 1, i] + delta_spin
        x[t, i] = x[t - 1, i] + DT * v[t, i]
        angle[t, i] = angle[t - 1, i] + DT * spin[t, i]


@ti.kernel
def measure(axis: ti.template):
    for i in range(N):
        loss[None] += x[STEPS - 1, i][axis]


def throw(friction: float):
    """Where the boxes end, and the derivatives of that by spin and place at the start."""
    axis = "xy".index(args.loss)
    with ti.ad.Tape(loss):
        for t in range(1, STEPS):
            move(t, friction)
        measure(axis)
    ends = x.to_numpy()[STEPS - 1, :, axis]
    return ends, spin.grad.to_numpy()[0], x.grad.to_numpy()[0, :, axis]


def set_up():
    places, turned = np.zeros((STEPS, N, 2)), np.zeros((STEPS, N))
    places[0], turned[0] = START, angles
    x.from_numpy(places)
    angle.from_numpy(turned)
    v.from_numpy(np.broadcast_to(SPEED, (STEPS, N, 2)))


def main():
    set_up()
    columns: dict[str, Any] = {"angle": angles}
    curves: dict[str, Any] = {}
    for friction in FRICTIONS:
        name = f"friction {friction:g}"
        ends, by_spin, by_place = throw(friction)
        columns |= {name: ends, f"{name} by spin": by_spin, f"{name} by {args.loss}": by_place}
        curves[name] = angles, ends
        left, right = ends[SAMPLES - 1], ends[SAMPLES]
        print(f"{name}: {args.loss} ends at {ends[0]:.5f} to {left:.5f} | jump", end=" ")
        print(f"{right - left:+.5f} | {right:.5f} to {ends[-1]:.5f}")
    studio.table(args, "ends", **columns)
    axes: dict[str, Any] = {"x": "angle at the start (rad)", "y": f"{args.loss} at the end"}
    studio.plot(args, "ends", curves, **axes, dots=True)


if __name__ == "__main__":
    main()
