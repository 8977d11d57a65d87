"""Solvers over fields, and gradients through their solutions."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "implicit_elastic.py"
pytestmark = pytest.mark.filterwarnings("error")


class Chain:
    """A row of n cells, (2 + c) x - neighbours = b, and the loss Σ w x²."""

    def __init__(self, n, dtype, wind=0.0, seed=0):
        self.n, self.wind = n, wind
        self.c, self.b, self.x = (
            ti.field(dtype, shape=n, needs_grad=True, name=name) for name in "cbx"
        )
        self.w = ti.field(dtype, shape=n, name="w")
        self.diagonal = ti.field(dtype, shape=n, name="diagonal")
        self.loss = ti.field(dtype, shape=(), needs_grad=True, name="loss")
        generator = np.random.default_rng(seed)
        self.C, self.B = generator.uniform(0.5, 1.5, n), generator.normal(size=n)
        self.W = generator.normal(size=n)
        for field, values in ((self.c, self.C), (self.b, self.B), (self.w, self.W)):
            field.from_numpy(values)
        self.diagonal.from_numpy(2 + self.C)
        n, c, b, x, w, loss = self.n, self.c, self.b, self.x, self.w, self.loss

        @ti.kernel
        def apply(p: ti.template(), q: ti.template()):
            for i in p:
                left = p[i - 1] if i > 0 else 0.0
                right = p[i + 1] if i < n - 1 else 0.0
                q[i] = (2 + c[i]) * p[i] - (1 + wind) * left - (1 - wind) * right

        @ti.kernel
        def step(p: ti.template(), q: ti.template()):
            for i in p:
                left = p[i - 1] if i > 0 else 0.0
                right = p[i + 1] if i < n - 1 else 0.0
                q[i] = (b[i] + (1 + wind) * left + (1 - wind) * right) / (2 + c[i])

        @ti.kernel
        def residual(p: ti.template(), q: ti.template()):
            for i in p:
                left = p[i - 1] if i > 0 else 0.0
                right = p[i + 1] if i < n - 1 else 0.0
                q[i] = (2 + c[i]) * p[i] - (1 + wind) * left - (1 - wind) * right - b[i]

        @ti.kernel
        def sum_up():
            for i in x:
                loss[None] += w[i] * x[i] ** 2

        self.apply, self.step, self.residual, self.sum_up = apply, step, residual, sum_up

    def solve(self, name, **options):
        if name == "jacobi":
            return ti.linalg.jacobi(self.apply, self.diagonal, self.b, self.x, **options)
        if name == "implicit":
            return ti.ad.implicit(self.step, self.x, **options)
        if name == "newton":
            return ti.linalg.newton(self.residual, self.x, **options)
        if name == "newton symmetric":
            return ti.linalg.newton(self.residual, self.x, symmetric=True, **options)
        return getattr(ti.linalg, name)(self.apply, self.b, self.x, **options)

    def bands(self):
        """The diagonals of the operator, from the upper one down."""
        return 0 * self.C - (1 - self.wind), 2 + self.C, 0 * self.C - (1 + self.wind)

    def exact(self):
        """The solution and the gradients by b and c."""
        upper, diagonal, lower = self.bands()
        x = solve_banded(upper, diagonal, lower, self.B)
        adjoint = solve_banded(lower, diagonal, upper, 2 * self.W * x)
        return x, adjoint, -adjoint * x


def solve_banded(upper, diagonal, lower, b):
    """Elimination along a row of cells."""
    diagonal, b = diagonal.copy(), b.copy()
    for i in range(1, len(b)):
        factor = lower[i] / diagonal[i - 1]
        diagonal[i] -= factor * upper[i - 1]
        b[i] -= factor * b[i - 1]
    for i in range(len(b) - 1, -1, -1):
        b[i] = (b[i] - (upper[i] * b[i + 1] if i + 1 < len(b) else 0)) / diagonal[i]
    return b


def error_of(field, wanted):
    return np.linalg.norm(field.to_numpy() - wanted) / np.linalg.norm(wanted)


SOLVERS = ["cg", "bicgstab", "jacobi", "implicit", "newton", "newton symmetric"]


@pytest.mark.parametrize("n", [1, 50, 65537])
@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("name", SOLVERS)
def test_gradients_of_solutions(name, dtype, n):
    chain = Chain(n, dtype)
    with ti.ad.Tape(chain.loss):
        info = chain.solve(name)
        chain.sum_up()
    bound = 1e-8 if dtype == ti.f64 else 2e-4
    assert info and info.adjoint.converged, info
    assert info.residual <= (1e-10 if dtype == ti.f64 else 1e-5)
    x, by_b, by_c = chain.exact()
    assert error_of(chain.x, x) < bound
    assert error_of(chain.b.grad, by_b) < bound
    assert error_of(chain.c.grad, by_c) < bound
    # The start has no influence.
    assert not chain.x.grad.to_numpy().any()


@pytest.mark.parametrize("name", ["bicgstab", "jacobi", "implicit", "newton"])
def test_operators_that_are_not_symmetric(name):
    chain = Chain(40, ti.f64, wind=0.7)
    with ti.ad.Tape(chain.loss):
        assert chain.solve(name, tol=1e-12)
        chain.sum_up()
    x, by_b, by_c = chain.exact()
    assert error_of(chain.x, x) < 1e-10
    assert error_of(chain.b.grad, by_b) < 1e-10
    assert error_of(chain.c.grad, by_c) < 1e-10


def unrolled(chain, sweeps):
    other = ti.field(ti.f64, shape=chain.n, needs_grad=True)
    chain.x.fill(0)
    with ti.ad.Tape(chain.loss) as tape:
        for _ in range(sweeps):
            chain.step(chain.x, other)
            chain.x.copy_from(other)
        chain.sum_up()
    return tape.stats().peak_bytes


def solved(chain, name, **options):
    chain.x.fill(0)
    with ti.ad.Tape(chain.loss) as tape:
        info = chain.solve(name, **options)
        chain.sum_up()
    return tape.stats().peak_bytes, info


@pytest.mark.parametrize("name", ["jacobi", "cg", "implicit"])
def test_implicit_and_unrolled_gradients_agree(name):
    chain = Chain(64, ti.f64)
    kept = unrolled(chain, 100)
    by_b, by_c = chain.b.grad.to_numpy(), chain.c.grad.to_numpy()
    assert kept >= 90 * 64 * 8
    few, rough = solved(chain, name, tol=1e-2)
    many, fine = solved(chain, name, tol=1e-13)
    assert fine.iterations > 2 * rough.iterations
    assert few == many == 0
    assert error_of(chain.b.grad, by_b) < 1e-6
    assert error_of(chain.c.grad, by_c) < 1e-6


@pytest.mark.parametrize("name", ["cg", "implicit"])
def test_the_error_follows_the_tolerance(name):
    chain = Chain(64, ti.f64)
    _, by_b, by_c = chain.exact()
    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
        solved(chain, name, tol=tolerance)
        assert error_of(chain.b.grad, by_b) < 10 * tolerance
        assert error_of(chain.c.grad, by_c) < 10 * tolerance


@pytest.mark.parametrize("name", SOLVERS)
def test_several_solves_with_the_same_fields(name):
    """The solution is the next right-hand side; parameters change in between."""
    chain = Chain(20, ti.f64)
    c, b, x = chain.c, chain.b, chain.x

    @ti.kernel
    def advance(t: ti.i32):
        for i in x:
            b[i] = ti.sin(x[i]) + 0.3 * b[i]
            c[i] = c[i] + 0.1 * x[i] ** 2

    def run(C, B):
        for _ in range(3):
            A = np.diag(2 + C) - np.eye(20, k=1) - np.eye(20, k=-1)
            X = np.linalg.solve(A, B)
            B, C = np.sin(X) + 0.3 * B, C + 0.1 * X**2
        return (chain.W * X**2).sum()

    def program():
        for t in range(3):
            chain.diagonal.fill(3.0)
            assert chain.solve(name, tol=1e-12)
            advance(t)
        chain.sum_up()

    with ti.ad.Tape(chain.loss) as tape:
        program()
    assert chain.loss[None] == pytest.approx(run(chain.C, chain.B), rel=1e-9)
    for field, which in ((b, 1), (c, 0)):
        direction = np.random.default_rng(5).normal(size=20)
        ends = []
        for sign in (1, -1):
            inputs = [chain.C, chain.B]
            inputs[which] = inputs[which] + sign * 1e-5 * direction
            ends.append(run(*inputs))
        slope = (ends[0] - ends[1]) / 2e-5
        assert (field.grad.to_numpy() * direction).sum() == pytest.approx(slope, rel=1e-6)
    # Each step keeps the parts of b, c and x that adjoints read, and the kernel's value at the
    # solution.
    assert tape.stats().peak_bytes <= 3 * 4 * 20 * 8
    # Once more from the start.
    gradient = c.grad.to_numpy()
    for field, values in ((c, chain.C), (b, chain.B)):
        field.from_numpy(values)
    x.fill(0)
    chain.loss[None] = 0
    tape.replay()
    assert error_of(c.grad, gradient) < 1e-8
    tape.grad(seed=2.0)
    assert error_of(c.grad, 2 * gradient) < 1e-8


@pytest.mark.parametrize(
    "options",
    [{"checkpoint": 2}, {"checkpoint": "periodic"}, {"health": True}],
    ids=str,
)
def test_other_tapes(options):
    chain = Chain(20, ti.f64)
    _, by_b, by_c = chain.exact()
    with ti.ad.Tape(chain.loss, **options):
        chain.solve("cg", tol=1e-12)
        chain.sum_up()
    assert error_of(chain.b.grad, by_b) < 1e-9
    assert error_of(chain.c.grad, by_c) < 1e-9


def test_inside_of_a_replaced_function_and_without_a_gradient():
    chain = Chain(10, ti.f64)
    _, by_b, _ = chain.exact()
    count = []

    @ti.ad.grad_replaced
    def forward():
        chain.solve("cg")

    @ti.ad.grad_for(forward)
    def backward():
        count.append(1)
        seed = ti.field(ti.f64, shape=10)
        seed.copy_from(chain.x.grad)
        adjoint = ti.field(ti.f64, shape=10)
        ti.linalg.cg(chain.apply, seed, adjoint)
        chain.b.grad.copy_from(adjoint)

    with ti.ad.Tape(chain.loss):
        forward()
        chain.sum_up()
    assert count == [1]
    assert error_of(chain.b.grad, by_b) < 1e-8
    with ti.ad.Tape(chain.loss) as tape:
        ti.ad.no_grad(lambda: chain.solve("cg"))()
        chain.sum_up()
    assert not chain.b.grad.to_numpy().any()
    assert tape.num_records == 2


def test_vectors_and_offsets():
    """Springs between neighbours in the plane, with a stiffness each."""
    n = 12
    k = ti.field(ti.f64, shape=n, needs_grad=True, offset=3)
    b, x = (ti.Vector.field(2, ti.f64, shape=n, needs_grad=True, offset=3) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def springs(p: ti.template(), q: ti.template()):
        for i in q:
            q[i] = p[i]
        for i in range(3, 3 + n - 1):
            pull = k[i] * (p[i + 1] - p[i] + 0.5 * ti.Vector([p[i][1] - p[i + 1][1], 0.0]))
            q[i] -= pull
            q[i + 1] += pull

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += x[i][0] * x[i][1] + ti.sin(x[i][0])

    def matrix(K):
        A = np.eye(2 * n)
        T = np.array([[1.0, -0.5], [0.0, 1.0]])
        for i in range(n - 1):
            for row, sign in ((i, -1), (i + 1, 1)):
                A[2 * row : 2 * row + 2, 2 * i + 2 : 2 * i + 4] += sign * K[i] * T
                A[2 * row : 2 * row + 2, 2 * i : 2 * i + 2] -= sign * K[i] * T
        return A

    generator = np.random.default_rng(1)
    K, B = generator.uniform(0.5, 2, n), generator.normal(size=(n, 2))
    k.from_numpy(K)
    b.from_numpy(B)
    with ti.ad.Tape(loss):
        assert ti.linalg.bicgstab(springs, b, x, tol=1e-13)
        sum_up()
    X = np.linalg.solve(matrix(K), B.ravel()).reshape(n, 2)
    assert error_of(x, X) < 1e-11
    G = np.stack([X[:, 1] + np.cos(X[:, 0]), X[:, 0]], axis=1)
    L = np.linalg.solve(matrix(K).T, G.ravel())
    assert error_of(b.grad, L.reshape(n, 2)) < 1e-11
    by_k = []
    for i in range(n):
        one = np.zeros(n)
        one[i] = 1
        by_k.append(-L @ (matrix(K + one) - matrix(K)) @ X.ravel())
    assert error_of(k.grad, np.array(by_k)) < 1e-11


@pytest.mark.parametrize("clears", [True, False])
def test_operators_that_scatter_through_memory_of_their_own(clears):
    """Differences in a field of the kernel, then sums; the second form never stores to q."""
    n = 16
    k, b, x = (ti.field(ti.f64, shape=n, needs_grad=True) for _ in range(3))
    flux = ti.field(ti.f64, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def apply(p: ti.template(), q: ti.template()):
        for i in range(n):
            right = p[i + 1] if i < n - 1 else 0.0
            flux[i] = k[i] * (right - p[i])
        if ti.static(clears):
            for i in q:
                q[i] = 0.0
        for i in range(n):
            q[i] += 0.5 * p[i] - flux[i]
            if i < n - 1:
                q[i + 1] += flux[i]

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += x[i] ** 3

    def matrix(K):
        D = np.eye(n, k=1) - np.eye(n)
        return 0.5 * np.eye(n) + (np.eye(n, k=-1) - np.eye(n)) @ np.diag(K) @ D

    generator = np.random.default_rng(2)
    K, B = generator.uniform(0.5, 2, n), generator.normal(size=n)
    k.from_numpy(K)
    b.from_numpy(B)
    A = matrix(K)
    with ti.ad.Tape(loss):
        for _ in range(2):
            assert ti.linalg.bicgstab(apply, b, x, tol=1e-13)
            sum_up()
    X = np.linalg.solve(A, B)
    L = 2 * np.linalg.solve(A.T, 3 * X**2)
    assert error_of(x, X) < 1e-11
    assert error_of(b.grad, L) < 1e-11
    by_k = [-L @ (matrix(K + np.eye(n)[i]) - matrix(K)) @ X for i in range(n)]
    assert error_of(k.grad, np.array(by_k)) < 1e-10


@ti.data_oriented
class Diffusion:
    def __init__(self, n):
        self.n = n
        self.x, self.b = (ti.field(ti.f64, shape=(n, n), needs_grad=True) for _ in range(2))
        self.loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def apply(self, p: ti.template(), q: ti.template(), dt: ti.f64):
        for i, j in p:
            total = 0.0 * p[i, j]
            for d in ti.static(((0, 1), (1, 0), (0, -1), (-1, 0))):
                at = (i + d[0], j + d[1])
                if 0 <= at[0] < self.n and 0 <= at[1] < self.n:
                    total += p[at[0], at[1]]
            q[i, j] = (1 + 4 * dt) * p[i, j] - dt * total

    @ti.kernel
    def sum_up(self):
        for i, j in self.x:
            self.loss[None] += self.x[i, j] ** 2


def test_methods_and_numbers_with_a_gradient():
    one, two = Diffusion(5), Diffusion(9)
    for scene in (one, two, one):
        n = scene.n
        scene.b.fill(1.0)
        dt = ti.ad.variable(0.3)
        with ti.ad.Tape(scene.loss):
            ti.linalg.cg(scene.apply, scene.b, scene.x, args=(dt,), tol=1e-13)
            scene.sum_up()
        line = np.eye(n, k=1) + np.eye(n, k=-1)
        D = 4 * np.eye(n * n) - np.kron(line, np.eye(n)) - np.kron(np.eye(n), line)
        A = np.eye(n * n) + 0.3 * D
        X = np.linalg.solve(A, np.ones(n * n))
        L = np.linalg.solve(A, 2 * X)
        assert error_of(scene.b.grad, L.reshape(n, n)) < 1e-11
        assert dt.grad == pytest.approx(-L @ D @ X, rel=1e-11)


def test_newton_needs_its_damping():
    """Far from the root of atan, full steps go further away each time."""
    x, a, b = (ti.field(ti.f64, shape=7, needs_grad=True, needs_dual=True) for _ in range(3))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    # Tangents of a program that has been in forward mode: they are not those of the solver.
    a.dual.fill(100.0)
    b.dual.fill(-3.0)

    @ti.kernel
    def residual(p: ti.template(), r: ti.template()):
        for i in p:
            r[i] = ti.atan2(a[i] * (p[i] - b[i]), 1.0)

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += (i + 1) * x[i] ** 2

    B = np.linspace(1, 3, 7)
    a.fill(2.0)
    b.from_numpy(B)
    x.fill(40.0)
    with ti.ad.Tape(loss):
        info = ti.linalg.newton(residual, x)
        sum_up()
    assert info and info.iterations > 5
    assert error_of(x, B) < 1e-9
    assert error_of(b.grad, 2 * B * np.arange(1, 8)) < 1e-9
    assert np.abs(a.grad.to_numpy()).max() < 1e-7
    assert a.dual[0] == 100 and b.dual[3] == -3


def test_nonlinear_fixed_points():
    x, t = (ti.field(ti.f64, shape=9, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def step(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = ti.cos(t[i] * p[i])

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += x[i]

    T = np.linspace(0.2, 1.1, 9)
    t.from_numpy(T)
    with ti.ad.Tape(loss):
        assert ti.ad.implicit(step, x, tol=1e-14)
        sum_up()
    X = x.to_numpy()
    assert np.abs(np.cos(T * X) - X).max() < 1e-13
    S = np.sin(T * X)
    assert error_of(t.grad, -X * S / (1 + T * S)) < 1e-12


@pytest.mark.parametrize("name", SOLVERS)
def test_nothing_to_do(name):
    """A right-hand side of zeros, a start that is the solution, and a loss that ignores it."""
    chain = Chain(10, ti.f64)
    chain.solve(name, tol=1e-12)
    again = chain.solve(name, tol=1e-9)
    # Newton's method measures by the start.
    assert again.iterations <= (3 if name.startswith("newton") else 1) and again
    chain.b.fill(0.0)
    chain.x.fill(0.0 if name == "implicit" else 1.0)
    info = chain.solve(name, tol=1e-12)
    assert info and np.abs(chain.x.to_numpy()).max() < 1e-10
    with ti.ad.Tape(chain.loss):
        chain.solve(name)
        chain.loss[None] = 3.0
    assert not chain.b.grad.to_numpy().any() and not chain.c.grad.to_numpy().any()


@pytest.mark.parametrize("scale", [1e-300, 1e-200, 1e200, 1e300])
@pytest.mark.parametrize("name", SOLVERS)
def test_scales(name, scale):
    chain = Chain(10, ti.f64)
    x, _, _ = chain.exact()
    chain.b.from_numpy(chain.B * scale)
    assert chain.solve(name)
    assert error_of_scaled(chain.x, x, scale) < 1e-8


def error_of_scaled(field, wanted, scale):
    return np.abs(field.to_numpy() / scale - wanted).max() / np.abs(wanted).max()


def one_system(matrix, n=2):
    """A kernel for a small matrix, b and x."""
    b, x = (ti.field(ti.f64, shape=n, needs_grad=True, name=name) for name in "bx")

    @ti.kernel
    def apply(p: ti.template(), q: ti.template()):
        for i in q:
            total = 0.0 * p[i]
            for j in ti.static(range(n)):
                for k in ti.static(range(n)):
                    if i == j:
                        total += matrix[j][k] * p[k]
            q[i] = total

    b.from_numpy(np.arange(1.0, n + 1))
    return apply, b, x


LOST = [
    ("cg", [[1, 0], [0, 0]], {}, "not positive definite"),
    ("cg", [[1, 0], [0, -3]], {}, "not positive definite"),
    ("cg", [[3, 1], [1, 3]], {"max_iterations": 1}, r"raise max_iterations or tol"),
    ("bicgstab", [[1, 1], [1, 1]], {}, "singular"),
    ("bicgstab", [[0, 0], [0, 0]], {}, "breaks down"),
    ("jacobi", [[1, 3], [3, 1]], {}, "diverges"),
    ("implicit", [[2, 0], [0, 1]], {}, "diverges|more iterations"),
    ("newton", [[0, 0], [0, 0]], {}, "makes the residual smaller"),
]


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("name", "matrix", "options", "reason"), LOST)
def test_what_does_not_converge_says_so(name, matrix, options, reason):
    apply, b, x = one_system(matrix)
    x.fill(1.0)
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match=reason) as found:
        if name == "jacobi":
            diagonal = ti.field(ti.f64, shape=2)
            diagonal.fill(1.0)
            info = ti.linalg.jacobi(apply, diagonal, b, x, **options)
        elif name == "implicit":
            info = ti.ad.implicit(apply, x, **options)
        elif name == "newton":
            info = ti.linalg.newton(affine(apply, b), x, **options)
        else:
            info = getattr(ti.linalg, name)(apply, b, x, **options)
    assert not info and info.reason
    text = str(found[0].message)
    assert "field 'x'" in text and "test_implicit.py:" in text and "called from" in text
    assert found[0].filename == __file__


def affine(apply, b):
    @ti.kernel
    def residual(p: ti.template(), r: ti.template()):
        for i in p:
            r[i] = 0.0 * p[i] - b[i]

    return residual


@pytest.mark.filterwarnings("default")
def test_an_adjoint_that_does_not_converge_says_so():
    chain = Chain(50, ti.f64)
    x, _, _ = chain.exact()
    # The start is the solution; its adjoint is not.
    chain.x.from_numpy(x)
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="the gradient of field 'x'") as found:
        with ti.ad.Tape(chain.loss):
            info = chain.solve("cg", tol=1e-8, max_iterations=2)
            chain.sum_up()
    assert len(found) == 1 and found[0].filename == __file__
    assert info and not info.adjoint and info.adjoint.iterations == 2


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_says_so(value):
    chain = Chain(10, ti.f64)
    chain.b[3] = value
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="holds NaN or infinity"):
        assert not chain.solve("cg")


@pytest.mark.filterwarnings("default")
def test_a_field_that_no_kernel_has_named_is_named():
    ti.init(arch=ti.cpu)
    right, answer = ti.field(ti.f64, shape=3), ti.field(ti.f64, shape=3)

    @ti.kernel
    def apply(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = -p[i]

    right.fill(1.0)
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="field 'answer' has not converged"):
        ti.linalg.cg(apply, right, answer)


def test_arguments_that_make_no_sense():
    chain = Chain(10, ti.f64)
    c, b, x, apply = chain.c, chain.b, chain.x, chain.apply
    short = ti.field(ti.f64, shape=9, name="short")
    half = ti.field(ti.f32, shape=10, name="half")
    whole = ti.field(ti.i32, shape=10, name="whole")
    moved = ti.field(ti.f64, shape=10, name="moved", offset=1)
    pairs = ti.Vector.field(2, ti.f64, shape=10, name="pairs")
    sparse = ti.field(ti.f64, name="sparse")
    ti.root.pointer(ti.i, 10).place(sparse)

    @ti.kernel
    def backwards(q: ti.template(), p: ti.template()):
        for i in p:
            q[i] = p[i]

    @ti.kernel
    def idle(p: ti.template(), q: ti.template()):
        for i in p:
            c[i] = p[i]

    @ti.kernel
    def constant(p: ti.template(), q: ti.template()):
        for i in q:
            q[i] = 1.0

    cg, error = ti.linalg.cg, ti.TaiRuntimeTypeError
    for call, message in [
        (lambda: cg(apply, short, x), "'short' has shape .9,., but field 'x' has .10,."),
        (lambda: cg(apply, half, x), "'half' has type f32, but field 'x' has f64"),
        (lambda: cg(apply, whole, x), "'whole' is of type i32"),
        (lambda: cg(apply, pairs, x), "'pairs' has element shape .2,., but field 'x' has"),
        (lambda: cg(apply, moved, x), "'moved' start at .1,., those of field 'x' at .0,."),
        (lambda: cg(apply, b, sparse), "field 'sparse' is sparse"),
        (lambda: cg(apply, x, x), "field 'x' is given twice"),
        (lambda: cg(apply, np.ones(10), x), "takes a field for the right-hand side"),
        (lambda: cg(lambda p, q: None, b, x), "takes a kernel"),
        (
            lambda: cg(backwards, b, x),
            r"'backwards' \(.*test_implicit.py:\d+\) writes to its first",
        ),
        (lambda: cg(idle, b, x), "'idle' .* does not write to its second field"),
        (lambda: cg(constant, b, x), "'constant' .* does not read its first field"),
        (lambda: cg(apply, b, x, tol=0.0), "tol must be between 0 and 1"),
        (lambda: cg(apply, b, x, tol="small"), "tol must be a number"),
        (lambda: cg(apply, b, x, max_iterations=0), "max_iterations must be a positive"),
        (lambda: cg(apply, b, x, args=[1]), "args must be a tuple"),
        (lambda: ti.linalg.jacobi(apply, short, b, x), "'short' has shape"),
        (lambda: ti.linalg.jacobi(apply, c, b, x, damping=3), "damping must be between 0 and 2"),
        (lambda: ti.ad.implicit(backwards, x), "writes to its first field"),
        (lambda: ti.linalg.newton(apply, whole), "'whole' is of type i32"),
    ]:
        with pytest.raises(error, match=message):
            call()


def test_where_no_derivative_passes():
    chain = Chain(10, ti.f64)
    plain = ti.field(ti.f64, shape=10, name="plain")
    with pytest.raises(ti.TaiAutodiffError, match="'plain' has no gradient"):
        with ti.ad.Tape(chain.loss):
            ti.linalg.cg(chain.apply, chain.b, plain)
    given, found_x = (ti.field(ti.f64, shape=10, needs_dual=True) for _ in range(2))
    with pytest.raises(ti.TaiAutodiffError, match="no derivative in forward mode") as found:
        with ti.ad.FwdMode(loss=found_x, param=given, seed=np.ones(10)):
            ti.linalg.newton(chain.residual, found_x)
    assert found.value.filename == __file__
    # And the program goes on.
    assert chain.solve("cg")


def test_the_example():
    command = [sys.executable, str(EXAMPLE), "--n", "8", "--steps", "6", "--iterations", "60"]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    first, last = map(float, re.search(r"loss +(\S+) -> (\S+)", output).groups())
    assert last < 1e-2 * first
    rows = re.findall(r"(\w+) +\S+ ms +(\S+) KiB on the tape +differs by (\S+)", output)
    kept = {name: float(memory) for name, memory, _ in rows}
    assert kept["newton"] == kept["implicit"] < kept["unrolled"] / 100
    assert all(float(error) < 1e-3 for _, _, error in rows)


def test_on_a_device(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(arch=ti.cuda)
    for name in ("cg", "newton"):
        chain = Chain(33, ti.f64)
        with ti.ad.Tape(chain.loss):
            assert chain.solve(name)
            chain.sum_up()
        _, by_b, by_c = chain.exact()
        assert error_of(chain.b.grad, by_b) < 1e-8
        assert error_of(chain.c.grad, by_c) < 1e-8


def test_programs_one_after_the_other():
    """Kernels outlive a program; fields of the solvers do not."""

    @ti.kernel
    def double(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = 2 * p[i]

    @ti.kernel
    def sum_up(x: ti.template(), loss: ti.template()):
        for i in x:
            loss[None] += x[i]

    for _ in range(2):
        b, x = (ti.field(ti.f64, shape=5, needs_grad=True) for _ in range(2))
        loss = ti.field(ti.f64, shape=(), needs_grad=True)
        b.fill(3.0)
        with ti.ad.Tape(loss):
            ti.linalg.cg(double, b, x)
            sum_up(x, loss)
        assert loss[None] == pytest.approx(7.5) and b.grad[2] == pytest.approx(0.5)
        ti.reset()
        ti.init(arch=ti.cpu)


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
def test_names_of_taichi(dtype, capsys):
    chain = Chain(9, dtype)
    b, x = chain.b, ti.field(dtype, shape=9)
    operator = ti.linalg.LinearOperator(chain.apply)
    matrix = np.diag(2 + chain.C) - np.eye(9, k=1) - np.eye(9, k=-1)
    wanted = np.linalg.solve(matrix, chain.B)
    for solve in (ti.linalg.MatrixFreeCG, ti.linalg.MatrixFreeBICGSTAB):
        x.fill(0)
        assert solve(operator, b, x, tol=1e-5, maxiter=100)
        assert x.to_numpy() == pytest.approx(wanted, abs=1e-4)
        assert np.linalg.norm(matrix @ x.to_numpy() - chain.B) < 2e-5
    assert capsys.readouterr().out == ""
    x.fill(0)
    with pytest.warns(ti.linalg.TaiConvergenceWarning):
        assert not ti.linalg.MatrixFreeCG(operator, b, x, maxiter=2, quiet=False)
    assert "did not converge: it needs more iterations after 2" in capsys.readouterr().out
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes a ti.linalg.LinearOperator"):
        ti.linalg.MatrixFreeCG(chain.apply, b, x)


@pytest.mark.parametrize("name", ["implicit", "newton"])
def test_adjoint_solves_of_other_equations_start_where_they_ended(name):
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    chain = Chain(64, ti.f64)
    start = ti.field(ti.f64, shape=64)
    found, counts = [], []
    for given in (None, start, start):
        chain.x.fill(0)
        with ti.ad.Tape(chain.loss):
            if name == "implicit":
                info = ti.ad.implicit(chain.step, chain.x, tol=1e-11, adjoint_start=given)
            else:
                info = ti.linalg.newton(chain.residual, chain.x, tol=1e-11, adjoint_start=given)
            chain.sum_up()
        found.append(chain.b.grad.to_numpy())
        counts.append(info.adjoint.iterations)
    assert found[0].tobytes() == found[1].tobytes() and counts[0] == counts[1]
    assert counts[2] < counts[1]
    np.testing.assert_allclose(found[2], found[0], rtol=1e-8, atol=1e-9)
