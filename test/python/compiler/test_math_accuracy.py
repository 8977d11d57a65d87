"""Exponentials, logarithms and the hyperbolic tangent of f32, in units in the last place."""

import math
from fractions import Fraction

import numpy as np
import pytest
import tai as ti

# Every exponent, and mantissas in between; and numbers of both signs around the special ones.
EXPONENTS = np.arange(-149, 128)
SPECIAL = np.array(
    [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 9.0, 9.02, 20.0, 88.72283, 88.72284, 100.0,
     -87.4, -103.97, -103.98, -104.0, -150.0, 3e38, -3e38, 1e-45, -1e-45, 1e-40,
     1.1754944e-38, np.nextafter(np.float32(1), np.float32(2)),
     np.nextafter(np.float32(1), np.float32(0))], dtype=np.float32)  # fmt: skip


def make_arguments() -> np.ndarray:
    """f32 numbers of all sizes, (count,)."""
    random = np.random.default_rng(7)
    mantissas = random.uniform(1.0, 2.0, (len(EXPONENTS), 60))
    spread = np.ldexp(mantissas, EXPONENTS[:, None]).ravel()
    near = random.uniform(-12.0, 12.0, 20000)
    wide = random.uniform(-110.0, 90.0, 20000)
    close = 1.0 + random.uniform(-0.4, 0.6, 10000)
    return np.concatenate([spread, -spread, near, wide, close, SPECIAL]).astype(np.float32)


