"""Reverse loops over dense fields that leave out blocks whose adjoints are zero: the same bits."""

import numpy as np
import pytest
import tai as ti

BODIES, N, STEPS = 8, 1024, 3
OFF = "all,-zero-adjoints"


@ti.func
def pointwise(v):
    return v + 0.1 * ti.sin(3.0 * v) * ti.exp(-v * v)


@ti.func
def rooted(v):
    # The partial derivative is infinite at zero, and a guard keeps it out.
    return ti.sqrt(v) + ti.log(v + 1.0) * ti.cos(v)


@ti.func
def quotient(v):
    return ti.sin(v) / (1.5 + ti.cos(v)) + ti.tanh(v)


FUNCTIONS = {"pointwise": pointwise, "rooted": rooted, "quotient": quotient}


def make(skip, step, dtype=ti.f32, deterministic=True):
    ti.init(skip=skip, deterministic=deterministic, offline_cache=False, default_fp=dtype)
    x = ti.field(dtype, shape=(STEPS + 1, BODIES, N), needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)
    f = FUNCTIONS.get(step)

    @ti.kernel
    def advance(t: ti.i32):
        for b, i in ti.ndrange(BODIES, N):
            x[t + 1, b, i] = f(x[t, b, i])

    @ti.kernel
    def stencil(t: ti.i32):
        for b, i in ti.ndrange(BODIES, N):
            x[t + 1, b, i] = x[t, b, i] + 0.1 * ti.sin(x[t, b, (i + 1) % N] - x[t, b, i])

    @ti.kernel
    def total(first: ti.i32, last: ti.i32):
        for i in range(first, last):
            loss[None] += x[STEPS, 2, i] ** 2

    def run(values, first=100, last=300):
        x.from_numpy(values)
        loss[None] = 0.0
        ti.profiler.clear_skips()
        with ti.ad.Tape(loss) as tape:
            for t in range(STEPS):
                (stencil if f is None else advance)(t)
            total(first, last)
        counts = ti.profiler.skips()["zero-adjoints"]
        return x.grad.to_numpy().tobytes(), x.to_numpy().tobytes(), counts, tape.explain()

    return run


def values(dtype="float32"):
    out = np.zeros((STEPS + 1, BODIES, N), dtype)
    out[0] = np.random.default_rng(1).uniform(0.0, 2.0, (BODIES, N))
    out[0, :, ::7] = 0.0
    return out


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("step", [*FUNCTIONS, "stencil"])
def test_blocks_have_the_same_bits(step, dtype):
    data = values("float32" if dtype == ti.f32 else "float64")
    run = make("all", step, dtype)
    some, everything = run(data), run(data, 0, N)
    run = make(OFF, step, dtype)
    for now, (first, last) in ((some, (100, 300)), (everything, (0, N))):
        long = run(data, first, last)
        assert now[:2] == long[:2]
        assert long[2] == {"cells_visited": 0, "cells_skipped": 0}
    assert "because their adjoints are zero" in some[3]
    assert "because their adjoints are zero" not in long[3]
    assert some[2]["cells_skipped"] > 3 * some[2]["cells_visited"] > 0


def test_a_block_with_numbers_that_are_not_finite_runs():
    """Zero times infinity is NaN where no guard stands, with the skip and without it."""
    data = values()
    data[0, 5, 17], data[0, 6, 900], data[0, 7, 3], data[0, 1, 5] = np.inf, np.nan, 3e38, -1e30
    for step in [*FUNCTIONS, "stencil"]:
        on, off = make("all", step)(data), make(OFF, step)(data)
        assert on[:2] == off[:2]


def test_a_single_adjoint_in_a_block_is_found():
    data = values() + 0.1
    run = make("all", "pointwise")
    places = (0, 1, 127, 128, 700, N - 1)
    found = [run(data, at, at + 1) for at in places]
    run = make(OFF, "pointwise")
    for at, on in zip(places, found, strict=True):
        assert on[:2] == run(data, at, at + 1)[:2]
        assert np.count_nonzero(np.frombuffer(on[0], "float32")) > 0


def test_cheap_loops_are_not_tested():
    ti.init(offline_cache=False)
    x, y = (ti.field(ti.f32, shape=4096, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def scale():
        for i in x:
            y[i] = 2.0 * x[i]

    @ti.kernel
    def total():
        loss[None] += y[3]

    ti.profiler.clear_skips()
    with ti.ad.Tape(loss):
        scale()
        total()
    assert ti.profiler.skips()["zero-adjoints"] == {"cells_visited": 0, "cells_skipped": 0}
    assert x.grad[3] == 2.0


def test_a_loop_that_adds_up_a_parameter():
    """Contributions to a parameter are added up as before."""

    def gradients(skip):
        ti.init(skip=skip, deterministic=True, offline_cache=False)
        x = ti.field(ti.f32, shape=(2, 8192), needs_grad=True)
        c, loss = (ti.field(ti.f32, shape=(), needs_grad=True) for _ in range(2))

        @ti.kernel
        def step():
            for i in range(8192):
                x[1, i] = x[0, i] + c[None] * ti.sin(ti.exp(x[0, i]))

        @ti.kernel
        def total():
            for i in range(64):
                loss[None] += x[1, 4000 + i] ** 2

        x.from_numpy(np.random.default_rng(2).normal(size=(2, 8192)).astype("float32"))
        c[None] = 0.7
        with ti.ad.Tape(loss):
            step()
            total()
        return x.grad.to_numpy().tobytes(), c.grad.to_numpy().tobytes()

    assert gradients("all") == gradients(OFF)
