"""Small vectors and matrices, in kernels and in Python, against NumPy."""

import numpy as np
import pytest
import tai as ti

A = np.array([[1.0, 2.0, -1.0], [0.5, 3.0, 2.0], [4.0, -2.0, 1.5]])
B = np.array([[2.0, -1.0, 0.5], [1.0, 0.0, 3.0], [-0.5, 2.0, 1.0]])
U = np.array([1.0, -2.0, 0.5])
V = np.array([3.0, 1.0, 2.0])


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def matrix_result(function, shape):
    """The result of `function(a, b, u, v)` in a kernel, as an array of the given shape."""
    a = ti.Matrix.field(3, 3, ti.f64, shape=())
    b = ti.Matrix.field(3, 3, ti.f64, shape=())
    u = ti.Vector.field(3, ti.f64, shape=())
    v = ti.Vector.field(3, ti.f64, shape=())
    for field, value in ((a, A), (b, B), (u, U), (v, V)):
        field.from_numpy(value)
    if len(shape) == 2:
        out = ti.Matrix.field(*shape, ti.f64, shape=())
    elif len(shape) == 1:
        out = ti.Vector.field(*shape, ti.f64, shape=())
    else:
        out = ti.field(ti.f64, shape=())

    @ti.kernel
    def kernel():
        out[None] = function(a[None], b[None], u[None], v[None])

    kernel()
    return out.to_numpy()


