"""How many iterations solvers take, and when they give up."""

import numpy as np
import pytest
import tai as ti

pytestmark = pytest.mark.filterwarnings("error")


@pytest.mark.parametrize("n, distinct", [(1, 1), (400, 1), (400, 3), (65_537, 8)])
def test_conjugate_gradients_take_a_step_for_each_eigenvalue(n, distinct):
    """But for rounding; along gradients alone it takes hundreds."""
    d, b, x = (ti.field(ti.f64, shape=n) for _ in range(3))
    eigenvalues = 10.0 ** np.linspace(0, 3, distinct)
    D = eigenvalues[np.arange(n) % distinct]
    B = np.random.default_rng(n).normal(size=n)
    d.from_numpy(D), b.from_numpy(B)

    @ti.kernel
    def scale(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = d[i] * p[i]

    info = ti.linalg.cg(scale, b, x, tol=1e-11)
    assert info.converged and info.iterations <= 2 * distinct
    assert np.allclose(x.to_numpy(), B / D, rtol=1e-9, atol=1e-12)


class Growth:
    """(1 - N) x = b, where N multiplies by 8 and shifts: residuals grow to 8^(n - 1), then vanish.

    Sweep k of Jacobi's iteration leaves N^k times the first residual, which starts in cell 0.
    """

    def __init__(self, n):
        self.b, self.x, self.ones = (ti.field(ti.f64, shape=n) for _ in range(3))
        self.ones.fill(1)
        self.b[0] = 1
        self.exact = 8.0 ** np.arange(n)

        @ti.kernel
        def apply(p: ti.template(), q: ti.template()):
            for i in p:
                q[i] = p[i] - (8 * p[i - 1] if i > 0 else 0.0)

        self.apply = apply

    def solve(self):
        return ti.linalg.jacobi(self.apply, self.ones, self.b, self.x)


def test_a_residual_that_grows_a_millionfold_diverges():
    """One that grows by less before it falls does not."""
    chain = Growth(7)
    info = chain.solve()
    assert info.converged and info.iterations == 7
    assert (chain.x.to_numpy() == chain.exact).all()
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="the iteration diverges"):
        info = Growth(9).solve()
    # 8^6 is less than a million, 8^7 is more.
    assert not info.converged and info.iterations == 7


@pytest.mark.parametrize("n, start", [(7, 1e9), (9, 1e-6)])
def test_growth_counts_from_the_first_residual_or_from_the_right_hand_side(n, start):
    """From the greater of the two: neither a far start nor a near one makes it diverge."""
    chain = Growth(n)
    chain.x.from_numpy(chain.exact)
    chain.x[0] += start
    info = chain.solve()
    assert info.converged
    assert np.allclose(chain.x.to_numpy(), chain.exact, rtol=1e-6)


def system(matrix, right, start=0.0, dtype=ti.f64):
    """A kernel that applies a matrix, the right-hand side, and a start."""
    n = len(matrix)
    a, b, x = ti.field(dtype, (n, n)), ti.field(dtype, n), ti.field(dtype, n)
    a.from_numpy(np.array(matrix, float)), b.from_numpy(np.array(right, float)), x.fill(start)

    @ti.kernel
    def apply(p: ti.template(), q: ti.template()):
        for i in p:
            total = ti.cast(0, dtype)
            for j in range(n):
                total += a[i, j] * p[j]
            q[i] = total

    return apply, b, x


SPREAD = [[2.0, 1, 0], [1, 3, 1], [0, 1, 4]]


@pytest.mark.parametrize("solver", ["cg", "bicgstab"])
@pytest.mark.parametrize("start", [np.nan, np.inf, -np.inf])
def test_a_start_that_is_not_finite_counts_as_zero(solver, start):
    right = np.array([1.0, -2, 3])
    apply, b, x = system(SPREAD, right, start)
    info = getattr(ti.linalg, solver)(apply, b, x)
    assert info.converged and info.iterations <= 4
    assert np.allclose(x.to_numpy(), np.linalg.solve(SPREAD, right), rtol=1e-9)


def test_a_breakdown_in_the_middle_begins_anew():
    """The residual after the first step is orthogonal to the first one, and not zero."""
    matrix = [[1.0, 0, 0], [-1, 2, 1], [-1, 0, 1]]
    apply, b, x = system(matrix, [1, 0, 0])
    info = ti.linalg.bicgstab(apply, b, x)
    assert info.converged
    assert np.allclose(x.to_numpy(), np.linalg.solve(matrix, [1, 0, 0]), rtol=1e-9)


