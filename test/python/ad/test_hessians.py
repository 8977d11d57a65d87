"""Products of Hessians and vectors, forward over reverse."""

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiAutodiffError


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def both(shape=()):
    return ti.field(ti.f64, shape=shape, needs_grad=True, needs_dual=True)


def difference_of_gradients(run, loss, x, direction):
    """Central differences of gradients by a tape, with one step of extrapolation."""
    start = x.to_numpy()

    def gradient(step):
        x.from_numpy(start + step * direction)
        with ti.ad.Tape(loss):
            run()
        return x.grad.to_numpy()

    h = 2e-3
    coarse = (gradient(h) - gradient(-h)) / (2 * h)
    fine = (gradient(h / 2) - gradient(-h / 2)) / h
    finest = (gradient(h / 4) - gradient(-h / 4)) / (h / 2)
    first, second = (4 * fine - coarse) / 3, (4 * finest - fine) / 3
    x.from_numpy(start)
    return (16 * second - first) / 15


def check(run, loss, x, seed=0):
    direction = np.random.default_rng(seed).standard_normal(x.to_numpy().shape)
    with ti.ad.Tape(loss):
        run()
    gradient = x.grad.to_numpy()
    product = ti.ad.hvp(run, loss, x, direction)
    np.testing.assert_allclose(x.grad.to_numpy(), gradient, rtol=1e-13, atol=1e-15)
    expected = difference_of_gradients(run, loss, x, direction)
    scale = abs(expected).max()
    np.testing.assert_allclose(product, expected, rtol=1e-7, atol=1e-7 * scale)
    assert scale > 0


def test_quadratic():
    n = 5
    x, loss = both(n), both()
    generator = np.random.default_rng(0)
    matrix = generator.standard_normal((n, n))
    a = ti.field(ti.f64, shape=(n, n))
    a.from_numpy(matrix)

    @ti.kernel
    def kernel():
        for i, j in a:
            loss[None] += 0.5 * x[i] * a[i, j] * x[j]

    x.from_numpy(generator.standard_normal(n))
    symmetric = (matrix + matrix.T) / 2
    rows = [ti.ad.hvp(kernel, loss, x, direction) for direction in np.eye(n)]
    np.testing.assert_allclose(rows, symmetric, rtol=1e-13, atol=1e-14)


def test_rosenbrock():
    n = 6
    x, loss = both(n), both()

    @ti.kernel
    def kernel():
        for i in range(n - 1):
            loss[None] += 100 * (x[i + 1] - x[i] ** 2) ** 2 + (1 - x[i]) ** 2

    point = np.random.default_rng(1).uniform(-1, 1, n)
    x.from_numpy(point)
    hessian = np.zeros((n, n))
    for i in range(n - 1):
        hessian[i, i] += 1200 * point[i] ** 2 - 400 * point[i + 1] + 2
        hessian[i + 1, i + 1] += 200
        hessian[i, i + 1] -= 400 * point[i]
        hessian[i + 1, i] -= 400 * point[i]
    direction = np.random.default_rng(2).standard_normal(n)
    product = ti.ad.hvp(kernel, loss, x, direction)
    np.testing.assert_allclose(product, hessian @ direction, rtol=1e-12)
    check(kernel, loss, x)


def test_simulation():
    n, steps, dt = 6, 40, 0.05
    x, v = both((steps + 1, n)), both((steps + 1, n))
    loss = both()

    @ti.kernel
    def step(t: int):
        for i in range(n):
            force = -ti.sin(x[t, i]) - 0.1 * v[t, i]
            for j in range(n):
                if i != j:
                    d = x[t, j] - x[t, i]
                    force += 0.3 * d / ti.sqrt(d * d + 0.1)
            v[t + 1, i] = v[t, i] + dt * force
            x[t + 1, i] = x[t, i] + dt * v[t + 1, i]

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += (x[steps, i] - 0.1 * i) ** 2

    def run():
        for t in range(steps):
            step(t)
        measure()

    start = np.zeros((steps + 1, n))
    start[0] = np.linspace(-1, 1.3, n)
    x.from_numpy(start)
    direction = np.zeros((steps + 1, n))
    direction[0] = np.random.default_rng(0).standard_normal(n)
    product = ti.ad.hvp(run, loss, x, direction)[0]
    x.from_numpy(start)
    expected = difference_of_gradients(run, loss, x, direction)[0]
    np.testing.assert_allclose(product, expected, rtol=1e-7, atol=1e-7 * abs(expected).max())
    # The Hessian is symmetric.
    other = np.zeros((steps + 1, n))
    other[0] = np.random.default_rng(1).standard_normal(n)
    second = ti.ad.hvp(run, loss, x, other)[0]
    assert product @ other[0] == pytest.approx(second @ direction[0], rel=1e-11)


