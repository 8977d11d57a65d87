"""`ti.ad.Tape(wrt=…)`: the gradients that are asked for have the bits of a tape that computes all,
and launches that lead to none of them do not run in reverse."""

import random

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError

N = 24


def skipped():
    return ti.profiler.skips()["unwanted-gradients"]["launches_skipped"]


class Scene:
    """Parameters p and q, a state with slots, a scratch field, and kernels between them."""

    def __init__(self, sparse=False, **options):
        ti.init(default_fp=ti.f64, deterministic=True, **options)
        p, q = (ti.field(ti.f64, shape=N, needs_grad=True) for _ in range(2))
        x, scratch = ti.field(ti.f64), ti.field(ti.f64)
        if sparse:
            ti.root.pointer(ti.i, 4).dense(ti.j, N).place(x, x.grad)
            ti.root.pointer(ti.i, N // 4).dense(ti.i, 4).place(scratch, scratch.grad)
        else:
            ti.root.dense(ti.ij, (4, N)).place(x)
            ti.root.dense(ti.i, N).place(scratch)
            ti.root.lazy_grad()
        loss = ti.field(ti.f64, shape=(), needs_grad=True)
        where = ti.field(ti.i32, shape=N)
        self.p, self.q, self.x, self.scratch, self.loss = p, q, x, scratch, loss
        self.where = where

        @ti.kernel
        def push(t: ti.i32):
            for i in range(N):
                x[t, i] += p[i] * p[(i + 1) % N]

        @ti.kernel
        def pull(t: ti.i32):
            for i in range(N):
                x[t, i] = q[i] * 0.5

        @ti.kernel
        def move(t: ti.i32, s: ti.i32):
            for i in range(N):
                x[t, i] = 0.9 * ti.sin(x[s, i]) + 0.1 * x[s, (i + 1) % N]

        @ti.kernel
        def note(t: ti.i32):
            for i in range(N):
                scratch[i] = x[t, i] * x[t, i]

        @ti.kernel
        def apply(t: ti.i32):
            for i in range(N):
                x[t, where[i]] += 0.3 * scratch[i]

        @ti.kernel
        def set_some(t: ti.i32, m: ti.i32):
            for i in range(m):
                x[t, i] = 0.25

        @ti.kernel
        def measure(t: ti.i32):
            for i in range(N):
                loss[None] += x[t, i] * x[t, i] * q[i]

        self.push, self.pull, self.move, self.note = push, pull, move, note
        self.apply, self.set_some, self.measure = apply, set_some, measure

    def reset(self):
        rng = np.random.default_rng(3)
        for field in (self.p, self.q, self.x, self.scratch):
            field.from_numpy(rng.uniform(0.2, 1, field.shape))
        self.where.from_numpy(rng.integers(0, N, N).astype(np.int32))

    def launch(self, sequence):
        slot = lambda: sequence.randrange(4)  # noqa: E731
        kernels = [
            lambda: self.push(slot()), lambda: self.pull(slot()),
            lambda: self.move(slot(), slot()), lambda: self.note(slot()),
            lambda: self.apply(slot()), lambda: self.set_some(slot(), sequence.randrange(N + 1)),
            lambda: self.x.__setitem__((slot(), 1), 0.125),
        ]  # fmt: skip
        some = sequence.choices(kernels, k=4)
        for _ in range(16):
            sequence.choice(some)()
        self.measure(slot())

    def run(self, number, wrt=None, **options):
        sequence = random.Random(number)
        self.reset()
        with ti.ad.Tape(self.loss, wrt=wrt, **options):
            self.launch(sequence)
        return {name: getattr(self, name).grad.to_numpy() for name in ("p", "q", "x", "scratch")}


OPTIONS = [{}, {"sparse": True}, {"cpu_max_num_threads": 2}]


@pytest.mark.filterwarnings("ignore::tai.errors.TaiGradientWarning")
@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("tape", [{}, {"checkpoint": 3}])
def test_wanted_gradients_have_the_same_bits(options, tape):
    found = {}
    for skip in ("all", "all,-unwanted-gradients"):
        scene = Scene(skip=skip, **options)
        everything = [scene.run(number, **tape) for number in range(20)]
        ti.profiler.clear_skips()
        for number, full in enumerate(everything):
            for names in ("p", "q", "x", "xp"):
                got = scene.run(number, [getattr(scene, name) for name in names], **tape)
                for name, gradient in got.items():
                    wanted = full[name] if name in names else np.zeros_like(full[name])
                    assert gradient.tobytes() == wanted.tobytes(), (number, names, name)
        found[skip] = skipped()
    assert found["all"] > 0
    assert found["all,-unwanted-gradients"] == 0


@pytest.mark.filterwarnings("ignore::tai.errors.TaiGradientWarning")
def test_a_device_finds_the_same_bits(monkeypatch):
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    scene = Scene(arch=ti.cuda)
    for number in range(6):
        full = scene.run(number)
        got = scene.run(number, scene.p)
        assert got["p"].tobytes() == full["p"].tobytes()
        assert not got["q"].any() and not got["x"].any()


def test_what_comes_before_the_parameter_is_skipped():
    scene = Scene()
    scene.reset()
    with ti.ad.Tape(scene.loss, wrt=[scene.p]) as tape:
        for t in range(3):
            scene.move(t + 1, t)
        scene.push(3)
        scene.measure(3)
    # No adjoint reaches the others then.
    assert skipped() == 1
    assert ti.profiler.skips()["dead-launches"]["skipped"] == 2
    assert scene.p.grad.to_numpy().all()
    assert not scene.x.grad.to_numpy().any()
    lines = tape.explain().splitlines()
    assert "leads to no gradient that is asked for" in lines[2]
    assert all(": skipped: no adjoint reaches" in line for line in lines[:2])
    scene.p.grad.fill(0)
    tape.grad()
    assert scene.p.grad.to_numpy().all() and not scene.q.grad.to_numpy().any()
    tape.replay()
    assert scene.p.grad.to_numpy().all() and not scene.x.grad.to_numpy().any()


@pytest.mark.filterwarnings("ignore::tai.errors.TaiGradientWarning")
def test_launches_that_overwrite_still_end_gradients():
    scene = Scene()
    scene.reset()
    with ti.ad.Tape(scene.loss, wrt=scene.p):
        scene.push(1)
        scene.pull(1)
        scene.measure(1)
    assert not scene.p.grad.to_numpy().any()


def test_gradients_of_unused_fields_stay():
    scene = Scene()
    other = ti.field(ti.f64, shape=3, needs_grad=True)
    scene.reset()
    other.grad.fill(2.0)
    with ti.ad.Tape(scene.loss, wrt=scene.p, clear_gradients=False):
        scene.push(1)
        scene.measure(1)
    assert np.all(other.grad.to_numpy() == 2.0)
    assert scene.loss.grad[None] == 1.0


def test_members_of_structs_and_vectors_are_wanted_each():
    ti.init(default_fp=ti.f64)
    body = ti.types.struct(v=ti.math.vec3, mass=ti.f64, kind=ti.i32)
    bodies = body.field(shape=4, needs_grad=True, layout=ti.Layout.SOA)
    w = ti.Vector.field(2, ti.f64, shape=4, needs_grad=True, layout=ti.Layout.SOA)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def measure():
        for i in bodies:
            loss[None] += bodies[i].v.norm_sqr() * bodies[i].mass * w[i].sum()

    bodies.v.fill(1.0)
    bodies.mass.fill(2.0)
    w.fill(1.0)
    with ti.ad.Tape(loss, wrt=bodies):
        measure()
    assert np.all(bodies.mass.grad.to_numpy() == 6.0) and bodies.v.grad.to_numpy().all()
    assert not w.grad.to_numpy().any()
    with ti.ad.Tape(loss, wrt=[w]):
        measure()
    assert np.all(w.grad.to_numpy() == 6.0)
    assert not bodies.mass.grad.to_numpy().any()


def test_gradients_of_arrays_are_always_computed():
    ti.init(default_fp=ti.f64)
    a = ti.ndarray(ti.f64, shape=5, needs_grad=True)
    p = ti.field(ti.f64, shape=5, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def scale(a: ti.types.ndarray(ti.f64, 1)):
        for i in p:
            p[i] = 3.0 * a[i]

    @ti.kernel
    def measure():
        for i in p:
            loss[None] += p[i]

    with ti.ad.Tape(loss, wrt=[loss]):
        scale(a)
        measure()
    assert np.all(a.grad.to_numpy() == 3.0)


def test_wrong_wishes_are_errors():
    ti.init()
    x = ti.field(ti.f32, shape=3, needs_grad=True)
    n = ti.field(ti.i32, shape=3)
    plain = ti.field(ti.f32, shape=3)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    with pytest.raises(TaiRuntimeTypeError, match="wrt takes fields, but got 3"):
        ti.ad.Tape(loss, wrt=[x, 3])
    with pytest.raises(TaiRuntimeTypeError, match="wrt names no field"):
        ti.ad.Tape(loss, wrt=[])
    with pytest.raises(TaiAutodiffError, match="of type i32, not a float"):
        ti.ad.Tape(loss, wrt=n)
    with pytest.raises((TaiAutodiffError, TaiRuntimeError), match="grad"):
        with ti.ad.Tape(loss, wrt=plain):
            pass


def test_a_loss_that_depends_on_nothing_wanted_warns():
    scene = Scene()
    scene.reset()
    with pytest.warns(ti.errors.TaiGradientWarning, match="whose gradient is asked for"):
        with ti.ad.Tape(scene.loss, wrt=scene.p):
            scene.measure(0)


def test_a_gradient_has_no_gradient():
    """Of a gradient and of a dual there is none, and each function says so by the field's name."""
    ti.init()
    x = ti.field(ti.f32, shape=3, needs_grad=True, needs_dual=True, name="x")
    s = ti.Struct.field({"a": ti.f32}, shape=3, needs_grad=True, needs_dual=True, name="s")
    loss = ti.field(ti.f32, shape=(), needs_grad=True, needs_dual=True, name="loss")

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] * x[i]

    def record(*args, **options):
        with ti.ad.Tape(*args, **options):
            measure()

    ones = np.ones(3)
    for refused in (
        lambda: record(loss, wrt=[x.grad]),
        lambda: record(x.grad),
        lambda: ti.ad.vjp(measure, x.grad, loss, 1.0),
        lambda: ti.ad.hvp(measure, loss, x.grad, ones),
        lambda: ti.ad.check(measure, loss=loss, wrt=[x.grad]),
        lambda: ti.optim.SGD([x.grad]),
    ):
        with pytest.raises(TaiAutodiffError, match="'x.grad' is a gradient, which has no gradient"):
            refused()
    with pytest.raises(TaiAutodiffError, match="'x.dual' is a dual, which has no gradient"):
        record(loss, wrt=x.dual)
    with pytest.raises(TaiRuntimeTypeError, match="'s' is a field of structs"):
        ti.ad.check(measure, loss=s, wrt=[x])


@pytest.mark.parametrize("budget", ["1KB", 1.5, float("nan"), float("inf"), True, b"8"], ids=str)
def test_a_budget_that_is_no_number_of_bytes(budget):
    ti.init()
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    with pytest.raises(TaiRuntimeTypeError, match="memory_budget is a number of bytes, but got"):
        ti.ad.Tape(loss, memory_budget=budget)
