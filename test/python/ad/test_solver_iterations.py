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
