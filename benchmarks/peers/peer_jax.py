"""The peer jax: each scene one jitted function whose time loop is a compiled scan.

The time of the backward pass is that of value_and_grad minus that of the forward pass;
*replay* is value_and_grad alone.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import harness

# The type of all floats; with "float64" jax wants jax_enable_x64.
REAL = "float32"


class JaxProgram(harness.Program):
    """Loss of one argument (an array or a tuple of arrays), jitted with its gradient."""

    def __init__(self, loss, argument):
        import jax

        self.argument = jax.tree.map(jax.device_put, argument)
        self.value = jax.jit(loss)
        self.both = jax.jit(jax.value_and_grad(loss))
        self.last = None

    def run(self) -> tuple[float, float]:
        def forward():
            self.value(self.argument).block_until_ready()

        def both():
            value, gradient = self.both(self.argument)
            value.block_until_ready()
            for part in gradient if isinstance(gradient, tuple) else (gradient,):
                part.block_until_ready()
            self.last = value, gradient

        return harness.combined_run(forward, both)

    def replay(self) -> float:
        start = harness.clock()
        self.queue()
        self.sync()
        return harness.clock() - start

    def queue(self) -> bool:
        self.last = self.both(self.argument)
        return True

    def sync(self) -> None:
        import jax

        jax.block_until_ready(self.last)

    def inputs(self) -> np.ndarray:
        import jax

        return np.concatenate([np.asarray(a).ravel() for a in jax.tree.leaves(self.argument)])

    def assign(self, flat: np.ndarray) -> None:
        import jax

        leaves, tree = jax.tree.flatten(self.argument)
        ends = np.cumsum([leaf.size for leaf in leaves])
        parts = np.split(flat, ends[:-1])
        new = [
            jax.device_put(part.reshape(leaf.shape).astype(leaf.dtype))
            for part, leaf in zip(parts, leaves, strict=True)
        ]
        self.argument = jax.tree.unflatten(tree, new)

    def loss(self) -> float:
        return float(self.last[0])

    def gradient(self) -> np.ndarray:
        gradient = self.last[1]
        parts = gradient if isinstance(gradient, tuple) else (gradient,)
        return np.concatenate([np.asarray(part).ravel() for part in parts])


def make_smoke(problem) -> harness.Program:
    import jax.numpy as jnp
    from jax import lax

    n, slots, sweeps = problem.n, problem.slots, problem.sweeps
    dx = 1.0 / n
    density0 = jnp.asarray(problem.density, dtype=REAL)
    target = jnp.asarray(problem.target, dtype=REAL)
    row, column = jnp.arange(n, dtype=REAL)[:, None], jnp.arange(n, dtype=REAL)

    def sampler(w):
        x, y = row - w[0], column - w[1]
        left, low = jnp.floor(x), jnp.floor(y)
        fx, fy = x - left, y - low
        ax, ay = left.astype(jnp.int32) % n, low.astype(jnp.int32) % n
        bx, by = (ax + 1) % n, (ay + 1) % n

        def sample(f):
            nearer = (1.0 - fy) * f[ax, ay] + fy * f[ax, by]
            farther = (1.0 - fy) * f[bx, ay] + fy * f[bx, by]
            return (1.0 - fx) * nearer + fx * farther

        return sample

    def difference(p, axis):
        return jnp.roll(p, -1, axis) - jnp.roll(p, 1, axis)

    def step(state, _):
        v, density, pressure, projected = state
        sample = sampler(v)
        star = sample(v[0]), sample(v[1])
        source = -0.5 * dx * (difference(star[0], 0) + difference(star[1], 1))
        new = (
            star[0] - 0.5 / dx * difference(projected, 0),
            star[1] - 0.5 / dx * difference(projected, 1),
        )
        for _ in range(sweeps):
            projected = pressure
            around = jnp.roll(pressure, 1, 0) + jnp.roll(pressure, -1, 0)
            around += jnp.roll(pressure, 1, 1) + jnp.roll(pressure, -1, 1)
            pressure = (source + around) * 0.25
        return (new, sampler(new)(density), pressure, projected), None

    def loss(v0):
        zero = jnp.zeros((n, n), REAL)
        start = ((v0[..., 0], v0[..., 1]), density0, zero, zero)
        (_, density, _, _), _ = lax.scan(step, start, None, length=slots - 1)
        return jnp.mean((target - density) ** 2)

    return JaxProgram(loss, problem.velocity.astype(REAL))


def make_wave(problem) -> harness.Program:
    import jax.numpy as jnp
    from jax import lax

    n, slots = problem.n, problem.slots
    dx = 1.0 / n
    target = jnp.asarray(problem.target, dtype=REAL)

    def step(state, _):
        before, now = state
        framed = jnp.pad(now, 1)
        around = framed[:-2, 1:-1] + framed[2:, 1:-1] + framed[1:-1, :-2] + framed[1:-1, 2:]
        after = 2.0 * now + (around - 4.0 * now) / 3.0 - before
        return (now, after), None

    def loss(u0):
        start = (u0, jnp.zeros_like(u0))
        (_, last), _ = lax.scan(step, start, None, length=slots - 2)
        return dx * dx * jnp.sum((target - last) ** 2)

    return JaxProgram(loss, problem.height.astype(REAL))


def make_mpm(problem) -> harness.Program:
    import jax.numpy as jnp
    from jax import lax

    material, slots = problem.material, problem.slots
    n, dt, dx = material.n, material.dt, material.dx
    x0 = jnp.asarray(problem.position, dtype=REAL)
    goal = jnp.asarray(problem.target, dtype=REAL)
    count = len(problem.position)
    identity = jnp.eye(2, dtype=REAL)
    offsets = jnp.asarray([(i, j) for i in range(3) for j in range(3)])
    index = jnp.arange(n)
    low, high = index < 3, index > n - 3

    def product(a, b):
        return jnp.einsum("pij,pjk->pik", a, b)

    def step(state, _):
        x, v, c, f = state
        base = (x / dx - 0.5).astype(jnp.int32)
        fx = x / dx - base
        w = jnp.stack([0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2])
        weight = w[offsets[:, 0], :, 0] * w[offsets[:, 1], :, 1]
        f = product(identity + dt * c, f)
        even, odd = f[:, 0, 0] + f[:, 1, 1], f[:, 1, 0] - f[:, 0, 1]
        scale = 1.0 / jnp.sqrt(even * even + odd * odd)
        cosine, sine = even * scale, odd * scale
        rotation = jnp.stack([jnp.stack([cosine, -sine], -1), jnp.stack([sine, cosine], -1)], 1)
        determinant = f[:, 0, 0] * f[:, 1, 1] - f[:, 0, 1] * f[:, 1, 0]
        cauchy = 2.0 * material.mu * product(f - rotation, f.transpose(0, 2, 1))
        pressure = material.lam * (determinant - 1.0) * determinant
        cauchy = cauchy + pressure[:, None, None] * identity
        affine = -dt * material.volume * 4.0 / dx**2 * cauchy + material.mass * c
        offset = offsets[:, None, :] - fx
        carried = material.mass * v + jnp.einsum("pij,kpj->kpi", affine, offset * dx)
        node = base + offsets[:, None, :]
        flat = node[..., 0] * n + node[..., 1]
        momentum = jnp.zeros((n * n, 2), REAL)
        momentum = momentum.at[flat].add(weight[..., None] * carried)
        mass = jnp.zeros((n * n,), REAL).at[flat].add(weight * material.mass)
        grid = momentum / (mass[:, None] + 1e-10)
        gx = grid[:, 0].reshape(n, n)
        gy = grid[:, 1].reshape(n, n) - dt * material.gravity
        gx = jnp.where((low[:, None] & (gx < 0)) | (high[:, None] & (gx > 0)), 0.0, gx)
        gy = jnp.where((low[None, :] & (gy < 0)) | (high[None, :] & (gy > 0)), 0.0, gy)
        grid = jnp.stack([gx.ravel(), gy.ravel()], -1)
        picked = weight[..., None] * grid[flat]
        v = picked.sum(axis=0)
        c = 4.0 / dx * jnp.einsum("kpi,kpj->pij", picked, offset)
        return (x + dt * v, v, c, f), None

    def loss(v0):
        c0 = jnp.zeros((count, 2, 2), REAL)
        f0 = jnp.broadcast_to(identity, (count, 2, 2))
        (x, _, _, _), _ = lax.scan(step, (x0, v0, c0, f0), None, length=slots - 1)
        return 0.5 * jnp.mean(jnp.sum((x - goal) ** 2, axis=1))

    return JaxProgram(loss, problem.velocity.astype(REAL))


def make_mass_spring(problem) -> harness.Program:
    import jax.numpy as jnp
    from jax import lax

    body, walk = problem.body, problem.walk
    dt, ground = walk.dt, walk.ground
    x0 = jnp.asarray(body.points, dtype=REAL)
    first, second = (jnp.asarray(body.springs[:, e]) for e in range(2))
    rest = jnp.asarray(body.rest, dtype=REAL)
    stiffness = jnp.asarray(body.stiffness, dtype=REAL)
    amount = jnp.asarray(body.actuation, dtype=REAL)
    goal = jnp.asarray(walk.goal, dtype=REAL)
    phases = jnp.asarray(2.0 * np.pi / 10.0 * np.arange(10), dtype=REAL)
    pull = jnp.asarray([0.0, dt * walk.gravity], dtype=REAL)
    damp = float(np.exp(-walk.damping * dt))

    def loss(weights):
        w1, b1, w2, b2 = weights

        def step(state, t):
            x, v = state
            centre = x.mean(axis=0)
            waves = jnp.sin(10.0 * t * dt + phases)
            seen = jnp.concatenate([0.05 * (x - centre), 0.05 * v], axis=1).ravel()
            inputs = jnp.concatenate([waves, seen, goal - centre])
            output = jnp.tanh(w2 @ jnp.tanh(w1 @ inputs + b1) + b2)
            d = x[first] - x[second]
            length = jnp.sqrt(jnp.sum(d * d, axis=1)) + 1e-4
            wanted = rest * (1.0 + amount * output)
            impulse = (dt * stiffness * (length - wanted) / length)[:, None] * d
            free = damp * v + pull
            free = free.at[first].add(-impulse).at[second].add(impulse)
            hit = (x[:, 1] + dt * free[:, 1] < ground) & (free[:, 1] < -1e-4)
            down = jnp.where(hit, free[:, 1], 1.0)
            toi = jnp.where(hit, -(x[:, 1] - ground) / down, 0.0)[:, None]
            v = jnp.where(hit[:, None], 0.0, free)
            return (x + toi * free + (dt - toi) * v, v), None

        times = jnp.arange(walk.slots - 1, dtype=REAL)
        (x, _), _ = lax.scan(step, (x0, jnp.zeros_like(x0)), times)
        return -x[0, 0]

    weights = tuple(problem.weights[k].astype(REAL) for k in ("w1", "b1", "w2", "b2"))
    return JaxProgram(loss, weights)


def make_first_kernel(problem) -> harness.Program:
    return JaxProgram(lambda x: (x * x).sum(), problem.x.astype(REAL))


def make_launch():
    import jax
    import jax.numpy as jnp

    bump = jax.jit(lambda value, t: value + t)
    value = jnp.zeros((), REAL)
    return lambda: bump(value, 1.0), lambda: bump(value, 1.0).block_until_ready()


def load(cache: Path, arch: str):
    import jax

    jax.config.update("jax_platforms", arch)
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    scenes = {
        "smoke": make_smoke,
        "wave": make_wave,
        "diffmpm": make_mpm,
        "mass_spring": make_mass_spring,
        "first_kernel": make_first_kernel,
    }
    return jax.__version__, scenes, make_launch


if __name__ == "__main__":
    sys.exit(harness.main("jax", load))
