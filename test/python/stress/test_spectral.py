"""S36: functions of singular values and eigenvalues, from values apart to values that are equal."""

import warnings

import numpy as np
import pytest
import tai as ti

from points import MODES, TYPES, Points, number

mpmath = pytest.importorskip("mpmath")
mp = mpmath.mp

LOW, HIGH = 0.7, 1.4
GAPS = [10.0**-k for k in range(1, 18)] + [0.0]
EPSILON = {"f64": 2.0**-52, "f32": 2.0**-23}

# Functions of one value alone: in a kernel, and by mpmath.
ALONE = {
    "square": (lambda s: s * s, lambda s: s * s),
    "reciprocal": (lambda s: 1 / s, lambda s: 1 / s),
    "logarithm": (lambda s: ti.log(s), mp.log),
    "root": (lambda s: ti.sqrt(s), mp.sqrt),
    "clamp": (lambda s: ti.math.clamp(s, LOW, HIGH), lambda s: min(max(s, LOW), HIGH)),
}


def coupled(log, s):
    """The principal Kirchhoff stresses of Hencky's material: all values are in each."""
    logs = [log(x) for x in s]
    total = sum(logs[1:], logs[0])
    return [2 * x + 0.5 * total for x in logs]


def in_kernel(name, s):
    return coupled(ti.log, s) if name == "hencky" else [ALONE[name][0](x) for x in s]


def by_mpmath(name, s):
    return coupled(mp.log, s) if name == "hencky" else [ALONE[name][1](x) for x in s]


def rotation(seed, n):
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((n, n)))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return q


def slopes_of(name, s):
    """The derivative of each result by each value, by differences in 100 digits."""
    h = mp.mpf(10) ** -40
    columns = []
    for k in range(len(s)):
        sides = [by_mpmath(name, [x + (i == k) * d for i, x in enumerate(s)]) for d in (h, -h)]
        columns.append([(a - b) / (2 * h) for a, b in zip(*sides, strict=True)])
    return [[columns[k][i] for k in range(len(s))] for i in range(len(s))]


def expected(a, w, name, form):
    """The gradient of sum(w L f(Σ) R') by A, from the decomposition of A in 100 digits."""
    n = len(a)
    with mpmath.workdps(100):
        if form == "Q Q":
            s, q = mp.eigsy(mp.matrix(a.tolist()))
            u = v = np.array(q.tolist(), float)
            s = list(s)
        else:
            left, s, right = mp.svd_r(mp.matrix(a.tolist()))
            u, v, s = np.array(left.tolist(), float), np.array(right.tolist(), float).T, list(s)
        m, slopes = by_mpmath(name, s), slopes_of(name, s)
        near = mp.mpf(10) ** -30
        d, same, other = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
        for i in range(n):
            for j in range(n):
                gap, rise = s[j] - s[i], m[j] - m[i]
                if i != j:
                    limit = slopes[j][j] - slopes[j][i] - slopes[i][j] + slopes[i][i]
                    d[i, j] = rise / gap if abs(gap) > near else limit / 2
                if form != "Q Q":
                    same[i, j], other[i, j] = rise / (s[j] + s[i]), (m[j] + m[i]) / (s[j] + s[i])
        slopes = np.array([[float(x) for x in row] for row in slopes])
    first, second = form.split()
    factors = {"U": u, "V": v, "Q": u}
    gradient = np.zeros((n, n))
    for k in range(n):
        for l in range(n):
            p = np.outer(u[k], v[l])
            middle = (p + p.T) / 2 * d
            skew = (p - p.T) / 2
            if form != "Q Q":
                skew = skew * (same if first == second else other)
                middle = middle + (skew if first == "U" else -skew)
            np.fill_diagonal(middle, slopes @ np.diag(p))
            gradient[k, l] = (w * (factors[first] @ middle @ factors[second].T)).sum()
    return gradient


def cubes_in_place(n, rows):
    """sum(w U S³ V') with singular values that are changed where they are."""

    @ti.func
    def function(x):
        a = ti.Matrix([[x[n * i + j] for j in range(n)] for i in range(n)])
        u, s, v = ti.svd(a)
        for k in ti.static(range(n)):
            s[k, k] = s[k, k] ** 3
        return (u @ s @ v.transpose() * ti.Matrix(rows)).sum()

    return function


def weighted(name, form, n, w, way):
    """sum(w L f(Σ) R') in a kernel, written in one of several ways."""
    rows = w.tolist()

    def function(x):
        a = ti.Matrix([[x[n * i + j] for j in range(n)] for i in range(n)])
        if form == "Q Q":
            values, q = ti.sym_eig(a)
            left = right = q
            diagonal = [values[i] for i in range(n)]
        else:
            u, sigma, v = ti.svd(a)
            left, right = (u if f == "U" else v for f in form.split())
            diagonal = [sigma[i, i] for i in range(n)]
        made = in_kernel(name, diagonal)
        middle = ti.Matrix([[made[i] if i == j else 0.0 for j in range(n)] for i in range(n)])
        if way == "from the right":
            product = left @ (middle @ right.transpose())
        elif way == "in parts":
            half = left @ (2.0 * middle)
            product = ((right @ half.transpose()).transpose() * 3.0) @ ti.Matrix(rows).transpose()
            return product.trace() / 6.0
        else:
            product = left @ middle @ right.transpose()
        return (product * ti.Matrix(rows)).sum()

    return function


