"""Differentiable MLS-MPM in 2-D: one step and its adjoint, the block, the crawler.

All in f64, or in the type of the arrays, of which `Material.real` makes a number.

State of a step: positions x (p, 2), velocities v (p, 2), affine velocities c (p, 2, 2)
and deformation gradients f (p, 2, 2). The grid lives inside one step; the reverse sweep
recomputes it from the particles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .smoke import add_at

State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

# The nine nodes of a particle's support, (9, 2).
OFFSETS = np.stack(np.meshgrid(np.arange(3), np.arange(3), indexing="ij"), -1).reshape(9, 2)


@dataclass(frozen=True)
class Material:
    """Grid, time step and material of a scene; `sticky` walls stop both components."""

    n: int = 120
    dt: float = 3e-4
    mu: float = 100.0
    lam: float = 100.0
    gravity: float = 9.8
    mass: float = 1.0
    volume: float = 1.0
    sticky: bool = False
    real: type = float

    @property
    def dx(self) -> float:
        return self.real(1.0 / self.n)


CRAWLER = Material(n=128, dt=1e-3, mu=10.0, lam=10.0, gravity=3.8, sticky=True)


def rest_state(x: np.ndarray, v: np.ndarray) -> State:
    """Undeformed particles at x (p, 2) with velocities v (p, 2)."""
    count = len(x)
    return x, v, np.zeros((count, 2, 2), x.dtype), np.tile(np.eye(2, dtype=x.dtype), (count, 1, 1))


def _mul(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product of 2 x 2 matrices along the first axis, faster than matmul on such."""
    out = np.empty_like(a)
    for i in range(2):
        for j in range(2):
            out[:, i, j] = a[:, i, 0] * b[:, 0, j] + a[:, i, 1] * b[:, 1, j]
    return out


def _t(a: np.ndarray) -> np.ndarray:
    return a.transpose(0, 2, 1)


def _apply(a: np.ndarray, d: np.ndarray) -> np.ndarray:
    """a (p, 2, 2) times d (k, p, 2)."""
    return np.stack(
        [
            a[:, 0, 0] * d[..., 0] + a[:, 0, 1] * d[..., 1],
            a[:, 1, 0] * d[..., 0] + a[:, 1, 1] * d[..., 1],
        ],
        axis=-1,
    )


def _weights(x: np.ndarray, material: Material):
    """Flat node numbers (9, p), per-axis weights (3, p, 2), products (9, p), fx (p, 2)."""
    scaled = x / material.dx
    base = np.trunc(scaled - 0.5).astype(int)
    fx = scaled - base
    w = np.stack([0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2])
    product = w[OFFSETS[:, 0], :, 0] * w[OFFSETS[:, 1], :, 1]
    node = (base[None, :, 0] + OFFSETS[:, 0, None]) * material.n
    node = node + base[None, :, 1] + OFFSETS[:, 1, None]
    return node, w, product, fx


def _polar(f: np.ndarray):
    """Rotation (p, 2, 2) of the polar decomposition, with its cosine, sine and scale."""
    p, q = f[:, 0, 0] + f[:, 1, 1], f[:, 1, 0] - f[:, 0, 1]
    scale = np.sqrt(p * p + q * q)
    c, s = p / scale, q / scale
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], axis=1), c, s, scale


def _scatter(node: np.ndarray, value: np.ndarray, n: int) -> np.ndarray:
    """Sum of value (9, p) at node (9, p) into a flat grid."""
    return add_at(node.ravel(), value.ravel(), n * n)


def _stress(f: np.ndarray, active: np.ndarray | None, material: Material):
    rotation, *_ = _polar(f)
    jacobian = f[:, 0, 0] * f[:, 1, 1] - f[:, 0, 1] * f[:, 1, 0]
    sigma = 2.0 * material.mu * _mul(f - rotation, _t(f))
    pressure = material.lam * (jacobian - 1.0) * jacobian
    sigma[:, 0, 0] += pressure
    sigma[:, 1, 1] += pressure
    if active is not None:
        second = f[:, :, 1]
        sigma += (4.0 * active)[:, None, None] * second[:, :, None] * second[:, None, :]
    return sigma


def _walls(velocity: np.ndarray, material: Material) -> np.ndarray:
    """1 where a component of the velocity (n * n, 2) survives the walls, else 0."""
    n = material.n
    index = np.arange(n)
    ij = np.stack(np.meshgrid(index, index, indexing="ij"), -1).reshape(-1, 2)
    keep = np.ones_like(velocity)
    for axis in range(2):
        for outward in (
            (ij[:, axis] < 3) & (velocity[:, axis] * keep[:, axis] < 0),
            (ij[:, axis] > n - 3) & (velocity[:, axis] * keep[:, axis] > 0),
        ):
            if material.sticky:
                keep[outward] = 0.0
            else:
                keep[outward, axis] = 0.0
    return keep


