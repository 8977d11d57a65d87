"""Skips change no bit of programs whose functions return structs.

Without a skip, adjoints have more code, and LLVM vectorises other loops. Strict and deterministic
programs must not show it.
"""

import numpy as np
import pytest
import tai as ti

from device_tensors import ON_GPU

N = 37
NAMES = list(ti.profiler.skips())
# Skips of the runtime and of sparse levels: they change no code of these programs.
WITHOUT_CODE = (
    "unchanged-lists activity-tests repeated-lookups empty-loops unlaunched-kernels "
    "untouched-memory dead-launches unwanted-gradients clean-gradients zero-adjoints "
    "unread-zeros unchanged-launches"
).split()
# One thread of a CPU adds in order; the threads of a GPU do so in deterministic mode.
MODES = {
    "deterministic": {"deterministic": True},
    "strict": {"strict": True, "cpu_max_num_threads": 1, "deterministic": ON_GPU},
}
PROGRAMS = {}


def program(make):
    PROGRAMS[make.__name__] = make
    return make


class Scene:
    def __init__(self):
        self.x = ti.field(ti.f32, shape=N, needs_grad=True)
        self.c = ti.field(ti.f32, shape=N, needs_grad=True)
        self.loss = ti.field(ti.f32, shape=(), needs_grad=True)


def program_of_terms(make):
    """A program that adds up a function of each pair of elements, which are read once."""

    def make_total(s):
        term = make()

        @ti.kernel
        def run():
            for i in s.x:
                s.loss[None] += term(s.x[i], s.c[i])

        return run

    PROGRAMS[make.__name__] = make_total
    return make


Pair = ti.types.struct(a=ti.f32, b=ti.f32, n=ti.i32)


# The values that the loops carry have no derivative, or a closed form, or are recorded


@program
def march(s):
    hit = ti.types.struct(t=ti.f32, steps=ti.i32, ok=ti.i32)

    @ti.func
    def cast(o, d):
        t = o * 0.1
        steps = 0
        ok = 0
        for _k in range(12):
            e = ti.sin(t * 1.7) * d + 0.3
            if e < 0.12:
                ok = 1
                break
            t += 0.2 * e
            steps += 1
        return hit(t, steps, ok)

    @ti.kernel
    def run():
        for i in s.x:
            h = cast(s.x[i], s.c[i])
            if h.ok == 1:
                s.loss[None] += h.t * h.t
            else:
                s.loss[None] += ti.sin(h.t) * h.steps

    return run


@program
def state(s):
    V = ti.types.vector(2, ti.f32)
    st = ti.types.struct(p=V, v=V, e=ti.f32)

    @ti.func
    def step(q, k):
        a = -q.p * (1.0 + 0.1 * q.p.norm_sqr()) * k
        v = q.v + 0.05 * a
        p = q.p + 0.05 * v
        return st(p, v, 0.5 * v.norm_sqr() + q.e * 0.5)

    @ti.kernel
    def run():
        for i in s.x:
            q = st(ti.Vector([s.x[i], 1.0]), ti.Vector([0.1, s.c[i]]), 0.0)
            for _k in range(9):
                q = step(q, s.c[i])
            s.loss[None] += q.e + q.p.norm_sqr()

    return run


@program_of_terms
def early():
    pair = ti.types.struct(a=ti.f32, b=ti.f32)

    @ti.real_func
    def f(x: ti.f32, n: ti.i32) -> ti.f32:
        r = x
        for _k in range(n):
            r = ti.sin(r * 1.3) + 0.1 * x
            if r > 1.05:
                return r * r
        return r

    @ti.func
    def g(x, c):
        y = x
        z = c
        k = 0
        while y < 3.0 and k < 10:
            y = y * 1.21 + 0.05 * z
            z = z - 0.1 * y * z
            k += 1
        return pair(y, z)

    @ti.func
    def term(x, c):
        p = g(x, c)
        return p.a * p.b + f(x, 6)

    return term


@program_of_terms
def closest():
    hit = ti.types.struct(d=ti.f32, at=ti.types.vector(3, ti.f32), index=ti.i32)

    @ti.func
    def nearest(p, c):
        best = hit(1e3, ti.Vector([0.0, 0.0, 0.0]), -1)
        for k in range(5):
            q = ti.Vector([0.3 * k, 0.1 * k * c, 1.0 - 0.2 * k])
            d = (p - q).norm()
            if d < best.d:
                best = hit(d, q, k)
        return best

    @ti.func
    def term(x, c):
        h = nearest(ti.Vector([x, c, 0.5]), c)
        return h.d * h.d * h.d + h.at.dot(h.at) * x

    return term


