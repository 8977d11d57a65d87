"""Smooth programs in which launches overwrite values; each makes its fields.

A program returns the function that runs it, the loss and the inputs.
"""

import tai as ti

PROGRAMS = {}


def program(build):
    PROGRAMS[build.__name__] = build
    return build


def both(shape=(), dtype=None):
    return ti.field(dtype or ti.f64, shape=shape, needs_grad=True, needs_dual=True)


def vectors(n, shape):
    return ti.Vector.field(n, ti.f64, shape=shape, needs_grad=True, needs_dual=True)


def matrices(n, shape):
    return ti.Matrix.field(n, n, ti.f64, shape=shape, needs_grad=True, needs_dual=True)


def squares_of(x, loss):
    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    return measure


# Values that later launches overwrite


@program
def copy_in_a_second_launch():
    x, y, loss = both(), both(), both()

    @ti.kernel
    def copy():
        y[None] = x[None]

    @ti.kernel
    def square():
        loss[None] += y[None] ** 3 * x[None]

    def run():
        copy()
        square()
        copy()
        square()

    return run, loss, [x]


@program
def sine_of_itself():
    x, loss = both(), both()

    @ti.kernel
    def step():
        x[None] = ti.sin(x[None]) * 1.3

    @ti.kernel
    def measure():
        loss[None] += x[None] ** 2

    def run():
        for _ in range(5):
            step()
        measure()

    return run, loss, [x]


@program
def pendulum_in_place():
    state, loss = both(2), both()

    @ti.kernel
    def step(dt: ti.f64):
        state[1] += -dt * ti.sin(state[0])
        state[0] += dt * state[1]

    @ti.kernel
    def measure():
        loss[None] += state[0] ** 2 + ti.exp(state[1])

    def run():
        for _ in range(40):
            step(0.05)
        measure()

    return run, loss, [state]


@program
def springs_in_place():
    n = 7
    x, v, k, loss = both(n), both(n), both(), both()

    @ti.kernel
    def forces():
        for i in range(n):
            f = -ti.sin(x[i]) * k[None]
            if i > 0:
                f += k[None] * (x[i - 1] - x[i]) ** 3
            if i < n - 1:
                f += k[None] * (x[i + 1] - x[i]) ** 3
            v[i] += 0.1 * f

    @ti.kernel
    def move():
        for i in x:
            x[i] += 0.1 * v[i]

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += (x[i] - 0.2 * i) ** 2

    def run():
        for _ in range(20):
            forces()
            move()
        measure()

    return run, loss, [x, v, k]


@program
def swap_of_two_buffers():
    n = 9
    a, b, loss = both(n), both(n), both()

    @ti.kernel
    def diffuse(source: ti.template(), target: ti.template()):
        for i in source:
            left, right = source[ti.max(i - 1, 0)], source[ti.min(i + 1, n - 1)]
            target[i] = source[i] + 0.2 * (left - 2 * source[i] + right) + 0.05 * source[i] ** 2

    @ti.kernel
    def measure():
        for i in a:
            loss[None] += a[i] ** 2

    def run():
        for _ in range(6):
            diffuse(a, b)
            diffuse(b, a)
        measure()

    return run, loss, [a]


@program
def swap_inside_a_kernel():
    n = 5
    a, b, loss = both(n), both(n), both()

    @ti.kernel
    def swap():
        for i in a:
            t = a[i]
            a[i] = ti.sin(b[i])
            b[i] = t * 1.1

    @ti.kernel
    def measure():
        for i in a:
            loss[None] += a[i] ** 2 * b[i]

    def run():
        for _ in range(5):
            swap()
        measure()

    return run, loss, [a, b]


@program
def copy_from_of_fields():
    x, old, loss = both(6), both(6), both()

    @ti.kernel
    def step():
        for i in x:
            x[i] = old[i] - 0.1 * old[(i + 1) % 6] ** 2

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 3

    def run():
        for _ in range(8):
            old.copy_from(x)
            step()
        measure()

    return run, loss, [x]


@program
def damping():
    v, c, loss = both(4), both(), both()

    @ti.kernel
    def step():
        for i in v:
            v[i] *= ti.exp(-c[None] * v[i] ** 2)

    @ti.kernel
    def measure():
        for i in v:
            loss[None] += v[i]

    def run():
        for _ in range(10):
            step()
        measure()

    return run, loss, [v, c]


@program
def accumulated_force():
    n = 6
    x, f, v, loss = both(n), both(n), both(n), both()

    @ti.kernel
    def clear():
        for i in f:
            f[i] = 0

    @ti.kernel
    def collect():
        for i, j in ti.ndrange(n, n):
            if i != j:
                d = x[j] - x[i]
                f[i] += d / (1 + d * d)

    @ti.kernel
    def move():
        for i in x:
            v[i] += 0.1 * f[i]
            x[i] += 0.1 * v[i]

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 4

    def run():
        for _ in range(10):
            clear()
            collect()
            move()
        measure()

    return run, loss, [x]