def _to_grid(state: State, active: np.ndarray | None, material: Material):
    """Everything of a step up to the grid velocity."""
    x, v, c, f = state
    dt, dx, mass = material.dt, material.dx, material.mass
    stretch = np.eye(2) + dt * c
    f_new = _mul(stretch, f)
    sigma = _stress(f_new, active, material)
    affine = -dt * material.volume * 4.0 / dx**2 * sigma + mass * c
    node, w, product, fx = _weights(x, material)
    offset = OFFSETS[:, None, :] - fx
    carried = mass * v + _apply(affine, offset * dx)
    momentum = np.stack(
        [_scatter(node, product * carried[..., a], material.n) for a in range(2)], -1
    )
    grid_mass = _scatter(node, product * mass, material.n)[:, None] + 1e-10
    velocity = momentum / grid_mass
    velocity[:, 1] -= dt * material.gravity
    keep = _walls(velocity, material)
    return (
        f_new,
        affine,
        node,
        w,
        product,
        offset,
        carried,
        momentum,
        grid_mass,
        keep,
        (velocity * keep),
    )


def step(state: State, material: Material, active: np.ndarray | None = None) -> State:
    """One step; `active` (p,) is the actuation of every particle, none if absent."""
    x = state[0]
    f_new, _, node, _, product, offset, *_, velocity = _to_grid(state, active, material)
    picked = product[..., None] * velocity[node]
    v_new = picked.sum(axis=0)
    c_new = np.stack([(picked[..., a, None] * offset).sum(axis=0) for a in range(2)], axis=1) * (
        4.0 / material.dx
    )
    return x + material.dt * v_new, v_new, c_new, f_new


def step_adjoint(
    state: State, g: State, material: Material, active: np.ndarray | None = None
) -> tuple[State, np.ndarray | None]:
    """Adjoint of `step`: that of the state before it, and of `active`."""
    _, _, c, f = state
    gx, gv_new, gc_new, gf_new = g
    dt, dx, mass = material.dt, material.dx, material.mass
    f_new, affine, node, w, product, offset, carried, momentum, grid_mass, keep, velocity = (
        _to_grid(state, active, material)
    )
    # Gather.
    gv_new = gv_new + dt * gx
    picked = velocity[node]
    through = gv_new + 4.0 / dx * _apply(gc_new, offset)
    g_velocity = np.stack(
        [_scatter(node, product * through[..., a], material.n) for a in range(2)], -1
    )
    g_product = np.sum(picked * through, axis=-1)
    g_offset = 4.0 / dx * product[..., None] * _apply(_t(gc_new), picked)
    # Grid.
    g_velocity *= keep
    g_momentum = g_velocity / grid_mass
    g_mass = -np.sum(g_momentum * momentum, axis=1) / grid_mass[:, 0]
    # Scatter.
    back = g_momentum[node]
    weighted = product[..., None] * back
    gv = mass * weighted.sum(axis=0)
    g_affine = dx * np.stack(
        [(weighted[..., a, None] * offset).sum(axis=0) for a in range(2)], axis=1
    )
    g_product = g_product + np.sum(back * carried, axis=-1) + mass * g_mass[node]
    g_offset = g_offset + dx * _apply(_t(affine), weighted)
    # Weights.
    g_fx = -g_offset.sum(axis=0)
    fx = -offset[0]
    slope = np.stack([fx - 1.5, -2.0 * (fx - 1.0), fx - 0.5])
    for axis in range(2):
        other = w[OFFSETS[:, 1 - axis], :, 1 - axis]
        g_fx[:, axis] += np.sum(g_product * other * slope[OFFSETS[:, axis], :, axis], axis=0)
    gx = gx + g_fx / dx
    # Stress.
    g_sigma = -dt * material.volume * 4.0 / dx**2 * g_affine
    gf_new, g_active = _stress_adjoint(f_new, g_sigma, gf_new, active, material)
    stretch = np.eye(2) + dt * c
    gc = mass * g_affine + dt * _mul(gf_new, _t(f))
    return (gx, gv, gc, _mul(_t(stretch), gf_new)), g_active


def _stress_adjoint(f, g_sigma, gf, active, material):
    rotation, cosine, sine, scale = _polar(f)
    mu, lam = material.mu, material.lam
    gm = 2.0 * mu * _mul(g_sigma, f)
    gf = gf + gm + 2.0 * mu * _mul(_t(g_sigma), f - rotation)
    gc = -(gm[:, 0, 0] + gm[:, 1, 1])
    gs = -(gm[:, 1, 0] - gm[:, 0, 1])
    radial = gc * cosine + gs * sine
    gp, gq = (gc - cosine * radial) / scale, (gs - sine * radial) / scale
    jacobian = f[:, 0, 0] * f[:, 1, 1] - f[:, 0, 1] * f[:, 1, 0]
    gj = lam * (2.0 * jacobian - 1.0) * (g_sigma[:, 0, 0] + g_sigma[:, 1, 1])
    gf[:, 0, 0] += gp + gj * f[:, 1, 1]
    gf[:, 1, 1] += gp + gj * f[:, 0, 0]
    gf[:, 1, 0] += gq - gj * f[:, 0, 1]
    gf[:, 0, 1] += -gq - gj * f[:, 1, 0]
    if active is None:
        return gf, None
    second = f[:, :, 1]
    both = g_sigma + _t(g_sigma)
    turned = np.stack([np.sum(both[:, a] * second, axis=1) for a in range(2)], axis=-1)
    gf[:, :, 1] += (4.0 * active)[:, None] * turned
    return gf, 2.0 * np.sum(turned * second, axis=1)