CASES = [
    (lambda a, b, u, v: a + b, A + B),
    (lambda a, b, u, v: a - 2 * b, A - 2 * B),
    (lambda a, b, u, v: a * b, A * B),
    (lambda a, b, u, v: a / b[0, 0], A / B[0, 0]),
    (lambda a, b, u, v: 1 / (a + 10), 1 / (A + 10)),
    (lambda a, b, u, v: a @ b, A @ B),
    (lambda a, b, u, v: a @ u, A @ U),
    (lambda a, b, u, v: -a, -A),
    (lambda a, b, u, v: abs(a), abs(A)),
    (lambda a, b, u, v: u**2 + v, U**2 + V),
    (lambda a, b, u, v: u % 1.5, U % 1.5),
    (lambda a, b, u, v: a.transpose(), A.T),
    (lambda a, b, u, v: u.outer_product(v), np.outer(U, V)),
    (lambda a, b, u, v: u.cross(v), np.cross(U, V)),
    (lambda a, b, u, v: u.dot(v), U @ V),
    (lambda a, b, u, v: u.norm(), np.linalg.norm(U)),
    (lambda a, b, u, v: u.norm(0.25), np.sqrt(U @ U + 0.25)),
    (lambda a, b, u, v: u.norm_sqr(), U @ U),
    (lambda a, b, u, v: u.norm_inv(), 1 / np.linalg.norm(U)),
    (lambda a, b, u, v: u.normalized(), U / np.linalg.norm(U)),
    (
        lambda a, b, u, v: ti.Vector.normalized(v) * ti.Matrix.norm(u),
        V / np.linalg.norm(V) * np.linalg.norm(U),
    ),
    (lambda a, b, u, v: u.normalized(0.5), U / (np.linalg.norm(U) + 0.5)),
    (lambda a, b, u, v: (0 * u).normalized(), 0 * U),
    (lambda a, b, u, v: a.trace(), np.trace(A)),
    (lambda a, b, u, v: a.determinant(), np.linalg.det(A)),
    (lambda a, b, u, v: a.inverse(), np.linalg.inv(A)),
    (lambda a, b, u, v: a.sum(), A.sum()),
    (lambda a, b, u, v: a.max() - a.min(), A.max() - A.min()),
    (lambda a, b, u, v: a.norm(), np.linalg.norm(A)),
    (lambda a, b, u, v: ti.sin(a), np.sin(A)),
    (lambda a, b, u, v: ti.exp(u), np.exp(U)),
    (lambda a, b, u, v: ti.max(u, v), np.maximum(U, V)),
    (lambda a, b, u, v: ti.min(u, 0.0), np.minimum(U, 0)),
    (lambda a, b, u, v: ti.select(u < v, u, v), np.minimum(U, V)),
    (lambda a, b, u, v: ti.floor(a), np.floor(A)),
    (lambda a, b, u, v: ti.solve(a, u), np.linalg.solve(A, U)),
    (lambda a, b, u, v: u.xy, U[:2]),
    (lambda a, b, u, v: u.zyx, U[::-1]),
    (lambda a, b, u, v: u.xxz, U[[0, 0, 2]]),
    (lambda a, b, u, v: u.z * v.y, U[2] * V[1]),
    (lambda a, b, u, v: a[1, 2], A[1, 2]),
    (lambda a, b, u, v: a[1, :], A[1]),
    (lambda a, b, u, v: a[:, 0], A[:, 0]),
    (lambda a, b, u, v: ti.Matrix.rows([u, v]), np.stack([U, V])),
    (lambda a, b, u, v: ti.Matrix.cols([u, v]), np.stack([U, V], axis=1)),
    (lambda a, b, u, v: ti.Matrix([[u[0], 1], [2, 3]]), np.array([[U[0], 1], [2, 3]])),
    (lambda a, b, u, v: ti.Matrix.diag(2, 4.5), 4.5 * np.eye(2)),
    (lambda a, b, u, v: ti.Matrix.identity(ti.f64, 3), np.eye(3)),
    (lambda a, b, u, v: ti.Vector.zero(ti.f64, 2), np.zeros(2)),
    (lambda a, b, u, v: ti.Vector.one(ti.f64, 2), np.ones(2)),
    (lambda a, b, u, v: ti.Vector.unit(3, 1, ti.f64), np.array([0, 1, 0])),
    (lambda a, b, u, v: ti.math.clamp(u, -1.0, 0.7), U.clip(-1, 0.7)),
    (lambda a, b, u, v: ti.math.mix(u, v, 0.25), 0.75 * U + 0.25 * V),
    (lambda a, b, u, v: ti.math.dot(u, v), U @ V),
    (lambda a, b, u, v: ti.math.cross(u, v), np.cross(U, V)),
    (lambda a, b, u, v: ti.math.normalize(v), V / np.linalg.norm(V)),
    (lambda a, b, u, v: ti.math.length(v), np.linalg.norm(V)),
    (lambda a, b, u, v: ti.math.sign(u), np.sign(U)),
    (lambda a, b, u, v: ti.math.vec2(u.xy), U[:2]),
    (lambda a, b, u, v: ti.math.vec3(u.xy, 4.0), np.array([*U[:2], 4])),
    (lambda a, b, u, v: ti.math.vec3(2.0), np.full(3, 2.0)),
    (lambda a, b, u, v: ti.math.mat2(1, 2, 3, 4), np.array([[1, 2], [3, 4]])),
]


@pytest.mark.parametrize("number", range(len(CASES)))
def test_in_a_kernel(number):
    function, expected = CASES[number]
    shape = np.shape(expected)
    np.testing.assert_allclose(matrix_result(function, shape), expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    "function, expected",
    # ti.solve stands in kernels only.
    [case for case in CASES if "solve" not in case[0].__code__.co_names],
)
def test_in_python(function, expected):
    arguments = [ti.Matrix(A), ti.Matrix(B), ti.Vector(U), ti.Vector(V)]
    result = function(*arguments)
    result = result.to_numpy() if hasattr(result, "to_numpy") else result
    np.testing.assert_allclose(result, expected, rtol=1e-6, atol=1e-12)