GIVES_UP = {
    "the residual overflows": ("cg", [[1, 1e200], [1e200, 1]], {}, "iteration diverges"),
    "products overflow": ("bicgstab", np.full((8, 8), 1e308), {}, "iteration diverges"),
    "the second product is zero": ("bicgstab", [[1, 0], [1, 0]], {}, "breaks down"),
    "too few": ("bicgstab", SPREAD, {"max_iterations": 1}, "needs more iterations"),
    "below rounding": ("cg", SPREAD, {"tol": 1e-30}, "no longer falls"),
}


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", GIVES_UP)
def test_the_reason_to_give_up_is_told(name):
    solver, matrix, options, reason = GIVES_UP[name]
    apply, b, x = system(matrix, np.eye(len(matrix))[0])
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match=reason):
        info = getattr(ti.linalg, solver)(apply, b, x, **options)
    assert not info.converged and reason in info.reason


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("solver", ["cg", "bicgstab"])
def test_an_operator_that_is_not_linear_stagnates(solver):
    _, b, x = system(SPREAD, [1, 2, 3])

    @ti.kernel
    def shifted(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = 2 * p[i] + 5

    with pytest.warns(ti.linalg.TaiConvergenceWarning):
        info = getattr(ti.linalg, solver)(shifted, b, x, max_iterations=50)
    assert not info.converged and info.residual > 0.1


@pytest.mark.parametrize("size", [1.0, 1e-3, 0.0])
@pytest.mark.parametrize("name", ["MatrixFreeCG", "MatrixFreeBICGSTAB"])
def test_the_bound_of_matrix_free_solvers_is_absolute(name, size):
    right = size * np.array([1.0, 2.0, -1.0])
    apply, b, x = system(SPREAD, right)
    assert getattr(ti.linalg, name)(ti.linalg.LinearOperator(apply), b, x, tol=1e-8)
    assert np.linalg.norm(SPREAD @ x.to_numpy() - right) <= 1e-8


def test_a_change_of_just_the_tolerance_is_small_enough():
    """From 0, the sums of 1 change by 1/1, 1/2, …"""
    x = ti.field(ti.f64, shape=1, needs_grad=True)

    @ti.kernel
    def add_one(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = p[i] + 1

    info = ti.ad.implicit(add_one, x, tol=0.5)
    assert info.converged and (info.iterations, info.residual, x[0]) == (2, 0.5, 2.0)


@pytest.mark.filterwarnings("default")
def test_sweeps_that_are_too_few_need_more():
    """A quarter of the residual is left by each sweep."""
    n = 3
    ones = ti.field(ti.f64, n)
    ones.fill(1)
    apply, b, x = system(0.75 * np.eye(n), [1, 2, 3])
    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="needs more iterations"):
        info = ti.linalg.jacobi(apply, ones, b, x, tol=1e-6, max_iterations=9)
    assert info.iterations == 9 and info.residual == pytest.approx(0.25**9)
    x.fill(0)
    info = ti.linalg.jacobi(apply, ones, b, x, tol=1e-6, max_iterations=10)
    assert info.converged and info.iterations == 10  # 4^10 is the first above a million
    x.fill(0)
    info = ti.linalg.jacobi(apply, ones, b, x, tol=1e-6, damping=4 / 3)
    assert info.converged and info.iterations == 1


@pytest.mark.filterwarnings("default")
def test_a_fixed_point_that_overflows_diverges():
    x = ti.field(ti.f64, 2)
    x.fill(10)

    @ti.kernel
    def step(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = p[i] * p[i]

    with pytest.warns(ti.linalg.TaiConvergenceWarning, match="the iteration diverges"):
        info = ti.ad.implicit(step, x)
    # 10^(2^k) is infinite from k = 9 on.
    assert not info.converged and info.iterations == 9


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    "start, limit, reason", [(np.nan, 50, "holds NaN"), (1e6, 2, "needs more iterations")]
)
def test_newton_gives_up(start, limit, reason):
    x = ti.field(ti.f64, 2)
    x.fill(start)

    @ti.kernel
    def residual(p: ti.template(), r: ti.template()):
        for i in p:
            r[i] = p[i] ** 3 - 8

    with pytest.warns(ti.linalg.TaiConvergenceWarning, match=reason):
        info = ti.linalg.newton(residual, x, max_iterations=limit)
    assert not info.converged and info.iterations == (0 if np.isnan(start) else limit)
    x.fill(3)
    assert ti.linalg.newton(residual, x).converged and np.allclose(x.to_numpy(), 2)


@pytest.mark.parametrize("size", [1e-170, 1e170])
def test_norms_whose_squares_overflow_or_vanish(size):
    """The fixed point of x / 2 + size is 2 size; each change is half the one before."""
    x = ti.field(ti.f64, 3)
    x.fill(0)

    @ti.kernel
    def step(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = 0.5 * p[i] + size

    info = ti.ad.implicit(step, x, tol=1e-6)
    assert info.converged and 18 <= info.iterations <= 21
    assert np.allclose(x.to_numpy(), 2 * size, rtol=1e-5, atol=0)
