"""A point bounces off the ground: only the exact time of impact gives the right gradient."""

import argparse

import tai as ti
from results import report

real = ti.f32
ti.init(default_fp=real)

max_steps = 204
dt = 0.002
ground = 0.1

scalar = lambda: ti.field(dtype=real)  # noqa: E731
vec = lambda: ti.Vector.field(2, dtype=real)  # noqa: E731
loss = scalar()
x, v = vec(), vec()
ti.root.dense(ti.i, max_steps).place(x, v)
ti.root.place(loss)
ti.root.lazy_grad()


@ti.kernel
def advance_toi(t: ti.i32):
    old_v = v[t - 1]
    new_v = old_v
    toi = 0.0
    old_x = x[t - 1]
    new_x = old_x + dt * old_v
    if new_x[1] < ground and old_v[1] < 0:
        new_v[1] = -old_v[1]
        toi = -(old_x[1] - ground) / old_v[1]
    v[t] = new_v
    x[t] = x[t - 1] + toi * old_v + (dt - toi) * new_v


@ti.kernel
def advance_no_toi(t: ti.i32):
    new_v = v[t - 1]
    if x[t - 1][1] < ground and new_v[1] < 0:
        new_v[1] = -new_v[1]
    v[t] = new_v
    x[t] = x[t - 1] + dt * new_v


@ti.kernel
def compute_loss(t: ti.i32):
    loss[None] = x[t][1]


def simulate(offset, use_toi, clear):
    x[0] = [0.7, 0.5 + offset]
    v[0] = [-1, -2]
    if clear == "all":
        ti.ad.clear_all_gradients()
    with ti.ad.Tape(loss=loss):
        for t in range(1, max_steps):
            if use_toi:
                advance_toi(t)
            else:
                advance_no_toi(t)
        compute_loss(max_steps - 1)
    return loss[None], x.grad[0][1], v.grad[0][1]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--zoom", type=int, default=4)
    args = parser.parse_args()
    coarse = {}
    for name, use_toi in (("naive", False), ("toi", True)):
        coarse[name] = [simulate(0.02 * i, use_toi, "all") for i in range(15)]
        coarse[name + "_zoom"] = [
            simulate(0.26 + 1e-4 * i, use_toi, "tape")[0] for i in range(args.zoom)
        ]
    report(**coarse)


if __name__ == "__main__":
    main()
