"""A rope of springs swings into rest: which of its springs are worn?

Time steps are implicit (backward Euler), so that a step is larger than any stable explicit one:
each is the root of an equation, found by Newton's method. The unknown is the stiffness of each
spring, judged by the motion alone. Gradients pass through the roots, not through the iterations.

    python examples/implicit_elastic.py
    python examples/implicit_elastic.py --iterations 400

At the end, one gradient is computed in three ways: through Newton's roots, through a relaxation
that is iterated until nothing changes (ti.ad.implicit), and through each of its sweeps.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import tai as ti

import studio

parser = studio.plain(__doc__)
add, least = parser.add_argument, studio.at_least
add("--n", type=least(2), default=24, help="springs of the rope (24)")
add("--steps", type=least(1), default=12, help="time steps (12)")
add("--iterations", type=least(1), default=150, help="steps of descent (150)")
add("--sweeps", type=least(1), default=1500, help="sweeps that are unrolled (1500)")
add("--rate", type=least(0, float), default=0.05, help="learning rate (0.05)")
args = parser.parse_args()

N, STEPS = args.n, args.steps
LENGTH, MASS, DT = 1 / N, 1 / N, 0.05
GRAVITY = ti.Vector([0.0, -9.81])
STIFF = 20.0 * N

ti.init(arch=ti.cpu, default_fp=ti.f64)

# Joints 0 and N are nailed to the wall. Stiffness by its logarithm: it stays positive.
log_k = ti.field(ti.f64, shape=N, needs_grad=True)
x = ti.Vector.field(2, ti.f64, shape=N + 1, needs_grad=True)
last = ti.Vector.field(2, ti.f64, shape=N + 1, needs_grad=True)
before = ti.Vector.field(2, ti.f64, shape=N + 1, needs_grad=True)
swept = ti.Vector.field(2, ti.f64, shape=N + 1, needs_grad=True)
seen = ti.Vector.field(2, ti.f64, shape=(STEPS, N + 1))
loss = ti.field(ti.f64, shape=(), needs_grad=True)


@ti.func
def pull(p: ti.template, i: int):
    """The force of spring i on its left joint."""
    d = p[i + 1] - p[i]
    length = d.norm() + 1e-12
    return STIFF * ti.exp(log_k[i]) * (length - LENGTH) * d / length


@ti.func
def imbalance(p: ti.template, i: int):
    """Inertia less forces, of joint i; a nailed one stays where it is."""
    out = p[i] - last[i]
    if 0 < i < N:
        inertia = MASS * (p[i] - 2 * last[i] + before[i]) / DT**2
        out = inertia - MASS * GRAVITY - pull(p, i) + pull(p, i - 1)
    return out


@ti.kernel
def residual(p: ti.template, r: ti.template):
    for i in p:
        r[i] = imbalance(p, i)


@ti.kernel
def relax(p: ti.template, q: ti.template):
    """A small step against the imbalance."""
    for i in p:
        weight = 1.0
        if 0 < i < N:
            weight = 1 / (MASS / DT**2 + 6 * STIFF)
        q[i] = p[i] - weight * imbalance(p, i)


@ti.kernel
def remember():
    for i in x:
        before[i] = last[i]
        last[i] = x[i]


@ti.kernel
def compare(t: ti.i32):
    for i in x:
        loss[None] += (x[i] - seen[t, i]).norm_sqr()


def by_newton():
    ti.linalg.newton(residual, x, tol=1e-9)


def by_relaxation():
    ti.ad.implicit(relax, x, tol=1e-9, max_iterations=20_000)


def by_sweeps():
    for _ in range(args.sweeps // 2):
        relax(x, swept)
        relax(swept, x)


def start():
    """A rope that is held straight."""
    straight = np.stack([np.linspace(0, 1, N + 1), np.zeros(N + 1)], axis=1)
    for field in (x, last, before):
        field.from_numpy(straight)
    loss[None] = 0


def swing(step: Callable[[], None], look: Callable[[int], None]):
    for t in range(STEPS):
        step()
        remember()
        look(t)


def gradient(step: Callable[[], None]):
    start()
    with ti.ad.Tape(loss) as tape:
        swing(step, compare)
    return log_k.grad.to_numpy(), tape


def record_truth():
    """The motion of a rope with two worn springs."""
    worn = np.zeros(N)
    worn[[N // 4, 2 * N // 3]] = np.log(0.5)
    log_k.from_numpy(worn)
    positions: list[Any] = []
    start()
    swing(by_newton, lambda t: positions.append(x.to_numpy()))
    seen.from_numpy(np.array(positions))
    return worn


def find() -> tuple[Any, list[float]]:
    """Adam on the logarithm of the stiffness; returns the losses."""
    guess, mean, square = np.zeros(N), 0.0, 0.0
    losses: list[float] = []
    bar = ti.tools.Progress(range(1, args.iterations + 1), "rope")
    for number in bar:
        log_k.from_numpy(guess)
        g, _ = gradient(by_newton)
        losses.append(loss[None])
        mean, square = 0.9 * mean + 0.1 * g, 0.99 * square + 0.01 * g**2
        corrected = mean / (1 - 0.9**number), square / (1 - 0.99**number)
        guess = guess - args.rate * corrected[0] / (np.sqrt(corrected[1]) + 1e-12)
        bar.note(f"loss {losses[-1]:.2e}")
    return guess, losses


def main():
    worn = record_truth()
    guess, losses = find()
    print(f"loss     {losses[0]:.3e} -> {losses[-1]:.3e}")
    print("worn    ", " ".join(f"{np.exp(k):.2f}" for k in worn))
    print("found   ", " ".join(f"{np.exp(k):.2f}" for k in guess))
    log_k.fill(0.0)
    exact = None
    for name, step in (("newton", by_newton), ("implicit", by_relaxation), ("unrolled", by_sweeps)):
        gradient(step)  # compiles
        began = time.perf_counter()
        g, tape = gradient(step)
        seconds = time.perf_counter() - began
        exact = g if exact is None else exact
        error = np.linalg.norm(g - exact) / np.linalg.norm(exact)
        print(
            f"{name:<9}{1e3 * seconds:8.1f} ms  {tape.memory / 1024:10.1f} KiB on the tape  "
            f"differs by {error:.1e}"
        )


if __name__ == "__main__":
    main()
