"""`ti.solve_to`: the error that was asked for, the modes, and the reasons to refuse."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import tai as ti
from tai._impl.ad import solve
from tai.errors import TaiAutodiffError

pytestmark = pytest.mark.filterwarnings("ignore::tai.errors.TaiConvergenceWarning")


def scalar(*shape, kind=float, name=""):
    return ti.field(kind, shape=shape, needs_grad=True, name=name)


def distances(found, loss, gradients):
    apart = [np.linalg.norm(a - b) for a, b in zip(found.gradients, gradients, strict=True)]
    size = np.linalg.norm([np.linalg.norm(g) for g in gradients])
    return max(abs(found.loss - loss) / abs(loss), np.linalg.norm(apart) / size)


def sines(n=500):
    """Σ (sin 3x - 1/2)², and its derivative."""
    x, y, loss = scalar(n), scalar(n), scalar()

    @ti.kernel
    def evaluate():
        for i in x:
            y[i] = ti.sin(3.0 * x[i])

    @ti.kernel
    def measure():
        for i in y:
            loss[None] += (y[i] - 0.5) ** 2

    def run():
        evaluate()
        measure()

    point = np.linspace(1, 2, n, dtype=np.float32)
    x.from_numpy(point)
    z = np.sin(3 * point.astype(float))
    gradient = 6 * (z - 0.5) * np.cos(3 * point.astype(float))
    return run, loss, [x], np.sum((z - 0.5) ** 2), [gradient]


def cancellation():
    """Numbers that lose four digits before they are squared."""
    n = 64
    x, loss = scalar(n), scalar()

    @ti.kernel
    def run():
        for i in x:
            d = (x[i] + 1000.0) - 1000.0
            loss[None] += d * d

    point = np.linspace(0.11, 0.97, n, dtype=np.float32)
    x.from_numpy(point)
    exact = point.astype(float)
    return run, loss, [x], np.sum(exact**2), [2 * exact]


def springs_in_place():
    """A chain that is updated in place, and the same in NumPy by complex steps."""
    n, steps, dt = 6, 30, 0.05
    x, v, loss = scalar(n), scalar(n), scalar()

    @ti.kernel
    def force():
        for i in range(n):
            f = -ti.sin(x[i])
            if i > 0:
                f += x[i - 1] - x[i]
            v[i] += dt * f

    @ti.kernel
    def move():
        for i in x:
            x[i] += dt * v[i]

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    def run():
        for _ in range(steps):
            force()
            move()
        measure()

    def in_numpy(p, q):
        p, q = p.astype(complex), q.astype(complex)
        for _ in range(steps):
            f = -np.sin(p)
            f[1:] += p[:-1] - p[1:]
            q = q + dt * f
            p = p + dt * q
        return np.sum(p**2)

    p = np.linspace(0.2, 1.3, n, dtype=np.float32)
    q = np.linspace(-0.4, 0.3, n, dtype=np.float32)
    x.from_numpy(p)
    v.from_numpy(q)
    h = 1e-30j * np.eye(n)
    gradients = [
        np.array([in_numpy(p + e, q).imag / 1e-30 for e in h]),
        np.array([in_numpy(p, q + e).imag / 1e-30 for e in h]),
    ]
    return run, loss, [x, v], in_numpy(p, q).real, gradients


SCENES = {"sines": sines, "cancellation": cancellation, "springs": springs_in_place}


@pytest.mark.parametrize("kind", ["f32", "f64"])
@pytest.mark.parametrize("scene", SCENES)
def test_the_error_that_was_asked_for(scene, kind, monkeypatch):
    # All iterations take a second, so that the time chooses nothing.
    monkeypatch.setattr(solve, "time", SimpleNamespace(perf_counter=itertools.count().__next__))
    ti.init(default_fp=getattr(ti, kind), offline_cache=False)
    run, loss, wrt, value, gradients = SCENES[scene]()
    before = [f.to_numpy() for f in wrt]
    kinds = [f.dtype for f in wrt]
    chosen = []
    for error in (1e-2, 1e-6, 1e-11):
        with np.errstate(all="raise"):
            if kind == "f32" and error < 1e-7:
                with pytest.warns(ti.ad.TaiGradientWarning, match="is of f32, which cannot hold"):
                    found = ti.solve_to(run, loss=loss, wrt=wrt, error=error)
            else:
                found = ti.solve_to(run, loss=loss, wrt=wrt, error=error)
        assert distances(found, value, gradients) <= error
        assert found.error <= error
        assert sum(part.error for part in found.parts) == found.error
        assert found.iterations <= 20
        assert found.time > 0
        chosen.append(found.modes["precision"])
        # The fields are as they were, but for the results.
        for field, array, dtype in zip(wrt, before, kinds, strict=True):
            np.testing.assert_array_equal(field.to_numpy(), array)
            assert field.dtype is dtype
        assert loss[None] == pytest.approx(found.loss, rel=1e-7)
        np.testing.assert_allclose(wrt[0].grad.to_numpy(), found.gradients[0], rtol=1e-6)
    assert chosen[0] == "f32"
    assert chosen[2] == "f64"
    # The line that cancels needs f64.
    assert (chosen[1] == "f64") == (scene == "cancellation")
    with ti.ad.Tape(loss):
        run()
    assert loss[None] == pytest.approx(value, rel=1e-3)


def test_parts_name_the_lines():
    ti.init(offline_cache=False)
    run, loss, wrt, _, _ = cancellation()
    found = ti.solve_to(run, loss=loss, wrt=wrt, error=1e-2)
    (part,) = found.parts
    assert part.name == "rounding"
    assert "d = (x[i] + 1000.0) - 1000.0" in part.lines[0][0]
    assert "d = (x[i] + 1000.0) - 1000.0" in str(found)


def test_again_in_the_chosen_modes():
    ti.init(offline_cache=False)
    run, loss, wrt, value, _ = springs_in_place()
    found = ti.solve_to(run, loss=loss, wrt=wrt, error=1e-5)
    start = [f.to_numpy() for f in wrt]
    found.run()
    assert loss[None] == pytest.approx(value, rel=1e-5)
    assert not np.array_equal(wrt[0].to_numpy(), start[0])  # it works in place


def pendulum():
    state, v0, loss = scalar(2), scalar(), scalar()

    @ti.kernel
    def begin():
        state[0] = 0.5
        state[1] = v0[None]

    @ti.kernel
    def step(dt: float):
        old = state[0] + 0.5 * dt * state[1]
        state[1] -= dt * ti.sin(old)
        state[0] = old + 0.5 * dt * state[1]

    @ti.kernel
    def end():
        loss[None] += state[0] ** 2

    def run(steps=16):
        begin()
        for _ in range(steps):
            step(2.0 / steps)
        end()

    v0[None] = 0.7
    return run, loss, v0


def pendulum_at(steps):
    """Loss and derivative by complex steps in NumPy, with so many steps that they are exact."""
    a, b, dt = 0.5 + 0j, 0.7 + 1e-30j, 2.0 / steps
    for _ in range(steps):
        old = a + 0.5 * dt * b
        b = b - dt * np.sin(old)
        a = old + 0.5 * dt * b
    value = a**2
    return value.real, value.imag / 1e-30


@pytest.mark.parametrize("error", [1e-2, 1e-3, 1e-5])
def test_steps_fill_the_room(error):
    ti.init(default_fp=ti.f64, offline_cache=False)
    run, loss, v0 = pendulum()
    found = ti.solve_to(run, loss=loss, wrt=[v0], error=error)
    coarse, fine = pendulum_at(4000), pendulum_at(8000)
    value, slope = ((4 * b - a) / 3 for a, b in zip(coarse, fine, strict=True))
    true = distances(found, value, [np.array(slope)])
    assert 0.05 * error <= true <= error
    assert [part.name for part in found.parts] == ["discretisation", "rounding"]
    assert f"steps={found.modes['steps']}" in found.parts[0].lines[0][0]
    assert found.iterations <= 20


def test_room_that_no_mode_fills():
    """f32 has a hundred-thousandth of the error, and few numbers gain nothing from 16 bits."""
    ti.init(default_fp=ti.f32, offline_cache=False)
    run, loss, wrt, *_ = sines()
    found = ti.solve_to(run, loss=loss, wrt=wrt, error=1e-2)
    assert found.error < 0.05e-2
    assert "already gives" in found.room and "can be stored in 16 bits" in found.room
    assert f"room: {found.room}" in str(found)


def test_room_names_the_modes_that_fail():
    ti.init(default_fp=ti.f32, offline_cache=False)
    run, loss, wrt, *_ = sines()
    found = ti.solve_to(run, loss=loss, wrt=wrt, error=1e-9)
    assert found.modes["precision"] == "f64"
    assert "f32: is" in found.room and "off by" in found.room


def test_no_room_is_left_by_steps():
    ti.init(default_fp=ti.f64, offline_cache=False)
    run, loss, v0 = pendulum()
    assert ti.solve_to(run, loss=loss, wrt=[v0], error=1e-3).room == ""


def test_a_gradient_that_loses_more_than_the_loss():
    """In f64, the estimate of the loss says 1e-16, and the gradient loses three digits more."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss = scalar(64), scalar()

    @ti.kernel
    def run():
        for i in x:
            d = (x[i] + 1000.0) - 1000.0
            loss[None] += 1.0 + 1e-8 * d * d

    point = np.linspace(0.11, 0.97, 64)
    x.from_numpy(point)
    found = ti.solve_to(run, loss=loss, wrt=[x], error=1e-11)
    true = distances(found, np.sum(1 + 1e-8 * point**2), [2e-8 * point])
    assert 1e-14 < true <= found.error <= 1e-11
    with pytest.raises(TaiAutodiffError, match="is not kept by any mode"):
        ti.solve_to(run, loss=loss, wrt=[x], error=1e-13)


