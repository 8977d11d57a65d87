"""Forward mode through numbers that kernels return and take, against closed forms."""

import math

import numpy as np
import pytest
import tai as ti

FLAGS = {"needs_grad": True, "needs_dual": True}


@pytest.fixture(autouse=True)
def start():
    ti.init(default_fp=ti.f64, offline_cache=False)


def number(value=0.0, dtype=ti.f64):
    made = ti.field(dtype, shape=(), **FLAGS)
    made[None] = value
    return made


@ti.kernel
def square(x: ti.template()) -> ti.f64:
    return x[None] ** 2


@ti.kernel
def add(loss: ti.template(), x: ti.template(), r: ti.f64):
    loss[None] += 2 * r * x[None]


def second_difference(run, x, loss, h=1e-3):
    start, values = x[None], []
    for t in (start - h, start, start + h):
        x[None], loss[None] = t, 0
        run()
        values.append(loss[None])
    x[None], loss[None] = start, 0
    return (values[0] - 2 * values[1] + values[2]) / h**2


def test_one_number_in_all_modes():
    """2 x³ at 2."""
    x, loss = number(2), number()

    def run():
        add(loss, x, square(x))

    for _ in range(2):
        with ti.ad.FwdMode(loss, x):
            run()
        assert loss.dual[None] == 24
        with ti.ad.Tape(loss):
            run()
        assert x.grad[None] == 24
    assert ti.ad.check(run, loss=loss)
    assert ti.ad.jvp(run, x, 3.0, loss) == 72
    assert ti.ad.hvp(run, loss, x, np.array(1.0)) == 24
    assert type(square(x)) is float


def test_arithmetic_of_python():
    x, loss = number(1.3), number()

    @ti.kernel
    def measure(a: ti.f64):
        loss[None] += ti.sin(a)

    cases = [
        (lambda r: 3 * r - r / 2 + 1, 2.5), (lambda r: r / (r + 1), None),
        (lambda r: r**2 + 2**r + r**0.5, None), (lambda r: -r + abs(-r) + (+r), None),
        (lambda r: 5 - r % 1.5, -1.0), (lambda r: 7 % r + 1 / r, None),
    ]  # fmt: skip
    for compute, slope in cases:

        def run(compute=compute):
            measure(compute(square(x)))

        s, h = 1.3**2, 1e-6
        if slope is None:
            slope = (compute(s + h) - compute(s - h)) / (2 * h)
        expected = math.cos(compute(s)) * slope * 2 * 1.3
        loss[None] = 0
        with ti.ad.FwdMode(loss, x):
            run()
        assert math.isclose(loss[None], math.sin(compute(s)), rel_tol=1e-13)
        assert math.isclose(loss.dual[None], expected, rel_tol=1e-7)
        assert ti.ad.check(run, loss=loss)
        curvature = second_difference(run, x, loss)
        assert math.isclose(ti.ad.hvp(run, loss, x, np.array(1.0)), curvature, rel_tol=1e-4)


def test_vectors_matrices_and_components():
    n = 3
    x, loss = ti.field(ti.f64, shape=n, **FLAGS), number()
    x.from_numpy(np.array([0.3, -1.2, 2.0]))

    @ti.kernel
    def sums(k: ti.f64) -> ti.types.vector(2, ti.f64):
        a, b = 0.0, 0.0
        for i in x:
            a += x[i] ** 3
            b += ti.sin(x[i]) * k
        return ti.Vector([a, b])

    @ti.kernel
    def outer(v: ti.types.vector(2, ti.f64), s: ti.f64) -> ti.types.matrix(2, 2, ti.f64):
        return v.outer_product(v) * s

    @ti.kernel
    def measure(m: ti.types.matrix(2, 2, ti.f64), v: ti.types.vector(2, ti.f64), k: ti.f64):
        loss[None] += (m @ v).norm_sqr() * k

    def run():
        v = sums(0.5)
        w = sums(v[0] * v.y)
        m = outer(v, w.x - 1)
        measure(m, w, m[0, 1])

    assert ti.ad.check(run, loss=loss)
    v, seed = np.array([1.0, -2.0, 0.5]), np.zeros(n)
    product = ti.ad.hvp(run, loss, x, v)
    h, gradients = 1e-5, []
    start = x.to_numpy()
    for t in (-h, h):
        x.from_numpy(start + t * v)
        with ti.ad.Tape(loss):
            run()
        gradients.append(x.grad.to_numpy())
    np.testing.assert_allclose(product, (gradients[1] - gradients[0]) / (2 * h), rtol=1e-6)
    x.from_numpy(start)
    for i in range(n):
        seed[:] = 0
        seed[i] = 1
        with ti.ad.FwdMode(loss, x, seed=seed):
            run()
        with ti.ad.Tape(loss):
            run()
        assert math.isclose(loss.dual[None], x.grad[i], rel_tol=1e-12)


