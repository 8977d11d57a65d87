"""How damping keeps the gradient of a long simulation from growing."""

import argparse
import math

import tai as ti
from results import report

ti.init(default_fp=ti.f32)
dt = 0.001
loss = ti.field(dtype=ti.f32, shape=(), needs_grad=True)
x = ti.field(dtype=ti.f32, shape=10000, needs_grad=True)
v = ti.field(dtype=ti.f32, shape=10000, needs_grad=True)
a = ti.field(dtype=ti.f32, shape=(), needs_grad=True)
damping = ti.field(dtype=ti.f32, shape=(), needs_grad=True)


@ti.kernel
def advance(t: ti.i32):
    v[t] = damping[None] * v[t - 1] + a[None]
    x[t] = x[t - 1] + dt * v[t]


@ti.kernel
def compute_loss(t: ti.i32):
    loss[None] = x[t]


def gradient(alpha, num_steps):
    damping[None] = math.exp(-dt * alpha)
    a[None] = 1
    with ti.ad.Tape(loss):
        for i in range(1, num_steps):
            advance(i)
        compute_loss(num_steps - 1)
    return loss[None], a.grad[None], damping.grad[None]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--longest", type=int, default=950)
    args = parser.parse_args()
    steps = range(50, args.longest + 1, 150)
    report(**{f"alpha{k}": [gradient(k, n) for n in steps] for k in (0, 1, 3, 10)})
