"""Kernels that overwrite elements they have read: gradients against central differences."""

import numpy as np
import pytest
import tai as ti

N = 4


class World:
    """Fields of random values, and a loss that weighs all that a kernel leaves in them."""

    def __init__(self):
        rng = np.random.default_rng(7)

        def real(*shape):
            return ti.field(ti.f64, shape=shape, needs_grad=True)

        self.x, self.y, self.g = real(N), real(N), real(2 * N)
        self.grid = real(2 * N, 3)
        self.v = ti.Vector.field(2, ti.f64, shape=N, needs_grad=True)
        self.m = ti.Matrix.field(2, 2, ti.f64, shape=N, needs_grad=True)
        self.a, self.loss = real(), real()
        self.plain = ti.field(ti.f64, shape=N)
        self.p = ti.field(ti.i32, shape=N)
        self.wanted = [self.x, self.y, self.g, self.grid, self.v, self.m, self.a]
        # The fields that hold the initial values: gradients are those of these.
        self.sources = [real(N), real(N), real(2 * N), real(2 * N, 3)]
        self.sources.append(ti.Vector.field(2, ti.f64, shape=N, needs_grad=True))
        self.sources.append(ti.Matrix.field(2, 2, ti.f64, shape=N, needs_grad=True))
        self.sources.append(real())
        self.start = [rng.uniform(0.4, 1.2, f.to_numpy().shape) for f in self.wanted]
        self.weights = [rng.uniform(-1, 1, value.shape) for value in self.start]
        self.plain_start = rng.uniform(0.4, 1.2, N)
        self.weight_fields = []
        for weights in self.weights:
            weight = ti.field(ti.f64, shape=weights.size)
            weight.from_numpy(weights.ravel())
            self.weight_fields.append(weight)
        self.reset()
        x, y, g, grid, v, m, a, loss = *self.wanted, self.loss
        wx, wy, wg, wgrid, wv, wm, wa = self.weight_fields

        @ti.kernel
        def weigh():
            for i in x:
                loss[None] += wx[i] * x[i] + wy[i] * y[i]
                for k in ti.static(range(2)):
                    loss[None] += wv[2 * i + k] * v[i][k]
                    for j in ti.static(range(2)):
                        loss[None] += wm[4 * i + 2 * k + j] * m[i][k, j]
            for i in g:
                loss[None] += wg[i] * g[i]
                for j in range(3):
                    loss[None] += wgrid[3 * i + j] * grid[i, j]
            for _ in range(1):
                loss[None] += wa[0] * a[None]

        self.weigh = weigh
        sx, sy, sg, sgrid, sv, sm, sa = self.sources

        @ti.kernel
        def load():
            for i in x:
                x[i] = sx[i]
                y[i] = sy[i]
                v[i] = sv[i]
                m[i] = sm[i]
            for i in g:
                g[i] = sg[i]
                for j in range(3):
                    grid[i, j] = sgrid[i, j]
            for _ in range(1):
                a[None] = sa[None]

        self.load = load

    def set_sources(self, values):
        for field, value in zip(self.sources, values, strict=True):
            if value.shape == ():
                field[None] = float(value)
            else:
                field.from_numpy(value)

    def reset(self):
        self.plain.from_numpy(self.plain_start)
        self.p.from_numpy(np.array([2, 0, 3, 1], dtype=np.int32))

    def evaluate(self, kernel, values):
        self.set_sources(values)
        self.reset()
        self.load()
        kernel()
        return sum(
            float(np.sum(weight * field.to_numpy()))
            for field, weight in zip(self.wanted, self.weights, strict=True)
        )

    def check(self, kernel, step=1e-6):
        self.set_sources(self.start)
        self.reset()
        with ti.ad.Tape(self.loss):
            self.load()
            kernel()
            self.weigh()
        found = [np.array(field.grad.to_numpy()) for field in self.sources]
        for which, value in enumerate(self.start):
            expected = np.zeros(value.shape)
            for at in np.ndindex(value.shape):
                ends = []
                for sign in (1, -1):
                    moved = [other.copy() for other in self.start]
                    moved[which][at] += sign * step
                    ends.append(self.evaluate(kernel, moved))
                expected[at] = (ends[0] - ends[1]) / (2 * step)
            np.testing.assert_allclose(found[which], expected, rtol=2e-7, atol=2e-8)


