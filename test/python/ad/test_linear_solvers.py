"""Solvers of linear systems: how they end for each kind of matrix, backward errors, gradients of
entries and right-hand sides against dense references, preconditioners, assembled matrices."""

import math
import warnings

import numpy as np
import pytest
import tai as ti

ITERATIVE = ["cg", "minres", "bicgstab", "gmres"]
SYMMETRIC = {"cg", "minres"}


@pytest.fixture(autouse=True)
def start():
    ti.init(arch=ti.cpu, default_fp=ti.f64)


def tridiagonal(n, diagonal=2.0, wind=0.0):
    lower, upper = np.eye(n, k=-1), np.eye(n, k=1)
    return diagonal * np.eye(n) - (1 + wind) * lower - (1 - wind) * upper


def neumann(n):
    """The differences of a row of cells without flow through its ends: constants vanish."""
    matrix = tridiagonal(n)
    matrix[0, 0] = matrix[-1, -1] = 1
    return matrix


def half_rank(n):
    """A symmetric matrix with many vectors that vanish."""
    q, _ = np.linalg.qr(np.random.default_rng(16).normal(size=(n, n)))
    values = np.r_[np.linspace(0.5, 2, n // 2), np.zeros(n - n // 2)]
    return (q * values) @ q.T / 2 + ((q * values) @ q.T).T / 2


class Problem:
    """A x = b with an assembled matrix, and the loss Σ w x."""

    def __init__(self, matrix, dtype=ti.f64, seed=0, right=None):
        self.matrix, n = matrix, len(matrix)
        self.at = np.nonzero(matrix)
        self.A = ti.linalg.AssembledMatrix(*self.at, matrix.shape, dtype, needs_grad=True)
        self.A.values.from_numpy(matrix[self.at].astype(dtype.numpy))
        self.b, self.x = (ti.field(dtype, shape=n, needs_grad=True, name=name) for name in "bx")
        self.w = ti.field(dtype, shape=n)
        self.loss = ti.field(ti.f64, shape=(), needs_grad=True)
        generator = np.random.default_rng(seed)
        self.X, self.W = generator.normal(size=(2, n))
        self.B = matrix @ self.X if right is None else np.asarray(right, float)
        self.b.from_numpy(self.B.astype(dtype.numpy))
        self.w.from_numpy(self.W.astype(dtype.numpy))
        w, x, loss = self.w, self.x, self.loss

        @ti.kernel
        def sum_up():
            for i in x:
                loss[None] += w[i] * x[i]

        self.sum_up = sum_up

    def solve(self, method, **options):
        return getattr(ti.linalg, method)(self.A, self.b, self.x, **options)

    def differentiate(self, method, **options):
        with ti.ad.Tape(self.loss) as self.tape:
            info = self.solve(method, **options)
            self.sum_up()
        return info

    def errors(self):
        """Errors of the solution and of both gradients, by the pseudo-inverse."""
        inverse = np.linalg.pinv(self.matrix, rcond=1e-10)
        x, adjoint = inverse @ self.B, inverse.T @ self.W
        found = [self.x, self.b.grad, self.A.values.grad]
        exact = [x, adjoint, -np.outer(adjoint, x)[self.at]]
        return [np.linalg.norm(f.to_numpy() - e) / np.linalg.norm(e)
                for f, e in zip(found, exact, strict=True)]  # fmt: skip

    def backward_error(self):
        x = self.x.to_numpy()
        norm = np.linalg.norm(self.matrix, 2) * np.linalg.norm(x) + np.linalg.norm(self.B)
        return np.linalg.norm(self.B - self.matrix @ x) / norm


GOOD = {
    "one": np.array([[3.0]]),
    "positive definite": tridiagonal(40, 2.1),
    "indefinite": tridiagonal(40, 0.7),
    "not symmetric": tridiagonal(40, 2.3, 0.5),
    "singular": neumann(30),
    "of half the rank": half_rank(24),
}


SINGULAR = {"singular", "of half the rank"}
# The others are refused: see test_wrong_kinds_of_matrices.
SUITED = [
    (method, kind) for method in ITERATIVE for kind in GOOD
    if (method, kind) != ("cg", "indefinite")
    and not (kind == "not symmetric" and method in SYMMETRIC)
]  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("method", "kind"), SUITED)
def test_gradients_and_backward_errors(method, kind):
    problem = Problem(GOOD[kind])
    options = {"restart": 40} if method == "gmres" else {}
    info = problem.differentiate(method, tol=1e-12, **options)
    assert info.status == info.adjoint.status == "converged"
    assert info.x is problem.x and info.solver == f"ti.linalg.{method}"
    assert max(problem.errors()) < 1e-9
    # Never reported too small, and by a norm that is not too large.
    assert problem.backward_error() <= info.backward_error * (1 + 1e-6) + 1e-16 < 1e-11
    assert 0 < info.norm <= np.linalg.norm(problem.matrix, 2) * (1 + 1e-12)
    assert (info.adjoint.projected > 0.1) == (kind in SINGULAR)
    assert problem.tape.solves == [info]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", [*ITERATIVE, "solve"])
def test_f32(method):
    problem = Problem(tridiagonal(50, 2.5), ti.f32)
    info = problem.differentiate(method)
    assert info and info.adjoint
    assert max(problem.errors()) < 1e-4
    assert info.backward_error < 1e-5


WRONG = [
    ("cg", "skew", "not symmetric"), ("cg", "wind", "not symmetric"),
    ("cg", "indefinite", "indefinite"),
    ("minres", "skew", "not symmetric"), ("minres", "wind", "not symmetric"),
    ("bicgstab", "skew", "diverged|stagnated|max iterations"),
    ("gmres", "turn", "stagnated"),
    ("cg", "outside", "indefinite|diverged|stagnated"), ("minres", "outside", "stagnated"),
    ("gmres", "outside", "stagnated|breakdown"), ("bicgstab", "outside", ""),
    ("solve", "outside", "breakdown"), ("solve", "zero", "breakdown"),
    ("solve", "torus", "breakdown"),
]  # fmt: skip


def torus(n):
    """Five points on n×n cells without ends: rounding leaves a last pivot that is not zero."""
    line = np.roll(np.eye(n), 1, axis=0)
    line = line + line.T
    return 4 * np.eye(n * n) - np.kron(line, np.eye(n)) - np.kron(np.eye(n), line)


def turn(n):
    """A cyclic shift: GMRES gains nothing before step n."""
    return np.roll(np.eye(n), 1, axis=0)


@pytest.mark.parametrize(("method", "kind", "status"), WRONG)
def test_wrong_kinds_of_matrices(method, kind, status):
    """The status says why, and no number is large: not of x, nor of the gradient."""
    matrix = {
        "skew": np.eye(40, k=1) - np.eye(40, k=-1), "wind": tridiagonal(40, 2.0, 0.5),
        "indefinite": tridiagonal(40, 0.7), "turn": turn(40), "outside": neumann(12),
        "torus": torus(16),
        "zero": np.array([[1.0, 2, 0], [2, 4, 0], [0, 0, 1e-30]]),
    }[kind]  # fmt: skip
    n = len(matrix)
    right = np.eye(n)[0] if kind in ("turn", "outside", "zero", "torus") else None
    problem = Problem(matrix, right=right)
    with pytest.warns(ti.linalg.TaiConvergenceWarning) as found:
        info = problem.differentiate(
            method, **({} if method == "solve" else {"max_iterations": 300})
        )
    assert not info and info.status in status.split("|") if status else not info
    assert info.status in str(found[0].message) and info.reason in str(found[0].message)
    # The best point is kept, and it is none that is worse than zero.
    assert info.residual <= 1.0 + 1e-12
    x = problem.x.to_numpy()
    residual = np.linalg.norm(problem.B - matrix @ x) / np.linalg.norm(problem.B)
    assert residual == pytest.approx(info.residual, rel=1e-3, abs=1e-12)
    limit = 10 * np.linalg.norm(np.linalg.pinv(matrix, 1e-10), 2)
    assert np.linalg.norm(x) <= limit * np.linalg.norm(problem.B)
    assert np.linalg.norm(problem.b.grad.to_numpy()) <= limit * np.linalg.norm(problem.W)
    assert np.isfinite(problem.A.values.grad.to_numpy()).all()


def test_the_best_point_is_kept():
    """Jacobi's iteration falls at first, along the part that it damps, and then diverges."""
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 3.0], [0.0, 3.0, 1.0]])
    b, x, diagonal = (ti.field(ti.f64, shape=3) for _ in range(3))
    diagonal.fill(1)
    b.from_numpy(np.array([1.0, 1e-6, 0.0]))
    A = ti.linalg.AssembledMatrix(*np.nonzero(matrix), (3, 3), ti.f64)
    A.values.from_numpy(matrix[np.nonzero(matrix)])
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="diverged"):
        info = ti.linalg.jacobi(A, diagonal, b, x, tol=1e-12)
    assert info.status == "diverged" and info.residual < 1e-5
    assert x[0] == pytest.approx(1.0)


