"""Mass-spring scenes in f64: the triangle of three springs, and the walking robots.

Each has a forward function that keeps every time slot and a hand-written adjoint of it.
Units are those of the scenes: unit masses, positions in a unit box, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .scenes import Robot

TRIANGLE = np.array([[0.3, 0.5], [0.3, 0.4], [0.4, 0.4]])
TRIANGLE_SPRINGS = np.array([[0, 1], [1, 2], [2, 0]])
TRIANGLE_REST = np.array([0.1, 0.1, 0.1 * np.sqrt(2.0)])


@dataclass(frozen=True)
class Triangle:
    """Settings of the triangle; `wall` adds the contact of the published program."""

    target: float = 0.1
    stiffness: float = 10.0
    damping: float = 20.0
    dt: float = 1e-3
    slots: int = 1024
    wall: bool = False


def _spring_forces(x: np.ndarray, springs: np.ndarray, rest: np.ndarray, k: float) -> np.ndarray:
    d = x[springs[:, 0]] - x[springs[:, 1]]
    length = np.linalg.norm(d, axis=1) + 1e-4
    force = (k * (length - rest) / length)[:, None] * d
    total = np.zeros_like(x)
    np.add.at(total, springs[:, 0], -force)
    np.add.at(total, springs[:, 1], force)
    return total


def _wall_velocity(v: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Stored velocity of points beyond the wall at x = 0.4 (friction 0.01)."""
    v = v.copy()
    for p in np.nonzero((x[:, 0] > 0.4) & (v[:, 0] > 0))[0]:
        if v[p, 1] > 0:
            v[p, 1] -= min(v[p, 1], 0.01 * v[p, 0])
        elif v[p, 1] < 0:
            v[p, 1] += min(-v[p, 1], 0.01 * v[p, 0])
        v[p, 0] = 0.0
    return v


def _wall_adjoint(v: np.ndarray, x: np.ndarray, gv: np.ndarray) -> np.ndarray:
    """Adjoint of `_wall_velocity` with respect to the velocity before the wall."""
    gv = gv.copy()
    for p in np.nonzero((x[:, 0] > 0.4) & (v[:, 0] > 0))[0]:
        vx, vy = v[p]
        gx, gy = 0.0, gv[p, 1]
        if vy > 0:
            gx, gy = (-0.01 * gy, gy) if 0.01 * vx < vy else (0.0, 0.0)
        elif vy < 0:
            gx, gy = (0.01 * gy, gy) if 0.01 * vx < -vy else (0.0, 0.0)
        gv[p] = gx, gy
    return gv


def triangle_forward(
    rest: np.ndarray, setup: Triangle = Triangle()
) -> tuple[float, np.ndarray, np.ndarray]:
    """Loss, positions and unclamped velocities of all slots, each (slots, 3, 2)."""
    damp = np.exp(-setup.dt * setup.damping)
    x = np.zeros((setup.slots, 3, 2))
    free = np.zeros_like(x)
    x[0] = TRIANGLE
    v = np.zeros((3, 2))
    for t in range(1, setup.slots):
        force = _spring_forces(x[t - 1], TRIANGLE_SPRINGS, rest, setup.stiffness)
        free[t] = damp * v + setup.dt * force
        x[t] = x[t - 1] + setup.dt * free[t]
        v = _wall_velocity(free[t], x[t]) if setup.wall else free[t]
    return (_area(x[-1]) - setup.target) ** 2, x, free


def _area(x: np.ndarray) -> float:
    a, b = x[0] - x[1], x[0] - x[2]
    return 0.5 * abs(a[0] * b[1] - a[1] * b[0])