@pytest.fixture
def world():
    return World()


def in_place(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = ti.sin(x[i]) * y[i]

    return kernel


def one_after_another(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = ti.sin(x[i])
            y[i] = y[i] * x[i]
            x[i] = ti.exp(x[i]) * y[i]
            x[i] = x[i] * x[i]

    return kernel


def swap(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            old = x[i]
            x[i] = y[i] * y[i]
            y[i] = ti.sin(old)

    return kernel


def stored_twice(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = x[i] * x[i]
            y[i] = ti.sin(x[i])

    return kernel


def add_square(w):
    x = w.x

    @ti.kernel
    def kernel():
        for i in x:
            x[i] += x[i] * x[i]

    return kernel


def add_twice(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            x[i] += x[i] * y[i]
            x[i] += x[i] * x[i]

    return kernel


def permuted(w):
    x, y, p = w.x, w.y, w.p

    @ti.kernel
    def kernel():
        for i in y:
            x[p[i]] = x[p[i]] * x[p[i]] * y[i]

    return kernel


def through_two_indices(w):
    x, grid, p = w.x, w.grid, w.p

    @ti.kernel
    def kernel():
        for i in range(2):
            for j in range(3):
                grid[p[i] * 2, j] += x[p[i + j]] * x[p[i + j]]

    return kernel


def copy_and_clear(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = x[i] * x[i]
            x[i] = 0

    return kernel


def serial_in_place(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            for _ in range(5):
                x[i] = ti.sin(x[i]) * y[i] + 0.3

    return kernel


def recurrence(w):
    x = w.x

    @ti.kernel
    def kernel():
        for _ in range(1):
            for j in range(1, N):
                x[j] = x[j] * x[j - 1]

    return kernel


def forward_shift(w):
    x = w.x

    @ti.kernel
    def kernel():
        for _ in range(1):
            for j in range(N - 1):
                x[j + 1] = ti.sin(x[j])

    return kernel


def backward_shift(w):
    x = w.x

    @ti.kernel
    def kernel():
        for _ in range(1):
            for j in range(N - 1):
                x[j] = ti.sin(x[j + 1])

    return kernel


def sweeps(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for _ in range(1):
            for t in range(3):
                for j in range(1, N):
                    x[j] = x[j] * 0.5 + ti.sin(x[j - 1] * y[j])
                x[0] = x[N - 1] * x[1] + t

    return kernel


def sort(w):
    x = w.x

    @ti.kernel
    def kernel():
        for _ in range(1):
            for k in range(N):
                for j in range(N - 1 - k):
                    if x[j] > x[j + 1]:
                        low = x[j + 1]
                        x[j + 1] = x[j] * 1.1
                        x[j] = low * low

    return kernel


def under_a_condition(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            if x[i] > 0.8:
                x[i] = x[i] * x[i]
            else:
                y[i] = x[i] * y[i]
            x[i] = ti.sin(x[i])

    return kernel


def until_small(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            while x[i] > 0.2:
                x[i] = x[i] * x[i] * 0.7
                y[i] = y[i] * x[i] + x[i]

    return kernel


def with_break(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            for _ in range(10):
                x[i] = x[i] * 0.8 * y[i]
                if x[i] < 0.2:
                    break
                y[i] = ti.sin(y[i] + x[i])

    return kernel


def two_loops(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = ti.sin(x[i])
        for i in x:
            x[i] = ti.exp(x[i]) * y[i]

    return kernel


def stencil_in_two_loops(w):
    x, y = w.x, w.y

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = x[i] * x[(i + 1) % N]
        for i in x:
            x[i] = x[i] + 0.1 * y[i] * y[i]

    return kernel


def scatter_and_gather(w):
    x, g = w.x, w.g

    @ti.kernel
    def kernel():
        for i in g:
            g[i] = 0
        for i in x:
            g[i // 2] += x[i] * x[i]
        for i in g:
            if g[i] > 0:
                g[i] = ti.sqrt(g[i])
        for i in x:
            x[i] = x[i] * g[i // 2]

    return kernel


def components(w):
    v = w.v

    @ti.kernel
    def kernel():
        for i in v:
            v[i][0] = v[i][0] * v[i][1]
            v[i][1] = v[i][0] * v[i][0]

    return kernel


def whole_and_component(w):
    v = w.v

    @ti.kernel
    def kernel():
        for i in v:
            v[i] = v[i] * v[i]
            v[i][0] = v[i][0] * v[i][1]
            v[i] = ti.sin(v[i])

    return kernel


def matrix_entries(w):
    m, x = w.m, w.x

    @ti.kernel
    def kernel():
        for i in m:
            m[i][0, 1] = m[i][0, 1] * m[i][1, 0] + x[i]
            m[i][1, 1] += m[i][0, 1] * m[i][0, 0]
            m[i] = m[i] @ m[i]

    return kernel


def component_at_run_time(w):
    v, p, x = w.v, w.p, w.x

    @ti.kernel
    def kernel():
        for i in v:
            k = p[i] % 2
            v[i][k] = v[i][0] * v[i][1] + x[i]
            v[i][1 - k] = v[i][k] * v[i][1]

    return kernel


def local_matrix_at_run_time(w):
    x, y, p = w.x, w.y, w.p

    @ti.kernel
    def kernel():
        for i in x:
            local = ti.Vector([x[i], y[i], 1.0])
            for j in range(4):
                k = (p[i] + j) % 3
                local[k] = local[k] * local[(k + 1) % 3] + 0.1
            x[i] = local[0] * local[1] + local[2]

    return kernel


def scratch(w):
    x, y, plain = w.x, w.y, w.plain

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = x[i] * plain[i]
            plain[i] = 2.0 * i
            x[i] = y[i] * x[i] * plain[i]

    return kernel


def number_in_serial_code(w):
    x, a = w.x, w.a

    @ti.kernel
    def kernel():
        for _ in range(1):
            a[None] = ti.sin(a[None])
            for j in range(N):
                a[None] = a[None] * x[j] + 0.5
            x[0] = a[None] * a[None]

    return kernel


def number_between_loops(w):
    x, y, a = w.x, w.y, w.a

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = x[i] * a[None]
        for _ in range(1):
            a[None] = a[None] * a[None]
        for i in x:
            x[i] = y[i] * y[i] * a[None]

    return kernel


def sums_of_itself(w):
    x, y, a = w.x, w.y, w.a

    @ti.kernel
    def kernel():
        for i in x:
            a[None] += x[i] * y[i]
        for i in x:
            x[i] = x[i] * a[None]

    return kernel


KERNELS = [
    in_place, one_after_another, swap, stored_twice, add_square, add_twice, permuted,
    through_two_indices, copy_and_clear, serial_in_place, recurrence, forward_shift,
    backward_shift, sweeps, sort, under_a_condition, until_small, with_break, two_loops,
    stencil_in_two_loops, scatter_and_gather, components, whole_and_component, matrix_entries,
    component_at_run_time, local_matrix_at_run_time, scratch, number_in_serial_code,
    number_between_loops, sums_of_itself,
]  # fmt: skip


@pytest.mark.parametrize("make", KERNELS, ids=lambda make: make.__name__)
def test_kernel(world, make):
    world.check(make(world))


def test_random_numbers_in_a_serial_loop():
    x = ti.field(ti.f64, shape=N, needs_grad=True)
    y = ti.field(ti.f64, shape=N, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def walk():
        for i in x:
            for _ in range(40):
                step = ti.random(ti.f64)
                if step > 0.2:
                    y[i] += x[i] * step

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * (i + 1)

    x.from_numpy(np.array([0.5, 1.0, 2.0, -3.0]))
    with ti.ad.Tape(loss):
        walk()
        total()
    # Linear in x: the sum of the numbers that were drawn is y / x.
    drawn = y.to_numpy() / x.to_numpy()
    assert np.all(drawn > 5)
    np.testing.assert_allclose(x.grad.to_numpy(), drawn * np.arange(1, N + 1), rtol=1e-13)