@pytest.mark.parametrize("method", ITERATIVE)
def test_starts(method):
    problem = Problem(tridiagonal(30, 2.5))
    first = problem.solve(method, tol=1e-10)
    again = problem.solve(method, tol=1e-9)
    assert first and again.status == "converged" and again.iterations == 0
    # A start that is not finite is replaced.
    problem.x.fill(math.nan)
    assert problem.solve(method) and np.allclose(problem.x.to_numpy(), problem.X, rtol=1e-6)
    # b = 0: x = 0, and the gradient is that of any other.
    problem.b.fill(0)
    problem.x.fill(1)
    info = problem.differentiate(method, tol=1e-12)
    assert info.status == "converged" and info.iterations == 0 and info.backward_error == 0
    assert not problem.x.to_numpy().any()
    adjoint = np.linalg.solve(problem.matrix.T, problem.W)
    assert np.allclose(problem.b.grad.to_numpy(), adjoint, rtol=1e-9)


@pytest.mark.parametrize("method", [*ITERATIVE, "solve"])
@pytest.mark.parametrize("where", ["b", "A"])
def test_what_is_not_finite_is_said(method, where):
    problem = Problem(tridiagonal(10, 2.5))
    (problem.b if where == "b" else problem.A.values)[3] = math.nan
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="not finite"):
        info = problem.solve(method)
    assert info.status == "not finite" and np.isfinite(problem.x.to_numpy()).all()