def triangle_gradient(rest: np.ndarray, setup: Triangle = Triangle()) -> tuple[float, np.ndarray]:
    """Loss and its gradient with respect to the three rest lengths."""
    loss, x, free = triangle_forward(rest, setup)
    damp = np.exp(-setup.dt * setup.damping)
    last = x[-1]
    a, b = last[0] - last[1], last[0] - last[2]
    cross = a[0] * b[1] - a[1] * b[0]
    g_cross = 2.0 * (0.5 * abs(cross) - setup.target) * 0.5 * np.sign(cross)
    ga = g_cross * np.array([b[1], -b[0]])
    gb = g_cross * np.array([-a[1], a[0]])
    gx = np.stack([ga + gb, -ga, -gb])
    gv = np.zeros((3, 2))
    g_rest = np.zeros(3)
    first, second = TRIANGLE_SPRINGS.T
    for t in range(setup.slots - 1, 0, -1):
        if setup.wall:
            gv = _wall_adjoint(free[t], x[t], gv)
        gv = gv + setup.dt * gx
        g_force = setup.dt * gv
        gv = damp * gv
        d = x[t - 1][first] - x[t - 1][second]
        norm = np.linalg.norm(d, axis=1)
        length = norm + 1e-4
        gf = g_force[second] - g_force[first]
        along = np.sum(gf * d, axis=1)
        g_rest -= setup.stiffness / length * along
        g_length = setup.stiffness * rest / length**2 * along
        gd = (setup.stiffness * (length - rest) / length)[:, None] * gf
        gd += (g_length / norm)[:, None] * d
        gx = gx.copy()
        np.add.at(gx, first, gd)
        np.add.at(gx, second, -gd)
    return loss, g_rest


def triangle_descent(iterations: int, rate: float = 5.0, setup: Triangle = Triangle()):
    """Losses of gradient descent on the rest lengths, and the rest lengths after it."""
    rest = TRIANGLE_REST.copy()
    losses = []
    for _ in range(iterations):
        loss, gradient = triangle_gradient(rest, setup)
        losses.append(loss)
        rest -= rate * gradient
    return losses, rest


@dataclass(frozen=True)
class Walk:
    """Settings of a robot's walk; `toi` uses the time of impact with the ground."""

    slots: int = 682
    dt: float = 0.004
    gravity: float = -4.8
    ground: float = 0.1
    damping: float = 15.0
    goal: tuple[float, float] = (0.9, 0.2)
    toi: bool = True
    real: type = float


def _controller_input(t: int, x: np.ndarray, v: np.ndarray, walk: Walk) -> np.ndarray:
    phases = 2.0 * np.pi / 10.0 * np.arange(10)
    waves = np.sin(walk.real(10.0) * t * walk.dt + phases)
    centre = x.mean(axis=0)
    body = np.concatenate([0.05 * (x - centre), 0.05 * v], axis=1).ravel()
    return np.concatenate([waves, body, np.array(walk.goal) - centre])


def _impulse(body: Robot, x: np.ndarray, a: np.ndarray, dt: float):
    """Spring impulses (m, 2), and what their adjoint needs."""
    d = x[body.springs[:, 0]] - x[body.springs[:, 1]]
    norm = np.linalg.norm(d, axis=1)
    length = norm + 1e-4
    target = body.rest * (1.0 + body.actuation * a)
    factor = dt * body.stiffness * (length - target) / length
    return factor[:, None] * d, d, norm, length, target, factor


def robot_forward(body: Robot, weights: dict[str, np.ndarray], walk: Walk = Walk()):
    """Loss and the stored slots: a dict of x, v, free velocity, hidden, output."""
    points = len(body.points)
    x = np.zeros((walk.slots, points, 2), walk.real)
    v = np.zeros_like(x)
    free = np.zeros_like(x)
    hidden = np.zeros((walk.slots, len(weights["b1"])), walk.real)
    output = np.zeros((walk.slots, len(weights["b2"])), walk.real)
    x[0] = body.points
    damp = np.exp(-walk.damping * walk.dt)
    for t in range(1, walk.slots):
        inputs = _controller_input(t - 1, x[t - 1], v[t - 1], walk)
        hidden[t - 1] = np.tanh(weights["w1"] @ inputs + weights["b1"])
        output[t - 1] = np.tanh(weights["w2"] @ hidden[t - 1] + weights["b2"])
        impulse = _impulse(body, x[t - 1], output[t - 1], walk.dt)[0]
        new = damp * v[t - 1]
        new[:, 1] += walk.real(walk.dt) * walk.gravity
        np.add.at(new, body.springs[:, 0], -impulse)
        np.add.at(new, body.springs[:, 1], impulse)
        free[t] = new
        hit = _hits(x[t - 1], new, walk)
        v[t] = np.where(hit[:, None], 0.0, new)
        if walk.toi:
            vy = np.where(hit, new[:, 1], 1.0)
            toi = np.where(hit, -(x[t - 1][:, 1] - walk.ground) / vy, 0.0)[:, None]
            x[t] = x[t - 1] + toi * new + (walk.dt - toi) * v[t]
        else:
            x[t] = x[t - 1] + walk.dt * v[t]
    stored = {"x": x, "v": v, "free": free, "hidden": hidden, "output": output}
    return -x[-1, 0, 0], stored


