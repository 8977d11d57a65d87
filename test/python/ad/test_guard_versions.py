"""Loops that test once whether guards matter: the same gradients as with a guard at each product.

The reference is the same program at opt_level 0, where guards are selects and nothing else.
"""

import numpy as np
import pytest
import tai as ti

SIZES = [1, 7, 65537]
#: What makes a partial derivative infinite or undefined, or nearly so.
BAD = {
    "zero": 0.0,
    "infinite": np.inf,
    "nan": np.nan,
    "negative": -1.0,
    "tiny": 1e-37,
    "denormal": {ti.f32: 1e-42, ti.f64: 1e-310},
    "huge": {ti.f32: 1e30, ti.f64: 1e250},
}
REALS = [pytest.param(ti.f32, id="f32"), pytest.param(ti.f64, id="f64")]


def bad_value(name, real):
    value = BAD[name]
    return value[real] if isinstance(value, dict) else value


def both(run, real, **options):
    """The results of `run` at opt_level 3 and 0 agree: the finite numbers, and the places of NaN
    and infinities."""
    results = []
    for level in (3, 0):
        ti.init(arch=ti.cpu, default_fp=real, opt_level=level, **options)
        results.append([np.asarray(found, np.float64) for found in run()])
    for found, expected in zip(*results, strict=True):
        far, near = (1e-3, 1e-4) if real == ti.f32 else (1e-10, 1e-12)
        np.testing.assert_allclose(found, expected, rtol=far, atol=near, equal_nan=True)
    return results[0]


