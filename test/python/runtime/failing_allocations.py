"""Runs a scene again and again; each time one more of its allocations fails.

Each must raise MemoryError or succeed, and what runs afterwards must be right. The library of
`failing_allocations.c` is preloaded.
"""

import ctypes
import faulthandler
import sys

import numpy as np
import tai as ti

faulthandler.enable()
hook = ctypes.CDLL(None)
hook.begin_failing.argtypes = [ctypes.c_long]
hook.end_failing.restype = ctypes.c_long

THREADS = int(sys.argv[2])
ti.init(arch=ti.cpu, log_level=ti.ERROR, cpu_max_num_threads=THREADS)
N = 65_537
x = ti.field(ti.f32, N, needs_grad=True)
y = ti.field(ti.f32, N, needs_grad=True)
loss = ti.field(ti.f32, (), needs_grad=True)
s = ti.field(ti.i32)
block = ti.root.pointer(ti.i, 64)
block.dense(ti.i, 16).place(s)
a, ones = np.ones(100, np.float32), np.ones(N, np.float32)


@ti.kernel
def step():
    for i in x:
        y[i] = 2 * x[i] + y[i]


@ti.kernel
def total():
    for i in range(1000):
        loss[None] += y[i] * y[i]


@ti.kernel
def grow(n: ti.i32):
    for i in range(n):
        s[i * 16] = i + 1


@ti.kernel
def count() -> ti.i32:
    c = 0
    for _i in s:
        c += 1
    return c


@ti.kernel
def scale(a: ti.types.ndarray(), f: ti.f32):
    for i in range(a.shape[0]):
        a[i] = a[i] * f


def launches():
    step()
    scale(a, 1.0)
    step()


def taped():
    with ti.ad.Tape(loss):
        step()
        step()
        total()


def recomputed():
    with ti.ad.Tape(loss, checkpoint=1):
        for _ in range(4):
            step()
        total()


def again():
    tape = ti.ad.Tape(loss)
    with tape:
        step()
        total()
    tape.grad()


def copies():
    x.from_numpy(ones)
    x.to_numpy()
    y.fill(2.0)
    x[5] = 1.0
    assert x[5] == 1
    y.copy_from(x)


def sparse():
    grow(40)
    count()
    block.deactivate_all()
    grow(10)
    count()
    s.to_numpy()
    s.fill(1)


SCENES = {
    "launches": launches, "taped": taped, "recomputed": recomputed, "again": again,
    "copies": copies, "sparse": sparse,
}  # fmt: skip


def prepare():
    x.fill(1)
    y.fill(1)


def check():
    prepare()
    step()
    assert y[7] == 3, y[7]
    prepare()
    taped()
    assert loss[None] == 25_000, loss[None]
    assert x.grad[3] == 40, x.grad[3]
    assert x.grad[1000] == 0
    block.deactivate_all()
    grow(20)
    assert count() == 320
    x.from_numpy(ones * 3)
    assert x.to_numpy().sum() == 3 * N
    scale(a, 2.0)
    assert a[3] == 2
    a[:] = 1


def main():
    scene = SCENES[sys.argv[1]]
    for run in SCENES.values():
        prepare()
        run()
    check()
    check()
    number = failed = 0
    while True:
        prepare()
        hook.begin_failing(number)
        error = None
        try:
            scene()
        except MemoryError as caught:
            error = caught
        finally:
            made = hook.end_failing()
        failed += error is not None
        error = None
        check()
        if made <= number:
            break
        number += 1
    print(number, failed)


main()