def _hits(x: np.ndarray, v: np.ndarray, walk: Walk) -> np.ndarray:
    if walk.toi:
        return (x[:, 1] + walk.dt * v[:, 1] < walk.ground) & (v[:, 1] < -1e-4)
    return (x[:, 1] < walk.ground) & (v[:, 1] < 0.0)


def robot_gradient(body: Robot, weights: dict[str, np.ndarray], walk: Walk = Walk()):
    """Loss and its gradient with respect to w1, b1, w2, b2 (a dict of the same shapes)."""
    loss, stored = robot_forward(body, weights, walk)
    grads = {name: np.zeros_like(value) for name, value in weights.items()}
    points = len(body.points)
    damp = np.exp(-walk.damping * walk.dt)
    first, second = body.springs.T
    gx = np.zeros((points, 2), walk.real)
    gx[0, 0] = -1.0
    gv = np.zeros((points, 2), walk.real)
    for t in range(walk.slots - 1, 0, -1):
        x, v, free = stored["x"][t - 1], stored["v"][t - 1], stored["free"][t]
        hit = _hits(x, free, walk)
        g_free = np.where(hit[:, None], 0.0, gv + walk.dt * gx)
        gx_before = gx.copy()
        if walk.toi:
            vy = np.where(hit, free[:, 1], 1.0)
            height = x[:, 1] - walk.ground
            toi = np.where(hit, -height / vy, 0.0)
            g_toi = np.where(hit, np.sum(gx * free, axis=1), 0.0)
            g_free += toi[:, None] * gx
            g_free[:, 1] += g_toi * height / vy**2
            gx_before[:, 1] -= g_toi / vy
        gv = damp * g_free

        a = stored["output"][t - 1]
        _, d, norm, length, target, factor = _impulse(body, x, a, walk.dt)
        gi = g_free[second] - g_free[first]
        along = np.sum(gi * d, axis=1)
        scale = walk.dt * body.stiffness
        g_target = -scale / length * along
        gd = factor[:, None] * gi + (scale * target / length**2 * along / norm)[:, None] * d
        np.add.at(gx_before, first, gd)
        np.add.at(gx_before, second, -gd)

        hidden = stored["hidden"][t - 1]
        g_out = g_target * body.rest * body.actuation * (1.0 - a * a)
        grads["w2"] += np.outer(g_out, hidden)
        grads["b2"] += g_out
        g_hid = (weights["w2"].T @ g_out) * (1.0 - hidden * hidden)
        grads["w1"] += np.outer(g_hid, _controller_input(t - 1, x, v, walk))
        grads["b1"] += g_hid
        g_in = weights["w1"].T @ g_hid
        per_point = g_in[10:-2].reshape(points, 4)
        g_centre = -0.05 * per_point[:, :2].sum(axis=0) - g_in[-2:]
        gx = gx_before + 0.05 * per_point[:, :2] + g_centre / points
        gv = gv + 0.05 * per_point[:, 2:]
    return loss, grads


def robot_update(weights: dict[str, np.ndarray], grads: dict[str, np.ndarray]):
    """The published update: a step of fixed length 0.2 over all four arrays together."""
    norm = np.sqrt(sum(float(np.sum(g * g)) for g in grads.values()))
    return {name: w - 0.2 / (norm + 1e-6) * grads[name] for name, w in weights.items()}
