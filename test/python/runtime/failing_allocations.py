"""Runs a scene again and again; each time one more of its allocations fails.

Each must raise MemoryError or succeed, and what runs afterwards must be right. The library of
`failing_allocations.c` is preloaded.
"""

import ctypes
import faulthandler
import sys
import tempfile
from pathlib import Path

import numpy as np
import tai as ti

faulthandler.enable()
hook = ctypes.CDLL(None)
hook.begin_failing.argtypes = [ctypes.c_long]
hook.end_failing.restype = ctypes.c_long

THREADS = int(sys.argv[2])
if THREADS == 0:
    # The emulated device: the environment says so.
    ti.init(arch=ti.cuda, log_level=ti.ERROR)
else:
    ti.init(arch=ti.cpu, log_level=ti.ERROR, cpu_max_num_threads=THREADS)
N = 65_537
x = ti.field(ti.f32, N, needs_grad=True)
y = ti.field(ti.f32, N, needs_grad=True)
loss = ti.field(ti.f32, (), needs_grad=True)
s = ti.field(ti.i32)
block = ti.root.pointer(ti.i, 64)
block.dense(ti.i, 16).place(s)
w = ti.field(ti.f32, needs_grad=True)
patches = ti.root.pointer(ti.i, 64)
patches.dense(ti.i, 16).place(w, w.grad)
few = ti.field(ti.f32, 3, needs_grad=True)
cost = ti.field(ti.f32, (), needs_grad=True)
points = ti.Vector.field(3, ti.f64, 1000)
b = ti.ndarray(ti.f32, 500, needs_grad=True)
worlds = ti.batch(8)
v = worlds.field(ti.f32, 3, needs_grad=True)
losses = worlds.field(ti.f32, needs_grad=True)
ti.root.lazy_dual()
a, ones = np.ones(100, np.float32), np.ones(N, np.float32)
places = np.arange(3000, dtype=np.float64).reshape(1000, 3)


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


@ti.kernel
def quartic():
    for i in few:
        cost[None] += few[i] ** 4


@ti.kernel
def spread(n: ti.i32):
    for i in range(n):
        w[i * 16] += 2.0


@ti.kernel
def total_of_patches():
    for i in w:
        loss[None] += w[i] * w[i]


@ti.kernel
def total_of_array(b: ti.types.ndarray()):
    for i in range(b.shape[0]):
        loss[None] += b[i] * b[i]


@worlds.kernel
def move():
    for i in v:
        v[i] = v[i] * 2.0


@worlds.kernel
def measure():
    losses[None] += v[0] * v[0]


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


kept_tape = ti.ad.Tape(loss)


def replayed():
    kept_tape.replay()
    kept_tape.replay(backward=False)


def record_again():
    """A tape may say that it is to be recorded again."""
    with kept_tape:
        step()
        step()
        total()


def recomputed_replay():
    with ti.ad.Tape(loss, checkpoint=2) as tape:
        for _ in range(3):
            step()
        total()
    tape.replay()


def forward():
    with ti.ad.FwdMode(loss=cost, param=few, seed=[1.0, 0.0, 0.0]):
        quartic()


def hessian():
    product = ti.ad.hvp(quartic, cost, few, np.array([1.0, 0.0, 0.0], np.float32))
    assert product[0] == 12, product


def sparse_tape():
    patches.deactivate_all()
    with ti.ad.Tape(loss):
        spread(20)
        total_of_patches()


def arrays():
    b.fill(2.0)
    with ti.ad.Tape(loss):
        total_of_array(b)
    b.to_numpy()
    b.from_numpy(ones[:500])


def batch():
    with worlds.tape(losses):
        move()
        measure()


def vectors():
    points.from_numpy(places)
    assert points.to_numpy()[7, 1] == 22
    points[3] = ti.Vector([1.0, 2.0, 3.0])


saved_path = Path(tempfile.mkdtemp()) / "state.npz"


def saved():
    try:
        ti.checkpoint.save(saved_path, few=few, points=points)
        ti.checkpoint.load(saved_path, few=few, points=points)
    except (RuntimeError, SystemError, OSError) as error:
        # CPython's locks of files and NumPy's iterators say it in other ways.
        raise MemoryError from error


SCENES = {
    "launches": launches, "taped": taped, "recomputed": recomputed, "again": again,
    "copies": copies, "sparse": sparse, "replayed": replayed,
    "recomputed_replay": recomputed_replay, "forward": forward, "hessian": hessian,
    "sparse_tape": sparse_tape, "arrays": arrays, "batch": batch, "vectors": vectors,
    "saved": saved,
}  # fmt: skip


def prepare():
    x.fill(1)
    y.fill(1)
    few.fill(1)


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
    prepare()
    try:
        kept_tape.replay()
    except ti.TaiMemoryError as error:
        assert "record it again" in str(error)
        record_again()
        prepare()
        kept_tape.replay()
    assert loss[None] == 25_000, loss[None]
    assert x.grad[3] == 40, x.grad[3]
    assert x.grad[1000] == 0
    hessian()
    sparse_tape()
    assert loss[None] == 80, loss[None]
    assert w.grad[16] == 4, w.grad[16]
    arrays()
    assert b.grad.to_numpy().sum() == 2000
    v.fill(1.0)
    batch()
    assert (losses.to_numpy() == 4).all()
    assert (v.grad.to_numpy()[:, 0] == 8).all()
    vectors()
    few.fill(0)
    ti.checkpoint.load(saved_path, few=few, points=points)
    assert few[1] == 1


def main():
    scene = SCENES[sys.argv[1]]
    record_again()
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
