"""The program that r18_reproducers.py runs: one kernel, launched in the way that the argument
names.

A sequence of launches that comes again becomes one program of a device. Where that cannot be made,
they are launched one by one, and the tape says why.
"""

import sys

import tai as ti

WHAT = sys.argv[1]

ti.init(**({"bounds": "clamp"} if WHAT == "clamp" else {}))
x = ti.field(ti.f32, shape=8, needs_grad=True, needs_dual=True)
y = ti.field(ti.f32, shape=(), needs_grad=True, needs_dual=True)


@ti.kernel
def accumulate():
    for i in x:
        y[None] += ti.sin(x[i]) * x[i]


def run() -> None:
    if WHAT == "gradient":
        with ti.ad.Tape(y):
            accumulate()
    elif WHAT == "program":
        with ti.ad.Tape(y) as tape:
            for _ in range(4):
                accumulate()
        for _ in range(3):
            tape.replay()
        print(tape.explain())
    elif WHAT == "checks":
        with ti.ad.Tape(y, validation=True):
            accumulate()
    elif WHAT == "tangent":
        with ti.ad.FwdMode(loss=y, param=x, seed=[1.0] * 8):
            accumulate()
    else:
        accumulate()
    ti.sync()


# Twice: a second try leaves no second file. Indices are clamped where a kernel is made, and the
# next try makes another one; a second tape makes a sequence of other launches come again.
for _ in range(1 if WHAT in ("clamp", "program") else 2):
    try:
        run()
    except ti.TaiError as error:
        print(error)
