"""A loop of launches that ends when the host reads that the last one changed nothing."""

import numpy as np
import tai as ti

N = 16


def test_launches_after_the_last_change_are_neither_run_nor_reversed():
    """The gradient is that of as many launches as were needed, and the tape has no others."""
    ti.init(default_fp=ti.f64)
    x, b = (ti.field(ti.f64, shape=(64, N), needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    moved = ti.field(ti.i32, shape=())

    @ti.kernel
    def relax(t: ti.i32, bound: ti.f64):
        for i in range(N):
            x[t + 1, i] = 0.5 * x[t, i] + b[0, i]
            if abs(x[t + 1, i] - x[t, i]) > bound:
                moved[None] = 1

    @ti.kernel
    def total(t: ti.i32):
        for i in range(N):
            loss[None] += x[t, i]

    b.from_numpy(np.ones((64, N)))
    steps = []
    for bound in (1e-3, 1e-9):
        x.fill(0.0)
        with ti.ad.Tape(loss) as tape:
            for t in range(63):
                moved[None] = 0
                relax(t, bound)
                if moved[None] == 0:
                    break
            total(t + 1)
        steps.append(t + 1)
        launches = [line for line in tape.explain().splitlines() if "@relax" in line]
        assert len(launches) == t + 1
        # The sum of 0.5**k for k below the number of steps.
        np.testing.assert_allclose(b.grad.to_numpy()[0], 2 - 0.5**t, rtol=1e-14)
    assert steps[0] < steps[1] < 40


def test_the_adjoint_of_a_solve_begins_where_the_last_one_ended():
    ti.init(default_fp=ti.f64)
    b, x, start, d = (ti.field(ti.f64, shape=200, needs_grad=True) for _ in range(4))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    d.from_numpy(np.linspace(1, 50, 200))
    b.fill(1.0)

    @ti.kernel
    def scale(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = d[i] * p[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] * x[i]

    iterations = []
    for _ in range(2):
        with ti.ad.Tape(loss):
            info = ti.linalg.cg(scale, b, x, tol=1e-10, adjoint_start=start)
            total()
        iterations.append((info.iterations, info.adjoint.iterations))
    assert iterations[0][0] > 10 and iterations[0][1] > 10
    assert iterations[1][0] <= 1 and iterations[1][1] <= 1
