"""Steps in time, borders and slots in the forms that programs write, and their gradients, against
sums by NumPy: for lengths around those at which the compiler once changed its mind, on one thread
and on two, and with sums in a fixed order.
"""

import numpy as np
import pytest
import tai as ti

LENGTHS = [1, 2, 3, 1000, 65_536, 65_537]
SETTINGS = {
    "one thread": {"cpu_max_num_threads": 1},
    "two threads": {"cpu_max_num_threads": 2},
    "deterministic": {"cpu_max_num_threads": 2, "deterministic": True},
    "strict": {"cpu_max_num_threads": 2, "deterministic": True, "math": "strict"},
}


@pytest.fixture(params=SETTINGS)
def start(request):
    ti.init(**SETTINGS[request.param])


def numbers(shape, seed):
    """Multiples of 1/8, so that f32 holds sums of them exactly."""
    return np.random.default_rng(seed).integers(-32, 32, shape).astype(np.float64) / 8


def filled(*fields):
    """Puts numbers into fields and their adjoints; returns both lists."""
    for seed, field in enumerate(fields):
        shape = field.shape + ((field.n,) if hasattr(field, "n") else ())
        field.from_numpy(numbers(shape, seed).astype(np.float32))
        field.grad.from_numpy(numbers(shape, seed + 100).astype(np.float32))
    return (
        [f.to_numpy().astype(np.float64) for f in fields],
        [f.grad.to_numpy().astype(np.float64) for f in fields],
    )


def weighed(values, taps):
    """The sum over the taps (indices, sources, weight) of weight * values[sources], at indices."""
    result = np.zeros(values.shape)
    for indices, sources, weight in taps:
        np.add.at(result, indices, weight * values[sources])
    return result


def transposed(bar, taps):
    return weighed(bar, [(sources, indices, weight) for indices, sources, weight in taps])


def check_map(kernel, x, y, taps, args=()):
    """Checks y = sum of taps of x, for a kernel that stores to all elements of y."""
    (before, _), (x_bar, y_bar) = filled(x, y)
    kernel(*args)
    np.testing.assert_array_equal(y.to_numpy(), weighed(before, taps))
    kernel.grad(*args)
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar + transposed(y_bar, taps))
    np.testing.assert_array_equal(y.grad.to_numpy(), 0)


def clamped_taps(n):
    i = np.arange(n)
    return [(i, np.minimum(i + 1, n - 1), 1.0), (i, np.maximum(i - 1, 0), -2.0)]


def periodic_taps(n):
    i = np.arange(n)
    return [(i, (i + 1) % n, 1.0), (i, (i - 1) % n, -2.0)]


