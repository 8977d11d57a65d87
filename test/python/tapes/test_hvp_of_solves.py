"""Hessian products through linear solvers, against the Hessian of dense systems in NumPy."""

import numpy as np
import pytest
import tai as ti

N = 7
CENTERED = 2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)


class Rod:
    """A x = b with A = CENTERED + diag(c²) and b = sin(t); loss = Σ x³ + Σ c x."""

    def __init__(self, kind=ti.f64):
        ti.init(default_fp=kind, offline_cache=False)
        made = {"needs_grad": True, "needs_dual": True}
        self.c, self.t, self.b, self.x = (ti.field(kind, shape=N, **made) for _ in range(4))
        self.loss = ti.field(kind, shape=(), **made)
        self.kernels()
        generator = np.random.default_rng(4)
        self.at = generator.uniform(0.5, 1.5, (2, N))
        self.directions = generator.normal(size=(2, N))
        self.c.from_numpy(self.at[0].astype(kind.numpy))
        self.t.from_numpy(self.at[1].astype(kind.numpy))
        self.inputs = [self.c, self.t]

    def kernels(self):
        c, t, b, x, loss = self.c, self.t, self.b, self.x, self.loss

        @ti.kernel
        def apply(p: ti.template(), q: ti.template()):
            for i in p:
                left = p[i - 1] if i > 0 else 0.0
                right = p[i + 1] if i < N - 1 else 0.0
                q[i] = (2 + c[i] ** 2) * p[i] - left - right

        @ti.kernel
        def load():
            for i in b:
                b[i] = ti.sin(t[i])

        @ti.kernel
        def measure():
            for i in x:
                loss[None] += x[i] ** 3 + c[i] * x[i]

        self.apply, self.load, self.measure = apply, load, measure

    def run(self, solve):
        self.load()
        self.x.fill(0)
        solve(self.apply, self.b, self.x)
        self.measure()


def gradient(at, skew=0.0):
    """The gradient in NumPy, for complex arguments, too."""
    c, t = at
    A = CENTERED + np.diag(c**2) + skew * (np.eye(N, k=1) - np.eye(N, k=-1))
    x = np.linalg.solve(A, np.sin(t))
    adjoint = np.linalg.solve(A.T, 3 * x**2 + c)
    return np.array([x - 2 * c * x * adjoint, np.cos(t) * adjoint])


def exact(rod, **options):
    return gradient(rod.at + 1e-30j * rod.directions, **options).imag / 1e-30


