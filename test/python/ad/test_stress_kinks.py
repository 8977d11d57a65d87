"""The conventions of docs/reference/derivatives.md at kinks and singular points, one by one."""

import math

import numpy as np
import pytest
import tai as ti

from derivatives import MODES, derive

INF, NAN = math.inf, math.nan


@ti.func
def root_of_positive(x):
    y = 0.0 * x
    if x > 0:
        y = ti.sqrt(x)
    return y


@ti.func
def python_max(x):
    return max(0.0, x)


@ti.func
def max_with_branch(x):
    zero = 0.0
    if x > 5:
        zero = 0.0
    return ti.max(zero, x)


@ti.func
def max_with_loop(x):
    zero = 1.0
    for _ in range(3):
        zero = 0.0
    return ti.max(zero, x)


# Label, function of a vector, point, value and gradient: exact.
EXACT = [
    ("sqrt(0)", lambda x: ti.sqrt(x[0]), [0], 0, [INF]),
    ("0 sqrt(0)", lambda x: 0.0 * ti.sqrt(x[0]) + x[0], [0], 0, [1]),
    ("x sqrt(x)", lambda x: x[0] * ti.sqrt(x[0]), [0], 0, [0]),
    ("rsqrt(0), unused", lambda x: ti.select(x[0] > 0, ti.rsqrt(x[0]), 1.0), [0], 1, [0]),
    ("norm(0)", lambda x: x.norm(), [0, 0, 0], 0, [0, 0, 0]),
    ("norm squared", lambda x: x.norm() ** 2, [0, 0, 0], 0, [0, 0, 0]),
    ("normalized(0)", lambda x: x.normalized().sum(), [0, 0, 0], 0, [0, 0, 0]),
    ("distance(0)", lambda x: ti.math.distance(x, 2 * x), [0, 0], 0, [0, 0]),
    ("abs(0)", lambda x: abs(x[0]), [0], 0, [0]),
    ("abs(-0)", lambda x: abs(x[0]), [-0.0], 0, [0]),
    ("max(x, 0)", lambda x: ti.max(x[0], 0.0), [0], 0, [0]),
    ("max(0, x)", lambda x: ti.max(0.0, x[0]), [0], 0, [1]),
    ("min(x, 0)", lambda x: ti.min(x[0], 0.0), [0], 0, [0]),
    ("min(0, x)", lambda x: ti.min(0.0, x[0]), [0], 0, [1]),
    ("max, tie", lambda x: ti.max(x[0], x[1]), [1, 1], 1, [0, 1]),
    ("min, tie", lambda x: ti.min(x[0], x[1]), [1, 1], 1, [0, 1]),
    ("max(x, 0), whole", lambda x: ti.max(x[0], 0), [0], 0, [0]),
    ("max(0, x), whole", lambda x: ti.max(0, x[0]), [0], 0, [1]),
    ("max(-0., x)", lambda x: ti.max(-0.0, x[0]), [0], 0, [1]),
    ("max(cast, x)", lambda x: ti.max(ti.cast(0, ti.f32), x[0]), [0], 0, [1]),
    ("max of three, x first", lambda x: ti.max(x[0], 0.0, -1.0), [0], 0, [0]),
    ("max of three, x second", lambda x: ti.max(0.0, x[0], -1.0), [0], 0, [1]),
    ("max of three, x last", lambda x: ti.max(-1.0, 0.0, x[0]), [0], 0, [1]),
    ("max(vector, 0)", lambda x: ti.max(x, 0.0).sum(), [0, 0], 0, [0, 0]),
    ("max(0, vector)", lambda x: ti.max(0.0, x).sum(), [0, 0], 0, [1, 1]),
    ("max(zeros, vector)", lambda x: ti.max(ti.Vector([0.0, 0.0]), x).sum(), [0, 0], 0, [1, 1]),
    ("max(vector, zeros)", lambda x: ti.max(x, ti.Vector([0.0, 0.0])).sum(), [0, 0], 0, [0, 0]),
    ("min(numbers, vector)", lambda x: ti.min(ti.Vector([0.0, 1.0]), x).sum(), [0, 1], 1, [1, 1]),
    (
        "max(matrix, matrix)",
        lambda x: ti.max(ti.Matrix([[0.0, 1.0]]), ti.Matrix([[x[0], x[1]]])).sum(),
        [0, 1],
        1,
        [1, 1],
    ),
    ("Python's max(0, x)", lambda x: python_max(x[0]), [0], 0, [1]),
    ("ti.math.max(0, x)", lambda x: ti.math.max(0.0, x[0]), [0], 0, [1]),
    ("max(zero in a branch, x)", lambda x: max_with_branch(x[0]), [0], 0, [1]),
    ("max(zero in a loop, x)", lambda x: max_with_loop(x[0]), [0], 0, [1]),
    (
        "max(x, y) and max(y, x)",
        lambda x: ti.max(x[0], x[1]) + 10 * ti.max(x[1], x[0]),
        [1, 1],
        11,
        [10, 1],
    ),
    (
        "min(x, y) and min(y, x)",
        lambda x: ti.min(x[0], x[1]) + 10 * ti.min(x[1], x[0]),
        [1, 1],
        11,
        [10, 1],
    ),
    ("components, 0 last", lambda x: ti.Vector([x[0], 0.0]).max(), [0], 0, [0]),
    ("components, 0 first", lambda x: ti.Vector([0.0, x[0]]).max(), [0], 0, [1]),
    ("-min(-x, 0)", lambda x: -ti.min(-x[0], 0.0), [0], 0, [0]),
    ("select, x > 0", lambda x: ti.select(x[0] > 0, x[0], 0.0), [0], 0, [0]),
    ("select, x >= 0", lambda x: ti.select(x[0] >= 0, x[0], 0.0), [0], 0, [1]),
    ("x (x > 0)", lambda x: x[0] * (x[0] > 0), [0], 0, [0]),
    ("(x + abs x) / 2", lambda x: 0.5 * (x[0] + abs(x[0])), [0], 0, [0.5]),
    ("max(NaN, x)", lambda x: ti.max(x[1] * NAN, x[0]), [2, 1], 2, [1, 0]),
    ("max(x, NaN)", lambda x: ti.max(x[0], x[1] * NAN), [2, 1], 2, [1, 0]),
    ("max of components, tie", lambda x: x.max(), [1, 1, 1], 1, [0, 0, 1]),
    ("clamp, low", lambda x: ti.math.clamp(x[0], 0.0, 1.0), [0], 0, [1]),
    ("clamp, high", lambda x: ti.math.clamp(x[0], 0.0, 1.0), [1], 1, [1]),
    ("clamp, outside", lambda x: ti.math.clamp(x[0], 0.0, 1.0), [2], 1, [0]),
    ("atan2(0, 0)", lambda x: ti.atan2(x[0], x[1]), [0, 0], 0, [0, 0]),
    ("pow(0, 0)", lambda x: x[0] ** x[1], [0, 0], 1, [0, 0]),
    ("pow(0, 2)", lambda x: x[0] ** x[1], [0, 2], 0, [0, 0]),
    # A power of a negative base has no derivative by its exponent; variables that the exponent does
    # not depend on have zero.
    ("pow(-2, 0 y)", lambda x: x[0] ** (x[1] * x[2]), [-2, 0, 1], 1, [0, NAN, 0]),
    ("pow(-2, y 0)", lambda x: x[0] ** (x[1] * x[2]), [-2, 1, 0], 1, [0, 0, NAN]),
    ("pow(-2, 2)", lambda x: x[0] ** x[1], [-2, 2], 4, [-4, NAN]),
    ("x ** 0", lambda x: x[0] ** 0, [0], 1, [0]),
    ("x ** 1", lambda x: x[0] ** 1, [0], 0, [1]),
    ("x ** 2", lambda x: x[0] ** 2, [0], 0, [0]),
    ("x ** 2.0", lambda x: x[0] ** 2.0, [-3], 9, [-6]),
    ("acos(1)", lambda x: ti.acos(x[0]), [1], 0, [-INF]),
    ("acos(1), unused", lambda x: 0.0 * ti.acos(x[0]) + 1.0, [1], 1, [0]),
    ("asin(1), unused", lambda x: ti.select(x[0] < 1, ti.asin(x[0]), 0.0), [1], 0, [0]),
    (
        "masked root, -1",
        lambda x: ti.select(x[0] > 0, ti.sqrt(x[0]), 0.0),
        [-1],
        0,
        [0],
    ),
    ("masked root, 0", lambda x: ti.select(x[0] > 0, ti.sqrt(x[0]), 0.0), [0], 0, [0]),
    ("masked log", lambda x: ti.select(x[0] > 0, ti.log(x[0]), 0.0), [-1], 0, [0]),
    ("masked quotient", lambda x: ti.select(x[0] != 0, 1 / x[0], 0.0), [0], 0, [0]),
    ("branch", lambda x: root_of_positive(x[0]), [-1], 0, [0]),
    ("sigmoid", lambda x: 1 / (1 + ti.exp(-x[0])), [-800], 0, [0]),
    ("sigmoid, saturated", lambda x: 1 / (1 + ti.exp(-x[0])), [800], 1, [0]),
    ("remainder", lambda x: x[0] % x[1], [5.5, 2], 1.5, [1, -2]),
    ("remainder, negative", lambda x: x[0] % x[1], [-5.5, 2], 0.5, [1, 3]),
    ("mod", lambda x: ti.math.mod(x[0], x[1]), [5.5, 2], 1.5, [1, -2]),
    ("floor", lambda x: ti.floor(x[0]) * x[0], [2], 4, [2]),
    ("round", lambda x: ti.round(x[0]), [0.5], 1, [0]),
    ("cast", lambda x: ti.cast(ti.cast(x[0], int), float) * x[0], [2.5], 5, [2]),
    ("sign", lambda x: ti.math.sign(x[0]), [0], 0, [0]),
    ("step", lambda x: ti.math.step(0.0, x[0]), [0], 1, [0]),
]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("row", EXACT, ids=[row[0] for row in EXACT])
def test_exact(row, dtype, mode):
    _, function, at, value, gradient = row
    found_value, found = derive(function, at, dtype, mode)
    assert found_value == value
    np.testing.assert_array_equal(found, np.array(gradient, float))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_arc_sine_at_one(dtype, mode):
    value, gradient = derive(lambda x: ti.asin(x[0]), [1], dtype, mode)
    assert value == pytest.approx(math.pi / 2, rel=1e-6)
    assert gradient[0] == INF


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-14), ("f32", 1e-6)])
def test_tangent(dtype, bound, mode):
    value, gradient = derive(lambda x: ti.tan(x[0]), [0.3], dtype, mode)
    assert value == pytest.approx(math.tan(0.3), rel=bound)
    assert gradient[0] == pytest.approx(1 + math.tan(0.3) ** 2, rel=bound)