def test_steps_that_would_take_too_long():
    ti.init(default_fp=ti.f64, offline_cache=False)
    run, loss, v0 = pendulum()
    with pytest.raises(TaiAutodiffError, match="would take about .* steps") as caught:
        ti.solve_to(run, loss=loss, wrt=[v0], error=1e-12)
    assert caught.value.filename == __file__


def test_steps_beyond_the_field():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss = scalar(33), scalar()

    @ti.kernel
    def step(t: int, dt: float):
        x[t + 1] = x[t] - dt * ti.sin(x[t])

    @ti.kernel
    def end(t: int):
        loss[None] += x[t]

    def run(steps=32):
        for t in range(steps):
            step(t, 1.0 / steps)
        end(steps)

    x[0] = 0.5
    with pytest.raises(TaiAutodiffError, match=r"run\(steps=64\) fails") as caught:
        ti.solve_to(run, loss=loss, wrt=[x], error=1e-3)
    assert "time axis" in caught.value.hint


def test_tolerance_of_a_solver():
    ti.init(default_fp=ti.f64, offline_cache=False)
    n = 30
    b, x, loss = scalar(n), scalar(n), scalar()

    @ti.kernel
    def product(p: ti.template(), q: ti.template()):
        for i in p:
            left = p[i - 1] if i > 0 else 0.0
            right = p[i + 1] if i < n - 1 else 0.0
            q[i] = 2.1 * p[i] - left - right

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    def run(tol=1e-6):
        ti.linalg.cg(product, b, x, tol=tol)
        measure()

    right = np.linspace(1, 2, n)
    b.from_numpy(right)
    matrix = 2.1 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    solution = np.linalg.solve(matrix, right)
    found = ti.solve_to(run, loss=loss, wrt=[b], error=1e-4)
    gradient = np.linalg.solve(matrix, 2 * solution)
    assert distances(found, solution @ solution, [gradient]) <= 1e-4
    assert [part.name for part in found.parts] == ["solver", "rounding"]
    assert found.modes["tol"] <= 1e-4
    assert "ti.linalg.cg, backward error" in found.parts[0].lines[0][0]