def test_loops_that_keep_a_history():
    x, loss = both(4), both()

    @ti.kernel
    def kernel():
        for i in x:
            v = ti.Vector([x[i], 0.3])
            for _ in range(30):
                v = ti.Vector([ti.sin(v.x + v.y), ti.cos(v.x) * v.y])
            loss[None] += v.x * v.y * (i + 1)

    x.from_numpy(np.linspace(0.2, 1.1, 4))
    check(kernel, loss, x)


def test_loops_until():
    x, loss = both(4), both()

    @ti.kernel
    def kernel():
        for i in x:
            v = x[i]
            while v < 5:
                v = v * v * 0.3 + v + x[i] * 0.2
            loss[None] += v**2

    x.from_numpy(np.linspace(0.5, 1.1, 4))
    check(kernel, loss, x)


def test_elements_that_every_launch_stores():
    """The tape brings their values back, and the tangents of these."""
    x, loss, between = both(3), both(), both(3)

    @ti.kernel
    def kernel(k: int):
        for i in x:
            between[i] = ti.sin(k * x[i])
        for i in x:
            loss[None] += between[i] ** 2 * x[i]

    def run():
        for k in range(1, 4):
            kernel(k)

    x.from_numpy(np.array([0.3, 0.7, 1.1]))
    check(run, loss, x)


def test_stored_elements_whose_values_no_adjoint_reads():
    """The adjoints of elements that are stored again are zeroed in between; so are their duals."""
    x, loss, between = both(3), both(), both(3)

    @ti.kernel
    def kernel(k: int):
        for i in x:
            between[i] = ti.sin(k * x[i])
        for i in x:
            loss[None] += between[i] * k

    def run():
        for k in range(1, 4):
            kernel(k)

    x.from_numpy(np.array([0.3, 0.7, 1.1]))
    check(run, loss, x)


def test_branches_and_functions():
    x, loss = both(6), both()

    @ti.kernel
    def kernel():
        for i in x:
            if x[i] > 0.5:
                loss[None] += ti.log(x[i]) * ti.tanh(x[i])
            else:
                loss[None] += ti.exp(x[i]) / (1 + x[i] ** 2) + ti.pow(x[i] + 2, 2.5)

    x.from_numpy(np.linspace(0.12, 1.3, 6))
    check(kernel, loss, x)


@pytest.mark.parametrize("name", ["inverse", "svd", "polar", "norm"])
def test_matrices(name):
    f = ti.Matrix.field(2, 2, ti.f64, shape=3, needs_grad=True, needs_dual=True)
    loss = both()

    @ti.kernel
    def kernel():
        for i in f:
            if ti.static(name == "inverse"):
                loss[None] += (f[i].inverse() @ f[i].transpose()).sum() / f[i].determinant()
            elif ti.static(name == "svd"):
                u, s, v = ti.svd(f[i])
                loss[None] += s[0, 0] ** 3 + s[0, 0] * s[1, 1]
            elif ti.static(name == "polar"):
                r, s = ti.polar_decompose(f[i])
                loss[None] += ((f[i] - r) * (f[i] - r)).sum() * r[0, 1]
            else:
                loss[None] += f[i].norm() * f[i][0, 0]

    f.from_numpy(np.random.default_rng(3).uniform(0.2, 1, (3, 2, 2)) + np.diag([2.0, 1.0]))
    check(kernel, loss, f)


