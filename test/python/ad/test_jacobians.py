"""Jacobians and Hessians: whole, sparse by colours, and as operators."""

import sys

import numpy as np
import pytest
import tai as ti
from tai._impl.ad.matrices import _colour
from tai.errors import TaiAutodiffError, TaiRuntimeTypeError

sparse = pytest.importorskip("scipy.sparse", reason="SciPy is not installed")


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64)


def both(shape=(), dtype=ti.f64):
    return ti.field(dtype, shape=shape, needs_grad=True, needs_dual=True)


def ring(n):
    """y[i] = x[i] x[i+1] + sin x[i] on a ring, and its Jacobian."""
    x, y = both(n), both(n)

    @ti.kernel
    def run():
        for i in y:
            y[i] = x[i] * x[(i + 1) % n] + ti.sin(x[i])

    values = np.linspace(0.3, 1.7, n)
    x.from_numpy(values)
    right = np.diag(np.cos(values))
    for i in range(n):
        right[i, i] += values[(i + 1) % n]
        right[i, (i + 1) % n] += values[i]
    return run, x, y, right


@pytest.mark.parametrize("n", [1, 2, 7, 130])
@pytest.mark.parametrize("mode", [None, "forward", "reverse"])
def test_jacobian(n, mode):
    run, x, y, right = ring(n)
    before = x.to_numpy()
    found = ti.ad.jacobian(run, x, y, mode=mode)
    np.testing.assert_allclose(found, right, rtol=1e-13, atol=1e-14)
    np.testing.assert_array_equal(x.to_numpy(), before)
    band = ti.ad.jacobian(run, x, y, pattern=right != 0, mode=mode)
    assert band.nnz == np.count_nonzero(right)
    np.testing.assert_allclose(band.toarray(), right, rtol=1e-13, atol=1e-14)


def test_products():
    run, x, y, right = ring(9)
    w = np.random.default_rng(1).standard_normal(9)
    np.testing.assert_allclose(ti.ad.vjp(run, x, y, w), right.T @ w, rtol=1e-13)
    np.testing.assert_allclose(ti.ad.jvp(run, x, w, y), right @ w, rtol=1e-13)
    operator = ti.ad.jacobian_operator(run, x, y)
    np.testing.assert_allclose(operator @ w, right @ w, rtol=1e-13)
    np.testing.assert_allclose(operator.T @ w, right.T @ w, rtol=1e-13)
    # An operator is of the values that the fields have now.
    x.from_numpy(np.zeros(9))
    np.testing.assert_allclose(operator @ w, w, rtol=1e-13)


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_in_place(mode):
    """Each product begins with the first values, also of a single number."""
    x, z = both(5), both()

    @ti.kernel
    def square():
        for i in x:
            x[i] = x[i] * x[i]
        z[None] = z[None] * z[None] * x[0]

    values = np.arange(2.0, 7.0)
    x.from_numpy(values)
    z[None] = 3.0

    def run():
        square()
        square()

    (xx, xz), (zx, zz) = ti.ad.jacobian(run, [x, z], [x, z], mode=mode)
    np.testing.assert_allclose(xx, np.diag(4 * values**3), rtol=1e-13)
    np.testing.assert_array_equal(xz, np.zeros(5))
    # z becomes (z² x²)² x⁴ = z⁴ x⁸.
    np.testing.assert_allclose(zz, 4 * 3.0**3 * 2.0**8, rtol=1e-13)
    np.testing.assert_allclose(zx, [3.0**4 * 8 * 2.0**7, 0, 0, 0, 0], rtol=1e-13)
    np.testing.assert_array_equal(x.to_numpy(), values)
    assert z[None] == 3.0


@pytest.mark.parametrize("order", [ti.Layout.AOS, ti.Layout.SOA])
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_vectors_and_types(mode, order):
    """Element shapes are parts of the shape, and an input of f32 has its own precision."""
    options = {"needs_grad": True, "needs_dual": True, "layout": order}
    v = ti.Vector.field(3, ti.f64, shape=(2,), **options)
    s = both(2, ti.f32)
    out = ti.Matrix.field(2, 2, ti.f64, shape=(2,), **options)

    @ti.kernel
    def run():
        for i in out:
            a, c = v[i], s[i]
            out[i] = ti.Matrix([[a[0] * a[1], a[2] * c], [c * c, a[0]]])

    v.from_numpy(np.array([[1.0, 2, 3], [4, 5, 6]]))
    s.from_numpy(np.array([0.5, 0.25], np.float32))
    by_v, by_s = ti.ad.jacobian(run, [v, s], out, mode=mode)
    assert by_v.shape == (2, 2, 2, 2, 3) and by_s.shape == (2, 2, 2, 2)
    right = np.zeros((2, 2, 2, 2, 3))
    for i, (a, c) in enumerate(zip(v.to_numpy(), s.to_numpy(), strict=True)):
        right[i, 0, 0, i] = [a[1], a[0], 0]
        right[i, 0, 1, i] = [0, 0, c]
        right[i, 1, 1, i] = [1, 0, 0]
    np.testing.assert_allclose(by_v, right, rtol=1e-7)
    np.testing.assert_allclose(by_s[1, :, :, 1], [[0, 6], [0.5, 0]], rtol=1e-6)
    assert not by_s[0, :, :, 1].any()


