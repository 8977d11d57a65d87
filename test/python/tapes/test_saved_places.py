"""Places of fields that arguments choose: what is saved, put back, and computed again."""

import numpy as np
import pytest
import tai as ti

STEPS, WIDTH = 5, 8
SAVING = [{}, {"checkpoint": "periodic"}, {"checkpoint": "binomial"}, {"checkpoint": 1}]
# Overwritten levels, the same one again, and places that the field does not have.
TIMES = [0, -2, 1, 1, 7, 2, 0, 4, 3, -1, 2, 0, 1, 5, 3]


def dense(field):
    ti.root.dense(ti.ij, (STEPS, WIDTH)).place(field)


def dense_apart(field):
    ti.root.dense(ti.i, STEPS).dense(ti.j, WIDTH).place(field)


def time_inside(field):
    ti.root.dense(ti.j, WIDTH).dense(ti.i, STEPS).place(field)


def cells_below_time(field):
    ti.root.dense(ti.i, STEPS).pointer(ti.j, WIDTH // 2).dense(ti.j, 2).place(field)


def cells_of_time(field):
    ti.root.pointer(ti.ij, (STEPS, WIDTH // 4)).dense(ti.j, 4).place(field)


def mask_below_time(field):
    ti.root.dense(ti.i, STEPS).bitmasked(ti.j, WIDTH).place(field)


def cells_across_time(field):
    ti.root.pointer(ti.j, WIDTH // 2).dense(ti.ij, (STEPS, 2)).place(field)


LAYOUTS = [
    dense, dense_apart, time_inside, cells_below_time, cells_of_time, mask_below_time,
    cells_across_time,
]  # fmt: skip


def place(layout):
    x = ti.field(ti.f64, needs_grad=True, name="x")
    layout(x)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, name="loss")
    return x, loss


def reference(start, times):
    x = start.copy()
    for t in times:
        if 0 <= t < STEPS - 1:
            x[t + 1] = np.sin(x[t]) + 0.5 * x[t + 1] ** 2
    return np.sum(x**3)


def slopes(start, times):
    result = np.zeros(start.shape)
    for at in np.ndindex(start.shape):
        point = start.astype(complex)
        point[at] += 1e-30j
        result[at] = reference(point, times).imag / 1e-30
    return result


class Levels:
    """x[t + 1] = sin(x[t]) + x[t + 1]^2 / 2, for a level that an argument names."""

    def __init__(self, layout):
        self.x, self.loss = x, loss = place(layout)

        @ti.kernel
        def step(t: ti.i32):
            for j in range(WIDTH):
                if t >= 0 and t < STEPS - 1:
                    x[t + 1, j] = ti.sin(x[t, j]) + 0.5 * x[t + 1, j] ** 2

        @ti.kernel
        def total():
            for i, j in ti.ndrange(STEPS, WIDTH):
                loss[None] += x[i, j] ** 3

        self.step, self.total = step, total
        self.start = 0.1 + np.arange(STEPS * WIDTH).reshape(STEPS, WIDTH) / 50

    def run(self, times):
        for t in times:
            self.step(t)
        self.total()


@pytest.mark.parametrize("saving", SAVING, ids=lambda s: str(s.get("checkpoint", "saves")))
@pytest.mark.parametrize("layout", LAYOUTS)
def test_levels_that_are_overwritten(layout, saving):
    ti.init(default_fp=ti.f64, offline_cache=False)
    program = Levels(layout)
    program.x.from_numpy(program.start)
    with ti.ad.Tape(program.loss, **saving) as tape:
        program.run(TIMES)
    assert program.loss[None] == pytest.approx(reference(program.start, TIMES), rel=1e-12)
    expected = slopes(program.start, TIMES)
    np.testing.assert_allclose(program.x.grad.to_numpy(), expected, rtol=1e-10, atol=1e-14)
    # Everything is as the program left it, and the sweep can be repeated.
    after = program.x.to_numpy()
    tape.replay(forward=False)
    np.testing.assert_allclose(program.x.grad.to_numpy(), expected, rtol=1e-10, atol=1e-14)
    np.testing.assert_array_equal(program.x.to_numpy(), after)
    program.x.from_numpy(program.start)
    tape.replay()
    np.testing.assert_allclose(program.x.grad.to_numpy(), expected, rtol=1e-10, atol=1e-14)
    np.testing.assert_array_equal(program.x.to_numpy(), after)


def rows_of(layout):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss = place(layout)

    @ti.kernel
    def step(t: ti.i32):
        for j in range(WIDTH):
            if t >= 0 and t < STEPS - 1:
                x[t + 1, j] = 3 * ti.sin(x[t, j])

    @ti.kernel
    def total():
        for j in range(WIDTH):
            loss[None] += x[STEPS - 1, j] ** 3

    x.from_numpy(0.1 + np.arange(STEPS * WIDTH).reshape(STEPS, WIDTH) / 50)
    with ti.ad.Tape(loss, health=True) as tape:
        for t in (0, 1, 9, 2, 3):
            step(t)
        total()
    rows = [row for row in tape.health().rows if row.field == "x"]
    return [r.record for r in rows], [r.max_abs for r in rows]


@pytest.mark.parametrize("layout", LAYOUTS[1:])
def test_health_of_levels(layout):
    """A row is about the level that its kernel read, unless cells hold several levels."""
    (records, sizes), (of_dense, expected) = rows_of(layout), rows_of(dense)
    assert records == of_dense
    assert len(set(expected)) > 2
    if layout is cells_across_time:
        assert all(a >= b * (1 - 1e-12) for a, b in zip(sizes, expected, strict=True))
    else:
        np.testing.assert_allclose(sizes, expected, rtol=1e-12)


@pytest.mark.parametrize("checkpoint", ["periodic", "mixed", 1, 2, 3])
def test_a_host_function_that_fails_in_the_sweep(checkpoint):
    """The fields are put back as the program left them, and the sweep can be repeated."""
    ti.init(default_fp=ti.f64, offline_cache=False, deterministic=True)
    x, loss = place(dense)
    calls, fails_at = 0, None

    @ti.kernel
    def grow(factor: ti.f64):
        for i, j in x:
            x[i, j] = ti.sin(x[i, j]) * factor

    @ti.kernel
    def total():
        for i, j in x:
            loss[None] += x[i, j] ** 2

    @ti.kernel
    def shift(by: ti.f64):
        for i, j in x:
            x[i, j] += by

    @ti.ad.no_grad
    def shift_all(by):
        nonlocal calls
        calls += 1
        if calls == fails_at:
            raise ValueError("no more")
        shift(by)

    def run(failure):
        nonlocal calls, fails_at
        fails_at = None
        x.from_numpy(0.2 + np.arange(STEPS * WIDTH).reshape(STEPS, WIDTH) / 50)
        error, calls = None, 0
        tape = ti.ad.Tape(loss, checkpoint=checkpoint)
        try:
            with tape:
                for k in range(9):
                    grow(1.0 + 0.1 * k)
                    shift_all(0.05 * k)
                total()
                recorded = calls
                state = x.to_numpy()
                fails_at = None if failure is None else recorded + failure
        except ValueError as caught:
            error = caught
        fails_at = None
        np.testing.assert_array_equal(x.to_numpy(), state)
        return tape, error, calls - recorded

    _, error, swept = run(None)
    assert error is None and swept > 0
    expected = x.grad.to_numpy()
    for failure in range(1, swept + 1):
        tape, error, _ = run(failure)
        assert str(error).startswith("no more"), failure
        tape.replay(forward=False)
        np.testing.assert_array_equal(x.grad.to_numpy(), expected)


def test_levels_of_which_some_are_constant():
    """Positions of two fields at once, with constants among them."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    weights = ti.field(ti.f64, shape=(3, 4), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def mix(k: ti.i32):
        for i in range(3):
            weights[i, k] = weights[i, 0] * weights[i, 1] * weights[i, 2] + weights[i, 3]

    @ti.kernel
    def total():
        for i, k in weights:
            loss[None] += weights[i, k] ** 2

    def compute(w):
        for k in (1, 3, 0, 1, 2, 1):
            w[:, k] = w[:, 0] * w[:, 1] * w[:, 2] + w[:, 3]
        return np.sum(w**2)

    start = 0.4 + np.arange(12.0).reshape(3, 4) / 20
    for saving in SAVING:
        weights.from_numpy(start)
        loss[None] = 0
        with ti.ad.Tape(loss, **saving):
            for k in (1, 3, 0, 1, 2, 1):
                mix(k)
            total()
        for at in np.ndindex(3, 4):
            point = start.astype(complex)
            point[at] += 1e-30j
            assert weights.grad[at] == pytest.approx(compute(point).imag / 1e-30, rel=1e-10)
