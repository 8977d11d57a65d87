"""Decompositions and matrix functions at equal, tiny and negative singular values."""

import numpy as np
import pytest
import tai as ti

from derivatives import MODES, Derivation, derive

BOUNDS = {"f64": 1e-12, "f32": 1e-5}


def rotation(seed, n=3):
    """A rotation."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((n, n)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return q


def signed_svd(a):
    """U, s, V with rotations U and V: the least singular value has the sign of the determinant."""
    u, s, vt = np.linalg.svd(a)
    for side in (u, vt.T):
        if np.linalg.det(side) < 0:
            side[:, -1] = -side[:, -1]
            s[-1] = -s[-1]
    return u, s, vt.T


def polar_gradient(a, w):
    """The gradient of sum(w R) by a, where a = R S."""
    u, s, v = signed_svd(a)
    k = u.T @ w @ v
    sums = s[:, None] + s[None, :]
    np.fill_diagonal(sums, 1.0)
    return u @ ((k - k.T) / sums) @ v.T


def weighted(name, w):
    """sum(w f(A)) as a function for `derive`."""
    rows = w.tolist()

    def function(a):
        weights = ti.Matrix(rows)
        if name == "polar":
            r, _ = ti.polar_decompose(a)
            return (r * weights).sum()
        if name == "stretch":
            r, s = ti.polar_decompose(a)
            return (r @ s * weights).sum()
        u, sigma, v = ti.svd(a)
        if name == "rotation of svd":
            return (u @ v.transpose() * weights).sum()
        if name == "product of svd":
            return (u @ sigma @ v.transpose() * weights).sum()
        if name == "u":
            return (u * weights).sum()
        return (v * weights).sum()

    return function


def regular(n):
    """Matrices whose rotation has a derivative: no two singular values cancel."""
    eye = np.eye(n)
    points = {"identity": eye, "rotation": rotation(1, n), "twice": 2 * eye}
    for d in (0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3):
        last = eye.copy()
        last[-1, -1] += d
        points[f"diagonal, {d}"] = last
        points[f"turned, {d}"] = rotation(2, n) @ last @ rotation(3, n).T
    points["reflection"] = rotation(4, n) @ np.diag([3.0, 2.0, -1.0][3 - n :]) @ rotation(5, n)
    points["small last"] = rotation(6, n) @ np.diag([2.0, 1.0, 1e-8][3 - n :]) @ rotation(7, n)
    points["random"] = np.random.default_rng(8).standard_normal((n, n)) + eye
    points["tiny"] = 1e-6 * points["random"]
    if n == 3:
        points["rank 2"] = rotation(6) @ np.diag([2.0, 1.0, 0.0]) @ rotation(7)
        points["pair"] = rotation(6) @ np.diag([2.0, 2.0, 0.5]) @ rotation(7)
    return points


SINGULAR = {
    "zero": np.zeros((3, 3)),
    "rank 1": np.outer([1.0, 2.0, -1.0], [0.5, 1.0, 3.0]),
    "axis": np.diag([1.0, 0.0, 0.0]),
    "mirror": np.diag([1.0, 1.0, -1.0]),
    "mirror of all": -np.eye(3),
    "denormal": np.diag([1e-310, 1e-310, 1e-310]),
}
COMPOSITES = ["polar", "stretch", "rotation of svd", "product of svd"]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("name", COMPOSITES)
@pytest.mark.parametrize("n", [2, 3])
def test_composites_are_right(n, name, dtype, mode):
    number = np.dtype(dtype.replace("f", "float")).type
    w = np.random.default_rng(9).standard_normal((n, n)).astype(number).astype(float)
    derivation = Derivation(weighted(name, w), (n, n), dtype, mode)
    scaled = {f"random by {s}": s * regular(n)["random"] for s in (1e-25, 1e25)}
    for where, point in {**regular(n), **scaled}.items():
        a = point.astype(number).astype(float)
        _, found = derivation(a)
        product = name in ("stretch", "product of svd")
        expected = w if product else polar_gradient(a, w)
        # Accuracy lost in the factors is lost by the condition of the composite.
        scale = np.abs(expected).max() if not product else np.abs(w).max()
        error = np.abs(found - expected).max() / scale
        assert error <= 10 * BOUNDS[dtype], (where, error)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("least", [1.0, 1.3])  # the square of 1.3 is rounded
@pytest.mark.parametrize("n", [2, 3])
def test_products_of_factors_in_any_order(n, least, mode):
    """How U and V turn together cancels in longer products, too, and in any order of them."""
    w, c = np.random.default_rng(9).standard_normal((2, n, n))
    near = np.diag([2.0, least + 1e-9, least][3 - n :])
    near = rotation(2, n) @ near @ rotation(3, n).T
    weights, other = w.tolist(), c.tolist()

    def stretch(a):
        _, sigma, v = ti.svd(a)
        return (v @ (sigma @ v.transpose()) * ti.Matrix(weights)).sum()

    def between(a):
        u, sigma, v = ti.svd(a)
        m = ti.Matrix(other)
        return (m @ u @ sigma @ sigma @ (v.transpose() @ m) * ti.Matrix(weights)).sum()

    def identity(a):
        u, _, _ = ti.svd(a)
        return (u @ u.transpose() * ti.Matrix(weights)).sum()

    def expected(name, a):
        """By central differences of NumPy's, with a step that the gap does not matter to."""

        def value(b):
            u, s, v = signed_svd(b)
            if name == "stretch":
                return (v @ np.diag(s) @ v.T * w).sum()
            return (c @ u @ np.diag(s**2) @ v.T @ c * w).sum()

        found, h = np.zeros((n, n)), 1e-4
        for k in np.ndindex(n, n):
            step = np.zeros((n, n))
            step[k] = h
            slopes = [(value(a + e * step) - value(a - e * step)) / (2 * e * h) for e in (1, 0.5)]
            found[k] = (4 * slopes[1] - slopes[0]) / 3
        return found

    for function in (stretch, between):
        _, gradient = derive(function, near, "f64", mode)
        reference = expected(function.__name__, near)
        assert np.abs(gradient - reference).max() <= 1e-9 * np.abs(reference).max()
    _, gradient = derive(identity, near, "f64", mode)
    assert np.abs(gradient).max() <= {"forward": 0.0, "reverse": 1e-6}[mode]


