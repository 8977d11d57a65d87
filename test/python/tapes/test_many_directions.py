"""Several directions in one call of `ti.ad.jvp`, and in one launch of a batch."""

import numpy as np
import pytest
import tai as ti

N, COUNT = 6, 4
START = np.linspace(0.2, 1.1, N)
DIRECTIONS = np.random.default_rng(2).normal(size=(COUNT, N))


def simulator():
    """A simulator that works in place, and the derivative of its final state."""
    ti.init(default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=N, needs_dual=True)
    speed = ti.Vector.field(2, ti.f64, shape=N, needs_dual=True)

    @ti.kernel
    def step():
        for i in x:
            speed[i] += 0.1 * ti.Vector([ti.sin(x[i]), x[i] ** 2])
        for i in x:
            x[i] += 0.1 * speed[i].sum()

    def run():
        for _ in range(5):
            step()

    x.from_numpy(START)
    return run, x, speed


def in_numpy(x, v):
    for _ in range(5):
        v = v + 0.1 * np.stack([np.sin(x), x**2], axis=-1)
        x = x + 0.1 * v.sum(axis=-1)
    return x, v


def test_many_directions():
    run, x, speed = simulator()
    more = np.random.default_rng(3).normal(size=(COUNT, N, 2))
    by_x, by_v = ti.ad.jvp(run, [x, speed], [DIRECTIONS, more], [x, speed], many=True)
    assert by_x.shape == (COUNT, N) and by_v.shape == (COUNT, N, 2)
    for k in range(COUNT):
        moved = in_numpy(START + 1e-30j * DIRECTIONS[k], 1e-30j * more[k])
        np.testing.assert_allclose(by_x[k], moved[0].imag / 1e-30, rtol=1e-12)
        np.testing.assert_allclose(by_v[k], moved[1].imag / 1e-30, rtol=1e-12)
    # The fields are as before, and one direction gives the same bits.
    np.testing.assert_array_equal(x.to_numpy(), START)
    one = ti.ad.jvp(run, x, DIRECTIONS[2:3], x, many=True)[0]
    np.testing.assert_array_equal(ti.ad.jvp(run, x, DIRECTIONS[2], x), one)


def test_many_directions_of_a_number():
    ti.init(default_fp=ti.f64, offline_cache=False)
    t, y = (ti.field(ti.f64, shape=(), needs_dual=True) for _ in range(2))

    @ti.kernel
    def cube():
        y[None] = t[None] ** 3

    t[None] = 2.0
    found = ti.ad.jvp(cube, t, [1.0, -2.0, 0.5], y, many=True)
    np.testing.assert_allclose(found, [12.0, -24.0, 6.0])
    assert ti.ad.jvp(cube, t, [1.0], y, many=True).shape == (1,)


def test_directions_of_all_worlds_in_one_launch():
    ti.init(default_fp=ti.f64, offline_cache=False)
    worlds = ti.batch(COUNT)
    x = worlds.field(ti.f64, N, needs_dual=True)
    v = worlds.field(ti.f64, N, needs_dual=True)

    @worlds.kernel
    def step():
        for i in range(N):
            v[i] += 0.1 * (ti.sin(x[i]) + x[i] ** 2)
        for i in range(N):
            x[i] += 0.1 * v[i]

    def run():
        for _ in range(5):
            step()

    x.from_numpy(np.tile(START, (COUNT, 1)))
    found = ti.ad.jvp(run, x, DIRECTIONS, x)
    for k in range(COUNT):
        moved = in_numpy(START + 1e-30j * DIRECTIONS[k], np.zeros((N, 2)))[0]
        np.testing.assert_allclose(found[k], moved.imag / 1e-30, rtol=1e-12)


def test_wrong_stacks_of_directions():
    run, x, speed = simulator()
    for given, text in [
        (DIRECTIONS[0], r"must have shape \(n, 6\), but got \(6,\)"),
        (DIRECTIONS[:, :3], r"must have shape \(n, 6\), but got \(4, 3\)"),
        (DIRECTIONS[:0], "at least one"),
    ]:
        with pytest.raises(ti.TaiRuntimeTypeError, match=text):
            ti.ad.jvp(run, x, given, x, many=True)
    with pytest.raises(ti.TaiRuntimeTypeError, match="the same number of directions"):
        ti.ad.jvp(run, [x, speed], [DIRECTIONS, np.zeros((2, N, 2))], x, many=True)
    plain = ti.field(ti.f64, shape=N, name="plain")
    with pytest.raises(ti.TaiAutodiffError, match="'plain' has no dual"):
        ti.ad.jvp(run, plain, DIRECTIONS, x, many=True)
    np.testing.assert_array_equal(x.to_numpy(), START)
