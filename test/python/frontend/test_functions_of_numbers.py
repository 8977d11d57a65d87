"""atan, hyperbolic functions and their inverses, cbrt, erf, erfc, log10, trunc, hypot, copysign:
values and gradients against mpmath, at ordinary numbers and at the ends of domains and types."""

import math

import mpmath
import numpy as np
import pytest
import tai as ti

mpmath.mp.dps = 60
INF, NAN = math.inf, math.nan
ROOT_PI = 2 / mpmath.sqrt(mpmath.pi)

# Functions and derivatives of mpmath, and ordinary arguments.
UNARY = {
    "atan": (mpmath.atan, lambda x: 1 / (1 + x * x), (-30.0, 30.0)),
    "sinh": (mpmath.sinh, mpmath.cosh, (-20.0, 20.0)),
    "cosh": (mpmath.cosh, mpmath.sinh, (-20.0, 20.0)),
    "asinh": (mpmath.asinh, lambda x: 1 / mpmath.sqrt(1 + x * x), (-50.0, 50.0)),
    "acosh": (mpmath.acosh, lambda x: 1 / mpmath.sqrt(x * x - 1), (1.001, 50.0)),
    "atanh": (mpmath.atanh, lambda x: 1 / (1 - x * x), (-0.999, 0.999)),
    "cbrt": (
        lambda x: mpmath.sign(x) * mpmath.cbrt(abs(x)),
        lambda x: 1 / (3 * mpmath.cbrt(abs(x)) ** 2), (-90.0, 90.0),
    ),
    "erf": (mpmath.erf, lambda x: ROOT_PI * mpmath.exp(-x * x), (-3.0, 3.0)),
    "erfc": (mpmath.erfc, lambda x: -ROOT_PI * mpmath.exp(-x * x), (-3.0, 8.0)),
    "log10": (mpmath.log10, lambda x: 1 / (x * mpmath.log(10)), (1e-3, 1e3)),
    "trunc": (lambda x: mpmath.mpf(int(x)), lambda x: mpmath.mpf(0), (-9.0, 9.0)),
}  # fmt: skip
BINARY = {
    "hypot": (
        mpmath.hypot,
        lambda x, y: (x / mpmath.hypot(x, y), y / mpmath.hypot(x, y)),
    ),
    "copysign": (
        lambda x, y: abs(x) * mpmath.sign(y),
        lambda x, y: (mpmath.sign(x) * mpmath.sign(y), mpmath.mpf(0)),
    ),
}
# Values at special arguments: zeros with their signs, the ends of domains, infinities, NaN.
SPECIAL = {
    "atan": {0.0: 0.0, INF: math.pi / 2, -INF: -math.pi / 2, NAN: NAN},
    "sinh": {0.0: 0.0, INF: INF, -INF: -INF, 1e4: INF, -1e4: -INF, NAN: NAN},
    "cosh": {0.0: 1.0, INF: INF, -INF: INF, 1e4: INF, -1e4: INF, NAN: NAN},
    "asinh": {0.0: 0.0, INF: INF, -INF: -INF, NAN: NAN},
    "acosh": {1.0: 0.0, 0.99: NAN, -2.0: NAN, INF: INF, -INF: NAN, NAN: NAN},
    "atanh": {0.0: 0.0, 1.0: INF, -1.0: -INF, 1.5: NAN, INF: NAN, NAN: NAN},
    "cbrt": {0.0: 0.0, 27.0: 3.0, -8.0: -2.0, INF: INF, -INF: -INF, NAN: NAN},
    "erf": {0.0: 0.0, INF: 1.0, -INF: -1.0, 40.0: 1.0, NAN: NAN},
    "erfc": {0.0: 1.0, INF: 0.0, -INF: 2.0, 40.0: 0.0, NAN: NAN},
    "log10": {1.0: 0.0, 1000.0: 3.0, 0.0: -INF, -1.0: NAN, INF: INF, NAN: NAN},
    "trunc": {0.0: 0.0, -0.7: -0.0, 0.7: 0.0, -2.5: -2.0, 1e30: 1e30, INF: INF,
              -INF: -INF, NAN: NAN},
}  # fmt: skip
SPECIAL_PAIRS = {
    "hypot": {(3.0, -4.0): 5.0, (0.0, 0.0): 0.0, (INF, 1.0): INF, (-1.0, -INF): INF},
    "copysign": {(1.0, -0.0): -1.0, (-2.0, 0.0): 2.0, (0.0, -3.0): -0.0, (INF, -1.0): -INF,
                 (3.0, -INF): -3.0, (-0.0, 1.0): 0.0},
}  # fmt: skip
TYPES = {"f32": (ti.f32, np.float32), "f64": (ti.f64, np.float64)}


