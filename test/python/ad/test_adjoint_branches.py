"""Gradients of branches: guards around them, and what only a branch that was taken contributes.

The reference is the same program at opt_level 0, where nothing is versioned or moved, or numpy.
"""

import os

import numpy as np
import pytest
import tai as ti

pytestmark = pytest.mark.filterwarnings("ignore::tai.ad.TaiGradientWarning")

#: What makes a partial derivative infinite or undefined, or nearly so.
BAD = {"good": 1.5, "zero": 0.0, "infinite": np.inf, "nan": np.nan, "negative": -1.0, "tiny": 1e-37}
REALS = [pytest.param(ti.f32, id="f32"), pytest.param(ti.f64, id="f64")]
SIZES = [1, 7, 300]


def both(run, real, **options):
    """The results of `run` at opt_level 3, which agree with those at 0."""
    results = []
    for level in (3, 0):
        ti.init(arch=ti.cpu, default_fp=real, opt_level=level, offline_cache=False, **options)
        results.append([np.asarray(found, np.float64) for found in run()])
    for found, expected in zip(*results, strict=True):
        far, near = (1e-3, 1e-4) if real == ti.f32 else (1e-10, 1e-12)
        np.testing.assert_allclose(found, expected, rtol=far, atol=near, equal_nan=True)
    return results[0]


class Joints:
    """Springs, some of which are joints: guards before, in and behind a branch."""

    def __init__(self, real, n):
        self.n = n
        self.x = ti.field(real, shape=n + 1, needs_grad=True)
        self.v = ti.field(real, shape=n + 1, needs_grad=True)
        self.rest = ti.field(real, shape=n, needs_grad=True)
        self.to = ti.field(ti.i32, shape=n)
        self.loss = ti.field(real, shape=(), needs_grad=True)
        x, v, rest, to, loss = self.x, self.v, self.rest, self.to, self.loss

        @ti.kernel
        def springs(m: ti.i32):
            for i in range(m):
                a, b = to[i], i
                way = x[a] - x[b]
                length = ti.abs(way) + 1e-3
                pull = (length - rest[i]) / length * way
                if rest[i] < 0:
                    slip = v[a] - v[b]
                    speed = ti.sqrt(slip * slip)
                    pull += slip / speed * ti.log(speed)
                loss[None] += pull * pull / rest[i] + v[b] * pull

        self.springs = springs
        self.to.from_numpy((np.arange(n, dtype=np.int32) * 3 + 1) % (n + 1))

    def gradient(self, x, v, rest):
        self.x.from_numpy(x)
        self.v.from_numpy(v)
        self.rest.from_numpy(rest)
        self.loss[None] = 0
        with ti.ad.Tape(self.loss):
            self.springs(self.n)
        return [field.grad.to_numpy() for field in (self.x, self.v, self.rest)]


