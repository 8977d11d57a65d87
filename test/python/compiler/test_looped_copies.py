"""A copy of a shared element that serial loops change before it is stored: a total is an update."""

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
        self.counts = random.integers(0, 5, size).astype(np.int32)
        self.p = random.integers(-3, 4, size).astype(np.float64)
        self.c, self.n = (ti.field(ti.i32, size) for _ in range(2))
        self.a = ti.field(ti.f64, size, needs_grad=True)
        self.s = ti.field(ti.f64, GROUPS, needs_grad=True)
        self.v = ti.Vector.field(3, ti.f64, GROUPS, needs_grad=True)
        self.loss = ti.field(ti.f64, (), needs_grad=True)
        for field, values in ((self.c, self.groups), (self.n, self.counts), (self.a, self.p)):
            field.from_numpy(values)


def counted(scene):
    s, c, n, a = scene.s, scene.c, scene.n, scene.a

    @ti.kernel
    def run():
        for i in a:
            e = s[c[i]]
            for k in range(n[i]):
                e += a[i] * (k + 1)
            s[c[i]] = e

    return run, s, lambda n, p: p * (n * (n + 1) / 2), lambda n, p: n * (n + 1) / 2


def constant(scene):
    """Few trips, which may be unrolled, with steps around them."""
    s, c, a = scene.s, scene.c, scene.a

    @ti.kernel
    def run():
        for i in a:
            e = s[c[i]] + a[i]
            for _ in range(3):
                e -= 2.0 * a[i]
            e = e + 4.0
            s[c[i]] = e

    return run, s, lambda n, p: 4 - 5 * p, lambda n, p: -5.0 + 0 * n


def branched(scene):
    """A branch in a loop in a branch."""
    s, c, n, a = scene.s, scene.c, scene.n, scene.a

    @ti.kernel
    def run():
        for i in a:
            e = s[c[i]]
            if a[i] > -1:
                for k in range(n[i]):
                    if k > 1:
                        e += a[i]
                    else:
                        e -= 1.0
            else:
                e += 2.0
            s[c[i]] = e

    def value(n, p):
        few = np.minimum(n, 2)
        return np.where(p > -1, (n - few) * p - few, 2.0)

    return run, s, value, lambda n, p: np.where(p > -1, np.maximum(n - 2, 0), 0)


def nested(scene):
    s, c, n, a = scene.s, scene.c, scene.n, scene.a

    @ti.kernel
    def run():
        for i in a:
            e = s[c[i]]
            for k in range(n[i]):
                e += 1.0
                for j in range(k):
                    e = e + a[i] * j
                e -= a[i]
            s[c[i]] = e

    def inner(n):
        return n * (n - 1) * (n - 2) / 6  # The sum of k (k - 1) / 2.

    return run, s, lambda n, p: n + p * (inner(n) - n), lambda n, p: inner(n) - n


def chosen(scene):
    """A choice behind the loop."""
    s, c, n, a = scene.s, scene.c, scene.n, scene.a

    @ti.kernel
    def run():
        for i in a:
            e = s[c[i]]
            t = e
            for _ in range(n[i]):
                t += a[i]
            s[c[i]] = ti.select(a[i] > 0, t, e)

    return run, s, lambda n, p: n * p * (p > 0), lambda n, p: n * (p > 0)


def component(scene):
    v, c, n, a = scene.v, scene.c, scene.n, scene.a

    @ti.kernel
    def run():
        for i in a:
            o = v[c[i]]
            for k in range(n[i]):
                o[1] += a[i]
                if k == 2:
                    o[2] -= a[i]
            v[c[i]] = o

    def value(n, p):
        return np.stack([0 * p, n * p, -p * (n > 2)], 1)

    return run, v, value, lambda n, p: n - 1.0 * (n > 2)


def whole(scene):
    v, c, n, a = scene.v, scene.c, scene.n, scene.a

    @ti.kernel
    def run():
        for i in a:
            o = v[c[i]]
            for _ in range(n[i]):
                o += ti.Vector([1.0, a[i], 2.0])
            v[c[i]] = o

    return run, v, lambda n, p: np.stack([n, n * p, 2 * n], 1), lambda n, p: 1.0 * n


