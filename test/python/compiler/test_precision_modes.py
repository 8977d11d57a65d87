"""precision and adjoints: the types of fields, gradients and arithmetic; fields of 16 bits."""

import math

import numpy as np
import pytest
import tai as ti

NPT = {ti.f32: np.float32, ti.f64: np.float64}


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
def test_gradients_of_narrow_fields_are_f32(dt):
    """3000 contributions of one add up to 3000, which neither type can count to."""
    ti.init(arch=ti.cpu)
    n = 3001
    x = ti.field(dt, shape=(), needs_grad=True)
    y = ti.field(ti.f32, shape=n, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def spread():
        for i in y:
            y[i] = x[None] * 1.0

    @ti.kernel
    def gather():
        for i in y:
            loss[None] += y[i]

    x[None] = 1
    with ti.ad.Tape(loss):
        spread()
        gather()
    assert x.grad.dtype is ti.f32
    assert x.grad[None] == n


@pytest.mark.parametrize("dt", [ti.f16, ti.bf16])
@pytest.mark.parametrize("scale", [2.0**-30, 2.0**20])
def test_gradients_of_narrow_fields_are_not_rounded_on_their_way(dt, scale):
    """The numbers are of a size that f16 does not have, and have more digits than either type; they
    pass through stores."""
    ti.init(arch=ti.cpu)
    n = 4
    x, y = (ti.Vector.field(2, dt, shape=n, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def copy():
        for i in x:
            y[i] = 2.0 * x[i] + x[i]

    @ti.kernel
    def measure(a: ti.f32):
        for i in y:
            loss[None] += a * y[i].sum()

    x.fill(1)
    a = np.float32(scale * (1 + 2.0**-20))
    with ti.ad.Tape(loss):
        copy()
        measure(a)
    np.testing.assert_array_equal(x.grad.to_numpy(), np.full((n, 2), np.float32(3) * a))


@pytest.mark.parametrize(
    ("dt", "adjoints", "rtol"),
    [(ti.f16, "default", 6e-8), (ti.bf16, "default", 6e-8),
     (ti.f16, "f64", 1e-15), (ti.bf16, "f64", 1e-15), (ti.f32, "f64", 1e-15)],
)  # fmt: skip
@pytest.mark.parametrize("of_kernel", [False, True])
def test_gradients_in_f64_are_rounded_once(dt, adjoints, rtol, of_kernel):
    """To the type of the gradient, and not to that of the field on the way."""
    modes = {"precision": "f64"}
    ti.init(arch=ti.cpu, adjoints=adjoints, **({} if of_kernel else modes))
    x, y = (ti.field(dt, shape=33, needs_grad=True) for _ in range(2))
    v = ti.Vector.field(2, dt, shape=33, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel(**(modes if of_kernel else {}))
    def store():
        for i in x:
            y[i] = 3.0 * x[i] + v[i][1] / 7.0

    @ti.kernel(**(modes if of_kernel else {}))
    def measure():
        for i in y:
            loss[None] += y[i] / 3.0 + ti.sqrt(v[i][0])

    x.fill(1)
    v.fill(3)
    with ti.ad.Tape(loss):
        store()
        measure()
    np.testing.assert_allclose(x.grad.to_numpy(), 1, rtol=rtol)
    slopes = [0.5 / math.sqrt(3), 1 / 21]
    np.testing.assert_allclose(v.grad.to_numpy(), np.tile(slopes, (33, 1)), rtol=rtol)


def test_bf16_fields():
    """They hold the nearest number of eight bits; arithmetic on them is f32."""
    ti.init(arch=ti.cpu)
    x, v = ti.field(ti.bf16, shape=5), ti.Vector.field(2, ti.bf16, shape=1)
    out = ti.field(ti.f32, shape=4)
    given = np.array([1.00390625, 1.01171875, 3.0e38, np.inf, 256], np.float32)

    @ti.kernel
    def run():
        out[0] = x[4] + 1.0
        out[1] = ti.cast(257.0, ti.bf16)
        out[2] = v[0].sum()
        x[0] = 0.1

    x.from_numpy(given)
    expected = np.array([1.0, 1.015625, 3.0e38, np.inf, 256], np.float32)
    np.testing.assert_allclose(x.to_numpy(), expected, rtol=0.002)
    assert x[0] == 1.0 and x[1] == 1.015625
    v[0] = [256, 1]
    run()
    assert out.to_numpy()[:3].tolist() == [257, 256, 257]
    assert x[0] == 0.10009765625
    with pytest.raises(BufferError, match="bf16"):
        x.__dlpack__()
    with pytest.raises(ti.TaiRuntimeTypeError, match="bf16"):
        ti.ndarray(ti.bf16, 3)


@pytest.mark.parametrize(("precision", "stored"), [("f16", ti.f16), ("bf16", ti.bf16)])
def test_precision_of_storage(precision, stored):
    ti.init(arch=ti.cpu, precision=precision)
    x, y = ti.field(float, shape=3), ti.field(ti.f32, shape=3)
    assert x.dtype is stored and y.dtype is ti.f32

    @ti.kernel
    def run(a: float):
        for i in y:
            y[i] = a + 0.1

    run(0.1)
    assert y[0] == np.float32(0.1) + np.float32(0.1)


@pytest.mark.parametrize("precision", ["f16", "bf16"])
def test_single_elements_are_not_stored_in_16_bits(precision):
    """Sums and results of a program stay wide, unless their type is given."""
    ti.init(arch=ti.cpu, precision=precision)
    n = 100_000
    x, loss = ti.field(float, n, needs_grad=True), ti.field(float, (), needs_grad=True)
    rate, named = ti.Vector.field(2, float, ()), ti.field(getattr(ti, precision), ())
    assert loss.dtype is ti.f32 and rate.dtype is ti.f32
    assert named.dtype is x.dtype is getattr(ti, precision)
    assert ti.field(float, 1).dtype is x.dtype
    x.fill(1)
    rate[None] = [0.1, 70001]

    @ti.kernel
    def add():
        for i in x:
            loss[None] += x[i] * rate[None][1]

    with ti.ad.Tape(loss):
        add()
    assert loss[None] == pytest.approx(70001 * n, rel=1e-6)
    assert x.grad[n - 1] == 70001 and rate[None][0] == np.float32(0.1)


def test_precision_of_a_kernel():
    """Fields of f32, arithmetic of f64: literals, arguments, locals and loops."""
    ti.init(arch=ti.cpu)
    n = 1000
    x, y = ti.field(ti.f32, shape=n), ti.field(ti.f32, shape=n)
    values = np.random.default_rng(0).uniform(1, 2, n).astype(np.float32)
    x.from_numpy(values)

    def body(a: float):
        for i in x:
            s = x[i] * a
            k = 0
            while k < 10:
                s += 0.1 * x[i] - 0.1
                k += 1
            for _ in range(5):
                s = s * 1.1 if s > 0 else s
            y[i] = s

    def expected(npt):
        v = values.astype(npt)
        s = v * npt(0.3)
        for _ in range(10):
            s += npt(0.1) * v - npt(0.1)
        for _ in range(5):
            s = np.where(s > 0, s * npt(1.1), s)
        return s.astype(np.float32)

    wide = ti.kernel(precision="f64")(body)
    wide(0.3)
    assert np.array_equal(y.to_numpy(), expected(np.float64))
    ti.kernel(body)(0.3)
    assert not np.array_equal(y.to_numpy(), expected(np.float64))
    assert "arith.extf" in wide.mlir() and "f64" in wide.mlir()


def test_f32_on_fields_of_f64():
    """Their numbers stay f64, and so do constants beside them."""
    ti.init(arch=ti.cpu, precision="f64")
    x = ti.field(float, shape=4)
    v = ti.Vector.field(2, float, shape=4)

    @ti.kernel(precision="f32")
    def move():
        for i in x:
            x[i] = x[i] * 2.0 + 1.0
            v[i] = v[i] + ti.Vector([x[i], 0.5])

    x.fill(1e-12)
    move()
    np.testing.assert_array_equal(x.to_numpy(), np.full(4, 1e-12) * 2 + 1)
    np.testing.assert_array_equal(v.to_numpy()[:, 0], x.to_numpy())


def test_precision_of_a_kernel_with_matrices_and_gradients():
    ti.init(arch=ti.cpu)
    n = 100
    f = ti.Matrix.field(2, 2, ti.f32, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel(precision="f64")
    def measure():
        for i in f:
            loss[None] += (f[i] @ f[i].transpose()).trace() + f[i].norm()

    values = np.random.default_rng(0).uniform(-1, 1, (n, 2, 2)).astype(np.float32)
    f.from_numpy(values)
    with ti.ad.Tape(loss):
        measure()
    wide = values.astype(np.float64)
    norms = np.sqrt((wide**2).sum((1, 2)))
    assert loss[None] == pytest.approx((norms**2 + norms).sum(), rel=1e-14)
    gradient = (2 + 1 / norms)[:, None, None] * wide
    np.testing.assert_array_equal(f.grad.to_numpy(), gradient.astype(np.float32))


def test_the_precision_of_a_kernel_ends_with_it():
    """Neither other kernels nor fields have it, also after one that does not compile."""
    ti.init(arch=ti.cpu)
    x = ti.field(ti.f32, shape=4)
    x.fill(1e-9)

    @ti.kernel(precision="f64")
    def wide() -> float:
        return x[0] + 1.0

    @ti.kernel(precision="f64")
    def wrong(a: float):
        x[0] = nothing_of_this_name  # noqa: F821

    @ti.kernel
    def narrow(a: float) -> float:
        return x[0] + a

    assert wide() == np.float64(np.float32(1e-9)) + 1
    assert narrow(1.0) == 1
    with pytest.raises(ti.TaiCompilationError):
        wrong(1.0)
    assert narrow(1.0) == 1
    assert ti.field(float, shape=()).dtype == ti.f32
    assert ti.Vector.field(2, float, shape=()).dtype == ti.f32

    @ti.kernel
    def later(a: float) -> float:
        return x[0] + a

    assert later(1.0) == 1


# Adjoints


def test_adjoints_of_f64():
    """The gradient of f32 is kept in f64: a small contribution is not lost beside a large one."""
    for adjoints, dt in (("default", ti.f32), ("f64", ti.f64)):
        ti.init(arch=ti.cpu, adjoints=adjoints)
        x = ti.Vector.field(2, ti.f32, shape=(), needs_grad=True)
        loss = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def add(a: ti.f32, x: ti.template(), loss: ti.template()):
            loss[None] += a * x[None][0]

        with ti.ad.Tape(loss):
            add(1.0, x, loss)
            add(2.0**-30, x, loss)
        assert x.grad.dtype is dt
        assert x.grad[None][0] - 1 == (2.0**-30 if dt is ti.f64 else 0)


def test_adjoints_of_f64_of_overwritten_and_contended_values():
    ti.init(arch=ti.cpu, adjoints="f64")
    n = 50
    x = ti.field(ti.f32, shape=n, needs_grad=True)
    top = ti.field(ti.f32, shape=(), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def step():
        for i in x:
            x[i] = 2.0 * x[i]

    @ti.kernel
    def reach():
        for i in x:
            ti.atomic_max(top[None], x[i])

    @ti.kernel
    def measure():
        loss[None] += top[None] * top[None]

    x.from_numpy(np.arange(n, dtype=np.float32))
    with ti.ad.Tape(loss):
        step()
        step()
        reach()
        measure()
    expected = np.zeros(n)
    expected[-1] = 2 * 4 * (n - 1) * 4
    np.testing.assert_array_equal(x.grad.to_numpy(), expected)
    assert x.grad.dtype is ti.f64
