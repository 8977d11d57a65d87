"""S35, S38, S43: volumes near one, denormals, extreme scales, fast mathematics."""

import math

import numpy as np
import pytest
import tai as ti

from device_tensors import ON_GPU
from points import MODES, TYPES, Points, number


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dim", [2, 3])
def test_s35_log_of_the_volume(dim, mode, measure):
    """log1p of J - 1 in terms of the displacement keeps 1e-6 in f32 where log J has no digit."""
    ti.init(offline_cache=False)
    random = np.random.default_rng(4).standard_normal((6, dim, dim))
    # No volume is near zero relative to its parts.
    random += 3 * np.eye(dim)
    scales = 10.0 ** -np.arange(1, 7)
    points = (scales[:, None, None] * random).astype(np.float32)

    def energy(x):
        h = ti.Matrix([[x[dim * i + j] for j in range(dim)] for i in range(dim)])
        delta = h.trace() + h.determinant()
        if ti.static(dim == 3):
            delta += 0.5 * (h.trace() ** 2 - (h @ h).trace())
        return ti.math.log1p(delta)

    values, gradients = Points(energy, dim * dim, 6, "f32", mode)(points.reshape(6, -1))
    wide = points.astype(float)
    exact = [math.log1p(volume(h)) for h in wide]
    slopes = np.stack([np.linalg.inv(np.eye(dim) + h).T.ravel() for h in wide])
    measure("value", np.abs(values / exact - 1).max(), 1e-6)
    scale = np.abs(slopes).max(axis=1, keepdims=True)
    measure("slope", (np.abs(gradients - slopes) / scale).max(), 1e-6)


def volume(h):
    """det(I + h) - 1 without cancellation."""
    if len(h) == 2:
        return np.trace(h) + np.linalg.det(h)
    return np.trace(h) + 0.5 * (np.trace(h) ** 2 - np.trace(h @ h)) + np.linalg.det(h)


DENORMAL = {"f32": float(np.float32(1e-40)), "f64": 1e-310}


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("count", [1, 1027])
def test_s38_denormals_are_kept(count, dtype, mode, fast):
    """Loads, stores, sums and products by powers of two of denormals are exact; grad too."""
    ti.init(offline_cache=False, fast_math=fast)
    m = DENORMAL[dtype]
    points = np.full((count, 1), m)
    values, gradients = Points(lambda x: 0.5 * x[0] + 1.5 * x[0], 1, count, dtype, mode)(points)
    np.testing.assert_array_equal(values.astype(float), 2 * m)
    np.testing.assert_array_equal(gradients, 2.0)


@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("accumulate", ["atomic", "sum"])
def test_s38_mass_of_denormals(dtype, accumulate):
    """1024 particles of a denormal mass: the mass of the cell is the sum, exactly."""
    if ON_GPU and (dtype, accumulate) == ("f32", "atomic"):
        pytest.skip("additions of f32 in the memory of a GPU make denormal numbers zero")
    ti.init(offline_cache=False, deterministic=accumulate == "sum")
    m, n = DENORMAL[dtype], 1024
    mass = ti.field(TYPES[dtype], shape=n)
    cell = ti.field(TYPES[dtype], shape=4)
    where = ti.field(ti.i32, shape=n)
    mass.fill(m)
    where.from_numpy(np.arange(n, dtype=np.int32) % 4)

    @ti.kernel
    def scatter():
        for i in mass:
            cell[where[i]] += mass[i]

    scatter()
    assert cell.to_numpy().astype(float).tolist() == [256 * m] * 4


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("mass", ["zero", "denormal", "one"])
def test_s38_cells_without_mass(mass, dtype, mode):
    """momentum / mass where there is enough of it, by a select: else 0, with gradient 0."""
    ti.init(offline_cache=False)
    m = {"zero": 0.0, "denormal": DENORMAL[dtype], "one": 1.0}[mass]

    def velocity(x):
        return ti.select(x[1] > 1e-30, x[0] / x[1], 0.0 * x[0])

    values, gradients = Points(velocity, 2, 65, dtype, mode)(np.full((65, 2), [3.0, m]))
    expected, slope = (3, [1, -3]) if mass == "one" else (0, [0, 0])
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(gradients, np.tile(slope, (65, 1)))