# Norms whose squares overflow or underflow.
TINY = {"f64": 1e-200, "f32": 1e-30}
HUGE = {"f64": 1e200, "f32": 1e30}
DENORMAL = {"f64": 2.0**-1070, "f32": 2.0**-146}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("scale", [TINY, HUGE, DENORMAL], ids=["tiny", "huge", "denormal"])
def test_norm_of_an_axis(scale, dtype, mode):
    length = float(np.dtype(dtype.replace("f", "float")).type(scale[dtype]))
    value, gradient = derive(lambda x: x.norm(), [length, 0, 0], dtype, mode)
    assert value == length
    np.testing.assert_array_equal(gradient, [1, 0, 0])


FLAT = {
    "tanh": (lambda p: ti.tanh(p), 1),
    "exp": (lambda p: ti.exp(-p), 0),
    "quotient": (lambda p: 1 / p, 0),
    "atan2": (lambda p: ti.atan2(1.0, p), 0),
    "rsqrt": (lambda p: ti.rsqrt(p), 0),
    "sigmoid": (lambda p: 1 / (1 + ti.exp(-p)), 1),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("name", FLAT)
def test_flat_functions_of_an_overflow(name, dtype, mode):
    """The product is infinite, and so is its tangent; the function has the slope zero there."""
    function, limit = FLAT[name]
    s = HUGE[dtype]
    value, gradient = derive(lambda x: function(s * x[0] * x[1]), [1.0, s], dtype, mode)
    assert value == limit
    np.testing.assert_array_equal(gradient, [0, 0])


NORMS = {
    "norm": lambda x: x.norm(),
    "length": lambda x: ti.math.length(x),
    "distance": lambda x: ti.math.distance(x, -x),
    "matrix": lambda x: ti.Matrix([[x[0], x[1]], [x[2], 0.0]]).norm(),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-15), ("f32", 3e-7)])
