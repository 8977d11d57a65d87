"""Reverse loops that leave out cells whose adjoints are zero: the same bits, and less work."""

import numpy as np
import pytest
import tai as ti

N, BLOCK = 512, 8


def scene(skip, deterministic=True, step="stencil"):
    """Ten bodies that do not touch; the loss looks at some of them."""
    ti.init(skip=skip, deterministic=deterministic, offline_cache=False, default_fp=ti.f64)
    x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
    c, loss = (ti.field(ti.f64, shape=(), needs_grad=True) for _ in range(2))
    ti.root.pointer(ti.i, N // BLOCK).dense(ti.i, BLOCK).place(x, y)

    @ti.kernel
    def fill():
        for body in range(10):
            for k in range(3 * BLOCK):
                x[48 * body + k] = 0.3 + 0.01 * ((body * 7 + k) % 13)

    @ti.kernel
    def stencil():
        for i in x:
            if 0 < i < N - 1:
                y[i] = x[i] * (0.5 + x[i - 1] - 0.25 * x[i + 1])

    @ti.kernel
    def scaled():
        for i in x:
            y[i] = x[i] * x[i] * c[None]

    @ti.kernel
    def scatter():
        for i in x:
            if i < N - 8:
                y[i + 8] += x[i] * x[i]

    @ti.kernel
    def constant():
        for i in x:
            y[i] = 1.0
            if i % 3 == 0:
                y[i] = x[i] * x[i]

    @ti.kernel
    def carried():
        for i in x:
            v = x[i]
            for _ in range(4):
                if v > 0.2:
                    v = v * x[i + 1] + 0.1 * ti.sin(v)
            y[i] = v

    @ti.kernel
    def back():
        for i in y:
            x[i] = 0.5 * x[i] + y[i] * y[i]

    @ti.kernel
    def total(bodies: ti.i32):
        for i in y:
            if i < 48 * bodies:
                loss[None] += x[i] * x[i]

    kernel = {"stencil": stencil, "scaled": scaled, "scatter": scatter, "constant": constant,
              "carried": carried}[step]  # fmt: skip

    def run(bodies):
        x.parent().parent().deactivate_all()
        fill()
        c[None] = 0.7
        with ti.ad.Tape(loss):
            for _ in range(3):
                kernel()
                back()
            total(bodies)
        return x.grad.to_numpy(), y.grad.to_numpy(), c.grad.to_numpy(), loss.to_numpy()

    return run


def counters():
    return ti.profiler.skips()["zero-adjoints"]


STEPS = ["stencil", "scaled", "scatter", "constant", "carried"]


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("bodies", [0, 1, 10])
def test_same_bits(step, bodies):
    with_flags = scene("all", step=step)(bodies)
    without = scene("all,-zero-adjoints", step=step)(bodies)
    assert counters() == {"cells_visited": 0, "cells_skipped": 0}
    for a, b in zip(with_flags, without, strict=True):
        assert a.tobytes() == b.tobytes()
    fast = scene("all", deterministic=False, step=step)(bodies)
    for a, b in zip(fast, without, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


def test_one_body_of_ten():
    run = scene("all", deterministic=False)
    ti.profiler.clear_skips()
    run(10)
    everything = counters()
    ti.profiler.clear_skips()
    grads = run(1)
    one = counters()
    assert one["cells_visited"] + one["cells_skipped"] == sum(everything.values())
    assert 0 < one["cells_visited"] <= 0.15 * everything["cells_visited"]
    assert np.any(grads[0][:24]) and not np.any(grads[0][48:])


def test_what_visits_everything():
    # The adjoint of a scatter reads the adjoints of other cells.
    run = scene("all", step="scatter")
    ti.profiler.clear_skips()
    run(1)
    scattered = sum(counters().values())
    run = scene("all", step="stencil")
    ti.profiler.clear_skips()
    run(1)
    assert 0 < scattered < sum(counters().values())


def test_gathered_adjoints_visit_what_lies_around():
    """A stencil: the loss looks at one of four bodies, and reaches over the border of a block."""
    gradients = []
    for skip in ("all", "all,-zero-adjoints"):
        ti.init(arch=ti.cpu, default_fp=ti.f64, deterministic=True, skip=skip)
        n = 128
        x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
        ti.root.pointer(ti.ij, n // 8).dense(ti.ij, 8).place(x, y, x.grad, y.grad)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def fill():
            for i, j in ti.ndrange(n, n):
                if i % 64 < 24 and j % 64 < 24:
                    x[i, j] = i + 0.5 * j

        @ti.kernel
        def step():
            for i, j in x:
                if 0 < i < n - 1 and 0 < j < n - 1:
                    y[i, j] = x[i, j] * x[i, j - 1] + 2.0 * x[i + 1, j] - x[i - 1, j + 1]

        @ti.kernel
        def look():
            loss[None] += y[64, 72] + 3.0 * y[71, 79] + y[87, 65]

        fill()
        ti.profiler.clear_skips()
        with ti.ad.Tape(loss):
            step()
            look()
        gradients.append(x.grad.to_numpy())
        counts = ti.profiler.skips()["zero-adjoints"]
        if skip == "all":
            # Around two of its blocks, the body of nine has all cells but one. And these two, to
            # zero the adjoints of elements stored there.
            assert counts == {"cells_visited": 8 + 2, "cells_skipped": 28 + 34}
    expected = np.zeros((128, 128))
    for (i, j), weight in {(64, 72): 1.0, (71, 79): 3.0, (87, 65): 1.0}.items():
        for k, l, partial in (
            (i, j, i + 0.5 * (j - 1)),
            (i, j - 1, i + 0.5 * j),
            (i + 1, j, 2.0),
            (i - 1, j + 1, -1.0),
        ):
            if k % 64 < 24 and l % 64 < 24:
                expected[k, l] += weight * partial
    np.testing.assert_allclose(gradients[0], expected, atol=1e-12)
    assert gradients[0].tobytes() == gradients[1].tobytes()