def jumping(n):
    """Matrices whose rotation jumps: two singular values cancel but for rounding."""
    generator = np.random.default_rng(5)
    points = {"axes": np.diag([1.0] * (n - 1) + [-1.0])}
    points["all"] = -np.eye(3) if n == 3 else np.array([[0.0, 2.0], [2.0, 0.0]])
    for k in range(6):
        left, right = rotation(10 + k, n), rotation(30 + k, n)
        values = {2: [[1, -1]], 3: [[1, 0, 0], [1, 1, -1], [2, 1, -1], [1, 1e-15, 1e-15]]}[n]
        for s in values:
            points[f"{s}, {k}"] = left @ np.diag(np.array(s, float)) @ right
            points[f"{s}, large, {k}"] = 3e5 * points[f"{s}, {k}"]
        if n == 3:
            points[f"outer, {k}"] = np.outer(*generator.standard_normal((2, 3)))
    return points


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("name", COMPOSITES)
@pytest.mark.parametrize("n", [2, 3])
def test_where_the_rotation_jumps(n, name, dtype, mode):
    """The turn that jumps gets zero, the other turns stay below their bound; the gradient of A
    itself is exact."""
    number = np.dtype(dtype.replace("f", "float")).type
    w = np.random.default_rng(9).standard_normal((n, n)).astype(number).astype(float)
    derivation = Derivation(weighted(name, w), (n, n), dtype, mode)
    for where, point in jumping(n).items():
        a = point.astype(number).astype(float)
        _, gradient = derivation(a)
        if name in ("stretch", "product of svd"):
            assert np.abs(gradient - w).max() <= 10 * BOUNDS[dtype], where
        elif n == 2:
            np.testing.assert_array_equal(gradient, 0, where)
        else:
            assert np.abs(gradient).max() <= 10 / np.abs(a).max(), (where, gradient)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["polar", "rotation of svd"])