def test_the_mode_is_the_one_with_fewer_products():
    """Forward mode would run once for each of 40 inputs, and the tape records one run."""
    x, y = both(40), both(2)
    calls = []

    @ti.kernel
    def fold():
        for i in x:
            y[i % 2] += x[i] * x[i]

    def run():
        calls.append(1)
        fold()

    x.fill(0.5)
    assert ti.ad.jacobian(run, x, y).shape == (2, 40) and len(calls) == 1
    calls.clear()
    assert ti.ad.jacobian(run, y, x).shape == (40, 2) and len(calls) == 2
    calls.clear()
    band = np.eye(40, dtype=bool)
    ti.ad.jacobian(run, x, x, pattern=band)
    assert len(calls) == 2  # one colour for all, and the check of the pattern


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("mode", ["forward", "reverse"])
@pytest.mark.parametrize("n", [2, 7, 65])
def test_a_pattern_that_lacks_an_entry_is_refused(dtype, mode, n):
    ti.init(default_fp=dtype)
    x = ti.field(dtype, n, needs_grad=True, needs_dual=True)
    y = ti.field(dtype, n, needs_grad=True, needs_dual=True)

    @ti.kernel
    def run():
        for i in x:
            y[i] = ti.sin(x[i])
            if i == n - 1:
                y[i] += 0.05 * x[0]

    x.from_numpy(np.linspace(0.2, 1, n))
    whole = np.eye(n)
    whole[n - 1, 0] = 1
    found = ti.ad.jacobian(run, x, y, pattern=whole, mode=mode)
    assert found.toarray()[n - 1, 0] == pytest.approx(0.05)
    row = f"output {n - 1}" if mode == "forward" else "input 0"
    with pytest.raises(TaiAutodiffError, match=f"the pattern lacks an entry of {row}: "):
        ti.ad.jacobian(run, x, y, pattern=np.eye(n), mode=mode)


def test_a_pattern_of_a_hessian_that_lacks_an_entry_is_refused():
    x, loss = both(4), both()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += x[i] ** 3 + x[i] * x[0]

    x.fill(0.5)
    with pytest.raises(TaiAutodiffError, match="the pattern lacks an entry of input 0"):
        ti.ad.hessian(run, loss, x, pattern=np.eye(4))