def chain(tol, kind=ti.f64, n=30):
    """A row of cells, solved to a tolerance of its own; and its loss and gradient in NumPy."""
    ti.init(default_fp=kind, offline_cache=False)
    b, x, loss = scalar(n), scalar(n), scalar()

    @ti.kernel
    def product(p: ti.template(), q: ti.template()):
        for i in p:
            left = p[i - 1] if i > 0 else 0.0
            right = p[i + 1] if i < n - 1 else 0.0
            q[i] = 2.1 * p[i] - left - right

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    def run():
        ti.linalg.cg(product, b, x, tol=tol)
        measure()

    right = np.linspace(1, 2, n).astype(np.float32).astype(float)
    b.from_numpy(right)
    matrix = 2.1 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    solution = np.linalg.solve(matrix, right)
    gradient = np.linalg.solve(matrix, 2 * solution)
    return run, loss, b, solution @ solution, gradient


@pytest.mark.parametrize("kind", [ti.f32, ti.f64])
def test_solvers_with_tolerances_of_their_own(kind):
    run, loss, b, value, gradient = chain(1e-4, kind)
    found = ti.solve_to(run, loss=loss, wrt=[b], error=1e-2)
    assert [part.name for part in found.parts] == ["solver", "rounding"]
    part = found.parts[0]
    (text, effect), = part.lines  # fmt: skip
    assert "test_solve_to.py" in text
    assert "ti.linalg.cg, backward error" in text
    assert 0 < part.error
    assert 0 < effect
    assert distances(found, value, [gradient]) <= found.error <= 1e-2


def test_solvers_that_stop_too_early():
    run, loss, b, _, _ = chain(1e-2)
    with pytest.raises(TaiAutodiffError, match="the solvers stop too early") as caught:
        ti.solve_to(run, loss=loss, wrt=[b], error=1e-6)
    assert "ti.linalg.cg, backward error" in caught.value.message
    assert "def run(tol=1e-6)" in caught.value.hint


