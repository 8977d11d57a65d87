"""S29 to S31, S36, S37: contacts, friction, flat land, plastic clamps, springs at rest."""

import numpy as np
import pytest
import tai as ti

from points import MODES, TYPES, Points, number

STEPS, DT, GROUND = 203, 0.002, 0.1


class Ball:
    """A ball that bounces once, with and without the time of impact."""

    def __init__(self, dtype, mode, exact):
        real = TYPES[dtype]
        kind = {"needs_grad": True} if mode == "reverse" else {"needs_dual": True}
        self.mode, self.exact = mode, exact
        height = self.height = ti.field(real, shape=(), **kind)
        loss = self.loss = ti.field(real, shape=(), **kind)
        x, v = ti.field(real, shape=STEPS + 1, **kind), ti.field(real, shape=STEPS + 1, **kind)

        @ti.kernel
        def start():
            x[0] = height[None]
            v[0] = -2.0

        @ti.kernel
        def advance(t: ti.i32):
            for _ in range(1):
                old, speed = x[t], v[t]
                impact = 0.0
                if old + DT * speed < GROUND and speed < 0:
                    speed = -speed
                    if ti.static(exact):
                        impact = -(old - GROUND) / v[t]
                v[t + 1] = speed
                x[t + 1] = old + impact * v[t] + (DT - impact) * speed

        @ti.kernel
        def end():
            loss[None] = x[STEPS]

        self.kernels = start, advance, end

    def run(self):
        start, advance, end = self.kernels
        start()
        for t in range(STEPS):
            advance(t)
        end()

    def slope(self, height):
        self.height[None] = height
        if self.mode == "reverse":
            with ti.ad.Tape(self.loss):
                self.run()
            return self.height.grad[None]
        with ti.ad.FwdMode(loss=self.loss, param=self.height, seed=[1.0]):
            self.run()
        return self.loss.dual[None]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-12), ("f32", 1e-5)])
def test_s29_time_of_impact(dtype, bound, mode, measure):
    """A ball that starts higher comes back later: -1. Without the time of impact it is +1, and
    wrong."""
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    heights = [0.3 + 0.037 * k for k in range(10)]
    ball = Ball(dtype, mode, exact=True)
    measure("of 10 heights", max(abs(ball.slope(h) + 1) for h in heights), bound)
    naive = Ball(dtype, mode, exact=False)
    assert [naive.slope(h) for h in heights] == [1.0] * 10


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_s30_balls_that_miss(dtype, mode, measure):
    """No ball meets the one that is measured: the gradient is zero, exactly, the loss is not."""
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    real = TYPES[dtype]
    kind = {"needs_grad": True} if mode == "reverse" else {"needs_dual": True}
    start = ti.field(real, shape=2, **kind)
    x = ti.Vector.field(2, real, shape=(33, 3), **kind)
    loss = ti.field(real, shape=(), **kind)

    @ti.kernel
    def begin():
        x[0, 0] = ti.Vector([start[0], start[1]])
        x[0, 1] = ti.Vector([1.0, 0.5])
        x[0, 2] = ti.Vector([2.0, 2.0])

    @ti.kernel
    def move(t: ti.i32):
        for i in range(3):
            push = ti.Vector([0.0, 0.0])
            for j in range(3):
                if i != j:
                    d = x[t, i] - x[t, j]
                    if d.norm() < 0.1:
                        push += d.normalized() * (0.1 - d.norm())
            x[t + 1, i] = x[t, i] + push

    @ti.kernel
    def miss():
        loss[None] = (x[32, 1] - ti.Vector([0.75, 0.5])).norm_sqr()

    def run():
        begin()
        for t in range(32):
            move(t)
        miss()

    if mode == "reverse":
        with ti.ad.Tape(loss, health=True) as tape:
            run()
        found = start.grad.to_numpy()
        assert any(finding.kind == "flat" for finding in tape.health().findings)
    else:
        with ti.ad.FwdMode(loss=loss, param=start, seed=[1.0, -2.0]):
            run()
        found = loss.dual.to_numpy()
    assert loss[None] == 0.0625
    measure("gradient", np.abs(found).max(), 0.0)


@ti.func
def friction(x):
    """A corner that slides: the impulse stops it or is at most what friction holds."""
    speed, normal = x[0], x[1]
    impulse = -speed
    limit = 0.5 * normal
    if ti.abs(impulse) > limit:
        impulse = limit * ti.math.sign(impulse)
    return (speed + impulse) ** 2 + 0.25 * impulse * normal


def friction_in_numpy(speed, normal):
    impulse, limit = -speed, 0.5 * normal
    if abs(impulse) > limit:
        impulse = limit * np.sign(impulse)
    return (speed + impulse) ** 2 + 0.25 * impulse * normal