@pytest.mark.parametrize("n", [2, 3])
def test_beside_the_jump_the_rotation_has_a_derivative(n, name, mode):
    """The derivative is right down to a sum of 1e-10, where it is 1e10; at 1e-13 it is zero, as
    documented."""
    w = np.zeros((n, n))
    w[n - 2, n - 1] = 1
    derivation = Derivation(weighted(name, w), (n, n), "f64", mode)
    for gap in (1e-3, 1e-6, 1e-10):
        a = np.diag([2.0, 1.0, gap - 1.0][3 - n :])
        _, gradient = derivation(a)
        expected = polar_gradient(a, w)
        assert np.abs(gradient - expected).max() <= 1e-4 * np.abs(expected).max(), gap
    _, gradient = derivation(np.diag([2.0, 1.0, 1e-13 - 1.0][3 - n :]))
    np.testing.assert_array_equal(gradient, 0)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3])
def test_product_of_svd_at_zero(n, dtype, mode):
    """U Σ Vᵀ is the matrix itself, at a zero one too."""
    number = np.dtype(dtype.replace("f", "float")).type
    w = np.random.default_rng(9).standard_normal((n, n)).astype(number).astype(float)
    value, gradient = derive(weighted("product of svd", w), np.zeros((n, n)), dtype, mode)
    assert value == 0
    np.testing.assert_allclose(gradient, w, rtol=4 * np.finfo(number).eps)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("name", [*COMPOSITES, "u", "v"])
def test_singular_points_are_finite(name, dtype, mode):
    w = np.random.default_rng(9).standard_normal((3, 3))
    derivation = Derivation(weighted(name, w), (3, 3), dtype, mode)
    for where, a in {**SINGULAR, **regular(3)}.items():
        value, gradient = derivation(a)
        assert np.isfinite(value), where
        assert np.isfinite(gradient).all(), (where, gradient)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3])
def test_at_the_identity_exactly(n, dtype, mode):
    for name in ("polar", "rotation of svd"):
        w = np.zeros((n, n))
        w[0, 1] = 1
        value, gradient = derive(weighted(name, w), np.eye(n), dtype, mode)
        expected = np.zeros((n, n))
        expected[0, 1], expected[1, 0] = 0.5, -0.5
        assert value == 0
        np.testing.assert_array_equal(gradient, expected)
    value, gradient = derive(lambda a: ti.svd(a)[1].sum(), np.eye(n), dtype, mode)
    assert value == n
    np.testing.assert_array_equal(gradient, np.eye(n))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3])
def test_corotated_energy_at_rest(n, dtype, mode):
    """Every material point starts at F = I: no force, and no NaN."""

    def energy(f):
        r, _ = ti.polar_decompose(f)
        return 30.0 * (f - r).norm_sqr() + 20.0 * (f.determinant() - 1) ** 2

    value, gradient = derive(energy, np.eye(n), dtype, mode)
    assert value == 0
    np.testing.assert_array_equal(gradient, np.zeros((n, n)))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3])
