"""The snippets of the comparison, for tai and taichi: the same source for both.

    python snippets_taichi.py <tai or taichi> <snippet>

prints the gradient as a JSON list. Each function is a program of its own; compare.py has the
expected values.
"""

import json
import math
import sys

if sys.argv[1] == "tai":
    import tai as ti
else:
    import taichi as ti


def numbers(*values, needs_grad=True):
    """A field of these numbers."""
    made = ti.field(ti.f64, shape=len(values), needs_grad=needs_grad)
    for i, value in enumerate(values):
        made[i] = value
    return made


def scalar():
    return ti.field(ti.f64, shape=(), needs_grad=True)


def tape(loss, *kernels):
    with ti.ad.Tape(loss=loss):
        for kernel in kernels:
            kernel()


def grad(x):
    return x.grad.to_numpy().ravel().tolist()


def power(trips):
    x, loss = numbers(1.01, 0.99), scalar()

    @ti.kernel
    def run():
        for i in x:
            y = 1.0
            for _ in range(trips):
                y *= x[i]
            loss[None] += y

    tape(loss, run)
    return grad(x)


def loop_30():
    return power(30)


def loop_31():
    return power(31)


def loop_100():
    return power(100)


def loop_5000():
    return power(5000)


def loop_of_field_length():
    x, loss = numbers(1.01, 0.99), scalar()
    n = ti.field(ti.i32, shape=2)
    n[0], n[1] = 40, 7

    @ti.kernel
    def run():
        for i in x:
            y = 1.0
            for _ in range(n[i]):
                y *= x[i]
            loss[None] += y

    tape(loss, run)
    return grad(x)


def loop_carrying_a_vector():
    x, loss = numbers(0.3), scalar()

    @ti.kernel
    def run():
        for i in x:
            v = ti.Vector([1.0, 0.5])
            for _ in range(40):
                v = ti.Vector([v[0] - 0.1 * x[i] * v[1], v[1] + 0.1 * x[i] * v[0]])
            loss[None] += v[0]

    tape(loss, run)
    return grad(x)


