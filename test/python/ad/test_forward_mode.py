"""Forward mode against reverse mode, closed forms and NumPy.

Tangent and gradient come from one table read in two directions, so they agree to rounding:
the tangent of a loss along a direction is the dot product of gradient and direction.
"""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import tai as ti
from tai._impl.base import state

N = 7
PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "derivatives.md"


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def both(shape=(), dtype=ti.f64, name=None):
    return ti.field(dtype, shape=shape, needs_grad=True, needs_dual=True, name=name)


def compare_modes(loss, inputs, run, tolerance=1e-12, seed=0):
    """The dot-product test: the derivative along a direction, forward and by the gradient."""
    generator = np.random.default_rng(seed)
    directions = [generator.standard_normal(x.to_numpy().shape) for x in inputs]
    starts = [x.to_numpy() for x in inputs]

    def start():
        for x, values in zip(inputs, starts, strict=True):
            x.from_numpy(values)
        loss[None] = 0
        run()

    tangent = float(ti.ad.jvp(start, list(inputs), directions, loss))
    for x, values in zip(inputs, starts, strict=True):
        x.from_numpy(values)
    with ti.ad.Tape(loss):
        run()
    products = [x.grad.to_numpy() * d for x, d in zip(inputs, directions, strict=True)]
    expected = sum(float(p.sum()) for p in products)
    size = sum(float(abs(p).sum()) for p in products) or 1.0
    assert abs(tangent - expected) <= tolerance * size, (tangent, expected)
    return tangent, directions


# Scalar ops


def op(name):
    """A function that becomes one op of the IR in a kernel."""
    return lambda *args: state.emitter.elementwise(
        name, [state.emitter.as_value(a) for a in args], state.emitter.as_value(args[0]).dt
    )


def truth(name):
    """A test for floats, which chooses between two values."""

    def function(x, y):
        emitter = state.emitter
        test = emitter.elementwise(name, [emitter.as_value(x)], ti.u1)
        return ti.select(test, x * y, x + y)

    return function


# For each row of the table a function of x in (0.2, 0.9) and y in (1.1, 1.9).
SCALAR = {
    "arith.addf": lambda x, y: x + y,
    "arith.subf": lambda x, y: x - y,
    "arith.negf": lambda x, y: -x * y,
    "arith.mulf": lambda x, y: x * y,
    "arith.divf": lambda x, y: x / y,
    "arith.remf": lambda x, y: op("arith.remf")(7.3 * x, y),
    "math.fma": lambda x, y: op("math.fma")(x, y, x * x),
    "vector.fma": lambda x, y: op("vector.fma")(ti.Vector([x, y]), ti.Vector([y, y]),
                                                ti.Vector([x, x])).sum(),
    "arith.select": lambda x, y: ti.select(x > 0.5, x * y, ti.sin(x)),
    "arith.maximumf": lambda x, y: op("arith.maximumf")(2 * x, y),
    "arith.minimumf": lambda x, y: op("arith.minimumf")(2 * x, y),
    "arith.maxnumf": lambda x, y: op("arith.maxnumf")(2 * x, y),
    "arith.minnumf": lambda x, y: op("arith.minnumf")(2 * x, y),
    "math.clampf": lambda x, y: op("math.clampf")(x * 2, 0.5 * y, y),
    "math.absf": lambda x, y: abs(x - 0.5) * y,
    "math.copysign": lambda x, y: op("math.copysign")(x, y - 1.5),
    "arith.extf": lambda x, y: ti.cast(ti.cast(x, ti.f32), ti.f64) * y,
    "arith.truncf": lambda x, y: ti.cast(ti.cast(x * y, ti.f32) * 2, ti.f64),
    "arith.fptosi": lambda x, y: x * ti.cast(y * 10, ti.i32),
    "arith.fptoui": lambda x, y: x * ti.cast(y * 10, ti.u32),
    "arith.cmpf": lambda x, y: x * ti.cast(x < 0.5, ti.i32) + y,
    "math.ceil": lambda x, y: x * op("math.ceil")(y * 3),
    "math.floor": lambda x, y: x * op("math.floor")(y * 3),
    "math.round": lambda x, y: x * op("math.round")(y * 3),
    "math.roundeven": lambda x, y: x * op("math.roundeven")(y * 3),
    "math.trunc": lambda x, y: x * op("math.trunc")(y * 3),
    "math.isfinite": truth("math.isfinite"),
    "math.isnan": truth("math.isnan"),
    "math.powf": lambda x, y: op("math.powf")(x, y),
    "math.fpowi": lambda x, y: op("math.fpowi")(x, 3) + op("math.fpowi")(y, -2),
    "math.atan2": lambda x, y: op("math.atan2")(x, y - 1.5),
    "math.acosh": lambda x, y: op("math.acosh")(y) * x,
}  # fmt: skip
UNARY = [
    "sqrt", "rsqrt", "cbrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin",
    "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "atanh", "erf", "erfc",
]  # fmt: skip
for unary in UNARY:
    SCALAR[f"math.{unary}"] = lambda x, y, name=f"math.{unary}": op(name)(x) * y