def matrices(n, form, dtype, least):
    """A matrix for each gap, with all values as far from each other; rounded to the type."""
    made = []
    for k, gap in enumerate(GAPS):
        values = least - 0.3 * gap + gap * np.arange(n)
        p, q = rotation(2 * k, n), rotation(2 * k + 1, n)
        a = p @ np.diag(values) @ (p if form == "Q Q" else q).T
        if k % 2 or gap == 0:
            a = np.diag(values)
        a = (a + a.T) / 2 if form == "Q Q" else a
        made.append(a.astype(number(dtype)).astype(float))
    return np.stack(made)


def check(name, form, n, dtype, mode, way, least=0.9):
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    w = np.random.default_rng(5).standard_normal((n, n)).astype(number(dtype)).astype(float)
    if form == "Q Q":
        w = (w + w.T) / 2
    a = matrices(n, form, dtype, least)
    function = weighted(name, form, n, w, way)
    _, found = Points(function, n * n, len(a), dtype, mode)(a.reshape(len(a), -1))
    found = found.reshape(-1, n, n).astype(float)
    assert np.isfinite(found).all()
    errors = []
    for matrix, gradient in zip(a, found, strict=True):
        right = expected(matrix, w, name, form)
        if form == "Q Q":
            # Elements above the diagonal are not read.
            gradient = (
                np.tril(gradient, -1) / 2 + np.tril(gradient, -1).T / 2 + np.diag(np.diag(gradient))
            )
        errors.append(np.abs(gradient - right).max() / np.abs(right).max())
    return np.array(errors)


def bound(dtype):
    """Where the quotient of differences and the derivative change places.

    At a gap d they are off by 4 eps / d and by d² / 3 and less: equal at d = (12 eps)^(1/3).
    """
    return 20 * EPSILON[dtype] ** (2 / 3)


FORMS = ["U V", "U U", "V V", "V U", "Q Q"]
NAMES = [*ALONE, "hencky"]


def pytest_generate_tests(metafunc):
    """All functions with the main form, all forms with the main function; all with all if long."""
    if {"name", "form"} <= set(metafunc.fixturenames):
        everything = metafunc.config.getoption("--long")
        pairs = [
            (name, form)
            for name in NAMES
            for form in FORMS
            if everything or form == "U V" or name == "square" or (form, name) == ("Q Q", "clamp")
        ]
        metafunc.parametrize(("name", "form"), pairs)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3])
def test_s36_from_values_apart_to_equal_ones(n, dtype, mode, name, form, measure):
    errors = check(name, form, n, dtype, mode, "anew")
    measure("of functions", errors.max(), bound(dtype))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("way", ["from the right", "in parts"])
@pytest.mark.parametrize("n", [2, 3])
def test_s36_however_it_is_written(n, way, mode, measure):
    for form in ("U V", "V U", "Q Q"):
        errors = check("square", form, n, "f64", mode, way)
        measure("of functions", errors.max(), bound("f64"))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("form", ["U V", "Q Q"])
def test_s36_a_kink_between_near_values(form, dtype, mode, measure):
    """No value is at the kink, and no smooth limit is right: an error of eps / gap remains."""
    errors = check("clamp", form, 2, dtype, mode, "anew", least=float(number(dtype)(HIGH)))
    apart = np.array(GAPS) > 64 * EPSILON[dtype]
    allowed = bound(dtype) + 32 * EPSILON[dtype] / np.array(GAPS)[apart]
    assert (errors[apart] <= allowed).all(), list(zip(GAPS, errors, strict=True))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("n", [2, 3])
