"""S1 to S21: the table of kinks, in vectorised loops of any length, and in other modes."""

import math

import numpy as np
import pytest
import tai as ti

from points import MODES, Points, number

INF, NAN = math.inf, math.nan
TINY = {"f64": 1e-200, "f32": 1e-30}
HUGE = {"f64": 1e200, "f32": 1e30}


@ti.func
def root_in_a_branch(x):
    y = 0.0 * x
    if x > 0:
        y = ti.sqrt(x)
    return y


def matrix(x, n):
    return ti.Matrix([[x[n * i + j] for j in range(n)] for i in range(n)])


def rotation_01(n):
    return lambda x: ti.polar_decompose(matrix(x, n))[0][0, 1]


def spectrum(n):
    return lambda x: ti.svd(matrix(x, n))[1].trace()


EYE = {n: np.eye(n).ravel().tolist() for n in (2, 3)}

# Id and name, the function, where, its value and its gradient there: exact, and why.
ROWS = [
    # The slope is infinite there, and stays so where something depends on it.
    ("S1 sqrt(0)", lambda x: ti.sqrt(x[0]), [0], 0, [INF]),
    # A zero adjoint contributes zero, whatever the partial is.
    ("S1 0 sqrt(0)", lambda x: 0.0 * ti.sqrt(x[0]) + x[0], [0], 0, [1]),
    # The true derivative, 3/2 sqrt(x).
    ("S2 x sqrt(x)", lambda x: x[0] * ti.sqrt(x[0]), [0], 0, [0]),
    # The subgradient of least norm.
    ("S3 norm(0)", lambda x: x.norm(), [0, 0, 0], 0, [0, 0, 0]),
    # The squares underflow, overflow: the norm is scaled before.
    ("S4 norm(tiny)", lambda x: x.norm(), [TINY, 0, 0], TINY, [1, 0, 0]),
    ("S5 norm(huge)", lambda x: x.norm(), [HUGE, 0, 0], HUGE, [1, 0, 0]),
    # No direction: zero, as of a norm of zero.
    ("S6 normalized(0)", lambda x: x.normalized().sum(), [0, 0, 0], 0, [0, 0, 0]),
    # The middle of the slopes -1 and 1.
    ("S7 abs(0)", lambda x: abs(x[0]), [0], 0, [0]),
    ("S7 abs(-0)", lambda x: abs(x[0]), [-0.0], 0, [0]),
    # The second operand wins a tie, as in Taichi.
    ("S8 max(x, 0)", lambda x: ti.max(x[0], 0.0), [0], 0, [0]),
    ("S8 max(0, x)", lambda x: ti.max(0.0, x[0]), [0], 0, [1]),
    ("S9 max(1, 1)", lambda x: ti.max(x[0], x[1]), [1, 1], 1, [0, 1]),
    ("S9 min(1, 1)", lambda x: ti.min(x[0], x[1]), [1, 1], 1, [0, 1]),
    # The edges are inside.
    ("S10 clamp, low", lambda x: ti.math.clamp(x[0], 0.0, 1.0), [0], 0, [1]),
    ("S10 clamp, high", lambda x: ti.math.clamp(x[0], 0.0, 1.0), [1], 1, [1]),
    # No angle: zero.
    ("S11 atan2(0, 0)", lambda x: ti.atan2(x[0], x[1]), [0, 0], 0, [0, 0]),
    # 0 ** y is flat in y, and x ** 0 in x.
    ("S12 pow(0, 0)", lambda x: x[0] ** x[1], [0, 0], 1, [0, 0]),
    ("S13 pow(0, 2)", lambda x: x[0] ** x[1], [0, 2], 0, [0, 0]),
    # By the exponent of a negative base there is no derivative.
    ("S13 pow(-2, 2)", lambda x: x[0] ** x[1], [-2, 2], 4, [-4, NAN]),
    ("S14 acos(1)", lambda x: ti.acos(x[0]), [1], 0, [-INF]),
    ("S14 asin(1), unused", lambda x: 0.0 * ti.asin(x[0]) + x[0], [1], 1, [1]),
    # The arm that is not taken gets a zero adjoint.
    ("S15 select at -1", lambda x: ti.select(x[0] > 0, ti.sqrt(x[0]), 0.0), [-1], 0, [0]),
    ("S15 select at 0", lambda x: ti.select(x[0] > 0, ti.sqrt(x[0]), 0.0), [0], 0, [0]),
    # An arm that does not run has no derivative.
    ("S16 if at -1", lambda x: root_in_a_branch(x[0]), [-1], 0, [0]),
    # inf / inf ** 2 is the flat end of the curve.
    ("S17 sigmoid", lambda x: 1 / (1 + ti.exp(-x[0])), [-800], 0, [0]),
    # x - floor(x / y) y, the quotient being constant.
    ("S18 remainder", lambda x: x[0] % x[1], [5.5, 2], 1.5, [1, -2]),
    # dR = R [w] with the axis of half of the antisymmetric part.
    ("S20 polar, 2", rotation_01(2), EYE[2], 0, [0, 0.5, -0.5, 0]),
    ("S20 polar, 3", rotation_01(3), EYE[3], 0, [0, 0.5, 0, -0.5, 0, 0, 0, 0, 0]),
    # The gradient is U V', at equal singular values too.
    ("S21 singular values, 2", spectrum(2), EYE[2], 2, EYE[2]),
    ("S21 singular values, 3", spectrum(3), EYE[3], 3, EYE[3]),
]  # fmt: skip