@program
def fill_by_the_host():
    x, f, loss = both(4), both(4), both()

    @ti.kernel
    def collect():
        for i in x:
            f[i] += x[i] ** 2

    @ti.kernel
    def move():
        for i in x:
            x[i] -= 0.1 * f[i] * x[i]

    measure = squares_of(x, loss)

    def run():
        for _ in range(4):
            f.fill(0)
            collect()
            move()
        measure()

    return run, loss, [x]


@program
def elements_written_by_the_host():
    x, scale, loss = both(3), both(2), both()

    @ti.kernel
    def step():
        for i in x:
            scale[1] += x[i]
            x[i] = x[i] * scale[0] + 0.1 * x[i] ** 2

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2 * scale[1]

    def run():
        for k in range(4):
            scale[0] = 0.9 + 0.1 * k
            step()
        measure()

    return run, loss, [x]


# Values that the same launch overwrites


@program
def two_loops_of_a_kernel():
    x, y, loss = both(5), both(5), both()

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = ti.sin(x[i])
        for i in x:
            x[i] = y[i] * x[i]
        for i in x:
            y[i] = x[i] ** 2 + y[i]
        for i in x:
            loss[None] += y[i] * x[i]

    def run():
        kernel()
        kernel()

    return run, loss, [x]


@program
def time_loop_in_a_kernel():
    state, loss = both(2), both()

    @ti.kernel
    def kernel():
        for _ in range(1):
            for _ in range(30):
                state[1] -= 0.1 * ti.sin(state[0])
                state[0] += 0.1 * state[1]
            loss[None] += state[0] ** 2 * state[1]

    return kernel, loss, [state]


@program
def serial_time_loop_of_many():
    n = 4
    x, v, loss = both(n), both(n), both()

    @ti.kernel
    def kernel():
        for i in x:
            for _ in range(15):
                v[i] -= 0.1 * x[i] ** 3
                x[i] += 0.1 * v[i]
        for i in x:
            loss[None] += x[i] ** 2

    return kernel, loss, [x, v]


@program
def stored_twice():
    x, y, loss = both(4), both(4), both()

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = x[i] ** 2
            a = ti.sin(y[i])
            y[i] = a * x[i]
            loss[None] += y[i] ** 2

    def run():
        kernel()
        kernel()

    return run, loss, [x]


@program
def prefix_sum_in_place():
    x, loss = both(6), both()

    @ti.kernel
    def kernel():
        for _ in range(1):
            for i in range(1, 6):
                x[i] += ti.sin(x[i - 1])
        for i in x:
            loss[None] += x[i] ** 2

    return kernel, loss, [x]


@program
def recurrence_over_an_axis():
    u, loss = both((8, 3)), both()

    @ti.kernel
    def kernel():
        for j in range(3):
            for t in range(1, 8):
                u[t, j] = u[t - 1, j] + 0.3 * ti.sin(u[t - 1, j]) * u[0, j]
        for j in range(3):
            loss[None] += u[7, j] ** 2

    def run():
        kernel()
        kernel()

    return run, loss, [u]


@program
def branch_that_overwrites():
    x, loss = both(6), both()

    @ti.kernel
    def step():
        for i in x:
            if x[i] > 0.5:
                x[i] = ti.log(x[i] + 1)
            else:
                x[i] = x[i] ** 2 + 0.1

    measure = squares_of(x, loss)

    def run():
        for _ in range(3):
            step()
        measure()

    return run, loss, [x]


@program
def while_loop():
    x, loss = both(4), both()

    @ti.kernel
    def kernel():
        for i in x:
            k = 0
            while k < 3 + i:
                x[i] = x[i] - 0.2 * ti.sin(2 * x[i])
                k += 1
            loss[None] += x[i] ** 2

    def run():
        kernel()
        kernel()

    return run, loss, [x]


@program
def while_loop_with_a_break():
    x, y, loss = both(4), both(4), both()

    @ti.kernel
    def kernel():
        for i in x:
            v = x[i]
            for _ in range(50):
                if v > 4:
                    break
                v = v * 1.5 + 0.1 * v * v
                y[i] += v
            loss[None] += y[i] * v

    def run():
        kernel()
        kernel()

    return run, loss, [x]


@program
def local_arrays():
    x, loss = both(4), both()

    @ti.kernel
    def step():
        for i in x:
            a = ti.Vector([x[i], x[i] ** 2, ti.sin(x[i]), 1.0])
            for k in range(3):
                a[k + 1] += a[k] * a[(k + 2) % 4]
            x[i] = a.sum() * 0.2

    measure = squares_of(x, loss)

    def run():
        for _ in range(3):
            step()
        measure()

    return run, loss, [x]


@program
def local_history():
    x, loss = both(3), both()

    @ti.kernel
    def step():
        for i in x:
            p = ti.Vector([x[i], 0.3])
            for _ in range(10):
                p = ti.Vector([ti.sin(p.x + p.y), ti.cos(p.x) * p.y])
            x[i] = p.x + p.y * x[i]

    measure = squares_of(x, loss)

    def run():
        for _ in range(4):
            step()
        measure()

    return run, loss, [x]