@program_of_terms
def ray():
    V = ti.types.vector(3, ti.f32)
    Ray = ti.types.struct(o=V, d=V, w=ti.f32)

    @ti.func
    def bounce(r, k):
        n = ti.Vector([0.0, 1.0, 0.2 * k]).normalized()
        d = r.d - 2.0 * r.d.dot(n) * n
        return Ray(r.o + 0.3 * d, d, r.w * (0.5 + 0.5 * ti.abs(r.d.dot(n))))

    @ti.func
    def term(x, c):
        r = Ray(ti.Vector([x, 0.2, 0.1]), ti.Vector([0.3, c, 0.9]).normalized(), 1.0)
        for k in range(4):
            r = bounce(r, k)
        for k in ti.static(range(2)):
            r = bounce(r, k)
        return r.w * r.o.norm() + r.d[1]

    return term


@program_of_terms
def newton():
    res = ti.types.struct(x=ti.f32, n=ti.i32)

    @ti.func
    def solve(a):
        x = a * 0.5 + 0.5
        n = 0
        while ti.abs(x * x - a) > 1e-3 and n < 20:
            x = 0.5 * (x + a / x)
            n += 1
        return res(x, n)

    @ti.func
    def term(x, c):
        r = solve(x + 1.0)
        q = solve(r.x + c)
        return r.x * q.x * (q.n + 1)

    return term


@program_of_terms
def minmax():
    mm = ti.types.struct(lo=ti.f32, hi=ti.f32, total=ti.f32)

    @ti.func
    def span(x, c):
        m = mm(1e3, -1e3, 0.0)
        v = x
        for k in range(7):
            v = ti.cos(v * c + k)
            m.lo = ti.min(m.lo, v)
            m.hi = ti.max(m.hi, v)
            m.total += v * v
        return m

    @ti.func
    def term(x, c):
        m = span(x, c)
        return m.lo * m.hi + m.total

    return term


@program
def nested(s):
    acc = ti.types.struct(a=ti.f32, b=ti.f32)

    @ti.func
    def inner(q, x):
        r = q
        for _k in range(3):
            r = acc(r.a * 0.9 + ti.sin(r.b), r.b + 0.1 * x * r.a)
        return r

    @ti.kernel
    def run():
        for i in s.x:
            q = acc(s.x[i], s.c[i])
            for k in range(4):
                for _l in range(k + 1):
                    q = inner(q, s.x[i])
                q.a = q.a * (1.0 + 0.1 * q.b)
            s.loss[None] += q.a * q.b

    return run


@program_of_terms
def dual():
    D = ti.types.struct(v=ti.f32, d=ti.f32)

    @ti.func
    def mul(a, b):
        return D(a.v * b.v, a.v * b.d + a.d * b.v)

    @ti.func
    def add(a, b):
        return D(a.v + b.v, a.d + b.d)

    @ti.func
    def term(x, c):
        a = D(x, 1.0)
        r = D(0.5, 0.0)
        for k in range(6):
            r = add(mul(r, a), D(c / (k + 1), 0.0))
        return r.d + r.v

    return term


@program_of_terms
def matrices():
    M = ti.types.matrix(2, 2, ti.f32)
    fac = ti.types.struct(u=M, e=ti.f32)

    @ti.func
    def grow(f, x):
        u = (ti.Matrix([[1.0, 0.1 * x], [-0.1 * x, 1.0]])) @ f.u
        return fac(u, f.e + (u.transpose() @ u).trace() * 0.1)

    @ti.func
    def term(x, c):
        f = fac(ti.Matrix([[1.0, c], [0.2, 1.0]]), 0.0)
        for _k in range(5):
            f = grow(f, x)
        return f.e + f.u.determinant()

    return term


@program_of_terms
def branchy():
    R = ti.types.struct(x=ti.f32, kind=ti.i32)

    @ti.func
    def pick(x, c, k):
        r = R(0.0, 0)
        if x > c:
            r = R(x * c + 0.1 * k, 1)
        elif x > 0.5 * c:
            r = R(ti.sqrt(x + c), 2)
        else:
            r = R(c - x * x, 3)
        return r

    @ti.func
    def term(x, c):
        v = x
        t = 0.0
        for k in range(6):
            r = pick(v, c, k)
            v = r.x * 0.7
            t += r.x * r.kind
        return t * v

    return term


@program
def damped(s):
    P = ti.types.struct(x=ti.f32, v=ti.f32, f=ti.f32)

    @ti.func
    def force(p, k):
        return -k * p.x - 0.1 * p.v * ti.abs(p.v)

    @ti.func
    def advance(p, k, h):
        f = force(p, k)
        m = P(p.x + 0.5 * h * p.v, p.v + 0.5 * h * f, f)
        g = force(m, k)
        return P(p.x + h * m.v, p.v + h * g, g)

    @ti.kernel
    def run():
        for i in s.x:
            p = P(s.x[i], s.c[i], 0.0)
            h = 0.05
            t = 0.0
            while t < 1.0:
                p = advance(p, 2.0 + s.x[i], h)
                t += h
                h *= 1.05
            s.loss[None] += p.x * p.x + 0.3 * p.v + p.f

    return run