SCALES = {"f32": [1e-30, 1e30], "f64": [1e-200, 1e200]}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-15), ("f32", 4e-7)])
@pytest.mark.parametrize("size", ["small", "large"])
def test_s4_s5_scales(size, dtype, bound, mode, measure):
    """Lengths, directions and angles do not know the scale, f32 to 1e30 and f64 to 1e200."""
    ti.init(offline_cache=False)
    s = SCALES[dtype][size == "large"]
    points = s * np.random.default_rng(5).uniform(1, 2, (65, 3))
    points = points.astype(number(dtype)).astype(float)
    unit = points / s / np.linalg.norm(points / s, axis=1, keepdims=True)
    values, gradients = Points(lambda x: x.norm() / s, 3, 65, dtype, mode)(points)
    measure("length", np.abs(values / np.linalg.norm(points / s, axis=1) - 1).max(), bound)
    measure("its slope", np.abs(gradients * s - unit).max(), bound)
    values, _ = Points(lambda x: x.normalized()[0], 3, 65, dtype, mode)(points)
    measure("direction", np.abs(values - unit[:, 0]).max(), bound)
    values, _ = Points(lambda x: ti.atan2(x[0], x[1]), 3, 65, dtype, mode)(points)
    exact = np.arctan2(points[:, 0], points[:, 1])
    measure("angle", np.abs(values - exact).max(), bound)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-13), ("f32", 4e-5)])
@pytest.mark.parametrize("size", ["small", "large"])
@pytest.mark.parametrize("n", [2, 3, 4])
def test_inverses_at_scales(n, size, dtype, bound, mode):
    """So does an inverse, whose determinant has n times the exponent of the matrix."""
    ti.init(offline_cache=False)
    s = SCALES[dtype][size == "large"]
    matrices = np.random.default_rng(6).uniform(-1, 1, (65, n, n)) + 3 * np.eye(n)
    inverses = np.linalg.inv(matrices)

    def corner(x):
        matrix = ti.Matrix([[s * x[n * i + j] for j in range(n)] for i in range(n)])
        return s * matrix.inverse()[0, 1]

    values, gradients = Points(corner, n * n, 65, dtype, mode)(matrices.reshape(65, -1))
    assert np.abs(values - inverses[:, 0, 1]).max() < bound
    slopes = -inverses[:, 0, :, None] * inverses[:, None, :, 1]
    assert np.abs(gradients - slopes.reshape(65, -1)).max() < bound


def test_inverse_of_singular_matrices():
    """The inverse has no finite entries, also for tiny matrices."""
    matrices = np.zeros((4, 3, 3))
    matrices[1, 0, 0] = matrices[2, 0, 0] = 1e-200
    matrices[2, 1, 1] = 1e-200
    a = ti.Matrix.field(3, 3, ti.f64, shape=4)
    b = ti.Matrix.field(3, 3, ti.f64, shape=4)
    matrices[3] = 1e-200 * np.diag([1, 2, 4])
    a.from_numpy(matrices)

    @ti.kernel
    def invert():
        for i in a:
            b[i] = a[i].inverse()

    invert()
    assert not np.isfinite(b.to_numpy()[:3].reshape(3, -1)).all(axis=1).any()
    np.testing.assert_allclose(b.to_numpy()[3], 1e200 * np.diag([1, 0.5, 0.25]), rtol=1e-14)


# The bounds of CUDA's fast intrinsics: ulps of the result, or an absolute error.
FAST = {
    "exp(80)": (lambda x: ti.exp(x), [80.0, 10.0, -80.0, 1.0], np.exp, "ulp", 95),
    "sin near pi": (lambda x: ti.sin(x), [3.0, 0.5, -2.0, 3.14159], np.sin, "abs", 2**-21.41),
    "cos": (lambda x: ti.cos(x), [3.0, 0.5, -2.0, 1.5707], np.cos, "abs", 2**-21.19),
    "sin(1e5)": (lambda x: ti.sin(x), [1e5, -1e5, 12345.0], np.sin, "abs", 2**-8),
    "log": (lambda x: ti.log(x), [3.0, 1e30, 1e-30, 0.1], np.log, "ulp", 4),
    "x / 1e38": (lambda x: 1.0 / x, [1e38, 8e37, 3e37, 3.0], lambda x: 1 / x, "denormal", 2),
}