@pytest.mark.parametrize("where", ["before", "inside", "behind"])
@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("n", SIZES)
def test_guards_around_a_branch(real, n, name, where):
    def run():
        program = Joints(real, n)
        x, v = np.linspace(0.5, 2, n + 1), np.linspace(3, 1, n + 1) ** 2
        rest = np.where(np.arange(n) % 3 == 1, -1.0, 0.7)
        for place in sorted({0, n // 2, n - 1}):
            for data in ({"before": [x], "inside": [v], "behind": [rest]})[where]:
                data[place] = BAD[name]
            yield from program.gradient(x, v, rest)

    both(run, real, cpu_max_num_threads=2)


@pytest.mark.parametrize("joint", [False, True])
def test_equal_speeds_in_a_joint(joint):
    """The derivative of a norm at zero times an infinite one, in the branch or not at all."""

    def run():
        program = Joints(ti.f64, 5)
        rest = np.full(5, -1.0 if joint else 0.7)
        return program.gradient(np.linspace(0, 1, 6), np.ones(6), rest)

    found = both(run, ti.f64)
    assert joint or all(np.isfinite(g).all() for g in found)


def contacts(real, n, corners):
    """Corners below a floor push their body; most are above."""
    x = ti.field(real, shape=n, needs_grad=True)
    angle = ti.field(real, shape=n, needs_grad=True)
    half = ti.field(real, shape=corners)
    force = ti.field(real, shape=n, needs_grad=True)
    loss = ti.field(real, shape=(), needs_grad=True)

    @ti.kernel
    def collide():
        for i in range(n):
            turn = ti.sin(angle[i])
            for k in range(corners):
                height = x[i] + half[k] * turn * ti.cos(half[k] * turn)
                if height < 0:
                    force[i] += ti.sqrt(-height) * height * height

    @ti.kernel
    def measure():
        for i in range(n):
            loss[None] += force[i]

    x.from_numpy(np.linspace(-0.3, 1, n))
    angle.from_numpy(np.linspace(0.1, 3, n))
    half.from_numpy(np.linspace(-1, 1, corners))

    def gradient():
        force.fill(0)
        loss[None] = 0
        with ti.ad.Tape(loss):
            collide()
            measure()
        return [x.grad.to_numpy(), angle.grad.to_numpy()]

    return gradient


def exact_contacts(n, corners):
    x, angle = np.linspace(-0.3, 1, n)[:, None], np.linspace(0.1, 3, n)[:, None]
    half = np.linspace(-1, 1, corners)[None]
    s = np.sin(angle)
    height = x + half * s * np.cos(half * s)
    depth = np.maximum(-height, 0)
    slope = -2.5 * depth**1.5
    inner = half * (np.cos(half * s) - half * s * np.sin(half * s))
    return [slope.sum(1), (slope * inner * np.cos(angle)).sum(1)]


def counters():
    return ti.profiler.skips()["untaken-branches"]


# By default products and sums become one operation, or not, as the code has it.
@pytest.mark.parametrize("mode", ["strict", "deterministic"])
@pytest.mark.parametrize("n, corners", [(1, 2), (7, 4), (300, 5)])
@pytest.mark.parametrize("real", REALS)
def test_contacts_have_the_same_bits_without_the_skip(real, n, corners, mode):
    found = {}
    for skip in ("all", "all,-untaken-branches"):
        ti.init(arch=ti.cpu, default_fp=real, skip=skip, offline_cache=False, **{mode: True})
        found[skip] = contacts(real, n, corners)()
        sinks = skip == "all" and os.environ.get("TI_ARCH") != "cuda"
        assert counters() == {"branches_sunk_into": int(sinks), "branches": int(sinks)}
    for one, other in zip(*found.values(), strict=True):
        np.testing.assert_array_equal(one, other)
    exact = exact_contacts(n, corners)
    for one, expected in zip(found["all"], exact, strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-3 if real == ti.f32 else 1e-9, atol=1e-5)


@pytest.mark.parametrize("threads", [1, 3])
def test_contacts_by_threads(threads):
    ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=threads, offline_cache=False)
    for one, expected in zip(contacts(ti.f64, 1001, 3)(), exact_contacts(1001, 3), strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-9, atol=1e-12)


def test_a_bad_value_behind_a_branch_that_is_not_taken():
    """Nothing of it arrives; where the branch is taken, all does."""

    def run():
        n = 12
        x = ti.field(ti.f64, shape=n, needs_grad=True)
        to = ti.field(ti.i32, shape=n)
        on = ti.field(ti.i32, shape=n)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def add():
            for i in range(n):
                root = ti.sqrt(x[to[i]])
                if on[i] == 1:
                    loss[None] += root * root * ti.log(root)

        x.from_numpy(np.array([0.0, np.inf, np.nan, -1.0] + [2.0] * (n - 4)))
        to.from_numpy(np.arange(n, dtype=np.int32))
        found = []
        for first in (4, 0):
            on.from_numpy((np.arange(n) >= first).astype(np.int32))
            loss[None] = 0
            with ti.ad.Tape(loss):
                add()
            found.append(x.grad.to_numpy())
        return found

    untaken, taken = both(run, ti.f64)
    assert np.isfinite(untaken).all() and (untaken[:4] == 0).all()
    assert not np.isfinite(taken[:4]).all()


def test_branches_in_branches_and_in_both_arms():
    def run():
        n = 40
        x = ti.field(ti.f64, shape=n, needs_grad=True)
        y = ti.field(ti.f64, shape=n, needs_grad=True)
        to = ti.field(ti.i32, shape=n)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def add():
            for i in range(n):
                j = to[i]
                a = x[j] * y[i]
                b = a / (1 + x[i] * x[i])
                if a > 0:
                    c = ti.sqrt(b + 2)
                    if b < 0.5:
                        loss[None] += c * y[j] / (a + 1)
                    else:
                        loss[None] += c
                elif b < -1:
                    loss[None] += ti.exp(b) * x[j]

        x.from_numpy(np.sin(np.arange(n)) * 2)
        y.from_numpy(np.cos(np.arange(n) * 1.7))
        to.from_numpy((np.arange(n, dtype=np.int32) * 7) % n)
        with ti.ad.Tape(loss):
            add()
        return [x.grad.to_numpy(), y.grad.to_numpy()]

    found = both(run, ti.f64)
    assert all(np.isfinite(g).all() and np.abs(g).max() > 0.1 for g in found)
