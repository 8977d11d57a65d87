"""Smooth programs of vectors, structs, arrays, sparse fields, reductions and functions."""

import numpy as np
import tai as ti

from smooth_steps import both, matrices, program, squares_of, vectors

# Vectors, matrices, structs


@program
def vectors_in_place():
    x, v, loss = vectors(3, 4), vectors(3, 4), both()

    @ti.kernel
    def step():
        for i in x:
            v[i] -= 0.1 * x[i] / (0.5 + x[i].norm_sqr())
            x[i] += 0.1 * v[i].cross(ti.Vector([0.1, 0.2, 0.3])) + 0.1 * v[i]

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i].dot(v[i])

    def run():
        for _ in range(10):
            step()
        measure()

    return run, loss, [x, v]


@program
def one_component_in_place():
    x, loss = vectors(2, 5), both()

    @ti.kernel
    def step():
        for i in x:
            x[i][0] += 0.2 * x[i][1] ** 2
            x[i].y = ti.sin(x[i].x) + x[i].y

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i].norm_sqr()

    def run():
        for _ in range(4):
            step()
        measure()

    return run, loss, [x]


@program
def deformation_gradient():
    f, c, loss = matrices(2, 3), matrices(2, 3), both()

    @ti.kernel
    def step():
        for i in f:
            f[i] = (ti.Matrix.identity(ti.f64, 2) + 0.1 * c[i]) @ f[i]
            c[i] -= 0.1 * (f[i] - f[i].inverse().transpose())

    @ti.kernel
    def measure():
        for i in f:
            loss[None] += f[i].determinant() ** 2 + (c[i] * c[i]).sum()

    def run():
        for _ in range(6):
            step()
        measure()

    return run, loss, [f, c]


@program
def polar_decomposition_in_place():
    f, loss = matrices(2, 2), both()

    @ti.kernel
    def step():
        for i in f:
            r, s = ti.polar_decompose(f[i])
            f[i] = 0.7 * f[i] + 0.3 * r @ s @ s

    @ti.kernel
    def measure():
        for i in f:
            loss[None] += (f[i] * f[i]).sum()

    def run():
        for _ in range(3):
            step()
        measure()

    return run, loss, [f]


@program
def structs_in_place():
    particle = ti.types.struct(pos=ti.types.vector(2, ti.f64), vel=ti.types.vector(2, ti.f64))
    p = particle.field(shape=4, needs_grad=True, needs_dual=True)
    loss = both()

    @ti.kernel
    def step():
        for i in p:
            p[i].vel -= 0.1 * p[i].pos * p[i].pos.norm_sqr()
            p[i].pos += 0.1 * p[i].vel

    @ti.kernel
    def measure():
        for i in p:
            loss[None] += p[i].pos.norm_sqr()

    def run():
        for _ in range(8):
            step()
        measure()

    return run, loss, [p.pos, p.vel]


@program
def arrays_of_structs():
    x, v, loss = ti.field(ti.f64), ti.field(ti.f64), both()
    ti.root.dense(ti.i, 5).place(x, v)
    ti.root.lazy_grad()
    ti.root.lazy_dual()

    @ti.kernel
    def step():
        for i in x:
            v[i] -= 0.1 * ti.sin(x[i])
            x[i] += 0.1 * v[i]

    measure = squares_of(x, loss)

    def run():
        for _ in range(8):
            step()
        measure()

    return run, loss, [x, v]


@program
def fields_with_an_offset():
    x = ti.field(ti.f64, shape=4, offset=-2, needs_grad=True, needs_dual=True)
    loss = both()

    @ti.kernel
    def step():
        for i in x:
            x[i] += 0.1 * ti.sin(x[i]) * i

    measure = squares_of(x, loss)

    def run():
        for _ in range(5):
            step()
        measure()

    return run, loss, [x]


# Arrays of the caller, sparse fields


@program
def constant_arrays():
    x, loss = both(5), both()
    weights = np.linspace(0.3, 1.2, 5)

    @ti.kernel
    def step(w: ti.types.ndarray()):
        for i in x:
            x[i] += 0.1 * w[i] * ti.sin(x[i])

    @ti.kernel
    def measure(w: ti.types.ndarray()):
        for i in x:
            loss[None] += x[i] ** 2 * w[i]

    def run():
        for _ in range(5):
            step(weights)
        measure(weights)

    return run, loss, [x]


@program
def constant_ndarrays():
    x, loss = both((3, 3)), both()
    a = ti.ndarray(ti.f64, shape=(3, 3))
    a.from_numpy(np.arange(9.0).reshape(3, 3) / 9)

    @ti.kernel
    def step(w: ti.types.ndarray()):
        for i, j in x:
            x[i, j] = x[i, j] * ti.cos(w[i, j] * x[i, j])

    @ti.kernel
    def measure(w: ti.types.ndarray()):
        for i, j in x:
            loss[None] += x[i, j] ** 2 * w[j, i]

    def run():
        for _ in range(4):
            step(a)
        measure(a)

    return run, loss, [x]