@pytest.mark.parametrize("mode", MODES)
def test_s31_corner_of_friction(mode, measure):
    """Sticking and sliding meet at |v| = mu N: AD takes the side that ran, to 1e-6; no NaN."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    edge = 0.5
    speeds = [
        edge,
        -edge,
        edge - 1e-9,
        edge + 1e-9,
        -edge - 1e-9,
        -edge + 1e-9,
        0.0,
        -0.0,
        0.2,
        2.0,
    ]
    points = np.array([[s, 1.0] for s in speeds])
    values, gradients = Points(friction, 2, len(points), "f64", mode)(points)
    assert np.isfinite(gradients).all()
    worst, h = 0.0, 1e-7
    for (speed, normal), value, gradient in zip(points, values, gradients, strict=True):
        assert value == pytest.approx(friction_in_numpy(speed, normal), rel=1e-15)
        # The edge itself sticks. By the speed: to the side where the same happens.
        sticks = abs(speed) <= edge * normal
        side = -np.sign(speed) if sticks else np.sign(speed)
        side = side or 1.0
        one = friction_in_numpy(speed + side * h, normal)
        two = friction_in_numpy(speed + 2 * side * h, normal)
        slope = (4 * one - two - 3 * value) / (2 * side * h)
        worst = max(worst, abs(gradient[0] - slope))
    measure("one-sided difference", worst, 1e-6)
    # The slopes of the two sides differ.
    assert abs(gradients[2][0] - gradients[3][0]) > 0.1


LOW, HIGH = 1 - 2.5e-2, 1 + 7.5e-3  # theta_c and theta_s of snow


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
def test_s36_plastic_clamp(dtype, mode):
    """1 inside of the yield surface and on its edge, 0 outside."""
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    real = number(dtype)
    low, high = real(LOW), real(HIGH)
    at = [1, low, high, np.nextafter(low, real(0)), np.nextafter(high, real(2)),
          np.nextafter(low, real(2)), np.nextafter(high, real(0)), 0.5, 2]  # fmt: skip
    slopes = [1, 1, 1, 0, 0, 1, 1, 0, 0]
    clamp = Points(lambda x: ti.math.clamp(x[0], LOW, HIGH), 1, len(at), dtype, mode)
    values, gradients = clamp(np.array(at, real)[:, None])
    np.testing.assert_array_equal(values, np.clip(np.array(at, real), low, high))
    np.testing.assert_array_equal(gradients[:, 0], slopes)


def clamped(dim, rows):
    """The weighted sum of F with singular values within the yield surface."""

    @ti.func
    def elastic(x):
        f = ti.Matrix([[x[dim * i + j] for j in range(dim)] for i in range(dim)])
        u, s, v = ti.svd(f)
        for k in ti.static(range(dim)):
            s[k, k] = ti.math.clamp(s[k, k], LOW, HIGH)
        return (u @ s @ v.transpose() * ti.Matrix(rows)).sum()

    return elastic


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("dtype", "bound"), [("f64", 1e-13), ("f32", 3e-5)])
@pytest.mark.parametrize("dim", [2, 3])
def test_s36_clamped_deformation(dim, dtype, bound, mode, measure):
    """U clamp(S) V' of F: dF inside; outside, the clamped directions do not move.

    U and V lose accuracy by the reciprocal of the gaps: 50 for gaps of 0.02.
    """
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    w = np.random.default_rng(3).standard_normal((dim, dim)).astype(number(dtype)).astype(float)
    rows = w.tolist()

    inside = np.diag([1.004, 1.002, 0.98][:dim])
    apart = np.diag([2.02, 2.0, 1.98][:dim])
    points = np.stack([np.eye(dim), inside, apart, np.diag([1.5, 1.0, 0.5][:dim])])
    _, gradients = Points(clamped(dim, rows), dim * dim, 4, dtype, mode)(points.reshape(4, -1))
    gradients = gradients.reshape(-1, dim, dim).astype(float)
    assert np.isfinite(gradients).all()
    measure("inside", np.abs(gradients[:2] - w).max(), 10 * bound)
    # All are clamped: only the rotation is left, U V' with the factor theta_s.
    sums = np.add.outer(np.diag(apart), np.diag(apart))
    measure("outside", np.abs(gradients[2] - HIGH * (w - w.T) / sums).max(), 1e3 * bound)
    # Apart: the diagonal moves where it is inside alone.
    measure("diagonal", np.abs(np.diag(gradients[3]) - [0, w[1, 1], 0][:dim]).max(), 10 * bound)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dim", [2, 3])
def test_s36_clamped_at_equal_values(dim, mode, measure):
    """F = 2 I, clamped: theta_s times the derivative of the rotation, as beside it."""
    ti.init(offline_cache=False, default_fp=ti.f64)
    w = np.random.default_rng(3).standard_normal((dim, dim))
    points = 2 * np.eye(dim).reshape(1, -1)
    _, gradients = Points(clamped(dim, w.tolist()), dim * dim, 1, "f64", mode)(points)
    error = np.abs(gradients.reshape(dim, dim) - HIGH * (w - w.T) / 4).max()
    measure("gradient", error, 1e-12)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("dtype", ["f64", "f32"])
@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
def test_s37_springs(scale, dtype, mode):
    """At rest length the force is 0, exactly; at length zero and near it, finite."""
    ti.init(offline_cache=False, default_fp=TYPES[dtype])
    rest = float(number(dtype)(5 * scale))

    def strain(x):
        return 0.5 * ((x.norm() - rest) / rest) ** 2

    tiny = float(np.finfo(number(dtype)).smallest_subnormal)
    points = np.array([[3 * scale, 4 * scale], [0, 0], [tiny, 0], [1e-6 * scale, 0]])
    values, gradients = Points(strain, 2, 4, dtype, mode)(points)
    assert np.isfinite(values).all() and np.isfinite(gradients).all()
    np.testing.assert_allclose(values, [0, 0.5, 0.5, 0.5], rtol=1e-5, atol=1e-13)
    np.testing.assert_array_equal(gradients[1], [0, 0])
    if scale == 1.0:
        np.testing.assert_array_equal(gradients[0], [0, 0])
        np.testing.assert_allclose(gradients[2:], [[-0.2, 0], [-0.2, 0]], rtol=1e-5)