def in_ulps(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Distance of f32 numbers from f64 ones, in units in the last place of f32 there."""
    unit = np.spacing(np.abs(expected).astype(np.float32)).astype(np.float64)
    return np.abs(found.astype(np.float64) - expected) / unit


def on_a_gpu() -> bool:
    return ti.lang.impl.current_cfg().arch == ti.cuda


FUNCTIONS = {
    "exp": (ti.exp, np.exp),
    "exp2": (ti.math.exp2, np.exp2),
    "log": (ti.log, np.log),
    "log2": (ti.math.log2, np.log2),
    "tanh": (ti.tanh, np.tanh),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_half_a_unit(name):
    ti.init(arch=ti.cpu)
    function, reference = FUNCTIONS[name]
    arguments = make_arguments()
    x = ti.field(ti.f32, shape=len(arguments))
    y = ti.field(ti.f32, shape=len(arguments))
    x.from_numpy(arguments)

    @ti.kernel
    def apply():
        for i in x:
            y[i] = function(x[i])

    apply()
    found = y.to_numpy()
    with np.errstate(all="ignore"):
        expected = reference(arguments.astype(np.float64))
        rounded = expected.astype(np.float32)
    # Results without neighbours: infinities, zeros with their signs, and NaN.
    special = ~np.isfinite(rounded) | (rounded == 0)
    np.testing.assert_array_equal(found[special], rounded[special])
    signs = ~np.isnan(rounded)
    np.testing.assert_array_equal(np.signbit(found[signs]), np.signbit(rounded[signs]))
    # On a GPU they are those of its library.
    bounds = {"exp": 2.0, "exp2": 2.0, "log": 1.0, "log2": 1.0, "tanh": 2.0}
    bound = bounds[name] if on_a_gpu() else 0.501
    assert in_ulps(found[~special], expected[~special]).max() < bound


def test_one_as_many():
    """A number alone gives the bits that it gives among others."""
    ti.init(arch=ti.cpu)
    arguments = np.random.default_rng(3).uniform(-4.0, 4.0, 64).astype(np.float32)
    x = ti.field(ti.f32, shape=64)
    y = ti.field(ti.f32, shape=64)
    z = ti.field(ti.f32, shape=64)
    x.from_numpy(arguments)

    @ti.kernel
    def together():
        for i in x:
            y[i] = ti.tanh(x[i]) + ti.exp(x[i])

    @ti.kernel
    def alone(i: ti.i32):
        z[i] = ti.tanh(x[i]) + ti.exp(x[i])

    together()
    for i in range(64):
        alone(i)
    np.testing.assert_array_equal(y.to_numpy(), z.to_numpy())


@pytest.mark.parametrize("options", [{"fast_math": True}, {"math": "strict"}])
def test_other_modes(options):
    """fast_math is within 4 units; strict ones are those of libm."""
    ti.init(arch=ti.cpu, **options)
    if on_a_gpu() and "fast_math" in options:
        pytest.skip("a GPU's fast logarithm near one, and tanh, have absolute errors")
    arguments = np.random.default_rng(5).uniform(-5.0, 5.0, 5000).astype(np.float32)
    x = ti.field(ti.f32, shape=5000)
    y = ti.field(ti.f32, shape=(3, 5000))
    x.from_numpy(arguments)

    @ti.kernel
    def apply():
        for i in x:
            y[0, i] = ti.exp(x[i])
            y[1, i] = ti.log(ti.abs(x[i]))
            y[2, i] = ti.tanh(x[i])

    apply()
    wide = arguments.astype(np.float64)
    expected = np.stack([np.exp(wide), np.log(np.abs(wide)), np.tanh(wide)])
    bounds = (4.0, 4.0, 5.0) if "fast_math" in options else (1.0, 1.0, 2.5)
    if on_a_gpu():
        bounds = (2.0, 1.0, 2.5)
    for found, exact, bound in zip(y.to_numpy(), expected, bounds, strict=True):
        assert in_ulps(found, exact).max() <= bound


@pytest.mark.parametrize("options", [{}, {"math": "strict"}, {"math": "accurate"}])
@pytest.mark.parametrize("dtype", [ti.f64, ti.f32])
def test_base_of_two(dtype, options):
    """Powers and their exponents are exact: by e and ln 2 they would be off by 600 units."""
    ti.init(default_fp=dtype, **options)
    exponents = np.arange(-1022, 1024) if dtype is ti.f64 else np.arange(-126, 128)
    x = ti.field(dtype, shape=len(exponents))
    y = ti.field(dtype, shape=(2, len(exponents)))
    x.from_numpy(exponents.astype(dtype.numpy))

    @ti.kernel
    def apply():
        for i in x:
            y[0, i] = ti.math.exp2(x[i])
            y[1, i] = ti.math.log2(y[0, i])

    apply()
    found = y.to_numpy()
    if on_a_gpu():  # its library is within a unit
        np.testing.assert_allclose(found[0], np.ldexp(1.0, exponents), rtol=2.0**-22)
        return
    np.testing.assert_array_equal(found[0], np.ldexp(1.0, exponents))
    np.testing.assert_array_equal(found[1], exponents)
    assert [ti.math.exp2(10), ti.math.log2(8), ti.math.log2(0)] == [1024, 3, -math.inf]


def test_power_of_a_constant_power_of_two():
    """As exp2 of a rounded product it would be off by 40 units."""
    n = 200
    x = ti.field(ti.f64, shape=n)
    y = ti.field(ti.f64, shape=n)

    @ti.kernel
    def raise_constant():
        for i in range(n):
            y[i] = ti.pow(2147483648.0, x[i])

    exponents = np.linspace(-1, 3.9, n)
    x.from_numpy(exponents)
    raise_constant()
    # 31 e, as the sum of a whole number and a rest that is exact.
    rests = [Fraction(e) * 31 - round(31 * e) for e in exponents]
    exact = np.array([math.ldexp(2.0 ** float(r), round(31 * e))
                      for r, e in zip(rests, exponents, strict=True)])  # fmt: skip
    errors = np.abs(y.to_numpy() - exact) / np.spacing(exact)
    assert errors.max() <= 2


@pytest.mark.parametrize("kind", [ti.f32, ti.f64])
def test_powers_with_halves_as_exponents(kind):
    """They are within one unit of the last place, and powers of special numbers are C's."""
    ti.init()
    exponents = [-2.5, -1.5, -0.5, 1.5, 2.5]
    dtype = kind.numpy
    least = np.finfo(dtype).tiny
    special = [0.0, -0.0, np.inf, -np.inf, np.nan, -1.0, least, 1.0, 4.0, np.finfo(dtype).max]
    limits = np.log([least, np.finfo(dtype).max])
    plain = np.exp(np.random.default_rng(0).uniform(*limits, size=2000))
    values = np.concatenate([special, plain]).astype(dtype)
    x = ti.field(kind, shape=values.size)
    y = ti.field(kind, shape=(len(exponents), values.size))

    @ti.kernel
    def compute():
        for i in x:
            for e in ti.static(range(len(exponents))):
                y[e, i] = x[i] ** exponents[e]

    x.from_numpy(values)
    compute()
    for found, exponent in zip(y.to_numpy(), exponents, strict=True):
        with np.errstate(all="ignore"):
            exact = np.power(values.astype(np.longdouble), np.longdouble(exponent))
            expected = exact.astype(dtype)
            regular = np.isfinite(expected) & (expected >= least)
            distance = np.abs(found - exact)[regular] / np.spacing(expected[regular])
        assert distance.max() < (0.51 if kind is ti.f32 else 1)
        others = ~regular & ~((expected != 0) & np.isfinite(expected))
        np.testing.assert_array_equal(found[others], expected[others])
        zeros = found == 0
        np.testing.assert_array_equal(np.signbit(found[zeros]), np.signbit(expected[zeros]))