def test_several_parameters():
    x, y, loss = number(2), number(3), number()

    @ti.kernel
    def product() -> ti.f64:
        return x[None] * y[None] ** 2

    def run():
        r = product()
        add(loss, x, r + y[None])

    # 2 (x y² + c) x, where c is the value that the host read
    assert ti.ad.jvp(run, [x, y], [1.0, 0.0], loss) == 2 * (2 * 2 * 9 + 3)
    assert ti.ad.jvp(run, [x, y], [0.0, 1.0], loss) == 2 * 4 * 2 * 3
    loss[None] = 0
    second = ti.ad.hvp(run, loss, [x, y], [1.0, -2.0])
    assert np.allclose(second, [4 * 9 - 2 * 8 * 6, 8 * 6 - 2 * 4 * 4])


def test_other_types_and_early_returns():
    x, loss = number(2, ti.f32), number(0, ti.f32)

    @ti.kernel
    def power(k: ti.i32) -> ti.f32:
        p = 1.0
        ti.loop_config(serialize=True)
        for i in range(100):
            if i == k:
                return p
            p *= x[None]
        return 0.0

    @ti.kernel
    def count() -> ti.i32:
        return ti.cast(x[None], ti.i32)

    @ti.kernel
    def take(r: ti.f32, n: ti.i32):
        loss[None] += r * n

    def run():
        take(power(3), count())

    with ti.ad.FwdMode(loss, x):
        run()
    assert loss.dual[None] == 3 * 4 * 2
    assert loss[None] == 16


def test_many_returned_numbers():
    """Places are used again, but not while a tape needs them."""
    x, loss = number(1.0), number()

    @ti.kernel
    def step(r: ti.f64) -> ti.f64:
        return r + x[None] / 5000

    @ti.kernel
    def measure(r: ti.f64):
        loss[None] += r

    def run(count):
        r = 0.0
        for _ in range(count):
            r = step(r)
        measure(r)

    with ti.ad.FwdMode(loss, x):
        run(10_000)
    assert math.isclose(loss.dual[None], 2, rel_tol=1e-12)
    with pytest.raises(ti.TaiRuntimeError, match="follows at most") as caught:
        ti.ad.hvp(lambda: run(10_000), loss, x, np.array(1.0))
    assert "in a field" in caught.value.hint
    with ti.ad.FwdMode(loss, x):
        run(1000)
    assert math.isclose(loss.dual[None], 0.2, rel_tol=1e-12)


def test_a_serial_chain_of_returned_numbers():
    x, loss = number(0.4), number()

    @ti.kernel
    def logistic(r: ti.f64) -> ti.f64:
        return 3.7 * r * (1 - r) + 0.1 * x[None]

    def run():
        r = square(x)
        for _ in range(6):
            r = logistic(r)
        add(loss, x, r)

    assert ti.ad.check(run, loss=loss)
    curvature = second_difference(run, x, loss, 1e-4)
    assert math.isclose(ti.ad.hvp(run, loss, x, np.array(1.0)), curvature, rel_tol=1e-3)