@pytest.mark.parametrize("method", [*ITERATIVE, "solve"])
@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_scales(method, scale):
    problem = Problem(tridiagonal(20, 2.5))
    problem.b.from_numpy(problem.B * scale)
    info = problem.solve(method)
    assert info and np.allclose(problem.x.to_numpy() / scale, problem.X, rtol=1e-7)
    assert info.backward_error < 1e-9


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("preconditioned", [False, True])
@pytest.mark.parametrize("method", ITERATIVE)
@pytest.mark.parametrize("scale", [1e-300, 1e-200, 1e200, 1e300])
def test_operators_whose_squares_overflow_or_vanish(method, scale, preconditioned):
    """Both systems are solved, although ‖A p‖² is not representable."""
    problem = Problem(scale * tridiagonal(20, 2.5))
    problem.B = problem.B / scale
    problem.b.from_numpy(problem.B)
    problem.W = problem.W * scale
    problem.w.from_numpy(problem.W)
    options = {}
    if preconditioned:
        diagonal = ti.field(ti.f64, shape=20)
        diagonal.fill(2.5 * scale)
        options["preconditioner"] = ti.linalg.Jacobi(diagonal)
    info = problem.differentiate(method, **options)
    assert info and info.adjoint
    plain = scale * problem.x.to_numpy()
    exact = np.linalg.solve(tridiagonal(20, 2.5), problem.B)
    np.testing.assert_allclose(plain, exact, rtol=1e-7)
    weights = np.linalg.solve(tridiagonal(20, 2.5), problem.W / scale)
    np.testing.assert_allclose(problem.b.grad.to_numpy(), weights, rtol=1e-7)
    assert 0.5 * scale < info.norm < 4.6 * scale
    assert info.backward_error < 1e-9


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", [*ITERATIVE, "solve"])
def test_forward_mode(method):
    """Tangents are those that the gradient predicts."""
    n, matrix = 20, tridiagonal(20, 2.5)
    at = np.nonzero(matrix)
    A = ti.linalg.AssembledMatrix(*at, (n, n), ti.f64, needs_grad=True, needs_dual=True)
    A.values.from_numpy(matrix[at])
    b, x = (ti.field(ti.f64, shape=n, needs_grad=True, needs_dual=True) for _ in range(2))
    generator = np.random.default_rng(3)
    B, by_b = generator.normal(size=(2, n))
    by_a = generator.normal(size=len(at[0]))
    b.from_numpy(B)
    options = {} if method == "solve" else {"tol": 1e-13}
    run = lambda: getattr(ti.linalg, method)(A, b, x, **options)  # noqa: E731
    tangent = ti.ad.jvp(run, [A.values, b], [by_a, by_b], x)
    change = np.zeros((n, n))
    change[at] = by_a
    X = np.linalg.solve(matrix, B)
    assert np.allclose(tangent, np.linalg.solve(matrix, by_b - change @ X), rtol=1e-9)
    assert np.allclose(x.to_numpy(), X, rtol=1e-10)
    # Under a tape, tangents of the gradient are two more solves.
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)

    @ti.kernel
    def square():
        for i in x:
            loss[None] += 0.5 * x[i] ** 2

    def energy():
        run()
        square()

    inverse = np.linalg.inv(matrix)
    product = ti.ad.hvp(energy, loss, b, by_b)
    assert np.allclose(product, inverse.T @ inverse @ by_b, rtol=1e-8)


