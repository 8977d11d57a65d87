"""Stencils over arrays, and to bounds of the launch, and their gradients, against sums by NumPy:
one thread and two, sums in a fixed order, arrays that overlap, and ranges shorter than the stencil.
"""

import numpy as np
import pytest
import tai as ti

LENGTHS = [1, 2, 3, 7, 1000, 65_537]
SETTINGS = {
    "one thread": {"cpu_max_num_threads": 1},
    "two threads": {"cpu_max_num_threads": 2},
    "deterministic": {"cpu_max_num_threads": 2, "deterministic": True},
    "strict": {"cpu_max_num_threads": 2, "deterministic": True, "math": "strict"},
}
Array = ti.types.ndarray


@pytest.fixture(params=SETTINGS)
def start(request):
    ti.init(**SETTINGS[request.param])


def numbers(shape, seed):
    """Multiples of 1/8, so that f32 holds sums of them exactly."""
    return (np.random.default_rng(seed).integers(-32, 32, shape) / 8).astype(np.float32)


def filled(*shapes):
    """Arrays of numbers with adjoints; returns them, their values and their adjoints."""
    arrays = [ti.ndarray(ti.f32, shape, needs_grad=True) for shape in shapes]
    for seed, array in enumerate(arrays):
        array.from_numpy(numbers(array.shape, seed))
        array.grad.from_numpy(numbers(array.shape, seed + 100))
    return arrays, [a.to_numpy() for a in arrays], [a.grad.to_numpy() for a in arrays]


@ti.kernel
def central(a: Array(ndim=1), b: Array(ndim=1)):
    for i in range(1, a.shape[0] - 1):
        b[i] = a[i + 1] - 2 * a[i - 1]


@ti.kernel
def under_condition(a: Array(ndim=1), b: Array(ndim=1)):
    for i in range(a.shape[0]):
        if i > 0 and i < a.shape[0] - 1:
            b[i] = a[i + 1] - 2 * a[i - 1]


@pytest.mark.parametrize("kernel", [central, under_condition], ids=["bounds", "condition"])
@pytest.mark.parametrize("n", LENGTHS)
def test_two_neighbours(n, kernel, start):
    (x, y), (before, after), (x_bar, y_bar) = filled(n, n)
    kernel(x, y)
    after[1:-1] = before[2:] - 2 * before[:-2] if n > 2 else after[1:-1]
    np.testing.assert_array_equal(y.to_numpy(), after)
    kernel.grad(x, y)
    if n > 2:
        x_bar[2:] += y_bar[1:-1]
        x_bar[:-2] -= 2 * y_bar[1:-1]
    y_bar[1:-1] = 0
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(y.grad.to_numpy(), y_bar)


@ti.kernel
def periodic(a: Array(ndim=1), b: Array(ndim=1)):
    n = a.shape[0]
    for i in range(n):
        b[i] = a[(i + 1) % n] - 2 * a[(i - 1) % n]


@ti.kernel
def clamped(a: Array(ndim=1), b: Array(ndim=1)):
    n = a.shape[0]
    for i in range(n):
        b[i] = a[ti.min(i + 1, n - 1)] - 2 * a[ti.max(i - 1, 0)]


@ti.kernel
def clamped_by_conditions(a: Array(ndim=1), b: Array(ndim=1)):
    for i in a:
        after, before = i + 1, i - 1
        if i == a.shape[0] - 1:
            after = i
        if before < 0:
            before = 0
        b[i] = a[after] - 2 * a[before]


def at_borders(kernel, i, n):
    if kernel is periodic:
        return (i + 1) % n, (i - 1) % n
    return np.minimum(i + 1, n - 1), np.maximum(i - 1, 0)