def statement_before_an_inner_loop():
    x, loss = numbers(3.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            s = x[i] * x[i]
            for j in range(4):
                loss[None] += s * j
            s = s * x[i]
            for j in range(2):
                loss[None] += s * (j + 1)

    tape(loss, run)
    return grad(x)


def while_loop():
    x, loss = numbers(2.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            y = x[i]
            while y < 100.0:
                y = y * y
            loss[None] += y

    tape(loss, run)
    return grad(x)


def break_in_a_loop():
    x, loss = numbers(2.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            y = x[i]
            for _ in range(100):
                if y > 1000.0:
                    break
                y = y * x[i]
            loss[None] += y

    tape(loss, run)
    return grad(x)


def continue_in_a_loop():
    x, loss = numbers(2.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            y = 1.0
            for j in range(6):
                if j % 2 == 1:
                    continue
                y = y * x[i]
            loss[None] += y

    tape(loss, run)
    return grad(x)


def early_return():
    x, loss = numbers(2.0), scalar()

    @ti.kernel
    def run(n: ti.i32):
        y = x[0] * x[0]
        loss[None] += y
        if n > 0:
            loss[None] += y * x[0]
            return
        loss[None] += 100 * y

    with ti.ad.Tape(loss=loss):
        run(1)
    return grad(x)


def stored_twice():
    x, y, loss = numbers(3.0), numbers(0.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            y[i] = x[i]
            y[i] = y[i] * y[i]
            loss[None] += y[i] * x[i]

    tape(loss, run)
    return grad(x)


def scaled_in_place():
    x, y, loss = numbers(3.0), numbers(0.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            y[i] = x[i]
            y[i] *= x[i]
            y[i] *= 2.0

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i]

    tape(loss, run, total)
    return grad(x)


def square_added_in_place():
    x, loss = numbers(3.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            x[i] += x[i] * x[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    tape(loss, run, total)
    return grad(x)


def swap():
    x, loss = numbers(3.0, 5.0), scalar()

    @ti.kernel
    def run():
        for _ in range(1):
            a = x[0] * x[0]
            x[0] = x[1]
            x[1] = a

    @ti.kernel
    def total():
        for _ in range(1):
            loss[None] += x[0] + 10 * x[1]

    tape(loss, run, total)
    return grad(x)


def recurrence_along_an_axis():
    x, a, loss = numbers(2.0, 3.0, 5.0), numbers(1.0, 0.0, 0.0, 0.0), scalar()

    @ti.kernel
    def run():
        for _ in range(1):
            for j in range(3):
                a[j + 1] = a[j] * x[j]

    @ti.kernel
    def total():
        for _ in range(1):
            loss[None] += a[3]

    tape(loss, run, total)
    return grad(x)


def masked_root():
    x, loss = numbers(-1.0, 4.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.select(x[i] > 0, ti.sqrt(x[i]), 0.0)

    tape(loss, run)
    return grad(x)


def untaken_branch():
    x, loss = numbers(-1.0, 4.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            y = 0.0
            if x[i] > 0:
                y = ti.sqrt(x[i])
            loss[None] += y

    tape(loss, run)
    return grad(x)


def saturated_sigmoid():
    x, loss = numbers(-800.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += 1 / (1 + ti.exp(-x[i]))

    tape(loss, run)
    return grad(x)


def atomic_product():
    x, loss = numbers(2.0, 3.0, 5.0), scalar()
    y = numbers(1.0)

    @ti.kernel
    def run():
        for i in x:
            ti.atomic_mul(y[0], x[i])

    @ti.kernel
    def total():
        for _ in range(1):
            loss[None] += y[0]

    tape(loss, run, total)
    return grad(x)


def atomic_maximum():
    x, loss = numbers(2.0, 7.0, 5.0), scalar()
    y = numbers(-100.0)

    @ti.kernel
    def run():
        for i in x:
            ti.atomic_max(y[0], x[i])

    @ti.kernel
    def total():
        for _ in range(1):
            loss[None] += y[0] * y[0]

    tape(loss, run, total)
    return grad(x)


def old_value_of_an_atomic():
    x, y, loss = numbers(3.0), numbers(2.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            old = ti.atomic_add(y[i], x[i])
            loss[None] += old * x[i]

    tape(loss, run)
    return grad(x)


def rollout_in_place():
    x, v, loss = numbers(1.0), numbers(0.5), scalar()

    @ti.kernel
    def step():
        for i in x:
            v[i] += -0.1 * x[i] * x[i] * x[i]
            x[i] += 0.1 * v[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    tape(loss, *[step] * 20, total)
    return grad(x) + grad(v)


def gather_and_scatter():
    x, loss = numbers(1.0, 2.0, 3.0, 4.0), scalar()
    p = ti.field(ti.i32, shape=4)
    y = ti.field(ti.f64, shape=(8, 2), needs_grad=True)
    for i, target in enumerate((3, 1, 3, 0)):
        p[i] = target

    @ti.kernel
    def run():
        for i in x:
            y[p[i] * 2, i % 2] += x[(i + p[i]) % 4] * x[i]

    @ti.kernel
    def total():
        for i, j in y:
            loss[None] += (i + 1) * (j + 1) * y[i, j]

    tape(loss, run, total)
    return grad(x)


def index_into_a_local_vector():
    x, loss = numbers(2.0, 3.0), scalar()
    k = ti.field(ti.i32, shape=())
    k[None] = 1

    @ti.kernel
    def run():
        for _ in range(1):
            v = ti.Vector([x[0] * x[1], x[1] * x[1], 0.0])
            v[k[None] + 1] = v[k[None]] * x[0]
            loss[None] += v[2] + v[k[None] - 1]

    tape(loss, run)
    return grad(x)


def norm_of_zero():
    v = ti.Vector.field(3, ti.f64, shape=1, needs_grad=True)
    loss = scalar()

    @ti.kernel
    def run():
        for i in v:
            loss[None] += v[i].norm()

    tape(loss, run)
    return grad(v)


def norm_of_a_tiny_vector():
    v = ti.Vector.field(3, ti.f64, shape=1, needs_grad=True)
    v[0] = [1e-200, 0.0, 0.0]
    loss = scalar()

    @ti.kernel
    def run():
        for i in v:
            loss[None] += v[i].norm()

    tape(loss, run)
    return grad(v)


def tangent():
    x, loss = numbers(0.3), scalar()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.tan(x[i])

    tape(loss, run)
    return grad(x)


def polar_3d():
    a = ti.Matrix.field(3, 3, ti.f64, shape=1, needs_grad=True)
    a[0] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    loss = scalar()

    @ti.kernel
    def run():
        for i in a:
            r, s = ti.polar_decompose(a[i], ti.f64)
            loss[None] += r[0, 1]

    tape(loss, run)
    return grad(a)


def svd_product():
    a = ti.Matrix.field(2, 2, ti.f64, shape=1, needs_grad=True)
    a[0] = [[1.0, 0.0], [0.0, 1.0]]
    loss = scalar()

    @ti.kernel
    def run():
        for i in a:
            u, s, v = ti.svd(a[i], ti.f64)
            b = u @ s @ v.transpose()
            loss[None] += b[0, 0] + 2 * b[0, 1] + 3 * b[1, 0] + 4 * b[1, 1]

    tape(loss, run)
    return grad(a)


def second_order():
    """Forward over reverse: d/dx of the gradient of x^4, along 1."""
    x = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    x[None] = 2.0

    @ti.kernel
    def run():
        loss[None] += x[None] ** 4

    if sys.argv[1] == "tai":
        return [float(ti.ad.hvp(run, loss, x, 1.0))]
    with ti.ad.FwdMode(loss=x.grad, param=x, seed=[1.0]):
        loss[None] = 0.0
        loss.grad[None] = 1.0
        x.grad[None] = 0.0
        run.grad()
    return [x.grad.dual[None]]


def random_numbers():
    """The gradient of r x is r, the number that was drawn in the forward pass."""
    x, loss = numbers(2.0), scalar()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.random(ti.f64) * x[i] * x[i]

    tape(loss, run)
    return [grad(x)[0] / loss[None]]


def returned_value():
    """The gradient of the result of a kernel."""
    x = numbers(3.0)

    @ti.kernel
    def energy() -> ti.f64:
        e = 0.0
        for i in range(1):
            e += x[i] * x[i]
        return e

    if sys.argv[1] == "tai":
        with ti.ad.Tape() as tape:
            result = energy()
        tape.backward(result)
    else:
        with ti.ad.Tape(loss=energy()):
            pass
    return grad(x)


if __name__ == "__main__":
    ti.init(arch=ti.cpu, default_fp=ti.f64, offline_cache=False)
    found = globals()[sys.argv[2]]()
    print("GRADIENT", json.dumps([None if math.isnan(g) else g for g in found]))
