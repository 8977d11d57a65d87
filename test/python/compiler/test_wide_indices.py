"""Loop bounds and indices that 32 bits cannot hold: nothing is cut, on no device."""

import os

import numpy as np
import pytest
import tai as ti

HALF, FULL = 2**31, 2**32


@pytest.fixture(autouse=True, params=["cpu", "device"])
def start(request, monkeypatch):
    if request.param == "device":
        monkeypatch.setenv("TI_ARCH", "cuda")
        if not os.environ.get("TAI_CUDA_EMULATION"):
            monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(default_fp=ti.f64, offline_cache=False)


def fields(n=16):
    out = ti.field(ti.i64, n)
    out.fill(-1)
    return out


@pytest.mark.parametrize("low", [0, HALF - 3, HALF, FULL - 2, FULL, 2**40, -HALF - 2, -FULL, -3])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_parallel_range(low: int, count: int):
    out = fields()

    @ti.kernel
    def run(low: ti.i64, high: ti.i64):
        for i in range(low, high):
            out[i - low] = i

    run(low, low + count)
    assert out.to_numpy().tolist() == [low + k if k < count else -1 for k in range(16)]


def test_many_iterations():
    n = 65537
    out = ti.field(ti.i64, n)

    @ti.kernel
    def run(low: ti.i64, high: ti.i64):
        for i in range(low, high):
            out[i - low] = i

    run(FULL - 5, FULL - 5 + n)
    assert np.array_equal(out.to_numpy(), np.arange(FULL - 5, FULL - 5 + n))


def test_constant_bounds():
    out = fields()

    @ti.kernel
    def run():
        for i in range(ti.i64(FULL), ti.i64(FULL + 3)):
            out[i - FULL] = i

    @ti.kernel
    def plain():
        for i in range(FULL, FULL + 6):
            out[i - FULL] += i

    run()
    assert out.to_numpy()[:4].tolist() == [FULL, FULL + 1, FULL + 2, -1]
    out.fill(0)
    plain()
    assert out.to_numpy()[:7].tolist() == [*range(FULL, FULL + 6), 0]


@pytest.mark.parametrize("low", [HALF - 2, FULL, -FULL - 1])
def test_serial_range(low: int):
    """A serial loop in a parallel one, and one that stands alone."""
    out = ti.field(ti.i64, (3, 8))
    alone = fields()

    @ti.kernel
    def run(low: ti.i64, high: ti.i64):
        for k in range(3):
            for i in range(low, high):
                out[k, i - low] = i + k

    @ti.kernel
    def total(low: ti.i64, high: ti.i64):
        s = ti.i64(0)
        i = low
        while i < high:
            s += i
            i += 1
        alone[0] = s

    run(low, low + 8)
    total(low, low + 8)
    assert np.array_equal(out.to_numpy(), low + np.arange(8) + np.arange(3)[:, None])
    assert alone[0] == sum(range(low, low + 8))


def test_steps():
    """The number of steps from one end of i32 to the other is none of i32."""
    count = ti.field(ti.i64, ())
    last = ti.field(ti.i64, ())

    @ti.kernel
    def run(low: ti.i32, high: ti.i32):
        for i in range(low, high, 2**30):
            count[None] += 1
            ti.atomic_max(last[None], i)

    @ti.kernel
    def wide():
        for i in range(-FULL, FULL, HALF):
            count[None] += 1
            ti.atomic_max(last[None], i)

    run(-HALF, HALF - 1)
    assert (count[None], last[None]) == (4, 2**30)
    count[None] = last[None] = 0
    wide()
    assert (count[None], last[None]) == (4, HALF)


def test_grouped():
    out = ti.field(ti.i64, (2, 2), offset=(0, HALF - 1))

    @ti.kernel
    def run():
        for index in ti.grouped(out):
            out[index] = index[0] + index[1]

    run()
    assert [out[0, HALF - 1], out[1, HALF]] == [HALF - 1, HALF + 1]


def test_bounds_from_fields():
    """Bounds that only the device knows."""
    bounds = ti.field(ti.i64, 2)
    out = fields()
    bounds[0], bounds[1] = FULL + 1, FULL + 6

    @ti.kernel
    def run():
        for i in range(bounds[0], bounds[1]):
            out[i - bounds[0]] = i

    run()
    assert out.to_numpy()[:6].tolist() == [*range(FULL + 1, FULL + 6), -1]


def test_ndrange():
    """Each extent is small enough; a first index is not."""
    out = ti.field(ti.i64, (4, 4))

    @ti.kernel
    def run(low: ti.i64, high: ti.i64, n: ti.i32):
        for i, j in ti.ndrange((low, high), n):
            out[i - low, j] = i + j

    run(FULL, FULL + 4, 4)
    assert np.array_equal(out.to_numpy(), FULL + np.arange(4) + np.arange(4)[:, None])