def test_what_is_refused():
    x, loss = number(2), number()

    @ti.kernel
    def pair() -> ti.types.vector(2, ti.f64):
        return ti.Vector([x[None], 2 * x[None]])

    @ti.kernel
    def template(r: ti.template()):
        loss[None] += r

    with ti.ad.FwdMode(loss, x):
        v, r = pair(), square(x)
        for compute in (lambda: 2 * v, lambda: v.norm()):
            with pytest.raises(ti.TaiAutodiffError, match="not computed with in Python"):
                compute()
        with pytest.raises(ti.TaiAutodiffError, match="'r' of kernel 'template' is a constant"):
            template(r)
        with pytest.raises(ti.TaiAutodiffError, match="of forward mode has no gradient"):
            _ = r.grad
    assert (2 * v).to_list() == [4, 8]
    assert type(2 * r) is float
    ti.init(default_fp=ti.f64, offline_cache=False)
    x, loss = number(2), number()
    with ti.ad.FwdMode(loss, x):
        add(loss, x, r)  # of a program that is gone: a constant
    assert loss.dual[None] == 2 * 4


def test_what_the_host_writes_has_no_tangent():
    """In forward mode as on a tape."""
    x, y = (ti.field(ti.f64, shape=2, **FLAGS) for _ in range(2))
    v, loss = ti.Vector.field(2, ti.f64, shape=2, **FLAGS), number()
    x.fill(1)

    @ti.kernel
    def spread():
        for i in x:
            y[i] = 2 * x[i]
            v[i] = ti.Vector([x[i], 3 * x[i]])

    @ti.kernel
    def measure():
        for i in y:
            loss[None] += y[i] + v[i].sum()

    component = v.get_scalar_field(1)
    for write in (
        lambda: y.fill(0), lambda: y.from_numpy(np.ones(2)), lambda: y.__setitem__(1, 3.0),
        lambda: v.fill(0), lambda: v.from_numpy(np.ones((2, 2))), lambda: v.fill([1.0, 2.0]),
        lambda: v.__setitem__(0, [1, 2]), lambda: v[1].__setitem__(0, 1.0),
        lambda: component.fill(0), lambda: component.from_numpy(np.ones(2)),
        lambda: component.__setitem__(1, 1.0), lambda: loss.fill(1),
    ):  # fmt: skip
        for before, after in ((write, lambda: None), (lambda: None, write)):

            def run(before=before, after=after):
                before()
                spread()
                after()
                measure()

            with ti.ad.Tape(loss) as tape:
                run()
            expected = x.grad.to_numpy().sum()
            assert ti.ad.jvp(run, x, np.ones(2), loss) == expected
            assert ti.ad.jvp(tape, x, np.ones(2), loss) == expected
            loss[None] = 0

    # Before the first launch it is the point at which one differentiates.
    def start():
        x.fill(2)
        v.fill(0)
        spread()
        measure()

    loss[None] = 0
    assert ti.ad.jvp(start, x, np.ones(2), loss) == 12
    assert loss[None] == 2 * (4 + 2 + 6)


def test_a_component_written_on_a_tape_leaves_the_others():
    x, v = ti.field(ti.f64, shape=3, **FLAGS), ti.Vector.field(2, ti.f64, shape=3, **FLAGS)
    one, loss = ti.Vector.field(2, ti.f64, shape=(), **FLAGS), number()

    @ti.kernel
    def spread():
        for i in x:
            v[i] = ti.Vector([x[i], 10 * x[i]])
            one[None] += ti.Vector([x[i], 10 * x[i]])

    @ti.kernel
    def measure():
        for i in v:
            loss[None] += v[i].sum() ** 2
        loss[None] += one[None].sum()

    x.fill(1)
    array = np.array([5.0, 6.0, 7.0])
    component = v.get_scalar_field(1)
    for write in (lambda: component.from_numpy(array), lambda: component.fill(2.5)):
        one.fill(0)
        with ti.ad.Tape(loss) as tape:
            spread()
            write()
            one.get_scalar_field(1).fill(2.5)
            measure()
        values = v.to_numpy()
        assert (values[:, 0] == 1).all() and one[None].to_list() == [3, 2.5]
        assert (x.grad.to_numpy() == 2 * values.sum(1) + 1).all()
        one.fill(0)
        tape.replay()
        assert (v.to_numpy() == values).all()
