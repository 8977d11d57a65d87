"""A copy of a shared element that branches change before it is stored: each step is an update."""

import numpy as np
import pytest
import tai as ti

GROUPS = 3
OPTIONS = {
    "one thread": {"cpu_max_num_threads": 1},
    "two threads": {"cpu_max_num_threads": 2},
    "deterministic": {"cpu_max_num_threads": 2, "deterministic": True},
    "strict": {"cpu_max_num_threads": 2, "math": "strict"},
}


class Scene:
    """Whole numbers, whose sums are exact in any order."""

    def __init__(self, size):
        random = np.random.default_rng(size)
        self.groups = random.integers(0, GROUPS, size).astype(np.int32)
        self.p, self.q = (random.integers(-3, 4, size).astype(np.float64) for _ in range(2))
        self.c = ti.field(ti.i32, size)
        self.a, self.b = (ti.field(ti.f64, size, needs_grad=True) for _ in range(2))
        self.s = ti.field(ti.f64, GROUPS, needs_grad=True)
        self.v = ti.Vector.field(3, ti.f64, GROUPS, needs_grad=True)
        self.loss = ti.field(ti.f64, (), needs_grad=True)
        for field, values in ((self.c, self.groups), (self.a, self.p), (self.b, self.q)):
            field.from_numpy(values)


def after(scene):
    """Steps behind a branch, and in front of one."""
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            e = s[c[i]]
            if p[i] > 0:
                e = e + 1.0
            e += q[i]
            s[c[i]] = e

    return run, s, lambda p, q: (p > 0) + q, lambda p, q: 1.0


def before(scene):
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            e = s[c[i]] + q[i]
            if p[i] > 0:
                e = e + 3.0 * q[i]
            s[c[i]] = e

    return run, s, lambda p, q: q + 3 * q * (p > 0), lambda p, q: 1.0 + 3 * (p > 0)


def chain(scene):
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            e = s[c[i]]
            if p[i] > 0:
                e += q[i]
            e -= 1.0
            if q[i] > 0:
                if p[i] > 1:
                    e += p[i] * q[i]
                else:
                    e -= 2.0
            elif p[i] > 2:
                e += 5.0
            s[c[i]] = e

    def value(p, q):
        inner = np.where(p > 1, p * q, -2.0)
        return np.where(p > 0, q, 0) - 1 + np.where(q > 0, inner, np.where(p > 2, 5.0, 0))

    return run, s, value, lambda p, q: (p > 0) + np.where((q > 0) & (p > 1), p, 0)


def selected(scene):
    """A branch with a choice in it, which begins at the update in front of the branch."""
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            e = s[c[i]] + q[i]
            if p[i] > 0:
                e = ti.select(q[i] > 0, e + q[i], e - 1.0)
            s[c[i]] = e

    def value(p, q):
        return q + np.where(p > 0, np.where(q > 0, q, -1.0), 0)

    return run, s, value, lambda p, q: 1.0 + ((p > 0) & (q > 0))


def chosen(scene):
    """A choice behind a branch, of which one side has a step more."""
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            e = s[c[i]]
            a = e
            t = 2.0 * q[i]
            if p[i] > 0:
                a = e + t
            s[c[i]] = ti.select(p[i] > 1, a, a + 1.0)

    return run, s, lambda p, q: 2 * q * (p > 0) + (p <= 1), lambda p, q: 2.0 * (p > 0)


def taken_back(scene):
    """A choice between the element and the number that a branch yields."""
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            e = s[c[i]]
            a = e
            t = q[i]
            if p[i] > 0:
                a = e + t
            s[c[i]] = ti.select(q[i] > 0, a, e)

    return run, s, lambda p, q: q * ((p > 0) & (q > 0)), lambda p, q: 1.0 * ((p > 0) & (q > 0))


def component(scene):
    v, c, p, q = scene.v, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            o = v[c[i]]
            if p[i] > 0:
                o[1] += q[i]
            v[c[i]] = o

    def value(p, q):
        return np.stack([0 * q, np.where(p > 0, q, 0), 0 * q], 1)

    return run, v, value, lambda p, q: 1.0 * (p > 0)


def components(scene):
    """Several, in branches of branches, and one in front of them."""
    v, c, p, q = scene.v, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            o = v[c[i]]
            o[2] += 1.0
            if p[i] > 0:
                if q[i] > 0:
                    o[0] += q[i]
                else:
                    o[1] += 2.0 * q[i]
            else:
                o[2] -= q[i]
            if q[i] > 1:
                o[1] += p[i]
            v[c[i]] = o

    def value(p, q):
        yes, more = p > 0, q > 0
        first = np.where(yes & more, q, 0)
        second = np.where(yes & ~more, 2 * q, 0) + np.where(q > 1, p, 0)
        return np.stack([first, second, 1 - np.where(yes, 0, q)], 1)

    def slope(p, q):
        return np.where(p > 0, np.where(q > 0, 1.0, 2.0), -1.0)

    return run, v, value, slope


def whole(scene):
    """All components at once."""
    v, c, p, q = scene.v, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            o = v[c[i]]
            if p[i] > 0:
                o += ti.Vector([1.0, q[i], 2.0])
            v[c[i]] = o

    def value(p, q):
        return (p > 0)[:, None] * np.stack([np.ones_like(q), q, np.full_like(q, 2)], 1)

    return run, v, value, lambda p, q: 1.0 * (p > 0)


FORMS = [after, before, chain, selected, chosen, taken_back, component, components, whole]


@pytest.mark.parametrize("size", [1, 7, 65_537])
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
@pytest.mark.parametrize("options", OPTIONS)
def test_values_and_gradients(form, options, size):
    ti.init(default_fp=ti.f64, offline_cache=False, **OPTIONS[options])
    scene = Scene(size)
    run, target, value, slope = form(scene)
    loss = scene.loss

    @ti.kernel
    def total():
        for k in range(GROUPS):
            if ti.static(target is scene.v):
                loss[None] += scene.v[k].sum()
            else:
                loss[None] += scene.s[k]

    expected = np.zeros(target.to_numpy().shape)
    np.add.at(expected, scene.groups, value(scene.p, scene.q))
    for _ in range(3):
        target.fill(0.0)
        run()
        np.testing.assert_array_equal(target.to_numpy(), expected)
    target.fill(0.0)
    with ti.ad.Tape(loss):
        run()
        total()
    assert loss[None] == expected.sum()
    slopes = np.broadcast_to(slope(scene.p, scene.q), (size,))
    np.testing.assert_array_equal(scene.b.grad.to_numpy(), slopes)


def test_a_branch_that_takes_an_update_back():
    """Only one side has the update: no sum, and found where it is asked for."""
    ti.init(default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=2, debug=True)
    scene = Scene(100)
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            old = s[c[i]]
            new = old + q[i]
            e = old
            if p[i] > 0:
                e = new + 1.0
            s[c[i]] = e

    with pytest.raises(ti.TaiRuntimeError, match="two iterations of a parallel loop"):
        run()


def test_on_one_thread_it_is_in_order():
    ti.init(default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=1)
    scene = Scene(1000)
    s, c, p, q = scene.s, scene.c, scene.a, scene.b

    @ti.kernel
    def run():
        for i in p:
            old = s[c[i]]
            new = old + q[i]
            e = old
            if p[i] > 0:
                e = new + 1.0
            s[c[i]] = e

    run()
    expected = np.zeros(GROUPS)
    np.add.at(expected, scene.groups, np.where(scene.p > 0, scene.q + 1, 0))
    np.testing.assert_array_equal(s.to_numpy(), expected)
