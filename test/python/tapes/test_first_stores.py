"""Gradients that a sweep stores before it reads them are not cleared: the same bits."""

import ctypes
import os

import numpy as np
import pytest
import tai as ti

N = 8192
# A device clears all gradients; results are the same there.
ON_CPU = os.environ.get("TI_ARCH", "cpu") == "cpu"
OFF = "all,-unread-zeros"
SKIPS = ("all", OFF, "none")


def counts():
    return ti.profiler.skips()["unread-zeros"]


def fields(dtype, *names):
    return [ti.field(dtype, shape=N, needs_grad=True) for _ in names]


def scenes(dtype):
    """Functions that launch kernels, by name, and the fields whose gradients matter."""
    x, y, z = fields(dtype, "x", "y", "z")
    v = ti.Vector.field(2, dtype, shape=N, needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    @ti.kernel
    def wave():
        for i in x:
            y[i] = x[i] * ti.sin(x[i])

    @ti.kernel
    def stencil():
        for i in range(N):
            z[i] = y[(i + 1) % N] * 0.5 - y[i] * y[i] + y[(i - 1) % N]

    @ti.kernel
    def vectors():
        for i in v:
            y[i] = v[i][0] * v[i][1] + v[i].dot(v[i])

    @ti.kernel
    def end(first: ti.i32, last: ti.i32):
        for i in range(first, last):
            loss[None] += z[i] * z[i] + y[i]

    @ti.kernel
    def inner():
        for i in range(1, N - 1):
            y[i] = x[i + 1] - x[i]

    @ti.kernel
    def part():
        for i in range(1, N - 1):
            y[i] = x[i] * x[i]

    def chain():
        wave()
        stencil()
        end(100, 180)

    def twice():
        wave()
        total()
        end(0, N)

    def mixed():
        vectors()
        stencil()
        end(0, N)

    def bounded():
        inner()
        end(0, N)

    def partial():
        part()
        end(0, N)

    return loss, (x, y, z, v), {"total": total, "chain": chain, "twice": twice,
                                "mixed": mixed, "bounded": bounded, "partial": partial}  # fmt: skip


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("name", ["total", "chain", "twice", "mixed", "bounded", "partial"])
def test_first_stores_have_the_same_bits(name, dtype):
    found = {}
    for skip in SKIPS:
        ti.init(skip=skip, default_fp=dtype, deterministic=True, offline_cache=False)
        loss, all_fields, launches = scenes(dtype)
        rng = np.random.default_rng(7)
        bits = []
        for _ in range(4):
            for field in all_fields:
                field.from_numpy(rng.uniform(-1, 1, field.to_numpy().shape))
            loss[None] = 0.0
            with ti.ad.Tape(loss) as tape:
                launches[name]()
            bits.append([field.grad.to_numpy().tobytes() for field in all_fields])
        # Replays clear gradients as well.
        tape.replay()
        bits.append([field.grad.to_numpy().tobytes() for field in all_fields])
        found[skip] = bits
        # The host has read the gradients, so that they were no debt any more.
        number = counts()["fields_stored_first"]
        assert (number > 0) == (ON_CPU and skip == "all" and name != "partial")
        assert ("not cleared" in tape.explain()) == (number > 0)
    assert found["all"] == found[OFF] == found["none"]


def test_zeros_of_either_sign_stay():
    """An adjoint of minus zero is added to a zero."""
    found = []
    for skip in SKIPS:
        ti.init(skip=skip, offline_cache=False)
        (x,) = fields(ti.f32, "x")
        loss = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def total(x: ti.template(), loss: ti.template(), factor: ti.f32):
            for i in x:
                loss[None] += x[i] * factor

        for factor in (2.0, -0.0):
            with ti.ad.Tape(loss):
                total(x, loss, factor)
        found.append(x.grad.to_numpy())
        assert not np.signbit(found[-1]).any()
    assert found[0].tobytes() == found[1].tobytes() == found[2].tobytes()


def test_everyone_who_looks_finds_zeros():
    ti.init(offline_cache=False)
    loss, (x, *_), launches = scenes(ti.f32)
    y = ti.field(ti.f32, shape=N)

    @ti.kernel
    def read():
        for i in x:
            y[i] = x.grad[i]

    def sweep():
        with ti.ad.Tape(loss):
            launches["total"]()

    for look in (
        lambda: x.grad.to_numpy(),
        lambda: np.array([x.grad[i] for i in (0, 5, N - 1)]),
        lambda: (read(), y.to_numpy())[1],
        lambda: np.from_dlpack(x.grad).copy(),
    ):
        sweep()
        sweep()
        assert x.grad[3] == 1.0
        # The tape clears, and then its sweep does not happen.
        with pytest.raises(ZeroDivisionError), ti.ad.Tape(loss):
            1 / 0  # noqa: B018
        assert not look().any()


def test_whoever_has_an_address_finds_zeros():
    """A gradient that a program reads and writes by its address is cleared, and added to."""
    ti.init(offline_cache=False)
    loss, (x, *_), launches = scenes(ti.f32)
    kind = ctypes.POINTER(ctypes.c_float)
    at = ctypes.cast(x.grad.core.address((0,)), kind) if ON_CPU else None
    for number in range(4):
        with ti.ad.Tape(loss):
            launches["total"]()
            if ON_CPU:
                assert at[7] == 0.0
                at[7] = 10.0
        assert x.grad[7] == (11.0 if ON_CPU else 1.0), number
    assert counts()["fields_stored_first"] == 0


def test_a_seed_of_the_program_is_kept():
    """A gradient that the host writes during the recording is added to."""
    found = []
    for skip in ("all", OFF):
        ti.init(skip=skip, offline_cache=False)
        loss, (x, *_), launches = scenes(ti.f32)
        for _ in range(2):
            with ti.ad.Tape(loss):
                launches["total"]()
        with ti.ad.Tape(loss):
            launches["total"]()
            x.grad[7] = 10.0
        found.append(x.grad.to_numpy())
        assert found[-1][7] == 11.0 and found[-1][8] == 1.0
    assert found[0].tobytes() == found[1].tobytes()


def test_another_order_of_launches_clears():
    """A kernel that stored a gradient first adds to it in the next tape."""
    found = []
    for skip in ("all", OFF):
        ti.init(skip=skip, offline_cache=False)
        loss, (x, *_), launches = scenes(ti.f32)

        @ti.kernel
        def one(x: ti.template(), loss: ti.template()):
            loss[None] += 3.0 * x[17]

        for late in (False, True, False, True):
            with ti.ad.Tape(loss):
                if not late:
                    one(x, loss)
                launches["total"]()
                if late:
                    one(x, loss)
            found.append(x.grad.to_numpy().tobytes())
            assert x.grad[17] == 4.0 and x.grad[18] == 1.0
    assert len(set(found)) == 1


def test_a_sweep_that_fails_leaves_no_old_numbers():
    ti.init(offline_cache=False, debug=True)
    loss, (x, *_), launches = scenes(ti.f32)

    @ti.kernel
    def guarded(limit: ti.f32):
        for i in x:
            assert x[i] < limit
            loss[None] += x[i] * x[i]

    def sweep(value):
        x.fill(value)
        with ti.ad.Tape(loss):
            guarded(10.0)

    sweep(1.0)
    sweep(2.0)
    assert x.grad[0] == 4.0
    with pytest.raises(Exception, match="assert|limit"):
        sweep(20.0)
    sweep(3.0)
    assert (x.grad.to_numpy() == 6.0).all()


def test_blocks_without_adjoints_are_set_to_zero():
    """The skip of blocks stores zeros where memory holds old numbers."""
    found = {}
    for skip in SKIPS:
        ti.init(skip=skip, offline_cache=False, deterministic=True)
        loss, (x, y, *_), launches = scenes(ti.f32)

        @ti.kernel
        def heavy():
            for i in x:
                y[i] = ti.sin(3.0 * x[i]) * ti.exp(-x[i] * x[i]) + ti.cos(x[i])

        @ti.kernel
        def part(first: ti.i32, last: ti.i32):
            for i in range(first, last):
                loss[None] += y[i] ** 2

        x.from_numpy(np.random.default_rng(3).uniform(-1, 1, N).astype("float32"))
        bits = []
        for first, last in ((0, N), (100, 200), (5000, 5001), (0, N), (0, 0)):
            with ti.ad.Tape(loss):
                heavy()
                part(first, last)
            bits.append(x.grad.to_numpy().tobytes())
        found[skip] = bits
        skipped = ti.profiler.skips()["zero-adjoints"]["cells_skipped"]
        assert (skipped > N) == (ON_CPU and skip != "none")
    assert found["all"] == found[OFF] == found["none"]