@pytest.mark.parametrize("scale", [TINY, HUGE], ids=["tiny", "huge"])
@pytest.mark.parametrize("name", NORMS)
def test_norms(name, scale, dtype, bound, mode):
    s = scale[dtype]
    value, gradient = derive(NORMS[name], [2 * s, -3 * s, 6 * s], dtype, mode)
    factor = 2 if name == "distance" else 1
    assert value == pytest.approx(factor * 7 * s, rel=bound, abs=0)
    np.testing.assert_allclose(gradient, factor * np.array([2, -3, 6]) / 7, rtol=bound)


@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-15), ("f32", 3e-7)])
@pytest.mark.parametrize("scale", [TINY, HUGE], ids=["tiny", "huge"])
def test_directions(scale, dtype, bound):
    s = scale[dtype]
    for component, expected in enumerate([2 / 7, -3 / 7, 6 / 7]):
        value, _ = derive(lambda x, c=component: x.normalized()[c], [2 * s, -3 * s, 6 * s], dtype)
        assert value == pytest.approx(expected, rel=2 * bound, abs=0)
    value, _ = derive(lambda x: x.norm_inv() * 1e-5, [2 * s, -3 * s, 6 * s], dtype)
    assert value == pytest.approx(1e-5 / (7 * s), rel=2 * bound, abs=0)


