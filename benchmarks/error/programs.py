"""Small programs with exact results, for `solve_to.py`: most have steps or a tolerance to choose.

Each function makes the program in the tai that has been started, and returns it with the exact
loss and gradient: closed forms, dense linear algebra, or arithmetic of 30 digits. A parameter
`steps` or `tol` of the program is one that `ti.solve_to` chooses.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import mpmath
import numpy as np
import tai as ti


class Case(NamedTuple):
    """A program, its loss and unknowns, and the exact loss and gradient."""

    run: Callable[..., Any]
    loss: Any
    wrt: list[Any]
    exact: tuple[float, np.ndarray]


def _field(*shape: int) -> Any:
    return ti.field(float, shape=shape, needs_grad=True)


def _by_differences(value: Callable[..., Any], at: list[float]) -> tuple[float, np.ndarray]:
    """A value and its gradient, by central differences in 60 digits."""
    with mpmath.workdps(60):
        h = mpmath.mpf(10) ** -20
        point = [mpmath.mpf(x) for x in at]
        slopes = []
        for k in range(len(point)):
            above, below = list(point), list(point)
            above[k] += h
            below[k] -= h
            slopes.append(float((value(*above) - value(*below)) / (2 * h)))
        return float(value(*point)), np.array(slopes)


def _ode(rates: Callable, at: list[float], order: int, time: float, value: Callable) -> Case:
    """x' = rates(x) from `at`, by a method of order 1, 2 or 4, and the square of x[0] at the end.

    Args:
        rates: makes the kernel function of the rates.
        value: the loss by the initial values, in mpmath.
    """
    n = len(at)
    x, loss = ti.Vector.field(n, float, shape=(), needs_grad=True), _field()
    start = ti.Vector.field(n, float, shape=(), needs_grad=True)
    f = ti.func(rates)

    @ti.kernel
    def begin():
        x[None] = start[None]

    @ti.kernel
    def step(dt: float):
        p = x[None]
        k1 = f(p)
        if ti.static(order == 1):
            x[None] = p + dt * k1
        elif ti.static(order == 2):
            x[None] = p + dt * f(p + 0.5 * dt * k1)
        else:
            k2 = f(p + 0.5 * dt * k1)
            k3 = f(p + 0.5 * dt * k2)
            k4 = f(p + dt * k3)
            x[None] = p + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    @ti.kernel
    def end():
        loss[None] += x[None][0] ** 2

    def run(steps: int = 8) -> None:
        begin()
        for _ in range(steps):
            step(time / steps)
        end()

    start[None] = at
    return Case(run, loss, [start], _by_differences(value, at))


def decay() -> Case:
    """Exponential decay, by the midpoint rule."""

    def rates(p):
        return ti.Vector([-1.5 * p[0]])

    return _ode(rates, [1.25], 2, 1.0, lambda x: (x * mpmath.exp(mpmath.mpf(-3) / 2)) ** 2)


def oscillator() -> Case:
    """A spring, by Runge's and Kutta's method."""

    def rates(p):
        return ti.Vector([p[1], -4.0 * p[0]])

    def value(x, v):
        return (x * mpmath.cos(4) + v / 2 * mpmath.sin(4)) ** 2

    return _ode(rates, [1.0, 0.5], 4, 2.0, value)


def logistic() -> Case:
    """Growth to a limit, by the midpoint rule."""

    def rates(p):
        return ti.Vector([2.0 * p[0] * (1.0 - p[0])])

    return _ode(rates, [0.125], 2, 1.5, lambda x: (1 / (1 + (1 / x - 1) * mpmath.exp(-3))) ** 2)


def drag() -> Case:
    """A body that is slowed by the square of its speed, by Euler's method."""

    def rates(p):
        return ti.Vector([p[1], -0.5 * p[1] * ti.abs(p[1])])

    return _ode(rates, [0.25, 2.0], 1, 1.0, lambda x, v: (x + 2 * mpmath.log(1 + v / 2)) ** 2)


def predators() -> Case:
    """Lotka's and Volterra's equations, against Taylor series in mpmath."""

    def rates(p):
        return ti.Vector([p[0] * (1.0 - p[1]), p[1] * (p[0] - 1.0)])

    def value(a, b):
        x, y, n = a, b, 64
        for _ in range(8):  # Taylor series over an eighth of the time each
            xs, ys = [x], [y]
            for k in range(n):
                both = mpmath.fsum(xs[j] * ys[k - j] for j in range(k + 1))
                xs.append((xs[k] - both) / (k + 1))
                ys.append((both - ys[k]) / (k + 1))
            h = mpmath.mpf(1) / 8
            x = mpmath.polyval(xs[::-1], h)
            y = mpmath.polyval(ys[::-1], h)
        return x**2

    return _ode(rates, [1.5, 0.75], 4, 1.0, value)


def quadrature() -> Case:
    """The integral of exp(-a x²) from 0 to 1, by the midpoint rule in one kernel."""
    a, loss = _field(), _field()

    @ti.kernel
    def integrate(n: int):
        for i in range(n):
            x = (i + 0.5) / n
            loss[None] += ti.exp(-a[None] * x * x) / n

    a[None] = 1.75

    def value(a):
        return mpmath.sqrt(mpmath.pi / a) / 2 * mpmath.erf(mpmath.sqrt(a))

    def run(steps: int = 16) -> None:
        integrate(steps)

    return Case(run, loss, [a], _by_differences(value, [1.75]))