def test_hessian():
    x, loss = both(12), both()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.exp(x[i])
            if i > 0:
                loss[None] += x[i] ** 2 * x[i - 1]

    values = np.linspace(-1, 1, 12)
    x.from_numpy(values)
    right = np.diag(np.exp(values))
    for i in range(1, 12):
        right[i, i] += 2 * values[i - 1]
        right[i, i - 1] += 2 * values[i]
        right[i - 1, i] += 2 * values[i]
    np.testing.assert_allclose(ti.ad.hessian(run, loss, x), right, rtol=1e-12, atol=1e-14)
    band = ti.ad.hessian(run, loss, x, pattern=right != 0)
    np.testing.assert_allclose(band.toarray(), right, rtol=1e-12, atol=1e-14)
    v = np.random.default_rng(2).standard_normal(12)
    np.testing.assert_allclose(ti.ad.hessian_operator(run, loss, x) @ v, right @ v, rtol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_columns_of_a_colour_share_no_row(seed):
    generator = np.random.default_rng(seed)
    shape = generator.integers(1, 60, 2)
    pattern = sparse.csc_array(generator.random(shape) < generator.choice([0.0, 0.02, 0.1, 0.6]))
    colours = _colour(pattern)
    assert (colours >= 0).all() and set(colours) == set(range(colours.max() + 1))
    dense = pattern.toarray()
    for colour in set(colours):
        assert dense[:, colours == colour].sum(1).max() <= 1
    # No more than the greedy bound: a column meets those with which it shares a row.
    assert colours.max() <= (((dense.T.astype(int) @ dense.astype(int)) > 0).sum(0)).max()


def test_a_band_takes_as_many_products_as_it_is_wide():
    n = 500
    band = sparse.csc_array(
        sparse.diags_array([np.ones(n)] * 5, offsets=range(-2, 3), shape=(n, n))
    )
    assert _colour(band).max() + 1 == 5


def test_mistakes(monkeypatch):
    run, x, y, _ = ring(4)
    plain, graded = ti.field(ti.f64, shape=4), ti.field(ti.f64, shape=4, needs_grad=True)
    with pytest.raises(TaiAutodiffError, match="neither duals nor gradients"):
        ti.ad.jacobian(run, plain, y)
    with pytest.raises(TaiAutodiffError, match="needs the duals of all inputs and outputs"):
        ti.ad.jacobian(run, graded, y, mode="forward")
    with pytest.raises(TaiRuntimeTypeError, match="mode is 'forward', 'reverse' or None"):
        ti.ad.jacobian(run, x, y, mode="backward")
    with pytest.raises(
        TaiRuntimeTypeError, match="shape \\(4, 3\\), but there are 4 outputs and 4"
    ):
        ti.ad.jacobian(run, x, y, pattern=np.ones((4, 3)))
    with pytest.raises(TaiRuntimeTypeError, match="the input must be a field, but got 3"):
        ti.ad.jacobian(run, 3, y)
    with pytest.raises(TaiRuntimeTypeError, match="the inputs name a field twice"):
        ti.ad.vjp(run, [x, x], y, np.ones(4))
    with pytest.raises(TaiRuntimeTypeError, match="shape \\(3,\\), but the field has \\(4,\\)"):
        ti.ad.vjp(run, x, y, np.ones(3))
    with pytest.raises(TaiRuntimeTypeError, match="1 outputs and 2 arrays"):
        ti.ad.vjp(run, x, [y], [np.ones(4), np.ones(4)])
    with pytest.raises(TaiAutodiffError, match="'counter' is of type i32, not a float"):
        counter = ti.field(ti.i32, shape=2, name="counter")
        ti.ad.jacobian(run, counter, y)
    with pytest.raises(TaiRuntimeTypeError, match="a function that launches kernels"):
        ti.ad.jacobian(3, x, y)
    with pytest.raises(TaiRuntimeTypeError, match="the outputs are an empty list"):
        ti.ad.jacobian(run, x, [])
    with pytest.raises(TaiRuntimeTypeError, match="field, but got.*ndarray") as caught:
        ti.ad.jacobian(run, ti.ndarray(ti.f64, shape=4), y)
    assert "copy the array to a field" in str(caught.value)
    for value in (np.ones(4) * 1j, ["1"] * 4, [1.0, None, 1.0, 1.0]):
        for call in (ti.ad.jvp, lambda run, x, v, y: ti.ad.vjp(run, x, y, v)):
            with pytest.raises(TaiRuntimeTypeError, match=r"must be numbers of shape \(4,\)"):
                call(run, x, value, y)
    for call in (
        lambda: ti.ad.jvp(None, x, np.ones(4), y),
        lambda: ti.ad.vjp(None, x, y, np.ones(4)),
        lambda: ti.ad.hvp(None, y, x, np.ones(4)),
        lambda: ti.ad.hessian_operator(None, y, x),
    ):
        with pytest.raises(TaiRuntimeTypeError, match="launches kernels, but got None"):
            call()
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "scipy.sparse", None)
        for call in (
            lambda: ti.ad.jacobian(run, x, y, pattern=np.ones((4, 4))),
            lambda: ti.ad.jacobian_operator(run, x, y),
        ):
            with pytest.raises(ti.TaiRuntimeError, match="s need SciPy, which is not installed"):
                call()
    # An error in the run leaves the fields as they were.
    before = x.to_numpy()

    def fails():
        x.fill(9.0)
        raise KeyError("inside")

    with pytest.raises(KeyError, match="inside"):
        ti.ad.jacobian(fails, x, y)
    np.testing.assert_array_equal(x.to_numpy(), before)


def test_fields_of_structs_are_named_by_their_members():
    body = ti.types.struct(x=ti.types.vector(2, ti.f64), m=ti.f64)
    p = body.field(shape=3, needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)

    @ti.kernel
    def run():
        for i in range(3):
            loss[None] += p[i].m * p[i].x.norm_sqr()

    x, m = np.arange(6.0).reshape(3, 2), np.arange(1.0, 4.0)
    p.x.from_numpy(x)
    p.m.from_numpy(m)
    for call in (
        lambda: ti.ad.jacobian(run, p, loss),
        lambda: ti.ad.jacobian(run, p.x, p),
        lambda: ti.ad.jvp(run, p, x, loss),
        lambda: ti.ad.vjp(run, p, loss, 1.0),
        lambda: ti.ad.hvp(run, loss, p, x),
        lambda: ti.ad.hessian(run, loss, [p.x, p]),
        lambda: ti.ad.Tape(p),
    ):
        with pytest.raises(TaiRuntimeTypeError, match="'p' is a field of structs") as caught:
            call()
        assert "[p.x, p.m]" in str(caught.value)
    by_x, by_m = ti.ad.jacobian(run, [p.x, p.m], loss)
    np.testing.assert_allclose(by_x, 2 * m[:, None] * x, atol=1e-14)
    np.testing.assert_allclose(by_m, (x**2).sum(1), atol=1e-14)