def test_corotated_stress(n, dtype, mode):
    """P = 2 mu (F - R) + lambda (J - 1) J F^-T."""

    def energy(f):
        r, _ = ti.polar_decompose(f)
        return 30.0 * (f - r).norm_sqr() + 20.0 * (f.determinant() - 1) ** 2

    derivation = Derivation(energy, (n, n), dtype, mode)
    for where, f in regular(n).items():
        if abs(np.linalg.det(f)) < 1e-3:
            continue
        u, _, v = signed_svd(f)
        j = np.linalg.det(f)
        expected = 60 * (f - u @ v.T) + 40 * (j - 1) * j * np.linalg.inv(f).T
        _, gradient = derivation(f)
        bound = {"f64": 1e-12, "f32": 1e-4}[dtype] * max(60.0, np.abs(expected).max())
        assert np.abs(gradient - expected).max() <= bound, where


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-4, 1e-6])
def test_logarithm_of_the_volume_near_rest(size, mode):
    """In terms of the displacement, log J keeps its digits in f32."""
    h = (size * np.array([[0.3, -0.5], [0.2, 0.1]])).astype(np.float32).astype(float)

    def energy(h):
        return ti.math.log1p(h.trace() + h.determinant()) ** 2

    f, delta = np.eye(2) + h, np.trace(h) + np.linalg.det(h)
    value, gradient = derive(energy, h, "f32", mode)
    assert value == pytest.approx(np.log1p(delta) ** 2, rel=2e-6, abs=0)
    expected = 2 * np.log1p(delta) * np.linalg.inv(f).T
    np.testing.assert_allclose(gradient, expected, rtol=2e-6)


def test_neo_hookean_of_small_volumes():
    """The stress is right down to J = 1e-3; a negative volume stops a debug run."""

    @ti.func
    def energy(f):
        j = f.determinant()
        assert j > 0, "inverted"
        return 0.5 * (f * f).sum() - ti.log(j) + 2 * ti.log(j) ** 2

    for j in (1e-3, 0.1, 1.0):
        f = rotation(1, 2) @ np.diag([j, 1.0]) @ rotation(2, 2)
        inverse = np.linalg.inv(f).T
        expected = f - inverse + 4 * np.log(np.linalg.det(f)) * inverse
        _, gradient = derive(energy, f, "f64", debug=True)
        np.testing.assert_allclose(gradient, expected, rtol=1e-9, atol=1e-12)
    with pytest.raises(ti.TaichiAssertionError, match="inverted"):
        derive(energy, np.diag([-1.0, 1.0]), "f64", debug=True)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_springs(dtype, mode):
    """At rest length there is no force, and at length zero no NaN."""

    def energy(x):
        return 0.5 * ((x - x.yx * 0.0).norm() - 5.0) ** 2

    value, gradient = derive(energy, [3, 4], dtype, mode)
    assert value == 0
    np.testing.assert_array_equal(gradient, [0, 0])
    value, gradient = derive(energy, [0, 0], dtype, mode)
    assert value == 12.5
    np.testing.assert_array_equal(gradient, [0, 0])

    def force(x):
        return ((x.norm() - 5.0) * x.normalized()).sum()

    value, gradient = derive(force, [0, 0], dtype, mode)
    assert value == 0
    assert np.isfinite(gradient).all()


# Functions of matrices against NumPy.


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3, 4])
def test_inverse_determinant_trace(n, dtype, mode):
    generator = np.random.default_rng(n)
    a = generator.standard_normal((n, n)) + 2 * np.eye(n)
    w = generator.standard_normal((n, n))
    rows, inverse = w.tolist(), np.linalg.inv(a)
    rtol = {"f64": 1e-12, "f32": 2e-4}[dtype]

    value, gradient = derive(lambda m: (m.inverse() * ti.Matrix(rows)).sum(), a, dtype, mode)
    assert value == pytest.approx((inverse * w).sum(), rel=rtol)
    expected = -inverse.T @ w @ inverse.T
    np.testing.assert_allclose(gradient, expected, rtol=rtol, atol=rtol)

    value, gradient = derive(lambda m: m.determinant(), a, dtype, mode)
    assert value == pytest.approx(np.linalg.det(a), rel=rtol)
    np.testing.assert_allclose(gradient, np.linalg.det(a) * inverse.T, rtol=rtol, atol=10 * rtol)

    value, gradient = derive(lambda m: m.trace(), a, dtype, mode)
    np.testing.assert_array_equal(gradient, np.eye(n))


