"""Sequences of launches that become one piece of work, and the option against it.

The emulated device runs the threads of a program one after another between two barriers, in an
order that changes: a barrier that lacks shows in the results.
"""

import os
import re

import numpy as np
import pytest
import tai as ti

N, STEPS, SWEEPS = 8, 4, 3


@pytest.fixture(autouse=True)
def device(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if not os.environ.get("TAI_CUDA_EMULATION"):
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    # These look at the programs of sweeps, which are of steps and barriers that are known.
    monkeypatch.setenv("TAI_COLLECT_RECORDINGS", "0")


def barriers_of(tape):
    """Steps and barriers of the programs that a tape has made."""
    return [
        (int(steps), int(barriers))
        for steps, barriers in re.findall(
            r"^(\d+) steps.* (\d+) barriers", tape.explain(), re.MULTILINE
        )
    ]


def init(fuse, **options):
    ti.init(offline_cache=False, deterministic=True, fuse_launches=fuse, bounds="off", **options)


def diffuse(fuse, runs=5):
    """A stencil around the borders, maps and a sum, forward and back: gradient and last tape."""
    init(fuse)
    heat = ti.field(ti.f32, shape=(STEPS * SWEEPS + 1, N, N), needs_grad=True)
    wind = ti.Vector.field(2, ti.f32, shape=(STEPS + 1, N, N), needs_grad=True)
    source = ti.field(ti.f32, shape=(N, N), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def blow(t: ti.i32):
        for i, j in ti.ndrange(N, N):
            k = ti.cast(ti.floor(wind[t, i, j][0]), ti.i32) % N
            wind[t + 1, i, j] = 0.9 * wind[t, i, j] + ti.Vector([source[i, j], wind[t, k, j][1]])

    @ti.kernel
    def sweep(s: ti.i32, t: ti.i32):
        for i, j in ti.ndrange(N, N):
            around = heat[s, (i + 1) % N, j] + heat[s, (i + N - 1) % N, j]
            around += heat[s, i, (j + 1) % N] + heat[s, i, (j + N - 1) % N]
            heat[s + 1, i, j] = 0.24 * around + wind[t, i, j][0] * wind[t, i, j][1]

    @ti.kernel
    def total():
        for i, j in ti.ndrange(N, N):
            loss[None] += heat[STEPS * SWEEPS, i, j] ** 2 + wind[STEPS, i, j].dot(wind[STEPS, i, j])

    values = np.random.default_rng(3)
    source.from_numpy(values.random((N, N), np.float32))
    heat.from_numpy(values.random((STEPS * SWEEPS + 1, N, N), np.float32))
    wind.from_numpy(4 * values.random((STEPS + 1, N, N, 2), np.float32))
    results = []
    for _ in range(runs):
        with ti.ad.Tape(loss) as tape:
            for t in range(STEPS):
                blow(t)
                for s in range(t * SWEEPS, (t + 1) * SWEEPS):
                    sweep(s, t)
            total()
        results.append((loss[None], source.grad.to_numpy(), heat.grad.to_numpy()))
    return results, tape


def test_bits_are_those_of_single_launches():
    fused, fused_tape = diffuse(True)
    plain, plain_tape = diffuse(False)
    for one, other in zip(fused, plain, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
    assert not barriers_of(plain_tape)
    # The sweeps must wait for each other, the first and last of the rest for them.
    ((steps, barriers),) = barriers_of(fused_tape)
    assert STEPS * SWEEPS - 1 <= barriers <= STEPS * SWEEPS + 2 < steps - 1


def test_threads_that_go_on_with_their_elements_do_not_wait():
    init(True)
    x = ti.field(ti.f32, shape=(6, 40), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def square(t: ti.i32):
        for i in range(40):
            x[t + 1, i] = x[t, i] * x[t, i]

    @ti.kernel
    def total():
        for i in range(40):
            loss[None] += x[5, i]

    start = np.linspace(0.9, 1.05, 6 * 40, dtype=np.float32).reshape(6, 40)
    for _ in range(4):
        x.from_numpy(start)
        with ti.ad.Tape(loss) as tape:
            for t in range(5):
                square(t)
            total()
        np.testing.assert_allclose(x.grad.to_numpy()[0], 32 * start[0].astype(float) ** 31, 1e-4)
    ((steps, barriers),) = barriers_of(tape)
    # The five are one group; in front of it, the adjoint of the sum may wait for that of the loss.
    assert steps >= 6
    assert barriers <= 1


def test_the_option_has_one_name():
    with pytest.raises(ti.TaiRuntimeError, match="fuse_launch"):
        ti.init(fuse_launch=False)


def test_rows_that_are_written_out_are_known():
    # More accesses than a list keeps one by one: neighbours are counted as one.
    init(True)
    columns = 120
    w = ti.field(ti.f32, shape=(3, columns), needs_grad=True)
    y = ti.field(ti.f32, shape=(5, 3), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def product(t: ti.i32):
        for i in range(3):
            total = 0.0
            for k in ti.static(range(columns)):
                total += w[i, k] * y[t, k % 3]
            y[t + 1, i] = total

    @ti.kernel
    def total():
        for i in range(3):
            loss[None] += y[4, i]

    weights = np.random.default_rng(5).random((3, columns), np.float32) / 40
    w.from_numpy(weights)
    y.fill(1.0)
    for _ in range(4):
        with ti.ad.Tape(loss) as tape:
            for t in range(4):
                product(t)
            total()
    matrix = weights.astype(float).reshape(3, columns // 3, 3).sum(axis=1)
    expected = np.ones(3) @ np.linalg.matrix_power(matrix, 4)
    np.testing.assert_allclose(y.grad.to_numpy()[0], expected, 1e-5)
    assert barriers_of(tape)
    assert "unknown" not in tape.explain()


def test_another_order_runs_the_same_kernels():
    """The parameters decide which steps wait for which, and thereby their order."""
    # Without deterministic, which runs scatters on one thread in their order.
    ti.init(offline_cache=False, fuse_launches=True)
    x = ti.field(ti.f64, shape=(6, N), needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def double(s: ti.i32, d: ti.i32):
        for i in range(N):
            x[d, i] = 2.0 * x[s, (i + 1) % N]

    @ti.kernel
    def triple(s: ti.i32, d: ti.i32):
        for i in range(N):
            x[d, i] = 3.0 * x[s, (i + 1) % N]

    @ti.kernel
    def quintuple(s: ti.i32, d: ti.i32):
        for i in range(N):
            x[d, i] = 5.0 * x[s, (i + 1) % N]

    @ti.kernel
    def total():
        for r, i in ti.ndrange(6, N):
            loss[None] += (r + 1) * (i + 1) * x[r, i]

    weights = np.outer(np.arange(1.0, 7.0), np.arange(1.0, N + 1.0))
    # The source of the last: first a row of the second kernel, then one of the first.
    for source in [4, 4, 4, 4, 3, 3, 4]:
        with ti.ad.Tape(loss):
            double(0, 3)
            triple(1, 4)
            quintuple(source, 5)
            total()
        expected = weights.copy()
        for factor, s, d in [(5.0, source, 5), (3.0, 1, 4), (2.0, 0, 3)]:
            expected[s] += factor * np.roll(expected[d], 1)
        np.testing.assert_allclose(x.grad.to_numpy()[:2], expected[:2], rtol=1e-12)
