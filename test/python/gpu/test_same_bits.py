"""The same bits on the CPU, with any number of threads, and on the emulated device, with blocks of
any size, where `math="strict"` and `deterministic=True` are chosen and no function is computed.

What does not depend on an order of sums has them. Sums over iterations and scatters have a fixed
order on each target, and not the same one: decision 0036.
"""

import numpy as np
import pytest
import tai as ti

TYPES = {"f32": ti.f32, "f64": ti.f64}

# Long enough for several partitions, blocks of sums and warps.
N = 20_011


def numbers(n, dtype, seed=0):
    return np.random.default_rng(seed).standard_normal(n).astype(dtype.replace("f", "float"))


def runs(monkeypatch):
    """Contexts of each target: their names, when they have begun."""
    for threads in (1, 2, 3, 4):
        monkeypatch.setenv("TI_ARCH", "cpu")
        yield f"cpu {threads}", {"arch": ti.cpu, "cpu_max_num_threads": threads}
    for threads in (1, 32, 96):
        monkeypatch.setenv("TI_ARCH", "cuda")
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
        monkeypatch.setenv("TAI_EMULATED_THREADS", str(threads))
        yield f"device {threads}", {"arch": ti.cuda}


def assert_same(program, dtype, monkeypatch):
    """`program(dtype)` gives arrays whose bits are those of one thread of the CPU."""
    first = None
    for name, options in runs(monkeypatch):
        ti.init(
            offline_cache=False, math="strict", deterministic=True,
            default_fp=TYPES[dtype], **options,
        )  # fmt: skip
        found = [np.ascontiguousarray(a) for a in program(dtype)]
        first = first or found
        for i, (one, other) in enumerate(zip(first, found, strict=True)):
            different = np.flatnonzero(one.view(np.uint8) != other.view(np.uint8))
            assert different.size == 0, f"array {i} on {name}: {different.size} bytes differ"


def fields(dtype, count, shape=N, **kinds):
    kinds = kinds or {"needs_grad": True}
    return [ti.field(TYPES[dtype], shape=shape, **kinds) for _ in range(count)]


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


def total(dtype):
    """All iterations add to one element."""
    (x,) = fields(dtype, 1)
    (s,) = fields(dtype, 1, ())

    @ti.kernel
    def run():
        for i in x:
            s[None] += x[i] * x[i] - 0.5

    x.from_numpy(numbers(N, dtype))
    run()
    return [s.to_numpy()]


def scatter(dtype, cells):
    """Iterations add to elements that an index names."""
    (x,) = fields(dtype, 1)
    (grid,) = fields(dtype, 1, cells)
    at = ti.field(ti.i32, shape=N)

    @ti.kernel
    def run():
        for i in x:
            grid[at[i]] += x[i]

    x.from_numpy(numbers(N, dtype))
    at.from_numpy(np.random.default_rng(0).integers(0, cells, N).astype(np.int32))
    run()
    return [grid.to_numpy()]


def adjoints_across_parts(dtype):
    """A stencil under a condition, whose adjoint is not gathered: parts of the loop meet."""
    x, y = fields(dtype, 2, 100_003)

    @ti.kernel
    def run():
        for i in x:
            if i > 0 and i < 100_002:
                y[i] = (x[i - 1] - 2.0 * x[i] + x[i + 1]) * x[i]

    x.from_numpy(numbers(100_003, dtype))
    with ti.ad.Tape() as tape:
        run()
    tape.backward({y: numbers(100_003, dtype, 1)})
    return [x.grad.to_numpy()]


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize(
    "program", [maps, stencils, matrices, serial_sums, own_elements, gathers],
    ids=lambda program: program.__name__,
)  # fmt: skip
def test_no_order(program, dtype, monkeypatch):
    assert_same(program, dtype, monkeypatch)


ORDERS = {
    "total": (total, "the CPU has blocks of 2048 terms, a device every 8192th"),
    "to 13 cells": (lambda dtype: scatter(dtype, 13), "the CPU has partitions, a device warps"),
    "to many cells": (lambda dtype: scatter(dtype, 6007), "the CPU has partitions, a device warps"),
    "adjoints across parts": (adjoints_across_parts, "partitions of the CPU meet in an element"),
}


def different_orders():
    for name, (program, why) in ORDERS.items():
        for dtype in TYPES:
            # Totals of f32 are added up in f64 on both, and rounded once.
            marks = (
                ()
                if (name, dtype) == ("total", "f32")
                else pytest.mark.xfail(reason=why, strict=True)
            )
            yield pytest.param(program, dtype, marks=marks, id=f"{name}-{dtype}")


@pytest.mark.parametrize("program, dtype", different_orders())
def test_one_order(program, dtype, monkeypatch):
    """To be had by one tree of sums for all targets."""
    assert_same(program, dtype, monkeypatch)