@pytest.mark.parametrize("mode", MODES)
def test_determinant_of_singular_matrices(mode):
    a = np.outer([1.0, 2.0, 3.0], [1.0, -1.0, 2.0])
    value, gradient = derive(lambda m: m.determinant(), a, "f64", mode)
    assert value == 0
    np.testing.assert_array_equal(gradient, np.zeros((3, 3)))  # rank 1: all cofactors vanish
    value, gradient = derive(lambda m: m.determinant(), [[1, 2], [2, 4]], "f64", mode)
    assert value == 0
    np.testing.assert_array_equal(gradient, [[4, -2], [-2, 1]])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3])
def test_solve(n, dtype, mode):
    """x = A^-1 b: the adjoint of b is A^-T g, that of A is -A^-T g x^T."""
    generator = np.random.default_rng(10 + n)
    a = generator.standard_normal((n, n)) + 2 * np.eye(n)
    b, w = generator.standard_normal(n), generator.standard_normal(n)
    rtol = {"f64": 1e-12, "f32": 1e-4}[dtype]

    def function(m):
        x = ti.solve(ti.Matrix([[m[r, c] for c in range(n)] for r in range(n)]),
                     ti.Vector([m[n, c] for c in range(n)]))  # fmt: skip
        return x.dot(ti.Vector(w.tolist()))

    value, gradient = derive(function, np.vstack([a, b]), dtype, mode)
    x, adjoint = np.linalg.solve(a, b), np.linalg.solve(a.T, w)
    assert value == pytest.approx(x @ w, rel=rtol, abs=rtol)
    np.testing.assert_allclose(gradient[n], adjoint, rtol=rtol, atol=rtol)
    np.testing.assert_allclose(gradient[:n], -np.outer(adjoint, x), rtol=rtol, atol=rtol)


@pytest.mark.parametrize("mode", MODES)
def test_solve_where_the_pivot_is_zero(mode):
    def function(m):
        return ti.solve(m, ti.Vector([1.0, 2.0])).sum()

    value, gradient = derive(function, [[0, 2], [1, 0]], "f64", mode)
    assert value == 2.5
    np.testing.assert_array_equal(gradient, [[-2 * 0.5, -0.5 * 0.5], [-2, -0.5]])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-12), ("f32", 2e-5)])
@pytest.mark.parametrize("n", [2, 3])
def test_symmetric_eigenvalues(n, dtype, bound, mode):
    generator = np.random.default_rng(20 + n)
    points = [generator.standard_normal((n, n)), np.eye(n), np.diag([2.0, 1.0, 1.0][:n])]
    derivation = Derivation(
        lambda m: (ti.sym_eig(0.5 * (m + m.transpose()))[0] ** 3).sum(), (n, n), dtype, mode
    )
    for raw in points:
        a = raw + raw.T
        values, vectors = np.linalg.eigh(a)
        found, gradient = derivation(a)
        assert found == pytest.approx((values**3).sum(), rel=bound, abs=bound)
        expected = vectors @ np.diag(3 * values**2) @ vectors.T
        scale = np.abs(expected).max()
        np.testing.assert_allclose(gradient, expected, atol=10 * bound * scale)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_greatest_eigenvalue_and_its_projector(dtype, mode):
    """Where they are apart: d lambda = v v^T, and the projector turns by known rates."""
    a, w = np.diag([3.0, 2.0, -1.0]), np.random.default_rng(3).standard_normal((3, 3))
    _, gradient = derive(lambda m: ti.sym_eig(m)[0][0], a, dtype, mode)
    np.testing.assert_allclose(gradient, np.diag([1.0, 0, 0]), atol=1e-6)

    def projector(m):
        q = ti.sym_eig(0.5 * (m + m.transpose()))[1]
        v = ti.Vector([q[0, 0], q[1, 0], q[2, 0]])
        return (v.outer_product(v) * ti.Matrix(w.tolist())).sum()

    _, gradient = derive(projector, a, dtype, mode)
    expected, symmetric = np.zeros((3, 3)), 0.5 * (w + w.T)
    for k in (1, 2):
        expected[0, k] = expected[k, 0] = symmetric[0, k] / (a[0, 0] - a[k, k])
    np.testing.assert_allclose(gradient, expected, atol={"f64": 1e-13, "f32": 1e-5}[dtype])