@program
def sparse_fields():
    x, loss = ti.field(ti.f64), both()
    ti.root.pointer(ti.i, 8).dense(ti.i, 4).place(x)
    ti.root.lazy_grad()
    ti.root.lazy_dual()
    x[1] = x[9] = x[30] = 0.1

    @ti.kernel
    def step():
        for i in x:
            x[i] += 0.1 * ti.sin(x[i]) + 0.02 * x[i] ** 2

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 3

    def run():
        for _ in range(5):
            step()
        measure()

    return run, loss, [x]


@program
def sparse_grid_that_is_emptied():
    n = 6
    x, v = both(n), both(n)
    m, loss = ti.field(ti.f64), both()
    block = ti.root.pointer(ti.i, 16)
    block.dense(ti.i, 4).place(m)
    ti.root.lazy_grad()
    ti.root.lazy_dual()

    @ti.kernel
    def scatter():
        for p in x:
            base = int(x[p] * 8)
            f = x[p] * 8 - base
            m[base] += (1 - f) * v[p]
            m[base + 1] += f * v[p]

    @ti.kernel
    def gather():
        for p in x:
            base = int(x[p] * 8)
            f = x[p] * 8 - base
            g = (1 - f) * m[base] + f * m[base + 1]
            v[p] = 0.9 * v[p] + 0.1 * ti.sin(g)
            x[p] += 1e-3 * v[p]

    @ti.kernel
    def measure():
        for p in x:
            loss[None] += v[p] ** 2 + x[p] * v[p]

    def run():
        for _ in range(3):
            block.deactivate_all()
            scatter()
            gather()
        measure()

    return run, loss, [x, v]


# Atomics and reductions


@program
def atomic_minus():
    x, total, loss = both(5), both(), both()

    @ti.kernel
    def step():
        for i in x:
            total[None] -= x[i] ** 2
        for i in x:
            x[i] += 0.05 * total[None] * x[i]

    @ti.kernel
    def measure():
        loss[None] += total[None] ** 2

    def run():
        for _ in range(3):
            step()
        measure()

    return run, loss, [x]


@program
def atomic_product():
    x, product, loss = both(4), both(), both()

    @ti.kernel
    def kernel():
        product[None] = 1.0
        for i in x:
            ti.atomic_mul(product[None], 1 + x[i] ** 2)
        loss[None] += ti.log(product[None]) * product[None]

    def run():
        kernel()
        kernel()

    return run, loss, [x]


@program
def normalisation():
    x, total, loss = both(5), both(), both()

    @ti.kernel
    def clear():
        total[None] = 0

    @ti.kernel
    def collect():
        for i in x:
            total[None] += x[i] ** 2

    @ti.kernel
    def divide():
        for i in x:
            x[i] = ti.exp(x[i] / ti.sqrt(total[None]))

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] * (i + 1)

    def run():
        for _ in range(4):
            clear()
            collect()
            divide()
        measure()

    return run, loss, [x]


@program
def scatter_by_data():
    x, y, loss = both(6), both(3), both()
    to = ti.field(ti.i32, shape=6)
    to.from_numpy(np.array([0, 2, 1, 1, 0, 2], np.int32))

    @ti.kernel
    def scatter():
        for i in x:
            y[to[i]] += x[i] ** 2

    @ti.kernel
    def gather():
        for i in x:
            x[i] -= 0.05 * y[to[i]] * x[i]

    measure = squares_of(x, loss)

    def run():
        for _ in range(4):
            scatter()
            gather()
        measure()

    return run, loss, [x]


@program
def loss_of_a_mean():
    x, mean, loss = both(5), both(), both()

    @ti.kernel
    def centre():
        mean[None] = 0
        for i in x:
            mean[None] += x[i] / 5
        for i in x:
            x[i] = (x[i] - mean[None]) ** 2 + 0.1 * x[i]
        for i in x:
            loss[None] += x[i] ** 2

    def run():
        centre()
        centre()

    return run, loss, [x]


# Returned numbers, functions, host functions


@program
def returned_numbers():
    x, loss = both(4), both()

    @ti.kernel
    def energy() -> ti.f64:
        s = 0.0
        for i in x:
            s += x[i] ** 2
        return s

    @ti.kernel
    def relax(e: ti.f64):
        for i in x:
            x[i] -= 0.01 * e * x[i]

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 4

    def run():
        for _ in range(3):
            relax(energy())
        measure()

    return run, loss, [x]


