"""Steps of simulators as operators of torch and functions of JAX, checked by these libraries.

The state is in their arrays, the scratch space in fields, dense and sparse. The tensors are on the
GPU with `--arch cuda`, which `scripts/test_gpu.py --tests -k simulators_as_operators` passes.
"""

import numpy as np
import pytest
import tai as ti

from device_tensors import ON_GPU

vec = ti.types.vector(2, ti.f64)
mat = ti.types.matrix(2, 2, ti.f64)
Points = ti.types.ndarray(dtype=vec, ndim=1)
Matrices = ti.types.ndarray(dtype=mat, ndim=1)


@pytest.fixture(autouse=True)
def program(fresh_program):
    ti.init(default_fp=ti.f64, offline_cache=False)


@pytest.fixture(params=["torch", "jax"])
def library(request, monkeypatch):
    """Checks the gradients of a wrapped function at some inputs."""
    if request.param == "torch":
        yield WithTorch(pytest.importorskip("torch", reason="torch is not installed"))
        return
    # Else JAX takes three quarters of a GPU's memory at once.
    monkeypatch.setenv("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    jax = pytest.importorskip("jax", reason="JAX is not installed: pip install jax")
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield WithJax(jax)
    jax.config.update("jax_enable_x64", before)


class WithTorch:
    def __init__(self, torch):
        if ON_GPU and not torch.cuda.is_available():
            pytest.skip("torch has no GPU")
        self.torch = torch

    def wrap(self, function, outputs):
        return ti.torch.wrap(function, outputs=outputs)

    def arrays(self, given):
        device = "cuda" if ON_GPU else "cpu"
        return tuple(self.torch.tensor(a, device=device, requires_grad=True) for a in given)

    def check(self, function, arrays):
        # Parallel threads add to the grid in any order.
        assert self.torch.autograd.gradcheck(function, arrays, nondet_tol=1e-9)


class WithJax:
    def __init__(self, jax):
        if ON_GPU and not any(device.platform == "gpu" for device in jax.devices()):
            pytest.skip("JAX has no GPU: pip install jax[cuda12]")
        self.jax = jax

    def wrap(self, function, outputs):
        return ti.jax.wrap(function, outputs=outputs)

    def arrays(self, given):
        return tuple(map(self.jax.numpy.asarray, given))

    def check(self, function, arrays):
        from jax.test_util import check_grads

        check_grads(function, arrays, order=1, modes=["rev"], eps=1e-6)
        check_grads(self.jax.jit(function), arrays, order=1, modes=["rev"], eps=1e-6)


def repeated(step, count):
    """A function of a state that makes several steps."""

    def run(*state):
        for _ in range(count):
            state = step(*state)
        return state

    return run


def make_mpm(n_grid=6, dt=2e-3):
    """A step of the material point method, of a neo-Hookean solid on a grid in fields."""
    momentum = ti.Vector.field(2, ti.f64, shape=(n_grid, n_grid), needs_grad=True)
    mass = ti.field(ti.f64, shape=(n_grid, n_grid), needs_grad=True)
    velocity = ti.Vector.field(2, ti.f64, shape=(n_grid, n_grid), needs_grad=True)
    h = 1.0 / n_grid
    identity = ti.Matrix([[1.0, 0.0], [0.0, 1.0]])

    @ti.func
    def weights(fx):
        return [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2]

    @ti.kernel
    def clear():
        for i, j in mass:
            mass[i, j] = 0.0
            momentum[i, j] = [0.0, 0.0]

    @ti.kernel
    def to_grid(x: Points, v: Points, C: Matrices, F: Matrices, G: Matrices):
        for p in range(x.shape[0]):
            base = ti.cast(x[p] / h - 0.5, ti.i32)
            fx = x[p] / h - base
            w = weights(fx)
            now = (identity + dt * C[p]) @ F[p]
            G[p] = now
            tau = 30.0 * (now @ now.transpose() - identity)
            tau += 20.0 * ti.log(now.determinant()) * identity
            affine = -dt * 4.0 / (h * h) * 0.01 * tau + C[p]
            for a, b in ti.static(ti.ndrange(3, 3)):
                way = (ti.Vector([a, b]) - fx) * h
                weight = w[a][0] * w[b][1]
                momentum[base + ti.Vector([a, b])] += weight * (v[p] + affine @ way)
                mass[base + ti.Vector([a, b])] += weight

    @ti.kernel
    def on_grid():
        for i, j in mass:
            if mass[i, j] > 1e-12:
                velocity[i, j] = momentum[i, j] / mass[i, j] + dt * ti.Vector([0.0, -9.8])
            if j < 2:
                velocity[i, j][1] = ti.max(velocity[i, j][1], -0.05)

    @ti.kernel
    def to_particles(x: Points, y: Points, w: Points, D: Matrices):
        for p in range(x.shape[0]):
            base = ti.cast(x[p] / h - 0.5, ti.i32)
            fx = x[p] / h - base
            ws = weights(fx)
            new_v, new_C = ti.Vector([0.0, 0.0]), 0.0 * identity
            for a, b in ti.static(ti.ndrange(3, 3)):
                g = velocity[base + ti.Vector([a, b])]
                weight = ws[a][0] * ws[b][1]
                new_v += weight * g
                new_C += 4.0 / h * weight * g.outer_product(ti.Vector([a, b]) - fx)
            w[p], D[p] = new_v, new_C
            y[p] = x[p] + dt * new_v

    def step(x, v, C, F, y, w, D, G):
        clear()
        to_grid(x, v, C, F, G)
        on_grid()
        to_particles(x, y, w, D)

    return step


def particles(n, seed=3):
    rng = np.random.default_rng(seed)
    return (rng.uniform(0.3, 0.7, (n, 2)), rng.normal(0, 0.3, (n, 2)),
            rng.normal(0, 0.5, (n, 2, 2)), np.eye(2) + rng.normal(0, 0.05, (n, 2, 2)))  # fmt: skip


@pytest.mark.parametrize("n, steps", [(1, 1), (5, 1), (4, 3)])
def test_steps_of_the_material_point_method(library, n, steps):
    outputs = {"y": "x", "w": "v", "D": "C", "G": "F"}
    step = library.wrap(make_mpm(), outputs)
    state = library.arrays(particles(n))
    library.check(repeated(step, steps), state)
    moved = repeated(step, steps)(*state)[0]
    assert not np.allclose(np.asarray(moved.tolist()), particles(n)[0])


def make_smoke(n, sweeps=2):
    """A step of the smoke solver: advection, projection by Jacobi sweeps, advection of smoke."""
    advected = ti.Vector.field(2, ti.f64, shape=(n, n), needs_grad=True)
    divergence = ti.field(ti.f64, shape=(n, n), needs_grad=True)
    pressure = ti.field(ti.f64, shape=(sweeps + 1, n, n), needs_grad=True)
    Grid = ti.types.ndarray(dtype=ti.f64, ndim=2)
    Flow = ti.types.ndarray(dtype=vec, ndim=2)

    @ti.func
    def around(i, j):
        return [(i + 1) % n, (i + n - 1) % n, (j + 1) % n, (j + n - 1) % n]

    @ti.func
    def corners(i, j, w):
        x, y = i - w[0], j - w[1]
        x0, y0 = ti.floor(x), ti.floor(y)
        i0, j0 = ti.cast(x0, ti.i32) % n, ti.cast(y0, ti.i32) % n
        return [x - x0, y - y0], [i0, (i0 + 1) % n, j0, (j0 + 1) % n]

    @ti.kernel
    def advect(u: Flow):
        for i, j in advected:
            f, c = corners(i, j, u[i, j])
            near = (1 - f[1]) * u[c[0], c[2]] + f[1] * u[c[0], c[3]]
            far = (1 - f[1]) * u[c[1], c[2]] + f[1] * u[c[1], c[3]]
            advected[i, j] = (1 - f[0]) * near + f[0] * far

    @ti.kernel
    def diverge():
        for i, j in divergence:
            a = around(i, j)
            along = advected[a[0], j][0] - advected[a[1], j][0]
            divergence[i, j] = -0.5 * (along + advected[i, a[2]][1] - advected[i, a[3]][1])
            pressure[0, i, j] = 0.0

    @ti.kernel
    def sweep(k: ti.i32):
        for i, j in divergence:
            a = around(i, j)
            total = pressure[k, a[0], j] + pressure[k, a[1], j]
            total += pressure[k, i, a[2]] + pressure[k, i, a[3]]
            pressure[k + 1, i, j] = (divergence[i, j] + total) / 4

    @ti.kernel
    def finish(s: Grid, u: Flow, u2: Flow, s2: Grid):
        for i, j in divergence:
            a = around(i, j)
            push = ti.Vector([pressure[sweeps, a[0], j] - pressure[sweeps, a[1], j],
                              pressure[sweeps, i, a[2]] - pressure[sweeps, i, a[3]]])  # fmt: skip
            u2[i, j] = advected[i, j] - 0.5 * push
            f, c = corners(i, j, u[i, j])
            near = (1 - f[1]) * s[c[0], c[2]] + f[1] * s[c[0], c[3]]
            far = (1 - f[1]) * s[c[1], c[2]] + f[1] * s[c[1], c[3]]
            s2[i, j] = (1 - f[0]) * near + f[0] * far

    def step(u, s, u2, s2):
        advect(u)
        diverge()
        for k in range(sweeps):
            sweep(k)
        finish(s, u, u2, s2)

    return step


@pytest.mark.parametrize("n, steps", [(2, 1), (4, 1), (3, 3)])
def test_steps_of_smoke(library, n, steps):
    rng = np.random.default_rng(5)
    step = library.wrap(make_smoke(n), {"u2": "u", "s2": "s"})
    state = library.arrays((rng.normal(0, 0.8, (n, n, 2)), rng.uniform(0, 1, (n, n))))
    library.check(repeated(step, steps), state)


def make_sparse(is_emptied):
    """Particles add their weights to a sparse grid and read the sums back."""
    rho = ti.field(ti.f64, needs_grad=True)
    blocks = ti.root.pointer(ti.ij, 8)
    blocks.dense(ti.ij, 4).place(rho)

    @ti.kernel
    def clear():
        for i, j in rho:
            rho[i, j] = 0.0

    @ti.kernel
    def scatter(x: Points, m: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for p in range(x.shape[0]):
            base = ti.cast(ti.floor(x[p]), ti.i32)
            f = x[p] - base
            for a, b in ti.static(ti.ndrange(2, 2)):
                weight = (f[0] if a == 1 else 1 - f[0]) * (f[1] if b == 1 else 1 - f[1])
                rho[base + ti.Vector([a, b])] += m[p] * weight

    @ti.kernel
    def gather(
        x: Points,
        y: ti.types.ndarray(dtype=ti.f64, ndim=1),
        total: ti.types.ndarray(dtype=ti.f64, ndim=1),
    ):
        for p in range(x.shape[0]):
            base = ti.cast(ti.floor(x[p]), ti.i32)
            y[p] = ti.sin(rho[base]) * x[p][0] + rho[base + ti.Vector([1, 1])]
        for i, j in rho:
            total[0] += rho[i, j] ** 3

    def density(x, m, y, total):
        if is_emptied:
            blocks.deactivate_all()
        else:
            clear()
        scatter(x, m)
        gather(x, y, total)

    return density, blocks


@pytest.mark.parametrize("is_emptied", [False, True])
@pytest.mark.parametrize("n", [1, 6])
def test_a_sparse_grid(library, n, is_emptied):
    rng = np.random.default_rng(7)
    function, _ = make_sparse(is_emptied)
    operator = library.wrap(function, {"y": "m", "total": lambda x, m: 1})
    given = (rng.uniform(1, 30, (n, 2)), rng.uniform(0.5, 1.5, n))
    library.check(operator, library.arrays(given))
    y, total = operator(*library.arrays(given))
    rho, (x, m) = np.zeros((32, 32)), given
    base = np.floor(x).astype(int)
    f = x - base
    for a in range(2):
        for b in range(2):
            weight = (f[:, 0] if a else 1 - f[:, 0]) * (f[:, 1] if b else 1 - f[:, 1])
            np.add.at(rho, (base[:, 0] + a, base[:, 1] + b), m * weight)
    np.testing.assert_allclose(total.tolist(), [(rho**3).sum()])
    at, diagonal = rho[tuple(base.T)], rho[tuple(base.T + 1)]
    np.testing.assert_allclose(y.tolist(), np.sin(at) * x[:, 0] + diagonal)
