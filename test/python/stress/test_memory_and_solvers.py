"""S40 to S42: checkpoints, linear solves by hundreds of iterations, grids of f16."""

import math

import numpy as np
import pytest
import tai as ti

from points import TYPES


class Rods:
    """A row of coupled pendulums in place, whose steps overwrite values that the reverse sweep
    needs."""

    def __init__(self, n):
        self.n = n
        x, v = (ti.field(ti.f64, shape=n, needs_grad=True) for _ in "xv")
        first = self.first = ti.field(ti.f64, shape=n, needs_grad=True)
        loss = self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        first.from_numpy(np.linspace(0.1, 2.0, n))

        @ti.kernel
        def begin():
            for i in x:
                x[i] = first[i]
                v[i] = 0.0

        @ti.kernel
        def push():
            for i in x:
                left, right = x[(i - 1 + n) % n], x[(i + 1) % n]
                v[i] += 0.01 * (-ti.sin(x[i]) + 0.3 * (left + right - 2 * x[i]))

        @ti.kernel
        def move():
            for i in x:
                x[i] += 0.01 * v[i] * (1 + 0.1 * x[i])

        @ti.kernel
        def end():
            for i in x:
                loss[None] += x[i] ** 2

        self.kernels = begin, push, move, end

    def gradient(self, steps, **options):
        begin, push, move, end = self.kernels
        with ti.ad.Tape(self.loss, **options) as tape:
            begin()
            for _ in range(steps):
                push()
                move()
            end()
        return self.first.grad.to_numpy(), tape.stats()


@pytest.mark.parametrize("deterministic", [True, False])
@pytest.mark.parametrize("n", [1, 64, 65537])
def test_s40_checkpoints(n, deterministic, measure):
    """Recomputed with S = 1, sqrt(n), n snapshots: equal bits in deterministic mode, else 1e-6."""
    ti.init(offline_cache=False, deterministic=deterministic)
    steps = 12 if n > 1000 else 60
    rods = Rods(n)
    full, _ = rods.gradient(steps)
    assert np.abs(full).max() > 0
    for snapshots in (1, math.isqrt(2 * steps), 2 * steps):
        again, stats = rods.gradient(steps, checkpoint=snapshots)
        assert snapshots >= 2 * steps or stats.recomputed > 0
        error = np.abs(again - full).max() / np.abs(full).max()
        measure(f"S = {snapshots}", error, 0.0 if deterministic else 1e-6)


@pytest.mark.parametrize("snapshots", [2, 8, 20])
def test_s40_peak_memory(snapshots, measure):
    """S snapshots of both fields, the final values, the saved values of one record: 1.1 times."""
    ti.init(offline_cache=False, deterministic=True)
    n, steps = 4096, 100
    _, stats = Rods(n).gradient(steps, checkpoint=snapshots)
    state = 2 * 8 * n
    measure("of the formula", stats.peak_bytes / ((snapshots + 1) * state + state / 2), 1.1)


def laplacian(n, seed):
    a = np.random.default_rng(seed).uniform(-1, 1, (n, n))
    a = 0.5 * (a + a.T)
    return a + np.diag(np.abs(a).sum(axis=1) * 1.25)


def solver(method, n, iterations, dtype):
    """A kernel for each step of the solver; x[iterations] is the solution."""
    real = TYPES[dtype]
    a = ti.field(real, shape=(n, n), needs_grad=True)
    b, w = ti.field(real, shape=n, needs_grad=True), ti.field(real, shape=n)
    x = ti.field(real, shape=(iterations + 1, n), needs_grad=True)
    r, p = (ti.field(real, shape=(iterations + 1, n), needs_grad=True) for _ in "rp")
    q = ti.field(real, shape=(iterations, n), needs_grad=True)
    rr = ti.field(real, shape=iterations + 1, needs_grad=True)
    pq = ti.field(real, shape=iterations, needs_grad=True)
    loss = ti.field(real, shape=(), needs_grad=True)

    @ti.kernel
    def jacobi(t: ti.i32):
        for i in b:
            rest = b[i]
            for j in range(n):
                if j != i:
                    rest -= a[i, j] * x[t, j]
            x[t + 1, i] = rest / a[i, i]

    @ti.kernel
    def begin():
        for i in b:
            r[0, i] = b[i]
            p[0, i] = b[i]
            rr[0] += b[i] * b[i]

    @ti.kernel
    def apply(t: ti.i32):
        for i in b:
            total = 0.0
            for j in range(n):
                total += a[i, j] * p[t, j]
            q[t, i] = total
            pq[t] += total * p[t, i]

    @ti.kernel
    def step(t: ti.i32):
        for i in b:
            alpha = rr[t] / pq[t]
            x[t + 1, i] = x[t, i] + alpha * p[t, i]
            r[t + 1, i] = r[t, i] - alpha * q[t, i]
            rr[t + 1] += r[t + 1, i] ** 2

    @ti.kernel
    def turn(t: ti.i32):
        for i in b:
            p[t + 1, i] = r[t + 1, i] + rr[t + 1] / rr[t] * p[t, i]

    @ti.kernel
    def end():
        for i in b:
            loss[None] += w[i] * x[iterations, i]

    def run():
        if method == "jacobi":
            for t in range(iterations):
                jacobi(t)
        else:
            begin()
            for t in range(iterations):
                apply(t)
                step(t)
                turn(t)
        end()

    return run, a, b, w, loss


