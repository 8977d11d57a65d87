"""Values that are read in one branch and in the other, before each branch writes."""

import tai as ti


def test_an_adjoint_read_and_cleared_in_both_branches():
    """The vectoriser selects among masked loads; the loads must not pass the stores."""
    n = 1031
    y = ti.field(ti.f64, shape=n, needs_grad=True)
    u = ti.field(ti.f64, shape=n, needs_grad=True)
    v = ti.Vector.field(2, ti.f64, shape=n, needs_grad=True)
    m = ti.field(ti.f64, shape=n, needs_grad=True)
    s = ti.field(ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def overwrite():
        for i in range(n):
            v[i][0] = y[i]
            y[i] = s[None]
            v[i] = v[i]
            loss[None] += ti.cos(y[i] * u[i] if i % 2 == 0 else m[1])

    @ti.kernel
    def total():
        for i in range(n):
            loss[None] += y[i]

    s[None] = 0.5
    with ti.ad.Tape(loss):
        overwrite()
        total()
    assert s.grad[None] == n