def badly_scaled(n):
    scale = 10.0 ** np.random.default_rng(5).uniform(-1, 1, n)
    return scale[:, None] * tridiagonal(n, 2.01) * scale


def check_preconditioned(problem, method, preconditioner, most):
    """The solution and the gradient are those without one."""
    options = {"restart": 60} if method == "gmres" else {}
    info = problem.differentiate(method, tol=1e-11, preconditioner=preconditioner, **options)
    assert info and info.adjoint and info.iterations <= most
    assert max(problem.errors()) < 1e-5
    assert problem.backward_error() < 1e-10


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["jacobi", "kernel", "function"])
@pytest.mark.parametrize("method", ITERATIVE)
def test_preconditioners(method, name):
    problem = Problem(badly_scaled(60))
    diagonal = ti.field(ti.f64, shape=60)
    diagonal.from_numpy(problem.A.diagonal())

    @ti.kernel
    def divide(r: ti.template(), z: ti.template()):
        for i in r:
            z[i] = r[i] / diagonal[i]

    preconditioner = {
        "jacobi": ti.linalg.Jacobi(diagonal), "kernel": divide,
        "function": lambda r, z: divide(r, z),
    }[name]  # fmt: skip
    check_preconditioned(problem, method, preconditioner, 120)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", ITERATIVE)
def test_incomplete_cholesky(method):
    """The pattern of a tridiagonal matrix is that of its factor: one or two steps."""
    problem = Problem(badly_scaled(60))
    check_preconditioned(problem, method, ti.linalg.IncompleteCholesky(problem.A), 2)