@pytest.mark.parametrize("count", [1, 1027])
@pytest.mark.parametrize("name", FAST)
def test_s43_fast_functions(name, count, measure):
    """With fast_math, errors are within the bounds that CUDA documents for its intrinsics."""
    ti.init(offline_cache=False, fast_math=True)
    function, at, reference, kind, bound = FAST[name]
    worst = 0.0
    for number_ in at:
        points = np.full((count, 1), number_, np.float32)
        values, _ = Points(lambda x: function(x[0]), 1, count, "f32", "reverse")(points)
        exact = reference(points[:, 0].astype(float))
        if kind == "abs":
            error = np.abs(values - exact)
        else:
            error = np.abs(values - exact) / np.spacing(np.abs(exact).astype(np.float32))
        worst = max(worst, float(error.max()))
    measure({"abs": "absolute", "ulp": "ulp", "denormal": "ulp"}[kind], worst, bound)


@pytest.mark.skipif(ON_GPU, reason="approximate instructions of a GPU make denormal numbers zero")
@pytest.mark.parametrize("count", [1, 1027])
def test_s43_fast_functions_of_denormals(count):
    """exp with a denormal result, and log of denormals: by polynomials they were 0, and log of
    1.2e-38."""
    ti.init(offline_cache=False, fast_math=True)
    numbers = [1e-38, 1e-40, 3e-45]
    for at, of in zip(np.log(numbers), numbers, strict=True):
        values, _ = Points(lambda x: ti.exp(x[0]), 1, count, "f32", "reverse")(
            np.full((count, 1), at, np.float32)
        )
        np.testing.assert_allclose(values, np.exp(float(np.float32(at))), rtol=1e-5, atol=1.5e-45)
        values, slopes = Points(lambda x: ti.log(x[0]), 1, count, "f32", "reverse")(
            np.full((count, 1), of, np.float32)
        )
        np.testing.assert_allclose(values, math.log(float(np.float32(of))), rtol=4e-7)
    for at, exp, log in ((0, 1, -np.inf), (np.inf, np.inf, np.inf), (-np.inf, 0, np.nan)):
        point = np.full((count, 1), at, np.float32)
        values, _ = Points(lambda x: ti.exp(x[0]), 1, count, "f32", "reverse")(point)
        np.testing.assert_array_equal(values, exp)
        values, _ = Points(lambda x: ti.log(x[0]), 1, count, "f32", "reverse")(point)
        np.testing.assert_array_equal(values, log)


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("count", [1, 1027])
def test_s43_nan_and_infinity_are_known(count, dtype, fast):
    """isnan(v), v != v, isinf and comparisons keep their meaning, under fast flags too."""
    ti.init(offline_cache=False, fast_math=fast)
    real = TYPES[dtype]
    x = ti.field(real, shape=count)
    tests = ti.field(ti.i32, shape=(6, count))

    @ti.kernel
    def ask():
        for i in x:
            v = ti.sqrt(x[i])
            w = 1.0 / (x[i] + 1.0)
            tests[0, i] = ti.cast(ti.math.isnan(v), ti.i32)
            tests[1, i] = ti.cast(v != v, ti.i32)
            tests[2, i] = ti.cast(v == v, ti.i32)
            tests[3, i] = ti.cast(ti.math.isinf(w), ti.i32)
            tests[4, i] = ti.cast(w > 1e30, ti.i32)
            tests[5, i] = ti.cast(v >= 0.0, ti.i32)

    for at, expected in ((-1.0, [1, 1, 0, 1, 1, 0]), (4.0, [0, 0, 1, 0, 0, 1])):
        x.fill(at)
        ask()
        assert tests.to_numpy().T.tolist() == [expected] * count, at