def test_polar_svd_eigen():
    a = ti.Matrix.field(2, 2, ti.f64, shape=8)
    worst = ti.field(ti.f64, shape=8)
    a.from_numpy(np.random.default_rng(1).standard_normal((8, 2, 2)))

    @ti.kernel
    def kernel():
        for i in a:
            r, s = ti.polar_decompose(a[i])
            u, sig, v = ti.svd(a[i])
            sym = a[i] + a[i].transpose()
            values, vectors = ti.sym_eig(sym)
            one = ti.Matrix.identity(ti.f64, 2)
            w = (r @ s - a[i]).norm() + (r @ r.transpose() - one).norm()
            w += (s - s.transpose()).norm()
            w += (u @ sig @ v.transpose() - a[i]).norm()
            w += (sym @ vectors - vectors @ ti.Matrix([[values[0], 0], [0, values[1]]])).norm()
            worst[i] = w

    kernel()
    assert worst.to_numpy().max() < 1e-12


def test_dynamic_index():
    x = ti.field(ti.f64, shape=(3, 3))
    y = ti.Vector.field(3, ti.f64, shape=3)

    @ti.kernel
    def read():
        m = ti.Matrix([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])
        for i in range(3):
            for j in range(3):
                x[i, j] = m[i, j]

    @ti.kernel
    def write():
        for i in y:
            v = ti.Vector([0.0, 0.0, 0.0])
            for j in range(i + 1):
                v[j] = 10 * i + j
            y[i] = v
            y[i][i] += 100

    read()
    write()
    assert x.to_numpy().tolist() == np.arange(1, 10).reshape(3, 3).tolist()
    assert y.to_numpy().tolist() == [[100, 0, 0], [10, 111, 0], [20, 21, 122]]