@pytest.mark.parametrize(
    "kernel", [periodic, clamped, clamped_by_conditions], ids=["periodic", "min", "if"]
)
@pytest.mark.parametrize("n", LENGTHS)
def test_borders(n, kernel, start):
    (x, y), (before, _), (x_bar, y_bar) = filled(n, n)
    after, behind = at_borders(kernel, np.arange(n), n)
    kernel(x, y)
    np.testing.assert_array_equal(y.to_numpy(), before[after] - 2 * before[behind])
    kernel.grad(x, y)
    np.add.at(x_bar, after, y_bar)
    np.add.at(x_bar, behind, -2 * y_bar)
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(y.grad.to_numpy(), 0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 2), (5, 5), (40, 33)])
def test_periodic_planes(shape, start):
    (x, y), (before, _), (x_bar, y_bar) = filled(shape, shape)

    @ti.kernel
    def step(a: Array(ndim=2), b: Array(ndim=2)):
        n, m = a.shape[0], a.shape[1]
        for i, j in ti.ndrange(n, m):
            b[i, j] = a[(i + 1) % n, j] - 2 * a[i, (j - 2) % m] + 3 * a[i, ti.min(j + 1, m - 1)]

    i, j = np.indices(shape)
    n, m = shape
    parts = [(1, ((i + 1) % n, j)), (-2, (i, (j - 2) % m)), (3, (i, np.minimum(j + 1, m - 1)))]
    step(x, y)
    np.testing.assert_array_equal(y.to_numpy(), sum(w * before[part] for w, part in parts))
    step.grad(x, y)
    for weight, part in parts:
        np.add.at(x_bar, part, weight * y_bar)
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)


@pytest.mark.parametrize("used", [1, 2, 3, 500, 1000])
def test_periods_within_a_field(used, start):
    x, y = (ti.field(ti.f32, 1001, needs_grad=True) for _ in range(2))
    for seed, part in enumerate((x, y, x.grad, y.grad)):
        part.from_numpy(numbers(1001, seed))
    before, after, x_bar, y_bar = (part.to_numpy() for part in (x, y, x.grad, y.grad))

    @ti.kernel
    def step(m: ti.i32):
        for i in range(m):
            y[i] = x[(i + 1) % m] - 2 * x[(i - 1) % m]

    step(used)
    i = np.arange(used)
    after[i] = before[(i + 1) % used] - 2 * before[(i - 1) % used]
    np.testing.assert_array_equal(y.to_numpy(), after)
    step.grad(used)
    np.add.at(x_bar, (i + 1) % used, y_bar[i])
    np.add.at(x_bar, (i - 1) % used, -2 * y_bar[i])
    y_bar[i] = 0
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(y.grad.to_numpy(), y_bar)


@pytest.mark.parametrize("n", LENGTHS)
def test_shifted_products(n, start):
    """A term whose factors are other elements than that of the iteration."""
    (x, y), (before, _), (x_bar, y_bar) = filled(n + 3, n)

    @ti.kernel
    def step(a: Array(ndim=1), b: Array(ndim=1)):
        for i in b:
            b[i] = a[i] * a[i + 3] + a[i + 1]

    step(x, y)
    np.testing.assert_array_equal(y.to_numpy(), before[:-3] * before[3:] + before[1 : n + 1])
    step.grad(x, y)
    x_bar[:-3] += y_bar * before[3:]
    x_bar[3:] += y_bar * before[:-3]
    x_bar[1 : n + 1] += y_bar
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(y.grad.to_numpy(), 0)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 2), (3, 3), (7, 4), (40, 33)])
def test_five_points(shape, start):
    (x, y), (before, after), (x_bar, y_bar) = filled(shape, shape)

    @ti.kernel
    def step(a: Array(ndim=2), b: Array(ndim=2)):
        for i, j in ti.ndrange((1, a.shape[0] - 1), (1, a.shape[1] - 1)):
            b[i, j] = a[i + 1, j] - 2 * a[i - 1, j] + 3 * a[i, j + 1] - 4 * a[i, j - 1]

    step(x, y)
    inner = (slice(1, -1), slice(1, -1))
    parts = [
        (1, (slice(2, None), slice(1, -1))), (-2, (slice(None, -2), slice(1, -1))),
        (3, (slice(1, -1), slice(2, None))), (-4, (slice(1, -1), slice(None, -2))),
    ]  # fmt: skip
    if min(shape) > 2:
        after[inner] = sum(weight * before[part] for weight, part in parts)
    np.testing.assert_array_equal(y.to_numpy(), after)
    step.grad(x, y)
    if min(shape) > 2:
        for weight, part in parts:
            x_bar[part] += weight * y_bar[inner]
        y_bar[inner] = 0
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(y.grad.to_numpy(), y_bar)


@pytest.mark.parametrize("n", LENGTHS)
def test_steps_of_an_array(n, start):
    """One array with a time axis."""
    (x,), (before,), (bar,) = filled((3, n + 1))

    @ti.kernel
    def step(a: Array(ndim=2), t: ti.i32):
        for i in range(a.shape[1] - 1):
            a[t + 1, i] = a[t, i + 1] - a[t, i]

    step(x, 1)
    before[2, :-1] = before[1, 1:] - before[1, :-1]
    np.testing.assert_array_equal(x.to_numpy(), before)
    step.grad(x, 1)
    bar[1, 1:] += bar[2, :-1]
    bar[1, :-1] -= bar[2, :-1]
    bar[2, :-1] = 0
    np.testing.assert_array_equal(x.grad.to_numpy(), bar)