def _block_loss(x: np.ndarray, target: np.ndarray, each: bool) -> tuple[float, np.ndarray]:
    """Loss of the last positions, and its gradient with respect to them (p, 2)."""
    distance = (x if each else x.mean(axis=0, keepdims=True)) - target
    loss = 0.5 * np.mean(np.sum(distance**2, axis=1))
    return loss, np.broadcast_to(distance / len(x), x.shape).copy()


def block_forward(
    x: np.ndarray,
    v: np.ndarray,
    target: np.ndarray,
    material: Material,
    slots: int,
    each: bool = False,
) -> tuple[float, State]:
    """Loss and last state of a block that is driven to target (2,).

    The loss is half the squared distance of the mean position, or with `each` the mean
    over the particles of half their squared distances.
    """
    state = rest_state(x, v)
    for _ in range(1, slots):
        state = step(state, material)
    return _block_loss(state[0], target, each)[0], state


def block_gradient(
    x: np.ndarray,
    v: np.ndarray,
    target: np.ndarray,
    material: Material,
    slots: int,
    segment: int = 32,
    each: bool = False,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Loss of `block_forward` and its gradient with respect to x and v (p, 2) of slot 0.

    Only every `segment`-th state is kept, the others are recomputed when needed.
    """
    kept = [rest_state(x, v)]
    state = kept[0]
    for t in range(1, slots):
        state = step(state, material)
        if t % segment == 0:
            kept.append(state)
    loss, gx = _block_loss(state[0], target, each)
    zero = np.zeros((len(x), 2, 2), x.dtype)
    g: State = (gx, np.zeros_like(gx), zero, zero)
    last = slots - 1
    while kept:
        first = (len(kept) - 1) * segment
        states = [kept.pop()]
        for _ in range(first + 1, last):
            states.append(step(states[-1], material))
        for before in reversed(states[: last - first]):
            g, _ = step_adjoint(before, g, material)
        last = first
    return loss, g[0], g[1]


def muscle_actuation(weights: dict[str, np.ndarray], t: int, dt: float) -> np.ndarray:
    """Actuation of the four muscles at step t, (4,)."""
    waves = np.sin(20.0 * t * dt + 2.0 * np.pi / 4.0 * np.arange(4))
    return np.tanh(weights["bias"] + weights["weights"] @ waves)


def _spread(values: np.ndarray, muscles: np.ndarray) -> np.ndarray:
    return np.where(muscles >= 0, values[np.maximum(muscles, 0)], 0.0)


def crawler_forward(
    x: np.ndarray,
    muscles: np.ndarray,
    weights: dict[str, np.ndarray],
    slots: int = 1024,
    material: Material = CRAWLER,
) -> tuple[float, list[State]]:
    """Loss (minus the mean x position at the end) and the states of all slots."""
    states = [rest_state(x, np.zeros_like(x))]
    for t in range(slots - 1):
        active = _spread(muscle_actuation(weights, t, material.dt), muscles)
        states.append(step(states[-1], material, active))
    return -float(states[-1][0][:, 0].mean()), states


def crawler_gradient(
    x: np.ndarray,
    muscles: np.ndarray,
    weights: dict[str, np.ndarray],
    slots: int = 1024,
    material: Material = CRAWLER,
) -> tuple[float, dict[str, np.ndarray]]:
    """Loss and its gradient with respect to weights (4, 4) and bias (4,)."""
    loss, states = crawler_forward(x, muscles, weights, slots, material)
    count = len(x)
    gx = np.zeros((count, 2))
    gx[:, 0] = -1.0 / count
    zero = np.zeros((count, 2, 2))
    g: State = (gx, np.zeros((count, 2)), zero, zero)
    grads = {name: np.zeros_like(value) for name, value in weights.items()}
    for t in range(slots - 2, -1, -1):
        output = muscle_actuation(weights, t, material.dt)
        g, g_active = step_adjoint(states[t], g, material, _spread(output, muscles))
        g_muscle = np.array([g_active[muscles == m].sum() for m in range(4)])
        g_muscle *= 1.0 - output * output
        waves = np.sin(20.0 * t * material.dt + 2.0 * np.pi / 4.0 * np.arange(4))
        grads["weights"] += np.outer(g_muscle, waves)
        grads["bias"] += g_muscle
    return loss, grads
