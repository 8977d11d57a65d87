"""Derivatives of the updates that become reductions, against central differences in f64.

Each program updates a variable, an element, a component or a member in a parallel loop. Forward
mode and reverse mode must both agree with differences of the same program.
"""

import numpy as np
import pytest
import tai as ti

N = 67
BINS = 5
STEP = 1e-3


class Scene:
    """Inputs `x` and `w`, results `o` at bins that `p` chooses, and a loss of all of it."""

    def __init__(self, size=N, layout="dense", threads=2):
        ti.init(default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=threads)
        make = {"needs_grad": True, "needs_dual": True}
        if layout == "dense":
            self.x, self.w = (ti.field(ti.f64, shape=size, **make) for _ in range(2))
        else:
            pair = ti.types.struct(x=ti.f64, w=ti.f64)
            both = pair.field(shape=size, layout=getattr(ti.Layout, layout.upper()), **make)
            self.x, self.w = both.x, both.w
        self.o = ti.field(ti.f64, shape=BINS, **make)
        self.v = ti.Vector.field(2, ti.f64, shape=BINS, **make)
        self.loss = ti.field(ti.f64, shape=(), **make)
        self.p = ti.field(ti.i32, shape=size)
        r = np.random.default_rng(5)
        self.p.from_numpy(r.integers(0, BINS, size).astype(np.int32))
        # Distinct numbers, so that no minimum is a tie; near 1, so that products stay finite.
        self.start = {
            "x": 0.9 + 0.2 * r.permutation(size) / size + 0.01 * r.random(size) / size,
            "w": 0.8 + 0.4 * r.random(size),
        }

    def reset(self, x, w, first):
        self.x.from_numpy(x)
        self.w.from_numpy(w)
        self.o.fill(first)
        self.v.fill(first)
        self.loss[None] = 0.0


PROGRAMS = {}


def program(first=0.0):
    def add(make):
        PROGRAMS[make.__name__] = (make, first)
        return make

    return add


def finish(s):
    @ti.kernel
    def finish():
        for i in s.o:
            s.loss[None] += (i + 1) * s.o[i] + s.v[i][0] * s.v[i][1]

    return finish


@program()
def sum_of_a_variable(s):
    @ti.kernel
    def run():
        c = 0.0
        for i in s.x:
            c = c + s.x[i] * s.w[i]
        s.o[0] = c * c

    return run


@program()
def conditional_sum_of_a_variable(s):
    @ti.kernel
    def run():
        c = 0.0
        for i in s.x:
            if s.x[i] > 1.0:
                c = c + s.x[i] * s.x[i]
        s.o[1] = c

    return run


@program()
def minimum_of_a_variable(s):
    @ti.kernel
    def run():
        m = 100.0
        for i in s.x:
            m = ti.min(m, s.x[i] * s.w[i])
        s.o[0] = m * m

    return run


@program()
def maximum_by_a_condition(s):
    @ti.kernel
    def run():
        m = -100.0
        for i in s.x:
            v = s.x[i] * s.w[i]
            if v > m:
                m = v
        s.o[2] = m * m

    return run


@program()
def maximum_by_a_selection(s):
    @ti.kernel
    def run():
        m = -100.0
        for i in s.x:
            v = s.x[i] - s.w[i]
            m = v if v > m else m
        s.o[2] = ti.exp(m)

    return run


@program()
def product_of_a_variable(s):
    @ti.kernel
    def run():
        f = 1.0
        for i in s.x:
            f *= s.x[i]
        s.o[0] = f

    return run


@program()
def element(s):
    @ti.kernel
    def run():
        for i in s.x:
            s.o[3] = s.o[3] + s.x[i] * s.w[i]

    return run


@program()
def histogram(s):
    @ti.kernel
    def run():
        for i in s.x:
            b = s.p[i]
            s.o[b] = s.o[b] + s.x[i] * s.w[i]

    return run


@program()
def conditional_histogram(s):
    @ti.kernel
    def run():
        for i in s.x:
            if s.w[i] > 1.0:
                s.o[s.p[i]] = s.o[s.p[i]] - s.x[i] * s.x[i]

    return run


@program(first=1.0)
def products_at_indices_from_data(s):
    @ti.kernel
    def run():
        for i in s.x:
            s.o[s.p[i]] *= s.x[i]

    return run


@program(first=-100.0)
def maxima_at_indices_from_data(s):
    @ti.kernel
    def run():
        for i in s.x:
            s.o[s.p[i]] = ti.max(s.o[s.p[i]], s.x[i] * s.w[i])

    return run


@program(first=100.0)
def minima_at_indices_from_data(s):
    @ti.kernel
    def run():
        for i in s.x:
            ti.atomic_min(s.o[s.p[i]], s.x[i] * s.w[i])

    return run


@program()
def components(s):
    @ti.kernel
    def run():
        for i in s.x:
            s.v[s.p[i]] = s.v[s.p[i]] + ti.Vector([s.x[i], s.w[i] * s.x[i]])

    return run


@program(first=-100.0)
def maxima_of_components(s):
    @ti.kernel
    def run():
        for i in s.x:
            s.v[s.p[i]][0] = ti.max(s.v[s.p[i]][0], s.x[i])
            s.v[s.p[i]][1] = ti.max(s.v[s.p[i]][1], s.x[i] * s.w[i])

    return run