@pytest.mark.parametrize("n", LENGTHS)
def test_clamped_borders(n, start):
    x, y = (ti.field(ti.f32, n, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step():
        for i in range(n):
            y[i] = x[ti.min(i + 1, n - 1)] - 2 * x[ti.max(i - 1, 0)]

    check_map(step, x, y, clamped_taps(n))


@pytest.mark.parametrize("n", LENGTHS)
def test_clamped_borders_by_conditions(n, start):
    x, y = (ti.field(ti.f32, n, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step():
        for i in y:
            above, below = i + 1, i - 1
            if i == n - 1:
                above = i
            if i == 0:
                below = 0
            y[i] = x[above] - 2 * x[below]

    check_map(step, x, y, clamped_taps(n))


@pytest.mark.parametrize("n", LENGTHS)
def test_periodic_borders(n, start):
    x, y = (ti.field(ti.f32, n, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step():
        for i in range(n):
            y[i] = x[(i + 1) % n] - 2 * x[(i - 1) % n]

    check_map(step, x, y, periodic_taps(n))


@pytest.mark.parametrize("n", LENGTHS)
def test_periods_of_the_launch(n, start):
    x, y = (ti.field(ti.f32, n, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step(m: ti.i32):
        for i in range(m):
            y[i] = x[(i + 1) % m] - 2 * x[(i - 1) % m]

    check_map(step, x, y, periodic_taps(n), (n,))


@pytest.mark.parametrize("n", LENGTHS)
def test_bounds_of_the_launch(n, start):
    x, y = (ti.field(ti.f32, n + 2, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step(m: ti.i32):
        for i in range(1, m - 1):
            y[i] = x[i + 1] - 2 * x[i - 1]

    (before, y_before), (x_bar, y_bar) = filled(x, y)
    i = np.arange(1, n + 1)
    taps = [(i, i + 1, 1.0), (i, i - 1, -2.0)]
    step(n + 2)
    np.testing.assert_array_equal(y.to_numpy()[1:-1], weighed(before, taps)[1:-1])
    step.grad(n + 2)
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar + transposed(y_bar, taps))
    y_bar[1:-1] = 0
    np.testing.assert_array_equal(y.grad.to_numpy(), y_bar)


@pytest.mark.parametrize("n", LENGTHS)
def test_arrays(n, start):
    x, y = (ti.ndarray(ti.f32, n, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step(a: ti.types.ndarray(ndim=1), b: ti.types.ndarray(ndim=1)):
        for i in range(a.shape[0]):
            b[i] = a[ti.min(i + 1, a.shape[0] - 1)] - 2 * a[ti.max(i - 1, 0)]

    check_map(step, x, y, clamped_taps(n), (x, y))


@pytest.mark.parametrize("layout", [None, ti.Layout.SOA])
@pytest.mark.parametrize("n", LENGTHS)
def test_vectors(n, layout, start):
    extra = {} if layout is None else {"layout": layout}
    x, y = (ti.Vector.field(3, ti.f32, shape=n, needs_grad=True, **extra) for _ in range(2))

    @ti.kernel
    def step():
        for i in range(n):
            y[i] = x[ti.min(i + 1, n - 1)] - 2 * x[ti.max(i - 1, 0)]

    check_map(step, x, y, clamped_taps(n))


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 2), (40, 33)])
def test_clamped_corners(shape, start):
    n, m = shape
    x, y = (ti.field(ti.f32, shape, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step():
        for i, j in x:
            y[i, j] = x[ti.min(i + 1, n - 1), ti.max(j - 1, 0)] - 2 * x[ti.max(i - 2, 0), j]

    i, j = (part.ravel() for part in np.indices(shape))
    taps = [
        ((i, j), (np.minimum(i + 1, n - 1), np.maximum(j - 1, 0)), 1.0),
        ((i, j), (np.maximum(i - 2, 0), j), -2.0),
    ]
    check_map(step, x, y, taps)


def check_step(kernel, x, taps, args, source=0, target=1):
    """Checks x[target] = sum of taps of x[source] where there are taps, and the gradient."""
    (before,), (bar,) = filled(x)
    kernel(*args)
    where = np.unique(taps[0][0])
    expected = before.copy()
    expected[target, where] = weighed(before[source], taps)[where]
    np.testing.assert_array_equal(x.to_numpy(), expected)
    kernel.grad(*args)
    taken = np.zeros(bar[target].shape)
    taken[where] = bar[target, where]
    bar[target, where] = 0
    bar[source] += transposed(taken, taps)
    np.testing.assert_array_equal(x.grad.to_numpy(), bar)


def inner_taps(n):
    i = np.arange(n - 1)
    return [(i, i + 1, 1.0), (i, i, -1.0)]


@pytest.mark.parametrize("n", LENGTHS)
def test_guarded_steps(n, start):
    x = ti.field(ti.f32, (3, n), needs_grad=True)

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            if i < n - 1:
                x[t + 1, i] = x[t, i + 1] - x[t, i]

    check_step(step, x, inner_taps(n), (1,), source=1, target=2)


@pytest.mark.parametrize(("source", "target"), [(0, 2), (2, 1)])
@pytest.mark.parametrize("n", LENGTHS)
def test_slots(n, source, target, start):
    x = ti.field(ti.f32, (3, n), needs_grad=True)

    @ti.kernel
    def step(a: ti.i32, b: ti.i32):
        for i in range(n - 1):
            x[b, i] = x[a, i + 1] - x[a, i]

    check_step(step, x, inner_taps(n), (source, target), source, target)


@pytest.mark.parametrize(("source", "target"), [(0, 2), (2, 1)])
@pytest.mark.parametrize("n", LENGTHS)
def test_slots_of_one_neighbour(n, source, target, start):
    """The only element that an iteration reads is that of another one."""
    x = ti.field(ti.f32, (3, n), needs_grad=True)

    @ti.kernel
    def step(a: ti.i32, b: ti.i32):
        for i in range(n - 1):
            x[b, i] = 2 * x[a, i + 1]

    i = np.arange(n - 1)
    check_step(step, x, [(i, i + 1, 2.0)], (source, target), source, target)


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("layout", [None, ti.Layout.SOA])
@pytest.mark.parametrize("n", [1, 7, 65_537])
def test_slots_of_vectors(n, layout, precision, start):
    extra = {} if layout is None else {"layout": layout}
    kind = getattr(ti, precision)
    x = ti.Vector.field(2, kind, shape=(3, n), needs_grad=True, **extra)

    @ti.kernel
    def step(a: ti.i32, b: ti.i32):
        for i in range(n - 1):
            x[b, i] = x[a, i + 1] - x[a, i]

    for source, target in ((0, 2), (2, 1), (1, 0)):
        check_step(step, x, inner_taps(n), (source, target), source, target)


@pytest.mark.parametrize("used", [0, 1, 2, 999, 1000])
def test_parts_of_a_field(used, start):
    """Bounds and periods that are the size of the field in some launches, and less in others."""
    x, y = (ti.field(ti.f32, 1000, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step(m: ti.i32):
        for i in range(m):
            y[i] = x[(i + 1) % m] - 2 * x[ti.max(i - 1, 0)]

    (before, y_before), (x_bar, y_bar) = filled(x, y)
    i = np.arange(used)
    taps = [(i, (i + 1) % max(used, 1), 1.0), (i, np.maximum(i - 1, 0), -2.0)]
    step(used)
    y_before[:used] = weighed(before, taps)[:used]
    np.testing.assert_array_equal(y.to_numpy(), y_before)
    step.grad(used)
    taken = np.where(np.arange(1000) < used, y_bar, 0)
    np.testing.assert_array_equal(x.grad.to_numpy(), x_bar + transposed(taken, taps))
    np.testing.assert_array_equal(y.grad.to_numpy(), y_bar - taken)


def test_equal_slots():
    """The same kernel where both slots are one, as far as iterations do not meet."""
    ti.init(cpu_max_num_threads=2)
    n = 3000
    x = ti.field(ti.f32, (2, n), needs_grad=True)

    @ti.kernel
    def step(a: ti.i32, b: ti.i32):
        for i in range(n // 2):
            x[b, i] = x[a, i + n // 2] - x[a, i]

    i = np.arange(n // 2)
    taps = [(i, i + n // 2, 1.0), (i, i, -1.0)]
    check_step(step, x, taps, (1, 1), 1, 1)
    check_step(step, x, taps, (0, 1), 0, 1)


@pytest.mark.parametrize("n", LENGTHS)
def test_coupled_fields(n, start):
    """Positions that are made of the new velocities."""
    x, v = (ti.Vector.field(2, ti.f32, shape=(2, n), needs_grad=True) for _ in range(2))

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            force = ti.Vector([0.0, -1.0])
            if i > 0:
                force += x[t, i - 1] - x[t, i]
            if i < n - 1:
                force += x[t, i + 1] - x[t, i]
            v[t + 1, i] = v[t, i] + 0.5 * force
            x[t + 1, i] = x[t, i] + 0.5 * v[t + 1, i]

    (at, speed), (x_bar, v_bar) = filled(x, v)
    i = np.arange(n)
    taps = [
        (i[1:], i[:-1], 1.0), (i[1:], i[1:], -1.0),
        (i[:-1], i[1:], 1.0), (i[:-1], i[:-1], -1.0),
    ]  # fmt: skip
    step(0)
    new_speed = speed[0] + 0.5 * (weighed(at[0], taps) + [0, -1])
    np.testing.assert_array_equal(v.to_numpy()[1], new_speed)
    np.testing.assert_array_equal(x.to_numpy()[1], at[0] + 0.5 * new_speed)
    step.grad(0)
    speed_bar = v_bar[1] + 0.5 * x_bar[1]
    np.testing.assert_array_equal(v.grad.to_numpy(), [v_bar[0] + speed_bar, 0 * speed_bar])
    np.testing.assert_array_equal(
        x.grad.to_numpy(),
        [x_bar[0] + x_bar[1] + 0.5 * transposed(speed_bar, taps), 0 * speed_bar],
    )


@pytest.mark.parametrize("n", [1, 2, 3, 12])
def test_six_fields(n, start):
    """Electric fields of a box, from the curl of magnetic ones, under one condition."""
    shape = (2, n, n, n)
    ex, ey, hz = (ti.field(ti.f32, shape, needs_grad=True) for _ in range(3))

    @ti.kernel
    def step(t: ti.i32):
        for i, j, k in ti.ndrange(n, n, n):
            if i < n - 1 and j < n - 1 and k < n - 1:
                hz[t + 1, i, j, k] = hz[t, i, j, k] + 0.5 * (
                    ex[t, i, j + 1, k] - ex[t, i, j, k] - ey[t, i + 1, j, k] + ey[t, i, j, k]
                )
                ex[t + 1, i, j, k] = ex[t, i, j, k]

    (x, y, z), (x_bar, y_bar, z_bar) = filled(ex, ey, hz)
    step(0)
    inner = (slice(0, n - 1),) * 3
    curl = np.roll(x[0], -1, 1) - x[0] - np.roll(y[0], -1, 0) + y[0]
    z[1][inner] = (z[0] + 0.5 * curl)[inner]
    np.testing.assert_array_equal(hz.to_numpy(), z)
    step.grad(0)
    taken, taken_x = np.zeros((n, n, n)), np.zeros((n, n, n))
    taken[inner], taken_x[inner] = z_bar[1][inner], x_bar[1][inner]
    z_bar[0] += taken
    x_bar[0] += taken_x + 0.5 * (np.roll(taken, 1, 1) - taken)
    y_bar[0] += 0.5 * (taken - np.roll(taken, 1, 0))
    z_bar[1][inner], x_bar[1][inner] = 0, 0
    np.testing.assert_array_equal(hz.grad.to_numpy(), z_bar)
    np.testing.assert_array_equal(ex.grad.to_numpy(), x_bar)
    np.testing.assert_array_equal(ey.grad.to_numpy(), y_bar)


@pytest.mark.parametrize("n", LENGTHS)
def test_convolutions(n, start):
    """Weights by an inner loop."""
    x, y = (ti.field(ti.f32, n, needs_grad=True) for _ in range(2))

    @ti.kernel
    def step():
        for i in range(n):
            total = 0.0
            for k in range(-2, 3):
                j = i + k
                if j >= 0 and j < n:
                    total += (k + 3) * x[j]
            y[i] = total

    i = np.arange(n)
    taps = []
    for k in range(-2, 3):
        inside = i[(i + k >= 0) & (i + k < n)]
        taps.append((inside, inside + k, k + 3.0))
    check_map(step, x, y, taps)


def rope_step(ti_type, n, layout):
    """One step of a rope whose springs have lengths: fields of two slots, and the kernel."""
    extra = {} if layout is None else {"layout": layout}
    x, v = (ti.Vector.field(2, ti_type, shape=(2, n), needs_grad=True, **extra) for _ in range(2))

    @ti.func
    def pull(a, b):
        d = b - a
        length = ti.sqrt(d.dot(d) + 0.015625)
        return (length - 0.5) / length * d

    @ti.kernel
    def step(t: ti.i32):
        for i in range(n):
            force = ti.Vector([0.0, -1.0], dt=ti_type)
            if i > 0:
                force += pull(x[t, i], x[t, i - 1])
            if i < n - 1:
                force += pull(x[t, i], x[t, i + 1])
            v[t + 1, i] = 0.5 * v[t, i] + 0.25 * force
            x[t + 1, i] = x[t, i] + 0.25 * v[t + 1, i]

    return x, v, step


def rope_by_numpy(at, speed, x_bar, v_bar):
    """The step of rope_step, and the adjoints of its first slots by the chain rule, in f64."""
    d = at[1:] - at[:-1]
    length = np.sqrt((d * d).sum(-1, keepdims=True) + 0.015625)
    pull = (length - 0.5) / length * d
    force = np.zeros_like(at) + [0.0, -1.0]
    force[:-1] += pull
    force[1:] -= pull
    new_speed = 0.5 * speed + 0.25 * force
    speed_bar = v_bar + 0.25 * x_bar
    pull_bar = 0.25 * (speed_bar[:-1] - speed_bar[1:])
    along = (pull_bar * d).sum(-1, keepdims=True)
    d_bar = (length - 0.5) / length * pull_bar + 0.5 / length**3 * along * d
    at_bar = x_bar.copy()
    at_bar[1:] += d_bar
    at_bar[:-1] -= d_bar
    return at + 0.25 * new_speed, new_speed, at_bar, 0.5 * speed_bar


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("layout", [None, ti.Layout.SOA])
@pytest.mark.parametrize("n", [1, 2, 7, 1000, 65_537])
def test_lengths_of_springs(n, layout, precision, start):
    x, v, step = rope_step(getattr(ti, precision), n, layout)
    random = np.random.default_rng(n)
    at, speed, x_bar, v_bar = (random.standard_normal((n, 2)) for _ in range(4))
    zero = np.zeros((n, 2))
    for field, first in ((x, at), (v, speed)):
        field.from_numpy(np.stack([first, zero]).astype(precision.replace("f", "float")))
    for field, last in ((x, x_bar), (v, v_bar)):
        field.grad.from_numpy(np.stack([zero, last]).astype(precision.replace("f", "float")))
    step(0)
    new_at, new_speed, at_bar, speed_bar = rope_by_numpy(at, speed, x_bar, v_bar)
    tolerance = 2e-5 if precision == "f32" else 1e-13
    np.testing.assert_allclose(x.to_numpy()[1], new_at, atol=tolerance)
    np.testing.assert_allclose(v.to_numpy()[1], new_speed, atol=tolerance)
    step.grad(0)
    np.testing.assert_allclose(x.grad.to_numpy(), [at_bar, zero], atol=4 * tolerance)
    np.testing.assert_allclose(v.grad.to_numpy(), [speed_bar, zero], atol=4 * tolerance)