def _linear(matrix: np.ndarray, solver: str) -> Case:
    """The square of a solution, by an iterative solver."""
    n = len(matrix)
    b, x, loss = _field(n), _field(n), _field()
    rows = ti.field(float, shape=(n, n))
    rows.from_numpy(matrix)

    @ti.kernel
    def product(p: ti.template(), q: ti.template()):
        for i in p:
            total = 0.0
            for j in range(n):
                total += rows[i, j] * p[j]
            q[i] = total

    @ti.kernel
    def measure():
        for i in x:
            loss[None] += x[i] ** 2

    method = getattr(ti.linalg, solver)

    def run(tol: float = 1e-6) -> None:
        method(product, b, x, tol=tol)
        measure()

    right = np.linspace(1, 2, n).astype(np.float32).astype(float)
    b.from_numpy(right)
    solution = np.linalg.solve(matrix, right)
    solution += np.linalg.solve(matrix, right - matrix @ solution)
    return Case(
        run, loss, [b], (float(solution @ solution), 2 * np.linalg.solve(matrix.T, solution))
    )


def _row(n: int, diagonal: float, wind: float = 0.0) -> np.ndarray:
    below, above = np.eye(n, k=-1), np.eye(n, k=1)
    return diagonal * np.eye(n) - (1 + wind) * below - (1 - wind) * above


def heat() -> Case:
    """A row of cells, by conjugate gradients."""
    return _linear(_row(48, 2.0625), "cg")


def membrane() -> Case:
    """Five points on a square, by MINRES."""
    one, row = np.eye(7), _row(7, 2.0)
    return _linear(np.kron(row, one) + np.kron(one, row), "minres")


def wind() -> Case:
    """A row of cells in wind, by GMRES."""
    return _linear(_row(40, 2.25, 0.5), "gmres")


def kepler() -> Case:
    """E = M + e sin E by iteration, for the sum of many anomalies E."""
    n = 16
    mean, anomaly, loss = _field(n), _field(n), _field()

    @ti.kernel
    def follow(p: ti.template(), q: ti.template()):
        for i in p:
            q[i] = mean[i] + 0.25 * ti.sin(p[i])

    @ti.kernel
    def measure():
        for i in anomaly:
            loss[None] += anomaly[i]

    def run(tol: float = 1e-6) -> None:
        ti.ad.implicit(follow, anomaly, tol=tol)
        measure()

    points = np.linspace(0.25, 3, n).astype(np.float32).astype(float)
    mean.from_numpy(points)
    found = points.copy()
    for _ in range(60):
        found = points + 0.25 * np.sin(found)
    return Case(run, loss, [mean], (math.fsum(found), 1 / (1 - 0.25 * np.cos(found))))


def regression() -> Case:
    """The likelihood of a logistic model; nothing but modes to choose from."""
    n, m = 2000, 4
    weights, loss = _field(m), _field()
    data, answer = ti.field(float, shape=(n, m)), ti.field(float, shape=n)

    @ti.kernel
    def run():
        for i in range(n):
            z = 0.0
            for j in range(m):
                z += weights[j] * data[i, j]
            loss[None] += ti.log(1.0 + ti.exp(-answer[i] * z)) / n

    generator = np.random.default_rng(3)
    rows = generator.standard_normal((n, m)).astype(np.float32).astype(float)
    signs = generator.choice([-1.0, 1.0], n)
    at = np.array([0.5, -0.25, 1.0, 0.125])
    weights.from_numpy(at)
    data.from_numpy(rows)
    answer.from_numpy(signs)
    z = (signs * (rows @ at)).astype(np.longdouble)
    loss_there = np.log1p(np.exp(-z)).sum() / n
    slope = -(signs / (1 + np.exp(z)))[:, None] * rows
    return Case(run, loss, [weights], (float(loss_there), slope.sum(0).astype(float) / n))


def small_angle() -> Case:
    """1 - cos x for small x, which loses most digits."""
    n = 256
    x, loss = _field(n), _field()

    @ti.kernel
    def run():
        for i in x:
            loss[None] += 1.0 - ti.cos(x[i])

    points = np.linspace(0.01, 0.05, n).astype(np.float32).astype(float)
    x.from_numpy(points)
    return Case(run, loss, [x], (2 * math.fsum(np.sin(points / 2) ** 2), np.sin(points)))


def rotations() -> Case:
    """A vector that is rotated many times, in place."""
    x, loss = ti.Vector.field(2, float, shape=(), needs_grad=True), _field()
    y = ti.Vector.field(2, float, shape=(), needs_grad=True)

    @ti.kernel
    def begin():
        y[None] = x[None]

    @ti.kernel
    def turn():
        p = y[None]
        y[None] = ti.Vector([0.75 * p[0] - 0.5 * p[1], 0.5 * p[0] + 0.75 * p[1]])

    @ti.kernel
    def end():
        loss[None] += y[None][0] ** 2 + 0.5 * y[None][1]

    def run() -> None:
        begin()
        for _ in range(10):
            turn()
        end()

    x[None] = [0.75, 1.25]

    def value(a, b):
        for _ in range(10):
            a, b = (3 * a - 2 * b) / 4, (2 * a + 3 * b) / 4
        return a**2 + b / 2

    return Case(run, loss, [x], _by_differences(value, [0.75, 1.25]))


PROGRAMS = {
    made.__name__: made
    for made in (decay, oscillator, logistic, drag, predators, quadrature, heat, membrane, wind,
                 kepler, regression, small_angle, rotations)
}  # fmt: skip