def launch(name, dtype, arguments):
    """Values, and the gradients of their sum, of a function of one or two fields."""
    function = getattr(ti, name)
    count = len(arguments[0])
    fields = [ti.field(dtype, shape=count, needs_grad=True) for _ in arguments]
    result = ti.field(dtype, shape=count, needs_grad=True)
    for field, values in zip(fields, arguments, strict=True):
        field.from_numpy(np.asarray(values, dtype.numpy))
    first, last = fields[0], fields[-1]

    @ti.kernel
    def apply():
        for i in result:
            if ti.static(len(fields) == 1):
                result[i] = function(first[i])
            else:
                result[i] = function(first[i], last[i])

    apply()
    result.grad.fill(1.0)
    apply.grad()
    return result.to_numpy(), [field.grad.to_numpy() for field in fields]


def check(found, exact, numpy, units):
    """The exact numbers are of mpmath; infinite where the type is too narrow."""
    wanted = np.array([float(x) for x in exact])
    with np.errstate(over="ignore"):
        unit = np.spacing(np.abs(wanted).astype(numpy)).astype(np.float64)
    distance = [abs(mpmath.mpf(float(a)) - b) for a, b in zip(found, exact, strict=True)]
    worst = max(float(d) / u for d, u in zip(distance, unit, strict=True))
    assert worst <= units, f"{worst} units in the last place"


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("name", UNARY)
def test_values_and_gradients(name, kind):
    dtype, numpy = TYPES[kind]
    ti.init(arch=ti.cpu, default_fp=dtype)
    value, slope, (low, high) = UNARY[name]
    x = np.random.default_rng(4).uniform(low, high, 300).astype(numpy)
    found, (gradient,) = launch(name, dtype, [x])
    exact = [mpmath.mpf(float(v)) for v in x]
    check(found, [value(v) for v in exact], numpy, 4)
    # Derivatives round in several steps, and 1 - x² loses some digits at 0.999.
    check(gradient, [slope(v) for v in exact], numpy, 8 if name != "erfc" else 80)


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("name", BINARY)
def test_functions_of_two(name, kind):
    dtype, numpy = TYPES[kind]
    ti.init(arch=ti.cpu, default_fp=dtype)
    value, slopes = BINARY[name]
    x, y = np.random.default_rng(4).normal(size=(2, 300)).astype(numpy)
    found, gradients = launch(name, dtype, [x, y])
    exact = [(mpmath.mpf(float(a)), mpmath.mpf(float(b))) for a, b in zip(x, y, strict=True)]
    check(found, [value(*v) for v in exact], numpy, 2)
    for which, gradient in enumerate(gradients):
        check(gradient, [slopes(*v)[which] for v in exact], numpy, 4)