SOLVERS = {
    "cg": lambda *a: ti.linalg.cg(*a, tol=1e-13),
    "minres": lambda *a: ti.linalg.minres(*a, tol=1e-13),
    "bicgstab": lambda *a: ti.linalg.bicgstab(*a, tol=1e-13),
    "gmres": lambda *a: ti.linalg.gmres(*a, tol=1e-13),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_products_of_a_solve(name):
    rod = Rod()
    solve = SOLVERS[name]
    found = ti.ad.hvp(lambda: rod.run(solve), rod.loss, rod.inputs, list(rod.directions))
    np.testing.assert_allclose(found, exact(rod), rtol=1e-9)
    first = np.array([f.grad.to_numpy() for f in rod.inputs])
    np.testing.assert_allclose(first, gradient(rod.at), rtol=1e-9)
    # Without forward mode it is as before.
    with ti.ad.Tape(rod.loss):
        rod.run(solve)
    np.testing.assert_allclose([f.grad.to_numpy() for f in rod.inputs], first, rtol=1e-9)


def test_products_of_a_preconditioned_solve():
    rod = Rod()
    diagonal = ti.field(ti.f64, shape=N)
    diagonal.from_numpy(2 + rod.at[0] ** 2)
    precondition = ti.linalg.Jacobi(diagonal)

    def solve(*given):
        ti.linalg.cg(*given, tol=1e-13, preconditioner=precondition)

    found = ti.ad.hvp(lambda: rod.run(solve), rod.loss, rod.inputs, list(rod.directions))
    np.testing.assert_allclose(found, exact(rod), rtol=1e-9)


def test_products_in_f32():
    rod = Rod(ti.f32)
    found = ti.ad.hvp(lambda: rod.run(ti.linalg.cg), rod.loss, rod.inputs, list(rod.directions))
    np.testing.assert_allclose(found, exact(rod), rtol=1e-3, atol=1e-4)


def test_a_whole_hessian_of_a_solve():
    rod = Rod()
    found = ti.ad.hessian(lambda: rod.run(SOLVERS["cg"]), rod.loss, rod.c)
    np.testing.assert_allclose(found, found.T, rtol=1e-8, atol=1e-10)
    rod.directions = np.array([np.eye(N)[2], np.zeros(N)])
    np.testing.assert_allclose(found[:, 2], exact(rod)[0], rtol=1e-8)


def test_products_of_solves_in_a_loop():
    """The solution of a step is the load of the next, and the matrix changes in place."""
    rod = Rod()
    c, b, x = rod.c, rod.b, rod.x

    @ti.kernel
    def advance():
        for i in c:
            b[i] = x[i] ** 2 + 0.1
            c[i] *= 1.1

    def run():
        rod.load()
        x.fill(0)
        for _ in range(3):
            ti.linalg.cg(rod.apply, b, x, tol=1e-13)
            advance()
        rod.measure()

    def in_numpy(c, t):
        load = np.sin(t)
        for _ in range(3):
            state = np.linalg.solve(CENTERED + np.diag(c**2), load)
            load, c = state**2 + 0.1, 1.1 * c
        return np.sum(state**3 + c * state)

    def slopes(at):
        found = np.empty((2, N), complex)
        for index in np.ndindex(2, N):
            # A complex step along the direction, and central differences across it.
            step = np.zeros((2, N))
            step[index] = 1e-4
            shifted = [in_numpy(*(at + k * step)) for k in (-2, -1, 1, 2)]
            found[index] = np.dot([1, -8, 8, -1], shifted) / 12e-4
        return found

    found = ti.ad.hvp(run, rod.loss, [rod.c, rod.t], list(rod.directions))
    wanted = slopes(rod.at + 1e-30j * rod.directions).imag / 1e-30
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8)


def test_products_of_an_assembled_matrix():
    rod = Rod()
    rows, columns = np.nonzero(CENTERED)
    A = ti.linalg.AssembledMatrix(rows, columns, (N, N), dtype=ti.f64, needs_grad=True,
                                  needs_dual=True)  # fmt: skip
    c, values = rod.c, A.values
    start = CENTERED[rows, columns]
    base, at = (ti.field(t, shape=len(rows)) for t in (ti.f64, ti.i32))
    base.from_numpy(start)
    at.from_numpy(np.where(rows == columns, rows, -1).astype(np.int32))

    @ti.kernel
    def assemble():
        for k in values:
            more = c[at[k]] ** 2 if at[k] >= 0 else 0.0
            values[k] = base[k] + more

    for solve in (SOLVERS["cg"], ti.linalg.solve):

        def run(solve=solve):
            assemble()
            rod.load()
            rod.x.fill(0)
            solve(A, rod.b, rod.x)
            rod.measure()

        found = ti.ad.hvp(run, rod.loss, rod.inputs, list(rod.directions))
        np.testing.assert_allclose(found, exact(rod), rtol=1e-8)


def test_a_tape_that_was_recorded_without_tangents():
    rod = Rod()
    with ti.ad.Tape(rod.loss) as tape:
        rod.run(ti.linalg.cg)
    with pytest.raises(ti.TaiAutodiffError, match="recorded outside of it") as caught:
        ti.ad.hvp(tape, rod.loss, rod.inputs, list(rod.directions))
    assert "pass the function" in caught.value.hint
    found = ti.ad.hvp(lambda: rod.run(SOLVERS["cg"]), rod.loss, rod.inputs, list(rod.directions))
    np.testing.assert_allclose(found, exact(rod), rtol=1e-9)


def test_solvers_without_second_derivatives():
    rod = Rod()

    @ti.kernel
    def residual(x: ti.template(), r: ti.template()):
        for i in x:
            r[i] = x[i] ** 3 + x[i] - rod.c[i]

    def run():
        ti.linalg.newton(residual, rod.x)
        rod.measure()

    with pytest.raises(ti.TaiAutodiffError, match="newton has no derivative in forward mode"):
        ti.ad.hvp(run, rod.loss, rod.c, rod.directions[0])