# How many elements, and options of ti.init. Kinks stand between regular points.
WAYS = {
    "one": (1, {}),
    "many": (1027, {}),
    "deterministic": (65, {"deterministic": True}),
    "plain": (65, {"opt_level": 0, "cpu_max_num_threads": 1}),
    "fast": (65, {"fast_math": True}),
}
# With fast_math the squares of a norm may under- and overflow: its results then.
FAST = {"S4 norm(tiny)": (0, [0, 0, 0]), "S5 norm(huge)": (INF, [0, 0, 0])}


def resolve(numbers, dtype):
    return np.array([n[dtype] if isinstance(n, dict) else n for n in numbers], number(dtype))


def mixed(at, count, dtype):
    """Points with `at` at each third and at the last, and where that is."""
    points = np.random.default_rng(1).uniform(0.6, 0.9, (count, len(at))).astype(number(dtype))
    where = np.arange(count) % 3 == 0
    where[-1] = True
    points[where] = at
    return points, where


def pytest_generate_tests(metafunc):
    if "way" in metafunc.fixturenames:
        everything = metafunc.config.getoption("--long")
        metafunc.parametrize("way", WAYS if everything else ["many", "fast"])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("row", ROWS, ids=[row[0] for row in ROWS])
def test_kinks(row, way, dtype, mode):
    name, function, at, value, gradient = row
    count, options = WAYS[way]
    if way == "fast" and name in FAST:
        value, gradient = FAST[name]
    ti.init(offline_cache=False, **options)
    points, where = mixed(resolve(at, dtype), count, dtype)
    values, gradients = Points(function, len(at), count, dtype, mode)(points)
    expected = resolve([value], dtype)[0]
    np.testing.assert_array_equal(values[where], np.full(where.sum(), expected))
    np.testing.assert_array_equal(gradients[where], np.tile(gradient, (where.sum(), 1)))
    assert np.isfinite(values).all() or not np.isfinite(expected)
    assert np.isfinite(gradients[~where]).all()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 4e-16), ("f32", 2e-7)])
@pytest.mark.parametrize("name", ["S14 asin(1)", "S19 tan(0.3)"])
def test_rounded_kinks(name, dtype, bound, mode, measure):
    """Values that are no whole numbers: pi / 2 with an infinite slope, and tan with 1 + tan²."""
    ti.init(offline_cache=False)
    count, at = 1027, 1.0 if "asin" in name else float(number(dtype)(0.3))
    function = (lambda x: ti.asin(x[0])) if "asin" in name else (lambda x: ti.tan(x[0]))
    points, where = mixed([at], count, dtype)
    values, gradients = Points(function, 1, count, dtype, mode)(points)
    value = math.pi / 2 if "asin" in name else math.tan(at)
    measure("value", np.abs(values[where] / value - 1).max(), bound)
    if "asin" in name:
        np.testing.assert_array_equal(gradients[where], INF)
    else:
        measure("slope", np.abs(gradients[where] / (1 + value**2) - 1).max(), 2 * bound)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("name", ["S8 max(x, 0)", "S8 max(0, x)", "S9 max(1, 1)", "S9 min(1, 1)"])
def test_split_ties(name, dtype, mode):
    """ad_ties="split": each operand of a tie gets half."""
    ti.init(offline_cache=False, ad_ties="split")
    _, function, at, value, gradient = next(row for row in ROWS if row[0] == name)
    points, where = mixed(resolve(at, dtype), 1027, dtype)
    values, gradients = Points(function, len(at), 1027, dtype, mode)(points)
    np.testing.assert_array_equal(values[where], value)
    np.testing.assert_array_equal(gradients[where], 0.5)
