"""The snippets of the comparison in warp: kernels on arrays, and a tape.

python snippets_warp.py <snippet>
"""

import json
import math
import sys

import numpy as np
import warp as wp

wp.config.quiet = True
wp.init()
wp.set_device("cpu")


def numbers(*values, dtype=float):
    kind = {float: wp.float64, int: wp.int32}[dtype]
    return wp.array(np.array(values, dtype), dtype=kind, requires_grad=dtype is float)


def launch(kernel, *inputs, dim=1):
    wp.launch(kernel, dim=dim, inputs=list(inputs))


def finish(tape, loss, *wanted):
    tape.backward(loss)
    return [float(g) for w in wanted for g in w.grad.numpy().ravel()]


@wp.kernel
def power_kernel(x: wp.array(dtype=wp.float64), n: int, loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    y = wp.float64(1.0)
    for _ in range(n):
        y = y * x[i]
    wp.atomic_add(loss, 0, y)


def power(trips):
    x, loss = numbers(1.01, 0.99), numbers(0.0)
    with wp.Tape() as tape:
        launch(power_kernel, x, trips, loss, dim=2)
    return finish(tape, loss, x)


def loop_30():
    return power(30)


def loop_31():
    return power(31)


def loop_100():
    return power(100)


def loop_5000():
    return power(5000)


@wp.kernel
def field_length_kernel(
    x: wp.array(dtype=wp.float64), n: wp.array(dtype=wp.int32), loss: wp.array(dtype=wp.float64)
):
    i = wp.tid()
    y = wp.float64(1.0)
    for _ in range(n[i]):
        y = y * x[i]
    wp.atomic_add(loss, 0, y)


def loop_of_field_length():
    x, n, loss = numbers(1.01, 0.99), numbers(40, 7, dtype=int), numbers(0.0)
    with wp.Tape() as tape:
        launch(field_length_kernel, x, n, loss, dim=2)
    return finish(tape, loss, x)


@wp.kernel
def inner_loop_kernel(x: wp.array(dtype=wp.float64), n: int, loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    s = x[i] * x[i]
    for j in range(2 * n):
        wp.atomic_add(loss, 0, s * wp.float64(j))
    s = s * x[i]
    for j in range(n):
        wp.atomic_add(loss, 0, s * wp.float64(j + 1))


def statement_before_an_inner_loop():
    x, loss = numbers(3.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(inner_loop_kernel, x, 2, loss)
    return finish(tape, loss, x)


@wp.kernel
def while_kernel(x: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    y = x[i]
    while y < wp.float64(100.0):
        y = y * y
    wp.atomic_add(loss, 0, y)


def while_loop():
    x, loss = numbers(2.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(while_kernel, x, loss)
    return finish(tape, loss, x)


@wp.kernel
def break_kernel(x: wp.array(dtype=wp.float64), n: int, loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    y = x[i]
    for _ in range(n):
        if y > wp.float64(1000.0):
            break
        y = y * x[i]
    wp.atomic_add(loss, 0, y)


def break_in_a_loop():
    x, loss = numbers(2.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(break_kernel, x, 100, loss)
    return finish(tape, loss, x)


@wp.kernel
def continue_kernel(x: wp.array(dtype=wp.float64), n: int, loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    y = wp.float64(1.0)
    for j in range(n):
        if j % 2 == 1:
            continue
        y = y * x[i]
    wp.atomic_add(loss, 0, y)


def continue_in_a_loop():
    x, loss = numbers(2.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(continue_kernel, x, 6, loss)
    return finish(tape, loss, x)


@wp.kernel
def return_kernel(x: wp.array(dtype=wp.float64), n: int, loss: wp.array(dtype=wp.float64)):
    y = x[0] * x[0]
    wp.atomic_add(loss, 0, y)
    if n > 0:
        wp.atomic_add(loss, 0, y * x[0])
        return
    wp.atomic_add(loss, 0, wp.float64(100.0) * y)


def early_return():
    x, loss = numbers(2.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(return_kernel, x, 1, loss)
    return finish(tape, loss, x)


@wp.kernel
def twice_kernel(
    x: wp.array(dtype=wp.float64), y: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)
):
    i = wp.tid()
    y[i] = x[i]
    y[i] = y[i] * y[i]
    wp.atomic_add(loss, 0, y[i] * x[i])


def stored_twice():
    x, y, loss = numbers(3.0), numbers(0.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(twice_kernel, x, y, loss)
    return finish(tape, loss, x)


@wp.kernel
def total_kernel(x: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    wp.atomic_add(loss, 0, x[wp.tid()])


@wp.kernel
def scale_kernel(x: wp.array(dtype=wp.float64), y: wp.array(dtype=wp.float64)):
    i = wp.tid()
    y[i] = x[i]
    y[i] = y[i] * x[i]
    y[i] = y[i] * wp.float64(2.0)


def scaled_in_place():
    x, y, loss = numbers(3.0), numbers(0.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(scale_kernel, x, y)
        launch(total_kernel, y, loss)
    return finish(tape, loss, x)


@wp.kernel
def square_kernel(x: wp.array(dtype=wp.float64)):
    i = wp.tid()
    x[i] = x[i] + x[i] * x[i]


def square_added_in_place():
    x, loss = numbers(3.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(square_kernel, x)
        launch(total_kernel, x, loss)
    return finish(tape, loss, x)


@wp.kernel
def recurrence_kernel(x: wp.array(dtype=wp.float64), a: wp.array(dtype=wp.float64), n: int):
    for j in range(n):
        a[j + 1] = a[j] * x[j]


@wp.kernel
def last_kernel(a: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    wp.atomic_add(loss, 0, a[3])


def recurrence_along_an_axis():
    x, a, loss = numbers(2.0, 3.0, 5.0), numbers(1.0, 0.0, 0.0, 0.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(recurrence_kernel, x, a, 3)
        launch(last_kernel, a, loss)
    return finish(tape, loss, x)


@wp.kernel
def mask_kernel(x: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    wp.atomic_add(loss, 0, wp.where(x[i] > wp.float64(0.0), wp.sqrt(x[i]), wp.float64(0.0)))


def masked_root():
    x, loss = numbers(-1.0, 4.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(mask_kernel, x, loss, dim=2)
    return finish(tape, loss, x)


@wp.kernel
def branch_kernel(x: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    y = wp.float64(0.0)
    if x[i] > wp.float64(0.0):
        y = wp.sqrt(x[i])
    wp.atomic_add(loss, 0, y)


def untaken_branch():
    x, loss = numbers(-1.0, 4.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(branch_kernel, x, loss, dim=2)
    return finish(tape, loss, x)


@wp.kernel
def sigmoid_kernel(x: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    one = wp.float64(1.0)
    wp.atomic_add(loss, 0, one / (one + wp.exp(-x[wp.tid()])))


def saturated_sigmoid():
    x, loss = numbers(-800.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(sigmoid_kernel, x, loss)
    return finish(tape, loss, x)


@wp.kernel
def maximum_kernel(x: wp.array(dtype=wp.float64), y: wp.array(dtype=wp.float64)):
    wp.atomic_max(y, 0, x[wp.tid()])


@wp.kernel
def squares_kernel(y: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    i = wp.tid()
    wp.atomic_add(loss, 0, y[i] * y[i])


def atomic_maximum():
    x, y, loss = numbers(2.0, 7.0, 5.0), numbers(-100.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(maximum_kernel, x, y, dim=3)
        launch(squares_kernel, y, loss)
    return finish(tape, loss, x)


@wp.kernel
def old_value_kernel(
    x: wp.array(dtype=wp.float64), y: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)
):
    i = wp.tid()
    old = wp.atomic_add(y, i, x[i])
    wp.atomic_add(loss, 0, old * x[i])


def old_value_of_an_atomic():
    x, y, loss = numbers(3.0), numbers(2.0), numbers(0.0)
    with wp.Tape() as tape:
        launch(old_value_kernel, x, y, loss)
    return finish(tape, loss, x)


@wp.kernel
def step_kernel(x: wp.array(dtype=wp.float64), v: wp.array(dtype=wp.float64)):
    i = wp.tid()
    v[i] = v[i] - wp.float64(0.1) * x[i] * x[i] * x[i]
    x[i] = x[i] + wp.float64(0.1) * v[i]


def rollout_in_place():
    x, v, loss = numbers(1.0), numbers(0.5), numbers(0.0)
    with wp.Tape() as tape:
        for _ in range(20):
            launch(step_kernel, x, v)
        launch(total_kernel, x, loss)
    return finish(tape, loss, x, v)


@wp.kernel
def norm_kernel(v: wp.array(dtype=wp.vec3d), loss: wp.array(dtype=wp.float64)):
    wp.atomic_add(loss, 0, wp.length(v[wp.tid()]))


def norm_of(*components):
    v = wp.array([components], dtype=wp.vec3d, requires_grad=True)
    loss = numbers(0.0)
    with wp.Tape() as tape:
        launch(norm_kernel, v, loss)
    return finish(tape, loss, v)


def norm_of_zero():
    return norm_of(0.0, 0.0, 0.0)


def norm_of_a_tiny_vector():
    return norm_of(1e-200, 0.0, 0.0)


@wp.kernel
def tangent_kernel(x: wp.array(dtype=wp.float64), loss: wp.array(dtype=wp.float64)):
    wp.atomic_add(loss, 0, wp.tan(x[wp.tid()]))


def tangent():
    x, loss = numbers(0.3), numbers(0.0)
    with wp.Tape() as tape:
        launch(tangent_kernel, x, loss)
    return finish(tape, loss, x)


@wp.kernel
def polar_kernel(a: wp.array(dtype=wp.mat33d), loss: wp.array(dtype=wp.float64)):
    u = wp.mat33d()
    s = wp.vec3d()
    v = wp.mat33d()
    wp.svd3(a[wp.tid()], u, s, v)
    r = u * wp.transpose(v)
    wp.atomic_add(loss, 0, r[0, 1])


def polar_3d():
    a = wp.array(np.eye(3)[None], dtype=wp.mat33d, requires_grad=True)
    loss = numbers(0.0)
    with wp.Tape() as tape:
        launch(polar_kernel, a, loss)
    return finish(tape, loss, a)


if __name__ == "__main__":
    if sys.argv[1] not in globals():
        print("NOTHING")
    else:
        found = globals()[sys.argv[1]]()
        print("GRADIENT", json.dumps([None if math.isnan(g) else g for g in found]))