@pytest.mark.parametrize("tol", [1e-2, 1e-4, 1e-8])
def test_the_report_bounds_the_effect_of_solvers(tol):
    run, loss, _b, value, _ = chain(tol)
    with ti.ad.Tape(loss, precision=True) as tape:
        run()
    (found,) = tape.precision_report().solves
    # To first order; and where a tolerance is small, roundings of f32 are not in it.
    assert abs(loss[None] - value) <= 1.1 * found.error + 1e-13 * value
    assert found.error <= 1e3 * max(tol, 1e-13) * value
    assert 0 < found.backward_error <= tol
    assert (found.solver, found.calls) == ("ti.linalg.cg", 1)
    assert "solvers, which stop at their tolerances" in str(tape.precision_report())


def test_a_report_without_solvers_names_none():
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss = scalar(4), scalar()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += x[i] ** 2

    x.fill(1.5)
    with ti.ad.Tape(loss, precision=True) as tape:
        run()
    assert tape.precision_report().solves == []
    assert "solvers" not in str(tape.precision_report())


def test_structs_matrices_and_returned_numbers():
    ti.init(default_fp=ti.f32, offline_cache=False)
    particle = ti.types.struct(pos=ti.types.vector(2, ti.f32), vel=ti.types.vector(2, ti.f32))
    p = particle.field(shape=5, needs_grad=True)
    m = ti.Matrix.field(2, 2, ti.f32, shape=3, needs_grad=True, layout=ti.Layout.SOA, offset=-1)
    loss = scalar()
    weights = np.linspace(0, 1, 5, dtype=np.float32)

    @ti.kernel
    def size() -> float:
        s = 0.0
        for i in p:
            s += p[i].pos.norm_sqr()
        return s

    @ti.kernel
    def push(s: float, w: ti.types.ndarray()):
        for i in p:
            p[i].vel += s * p[i].pos * w[i]
        for i in m:
            m[i] = m[i] @ m[i]

    @ti.kernel
    def measure():
        for i in p:
            loss[None] += p[i].vel.norm_sqr()
        for i in m:
            loss[None] += m[i].determinant()

    def run():
        push(size(), weights)
        measure()

    generator = np.random.default_rng(0)
    pos = generator.random((5, 2), dtype=np.float32)
    matrices = generator.random((3, 2, 2), dtype=np.float32)
    p.pos.from_numpy(pos)
    m.from_numpy(matrices)
    pos, matrices, w = pos.astype(float), matrices.astype(float), weights.astype(float)
    s = np.sum(pos**2)
    total = np.sum(w**2 * np.sum(pos**2, 1))
    determinants = np.linalg.det(matrices)
    value = s**2 * total + np.sum(determinants**2)
    by_pos = 4 * s * pos * total + 2 * s**2 * w[:, None] ** 2 * pos
    by_m = 2 * determinants[:, None, None] ** 2 * np.linalg.inv(matrices).transpose(0, 2, 1)
    for error in (1e-4, 1e-6):
        found = ti.solve_to(run, loss=loss, wrt=[p.pos, m], error=error)
        assert [g.shape for g in found.gradients] == [(5, 2), (3, 2, 2)]
        assert distances(found, value, [by_pos, by_m]) <= error
        assert p.pos.dtype is m.dtype is ti.f32


def test_a_function_that_makes_the_program():
    ti.init(offline_cache=False)

    def program(types):
        x = ti.field(types["x"], shape=8, needs_grad=True, name="x")
        loss = ti.field(float, shape=(), needs_grad=True)
        x.from_numpy(np.linspace(1, 2, 8, dtype=np.float32))

        @ti.kernel
        def measure():
            for i in x:
                loss[None] += x[i] ** 3

        return measure, loss

    found = ti.solve_to(program, wrt=["x"], error=1e-4)
    np.testing.assert_allclose(found.gradients[0], 3 * np.linspace(1, 2, 8) ** 2, rtol=1e-4)
    with pytest.raises(ti.TaiRuntimeTypeError, match="uses no field 'z'"):
        ti.solve_to(program, wrt=["z"], error=1e-4)


