"""Comparisons of norms and roots with constants, which need no root, against correctly rounded
roots by NumPy: for sums of squares at each side of the limit.
"""

import numpy as np
import pytest
import tai as ti

LIMITS = [0.4, 1.0, 3.0, 1e-3, 123.456, 1e10, 1e-12, 1e-30, 1e25]


def neighbours(limit, dtype):
    """Numbers around the square of the limit, and others far away from it."""
    square = dtype(limit) * dtype(limit)
    near, below, above = [square], square, square
    for _ in range(8):
        below, above = np.nextafter(below, dtype(0)), np.nextafter(above, dtype(np.inf))
        near += [below, above]
    return np.array([*near, 0, square / 2, square * 2, np.inf, np.nan], dtype)


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("limit", LIMITS)
def test_roots(limit, precision):
    dtype = np.dtype(precision.replace("f", "float")).type
    ti.init(default_fp=getattr(ti, precision), offline_cache=False)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        values = neighbours(limit, dtype)
        roots = np.sqrt(values)
    n, h = len(values), float(dtype(limit))
    s, found = ti.field(getattr(ti, precision), n), ti.field(ti.i32, (4, n))
    s.from_numpy(values)

    @ti.kernel
    def compare():
        for i in range(n):
            root = ti.sqrt(ti.abs(s[i]))
            found[0, i] = root < h
            found[1, i] = root <= h
            found[2, i] = root > h
            found[3, i] = h <= root

    compare()
    expected = [roots < dtype(h), roots <= dtype(h), roots > dtype(h), roots >= dtype(h)]
    np.testing.assert_array_equal(found.to_numpy(), np.array(expected, np.int32))


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("limit", LIMITS)
def test_norms(limit, precision):
    """The comparison with a constant is that with the same number from an argument."""
    dtype = np.dtype(precision.replace("f", "float")).type
    ti.init(default_fp=getattr(ti, precision), offline_cache=False)
    n, h = 20_000, float(dtype(limit))
    rng = np.random.default_rng(3)
    angle, length = rng.uniform(0, 7, n), h * (1 + rng.uniform(-4, 4, n) * np.finfo(dtype).eps)
    points = np.stack([np.cos(angle), np.sin(angle)], 1) * length[:, None]
    points[:4] = [[np.nan, h], [np.inf, 0], [0, 0], [h, 0]]
    points[4:8] = [[0, -h], [3e38, 3e38], [1e-40, 0], [h, h]]
    x = ti.Vector.field(2, getattr(ti, precision), shape=n)
    found, expected = ti.field(ti.i32, (2, n)), ti.field(ti.i32, (2, n))
    x.from_numpy(points.astype(dtype))

    @ti.kernel
    def constant():
        for i in range(n):
            found[0, i] = x[i].norm() < h
            found[1, i] = x[i].norm() >= h

    @ti.kernel
    def argument(k: float):
        for i in range(n):
            expected[0, i] = x[i].norm() < k
            expected[1, i] = x[i].norm() >= k

    constant()
    argument(h)
    np.testing.assert_array_equal(found.to_numpy(), expected.to_numpy())
    assert 0 < found.to_numpy()[0].sum() < n