@program_of_terms
def members():
    V = ti.types.vector(2, ti.f32)

    @ti.dataclass
    class Body:
        p: V
        v: V
        m: ti.f32

        @ti.func
        def kicked(self, f, h):
            v = self.v + f / self.m * h
            return Body(self.p + h * v, v, self.m * 0.99)

    @ti.func
    def term(x, c):
        b = Body(ti.Vector([x, 0.5]), ti.Vector([0.0, c]), 1.0 + x * 0.2)
        for _k in range(8):
            r = b.p.norm() + 0.1
            b = b.kicked(-b.p / (r * r * r), 0.02)
        return b.v.dot(b.v) * b.m + b.p[0]

    return term


@program_of_terms
def unrelated_loop():
    """The loop computes `t`, which carries no derivative, beside a vectorisable state."""

    @ti.func
    def step(q, x):
        r = Pair(q.a, q.b, 0)
        r = Pair(
            ti.tanh(ti.exp(-ti.abs(r.b)) + 1.0 / (2.0 + ti.abs(r.b))),
            0.3 * ti.cos(0.83 * r.a),
            r.n,
        )
        r.n += 1
        r.b = ti.sin(r.b * r.a - 0.83 * r.a)
        return r

    @ti.func
    def term(x, c):
        q = Pair(x, c, 0)
        t = 0.0
        for _ in range(6):
            q = step(q, t)
            t = 0.3 * ti.tanh(t - 0.607) + t
        return q.a * q.b + t * ti.cast(q.n % 3 + 1, ti.f32)

    return term


@program_of_terms
def one_member_at_a_time():
    @ti.func
    def step(q, x):
        r = Pair(q.a, q.b, 0)
        r.a = ti.sin(0.75 * ti.min(r.a, 1.0))
        return r

    @ti.func
    def term(x, c):
        q = Pair(x, c, 0)
        t = 0.0
        for _ in range(7):
            q = step(q, -0.018 * t)
            t = ti.tanh(ti.pow(ti.abs(t) + 0.5, 1.3)) + t
        return q.a * q.b + t * ti.cast(q.n % 3 + 1, ti.f32)

    return term


@program_of_terms
def recorded_for_nothing():
    """Without `unneeded-records`, the loops keep values, and are not vectorised."""

    @ti.func
    def step(q, x):
        r = Pair(q.a, q.b, 0)
        for _ in range(3):
            r.a = 0.3 * (ti.sin(q.a) + ti.atan2(q.a, 1.5))
            for _ in range(r.n + 2):
                r.n += 1
                r.a = 0.3 * -0.788
        return Pair(ti.sin(x * ti.abs(q.b)), 0.3 * (ti.min(q.b, 1.0) * (r.a - 0.342)), r.n)

    @ti.func
    def term(x, c):
        q = step(Pair(x, c, 0), x)
        return q.a * q.b

    return term


def gradients(make, skip, mode):
    ti.init(skip=skip, offline_cache=False, **MODES[mode])
    s = Scene()
    run = make(s)
    r = np.random.default_rng(3)
    s.x.from_numpy(r.uniform(0.2, 1.5, N).astype(np.float32))
    s.c.from_numpy(r.uniform(0.3, 1.2, N).astype(np.float32))
    with ti.ad.Tape(s.loss):
        run()
    return [s.loss.to_numpy(), s.x.grad.to_numpy(), s.c.grad.to_numpy()]


def check(make, skips, mode):
    expected = gradients(make, "all", mode)
    assert all(np.isfinite(array).all() for array in expected)
    assert all(np.any(array) for array in expected)
    for skip in skips:
        found = gradients(make, skip, mode)
        for a, b in zip(expected, found, strict=True):
            assert np.array_equal(a.view(np.uint32), b.view(np.uint32)), skip


def without(*names):
    return ",".join(["all", *(f"-{name}" for name in names)])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", PROGRAMS)
def test_gradients_have_the_same_bits_without_each_skip(name, mode):
    changing = [without(name) for name in NAMES if name not in WITHOUT_CODE]
    assert len(changing) == len(NAMES) - len(WITHOUT_CODE) >= 3
    check(PROGRAMS[name], ["none", *changing, without(*WITHOUT_CODE)], mode)


@pytest.mark.parametrize("mode", MODES)
def test_skips_that_change_no_code_change_no_bit_one_by_one(mode):
    check(march, [without(name) for name in WITHOUT_CODE], mode)