def test_a_zero_adjoint_is_not_a_constant():
    """(sqrt(x) - 1)^2 at 1: the adjoint of the root is zero, its derivative is not."""
    x, loss = both(), both()

    @ti.kernel
    def kernel():
        loss[None] = (ti.sqrt(x[None]) - 1) ** 2 + (x[None] * ti.log(x[None])) ** 2

    x[None] = 1
    product = ti.ad.hvp(kernel, loss, x, 1.0)
    assert x.grad[None] == 0
    assert product == pytest.approx(0.5 + 2, rel=1e-15)


def test_several_inputs_and_a_tape():
    x, y, loss = both(), both(), both()

    @ti.kernel
    def kernel():
        loss[None] += x[None] ** 2 * y[None]

    x[None], y[None] = 3, 5
    assert ti.ad.hvp(kernel, loss, [x, y], [1.0, 0.0]) == [10, 6]
    assert ti.ad.hvp(kernel, loss, [x, y], [0.0, 1.0]) == [6, 0]
    with ti.ad.Tape(loss) as tape:
        kernel()
    assert ti.ad.hvp(tape, loss, [x, y], [1.0, 2.0]) == [22, 6]


def test_duals_of_gradients_by_hand():
    x = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True, name="x")
    loss = both()

    @ti.kernel
    def kernel():
        loss[None] += x[None] ** 3

    x[None] = 2
    with ti.ad.FwdMode(loss=loss, param=x), ti.ad.Tape(loss):
        kernel()
    assert x.grad[None] == 12
    assert x.grad.dual[None] == 12
    assert x.dual.grad is None
    assert x.grad.dual.name == "x.grad.dual"


def test_what_needs_a_gradient_and_a_dual():
    x, loss = ti.field(ti.f64, shape=(), needs_dual=True), both()
    with pytest.raises(TaiAutodiffError, match="has no gradient"):
        ti.ad.hvp(lambda: None, loss, x, 1.0)


def test_a_field_between_needs_both():
    x, loss = both(), both()
    middle = ti.field(ti.f64, shape=(), needs_grad=True, name="middle")

    @ti.kernel
    def kernel():
        middle[None] = x[None] ** 2
        loss[None] = middle[None] ** 2

    with pytest.raises(TaiAutodiffError, match="'middle' has a gradient but no dual"):
        ti.ad.hvp(kernel, loss, x, 1.0)


@pytest.mark.parametrize("n", [2, 3])
def test_rotation_of_a_matrix(n):
    """Polar decomposition, also at equal singular values, where every material starts."""
    generator = np.random.default_rng(n)
    points = [np.eye(n), generator.standard_normal((n, n)) + 2 * np.eye(n),
              np.diag([1.0, 0.02, 0.01][:n])]  # fmt: skip
    weights = generator.standard_normal((n, n)).tolist()
    for point in points:
        x, loss = both((n, n)), both()

        @ti.kernel
        def kernel(x: ti.template(), loss: ti.template()):
            for _ in range(1):
                a = ti.Matrix([[x[i, j] for j in range(n)] for i in range(n)])
                r, _ = ti.polar_decompose(a)
                loss[None] += (r * ti.Matrix(weights)).sum() ** 2

        x.from_numpy(point)
        direction = generator.standard_normal((n, n))
        product = ti.ad.hvp(lambda x=x, loss=loss: kernel(x, loss), loss, x, direction)

        def gradient(step, x=x, loss=loss, point=point, direction=direction):
            x.from_numpy(point + step * direction)
            with ti.ad.Tape(loss):
                kernel(x, loss)
            return x.grad.to_numpy()

        h = 1e-4 * np.abs(np.linalg.svd(point, compute_uv=False)).min()
        slopes = [(gradient(h / k) - gradient(-h / k)) / (2 * h / k) for k in (1, 2)]
        expected = (4 * slopes[1] - slopes[0]) / 3
        np.testing.assert_allclose(product, expected, atol=1e-6 * np.abs(expected).max())
