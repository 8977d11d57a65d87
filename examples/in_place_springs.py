"""A damped net of springs, ten thousand steps long, whose state has no time axis.

Positions and velocities are overwritten in each step. A reverse sweep needs the old ones:
`ti.ad.Tape` saves them, or, under a memory budget, keeps a few snapshots and runs the steps
between them again. The same can be done by hand, with a function that brings its own gradient:
`--by hand` runs segments without a tape, and each again when its turn comes in reverse.

    python examples/in_place_springs.py                       # saves everything
    python examples/in_place_springs.py --by budget --budget 20000
    python examples/in_place_springs.py --by hand
"""

from typing import Any

import numpy as np
import tai as ti

import studio

SIDE = 3
N = SIDE * SIDE
DT, STIFFNESS, DAMPING = 2e-3, 60.0, 0.4
SEGMENT = 100

options = studio.options(__doc__, "in_place_springs", steps=10_000, least_steps=1, bare=True)
add = options.add_argument
add("--by", choices=["saving", "budget", "hand"], default="saving", help="how to go back (saving)")
text = "bytes that the tape may keep (50000)"
add("--budget", type=studio.at_least(1, most=2**63 - 1), default=50_000, help=text)
args = options.parse_args()
STEPS = args.steps
if args.by == "hand" and STEPS % SEGMENT:
    options.error(f"--steps {STEPS}: --by hand takes a multiple of {SEGMENT}")

studio.start(args, default_fp=ti.f64, deterministic=True)

x = ti.Vector.field(2, ti.f64, shape=N, needs_grad=True)
v = ti.Vector.field(2, ti.f64, shape=N, needs_grad=True)
force = ti.Vector.field(2, ti.f64, shape=N, needs_grad=True)
rest = ti.field(ti.f64, shape=(), needs_grad=True)
loss = ti.field(ti.f64, shape=(), needs_grad=True)

pairs = [(p, p + 1) for p in range(N) if (p + 1) % SIDE] + [(p, p + SIDE) for p in range(N - SIDE)]
first = ti.field(ti.i32, shape=len(pairs))
second = ti.field(ti.i32, shape=len(pairs))


@ti.kernel
def clear():
    for i in force:
        force[i] = ti.Vector([0.0, 0.0])


@ti.kernel
def apply_springs():
    for s in first:
        a, b = first[s], second[s]
        way = x[b] - x[a]
        length = way.norm()
        along = way / length
        stretch = STIFFNESS * (length - rest[None]) + DAMPING * (v[b] - v[a]).dot(along)
        force[a] += stretch * along
        force[b] -= stretch * along


@ti.kernel
def kick():
    for i in v:
        v[i] += DT * force[i]


@ti.kernel
def drift():
    for i in x:
        x[i] += DT * v[i]


@ti.kernel
def measure():
    for i in x:
        loss[None] += x[i].dot(x[i]) * (i + 1)


def step():
    clear()
    apply_springs()
    kick()
    drift()


def start():
    grid = np.stack(np.divmod(np.arange(N), SIDE), axis=-1).astype(np.float64)
    x.from_numpy(grid + 0.1 * np.sin(7 * grid[:, ::-1]))
    v.from_numpy(0.2 * np.cos(3 * grid))
    rest[None] = 0.8
    first.from_numpy(np.array([a for a, _ in pairs], np.int32))
    second.from_numpy(np.array([b for _, b in pairs], np.int32))


# By hand: the state at the start of each segment is kept, and nothing within it.
kept: dict[int, Any] = {}


@ti.ad.grad_replaced
def segment(number: int):
    kept[number] = x.to_numpy(), v.to_numpy()
    for _ in range(SEGMENT):
        step()


@ti.ad.grad_for(segment)
def segment_in_reverse(number: int):
    """Runs the segment again, keeps what its steps start from, and goes back."""
    x.from_numpy(kept[number][0])
    v.from_numpy(kept[number][1])
    states: list[tuple[Any, Any]] = []
    for _ in range(SEGMENT):
        states.append((x.to_numpy(), v.to_numpy()))
        step()
    for position, velocity in reversed(states):
        # The state that `apply_springs` read; the other kernels are linear, and their gradients
        # read nothing.
        x.from_numpy(position)
        v.from_numpy(velocity)
        drift.grad()
        kick.grad()
        apply_springs.grad()
        clear.grad()


def run():
    start()
    budget = args.budget if args.by == "budget" else None
    with ti.ad.Tape(loss, memory_budget=budget) as tape:
        if args.by == "hand":
            for number in range(STEPS // SEGMENT):
                segment(number)
        else:
            for _ in range(STEPS):
                step()
        measure()
    return tape.stats()


stats = run()
print(f"loss       {loss[None]:.12g}")
print(f"by rest    {rest.grad[None]:.12g}")
print(f"by x[0]    {x.grad[0][0]:.12g} {x.grad[0][1]:.12g}")
print(f"memory     {stats.peak_bytes} bytes")
print(f"recomputed {stats.recomputed}")