@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_norms_of_infinities_and_nan(dtype):
    value, _ = derive(lambda x: x.norm(), [INF, 1], dtype)
    assert value == INF
    value, _ = derive(lambda x: x.norm(), [NAN, 1], dtype)
    assert math.isnan(value)


# Choices of ti.init for ties, and for arc sines at ±1.
SPLIT = [
    ("max(x, 0)", lambda x: ti.max(x[0], 0.0), [0], 0, [0.5]),
    ("max(0, x)", lambda x: ti.max(0.0, x[0]), [0], 0, [0.5]),
    ("min(0, x)", lambda x: ti.min(0.0, x[0]), [0], 0, [0.5]),
    ("max, tie", lambda x: ti.max(x[0], x[1]), [1, 1], 1, [0.5, 0.5]),
    ("min, tie", lambda x: ti.min(x[0], x[1]), [1, 1], 1, [0.5, 0.5]),
    ("max, no tie", lambda x: ti.max(x[0], x[1]), [2, 1], 2, [1, 0]),
    ("min, no tie", lambda x: ti.min(x[0], x[1]), [2, 1], 1, [0, 1]),
    ("same value", lambda x: ti.max(x[0], x[0]), [1], 1, [1]),
    ("abs(0)", lambda x: abs(x[0]), [0], 0, [0]),
]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("row", SPLIT, ids=[row[0] for row in SPLIT])
def test_split_ties(row, dtype, mode):
    _, function, at, value, gradient = row
    found_value, found = derive(function, at, dtype, mode, ad_ties="split")
    assert found_value == value
    np.testing.assert_array_equal(found, gradient)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("at", [1.0, -1.0, 0.5])
def test_clamped_arcs(at, dtype, mode):
    number = np.dtype(dtype.replace("f", "float")).type
    inside = np.nextafter(number(at), number(0)) if abs(at) == 1 else number(at)
    slope = 1 / math.sqrt((1 - float(inside)) * (1 + float(inside)))
    _, sine = derive(lambda x: ti.asin(x[0]), [at], dtype, mode, ad_arcs="clamp")
    _, cosine = derive(lambda x: ti.acos(x[0]), [at], dtype, mode, ad_arcs="clamp")
    bound = 4 * float(np.finfo(number).eps)
    assert sine[0] == pytest.approx(slope, rel=bound)
    assert cosine[0] == pytest.approx(-slope, rel=bound)


@pytest.mark.parametrize("options", [{"ad_ties": "half"}, {"ad_arcs": "yes"}])
def test_unknown_choices(options):
    with pytest.raises(ti.TaiRuntimeError, match="is '.*' or '.*', but got"):
        ti.init(**options)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("scale", [TINY, HUGE], ids=["tiny", "huge"])
def test_angle_of_extreme_points(scale, dtype, mode):
    s = scale[dtype]
    _, gradient = derive(lambda x: ti.atan2(x[0], x[1]) * s, [3 * s, -4 * s], dtype, mode)
    np.testing.assert_allclose(gradient, [-4 / 25, -3 / 25], rtol=4e-7 if dtype == "f32" else 1e-15)