@pytest.mark.parametrize(("method", "iterations"), [("jacobi", 100), ("cg", 16)])
@pytest.mark.parametrize("n", [1, 24])
def test_s41_unrolled_solves(n, method, iterations, measure):
    """Gradients through the iterations are those of the equation: b* = A^-T w, A* = -b* x'."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    iterations = 1 if n == 1 else iterations
    run, a, b, w, loss = solver(method, n, iterations, "f64")
    matrix, random = laplacian(n, 6), np.random.default_rng(7)
    right, weights = random.standard_normal((2, n))
    a.from_numpy(matrix)
    b.from_numpy(right)
    w.from_numpy(weights)
    with ti.ad.Tape(loss):
        run()
    x, adjoint = np.linalg.solve(matrix, right), np.linalg.solve(matrix.T, weights)
    expected = -np.outer(adjoint, x)
    measure("loss", abs(loss[None] - weights @ x) / abs(weights @ x), 1e-6)
    measure("by b", np.abs(b.grad.to_numpy() - adjoint).max() / np.abs(adjoint).max(), 1e-6)
    found = a.grad.to_numpy()
    if method == "cg":  # works in symmetric matrices: its gradient is that of either half
        found, expected = found + found.T, expected + expected.T
    measure("by A", np.abs(found - expected).max() / np.abs(expected).max(), 1e-6)


@pytest.mark.parametrize("storage", ["f16", "f32"])
def test_s42_grid_of_halves(storage, measure):
    """Particles to a grid and back, its cells in f16: loss to 1e-2, cosine 0.999 against f64.

    Additions to a cell of f16 round, of 4 particles each, at most 4 times in 2^-11.
    """
    reference_loss, reference = particles("f64", "f64")
    loss, gradient = particles("f32", storage)
    measure("loss", abs(loss / reference_loss - 1), 1e-2)
    cosine = gradient @ reference / np.linalg.norm(gradient) / np.linalg.norm(reference)
    measure("1 - cosine", 1 - cosine, 1e-3)


def particles(dtype, storage, n=256, cells=64, steps=16):
    """The gradient of a loss by the first velocities of particles in one dimension (MPM)."""
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    real, kind = TYPES[dtype], {"f16": ti.f16, "f32": ti.f32, "f64": ti.f64}[storage]
    x, v, f = (ti.field(real, shape=(steps + 1, n), needs_grad=True) for _ in "xvf")
    mass, momentum = (ti.field(kind, shape=(steps, cells), needs_grad=True) for _ in "mp")
    loss = ti.field(real, shape=(), needs_grad=True)
    dt = 0.1

    @ti.func
    def weights(at):
        base = int(at - 0.5)
        fx = at - base
        return base, ti.Vector([0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2])

    @ti.kernel
    def scatter(t: ti.i32):
        for p in range(n):
            base, w = weights(x[t, p])
            stress = 2.0 * (f[t, p] - 1)
            fx = x[t, p] - base
            slope = ti.Vector([fx - 1.5, -2 * (fx - 1), fx - 0.5])
            for k in ti.static(range(3)):
                mass[t, base + k] += w[k]
                momentum[t, base + k] += w[k] * v[t, p] + dt * stress * slope[k]

    @ti.kernel
    def gather(t: ti.i32):
        for p in range(n):
            base, w = weights(x[t, p])
            fx = x[t, p] - base
            slope = ti.Vector([fx - 1.5, -2 * (fx - 1), fx - 0.5])
            speed, strain = 0.0, 0.0
            for k in ti.static(range(3)):
                one = momentum[t, base + k] / (mass[t, base + k] + 1e-3)
                speed += w[k] * one
                strain += slope[k] * one
            v[t + 1, p] = speed
            f[t + 1, p] = (1 + dt * strain) * f[t, p]
            x[t + 1, p] = x[t, p] + dt * speed

    @ti.kernel
    def end():
        for p in range(n):
            loss[None] += (x[steps, p] - 40.0) ** 2 / n

    start = np.linspace(8.1, 55.3, n).astype(np.float16)
    first = np.zeros((steps + 1, n))
    first[0] = start
    x.from_numpy(first.astype(real.numpy))
    first[0] = (0.4 * np.sin(start.astype(float) / 7)).astype(np.float16)
    v.from_numpy(first.astype(real.numpy))
    first[0] = 1
    f.from_numpy(first.astype(real.numpy))
    with ti.ad.Tape(loss):
        for t in range(steps):
            scatter(t)
            gather(t)
        end()
    return loss[None], v.grad.to_numpy()[0].astype(float)
