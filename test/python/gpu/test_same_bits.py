"""The same bits on the CPU, with any number of threads, and on the emulated device, with blocks of
any size, if `math="strict"` and `deterministic=True` are chosen and no function is computed:
results that do not depend on an order of sums.
"""

import numpy as np
import pytest
import tai as ti

from same_bits import TYPES, N, assert_same, fields, numbers


def maps(dtype):
    """Sums, products, quotients and roots of each element, and their gradient."""
    x, y = fields(dtype, 2)

    @ti.kernel
    def run():
        for i in x:
            a = x[i] * x[i] + 0.3
            y[i] = (a * x[i] - 2.0 / a) * ti.sqrt(a) + ti.abs(x[i]) / (1.0 + a * a)
            if x[i] > 0.5:
                y[i] = ti.max(y[i], a) - x[i] * 0.1

    x.from_numpy(numbers(N, dtype))
    with ti.ad.Tape() as tape:
        run()
    values = y.to_numpy()
    tape.backward({y: numbers(N, dtype, 1)})
    return values, x.grad.to_numpy()


def stencils(dtype):
    """Neighbours over an inner range in one and two dimensions: the adjoint is gathered."""
    x, y = fields(dtype, 2)
    p, q = fields(dtype, 2, (131, 97))

    @ti.kernel
    def line():
        for i in range(1, N - 1):
            y[i] = (x[i - 1] - 2.0 * x[i] + x[i + 1]) * x[i] / (1.0 + x[i] * x[i])

    @ti.kernel
    def plane():
        for i, j in ti.ndrange((1, 130), (1, 96)):
            q[i, j] = 0.2 * (p[i - 1, j] + p[i + 1, j] + p[i, j - 1] + p[i, j + 1]) - p[i, j] ** 2

    x.from_numpy(numbers(N, dtype))
    p.from_numpy(numbers(131 * 97, dtype, 2).reshape(131, 97))
    with ti.ad.Tape() as tape:
        line()
        plane()
    values = [y.to_numpy(), q.to_numpy()]
    tape.backward({
        y: numbers(N, dtype, 1), q: numbers(131 * 97, dtype, 3).reshape(131, 97)
    })  # fmt: skip
    return [*values, x.grad.to_numpy(), p.grad.to_numpy()]


def matrices(dtype):
    """Products, determinants and inverses of small matrices."""
    m = ti.Matrix.field(3, 3, TYPES[dtype], shape=501, needs_grad=True)
    v = ti.Vector.field(3, TYPES[dtype], shape=501, needs_grad=True)

    @ti.kernel
    def run():
        for i in m:
            a = m[i] @ m[i].transpose() + 2.0 * ti.Matrix.identity(TYPES[dtype], 3)
            b = a.inverse() * a.determinant()
            v[i] = b @ ti.Vector([m[i][0, 0], m[i][1, 2], 1.0]) + m[i] @ v[i].cross(
                ti.Vector([1.0, 2.0, 3.0])
            )

    m.from_numpy(numbers(501 * 9, dtype).reshape(501, 3, 3))
    v.from_numpy(numbers(501 * 3, dtype, 1).reshape(501, 3))
    run()
    return [v.to_numpy()]


def serial_sums(dtype):
    """A sum that one iteration forms by itself is arithmetic, in the order of the program."""
    x, y = fields(dtype, 2)

    @ti.kernel
    def run():
        for i in x:
            total = x[i] * 0.0
            for k in range(17):
                total += x[(i * 7 + k * 13) % N] * (k + 1)
                if total > 30.0:
                    break
            y[i] = total

    x.from_numpy(numbers(N, dtype))
    run()
    return [y.to_numpy()]


def own_elements(dtype):
    """Updates of elements that each iteration has for itself, and the greatest and least of all."""
    x, y = fields(dtype, 2)
    most, least = fields(dtype, 2, ())
    count = ti.field(ti.i64, shape=5)
    at = ti.field(ti.i32, shape=N)

    @ti.kernel
    def run():
        for i in x:
            y[N - 1 - i] += x[i] * x[i]
            y[N - 1 - i] -= 0.25 * x[i]
            ti.atomic_max(most[None], x[i])
            ti.atomic_min(least[None], x[i] * x[i] - 1.0)
            count[at[i]] += at[i] + 1

    x.from_numpy(numbers(N, dtype))
    y.from_numpy(numbers(N, dtype, 1))
    at.from_numpy(np.random.default_rng(0).integers(0, 5, N).astype(np.int32))
    run()
    return [f.to_numpy() for f in (y, most, least, count)]


def gathers(dtype):
    """Elements by way of an index, in any order."""
    x, y = fields(dtype, 2)
    at = ti.field(ti.i32, shape=N)

    @ti.kernel
    def run():
        for i in y:
            y[i] = x[at[i]] * 0.7 - x[(at[i] + 1) % N]

    x.from_numpy(numbers(N, dtype))
    at.from_numpy(np.random.default_rng(0).integers(0, N, N).astype(np.int32))
    run()
    return [y.to_numpy()]


@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize(
    "program", [maps, stencils, matrices, serial_sums, own_elements, gathers],
    ids=lambda program: program.__name__,
)  # fmt: skip
def test_no_order(program, dtype, monkeypatch):
    assert_same(program, dtype, monkeypatch)
