"""f16 is for storage: loaded values are computed with in f32, and stores round."""

import os

import numpy as np
import pytest
import tai as ti

HALF = np.float16


def start(**options):
    ti.init(arch=ti.cpu, offline_cache=False, **options)


def test_sums_of_loaded_values_are_f32():
    """2048 + 1 is 2049, which f16 does not have."""
    start()
    x, v = ti.field(ti.f16, shape=2), ti.Vector.field(2, ti.f16, shape=1)
    out = ti.field(ti.f32, shape=6)

    @ti.kernel
    def run(a: ti.types.ndarray(dtype=ti.f16, ndim=1)):
        out[0] = x[0] + x[1]
        out[1] = v[0].sum()
        out[2] = a[0] + a[1]
        kept = x[0]
        kept += x[1]
        out[3] = kept
        out[4] = ti.sqrt(x[0] * x[0])
        out[5] = v[0].dot(ti.Vector([1.0, 1.0]))

    x.from_numpy(np.array([2048, 1], HALF))
    v.from_numpy(np.array([[2048, 1]], HALF))
    run(np.array([2048, 1], HALF))
    np.testing.assert_array_equal(out.to_numpy(), [2049, 2049, 2049, 2049, 2048, 2049])


def test_what_is_declared_f16_is_rounded():
    """A variable, a cast and a matrix of f16 hold f16; arithmetic on them is f32."""
    start()
    out = ti.field(ti.f32, shape=7)

    @ti.kernel
    def run():
        tenth: ti.f16 = 0.1
        out[0] = tenth
        tenth += 1.0
        out[1] = tenth
        large = ti.f16(2048.0)
        out[2] = large + ti.f16(1.0)
        out[3] = -ti.f16(0.1)
        out[4] = abs(ti.f16(-0.1)) ** 2
        w = ti.Vector([2048.0, 0.1], dt=ti.f16)
        w[1] += 1.0
        out[5] = w[1]
        out[6] = w.sum()

    run()
    tenth = np.float32(HALF(0.1))
    sum_ = np.float32(HALF(tenth + np.float32(1)))
    expected = [tenth, sum_, 2049, -tenth, tenth * tenth, sum_, np.float32(2048) + sum_]
    np.testing.assert_array_equal(out.to_numpy(), np.array(expected, np.float32))


# Ties, denormals, and a number that rounds twice by way of f32.
DOUBLES = [0.1, -1 / 3, 65504.0, 65519.999, 65520.0, 1e30, 2.0**-24, 2.0**-25, 1.5 * 2.0**-24,
           2049.0, 2051.0, 1 + 2.0**-11 + 2.0**-40, np.inf, -0.0]  # fmt: skip


@pytest.mark.parametrize("source", ["f64", "f32"])
def test_conversions_round_once(source):
    start()
    numbers = np.array(DOUBLES, source.replace("f", "float"))
    n = len(numbers)
    a = ti.field(getattr(ti, source), shape=n)
    h = ti.field(ti.f16, shape=n)

    @ti.kernel
    def run():
        for i in range(n):
            h[i] = a[i]

    a.from_numpy(numbers)
    run()
    with np.errstate(over="ignore"):
        expected = numbers.astype(HALF)
    np.testing.assert_array_equal(h.to_numpy(), expected)
    np.testing.assert_array_equal(np.signbit(h.to_numpy()), np.signbit(expected))