REFUSED = {
    "chaos": "rounding changes the loss by .* in f64, as in chaos.*z = 3.99",
    "kink": "a kink is near by",
    "side": "at a kink, .* grows by 0.6, and by 0.3 from the other side",
    "beside": "a kink is near by",
    "jump": "the loss jumps",
    "zero": "the loss is 0",
    "random": "not repeatable",
    "flat": "the gradient is 0",
    "host": "outside of kernels",
    "reach": "cannot be kept: f64.* is expected to be off",
    "infinite": "not finite",
    "array": "writes to an array of the caller",
    "sparse": "field 's' is sparse",
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, there, loss = scalar(), scalar(), scalar()
    s = ti.field(ti.f32, name="s")
    ti.root.pointer(ti.i, 4).dense(ti.i, 4).place(s)
    ti.root.lazy_grad()
    array = np.zeros(4)

    @ti.kernel
    def chaos():
        for _ in range(1):
            z = x[None]
            for _ in range(80):
                z = 3.99 * z * (1 - z)
            loss[None] += z

    @ti.kernel
    def kink():
        loss[None] += ti.abs(x[None] - 0.3) + x[None]

    @ti.kernel
    def side():
        loss[None] += ti.max(x[None] - 0.3, 0.0) + x[None]

    @ti.kernel
    def beside():
        loss[None] += ti.abs(x[None] - 0.3 * (1 + 2e-7)) + 2.0 * x[None]

    @ti.kernel
    def jump():
        z = x[None]
        if z > 0.3:
            z += 1
        loss[None] += z

    @ti.kernel
    def zero():
        loss[None] += x[None] - 0.3

    @ti.kernel
    def random():
        loss[None] += x[None] * ti.random(ti.f64)

    @ti.kernel
    def flat():
        loss[None] += 0 * x[None] + 1.0

    @ti.kernel
    def square():
        loss[None] += x[None] ** 2

    @ti.kernel
    def infinite():
        loss[None] += x[None] / (x[None] - 0.3)

    @ti.kernel
    def write(a: ti.types.ndarray()):
        for i in range(4):
            a[i] = x[None]
        loss[None] += x[None] ** 2

    @ti.kernel
    def sparse():
        for i in s:
            loss[None] += s[i] * x[None]

    @ti.kernel
    def both():
        loss[None] += x[None] ** 2 + there[None]

    def host():
        there[None] = 1e-3 * np.sin(x[None])
        both()

    programs = {
        "chaos": chaos, "kink": kink, "side": side, "beside": beside, "jump": jump, "zero": zero,
        "random": random, "flat": flat,
        "host": host, "reach": square, "infinite": infinite, "array": lambda: write(array),
        "sparse": sparse,
    }  # fmt: skip
    x[None] = 0.3
    s[3] = 1.5
    error = 1e-17 if name == "reach" else 1e-3
    for _ in range(2):  # the reason must not depend on a warning that is said once
        with pytest.raises(TaiAutodiffError, match=REFUSED[name]) as caught:
            ti.solve_to(programs[name], loss=loss, wrt=[x], error=error)
        assert caught.value.filename == __file__
        assert caught.value.hint
    # The program is as it was.
    assert x[None] == 0.3
    assert x.dtype is ti.f64
    with ti.ad.Tape(loss):
        square()
    assert x.grad[None] == pytest.approx(0.6)


def test_bad_arguments():
    ti.init(offline_cache=False)
    run, loss, wrt, _, _ = sines(8)
    for error in (0, 1, -1e-3, True, "1e-4", None):
        with pytest.raises(ti.TaiRuntimeTypeError, match="between 0 and 1"):
            ti.solve_to(run, loss=loss, wrt=wrt, error=error)
    with pytest.raises(ti.TaiRuntimeTypeError, match="must be a function"):
        ti.solve_to(None, loss=loss, wrt=wrt)
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes an argument 'n'"):
        ti.solve_to(lambda n: run(), loss=loss, wrt=wrt)
    with pytest.raises(ti.TaiRuntimeTypeError, match="'steps' of run needs a default"):
        ti.solve_to(lambda steps: run(), loss=loss, wrt=wrt)
    with ti.ad.Tape(loss), pytest.raises(ti.TaiRuntimeError, match="tapes of its own"):
        ti.solve_to(run, loss=loss, wrt=wrt)


def test_an_error_inside_leaves_the_types():
    ti.init(offline_cache=False)
    run, loss, (x,), _, _ = sines(8)
    calls = []

    def fails():
        calls.append(x.dtype)
        if len(calls) == 2:
            raise KeyError("from the program")
        run()

    with pytest.raises(KeyError, match="from the program"):
        ti.solve_to(fails, loss=loss, wrt=[x])
    assert calls == [ti.f32, ti.f64]
    assert x.dtype is ti.f32
    assert x.grad.dtype is ti.f32
    with ti.ad.Tape(loss):
        run()
    assert np.all(np.isfinite(x.grad.to_numpy()))