def test_products():
    """i * n + j in 64 bits, from indices of 32."""
    out = ti.field(ti.i64, (4, 4))

    @ti.kernel
    def run(n: ti.i64):
        for i, j in out:
            out[i, j] = i * n + j

    run(3 * HALF)
    expected = 3 * HALF * np.arange(4)[:, None] + np.arange(4)
    assert np.array_equal(out.to_numpy(), expected)


def test_index_of_division():
    """An index that becomes small only by a division of a large number."""
    out = fields()

    @ti.kernel
    def run(n: ti.i64):
        for i in range(16):
            out[(i * n + n) // n - 1] = i
            out[(i * n + i) % n] = i

    run(FULL + 1)
    assert out.to_numpy().tolist() == list(range(16))


def test_reduction():
    @ti.kernel
    def run(low: ti.i64, high: ti.i64) -> ti.i64:
        s = ti.i64(0)
        for i in range(low, high):
            s += i
        return s

    assert run(FULL - 50, FULL + 50) == sum(range(FULL - 50, FULL + 50))


def test_while_within_a_loop():
    out = fields(5)

    @ti.kernel
    def run(step: ti.i64):
        for k in out:
            i = ti.i64(0)
            while i < 8 * step:
                i += step
            out[k] = i + k

    run(HALF)
    assert out.to_numpy().tolist() == [8 * HALF + k for k in range(5)]


@pytest.mark.parametrize("low", [5, HALF - 2, FULL])
def test_gradient(low: int):
    x = ti.field(ti.f64, 8, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    x.from_numpy(np.arange(8.0))

    @ti.kernel
    def run(low: ti.i64, high: ti.i64):
        for i in range(low, high):
            s = 1.0
            for k in range(low, i + 1):
                s *= 1.0 + x[k - low] * (k - low + 1)
            loss[None] += s

    with ti.ad.Tape(loss):
        run(low, low + 8)
    v = np.arange(8.0)
    factors = 1 + v * (np.arange(8) + 1)
    products = np.cumprod(factors)
    expected = [sum(products[k:]) / factors[k] * (k + 1) for k in range(8)]
    assert loss[None] == pytest.approx(products.sum(), rel=1e-12)
    np.testing.assert_allclose(x.grad.to_numpy(), expected, rtol=1e-12)


def test_recorded_program():
    """A sequence of launches, replayed with other bounds."""
    x = ti.field(ti.f64, 6, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    x.fill(2.0)

    @ti.kernel
    def square(low: ti.i64, high: ti.i64):
        for i in range(low, high):
            loss[None] += x[i - low] ** 2

    for low in (3, FULL + 3, -FULL):
        with ti.ad.Tape(loss):
            square(low, low + 6)
            square(low, low + 3)
        assert loss[None] == 36
        assert x.grad.to_numpy().tolist() == [8, 8, 8, 4, 4, 4]


def test_tree_of_large_extents():
    """Cells far from the first, of a tree whose indices still fit and one where they do not."""
    for n in (2**20, 2**33):
        x = ti.field(ti.i64)
        ti.root.pointer(ti.i, n // 16).dense(ti.i, 16).place(x)

        @ti.kernel
        def put(x: ti.template(), at: ti.i64):
            for i in range(at, at + 3):
                x[i] = i

        @ti.kernel
        def total(x: ti.template()) -> ti.i64:
            s = ti.i64(0)
            for i in x:
                if x[i] == i:
                    s += i
            return s

        put(x, n - 3)
        put(x, n // 2)
        assert total(x) == 3 * n - 6 + 3 * (n // 2) + 3
        assert x[n - 1] == n - 1


def test_large_arrays():
    """Offsets beyond 2**31 bytes: a small part of a large field is touched."""
    n = 2**29 + 64
    x = ti.field(ti.i64)
    ti.root.dense(ti.i, n).place(x)

    @ti.kernel
    def run(low: ti.i32):
        for i in range(low, low + 64):
            x[i] = i

    run(2**29)
    assert x[2**29 + 63] == 2**29 + 63
    assert x[2**29] == 2**29


def test_bounds_of_all_i32():
    """The last iterations before the largest i32 end the loop."""
    out = fields()
    top = HALF - 1

    @ti.kernel
    def run(low: ti.i32, high: ti.i32):
        for i in range(low, high):
            out[i - low] = i

    run(top - 5, top)
    assert out.to_numpy()[:6].tolist() == [*range(top - 5, top), -1]
    run(-HALF, -HALF + 4)
    assert out.to_numpy()[:5].tolist() == [*range(-HALF, -HALF + 4), top - 1]


def test_debug_mode_sees_what_is_out_of_range():
    """An index cut to 32 bits would be in range."""
    ti.init(debug=True, offline_cache=False)
    out = ti.field(ti.i32, 8)

    @ti.kernel
    def run(at: ti.i64):
        for _ in range(1):
            out[at] = 1

    with pytest.raises(ti.TaiRuntimeError, match=str(FULL + 2)):
        run(FULL + 2)
    assert out.to_numpy().sum() == 0
