"""Gradients of singular systems: the part of a gradient that no solution follows is left out."""

import numpy as np
import pytest
import tai as ti


def solved(solver, seed, n=20):
    """Gradients to the right-hand side and the matrix, and both by the pseudo-inverse."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    draw = np.random.default_rng(seed)
    basis = np.linalg.qr(draw.normal(size=(n, n)))[0]
    matrix = basis @ np.diag(np.linspace(0, 3, n)) @ basis.T
    right, weights = matrix @ draw.normal(size=n), draw.normal(size=n)
    rows, b, x = (ti.field(float, shape=s, needs_grad=True) for s in ((n, n), n, n))
    loss, w = ti.field(float, shape=(), needs_grad=True), ti.field(float, shape=n)

    @ti.kernel
    def product(p: ti.template(), q: ti.template()):
        for i in p:
            total = 0.0
            for j in range(n):
                total += rows[i, j] * p[j]
            q[i] = total

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += w[i] * x[i]

    for f, array in ((rows, matrix), (b, right), (w, weights)):
        f.from_numpy(array)
    with ti.ad.Tape(loss):
        getattr(ti.linalg, solver)(product, b, x, tol=1e-10)
        measure()
    adjoint = np.linalg.pinv(matrix, rcond=1e-10) @ weights
    exact = adjoint, -np.outer(adjoint, x.to_numpy())
    return (b.grad.to_numpy(), rows.grad.to_numpy()), exact


@pytest.mark.parametrize(
    ("solver", "seed"),
    [("gmres", 100), ("gmres", 102), ("gmres", 105), ("bicgstab", 100), ("cg", 100)],
)
def test_gradients_of_singular_systems(solver, seed):
    for found, exact in zip(*solved(solver, seed), strict=True):
        assert np.linalg.norm(found - exact) <= 1e-7 * np.linalg.norm(exact)