# Their rows say that the derivative is zero. Nothing lowers them, so nothing can use them.
NOT_LOWERED = {"math.isinf", "math.isnormal"}


def table_rows():
    table = PAGE.read_text().split("<!-- table: begin -->")[1].split("<!-- table: end")[0]
    return re.findall(r"^\| `([a-z0-9.]+)` \|", table, re.MULTILINE)


def test_every_scalar_rule_is_tested():
    assert set(table_rows()) == set(SCALAR) | NOT_LOWERED


def run_scalar(function, dtype):
    x, y = both(N, dtype), both(N, dtype)
    loss = both((), dtype)

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += (i + 1) * function(x[i], y[i])

    generator = np.random.default_rng(2)
    x.from_numpy(generator.uniform(0.2, 0.9, N))
    y.from_numpy(generator.uniform(1.1, 1.9, N))
    return loss, [x, y], kernel


@pytest.mark.parametrize("name", SCALAR)
def test_scalar_rules(name):
    loss, inputs, kernel = run_scalar(SCALAR[name], ti.f64)
    if name in ("arith.extf", "arith.truncf"):
        compare_modes(loss, inputs, kernel, tolerance=1e-6)  # through f32
        return
    tangent, directions = compare_modes(loss, inputs, kernel)
    # And against central differences, which know neither mode.
    starts = [x.to_numpy() for x in inputs]

    def value(step):
        for x, start, direction in zip(inputs, starts, directions, strict=True):
            x.from_numpy(start + step * direction)
        loss[None] = 0
        kernel()
        return loss[None]

    h = 1e-4
    coarse = (value(h) - value(-h)) / (2 * h)
    fine = (value(h / 2) - value(-h / 2)) / h
    assert tangent == pytest.approx((4 * fine - coarse) / 3, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("name", SCALAR)
def test_scalar_rules_in_single_precision(name):
    ti.init(default_fp=ti.f32, offline_cache=False)
    loss, inputs, kernel = run_scalar(SCALAR[name], ti.f32)
    compare_modes(loss, inputs, kernel, tolerance=1e-5)


# Kinks: one tangent each, by the convention of the gradient.

KINKS = {
    "abs": (lambda x, y: abs(x), 0, 0, 0.0, 0.0),
    "max tie": (lambda x, y: ti.max(x, y), 1, 1, 0.0, 1.0),
    "min tie": (lambda x, y: ti.min(x, y), 1, 1, 0.0, 1.0),
    "x sqrt x": (lambda x, y: x * ti.sqrt(x), 0, 0, 0.0, 0.0),
    "atan2": (lambda x, y: ti.atan2(x, y), 0, 0, 0.0, 0.0),
    "power 0 0": (lambda x, y: op("math.powf")(x, y), 0, 0, 0.0, 0.0),
    "power of 0": (lambda x, y: op("math.powf")(x, y), 0, 2, 0.0, 0.0),
    "guarded root": (lambda x, y: ti.select(x > 0, ti.sqrt(x), 0.0), -1, 0, 0.0, 0.0),
    "guarded root at 0": (lambda x, y: ti.select(x > 0, ti.sqrt(x), 0.0), 0, 0, 0.0, 0.0),
    "saturated": (lambda x, y: 1 / (1 + ti.exp(-x)), -800, 0, 0.0, 0.0),
    "clamp": (lambda x, y: ti.math.clamp(x, 0.0, 1.0), 1, 0, 1.0, 0.0),
    "norm": (lambda x, y: ti.Vector([x, y]).norm(), 0, 0, 0.0, 0.0),
    "normalized": (lambda x, y: ti.Vector([x, y]).normalized().sum(), 0, 0, 0.0, 0.0),
    "root of zero unused": (lambda x, y: ti.sqrt(x) * 0 + y, 0, 1, 0.0, 1.0),
    "zero factor": (lambda x, y: ti.Vector([ti.sqrt(x), y]).dot(ti.Vector([x, y])), 0, 2, 0.0, 4.0),
    "zero row": (lambda x, y: (ti.Matrix([[x, 0.0], [y, 1.0]]) @ ti.Vector([ti.sqrt(x), y]))[0],
                 0, 1, 0.0, 0.0),
    "rounding": (lambda x, y: ti.floor(x) + ti.round(y), 1, 0.5, 0.0, 0.0),
    "remainder": (lambda x, y: x % y, 5.5, 2, 1.0, -2.0),
}  # fmt: skip


@pytest.mark.parametrize("name", KINKS)
def test_kinks(name):
    function, x0, y0, by_x, by_y = KINKS[name]
    x, y, loss = both(), both(), both()

    @ti.kernel
    def kernel():
        loss[None] = function(x[None], y[None])

    x[None], y[None] = x0, y0
    assert ti.ad.jvp(kernel, x, 1.0, loss) == by_x
    assert ti.ad.jvp(kernel, y, 1.0, loss) == by_y
    with ti.ad.Tape(loss):
        kernel()
    assert (x.grad[None], y.grad[None]) == (by_x, by_y)


@pytest.mark.parametrize("name", ["asinh", "acosh"])
@pytest.mark.parametrize(("dtype", "rtol"), [(ti.f64, 1e-15), (ti.f32, 4e-7)])
def test_slopes_whose_squares_overflow(name, dtype, rtol):
    """1 / x where x^2 is infinite: values and slopes on both sides of the overflow."""
    function = op(f"math.{name}")
    numbers = np.array([1.5, 1e3, 2.0**30, 2.0**30 * 1.5, 1e18, 1e20, 1e37, *[1e160, 1e300]
                        * (dtype is ti.f64)]).astype(dtype.numpy)  # fmt: skip
    x, y = both(len(numbers), dtype), both(len(numbers), dtype)
    x.from_numpy(numbers)

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = function(x[i])

    y.grad.fill(1.0)
    kernel.grad()
    one = {"asinh": 1, "acosh": -1}[name]
    exact = [1 / math.hypot(v, 1) if one == 1 else 1 / (math.sqrt(v - 1) * math.sqrt(v + 1))
             for v in numbers.tolist()]  # fmt: skip
    np.testing.assert_allclose(x.grad.to_numpy(), exact, rtol=rtol)
    with ti.ad.FwdMode(loss=y, param=x, seed=[1.0] * len(numbers)):
        kernel()
    np.testing.assert_allclose(y.dual.to_numpy(), exact, rtol=rtol)


def test_root_of_zero_has_an_infinite_tangent():
    x, loss = both(), both()

    @ti.kernel
    def kernel():
        loss[None] = ti.sqrt(x[None])

    assert ti.ad.jvp(kernel, x, 1.0, loss) == math.inf
    assert ti.ad.jvp(kernel, x, 0.0, loss) == 0.0


# Matrices


def singular_values(a, u):
    p, s, q = ti.svd(a)
    return s[0, 0] * 2 + s[1, 1] ** 2 + p[0, 1] * q[1, 0]


def rotation(a, u):
    r, s = ti.polar_decompose(a)
    return (r @ u)[0] + s[0, 1] * s[1, 1]


def eigenvectors(a, u):
    values, vectors = ti.sym_eig(a.transpose() @ a)
    return values[0] * 3 + values[1] + (vectors[:, 1] * u)[0] ** 2


MATRIX = {
    "arithmetic": lambda a, u: (a * a + 2 * a - 1 / (a + 5)).sum(),
    "product": lambda a, u: (a @ a @ u).dot(u),
    "transpose": lambda a, u: (a.transpose() @ a).trace(),
    "determinant": lambda a, u: a.determinant() ** 2,
    "inverse": lambda a, u: (a.inverse() @ u).dot(u),
    "norm": lambda a, u: u.norm() + a.norm() + u.norm(0.5),
    "normalized": lambda a, u: (a @ u.normalized())[0] + u.normalized(0.1)[1],
    "outer": lambda a, u: (u.outer_product(a @ u) * a).sum(),
    "components": lambda a, u: a[0, 1] * u[1] + a[1, :].dot(u) + u.yx.x,
    "functions": lambda a, u: (ti.sin(a) * ti.exp(a * 0.3)).sum() + ti.sqrt(u * u + 1).sum(),
    "extremes": lambda a, u: a.max() * u.min() + ti.max(u, 0.3).sum(),
    "built": lambda a, u: ti.Matrix([[u[0], a[0, 0]], [1.0, u[1]]]).determinant(),
    "solve": lambda a, u: ti.solve(a, u).dot(u),
    "svd": ti.func(singular_values),
    "polar": ti.func(rotation),
    "sym_eig": ti.func(eigenvectors),
}


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("name", MATRIX)
def test_matrices(name, size):
    if size == 3 and name in ("built", "components"):
        pytest.skip("of two dimensions")
    function = MATRIX[name]
    a = ti.Matrix.field(size, size, ti.f64, shape=5, needs_grad=True, needs_dual=True)
    u = ti.Vector.field(size, ti.f64, shape=5, needs_grad=True, needs_dual=True)
    loss = both()

    @ti.kernel
    def kernel():
        for i in a:
            loss[None] += (i + 1) * function(a[i], u[i])

    generator = np.random.default_rng(3)
    a.from_numpy(generator.uniform(0.2, 0.9, (5, size, size)) + 1.5 * np.eye(size)
                 + np.diag(np.arange(size)))  # fmt: skip
    u.from_numpy(generator.uniform(0.5, 1.5, (5, size)))
    compare_modes(loss, [a, u], kernel, tolerance=1e-11)


@pytest.mark.parametrize("order", [ti.Layout.AOS, ti.Layout.SOA])
def test_duals_of_vectors(order):
    v = ti.Vector.field(2, ti.f64, shape=3, needs_dual=True, layout=order)
    w = ti.Vector.field(2, ti.f64, shape=3, needs_dual=True, layout=order)

    @ti.kernel
    def kernel():
        for i in v:
            w[i] = ti.Vector([v[i].y * v[i].x, 3 * v[i].x])
            w[i][1] += v[i].y

    values = np.arange(6.0).reshape(3, 2)
    v.from_numpy(values)
    direction = np.array([[1, 0], [0, 1], [2, -1.0]])
    with ti.ad.FwdMode(loss=w, param=v, seed=direction):
        kernel()
    x, y = values.T
    dx, dy = direction.T
    np.testing.assert_allclose(w.dual.to_numpy(), np.stack([dy * x + y * dx, 3 * dx + dy], 1))
    assert w.dual[2][1] == 5.0
    assert not v.dual.to_numpy().any()
