"""Loops over blocked fields, which run a row at a time: against NumPy."""

import numpy as np
import pytest
import tai as ti

N, B = 32, 8


def place_pointer(fields, n=N, b=B):
    ti.root.pointer(ti.ij, n // b).dense(ti.ij, b).place(*fields)


def place_apart(fields, n=N, b=B):
    # A gradient shares the activity of its field.
    for field in fields:
        if not any(field is other.grad for other in fields):
            both = [f for f in fields if f is field or f is field.grad]
            ti.root.bitmasked(ti.ij, n // b).dense(ti.ij, b).place(*both)


def place_two_levels(fields, n=N, b=B):
    ti.root.pointer(ti.ij, n // b // 2).pointer(ti.ij, 2).dense(ti.ij, b).place(*fields)


def place_dense_blocks(fields, n=N, b=B):
    ti.root.dense(ti.ij, n // b).dense(ti.ij, b).place(*fields)


def place_mixed(fields, n=N, b=B):
    ti.root.pointer(ti.ij, n // b).dense(ti.ij, b).place(fields[0])
    ti.root.dense(ti.ij, n).place(*fields[1:])


LAYOUTS = [place_pointer, place_apart, place_two_levels, place_dense_blocks, place_mixed]


def random_blocks(shape, block, seed):
    """Values in some of the blocks, zero in the others, and which those are."""
    rng = np.random.default_rng(seed)
    active = rng.random([s // block for s in shape]) < 0.6
    for axis in range(len(shape)):
        active = np.repeat(active, block, axis)
    return np.where(active, rng.normal(size=shape), 0.0), active


def write(field, values, active):
    for index in zip(*np.nonzero(active), strict=True):
        field[tuple(int(i) for i in index)] = values[index].item()


def shifted(x, di, dj):
    """x[i + di, j + dj], and zero outside."""
    padded = np.pad(x, 1)
    return padded[1 + di : 1 + di + x.shape[0], 1 + dj : 1 + dj + x.shape[1]]


def five_points(x):
    near = shifted(x, -1, 0) + shifted(x, 1, 0) + shifted(x, 0, -1) + shifted(x, 0, 1)
    return 0.5 * x + 0.125 * near


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
def test_stencil_away_from_the_border(layout, dtype):
    ti.init(arch=ti.cpu)
    x, y = ti.field(dtype), ti.field(dtype)
    layout([x, y])

    @ti.kernel
    def step():
        for i, j in x:
            if 0 < i < N - 1 and 0 < j < N - 1:
                near = x[i - 1, j] + x[i + 1, j] + x[i, j - 1] + x[i, j + 1]
                y[i, j] = 0.5 * x[i, j] + 0.125 * near

    values, active = random_blocks((N, N), B, seed=1)
    write(x, values, active)
    step()
    if layout is place_dense_blocks:
        active = np.ones_like(active)
    inner = np.zeros_like(active)
    inner[1:-1, 1:-1] = active[1:-1, 1:-1]
    expected = np.where(inner, five_points(values), 0.0)
    np.testing.assert_allclose(y.to_numpy(), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_periodic_stencil(layout):
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x, y = ti.field(ti.f64), ti.field(ti.f64)
    layout([x, y])

    @ti.kernel
    def step():
        for i, j in x:
            right, up = (i + 1) % N, (j + 1) % N
            left, down = (i - 1 + N) % N, (j - 2 + N) % N
            y[i, j] = x[right, j] - 2.0 * x[left, down] + 3.0 * x[i, up]

    values, active = random_blocks((N, N), B, seed=2)
    write(x, values, active)
    step()
    if layout is place_dense_blocks:
        active = np.ones_like(active)
    expected = (
        np.roll(values, -1, 0)
        - 2 * np.roll(np.roll(values, 1, 0), 2, 1)
        + 3 * np.roll(values, -1, 1)
    )
    np.testing.assert_allclose(y.to_numpy(), np.where(active, expected, 0.0), atol=1e-14)


def test_rows_become_active_where_they_are_written():
    ti.init(arch=ti.cpu)
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    block = ti.root.pointer(ti.ij, N // B)
    block.dense(ti.ij, B).place(x)
    other = ti.root.pointer(ti.ij, N // B)
    other.dense(ti.ij, B).place(y)

    @ti.kernel
    def copy():
        for i, j in x:
            y[i, j] = x[i, j] + 1

    x[3, 9] = 2
    x[31, 31] = 4
    copy()
    assert [tuple(c) for c in other.active_cells()] == [(0, 1), (3, 3)]
    expected = np.zeros((N, N))
    expected[0:8, 8:16] = expected[24:32, 24:32] = 1
    expected[3, 9], expected[31, 31] = 3, 5
    np.testing.assert_array_equal(y.to_numpy(), expected)


def test_indices_as_values_and_integers():
    ti.init(arch=ti.cpu)
    a, b = ti.field(ti.i32), ti.field(ti.f32)
    ti.root.pointer(ti.ij, (3, 2)).dense(ti.ij, (5, 16)).place(a, b, offset=(-4, 7))

    @ti.kernel
    def fill():
        for i, j in a:
            a[i, j] = 100 * i + j if i > j else i * j
            b[i, j] = ti.sqrt(ti.cast(j, ti.f32)) * 2.0

    a[-4, 7] = 1
    a[6, 30] = 1
    fill()
    got_a, got_b = a.to_numpy(), b.to_numpy()
    i, j = np.meshgrid(np.arange(-4, 11), np.arange(7, 39), indexing="ij")
    active = np.zeros((15, 32), bool)
    active[0:5, 0:16] = active[10:15, 16:32] = True
    np.testing.assert_array_equal(got_a, np.where(active, np.where(i > j, 100 * i + j, i * j), 0))
    np.testing.assert_allclose(got_b, np.where(active, 2 * np.sqrt(j), 0), rtol=1e-6)


def test_three_dimensions_of_vectors():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    n = 12
    v, w = ti.Vector.field(3, ti.f64), ti.Vector.field(3, ti.f64)
    ti.root.pointer(ti.ijk, n // 4).dense(ti.ijk, 4).place(v, w)

    @ti.kernel
    def step():
        for i, j, k in v:
            if 0 < i and j < n - 2 and 1 < k < n - 1:
                w[i, j, k] = v[i - 1, j, k] + 2.0 * v[i, j + 2, k] - v[i, j, k - 2]
                w[i, j, k][1] = v[i, j, k + 1][2]

    rng = np.random.default_rng(3)
    values = rng.normal(size=(n, n, n, 3))
    v.from_numpy(values)
    step()
    expected = np.zeros_like(values)
    c = np.s_[1:, : n - 2, 2 : n - 1]
    expected[c] = (
        values[: n - 1, : n - 2, 2 : n - 1]
        + 2 * values[1:, 2:, 2 : n - 1]
        - values[1:, : n - 2, : n - 3]
    )
    expected[c + (1,)] = values[1:, : n - 2, 3:, 2]
    np.testing.assert_allclose(w.to_numpy(), expected, atol=1e-14)


def test_in_place_and_in_one_dimension():
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x, s = ti.field(ti.f64), ti.field(ti.f64, shape=())
    ti.root.bitmasked(ti.i, 8).dense(ti.i, 16).place(x)

    @ti.kernel
    def step():
        for i in x:
            x[i] = x[i] * s[None] + 1.0
            x[i] -= 0.5 * x[i]

    s[None] = 3.0
    x[5] = 2.0
    x[77] = -1.0
    step()
    expected = np.zeros(128)
    expected[0:16] = expected[64:80] = 0.5
    expected[5], expected[77] = 3.5, -1.0
    np.testing.assert_array_equal(x.to_numpy(), expected)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_gradient_is_the_transpose(layout):
    """The stencil is linear: <y', A x'> = <A^T y', x'> for random x', y'."""
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    x, y = (ti.field(ti.f64, needs_grad=True) for _ in range(2))
    r = ti.field(ti.f64)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    layout([x, y, r, x.grad, y.grad])

    @ti.kernel
    def step():
        for i, j in x:
            if 0 < i < N - 1 and 0 < j < N - 1:
                y[i, j] = 3.0 * x[i, j] - x[i - 1, j] + 2.0 * x[i, j + 1]

    @ti.kernel
    def measure():
        for i, j in x:
            loss[None] += r[i, j] * y[i, j]

    values, active = random_blocks((N, N), B, seed=4)
    weights = np.random.default_rng(5).normal(size=(N, N))
    write(x, values, active)
    write(r, weights, active)
    write(x.grad, 0 * values, active)
    write(y.grad, 0 * values, active)
    with ti.ad.Tape(loss):
        step()
        measure()
    gradient = x.grad.to_numpy()
    if layout is place_dense_blocks:
        weights = np.where(active, weights, 0.0)
    inner = np.zeros_like(active)
    inner[1:-1, 1:-1] = True
    taken = np.where(active & inner, weights, 0.0)
    expected = 3 * taken - shifted(taken, 1, 0) + 2 * shifted(taken, 0, -1)
    # Inactive cells have no gradient; that of a dense field is everywhere.
    if layout not in (place_dense_blocks, place_mixed):
        expected = np.where(active, expected, 0.0)
    np.testing.assert_allclose(gradient, expected, atol=1e-13)