@program
def functions_with_references():
    x, loss = both(4), both()

    @ti.func
    def rotate(a, b):
        return ti.cos(b) * a, ti.sin(a) * b

    @ti.kernel
    def step():
        for i in range(2):
            x[2 * i], x[2 * i + 1] = rotate(x[2 * i], x[2 * i + 1])

    measure = squares_of(x, loss)

    def run():
        for _ in range(5):
            step()
        measure()

    return run, loss, [x]


@program
def data_oriented_class():
    @ti.data_oriented
    class Chain:
        def __init__(self, n):
            self.x, self.v, self.loss = both(n), both(n), both()

        @ti.kernel
        def step(self, dt: ti.f64):
            for i in self.x:
                self.v[i] -= dt * ti.tanh(self.x[i])
                self.x[i] += dt * self.v[i]

        @ti.kernel
        def measure(self):
            for i in self.x:
                self.loss[None] += self.x[i] ** 2

        def run(self):
            for _ in range(10):
                self.step(0.1)
            self.measure()

    chain = Chain(4)
    return chain.run, chain.loss, [chain.x, chain.v]


@program
def custom_function():
    """A gradient by hand that launches gradients of kernels, each with the values at its time."""
    x, y, z, loss = both(4), both(4), both(4), both()

    @ti.kernel
    def wave(source: ti.template(), target: ti.template()):
        for i in source:
            target[i] += ti.sin(source[i]) * source[i]

    @ti.ad.grad_replaced
    def steps():
        wave(x, y)
        wave(y, z)

    @ti.ad.grad_for(steps)
    def steps_back():
        wave.grad(y, z)
        wave.grad(x, y)

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += z[i] ** 2

    def run():
        steps()
        measure()

    return run, loss, [x]


@program
def skipped_launches():
    x, seen, loss = both(4), both(4), both()

    @ti.kernel
    def look():
        for i in x:
            seen[i] = x[i]

    @ti.kernel
    def step():
        for i in x:
            x[i] += 0.1 * ti.sin(x[i])

    measure = squares_of(x, loss)

    def run():
        for _ in range(4):
            step()
            look()
        measure()

    return run, loss, [x]


@program
def accumulated_loss():
    x, loss = both(4), both()

    @ti.kernel
    def step():
        for i in x:
            x[i] += 0.1 * ti.cos(x[i])

    measure = squares_of(x, loss)

    def run():
        for _ in range(5):
            step()
            measure()

    return run, loss, [x]


@program
def loss_that_is_overwritten():
    x, loss = both(4), both()

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    @ti.kernel
    def root():
        loss[None] = ti.sqrt(loss[None] + 1)

    def run():
        measure()
        root()
        measure()
        root()

    return run, loss, [x]


@program
def parameters_of_all_steps():
    u, state, loss = both(12), both(2), both()

    @ti.kernel
    def step(t: int):
        state[1] += 0.1 * (u[t] * ti.cos(state[0]) - state[1] * state[0])
        state[0] += 0.1 * state[1]

    @ti.kernel
    def measure():
        loss[None] += (state[0] - 1) ** 2 + state[1] ** 2

    def run():
        for t in range(12):
            step(t)
        measure()

    return run, loss, [u, state]


@program
def many_blocks():
    """More than one piece of memory, of which some change."""
    n = 5000
    x, loss = both(n), both()

    @ti.kernel
    def step():
        for i in x:
            if i % 1700 < 3:
                x[i] += 0.1 * ti.sin(x[i])

    measure = squares_of(x, loss)

    def run():
        for _ in range(3):
            step()
        measure()

    return run, loss, [x]


@program
def values_that_stay():
    """The step leaves the value as it is, x + 1 - 1, and not its tangent."""
    x, y, loss = both(3), both(3), both()

    @ti.kernel
    def step():
        for i in x:
            y[i] = y[i] + 0.0 * x[i]

    @ti.kernel
    def use():
        for i in x:
            loss[None] += y[i] ** 2 * x[i] + y[i] * x[i] ** 2

    @ti.kernel
    def change():
        for i in x:
            y[i] = x[i] * y[i] / 0.6

    def run():
        step()
        use()
        change()
        use()

    return run, loss, [x, y]


@program
def heat_in_two_dimensions():
    n = 6
    u, w, k, loss = both((n, n)), both((n, n)), both(), both()

    @ti.kernel
    def step():
        for i, j in u:
            w[i, j] = u[i, j]
        for i, j in u:
            if 0 < i < n - 1 and 0 < j < n - 1:
                u[i, j] += (
                    k[None]
                    * 0.2
                    * (w[i - 1, j] + w[i + 1, j] + w[i, j - 1] + w[i, j + 1] - 4 * w[i, j])
                    * (1 + w[i, j] ** 2)
                )

    @ti.kernel
    def measure():
        for i, j in u:
            loss[None] += u[i, j] ** 2 * (i + j)

    def run():
        for _ in range(5):
            step()
        measure()

    return run, loss, [u, k]