@pytest.mark.parametrize("wide", ["f64", "f32"])
def test_gradients_of_f16_fields(wide):
    """Through a loss of another type: they are f32, as they are sums."""
    start()
    n = 5
    x = ti.field(ti.f16, shape=n, needs_grad=True)
    y = ti.field(getattr(ti, wide), shape=n, needs_grad=True)
    loss = ti.field(getattr(ti, wide), shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            y[i] = ti.sin(x[i]) * x[i]
        for i in x:
            loss[None] += y[i] * x[i]

    values = np.linspace(0.1, 2.0, n).astype(HALF)
    x.from_numpy(values)
    with ti.ad.Tape(loss):
        run()
    v = values.astype(float)
    expected = np.cos(v) * v * v + 2 * np.sin(v) * v
    np.testing.assert_allclose(x.grad.to_numpy(), expected, rtol=1e-6)
    assert x.grad.dtype is ti.f32


def test_tangents_of_f16_fields():
    start()
    x = ti.field(ti.f16, shape=3, needs_dual=True)
    y = ti.field(ti.f64, shape=(), needs_dual=True)

    @ti.kernel
    def run():
        for i in x:
            y[None] += ti.exp(x[i])

    x.from_numpy(np.array([0.0, 1.0, -1.0], HALF))
    with ti.ad.FwdMode(loss=y, param=x, seed=[1.0, 2.0, 3.0]):
        run()
    assert y.dual[None] == pytest.approx(1 + 2 * np.e + 3 / np.e, rel=1e-6)


@pytest.mark.parametrize("threads", [1, 3])
def test_sums_of_a_loop_are_f32(threads):
    """10,000 ones, whose sum in f16 would stop at 2048, or where as many parts of it do."""
    start(cpu_max_num_threads=threads)
    if os.environ.get("TI_ARCH") == "cuda":
        pytest.skip("each thread of a GPU adds to the element, which rounds")
    x, total = ti.field(ti.f16, shape=10_000), ti.field(ti.f16, shape=())

    @ti.kernel
    def run():
        for i in x:
            total[None] += x[i]

    x.fill(1.0)
    run()
    assert total[None] == 10_000


class Smoke:
    """Smoke in a periodic box: advection, projection by Jacobi iterations, distance to a picture.

    Everything that lasts from step to step is stored in `dtype`, gradients too.
    """

    n, steps, jacobi = 20, 25, 6

    def __init__(self, dtype, options):
        start(**options)
        n, steps, jacobi = self.n, self.steps, self.jacobi

        def make(shape, kind=dtype):
            return ti.field(kind, shape=shape, needs_grad=True)

        vx, vy, ax, ay = (make((steps + 1, n, n)) for _ in range(4))
        smoke = make((steps + 1, n, n))
        pressure, divergence = make((steps, jacobi + 1, n, n)), make((steps, n, n))
        loss = make((), ti.f64 if dtype is ti.f64 else ti.f32)
        self.vx, self.vy, self.smoke, self.loss = vx, vy, smoke, loss
        target = ti.field(ti.f64, shape=(n, n))
        self.target = target

        @ti.func
        def sample(f, t, x, y):
            i, j = int(ti.floor(x)), int(ti.floor(y))
            u, v = x - i, y - j
            a = f[t, i % n, j % n] * (1 - u) + f[t, (i + 1) % n, j % n] * u
            b = f[t, i % n, (j + 1) % n] * (1 - u) + f[t, (i + 1) % n, (j + 1) % n] * u
            return a * (1 - v) + b * v

        @ti.kernel
        def advect(t: ti.i32):
            for i, j in ti.ndrange(n, n):
                x, y = i - vx[t, i, j], j - vy[t, i, j]
                ax[t, i, j] = sample(vx, t, x, y)
                ay[t, i, j] = sample(vy, t, x, y)
                smoke[t + 1, i, j] = sample(smoke, t, x, y)

        @ti.kernel
        def diverge(t: ti.i32):
            for i, j in ti.ndrange(n, n):
                divergence[t, i, j] = 0.5 * (
                    ax[t, (i + 1) % n, j] - ax[t, (i - 1) % n, j]
                    + ay[t, i, (j + 1) % n] - ay[t, i, (j - 1) % n])  # fmt: skip

        @ti.kernel
        def relax(t: ti.i32, k: ti.i32):
            for i, j in ti.ndrange(n, n):
                pressure[t, k + 1, i, j] = 0.25 * (
                    pressure[t, k, (i + 1) % n, j] + pressure[t, k, (i - 1) % n, j]
                    + pressure[t, k, i, (j + 1) % n] + pressure[t, k, i, (j - 1) % n]
                    - divergence[t, i, j])  # fmt: skip

        @ti.kernel
        def project(t: ti.i32):
            for i, j in ti.ndrange(n, n):
                p = ti.static(jacobi)
                vx[t + 1, i, j] = ax[t, i, j] - 0.5 * (
                    pressure[t, p, (i + 1) % n, j] - pressure[t, p, (i - 1) % n, j])  # fmt: skip
                vy[t + 1, i, j] = ay[t, i, j] - 0.5 * (
                    pressure[t, p, i, (j + 1) % n] - pressure[t, p, i, (j - 1) % n])  # fmt: skip

        @ti.kernel
        def measure():
            for i, j in ti.ndrange(n, n):
                loss[None] += (smoke[steps, i, j] - target[i, j]) ** 2

        self.kernels = advect, diverge, relax, project, measure

    def gradient(self):
        """The gradient of the loss by the first velocities."""
        n = self.n
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        wave = 2 * np.pi / n
        first = np.zeros(self.smoke.shape)
        first[0] = 0.5 + 0.5 * np.sin(wave * i) * np.cos(2 * wave * j)
        speed = np.zeros(self.vx.shape)
        speed[0] = 0.4 * np.sin(wave * j) + 0.1 * np.cos(2 * wave * i)
        other = np.zeros(self.vy.shape)
        other[0] = 0.3 * np.cos(wave * i)
        self.target.from_numpy(0.5 + 0.4 * np.cos(wave * (i + j)))
        for field, values in ((self.smoke, first), (self.vx, speed), (self.vy, other)):
            # In all types the same numbers to start from.
            field.from_numpy(values.astype(HALF).astype(field.dtype.numpy))
        advect, diverge, relax, project, measure = self.kernels
        with ti.ad.Tape(self.loss):
            for t in range(self.steps):
                advect(t)
                diverge(t)
                for k in range(self.jacobi):
                    relax(t, k)
                project(t)
            measure()
        found = [f.grad.to_numpy()[0].astype(float) for f in (self.vx, self.vy)]
        return self.loss[None], np.concatenate(found).ravel()


@pytest.mark.parametrize("threads", [1, 3])
def test_gradient_of_smoke_in_f16_storage(threads):
    expected, reference = Smoke(ti.f64, {}).gradient()
    loss, gradient = Smoke(ti.f16, {"cpu_max_num_threads": threads}).gradient()
    assert np.isfinite(gradient).all()
    cosine = gradient @ reference / np.linalg.norm(gradient) / np.linalg.norm(reference)
    assert loss == pytest.approx(expected, rel=1e-2)
    assert cosine >= 0.999