@pytest.mark.parametrize("shape", [(20,), (5, 7)], ids=str)
def test_dynamic_index_of_many_components(shape):
    columns = shape[1] if len(shape) == 2 else 1
    count = int(np.prod(shape))
    kind = ti.types.vector(count, ti.f64) if columns == 1 else ti.types.matrix(*shape, ti.f64)
    x = kind.field(shape=(), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    order = ti.field(ti.i32, shape=12)
    rng = np.random.default_rng(0)
    numbers, places = rng.standard_normal(shape), rng.integers(0, count, 12)
    x.from_numpy(numbers)
    order.from_numpy(places.astype(np.int32))

    @ti.func
    def at(n):
        return ti.Vector([n]) if ti.static(columns == 1) else ti.Vector([n // columns, n % columns])

    @ti.kernel
    def mix():
        v, used = x[None], ti.Vector([0 for _ in range(count)])
        ti.loop_config(serialize=True)
        for n in range(11):
            a, b = order[n], order[n + 1]
            v[at(a)] = v[at(a)] * v[at(b)] + ti.sin(v[at(b)])
            used[a] += 1
        loss[None] = v.norm_sqr() + used[order[0]]

    def expected(numbers):
        v = numbers.ravel().copy()
        for a, b in zip(places, places[1:], strict=False):
            v[a] = v[a] * v[b] + np.sin(v[b])
        return (v**2).sum() + (places[:11] == places[0]).sum()

    with ti.ad.Tape(loss):
        mix()
    assert loss[None] == pytest.approx(expected(numbers), rel=1e-12)
    for place in places[:4]:
        step = np.zeros(count)
        step[place] = 1e-6
        step = step.reshape(shape)
        slope = (expected(numbers + step) - expected(numbers - step)) / 2e-6
        assert x.grad.to_numpy().ravel()[place] == pytest.approx(slope, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("columns", [3, 9])
def test_rows_and_columns_by_a_dynamic_index(columns):
    numbers = np.arange(2.0 * columns).reshape(2, columns)
    f = ti.Matrix.field(2, columns, ti.f64, shape=2, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    f.from_numpy(np.stack([numbers, numbers]))

    @ti.kernel
    def kernel(i: ti.i32, j: ti.i32) -> ti.types.vector(columns, ti.f64):
        m = f[0]
        m[i, :] = m[1 - i, :] * 2
        m[:, j] += ti.Vector([100.0, 200.0])
        f[1][i, 1:3] = ti.Vector([-1.0, -2.0])
        return m[i, :]

    @ti.kernel
    def energy(i: ti.i32, j: ti.i32):
        loss[None] = f[0][i, :].norm_sqr() + f[0][:, j].sum()

    for i, j in ((0, 2), (1, 0)):
        expected = 2 * numbers[1 - i]
        expected[j] += 100 * (i + 1)
        assert kernel(i, j).to_list() == expected.tolist()
    assert f[1].to_list()[1][:3] == [numbers[1, 0], -1, -2]
    with ti.ad.Tape(loss):
        energy(1, 2)
    slope = np.zeros((2, columns))
    slope[1] = 2 * numbers[1]
    slope[:, 2] += 1
    assert f.grad.to_numpy()[0].tolist() == slope.tolist()


@pytest.mark.parametrize("count", [5, 20])
def test_dynamic_index_out_of_range(count):
    """Nothing is stored, and the last component is read, however many there are."""

    @ti.kernel
    def kernel(j: ti.i32) -> ti.types.vector(2, ti.f64):
        v = ti.Vector([1.0 * i for i in range(count)])
        last = v[j]
        v[j] = 100
        return ti.Vector([v.sum(), last])

    total = count * (count - 1) / 2
    for j in (count, -1, 2**31 - 1, -(2**31)):
        assert kernel(j).to_list() == [total, count - 1]
    assert kernel(count - 1).to_list() == [total - (count - 1) + 100, count - 1]


def test_component_assignment():
    y = ti.Matrix.field(2, 2, ti.f64, shape=2)

    @ti.kernel
    def kernel():
        for i in y:
            m = ti.Matrix([[0.0, 0.0], [0.0, 0.0]])
            m[0, 1] = 3
            m[1, 0] += i
            if i == 1:
                m[1, 1] = 7
            y[i] = m
            y[i][0, 0] = 5
            y[i][0, 0] += 1

    kernel()
    assert y.to_numpy().tolist() == [[[6, 3], [0, 0]], [[6, 3], [1, 7]]]


def test_swizzle_assignment():
    y = ti.Vector.field(3, ti.f64, shape=2)

    @ti.kernel
    def kernel():
        for i in y:
            v = ti.Vector([1.0, 2.0, 3.0])
            v.xy = v.yx
            v.z *= 10
            y[i] = v
            y[i].x += i
            y[i].yz = ti.Vector([8.0, 9.0])

    kernel()
    assert y.to_numpy().tolist() == [[2, 8, 9], [3, 8, 9]]


def test_fill():
    y = ti.Matrix.field(2, 2, ti.f64, shape=3)

    @ti.func
    def halve(v: ti.template(), w):
        v.fill(0.5)
        w.fill(9)

    @ti.kernel
    def kernel(n: ti.i32) -> ti.types.vector(5, ti.f64):
        for i in y:
            y[i].fill(i)
            y[i][0, :].fill(7)
        v, w = ti.Vector([1.0, 2.0, 3.0]), ti.Vector([4.0, 5.0])
        u = w
        halve(v, w)
        ti.loop_config(serialize=True)
        for i in range(n):
            if i == 2:
                v.fill(i)
            else:
                v[0] += 1
        v.yz.fill(-1)
        return ti.Vector([v.x, v.y, v.z, w.x, u.y])

    assert [kernel(n).to_list() for n in (1, 4)] == [[1.5, -1, -1, 4, 5], [3, -1, -1, 4, 5]]
    assert y.to_numpy().tolist() == [[[7, 7], [i, i]] for i in range(3)]


def test_vectors_carried_by_loops():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.types.vector(2, ti.f64):
        v = ti.Vector([1.0, 0.0])
        ti.loop_config(serialize=True)
        for i in range(n):
            if i % 2 == 0:
                v += ti.Vector([0.5, i])
            else:
                v = v * 2
        return v

    v = np.array([1.0, 0.0])
    for i in range(5):
        v = v + [0.5, i] if i % 2 == 0 else v * 2
    assert kernel(5).to_list() == v.tolist()


def test_integer_vectors():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.types.vector(4, ti.i32):
        a = ti.Vector([n, 7])
        b = a // 2 + ti.Vector([1, -1]) * a
        c = (a > 3).any()
        d = (a > 3).all()
        return ti.Vector([b[0], b[1], c, d])

    assert kernel(-5).to_list() == [-3 - 5, 3 - 7, 1, 0]


def test_vector_sums_are_atomic():
    total = ti.Vector.field(2, ti.f64, shape=())

    @ti.kernel
    def kernel():
        for i in range(1000):
            total[None] += ti.Vector([1.0, i])

    kernel()
    assert total[None].to_list() == [1000, 499500]


def test_sums_into_parts_of_vectors_are_atomic():
    """Iterations on other threads add to the same elements, at indices from data."""
    count = 100_000
    place = ti.field(ti.i32, shape=count)
    place.from_numpy((np.arange(count) % 7).astype(np.int32))
    v = ti.Vector.field(3, ti.i32, shape=7)
    m = ti.Matrix.field(2, 3, ti.i32, shape=7)

    @ti.kernel
    def scatter(a: ti.types.ndarray(dtype=ti.types.vector(3, ti.i32), ndim=1)):
        for i in place:
            j = place[i]
            v[j].zx += ti.Vector([1, 2])
            m[j][1, :] += ti.Vector([1, 2, 3])
            m[j][i % 2, :2] -= ti.Vector([1, 1])
            ti.atomic_max(v[j].yz, ti.Vector([i, 0]))
            a[j].xy += ti.Vector([1, 2])

    array = np.zeros((7, 3), np.int32)
    scatter(array)
    times = np.bincount(np.arange(count) % 7)
    odd = np.bincount(np.arange(1, count, 2) % 7)
    last = count - 1 - (count - 1 - np.arange(7)) % 7
    assert v.to_numpy().tolist() == np.stack([2 * times, last, times], 1).tolist()
    rows = [[odd - times, odd - times, 0 * odd], [times - odd, 2 * times - odd, 3 * times]]
    assert m.to_numpy().tolist() == np.moveaxis(np.array(rows), 2, 0).tolist()
    assert array.tolist() == np.stack([times, 2 * times, 0 * times], 1).tolist()


@pytest.mark.parametrize("order", [ti.Layout.AOS, ti.Layout.SOA], ids=["aos", "soa"])
@pytest.mark.parametrize("dt", [ti.i32, ti.u8, ti.f16, ti.f64], ids=str)
def test_components_known_when_the_kernel_runs(dt, order):
    """Other iterations may change the others meanwhile: only the one is written."""
    count = 30_000
    place = ti.field(ti.i32, shape=count)
    place.from_numpy((np.arange(count) % 70).astype(np.int32))
    v = ti.Vector.field(3, dt, shape=(70, 70), layout=order)
    m = ti.Matrix.field(2, 2, dt, shape=70, layout=order)
    before = ti.field(ti.i32, shape=())

    @ti.kernel
    def scatter():
        for i in place:
            j = place[i]
            if i < 7000:
                v[j, j][i % 3] += ti.cast(1, dt)
            m[j][i % 2, (i // 2) % 2] = ti.cast(i % 4, dt)
        for _ in range(1):
            old = ti.atomic_add(v[3, 3][before[None] + 1], ti.cast(5, dt))
            before[None] = ti.cast(old, ti.i32)

    scatter()
    expected = np.zeros((70, 3), int)
    np.add.at(expected, (np.arange(7000) % 70, np.arange(7000) % 3), 1)
    assert before[None] == expected[3, 1]
    expected[3, 1] += 5
    found = v.to_numpy().astype(int)
    assert (found[np.arange(70), np.arange(70)] == expected).all()
    assert found.sum() == expected.sum()
    i = np.arange(count - 140, count)
    odd = m.to_numpy().astype(int)
    assert (odd[i % 70, i % 2, i // 2 % 2] == i % 4).all()


def test_gradients_of_components_in_arrays_of_their_own():
    n = 40
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    at = ti.field(ti.i32, shape=n)
    v = ti.Vector.field(3, ti.f64, shape=5, layout=ti.Layout.SOA, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.linspace(-1, 2, n))
    at.from_numpy((np.arange(n) % 7 % 5).astype(np.int32))

    @ti.kernel
    def scatter():
        for i in x:
            v[at[i]][i % 3] += x[i] * x[i]

    @ti.kernel
    def total():
        for i in v:
            loss[None] += v[i].norm_sqr()

    with ti.ad.Tape(loss):
        scatter()
        total()
    i = np.arange(n)
    sums = np.zeros((5, 3))
    np.add.at(sums, (i % 7 % 5, i % 3), x.to_numpy() ** 2)
    assert loss[None] == pytest.approx((sums**2).sum())
    assert x.grad.to_numpy() == pytest.approx(4 * sums[i % 7 % 5, i % 3] * x.to_numpy())


def test_python_matrices():
    v = ti.Vector([1, 2, 3])
    v[1] = 5
    v.z = 7
    assert v.to_list() == [1, 5, 7] and v.n == 3 and v.m == 1
    assert (v == ti.Vector([1, 5, 7])).all()
    assert len(v) == 3 and list(v) == [1, 5, 7]
    m = ti.Matrix([[1, 2], [3, 4]], dt=ti.f32)
    assert m.dtype is ti.f32 and m.n == 2 and m.m == 2
    assert (3 + m)[1, 1] == 7 and (m @ m).to_list() == [[7, 10], [15, 22]]
    with pytest.raises(ti.TaiRuntimeTypeError):
        m @ v
    with pytest.raises(ti.TaiRuntimeTypeError):
        v + ti.Vector([1, 2])
    with pytest.raises(AttributeError):
        _ = v.w


@pytest.mark.parametrize("op", ["+", "-", "*", "//", "%", "**", "<", "==", "&", "<<"])
@pytest.mark.parametrize("number", [2, np.int32(2)])
def test_whole_vectors_and_numbers_in_python(op, number):
    v = ti.Vector([1, 5, 7])
    for text in (f"v {op} n", f"n {op} v"):
        found = eval(text, {"v": v, "n": number}).to_numpy()
        np.testing.assert_array_equal(found, eval(text, {"v": np.array([1, 5, 7]), "n": number}))
        if op in "+-*":
            assert found.dtype == np.int32
    assert (v + 1).dtype is ti.i32


def test_not_of_whole_vectors():
    """True where a component is zero."""

    @ti.kernel
    def kernel(v: ti.types.vector(3, ti.i32)) -> ti.types.vector(3, ti.i32):
        return ti.cast(not v, ti.i32)

    assert list(kernel([0, 1, -2])) == [1, 0, 0]


def test_rows_are_vectors_or_lists():
    @ti.kernel
    def of_vectors(v: ti.types.vector(2, ti.f64)) -> ti.types.matrix(3, 2, ti.f64):
        return ti.Matrix([v, [5.0, 6.0], 2 * v])

    @ti.kernel
    def of_matrices(m: ti.types.matrix(2, 2, ti.f64)) -> ti.types.matrix(2, 2, ti.f64):
        return ti.Matrix([m, m])

    assert of_vectors([1, 2]).to_list() == [[1, 2], [5, 6], [2, 4]]
    with pytest.raises(ti.TaiTypeError, match="the rows of a matrix are vectors or lists"):
        of_matrices([[1, 2], [3, 4]])
