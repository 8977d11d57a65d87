"""The wave and smoke of `mesh_gpus.py` in JAX, on one GPU and sharded over several.

    python benchmarks/gpu/mesh_jax.py --devices 2

Each device has a part of the rows, and fetches halos by `ppermute`; `jax.grad` differentiates
through them. The sizes, steps and rows of times are those of `mesh_gpus.py`.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--devices", type=int, default=2, help="GPUs to share the rows (2)")
parser.add_argument("--only", default="wave,smoke", help="the scenes to run")
parser.add_argument("--wave", type=int, default=16384, help="rows of the wave (16384)")
parser.add_argument("--smoke", type=int, default=8192, help="rows of the smoke (8192)")
parser.add_argument("--steps", type=int, default=8, help="time steps (8)")
parser.add_argument("--repeat", type=int, default=5, help="timed runs (5)")
parser.add_argument("--cpu", action="store_true", help="run on devices of the CPU")
args = parser.parse_args()
if args.cpu:
    os.environ["JAX_PLATFORMS"] = "cpu"
    os.environ["XLA_FLAGS"] = f"--xla_force_host_platform_device_count={args.devices}"
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax import lax  # noqa: E402
from jax.sharding import Mesh, NamedSharding, PartitionSpec  # noqa: E402

try:
    from jax import shard_map
except ImportError:
    from jax.experimental.shard_map import shard_map

AXIS = "x"


def with_halo(a: jax.Array, reach: int, devices: int) -> jax.Array:
    """The rows of a device between those of its neighbours; zeros at the borders."""
    if devices == 1:
        return jnp.pad(a, [(reach, reach)] + [(0, 0)] * (a.ndim - 1))
    up = [(d, d + 1) for d in range(devices - 1)]
    down = [(d + 1, d) for d in range(devices - 1)]
    before = lax.ppermute(a[-reach:], AXIS, up)
    after = lax.ppermute(a[:reach], AXIS, down)
    return jnp.concatenate([before, a, after])


def indices(a: jax.Array, devices: int) -> tuple[jax.Array, jax.Array]:
    """The indices in the whole field of the elements of a device."""
    first = lax.axis_index(AXIS) * a.shape[0] if devices > 1 else 0
    return first + jnp.arange(a.shape[0])[:, None], jnp.arange(a.shape[1])[None, :]


def interior(a: jax.Array, n: int, devices: int) -> jax.Array:
    i, j = indices(a, devices)
    return (i >= 1) & (i < n - 1) & (j >= 1) & (j < a.shape[1] - 1)


def beside(a: jax.Array, devices: int) -> tuple[jax.Array, ...]:
    """The neighbours of each element, below, above, left and right; zeros outside."""
    wide = jnp.pad(with_halo(a, 1, devices), ((0, 0), (1, 1)))
    return wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]


def wave(n: int, m: int, devices: int) -> tuple[Callable, tuple[np.ndarray, ...]]:
    """The loss of a wave as a function of its first state, of the rows of a device."""

    def loss(first: jax.Array) -> jax.Array:
        inside = interior(first, n, devices)

        def step(state: tuple, _: None) -> tuple:
            before, here = state
            around = sum(beside(here, devices))
            after = 2 * here - before + 0.2 * (around - 4 * here)
            return (here, jnp.where(inside, after, 0.0)), None

        (_, last), _ = lax.scan(step, (first, first), None, args.steps)
        return jnp.sum(last**2)

    i, j = np.ogrid[:n, :m]
    start = np.exp(-1e-4 * ((i - n / 2) ** 2 + (j - m / 2) ** 2), dtype=np.float32)
    return loss, (start,)


def smoke(n: int, m: int, devices: int) -> tuple[Callable, tuple[np.ndarray, ...]]:
    """The loss of smoke as a function of its first velocities and dye."""
    reach = 4

    def sample(wide: jax.Array, a: jax.Array, b: jax.Array, s: jax.Array, t: jax.Array) -> Any:
        low = wide[a, b] * (1 - t) + wide[a, b + 1] * t
        high = wide[a + 1, b] * (1 - t) + wide[a + 1, b + 1] * t
        return low * (1 - s) + high * s

    def loss(vx: jax.Array, vy: jax.Array, dye: jax.Array) -> jax.Array:
        inside = interior(dye, n, devices)
        i, j = indices(dye, devices)

        def step(state: tuple, _: None) -> tuple:
            vx, vy, p, dye = state
            x = jnp.clip(i - jnp.clip(vx, -3, 3), 0, n - 1.001)
            y = jnp.clip(j - jnp.clip(vy, -3, 3), 0, m - 1.001)
            a, b = jnp.floor(x).astype(jnp.int32), jnp.floor(y).astype(jnp.int32)
            s, t, row = x - a, y - b, a - i[0, 0] + reach
            wx, wy, ink = (sample(with_halo(f, reach, devices), row, b, s, t)
                           for f in (vx, vy, dye))  # fmt: skip
            low, high, _, _ = beside(wx, devices)
            _, _, left, right = beside(wy, devices)
            div = jnp.where(inside, 0.5 * (high - low + right - left), 0.0)
            p = jnp.where(inside, 0.0, p)

            def relax(p: jax.Array, _: None) -> tuple:
                return jnp.where(inside, 0.25 * (sum(beside(p, devices)) - div), 0.0), None

            p, _ = lax.scan(relax, p, None, 10)
            low, high, left, right = beside(p, devices)
            vx = jnp.where(inside, wx - 0.5 * (high - low), vx)
            vy = jnp.where(inside, wy - 0.5 * (right - left), vy)
            return (vx, vy, p, jnp.where(inside, ink, dye)), None

        state = (vx, vy, jnp.zeros_like(dye), dye)
        (_, _, _, last), _ = lax.scan(step, state, None, args.steps)
        return jnp.sum(last**2)

    i, j = np.ogrid[:n, :m]
    ones = np.ones((n, m), np.float32)
    start = (np.sin(j * 0.01) * ones, np.cos(i * 0.01) * ones, np.sin(i * 0.02) * np.cos(j * 0.02))
    return loss, tuple(each.astype(np.float32) for each in start)


def measure(make: Callable, n: int, m: int, devices: int) -> tuple[float, float, float]:
    """Seconds of the forward run and of the backward run, and the loss."""
    loss, start = make(n, m, devices)
    if devices > 1:
        mesh = Mesh(np.array(jax.devices()[:devices]), (AXIS,))
        rows = PartitionSpec(AXIS)
        each = loss

        def total(*given: jax.Array) -> jax.Array:
            return lax.psum(each(*given), AXIS)

        loss = shard_map(total, mesh=mesh, in_specs=(rows,) * len(start), out_specs=PartitionSpec())
        start = tuple(jax.device_put(a, NamedSharding(mesh, rows)) for a in start)
    else:
        start = tuple(jax.device_put(a, jax.devices()[0]) for a in start)
    forward = jax.jit(loss)
    both = jax.jit(jax.value_and_grad(loss, argnums=tuple(range(len(start)))))

    def seconds(run: Callable) -> float:
        jax.block_until_ready(run(*start))
        found = []
        for _ in range(args.repeat):
            begin = time.perf_counter()
            jax.block_until_ready(run(*start))
            found.append(time.perf_counter() - begin)
        return statistics.median(found)

    value = float(forward(*start))
    one_way = seconds(forward)
    return one_way, seconds(both) - one_way, value


def main() -> None:
    print(f"jax {jax.__version__} on {jax.devices()[0].device_kind}", flush=True)
    for name in args.only.split(","):
        make, n = {"wave": (wave, args.wave), "smoke": (smoke, args.smoke)}[name]
        count, found = args.devices, {}
        for label, devices, rows in (
            ("one", 1, n),
            ("strong", count, n),
            ("weak", count, n * count),
        ):
            try:
                forward, backward, loss = measure(make, rows, n, devices)
            except Exception as error:
                print(f"jax {name} {label}: FAILED: {str(error).splitlines()[0]}", flush=True)
                break
            found[label] = forward + backward
            print(f"jax {name} {label} {(rows, n)}: forward {1e3 * forward:.2f} ms, "
                  f"backward {1e3 * backward:.2f} ms, loss {loss:.6g}", flush=True)  # fmt: skip
        if len(found) == 3:
            strong, weak = found["one"] / (count * found["strong"]), found["one"] / found["weak"]
            print(f"jax {name}: strong scaling {strong:.1%}, weak {weak:.1%}", flush=True)


if __name__ == "__main__":
    main()
