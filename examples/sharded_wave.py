"""A membrane on several processes, and the gradient of its end with respect to its start.

A wave runs over a square membrane, whose rows are divided among the processes of a mesh; each
process steps its own rows, in reverse as well. Descent on the initial height makes the membrane
take a given shape at the end.

    torchrun --nproc-per-node 4 examples/sharded_wave.py
    torchrun --nproc-per-node 4 examples/sharded_wave.py --size 1024 --steps 400
    python examples/sharded_wave.py          # one process, without a mesh
    torchrun --nproc-per-node 2 examples/sharded_wave.py --check   # against differences
"""

import os
import time

import numpy as np
import tai as ti

import studio

parser = studio.plain(__doc__)
add, least = parser.add_argument, studio.at_least
add("--size", type=least(8), default=64, help="points along each side (64)")
add("--steps", type=least(3), default=60, help="steps in time (60)")
add("--iterations", type=least(1), default=10, help="steps of descent (10)")
add("--rate", type=float, default=0.1, help="rate of descent (0.1)")
add("--check", action="store_true", help="compare the gradient with differences")
args = parser.parse_args()

N, STEPS = args.size, args.steps
RANKS = int(os.environ.get("WORLD_SIZE", "1"))
SPEED = 0.2

mesh = ti.mesh("x", RANKS) if RANKS > 1 else None
ti.init(arch=ti.cpu, default_fp=ti.f64, mesh=mesh)

# The height over time, and the target at the end: their second axis is divided.
u, target = ti.field(float), ti.field(float)
loss = ti.field(float)
rows = ti.root.shard(ti.j) if mesh else ti.root
rows.dense(ti.ijk, (STEPS, N, N)).place(u)
rows.dense(ti.jk, (N, N)).place(target)
ti.root.place(loss)
ti.root.lazy_grad()


@ti.kernel
def begin():
    for i, j in ti.ndrange((1, N - 1), (1, N - 1)):
        u[1, i, j] = u[0, i, j]


@ti.kernel
def step(t: int):
    for i, j in ti.ndrange((1, N - 1), (1, N - 1)):
        around = u[t - 1, i - 1, j] + u[t - 1, i + 1, j] + u[t - 1, i, j - 1] + u[t - 1, i, j + 1]
        u[t, i, j] = 2 * u[t - 1, i, j] - u[t - 2, i, j] + SPEED * (around - 4 * u[t - 1, i, j])


@ti.kernel
def measure():
    for i, j in target:
        loss[None] += (u[STEPS - 1, i, j] - target[i, j]) ** 2 / N


@ti.kernel
def descend(rate: float):
    for i, j in target:
        u[0, i, j] -= rate * u.grad[0, i, j]


def run() -> float:
    """The loss, and its gradient with respect to the start."""
    with ti.ad.Tape(loss):
        begin()
        for t in range(2, STEPS):
            step(t)
        measure()
    return loss[None]


def say(text: str) -> None:
    """Prints on the first rank."""
    if mesh is None or mesh.rank == 0:
        print(text, flush=True)


x = np.linspace(-1, 1, N)
hill = np.exp(-8 * (x[:, None] ** 2 + x[None, :] ** 2))
target.from_numpy(hill)

if args.check:
    run()
    at, small = (0, N // 2, N // 2 - 1), 1e-4
    slope = u.grad[at]
    value = u[at]
    sides: list[float] = []
    for sign in (1, -1):
        u[at] = value + sign * small
        sides.append(run())
    difference = (sides[0] - sides[1]) / (2 * small)
    say(f"gradient {slope:.9f}, difference {difference:.9f}")
    assert abs(slope - difference) < 1e-6 * max(1.0, abs(slope))
else:
    for k in range(args.iterations):
        start = time.perf_counter()
        value = run()
        say(f"iteration {k}: loss {value:.6f}, {time.perf_counter() - start:.2f} s")
        descend(args.rate * N)