def same(found, wanted, numpy):
    wanted = np.asarray(wanted, numpy)
    np.testing.assert_allclose(found, wanted, rtol=4 * np.finfo(numpy).eps, atol=0)
    numbers = ~np.isnan(wanted)
    np.testing.assert_array_equal(np.signbit(found)[numbers], np.signbit(wanted)[numbers])


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("name", SPECIAL)
def test_special_arguments(name, kind):
    dtype, numpy = TYPES[kind]
    ti.init(arch=ti.cpu, default_fp=dtype)
    # 0.0 and -0.0 are one key: odd functions keep the sign.
    pairs = [*SPECIAL[name].items()]
    if 0.0 in SPECIAL[name]:
        at_zero = SPECIAL[name][0.0]
        odd = name not in ("cosh", "erfc", "log10")
        pairs = [(x, y) for x, y in pairs if x != 0]
        pairs += [
            (0.0, abs(at_zero) if odd else at_zero),
            (-0.0, -abs(at_zero) if odd else at_zero),
        ]
    x, wanted = zip(*pairs, strict=True)
    found, _ = launch(name, dtype, [x])
    same(found, wanted, numpy)
    # In Python, and as constants of a kernel, which the compiler folds.
    function = getattr(ti, name)
    same(np.array([function(v) for v in x]), wanted, np.float64)
    y = ti.field(dtype, shape=len(x))

    @ti.kernel
    def constants():
        for k in ti.static(range(len(x))):
            y[k] = function(ti.cast(x[k], dtype))

    constants()
    same(y.to_numpy(), wanted, numpy)


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("name", SPECIAL_PAIRS)
def test_special_pairs(name, kind):
    dtype, numpy = TYPES[kind]
    ti.init(arch=ti.cpu, default_fp=dtype)
    arguments = np.array([*SPECIAL_PAIRS[name]])
    wanted = [*SPECIAL_PAIRS[name].values()]
    found, _ = launch(name, dtype, arguments.T)
    same(found, wanted, numpy)
    function = getattr(ti, name)
    same(np.array([function(*pair) for pair in arguments.tolist()]), wanted, np.float64)


@pytest.mark.parametrize("kind", TYPES)
def test_far_and_near(kind):
    """Neither values nor slopes overflow or vanish on the way."""
    dtype, numpy = TYPES[kind]
    ti.init(arch=ti.cpu, default_fp=dtype)
    large, small = float(np.finfo(numpy).max) / 4, float(np.finfo(numpy).tiny) * 4
    found, (by_x, by_y) = launch("hypot", dtype, [[large, small, 0.0], [large, -small, 0.0]])
    root = math.sqrt(2)
    np.testing.assert_allclose(found, [large * root, small * root, 0.0], rtol=1e-6)
    np.testing.assert_allclose(by_x, [1 / root, 1 / root, 0.0], rtol=1e-6)
    np.testing.assert_allclose(by_y, [1 / root, -1 / root, 0.0], rtol=1e-6)
    for name in ("asinh", "acosh"):
        found, (slope,) = launch(name, dtype, [[large]])
        assert found[0] == pytest.approx(math.log(large) + math.log(2), rel=1e-6)
        assert slope[0] == pytest.approx(1 / large, rel=1e-6)
    found, (slope,) = launch("asinh", dtype, [[small]])
    assert (found[0], slope[0]) == (numpy(small), 1.0)
    found, (slope,) = launch("cbrt", dtype, [[large, -small]])
    np.testing.assert_allclose(found, [np.cbrt(large), -np.cbrt(small)], rtol=1e-6)
    np.testing.assert_allclose(slope, [found[0] / large / 3, -found[1] / small / 3], rtol=1e-6)


@pytest.mark.parametrize("name", ["acosh", "atanh", "cbrt", "log10"])
def test_no_gradient_where_none_is_asked_for(name):
    """At the ends of their domains the slopes are infinite, but nothing times that is nothing."""
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    end = {"acosh": 1.0, "atanh": 1.0, "cbrt": 0.0, "log10": 0.0}[name]
    function = getattr(ti, name)
    x = ti.field(ti.f64, shape=2, needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.array([end, 1.0]))

    @ti.kernel
    def choose():
        y[None] = ti.select(x[1] > 5, function(x[0]), 2 * x[1])

    choose()
    y.grad[None] = 1
    choose.grad()
    assert x.grad.to_numpy().tolist() == [0.0, 2.0]
    _, (slope,) = launch(name, ti.f64, [[end]])
    assert slope[0] == INF