def places(n):
    """Elements that are the only bad ones: the first, the last, one in the last thread's part."""
    return sorted({0, n // 2, n - 1, max(0, n - 2)})


class Scattered:
    """Quotients, roots and logarithms of elements that an index field names."""

    def __init__(self, real, n):
        self.n = n
        self.x = ti.field(real, shape=n, needs_grad=True, needs_dual=True)
        self.y = ti.field(real, shape=n, needs_grad=True)
        self.w = ti.field(real, shape=n)
        self.to = ti.field(ti.i32, shape=n)
        self.loss = ti.field(real, shape=(), needs_grad=True, needs_dual=True)
        x, y, w, to, loss = self.x, self.y, self.w, self.to, self.loss

        @ti.kernel
        def run(m: ti.i32):
            for i in range(m):
                a, b = x[to[i]], y[i]
                u = b / a
                speed = ti.max(ti.abs(u) + ti.sqrt(2.0 * a), 0.25)
                kept = ti.select(a > 0.0, ti.log(a) * u, 0.0)
                loss[None] += w[i] * (speed * u * u + kept * a + ti.sqrt(u * u))

        self.run = run
        self.to.from_numpy(np.arange(n, dtype=np.int32)[::-1].copy())

    def gradient(self, x, w):
        rng = np.random.default_rng(5)
        self.x.from_numpy(x)
        self.y.from_numpy(rng.uniform(0.5, 2, self.n))
        self.w.from_numpy(w)
        self.loss[None] = 0
        with ti.ad.Tape(self.loss):
            self.run(self.n)
        return [self.x.grad.to_numpy(), self.y.grad.to_numpy()]


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("n", SIZES)
def test_one_element_is_bad(real, n, name):
    def run():
        found = []
        program = Scattered(real, n)
        for place in places(n):
            for weight in (0.0, 1.0):
                x = np.linspace(0.5, 2, n)
                w = np.ones(n)
                x[place] = bad_value(name, real)
                w[n - 1 - place] = weight
                found += program.gradient(x, w)
        return found

    found = both(run, real, cpu_max_num_threads=2)
    if name in ("zero", "infinite", "negative", "nan"):
        # Where its adjoint is zero, nothing of the bad element enters.
        assert np.isfinite(found[0]).all() and np.isfinite(found[1]).all()


@pytest.mark.parametrize("real", REALS)
def test_the_data_change_between_sweeps(real):
    """Safe, bad and safe again, by the same kernels and tapes that come again."""

    def run():
        program, found = Scattered(real, 300), []
        for sweep in range(6):
            x, w = np.linspace(0.5, 2, 300), np.ones(300)
            if sweep in (2, 4):
                x[299 - sweep], w[sweep] = 0, 0
            found += program.gradient(x, w)
        return found

    assert all(np.isfinite(g).all() for g in both(run, real))


def test_two_tapes():
    def run():
        one, other = Scattered(ti.f64, 40), Scattered(ti.f64, 9)
        bad, w = np.linspace(0.5, 2, 40), np.ones(40)
        bad[39], w[0] = 0, 0
        found = []
        for _ in range(3):
            found += one.gradient(bad, w)
            found += other.gradient(np.linspace(1, 2, 9), np.ones(9))
        return found

    assert all(np.isfinite(g).all() for g in both(run, ti.f64))


@pytest.mark.parametrize("bad", [0, 5, 11], ids=["first", "middle", "last"])
@pytest.mark.parametrize("masked", [False, True], ids=["used", "masked"])
@pytest.mark.parametrize("real", REALS)
def test_a_serial_loop(real, masked, bad):
    """An adjoint that a loop carries, infinite since one sample of one ray."""

    def run():
        n, most = 33, 12
        x = ti.field(real, shape=(n, most), needs_grad=True)
        z = ti.field(real, shape=n, needs_grad=True)
        w = ti.field(real, shape=n)
        loss = ti.field(real, shape=(), needs_grad=True)

        @ti.kernel
        def march(samples: ti.i32):
            for i in range(n):
                light, total = 1.0, 0.0
                for s in range(samples):
                    d = ti.Vector([x[i, s], z[i] - 1.0]).norm() / x[i, s]
                    light *= 1.0 / (1.0 + ti.exp(d - 1.0))
                    total += light * ti.sqrt(x[i, s]) * z[i]
                loss[None] += w[i] * (total + light * light)

        found = []
        for samples in (1, most):
            data, weights = np.linspace(0.5, 2, n * most).reshape(n, most), np.ones(n)
            data[n - 1, min(bad, samples - 1)] = 0
            weights[n - 1] = 0 if masked else 1
            x.from_numpy(data)
            z.from_numpy(np.linspace(1, 2, n))
            w.from_numpy(weights)
            loss[None] = 0
            with ti.ad.Tape(loss):
                march(samples)
            found += [x.grad.to_numpy(), z.grad.to_numpy()]
        return found

    found = both(run, real)
    if masked:
        assert all(np.isfinite(g).all() for g in found)


@pytest.mark.parametrize("last", [1, 3, 5])
@pytest.mark.parametrize("real", REALS)
def test_an_infinite_adjoint_that_a_loop_carries(real, last):
    """The root of zero in one iteration: the one before it is regular, and meets a factor of 0."""

    def run():
        n, most = 17, 6
        a = ti.field(real, shape=(n, most), needs_grad=True)
        h = ti.field(real, shape=(n, most), needs_grad=True)
        loss = ti.field(real, shape=(), needs_grad=True)

        @ti.kernel
        def roots(samples: ti.i32):
            for i in range(n):
                c = 1.0
                for s in range(samples):
                    c = ti.sqrt(c + a[i, s] * a[i, s]) - h[i, s]
                loss[None] += c

        factors, less = np.full((n, most), 1.0), np.zeros((n, most))
        factors[n - 1, : last + 1] = 0
        less[n - 1, last - 1] = 1
        a.from_numpy(factors)
        h.from_numpy(less)
        with ti.ad.Tape(loss):
            roots(most)
        return [a.grad.to_numpy(), h.grad.to_numpy()]

    by_a, by_h = both(run, real)
    assert (by_a[-1, : last + 1] == 0).all() and np.isfinite(by_a).all()
    assert np.isneginf(by_h[-1, last - 1])


@pytest.mark.parametrize("name", ["zero", "nan", "infinite", "negative"])
def test_a_value_that_was_stored(name):
    """An adjoint that loads a result in the place of computing it: it may be infinite, too."""

    def run():
        n = 20
        x = ti.Vector.field(2, ti.f64, shape=n, needs_grad=True)
        e = ti.Vector.field(2, ti.f64, shape=n, needs_grad=True)
        to = ti.field(ti.i32, shape=n)
        w = ti.field(ti.f64, shape=n)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def fill():
            for i in range(n):
                e[i] = ti.exp(x[to[i]]) / x[to[i]].norm()

        @ti.kernel
        def total():
            for i in range(n):
                loss[None] += w[i] * e[i].sum()

        data, weights = np.linspace(0.5, 2, 2 * n).reshape(n, 2), np.ones(n)
        data[3] = [1e4, BAD[name]]
        weights[3] = 0
        x.from_numpy(data)
        w.from_numpy(weights)
        to.from_numpy(np.arange(n, dtype=np.int32))
        with ti.ad.Tape(loss):
            fill()
            total()
        return [x.grad.to_numpy()]

    assert np.isfinite(both(run, ti.f64)[0][:3]).all()


@pytest.mark.parametrize("name", ["zero", "tiny", "denormal", "nan"])
@pytest.mark.parametrize("n", [1, 40])
def test_matrices_and_normals(n, name):
    def run():
        F = ti.Matrix.field(2, 2, ti.f64, shape=n, needs_grad=True)
        v = ti.Vector.field(3, ti.f64, shape=n, needs_grad=True)
        w = ti.field(ti.f64, shape=n)
        to = ti.field(ti.i32, shape=n)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def energy():
            for i in range(n):
                A, u = F[to[i]], v[to[i]].normalized()
                J = A.determinant()
                P = A - A.inverse().transpose() + ti.log(J) * A.inverse()
                loss[None] += w[i] * (P.norm() + u[0] * u[1] + v[to[i]].norm())

        found = []
        for weight in (0.0, 1.0):
            matrices = np.tile(np.eye(2), (n, 1, 1)) + np.linspace(0, 0.3, n)[:, None, None]
            vectors, weights = np.linspace(0.5, 2, 3 * n).reshape(n, 3), np.ones(n)
            matrices[n - 1] *= bad_value(name, ti.f64)
            vectors[n - 1] *= bad_value(name, ti.f64)
            weights[n - 1] = weight
            F.from_numpy(matrices)
            v.from_numpy(vectors)
            w.from_numpy(weights)
            to.from_numpy(np.arange(n, dtype=np.int32))
            loss[None] = 0
            with ti.ad.Tape(loss):
                energy()
            found += [F.grad.to_numpy(), v.grad.to_numpy()]
        return found

    found = both(run, ti.f64)
    if name != "nan":  # loaded values count as finite in products
        assert np.isfinite(found[0]).all() and np.isfinite(found[1]).all()


@pytest.mark.parametrize("name", ["zero", "infinite", "negative", "denormal"])
def test_forward_mode(name):
    def run():
        n = 30
        program = Scattered(ti.f64, n)
        x, w = np.linspace(0.5, 2, n), np.ones(n)
        x[n - 1] = bad_value(name, ti.f64)
        program.x.from_numpy(x)
        program.y.fill(1.5)
        program.w.from_numpy(w)
        tangent = np.ones(n)
        tangent[n - 1] = 0
        with ti.ad.FwdMode(loss=program.loss, param=program.x, seed=tangent.tolist()):
            program.run(n)
        return [program.loss.dual.to_numpy()]

    both(run, ti.f64)


@pytest.mark.parametrize("real", REALS)
def test_a_tangent_that_is_infinite_before_a_loop(real):
    """The guards behind the loop have a test of their own, of the tangent as well."""

    def run():
        n = 4
        x, z, out = (ti.field(real, shape=n, needs_dual=True) for _ in range(3))
        loss = ti.field(real, shape=(), needs_dual=True)
        trips = ti.field(ti.i32, shape=n)

        @ti.kernel
        def evaluate():
            for i in range(n):
                inner = 1.0 - 1.0 / z[i]
                for _ in range(trips[i]):
                    loss[None] += ti.tanh(x[i])
                out[i] += ti.tanh(1.0 / inner)

        z.from_numpy(np.array([0.0, 2.0, 0.5, 3.0]))
        trips.fill(1)
        return [ti.ad.jvp(evaluate, [z, x], [np.ones(n), np.ones(n)], out)]

    [found] = both(run, real)
    np.testing.assert_allclose(found, [0, -0.07065082, -1.67989737, -0.04517666], rtol=1e-5)