def test_matrices_without_an_incomplete_factor():
    make, factorize = ti.linalg.AssembledMatrix, ti.linalg.IncompleteCholesky
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes a sparse matrix"):
        factorize(np.eye(3))
    wrong = make([0, 1], [0, 1], (2, 2), ti.f64)
    wrong.values.from_numpy(np.array([1.0, -1.0]))
    with pytest.raises(ti.TaiRuntimeError, match="not positive definite: element .1, 1. is -1"):
        factorize(wrong)
    lower = make([0, 1, 1], [0, 1, 0], (2, 2), ti.f64)
    lower.values.fill(1)
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes a symmetric matrix"):
        factorize(lower)
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes a square matrix, but got 2×3"):
        factorize(make([0], [0], (2, 3), ti.f64))
    # One that is not positive definite although its diagonal is, and whose pivots need a shift.
    indefinite = make([0, 0, 1, 1], [0, 1, 0, 1], (2, 2), ti.f64)
    indefinite.values.from_numpy(np.array([1.0, 50, 50, 1]))
    with pytest.raises(ti.TaiRuntimeError, match="pivot 1 stays below zero"):
        factorize(indefinite)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", [*ITERATIVE, "solve"])
def test_blocks(method):
    """A matrix of 2×2 blocks that is not symmetric but for cg and minres, with block Jacobi."""
    n, size = 12, 24
    generator = np.random.default_rng(8)
    dense = np.kron(tridiagonal(n, 0.0), np.array([[0.6, 0.2], [0.2, 0.3]]))
    for i in range(n):
        block = generator.normal(size=(2, 2))
        dense[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = block @ block.T + 3 * np.eye(2)
    if method not in SYMMETRIC:
        dense[0, 1] += 1
    rows, columns = np.nonzero(tridiagonal(n))
    A = ti.linalg.AssembledMatrix(rows, columns, (n, n), ti.f64, block=2, needs_grad=True)
    blocks = dense.reshape(n, 2, n, 2).transpose(0, 2, 1, 3)[rows, columns]
    A.values.from_numpy(blocks)
    assert np.array_equal(A.to_scipy().toarray(), dense)
    b, x = (ti.Vector.field(2, ti.f64, shape=n, needs_grad=True) for _ in range(2))
    diagonal = ti.Matrix.field(2, 2, ti.f64, shape=n)
    diagonal.from_numpy(A.diagonal())
    B, W = generator.normal(size=(2, size))
    b.from_numpy(B.reshape(n, 2))
    weights = ti.Vector.field(2, ti.f64, shape=n)
    weights.from_numpy(W.reshape(n, 2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += weights[i].dot(x[i])

    options = {"tol": 1e-13, "preconditioner": ti.linalg.BlockJacobi(diagonal)}
    with ti.ad.Tape(loss):
        assert getattr(ti.linalg, method)(A, b, x, **({} if method == "solve" else options))
        sum_up()
    X, L = np.linalg.solve(dense, B), np.linalg.solve(dense.T, W)
    assert np.allclose(x.to_numpy().ravel(), X, rtol=1e-9, atol=1e-11)
    assert np.allclose(b.grad.to_numpy().ravel(), L, rtol=1e-9, atol=1e-11)
    outer = -np.outer(L, X).reshape(n, 2, n, 2).transpose(0, 2, 1, 3)[rows, columns]
    assert np.allclose(A.values.grad.to_numpy(), outer, rtol=1e-8, atol=1e-10)


def test_assembled_matrices():
    """Entries at one place are added up, in any order; a kernel fills them; to SciPy and back."""
    rows, columns = np.array([2, 0, 1, 0, 2, 1]), np.array([2, 0, 1, 0, 1, 0])
    A = ti.linalg.AssembledMatrix(rows, columns, (3, 3), ti.f64, needs_grad=True)

    @ti.kernel
    def fill(values: ti.template()):
        for k in values:
            values[k] = k + 1.0

    fill(A.values)
    dense = np.array([[6.0, 0, 0], [6, 3, 0], [0, 5, 1]])
    assert np.array_equal(A.to_scipy().toarray(), dense)
    assert np.array_equal(A.diagonal(), [6, 3, 1])
    back = ti.linalg.AssembledMatrix.from_scipy(A.to_scipy())
    assert np.array_equal(back.to_scipy().toarray(), dense) and back.dtype == ti.f64
    b, x = (ti.field(ti.f64, shape=3, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    b.from_numpy(np.array([1.0, 2, 3]))

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += x[i]

    with ti.ad.Tape(loss):
        assert ti.linalg.solve(A, b, x)
        sum_up()
    X, L = np.linalg.solve(dense, [1, 2, 3]), np.linalg.solve(dense.T, np.ones(3))
    assert np.allclose(A.values.grad.to_numpy(), -L[rows] * X[columns])
    # A wide one has products alone.
    wide = ti.linalg.AssembledMatrix([0, 1], [3, 0], (2, 4), ti.f64)
    wide.values.fill(2)
    p, q = ti.field(ti.f64, shape=4), ti.field(ti.f64, shape=2)
    p.from_numpy(np.arange(4.0))
    wide.multiply(p, q)
    assert q.to_numpy().tolist() == [6, 0]


@pytest.mark.parametrize("n", [1, 3, 6])
def test_batches_of_small_systems(n):
    count = 5
    A = ti.Matrix.field(n, n, ti.f64, shape=count, needs_grad=True)
    b, x = (ti.Vector.field(n, ti.f64, shape=count, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    generator = np.random.default_rng(n)
    M, B = generator.normal(size=(count, n, n)), generator.normal(size=(count, n))
    M[0] = np.roll(np.eye(n), 1, axis=0)  # needs pivots
    M[1] *= 10.0 ** generator.uniform(-6, 6, (n, 1))  # rows of all sizes
    A.from_numpy(M.reshape(A.to_numpy().shape))
    b.from_numpy(B)

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += x[i].norm_sqr()

    with ti.ad.Tape(loss):
        info = ti.linalg.solve_batch(A, b, x)
        sum_up()
    assert info and info.adjoint and info.backward_error < 1e-12
    X = np.linalg.solve(M, B[..., None])[..., 0]
    L = np.linalg.solve(M.transpose(0, 2, 1), 2 * X[..., None])[..., 0]
    assert np.allclose(x.to_numpy(), X, rtol=1e-9)
    assert np.allclose(b.grad.to_numpy(), L, rtol=1e-9)
    assert np.allclose(A.grad.to_numpy().ravel(), -(L[:, :, None] * X[:, None]).ravel(), rtol=1e-8)
    M[2] = 0
    A.from_numpy(M.reshape(A.to_numpy().shape))
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="breakdown.*has no inverse"):
        info = ti.linalg.solve_batch(A, b, x)
    assert info.status == "breakdown"
    found = x.to_numpy()
    assert not found[2].any() and np.allclose(found[3], X[3], rtol=1e-9)


def test_fields_of_the_kernel_are_restored_after_a_projection():
    """A kernel that keeps fluxes in a field, of a singular operator that is not symmetric."""
    n = 12
    k, b, x, flux, m = (ti.field(ti.f64, shape=n, needs_grad=True) for _ in range(5))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def apply(p: ti.template(), q: ti.template()):
        for i in range(n):
            right = p[i + 1] if i < n - 1 else p[i]
            flux[i] = k[i] * (right - p[i])
        for i in q:
            before = flux[i - 1] if i > 0 else 0.0
            q[i] = m[i] * (before - flux[i])

    @ti.kernel
    def sum_up():
        for i in x:
            loss[None] += (i + 1) * x[i]

    generator = np.random.default_rng(6)
    K, M = generator.uniform(0.5, 2, (2, n))
    D = np.eye(n, k=1) - np.eye(n)
    D[-1] = 0
    matrix = np.diag(M) @ D.T @ np.diag(K) @ D
    B = matrix @ generator.normal(size=n)
    for field, values in ((k, K), (m, M), (b, B)):
        field.from_numpy(values)
    with ti.ad.Tape(loss):
        info = ti.linalg.gmres(apply, b, x, tol=1e-12)
        sum_up()
    assert info and info.adjoint and info.adjoint.projected > 0
    X = x.to_numpy()
    assert np.allclose(matrix @ X, B)
    # λ is unique up to the left null space, 1/m, so the rest is compared.
    L = np.linalg.pinv(matrix).T @ np.arange(1.0, n + 1)
    found = b.grad.to_numpy()
    null = 1 / M / np.linalg.norm(1 / M)
    assert np.allclose(found - null * (null @ found), L - null * (null @ L), rtol=1e-7, atol=1e-8)
    by_k = -(D @ X) * (D @ (M * found))
    assert np.allclose(k.grad.to_numpy(), by_k, rtol=1e-7, atol=1e-8)
    by_m = -found * (D.T @ (K * (D @ X)))
    assert np.allclose(m.grad.to_numpy(), by_m, rtol=1e-7, atol=1e-8)


def test_arguments_that_make_no_sense():
    problem = Problem(tridiagonal(6, 2.5))
    A, b, x = problem.A, problem.b, problem.x
    short, half = ti.field(ti.f64, shape=5, name="short"), ti.field(ti.f32, shape=6, name="half")
    half_b = ti.field(ti.f32, shape=6)
    pairs = ti.Vector.field(2, ti.f64, shape=6, name="pairs")
    matrices = ti.Matrix.field(3, 3, ti.f64, shape=6, name="matrices")
    wide = ti.linalg.AssembledMatrix([0], [1], (2, 3), ti.f64)
    make, lin = ti.linalg.AssembledMatrix, ti.linalg
    for call, message in [
        (lambda: lin.gmres(A, b, x, restart=0), "restart must be a positive whole number"),
        (lambda: lin.minres(A, b, short), "field 'b' has shape .6,., but field 'short' has"),
        (lambda: lin.cg(A, half_b, half), "takes fields of 6 numbers of f64 that begin at 0"),
        (lambda: lin.cg(wide, b, x), "takes a square matrix, but got one of 2×3"),
        (lambda: lin.cg(A, b, x, preconditioner=3), "a preconditioner is a kernel or function"),
        (lambda: lin.cg(A, b, x, preconditioner=lin.Jacobi(short)), "'short' has shape .5,."),
        (lambda: lin.cg(A, b, x, preconditioner=lin.BlockJacobi(matrices)), "blocks of 3×3"),
        (lambda: lin.Jacobi(1.0), "takes a field for the diagonal"),
        (lambda: lin.BlockJacobi(pairs), "takes a field of square matrices"),
        (lambda: lin.solve(problem.sum_up, b, x), "takes a ti.linalg.AssembledMatrix"),
        (
            lambda: lin.solve_batch(matrices, pairs, ti.Vector.field(2, ti.f64, shape=6)),
            "do not fit",
        ),
        (lambda: make([0], [0], (1, 1), ti.i32), "holds ti.f32 or ti.f64"),
        (lambda: make([0, 3], [0, 0], (2, 2)), r"rows\[1\] is 3, but the matrix has 2 rows"),
        (lambda: make([0], [0, 1], (2, 2)), "there are 1 rows, but 2 columns"),
        (lambda: make([0.5], [0], (2, 2)), "rows is an array of one or more whole numbers"),
        (lambda: make([], [], (2, 2)), "rows is an array of one or more whole numbers"),
        (lambda: make([0], [0], (1, 1), block=0), "block is a whole number above 0"),
        (lambda: ti.field(ti.f64, shape=0), "an extent must be positive"),
    ]:
        with pytest.raises(ti.TaiRuntimeTypeError, match=message):
            call()
    # A preconditioner that is not positive definite is said to be.
    negative = ti.field(ti.f64, shape=6)
    negative.fill(-1)
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="the preconditioner is not"):
        assert lin.cg(A, b, x, preconditioner=lin.Jacobi(negative)).status == "breakdown"


class Starts:
    """The same gradients again and again, each adjoint solve from the last solution."""

    def __init__(self, method):
        self.problem = Problem(tridiagonal(200, 2.05))
        self.start = ti.field(ti.f64, shape=200)
        self.method = method

    def run(self, start, **options):
        self.problem.x.fill(0)
        return self.problem.differentiate(
            self.method, tol=1e-10, adjoint_start=start, **options
        ).adjoint


@pytest.mark.parametrize("method", [*ITERATIVE, "jacobi"])
def test_adjoint_solves_start_where_they_ended(method):
    # Sums in a fixed order: the runs are compared bit for bit, on a GPU as well.
    ti.init(default_fp=ti.f64, deterministic=True)
    options = {"max_iterations": 20000}
    if method == "jacobi":
        options["damping"] = 0.9
    scene = Starts(method)
    if method == "jacobi":
        diagonal = ti.field(ti.f64, shape=200)
        diagonal.fill(2.05)
        solve = ti.linalg.jacobi
        scene.problem.solve = lambda method, **given: solve(
            scene.problem.A, diagonal, scene.problem.b, scene.problem.x, **given
        )
    cold = scene.run(None, **options)
    reference = scene.problem.b.grad.to_numpy()
    first = scene.run(scene.start, **options)
    # A field of zeros is the start without one, bit for bit.
    assert first.iterations == cold.iterations > 10
    assert scene.problem.b.grad.to_numpy().tobytes() == reference.tobytes()
    np.testing.assert_array_equal(scene.start.to_numpy(), reference)
    again = scene.run(scene.start, **options)
    assert again and again.iterations <= 1
    np.testing.assert_allclose(scene.problem.b.grad.to_numpy(), reference, rtol=0, atol=1e-7)
    # The system changes a little.
    scene.problem.A.values.from_numpy(scene.problem.A.values.to_numpy() * 1.0001)
    near = scene.run(scene.start, **options)
    assert near and near.iterations < cold.iterations
    exact = scene.problem.b.grad.to_numpy()
    scene.run(None, **options)
    np.testing.assert_allclose(exact, scene.problem.b.grad.to_numpy(), rtol=0, atol=1e-6)


def test_bad_starts_of_adjoint_solves():
    scene = Starts("cg")
    scene.start.fill(math.nan)
    assert scene.run(scene.start)
    assert np.all(np.isfinite(scene.start.to_numpy()))
    short = ti.field(ti.f64, shape=5, name="short")
    for start, message in [
        (short, "field 'short' has shape"),
        (scene.problem.x, "field 'x' is given twice"),
        (3, "takes a field for the solution of the adjoint system"),
    ]:
        with pytest.raises(ti.TaiRuntimeTypeError, match=message):
            scene.run(start)


def test_on_a_device(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(arch=ti.cuda, default_fp=ti.f64)
    problem = Problem(tridiagonal(33, 2.5))
    for method in [*ITERATIVE, "solve"]:
        problem.x.fill(0)
        info = problem.differentiate(method, **({} if method == "solve" else {"tol": 1e-12}))
        assert info and info.adjoint and max(problem.errors()) < 1e-9
    with pytest.raises(ti.TaiRuntimeError, match="on the CPU only"):
        ti.linalg.IncompleteCholesky(problem.A)


def test_warnings_can_be_errors():
    problem = Problem(np.eye(40, k=1) - np.eye(40, k=-1))
    with warnings.catch_warnings():
        warnings.simplefilter("error", ti.linalg.TaiConvergenceWarning)
        with pytest.raises(ti.linalg.TaiConvergenceWarning, match="not symmetric.*ti.linalg.gmres"):
            problem.solve("cg")