@program()
def members(s):
    pair = ti.types.struct(a=ti.f64, b=ti.f64)

    @ti.kernel
    def run():
        t = pair(0.0, 0.0)
        for i in s.x:
            t.a += s.x[i] * s.w[i]
            t.b -= s.x[i] * s.x[i]
        s.o[0] = t.a * t.b

    return run


def losses(s, kernels, x, w, first):
    s.reset(x, w, first)
    for kernel in kernels:
        kernel()
    return s.loss[None]


def difference(s, kernels, dx, dw, first):
    x, w = s.start["x"], s.start["w"]
    ahead = losses(s, kernels, x + STEP * dx, w + STEP * dw, first)
    behind = losses(s, kernels, x - STEP * dx, w - STEP * dw, first)
    noise = 16 * np.finfo(float).eps * max(abs(ahead), abs(behind)) / STEP
    return pytest.approx((ahead - behind) / (2 * STEP), rel=1e-6, abs=noise)


def directions(size):
    r = np.random.default_rng(11)
    # Small against the distances of the numbers, so that each minimum keeps its place.
    return [0.05 * r.standard_normal(size) / size for _ in range(2)]


CASES = [(name, "dense", 2, N) for name in PROGRAMS]
CASES += [(name, layout, 1, 1) for name, layout in zip(PROGRAMS, ["dense", "aos"] * 8)]
CASES += [(name, layout, 2, 1031) for name, layout in zip(PROGRAMS, ["aos", "soa"] * 8)]


def made(name, layout, threads, size):
    s = Scene(size, layout, threads)
    make, first = PROGRAMS[name]
    return s, [make(s), finish(s)], first


@pytest.mark.parametrize("name, layout, threads, size", CASES)
def test_forward_mode_agrees_with_differences(name, layout, threads, size):
    s, kernels, first = made(name, layout, threads, size)
    dx, dw = directions(size)
    expected = difference(s, kernels, dx, dw, first)
    s.reset(s.start["x"], s.start["w"], first)

    def run():
        for kernel in kernels:
            kernel()

    found = float(ti.ad.jvp(run, [s.x, s.w], [dx, dw], s.loss))
    assert found == expected
    assert size == 1 or found != 0


@pytest.mark.parametrize("name, layout, threads, size", CASES)
def test_the_gradient_agrees_with_differences(name, layout, threads, size):
    s, kernels, first = made(name, layout, threads, size)
    dx, dw = directions(size)
    expected = difference(s, kernels, dx, dw, first)
    s.reset(s.start["x"], s.start["w"], first)
    with ti.ad.Tape(s.loss):
        for kernel in kernels:
            kernel()
    found = float(s.x.grad.to_numpy() @ dx + s.w.grad.to_numpy() @ dw)
    assert found == expected


ARRAY = ti.types.ndarray(dtype=ti.f64, ndim=1, needs_grad=True)


@pytest.mark.parametrize("form", ["product", "maximum", "minimum"])
def test_arrays_of_the_caller_are_refused_with_a_remedy(form):
    """The message names a field as the remedy; the programs above use one."""
    s = Scene()

    @ti.kernel
    def product(a: ARRAY, b: ARRAY):
        for i in b:
            a[s.p[i]] *= b[i]

    @ti.kernel
    def maximum(a: ARRAY, b: ARRAY):
        for i in b:
            ti.atomic_max(a[s.p[i]], b[i])

    @ti.kernel
    def minimum(a: ARRAY, b: ARRAY):
        for i in b:
            a[s.p[i]] = ti.min(a[s.p[i]], b[i])

    a = ti.ndarray(ti.f64, shape=BINS, needs_grad=True)
    b = ti.ndarray(ti.f64, shape=N, needs_grad=True)
    kernel = {"product": product, "maximum": maximum, "minimum": minimum}[form]
    with pytest.raises(ti.TaiAutodiffError) as info, ti.ad.Tape(s.loss):
        kernel(a, b)
        finish(s)()
    message = str(info.value)
    assert "of an element of an array has no gradient" in message
    assert "combine into a field that has a gradient instead of the array" in message
    assert "tai-" not in message and "test_reduction_derivatives.py" in message


@pytest.mark.parametrize("threads", [1, 2])
def test_sums_into_arrays_at_indices_from_data(threads):
    s = Scene(threads=threads)

    @ti.kernel
    def add(a: ARRAY, b: ARRAY):
        for i in b:
            a[s.p[i]] = a[s.p[i]] + b[i] * b[i]

    @ti.kernel
    def total(a: ARRAY):
        for i in a:
            s.loss[None] += (i + 1) * a[i]

    a = ti.ndarray(ti.f64, shape=BINS, needs_grad=True)
    b = ti.ndarray(ti.f64, shape=N, needs_grad=True)
    b.from_numpy(s.start["x"])
    with ti.ad.Tape(s.loss):
        add(a, b)
        total(a)
    np.testing.assert_allclose(
        b.grad.to_numpy(), 2 * s.start["x"] * (s.p.to_numpy() + 1), rtol=1e-14
    )