FORMS = [counted, constant, branched, nested, chosen, component, whole]


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
    np.add.at(expected, scene.groups, value(scene.counts, scene.p))
    for _ in range(3):
        target.fill(0.0)
        run()
        np.testing.assert_array_equal(target.to_numpy(), expected)
    target.fill(0.0)
    with ti.ad.Tape(loss):
        run()
        total()
    assert loss[None] == expected.sum()
    np.testing.assert_array_equal(scene.a.grad.to_numpy(), slope(scene.counts, scene.p))


@pytest.mark.parametrize("dtype", ["i32", "i64", "f32", "f64"])
@pytest.mark.parametrize("options", OPTIONS)
def test_other_kinds(options, dtype):
    """Minima, maxima, products and bits; without a trip, the element stays as it was."""
    ti.init(offline_cache=False, **OPTIONS[options])
    size = 65_537
    random = np.random.default_rng(3)
    groups = random.integers(0, GROUPS, size).astype(np.int32)
    counts = random.integers(0, 4, size).astype(np.int32)
    values = random.integers(-1000, 1000, size)
    element = getattr(ti, dtype)
    c, n, a = ti.field(ti.i32, size), ti.field(ti.i32, size), ti.field(element, size)
    low, high, product, bits = (
        ti.field(element, GROUPS + 1),
        ti.field(element, GROUPS + 1),
        ti.field(element, GROUPS + 1),
        ti.field(ti.i32, GROUPS + 1),
    )
    for field, array in ((c, groups), (n, counts), (a, values)):
        field.from_numpy(array.astype(field.to_numpy().dtype))

    @ti.kernel
    def run():
        for i in a:
            e = low[c[i]]
            for k in range(n[i]):
                e = ti.min(e, a[i] - k)
            low[c[i]] = e
        for i in a:
            e = high[c[i]]
            for k in range(n[i]):
                if a[i] + k > e:
                    e = a[i] + k
            high[c[i]] = e
        for i in a:
            e = product[c[i]]
            for _ in range(n[i]):
                e *= -1
            product[c[i]] = e
        for i in a:
            e = bits[c[i]]
            for k in range(n[i]):
                e ^= i + k
            bits[c[i]] = e

    for field, start in ((low, 5), (high, -5), (product, 3), (bits, 9)):
        field.fill(start)
    run()
    expected = {low: [5] * 4, high: [-5] * 4, product: [3] * 4, bits: [9] * 4}
    for i, (group, trips, number) in enumerate(zip(groups, counts, values, strict=True)):
        for k in range(trips):
            expected[low][group] = min(expected[low][group], number - k)
            expected[high][group] = max(expected[high][group], number + k)
            expected[product][group] *= -1
            expected[bits][group] ^= i + k
    for field, right in expected.items():
        np.testing.assert_array_equal(field.to_numpy(), right)


def forgotten(scene):
    """Each trip begins with the element again: the last one counts."""
    s, c, n, a = scene.s, scene.c, scene.n, scene.a

    @ti.kernel
    def run():
        for i in a:
            start = s[c[i]]
            e = start
            for k in range(n[i]):
                e = start + a[i] * (k + 1)
            s[c[i]] = e

    return run, lambda n, p: n * p


def shown(scene):
    """The values between are stored elsewhere."""
    s, c, n, a = scene.s, scene.c, scene.n, scene.a
    seen = ti.field(ti.f64, 4)

    @ti.kernel
    def run():
        for i in a:
            e = s[c[i]]
            for k in range(n[i]):
                e += a[i]
                seen[k] = e
            s[c[i]] = e

    return run, lambda n, p: n * p


@pytest.mark.parametrize("form", [forgotten, shown], ids=lambda form: form.__name__)
def test_loops_that_are_no_sum(form):
    """In order on one thread, and found by the checks on several."""
    ti.init(default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=1)
    scene = Scene(1000)
    run, value = form(scene)
    run()
    expected = np.zeros(GROUPS)
    np.add.at(expected, scene.groups, value(scene.counts, scene.p))
    np.testing.assert_array_equal(scene.s.to_numpy(), expected)

    ti.init(default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=2, debug=True)
    run, _ = form(Scene(1000))
    with pytest.raises(ti.TaiRuntimeError, match="two iterations of a parallel loop"):
        run()
