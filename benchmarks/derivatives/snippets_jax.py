"""The snippets of the comparison in jax's own idiom: functions, `lax` loops, `.at` updates.

python snippets_jax.py <snippet>
"""

import json
import math
import sys

import jax
import jax.numpy as jnp
from jax import lax

jax.config.update("jax_enable_x64", True)


def gradient(function, *at):
    made = jax.grad(function, argnums=tuple(range(len(at))))(*(jnp.array(a, float) for a in at))
    return [float(g) for part in made for g in part.ravel()]


def power(trips):
    return gradient(
        lambda x: lax.fori_loop(0, trips, lambda _, y: y * x, jnp.ones(2)).sum(), [1.01, 0.99]
    )


def loop_30():
    return power(30)


def loop_31():
    return power(31)


def loop_100():
    return power(100)


def loop_5000():
    return power(5000)


def loop_of_field_length():
    def one(x, n):
        return lax.fori_loop(0, n, lambda _, y: y * x, 1.0)

    return gradient(lambda x: jax.vmap(one)(x, jnp.array([40, 7])).sum(), [1.01, 0.99])


def loop_carrying_a_vector():
    def loss(x):
        def body(_, v):
            return jnp.array([v[0] - 0.1 * x[0] * v[1], v[1] + 0.1 * x[0] * v[0]])

        return lax.fori_loop(0, 40, body, jnp.array([1.0, 0.5]))[0]

    return gradient(loss, [0.3])


def statement_before_an_inner_loop():
    def loss(x):
        s = x[0] * x[0]
        t = lax.fori_loop(0, 4, lambda j, t: t + s * j, 0.0)
        s = s * x[0]
        return lax.fori_loop(0, 2, lambda j, t: t + s * (j + 1), t)

    return gradient(loss, [3.0])


def while_loop():
    return gradient(lambda x: lax.while_loop(lambda y: y < 100, lambda y: y * y, x[0]), [2.0])


def break_in_a_loop():
    def loss(x):
        return lax.while_loop(lambda y: y <= 1000, lambda y: y * x[0], x[0])

    return gradient(loss, [2.0])


def continue_in_a_loop():
    def loss(x):
        def body(j, y):
            return lax.cond(j % 2 == 1, lambda: y, lambda: y * x[0])

        return lax.fori_loop(0, 6, body, 1.0)

    return gradient(loss, [2.0])


def early_return():
    def loss(x):
        y = x[0] * x[0]
        return y + lax.cond(x[0] > 0, lambda: y * x[0], lambda: 100 * y)

    return gradient(loss, [2.0])


def stored_twice():
    def loss(x):
        y = jnp.zeros(1).at[0].set(x[0])
        y = y.at[0].set(y[0] * y[0])
        return y[0] * x[0]

    return gradient(loss, [3.0])


def scaled_in_place():
    def loss(x):
        y = jnp.zeros(1).at[0].set(x[0])
        return y.at[0].mul(x[0]).at[0].mul(2.0).sum()

    return gradient(loss, [3.0])


def square_added_in_place():
    return gradient(lambda x: x.at[0].add(x[0] * x[0]).sum(), [3.0])


def swap():
    def loss(x):
        y = x.at[0].set(x[1]).at[1].set(x[0] * x[0])
        return y[0] + 10 * y[1]

    return gradient(loss, [3.0, 5.0])


def recurrence_along_an_axis():
    def loss(x):
        a = jnp.array([1.0, 0.0, 0.0, 0.0])
        return lax.fori_loop(0, 3, lambda j, a: a.at[j + 1].set(a[j] * x[j]), a)[3]

    return gradient(loss, [2.0, 3.0, 5.0])


def masked_root():
    return gradient(lambda x: jnp.where(x > 0, jnp.sqrt(x), 0.0).sum(), [-1.0, 4.0])


def untaken_branch():
    def one(x):
        return lax.cond(x > 0, jnp.sqrt, lambda y: 0.0 * y, x)

    return gradient(lambda x: lax.map(one, x).sum(), [-1.0, 4.0])


def saturated_sigmoid():
    return gradient(lambda x: (1 / (1 + jnp.exp(-x))).sum(), [-800.0])


def atomic_product():
    return gradient(lambda x: jnp.ones(1).at[jnp.zeros(3, int)].mul(x).sum(), [2.0, 3.0, 5.0])


def atomic_maximum():
    def loss(x):
        return (jnp.full(1, -100.0).at[jnp.zeros(3, int)].max(x) ** 2).sum()

    return gradient(loss, [2.0, 7.0, 5.0])


def rollout_in_place():
    def loss(x, v):
        def step(_, state):
            x, v = state
            v = v - 0.1 * x**3
            return x + 0.1 * v, v

        return lax.fori_loop(0, 20, step, (x, v))[0].sum()

    return gradient(loss, [1.0], [0.5])


def gather_and_scatter():
    def loss(x):
        i, p = jnp.arange(4), jnp.array([3, 1, 3, 0])
        y = jnp.zeros((8, 2)).at[p * 2, i % 2].add(x[(i + p) % 4] * x)
        return (jnp.arange(1, 9)[:, None] * jnp.arange(1, 3)[None, :] * y).sum()

    return gradient(loss, [1.0, 2.0, 3.0, 4.0])


def index_into_a_local_vector():
    def loss(x, k=1):
        v = jnp.array([x[0] * x[1], x[1] * x[1], 0.0])
        v = v.at[k + 1].set(v[k] * x[0])
        return v[2] + v[k - 1]

    return gradient(loss, [2.0, 3.0])


def norm_of_zero():
    return gradient(jnp.linalg.norm, [0.0, 0.0, 0.0])


def norm_of_a_tiny_vector():
    return gradient(jnp.linalg.norm, [1e-200, 0.0, 0.0])


def tangent():
    return gradient(lambda x: jnp.tan(x).sum(), [0.3])


def polar_3d():
    def loss(a):
        u, _, vt = jnp.linalg.svd(a)
        return (u @ vt)[0, 1]

    return gradient(loss, [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])


def svd_product():
    def loss(a):
        u, s, vt = jnp.linalg.svd(a)
        return (u @ jnp.diag(s) @ vt * jnp.array([[1.0, 2.0], [3.0, 4.0]])).sum()

    return gradient(loss, [[1.0, 0.0], [0.0, 1.0]])


def second_order():
    slope = jax.grad(lambda x: x**4)
    return [float(jax.jvp(slope, (2.0,), (1.0,))[1])]


def random_numbers():
    key = jax.random.key(1)

    def loss(x):
        return (jax.random.uniform(key, dtype=float) * x**2).sum()

    return [gradient(loss, [2.0])[0] / float(loss(jnp.array([2.0])))]


def returned_value():
    return gradient(lambda x: (x**2).sum(), [3.0])


if __name__ == "__main__":
    if sys.argv[1] not in globals():
        print("NOTHING")
    else:
        found = globals()[sys.argv[1]]()
        print("GRADIENT", json.dumps([None if math.isnan(g) else g for g in found]))