def test_s36_odd_functions_where_values_cancel(n, dtype, mode, measure):
    """U S³ V' = A A' A, also where det A < 0, and at zero."""
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    w = np.random.default_rng(5).standard_normal((n, n)).astype(number(dtype)).astype(float)
    values = [
        [1.0, 1.0, -1.0],
        [1.5, 1.0, -1.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [1.0, 0.5, -0.5],
    ]
    a = np.stack([np.diag(v[-n:]) for v in values]).astype(number(dtype)).astype(float)

    cube = cubes_in_place(n, w.tolist())
    _, found = Points(cube, n * n, len(a), dtype, mode)(a.reshape(len(a), -1))
    found = found.reshape(-1, n, n).astype(float)
    right = np.stack([w @ m.T @ m + m @ w.T @ m + m @ m.T @ w for m in a])
    measure("of a cube", np.abs(found - right).max(), 100 * EPSILON[dtype])


@pytest.mark.parametrize("mode", MODES)
def test_s36_what_is_not_recognised_is_said(mode, tmp_path):
    """The sum of outer products of the columns of U and V: a warning names the line, once in a
    program, also where the code comes from the cache."""
    for from_cache in (False, True):
        ti.init(offline_cache_file_path=str(tmp_path), default_fp=ti.f64)
        kernels, run = products_by_columns(mode)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = run(kernels["as_a_product"])
        np.testing.assert_allclose(found, [[0, 1.5], [0.5, 0]], atol=1e-15)
        with pytest.warns(ti.ad.TaiGradientWarning, match="singular values are equal") as said:
            run(kernels["by_columns"])
        assert len(said) == 1, from_cache
        assert said[0].filename == __file__
        text = str(said[0].message)
        assert "ti.svd(x[None])  # LINE" in text and "^" in text and "differentiated as" in text
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run(kernels["by_columns"])
        ti.init(offline_cache_file_path=str(tmp_path), default_fp=ti.f64)
        kernels, run = products_by_columns(mode)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(ti.ad.TaiGradientWarning, match="singular values"):
                run(kernels["by_columns"])


def products_by_columns(mode):
    """Two kernels of one function of a matrix, and what runs one of them for its gradient."""
    needs = {"needs_grad": True} if mode == "reverse" else {"needs_dual": True}
    x = ti.Matrix.field(2, 2, ti.f64, shape=(), **needs)
    y = ti.field(ti.f64, shape=(), **needs)

    @ti.kernel
    def by_columns():
        u, s, v = ti.svd(x[None])  # LINE
        for k in ti.static(range(2)):
            y[None] += s[k, k] ** 2 * u[0, k] * v[1, k]

    @ti.kernel
    def as_a_product():
        u, s, v = ti.svd(x[None])
        for k in ti.static(range(2)):
            s[k, k] = s[k, k] ** 2
        y[None] += (u @ s @ v.transpose())[0, 1]

    def run(kernel):
        x[None] = [[1.0, 0.0], [0.0, 1.0]]
        if mode == "reverse":
            with ti.ad.Tape(y):
                kernel()
            return x.grad.to_numpy()
        found = np.zeros((2, 2))
        for k in np.ndindex(2, 2):
            seed = np.zeros((2, 2))
            seed[k] = 1
            y[None] = 0
            with ti.ad.FwdMode(loss=y, param=x, seed=seed.ravel().tolist()):
                kernel()
            found[k] = y.dual[None]
        return found

    return {"by_columns": by_columns, "as_a_product": as_a_product}, run


def cubes_for_curvature(n, kind, w):
    """y = <w, A A' A> by singular values of A, or <w, A^3> by eigenvalues of a symmetric A."""
    x = ti.Matrix.field(n, n, ti.f64, shape=(), needs_grad=True, needs_dual=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)

    @ti.kernel
    def cube():
        if ti.static(kind == "svd"):
            u, s, v = ti.svd(x[None])
            for k in ti.static(range(n)):
                s[k, k] = s[k, k] ** 3
            y[None] += (ti.Matrix(w) * (u @ s @ v.transpose())).sum()
        else:
            values, q = ti.sym_eig(x[None])
            m = ti.Matrix.zero(ti.f64, n, n)
            for k in ti.static(range(n)):
                m[k, k] = values[k] ** 3
            y[None] += (ti.Matrix(w) * (q @ m @ q.transpose())).sum()

    return cube, x, y


def turn_of(n, rng):
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


@pytest.mark.parametrize("kind", ["svd", "eig"])
@pytest.mark.parametrize("n", [2, 3])
def test_s36_second_derivatives(n, kind, measure):
    """Forward over reverse: off by eps / gap^2 between values that are near, and at equal ones,
    where how the factors turn is missing, the compiler warns."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    rng = np.random.default_rng(7)
    w, d = rng.standard_normal((2, n, n))
    if kind == "eig":
        w, d = w + w.T, d + d.T
    cube, x, y = cubes_for_curvature(n, kind, w.tolist())
    u, v = turn_of(n, rng), turn_of(n, rng)
    with pytest.warns(ti.ad.TaiGradientWarning, match="values are equal"):
        for gap in (1.0, 0.5, 1e-2, 1e-3):
            s = np.diag(1 + gap * np.arange(n))
            a = u @ s @ (v if kind == "svd" else u).T
            x[None], y[None] = a.tolist(), 0
            found = ti.ad.hvp(cube, y, x, d)
            if kind == "svd":  # of A A' A
                right = w @ d.T @ a + w @ a.T @ d + d @ w.T @ a + a @ w.T @ d
                right += d @ a.T @ w + a @ d.T @ w
            else:
                right = d @ w @ a + a @ w @ d + w @ d @ a + w @ a @ d + d @ a @ w + a @ d @ w
                # The gradient by a symmetric matrix: a triangle has it twice.
                found, right = found + found.T, right + right.T
            error = np.abs(found - right).max() / np.abs(right).max()
            measure(f"gap {gap:g}", error, 1e-13 + 16 * EPSILON["f64"] / gap**2)