def test_vectors_whole_numbers_and_constants():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    v = ti.Vector.field(3, ti.f64, shape=(), needs_grad=True)
    w = ti.Vector.field(3, ti.f64, shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    V, W = np.array([3.0, -0.5, 2.0]), np.array([-4.0, 0.25, 1.5])
    v.from_numpy(V)
    w.from_numpy(W)

    @ti.kernel
    def sum_up():
        a, b = v[None], w[None]
        loss[None] += (ti.hypot(a, b) + ti.erf(a) * ti.copysign(a, b) + ti.hypot(a, 2)).sum()

    with ti.ad.Tape(loss):
        sum_up()
    erf = np.array([math.erf(x) for x in V])
    exact = np.hypot(V, W) + erf * np.copysign(V, W) + np.hypot(V, 2)
    assert loss[None] == pytest.approx(exact.sum(), rel=1e-14)
    by_v = V / np.hypot(V, W) + V / np.hypot(V, 2) + erf * np.sign(V * W)
    by_v += 2 / math.sqrt(math.pi) * np.exp(-V * V) * np.copysign(V, W)
    np.testing.assert_allclose(v.grad.to_numpy(), by_v, rtol=1e-13)
    np.testing.assert_allclose(w.grad.to_numpy(), W / np.hypot(V, W), rtol=1e-13)

    @ti.kernel
    def of_whole_numbers(a: ti.i32, b: ti.i32) -> ti.types.vector(5, ti.f64):
        return ti.Vector(
            [
                ti.hypot(a, b),
                ti.copysign(a, b),
                ti.atan(a),
                ti.trunc(7 / b),
                ti.trunc(7 / b, ti.i32),
            ]
        )

    expected = [5.0, -3.0, math.atan(3), -1.0, -1.0]
    np.testing.assert_allclose(of_whole_numbers(3, -4), expected, rtol=1e-15)
    # In Python a vector is one of default_fp.
    np.testing.assert_allclose(ti.hypot(ti.Vector([3, 1]), 4), [5, math.sqrt(17)], rtol=1e-15)
    np.testing.assert_allclose(ti.copysign(ti.Vector([3.0, 1.0]), ti.Vector([-1, 1])), [-3, 1])
    np.testing.assert_allclose(ti.cbrt(ti.Vector([8.0, -27.0])), [2, -3], rtol=1e-15)


def test_functions_of_pythons_math():
    """Kernels take them too, as they take math.sin."""
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    names = """asinh atanh exp2 expm1 log2 log10 log1p cbrt erf erfc atan sinh cosh trunc""".split()

    @ti.kernel
    def one(a: ti.f64) -> ti.types.vector(14, ti.f64):
        return ti.Vector([getattr(math, name)(a) for name in ti.static(names)])

    @ti.kernel
    def two(a: ti.f64, b: ti.f64) -> ti.types.vector(3, ti.f64):
        return ti.Vector([math.hypot(a, b), math.copysign(a, b), math.acosh(a - b)])

    np.testing.assert_allclose(one(0.4), [getattr(math, n)(0.4) for n in names], rtol=1e-15)
    wanted = [math.hypot(0.4, -0.7), -0.4, math.acosh(1.1)]
    np.testing.assert_allclose(two(0.4, -0.7), wanted, rtol=1e-14)


@pytest.mark.parametrize("name", ["acosh", "atanh", "log10"])
def test_debug_names_the_argument_outside_of_the_domain(name):
    ti.init(arch=ti.cpu, default_fp=ti.f64, debug=True)
    outside = {"acosh": 0.5, "atanh": -1.5, "log10": -2.5}[name]
    function = getattr(ti, name)

    @ti.kernel
    def apply(x: ti.f64) -> ti.f64:
        return function(x)

    with pytest.raises(ti.TaiAssertionError, match=f"{outside:g} does not exist"):
        apply(outside)


@pytest.mark.parametrize("name", ["floor", "ceil", "round", "trunc", "rsqrt", "sinh"])
def test_python_and_kernels_agree(name):
    """At infinities, NaN, zeros and just below one half, where Python's own functions raise."""
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x = np.array([0.0, -0.0, INF, -INF, NAN, 0.49999999999999994, -0.5, 2.5, -2.5, 1e300, -1e3])
    found, _ = launch(name, ti.f64, [x])
    same(np.array([getattr(ti, name)(float(v)) for v in x]), found, np.float64)


def test_bad_arguments():
    ti.init(arch=ti.cpu)
    with pytest.raises(ti.TaiTypeError, match="ti.erf takes numbers"):
        ti.erf("1")

    @ti.kernel
    def three(a: ti.f32) -> ti.f32:
        return math.hypot(a, a, a)

    with pytest.raises(ti.TaiTypeError, match="hypot"):
        three(1.0)