@pytest.mark.parametrize("used", [0, 1, 2, 3, 500, 999])
def test_bounds_within_a_field(used, start):
    x, y = (ti.field(ti.f32, 1001, needs_grad=True) for _ in range(2))
    for seed, part in enumerate((x, y, x.grad, y.grad)):
        part.from_numpy(numbers(1001, seed))
    before, after, x_bar, y_bar = (part.to_numpy() for part in (x, y, x.grad, y.grad))

    @ti.kernel
    def step(m: ti.i32):
        for i in range(1, m):
            y[i] = x[i + 1] - 2 * x[i - 1]

    step(used)
    i = np.arange(1, used)
    after[i] = before[i + 1] - 2 * before[i - 1]
    np.testing.assert_array_equal(y.to_numpy(), after)
    step.grad(used)
    x_bar[i + 1] += y_bar[i]
    x_bar[i - 1] -= 2 * y_bar[i]
    y_bar[i] = 0
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(y.grad.to_numpy(), y_bar)


@pytest.mark.parametrize("n", [1, 7, 65_537])
def test_vectors_in_arrays(n, start):
    x, y = (ti.Vector.ndarray(3, ti.f32, n + 2, needs_grad=True) for _ in range(2))
    for seed, part in enumerate((x, y, x.grad, y.grad)):
        part.from_numpy(numbers((n + 2, 3), seed))
    before, after, x_bar, y_bar = (part.to_numpy() for part in (x, y, x.grad, y.grad))
    vec3 = ti.types.vector(3, ti.f32)

    @ti.kernel
    def step(a: Array(dtype=vec3, ndim=1), b: Array(dtype=vec3, ndim=1)):
        for i in range(1, a.shape[0] - 1):
            b[i] = a[i + 1] - 2 * a[i - 1]

    step(x, y)
    after[1:-1] = before[2:] - 2 * before[:-2]
    np.testing.assert_array_equal(y.to_numpy(), after)
    step.grad(x, y)
    x_bar[2:] += y_bar[1:-1]
    x_bar[:-2] -= 2 * y_bar[1:-1]
    y_bar[1:-1] = 0
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(y.grad.to_numpy(), y_bar)


@pytest.mark.parametrize("threads", [1, 2])
def test_one_array_twice(threads):
    """Reads and writes of different parts of one array, as two arguments."""
    ti.init(cpu_max_num_threads=threads)
    n = 1000
    (x,), (before,), (bar,) = filled(2 * n)

    @ti.kernel
    def step(a: Array(ndim=1), b: Array(ndim=1), n: ti.i32):
        for i in range(1, n - 1):
            b[n + i] = a[i + 1] - 2 * a[i - 1]

    step(x, x, n)
    before[n + 1 : 2 * n - 1] = before[2:n] - 2 * before[: n - 2]
    np.testing.assert_array_equal(x.to_numpy(), before)
    step.grad(x, x, n)
    taken = bar[n + 1 : 2 * n - 1].copy()
    bar[2:n] += taken
    bar[: n - 2] -= 2 * taken
    bar[n + 1 : 2 * n - 1] = 0
    np.testing.assert_array_equal(x.grad.to_numpy(), bar)


def test_threads_do_not_change_bits():
    """Sums over arrays have one order on any number of threads."""
    found = []
    for threads in (1, 2):
        ti.init(cpu_max_num_threads=threads)
        x, y = (ti.ndarray(ti.f32, 40_000, needs_grad=True) for _ in range(2))
        for seed, part in enumerate((x, y, x.grad, y.grad)):
            values = np.random.default_rng(seed).standard_normal(40_000)
            part.from_numpy(values.astype(np.float32))
        central(x, y)
        central.grad(x, y)
        found.append(x.grad.to_numpy())
    np.testing.assert_array_equal(found[0].view(np.uint32), found[1].view(np.uint32))


def test_explained():
    ti.init(cpu_max_num_threads=2)
    (x, y), _, _ = filled(100, 100)
    central(x, y)
    central.grad(x, y)
    assert "additions to an array are gathered" in central.explain()
