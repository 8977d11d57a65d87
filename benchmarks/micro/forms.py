"""Forms that users write, against the form that the compiler knows best: stencils and gradients.

    python benchmarks/micro/forms.py                      # all rows, half a minute
    python benchmarks/micro/forms.py guard fdtd --threads 1

Each row is a kernel and another one that computes the same, or does the same amount of work. All
kernels of a row run in turns in one process, and the least of the rounds counts: processor time of
one thread, or the clock where there are more. `forward` and `adjoint` are the ratios of the row's
form to its reference; `own` is the adjoint against the forward kernel of the same form, and the
last column compares the adjoint with that on one thread.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import tai as ti

ROUNDS = 15
SECONDS = 0.002
ROWS = {}


def row(function):
    ROWS[function.__name__] = function
    return function


def real(*shape, vector=0, layout=None):
    """A field of random numbers with an adjoint."""
    extra = {} if layout is None else {"layout": layout}
    made = (
        ti.Vector.field(vector, ti.f32, shape=shape, needs_grad=True, **extra)
        if vector
        else ti.field(ti.f32, shape=shape, needs_grad=True)
    )
    whole = made.shape + ((vector,) if vector else ())
    for seed, part in enumerate((made, made.grad)):
        values = np.random.RandomState(seed).random_sample(whole)
        part.from_numpy(values.astype(np.float32))
    return made


class Taped:
    """A kernel and a loss, and both with their gradient on a tape."""

    def __init__(self, kernel, loss_of, loss):
        self.kernel, self.loss_of, self.loss = kernel, loss_of, loss

    def __call__(self):
        self.kernel()
        self.loss_of()

    def grad(self):
        with ti.ad.Tape(self.loss):
            self()


def time_axis(n):
    """A step within one field, whose last element is left alone."""
    x = real(3, n)

    @ti.kernel
    def guarded(t: ti.i32):
        for i in range(n):
            if i < n - 1:
                x[t + 1, i] = x[t, i + 1] - x[t, i]

    @ti.kernel
    def bounded(t: ti.i32):
        for i in range(n - 1):
            x[t + 1, i] = x[t, i + 1] - x[t, i]

    return [("guard", guarded, (0,)), ("bounds", bounded, (0,))]


@row
def guard():
    """`if i < n - 1` within one field with a time axis, against `range(n - 1)`."""
    return time_axis(65_000)


@row
def guard_65537():
    """The same, beyond 65,536 elements."""
    return time_axis(65_537)


@row
def length():
    """65,537 elements against 65,536, periodic."""

    def make(n):
        x, y = real(n), real(n)

        @ti.kernel
        def periodic():
            for i in range(n):
                y[i] = x[(i + 1) % n] - x[(i - 1) % n]

        return periodic, ()

    return [("65537", *make(65_537)), ("65536", *make(65_536))]


@row
def fdtd():
    """Six fields with a time axis under one condition, against bounds in `ndrange`."""
    n = 40
    ex, ey, ez, hx, hy, hz = (real(2, n, n, n) for _ in range(6))

    @ti.func
    def update(t, i, j, k):
        hx[t + 1, i, j, k] = hx[t, i, j, k] + 0.3 * (
            ey[t, i, j, k + 1] - ey[t, i, j, k] - ez[t, i, j + 1, k] + ez[t, i, j, k]
        )
        hy[t + 1, i, j, k] = hy[t, i, j, k] + 0.3 * (
            ez[t, i + 1, j, k] - ez[t, i, j, k] - ex[t, i, j, k + 1] + ex[t, i, j, k]
        )
        hz[t + 1, i, j, k] = hz[t, i, j, k] + 0.3 * (
            ex[t, i, j + 1, k] - ex[t, i, j, k] - ey[t, i + 1, j, k] + ey[t, i, j, k]
        )

    @ti.kernel
    def guarded(t: ti.i32):
        for i, j, k in ti.ndrange(n, n, n):
            if i < n - 1 and j < n - 1 and k < n - 1:
                update(t, i, j, k)

    @ti.kernel
    def bounded(t: ti.i32):
        for i, j, k in ti.ndrange(n - 1, n - 1, n - 1):
            update(t, i, j, k)

    return [("guard", guarded, (0,)), ("bounds", bounded, (0,))]


def vectors(layout):
    n = 60_000
    v, w = real(n, vector=3, layout=layout), real(n, vector=3, layout=layout)
    a, b = real(3 * n), real(3 * n)

    @ti.kernel
    def form():
        for i in range(n - 1):
            w[i] = v[i + 1] - v[i]

    @ti.kernel
    def flat():
        for i in range(3 * n - 3):
            b[i] = a[i + 3] - a[i]

    return [("vec3", form, ()), ("flat", flat, ())]


@row
def aos():
    """Vectors of three, as structures, against a flat field of as many numbers."""
    return vectors(None)


@row
def soa():
    """The same, with a field for each component."""
    return vectors(ti.Layout.SOA)


@row
def three():
    """Three scalar fields in one kernel."""
    n = 60_000
    v, w = [real(n) for _ in range(3)], [real(n) for _ in range(3)]
    a, b = real(3 * n), real(3 * n)

    @ti.kernel
    def form():
        for i in range(n - 1):
            for c in ti.static(range(3)):
                w[c][i] = v[c][i + 1] - v[c][i]

    @ti.kernel
    def flat():
        for i in range(3 * n - 3):
            b[i] = a[i + 3] - a[i]

    return [("fields", form, ()), ("flat", flat, ())]


@row
def springs():
    """Positions and velocities of a chain of springs in one kernel, against one field alone."""
    n = 60_000
    x, v, y = (real(2, n, vector=2) for _ in range(3))

    @ti.kernel
    def form(t: ti.i32):
        for i in range(n):
            force = ti.Vector([0.0, -1.0])
            if i > 0:
                force += x[t, i - 1] - x[t, i]
            if i < n - 1:
                force += x[t, i + 1] - x[t, i]
            v[t + 1, i] = 0.99 * v[t, i] + 0.01 * force
            x[t + 1, i] = x[t, i] + 0.01 * v[t + 1, i]

    @ti.kernel
    def alone(t: ti.i32):
        for i in range(1, n - 1):
            y[t + 1, i] = y[t, i] + 0.1 * (y[t, i - 1] - 2 * y[t, i] + y[t, i + 1])

    return [("coupled", form, (0,)), ("alone", alone, (0,))]


@row
def rope():
    """The same with norms: lengths of springs."""
    n = 60_000
    x, v, y = (real(2, n, vector=2) for _ in range(3))

    @ti.func
    def pull(a, b):
        d = b - a
        length = ti.sqrt(d.dot(d) + 1e-4)
        return (length - 0.5) / length * d

    @ti.kernel
    def form(t: ti.i32):
        for i in range(n):
            force = ti.Vector([0.0, -1.0])
            if i > 0:
                force += pull(x[t, i], x[t, i - 1])
            if i < n - 1:
                force += pull(x[t, i], x[t, i + 1])
            v[t + 1, i] = 0.99 * v[t, i] + 0.01 * force
            x[t + 1, i] = x[t, i] + 0.01 * v[t + 1, i]

    @ti.kernel
    def alone(t: ti.i32):
        for i in range(1, n - 1):
            y[t + 1, i] = y[t, i] + pull(y[t, i], y[t, i - 1]) + pull(y[t, i], y[t, i + 1])

    return [("coupled", form, (0,)), ("alone", alone, (0,))]


def borders(form_of, n=60_000, args=(), fields=None):
    """A form against the periodic stencil of constant size."""
    x, y = real(n), real(n)

    @ti.kernel
    def periodic():
        for i in range(n):
            y[i] = x[(i + 1) % n] - x[(i - 1) % n]

    form, args = form_of(n)
    return [("form", form, args), ("periodic", periodic, ())]


@row
def clamped():
    """Neighbours by `max(i - 1, 0)` and `min(i + 1, n - 1)`."""

    def make(n):
        x, y = real(n), real(n)

        @ti.kernel
        def form():
            for i in range(n):
                y[i] = x[ti.min(i + 1, n - 1)] - x[ti.max(i - 1, 0)]

        return form, ()

    return borders(make)


@row
def clamped_2d():
    """The same in two dimensions, against the periodic one."""
    n = 240
    x, y, p, q = (real(n, n) for _ in range(4))

    @ti.kernel
    def form():
        for i, j in x:
            y[i, j] = (
                x[ti.min(i + 1, n - 1), j]
                + x[ti.max(i - 1, 0), j]
                + x[i, ti.min(j + 1, n - 1)]
                + x[i, ti.max(j - 1, 0)]
                - 4 * x[i, j]
            )

    @ti.kernel
    def periodic():
        for i, j in p:
            q[i, j] = (
                p[(i + 1) % n, j]
                + p[(i - 1) % n, j]
                + p[i, (j + 1) % n]
                + p[i, (j - 1) % n]
                - 4 * p[i, j]
            )

    return [("clamped", form, ()), ("periodic", periodic, ())]


@row
def strided():
    """Every second element: `y[i] = x[2 * i] + x[2 * i + 1]`."""

    def make(n):
        x, y = real(2 * n), real(n)

        @ti.kernel
        def form():
            for i in range(n):
                y[i] = x[2 * i] - x[2 * i + 1]

        return form, ()

    return borders(make)


@row
def convolution():
    """Five weights by an inner loop, against the same written out and periodic."""
    n = 60_000
    x, y, p, q = (real(n) for _ in range(4))
    w = real(5)

    @ti.kernel
    def form():
        for i in range(n):
            total = 0.0
            for k in range(-2, 3):
                j = i + k
                if j >= 0 and j < n:
                    total += w[k + 2] * x[j]
            y[i] = total

    @ti.kernel
    def periodic():
        for i in range(n):
            total = 0.0
            for k in ti.static(range(-2, 3)):
                total += w[k + 2] * p[(i + k) % n]
            q[i] = total

    return [("inner loop", form, ()), ("periodic", periodic, ())]


@row
def ndarray():
    """Arrays as arguments."""

    def make(n):
        x, y = (ti.ndarray(ti.f32, n, needs_grad=True) for _ in range(2))
        for part in (x, y, x.grad, y.grad):
            part.from_numpy(np.random.RandomState(0).random_sample(n).astype(np.float32))

        @ti.kernel
        def form(a: ti.types.ndarray(ndim=1), b: ti.types.ndarray(ndim=1)):
            for i in range(1, a.shape[0] - 1):
                b[i] = a[i + 1] - a[i - 1]

        return form, (x, y)

    return borders(make)


def arrays(*shape):
    """Two arrays of random numbers with adjoints."""
    made = [ti.ndarray(ti.f32, shape, needs_grad=True) for _ in range(2)]
    for array in made:
        for seed, part in enumerate((array, array.grad)):
            values = np.random.RandomState(seed).random_sample(array.shape)
            part.from_numpy(values.astype(np.float32))
    return made


@row
def ndarray_periodic():
    """Arrays as arguments, periodic."""

    def make(n):
        @ti.kernel
        def form(a: ti.types.ndarray(ndim=1), b: ti.types.ndarray(ndim=1)):
            m = a.shape[0]
            for i in range(m):
                b[i] = a[(i + 1) % m] - a[(i - 1) % m]

        return form, arrays(n)

    return borders(make)


@row
def ndarray_clamped():
    """Arrays as arguments, with neighbours by `max` and `min`."""

    def make(n):
        @ti.kernel
        def form(a: ti.types.ndarray(ndim=1), b: ti.types.ndarray(ndim=1)):
            m = a.shape[0]
            for i in range(m):
                b[i] = a[ti.min(i + 1, m - 1)] - a[ti.max(i - 1, 0)]

        return form, arrays(n)

    return borders(make)


@row
def ndarray_plane():
    """Arrays of two dimensions as arguments, against a field of the same size."""
    n = 240
    p, q = (real(n, n) for _ in range(2))

    @ti.kernel
    def form(a: ti.types.ndarray(ndim=2), b: ti.types.ndarray(ndim=2)):
        for i, j in ti.ndrange((1, a.shape[0] - 1), (1, a.shape[1] - 1)):
            b[i, j] = a[i + 1, j] + a[i - 1, j] + a[i, j + 1] + a[i, j - 1] - 4 * a[i, j]

    @ti.kernel
    def periodic():
        for i, j in p:
            q[i, j] = (
                p[(i + 1) % n, j]
                + p[(i - 1) % n, j]
                + p[i, (j + 1) % n]
                + p[i, (j - 1) % n]
                - 4 * p[i, j]
            )

    return [("arrays", form, arrays(n, n)), ("periodic", periodic, ())]


@row
def ndarray_steps():
    """An array with a time axis."""

    def make(n):
        @ti.kernel
        def form(a: ti.types.ndarray(ndim=2), t: ti.i32):
            for i in range(1, a.shape[1] - 1):
                a[t + 1, i] = a[t, i + 1] - a[t, i - 1]

        return form, (arrays(3, n)[0], 1)

    return borders(make)


def periodic_to(length):
    """A periodic stencil whose period, `length(n)`, is an argument."""

    def make(n):
        x, y = real(n), real(n)

        @ti.kernel
        def form(m: ti.i32):
            for i in range(m):
                y[i] = x[(i + 1) % m] - x[(i - 1) % m]

        return form, (length(n),)

    return borders(make)


@row
def part():
    """Periodic over a part of a field, whose length is an argument."""

    return periodic_to(lambda n: n - 9)


@row
def run_time():
    """Bounds from an argument."""

    def make(n):
        x, y = real(n), real(n)

        @ti.kernel
        def form(m: ti.i32):
            for i in range(1, m - 1):
                y[i] = x[i + 1] - x[i - 1]

        return form, (n,)

    return borders(make)


@row
def run_time_periodic():
    """Periodic, with the period from an argument."""

    return periodic_to(lambda n: n)


@row
def slots():
    """Slots by two arguments, against a slot and the next one."""
    n = 60_000
    x, y = real(2, n), real(2, n)

    @ti.kernel
    def form(a: ti.i32, b: ti.i32):
        for i in range(n - 1):
            x[b, i] = x[a, i + 1] - x[a, i]

    @ti.kernel
    def next_one(t: ti.i32):
        for i in range(n - 1):
            y[t + 1, i] = y[t, i + 1] - y[t, i]

    return [("a to b", form, (0, 1)), ("t to t + 1", next_one, (0,))]


def wave(step):
    """Three slots that the kernel `step(x, n)` selects, against three that follow each other."""
    n = 60_000
    x, y = real(3, n), real(3, n)

    @ti.kernel
    def in_order(t: ti.i32):
        for i in range(1, n - 1):
            y[t + 2, i] = 1.8 * y[t + 1, i] - y[t, i] + 0.1 * (y[t + 1, i - 1] + y[t + 1, i + 1])

    return [("slots", *step(x, n)), ("t to t + 2", in_order, (0,))]


@row
def three_slots():
    """Slots by three arguments, as of a wave equation."""

    def make(x, n):
        @ti.kernel
        def form(a: ti.i32, b: ti.i32, c: ti.i32):
            for i in range(1, n - 1):
                x[c, i] = 1.8 * x[b, i] - x[a, i] + 0.1 * (x[b, i - 1] + x[b, i + 1])

        return form, (0, 1, 2)

    return wave(make)


@row
def ring():
    """The same with slots by remainders of the time step."""

    def make(x, n):
        @ti.kernel
        def form(t: ti.i32):
            for i in range(1, n - 1):
                x[(t + 2) % 3, i] = (
                    1.8 * x[(t + 1) % 3, i]
                    - x[t % 3, i]
                    + 0.1 * (x[(t + 1) % 3, i - 1] + x[(t + 1) % 3, i + 1])
                )

        return form, (1,)

    return wave(make)


@row
def upwind():
    """Three upwind terms in one kernel; to be compared with three times one."""
    n = 36
    x, y, u = real(n, n, n), real(n, n, n), real(n, n, n)

    @ti.func
    def term(s, back, here, ahead):
        result = 0.0
        if s > 0:
            result = ti.max(s, 0.0) * (here - back)
        else:
            result = ti.min(s, 0.0) * (ahead - here)
        return result

    @ti.kernel
    def form():
        for i, j, k in ti.ndrange(n, n, n):
            s = u[i, j, k] - 0.5
            y[i, j, k] = (
                term(s, x[(i - 1) % n, j, k], x[i, j, k], x[(i + 1) % n, j, k])
                + term(s, x[i, (j - 1) % n, k], x[i, j, k], x[i, (j + 1) % n, k])
                + term(s, x[i, j, (k - 1) % n], x[i, j, k], x[i, j, (k + 1) % n])
            )

    @ti.kernel
    def one():
        for i, j, k in ti.ndrange(n, n, n):
            s = u[i, j, k] - 0.5
            y[i, j, k] = term(s, x[(i - 1) % n, j, k], x[i, j, k], x[(i + 1) % n, j, k])

    return [("three axes", form, ()), ("one axis", one, ())]


@row
def overwritten():
    """Values that a kernel overwrites, against a kernel that keeps them in another field."""
    n = 60_000
    x, y, z = real(n), real(n), real(n)

    loss = real()

    @ti.kernel
    def form():
        for i in range(n):
            x[i] = x[i] * 1.01
            x[i] = ti.sin(x[i])

    @ti.kernel
    def kept():
        for i in range(n):
            z[i] = ti.sin(y[i] * 1.01)

    @ti.kernel
    def measure_x():
        for i in range(n):
            loss[None] += x[i]

    @ti.kernel
    def measure_z():
        for i in range(n):
            loss[None] += z[i]

    in_place, apart = Taped(form, measure_x, loss), Taped(kept, measure_z, loss)
    return [("in place", in_place, ()), ("kept", apart, ())]


@row
def norms():
    """`norm() < h` against `norm_sqr() < h * h`."""
    n = 60_000
    x, y, h = real(n, vector=2), real(n), 0.4

    @ti.kernel
    def form():
        for i in range(n):
            y[i] = 0.0
            for k in range(8):
                d = x[i] - x[(i + k) % n]
                if d.norm() < h:
                    y[i] += 1.0

    @ti.kernel
    def squares():
        for i in range(n):
            y[i] = 0.0
            for k in range(8):
                d = x[i] - x[(i + k) % n]
                if d.norm_sqr() < h * h:
                    y[i] += 1.0

    return [("norm", form, ()), ("norm_sqr", squares, ())]


@row
def hoisted():
    """Functions of the outer index within an inner loop, against the same by hand before it."""
    n, m = 400, 100
    x, y, w = real(n), real(n), real(m)

    @ti.kernel
    def form():
        for i in range(n):
            total = 0.0
            for k in range(m):
                total += ti.sin(x[i]) * ti.exp(-x[i]) * w[k]
            y[i] = total

    @ti.kernel
    def by_hand():
        for i in range(n):
            total = 0.0
            factor = ti.sin(x[i]) * ti.exp(-x[i])
            for k in range(m):
                total += factor * w[k]
            y[i] = total

    return [("inside", form, ()), ("outside", by_hand, ())]


@row
def small():
    """A launch of a few microseconds: two threads should not be slower than one."""
    n = 3000
    x, y = real(n), real(n)

    @ti.kernel
    def form():
        for i in range(n - 1):
            y[i] = ti.sqrt(x[i + 1] + x[i])

    return [("small", form, ()), ("small", form, ())]


def measure(name, threads):
    """Microseconds of (forward, adjoint) of both kernels of a row."""
    ti.init(arch=ti.cpu, cpu_max_num_threads=threads, log_level=ti.ERROR)
    forms = ROWS[name]()
    clock = time.thread_time if threads == 1 else time.perf_counter
    jobs = []
    for _, kernel, args in forms:
        for call in (kernel, kernel.grad):
            call(*args)
            call(*args)
            begin = clock()
            call(*args)
            once = max(clock() - begin, 1e-6)
            jobs.append((call, args, max(1, int(SECONDS / once)), []))
    for _ in range(ROUNDS):
        for call, args, count, found in jobs:
            begin = clock()
            for _ in range(count):
                call(*args)
            found.append((clock() - begin) / count * 1e6)
    return [min(job[-1]) for job in jobs]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", help="some of " + ", ".join(ROWS))
    parser.add_argument("--threads", default="1,2")
    args = parser.parse_args()
    heads = ["forward", "adjoint", "own", "to one"]
    print(f"{'':20}{'threads':>8}{'adjoint, us':>12}" + "".join(f"{head:>9}" for head in heads))
    for name in args.rows or ROWS:
        one = None
        for threads in map(int, args.threads.split(",")):
            forward, adjoint, plain, plain_adjoint = measure(name, threads)
            one = one or adjoint
            print(
                f"{name:20}{threads:>8}{adjoint:>12.1f}{forward / plain:>9.2f}"
                f"{adjoint / plain_adjoint:>9.2f}{adjoint / forward:>9.2f}{adjoint / one:>9.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
