"""Gradients of loops: carried values, trip counts, early exits.

Powers have closed forms; the rest is compared with central differences (f64, relative error
1e-7), and in f32 with the gradient in f64.
"""

import resource

import numpy as np
import pytest
import tai as ti

N = 5


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


# Powers: y *= c


def power_kernels(dtype):
    """Kernels that compute x c^n, and the fields (c, n, x, y) that they read and write."""
    c = ti.field(dtype, shape=(), needs_grad=True, name="c")
    n = ti.field(ti.i32, shape=(), name="n")
    x = ti.field(dtype, shape=3, needs_grad=True, name="x")
    y = ti.field(dtype, shape=3, needs_grad=True, name="y")

    @ti.kernel
    def counted(trips: ti.i32):
        for i in x:
            value = x[i]
            for _ in range(trips):
                value *= c[None]
            y[i] = value

    @ti.kernel
    def from_field():
        for i in x:
            value = x[i]
            for _ in range(n[None]):
                value *= c[None]
            y[i] = value

    @ti.kernel
    def leaving():
        for i in x:
            value = x[i]
            j = 0
            while True:
                if j >= n[None]:
                    break
                value *= c[None]
                j += 1
            y[i] = value

    kernels = {"argument": counted, "field": from_field, "while": leaving}
    return (c, n, x, y), kernels


@pytest.mark.parametrize("trips", [0, 1, 30, 31, 100, 5000, 1_000_000])
@pytest.mark.parametrize("how", ["argument", "field", "while"])
def test_powers(how, trips):
    (c, n, x, y), kernels = power_kernels(ti.f64)
    base = 1 + 1 / max(trips, 4)
    c[None], n[None] = base, trips
    start = np.array([0.5, -2.0, 3.0])
    x.from_numpy(start)
    kernel = kernels[how]
    arguments = (trips,) if how == "argument" else ()
    kernel(*arguments)
    np.testing.assert_allclose(y.to_numpy(), start * base**trips, rtol=1e-10)
    y.grad.fill(1.0)
    kernel.grad(*arguments)
    np.testing.assert_allclose(x.grad.to_numpy(), base**trips, rtol=1e-10)
    slope = trips * base ** (trips - 1) * start.sum()
    assert c.grad[None] == pytest.approx(slope, rel=1e-10)


@pytest.mark.parametrize("trips", [30, 31, 100, 5000])
@pytest.mark.parametrize("how", ["argument", "field", "while"])
def test_powers_in_single_precision(how, trips):
    (c, n, x, y), kernels = power_kernels(ti.f32)
    base = float(np.float32(1 + 1 / trips))
    c[None], n[None] = base, trips
    start = np.array([0.5, -2.0, 3.0], np.float32)
    x.from_numpy(start)
    kernel = kernels[how]
    arguments = (trips,) if how == "argument" else ()
    y.grad.fill(1.0)
    kernel.grad(*arguments)
    np.testing.assert_allclose(x.grad.to_numpy(), base**trips, rtol=3e-6 * trips**0.5)
    slope = trips * base ** (trips - 1) * start.sum()
    assert c.grad[None] == pytest.approx(slope, rel=3e-6 * trips**0.5)


@pytest.mark.parametrize("first, last", [(3, 3), (5, 2), (-4, 3), (-7, -2), (0, -10)])
def test_empty_and_negative_ranges(first, last):
    x = ti.field(ti.f64, shape=2, needs_grad=True)
    y = ti.field(ti.f64, shape=2, needs_grad=True)

    @ti.kernel
    def kernel(begin: ti.i32, end: ti.i32):
        for i in x:
            value = x[i]
            for j in range(begin, end):
                value = value * value * 0.5 + 0.01 * j
            y[i] = value

    start = np.array([0.7, -1.2])
    x.from_numpy(start)
    value, slope = start.copy(), np.ones(2)
    for j in range(first, last):
        value, slope = value * value * 0.5 + 0.01 * j, slope * value
    kernel(first, last)
    np.testing.assert_allclose(y.to_numpy(), value, rtol=1e-14)
    y.grad.fill(1.0)
    kernel.grad(first, last)
    np.testing.assert_allclose(x.grad.to_numpy(), slope, rtol=1e-14)


# Everything else: one function for each, which adds to `loss` from `x` (numbers in 0.2 .. 0.9),
# `v` (vectors), `m` (matrices), and `n` (whole numbers 0 .. 4)


class Case:
    def __init__(self, dtype):
        self.x = ti.field(dtype, shape=N, needs_grad=True, name="x")
        self.v = ti.Vector.field(3, dtype, shape=N, needs_grad=True, name="v")
        self.m = ti.Matrix.field(2, 2, dtype, shape=N, needs_grad=True, name="m")
        self.n = ti.field(ti.i32, shape=N, name="n")
        self.table = ti.field(ti.i32, shape=16, name="table")
        self.loss = ti.field(dtype, shape=(), needs_grad=True, name="loss")
        generator = np.random.default_rng(7)
        self.start = [
            generator.uniform(0.2, 0.9, N),
            generator.uniform(-1, 1, (N, 3)),
            generator.uniform(-0.7, 0.7, (N, 2, 2)),
        ]
        for field, array in zip(self.inputs, self.start, strict=True):
            field.from_numpy(array.astype(dtype.numpy))
        self.n.from_numpy(np.array([0, 1, 2, 3, 4], np.int32))
        self.table.from_numpy(generator.integers(0, N, 16).astype(np.int32))

    @property
    def inputs(self):
        return [self.x, self.v, self.m]


def case_scalar(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            for _ in range(6):
                value = ti.sin(value) + c.x[i] * value
            c.loss[None] += value

    return kernel


def case_vector(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            u = c.v[i]
            for j in range(c.n[i] + 2):
                u = u.cross(c.v[j % N]) + ti.sin(u) * c.x[i]
            c.loss[None] += u.dot(u)

    return kernel


def case_matrix(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            a = c.m[i]
            for j in range(c.n[i] + 2):
                a = a @ c.m[j % N] + a * c.x[i]
            c.loss[None] += (a @ a).trace()

    return kernel


def case_components(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            u, a = c.v[i], c.m[i]
            for j in range(4):
                u[j % 3] = u[0] * u[1] + ti.cos(u[2])
                a[j % 2, 1] *= u[0] + a[0, 0]
            c.loss[None] += u.sum() + a.determinant()

    return kernel


def case_several(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            position, velocity, energy, steps = c.x[i], 0.1, 0.0, 0
            u = c.v[i]
            for _ in range(c.n[i] * 2 + 1):
                force = -ti.sin(position) * u.norm()
                velocity += 0.1 * force
                position += 0.1 * velocity
                u = u * 0.9 + position
                energy += velocity * velocity
                steps += 2
            c.loss[None] += position * velocity + energy * steps + u[1]

    return kernel


def case_integers_that_steer(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            at, sign, seed, value = i, 1, 12345, c.x[i]
            for _ in range(7):
                seed = (seed * 1103515245 + 12345) & 0x7FFFFFFF
                at = c.table[(at * 3 + seed // 65536) % 16]
                sign = -sign
                if sign > 0:
                    value = value * c.x[at] + 0.3
                else:
                    value = value + value * value * at
            c.loss[None] += value

    return kernel


def case_swap(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            a, b = c.x[i], c.x[(i + 1) % N]
            for _ in range(5):
                a, b = b, a * b + 0.1
            c.loss[None] += a * b

    return kernel


def case_before_between_after(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            before = ti.exp(c.x[i])
            value = before * before
            for _ in range(c.n[i]):
                value = ti.sin(value * before)
            between = value * value
            other = between
            for j in range(3):
                other = other * c.x[j] + ti.cos(between)
            after = other * value
            c.loss[None] += after * before

    return kernel


def case_value_before_inner_loop(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            total = 0.0
            for j in range(3):
                square = c.x[i] * c.x[j]
                part = square
                for k in range(c.n[j]):
                    part += square * square * c.x[k]
                total += part * square
            c.loss[None] += total

    return kernel


def case_nested(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value, count = c.x[i], 0
            for j in range(3):
                scale = ti.sin(value)
                for k in range(c.n[j] + 1):
                    value = value * c.x[k] + scale
                    for p in range(j + k):
                        value = ti.cos(value) * c.x[p % N] + scale
                        count += p
                    scale *= value
                value += 0.1 * scale * count
            c.loss[None] += value

    return kernel


def case_while(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            if i > 0:
                while value < 3.0 and value > -1.0:
                    value = value * 1.5 + c.x[0] * 0.1
            else:
                value = value * value
            c.loss[None] += value * c.x[i]

    return kernel


def case_newton(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            guess = 1.0
            steps = 0
            while ti.abs(guess * guess - c.x[i]) > 1e-3:
                guess = 0.5 * (guess + c.x[i] / guess)
                steps += 1
            c.loss[None] += guess * steps

    return kernel


def case_break(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            for j in range(20):
                value = value * 1.3 + c.x[j % N] * 0.1
                if value > 2.0:
                    break
                value = value * 1.1
            c.loss[None] += value * value

    return kernel


def case_continue(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            for j in range(8):
                if (i + j) % 3 == 0:
                    continue
                value = ti.sin(value) * c.x[j % N] + value
                if value < 0.5:
                    continue
                value *= 0.8
            c.loss[None] += value

    return kernel


def case_break_of_nested(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            for j in range(4):
                for k in range(5):
                    if k > c.n[j]:
                        break
                    if k == j:
                        continue
                    value = value * c.x[k] + 0.2
                if value > 10.0:
                    break
                value = value * value + 0.5
            c.loss[None] += value

    return kernel


def case_loop_in_branch(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            if i % 2 == 0:
                for _ in range(c.n[i] + 1):
                    value = value * value + c.x[0]
            else:
                value = ti.exp(value)
                for j in range(3):
                    value -= ti.log(value + 2.0) * c.x[j]
            c.loss[None] += value

    return kernel


def case_branch_in_loop(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            for j in range(6):
                if value > 0.6:
                    value = value * c.x[j % N]
                else:
                    for _ in range(c.n[i]):
                        value = ti.sqrt(value + 0.3)
            c.loss[None] += value

    return kernel


@ti.func
def horner(a, x, terms):
    value = a
    for j in range(terms):
        value = value * x + a * (j + 1)
    return value


@ti.func
def early(x, limit):
    value = x
    for _ in range(10):
        value *= 1.4
        if value > limit:
            break
    return value


def case_functions(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = horner(c.x[i], c.x[(i + 1) % N], c.n[i])
            for j in range(3):
                value = horner(value, c.x[j], j) + early(value, 2.5)
            c.loss[None] += value

    return kernel


def case_reads_inside(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = 0.0
            for j in range(i + 1):
                value = value * c.x[j] + c.v[j].norm() * (c.m[j] @ c.m[i]).trace()
            c.loss[None] += value

    return kernel


def case_step_and_backwards(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            for j in range(10, -1, -3):
                value = value * c.x[j % N] + 0.1 * j
            for j in range(1, 9, 4):
                value = ti.sin(value) + c.x[j % N]
            for j, k in ti.ndrange(2, (1, 3)):
                value = value * c.x[k] + j * value * value * 0.1
            c.loss[None] += value

    return kernel


def case_static(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value, u = c.x[i], c.v[i]
            for j in ti.static(range(3)):
                for _ in range(j + 1):
                    value = value * u[j] + 0.3
                u[j] = value
            c.loss[None] += u.dot(u)

    return kernel


def case_loop_at_the_top(c):
    @ti.kernel
    def kernel():
        value = c.x[0]
        ti.loop_config(serialize=True)
        for i in range(N):
            value = value * c.x[i] + 0.5
        c.loss[None] += value * value

    return kernel


def case_atomic_inside(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value = c.x[i]
            for j in range(4):
                value = value * c.x[j] + 0.5
                c.loss[None] += value * value * 0.1

    return kernel


def case_condition_carries(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value, going = c.x[i], True
            count = 0
            while going:
                value = value * 1.2 + 0.1
                count += 1
                going = value < 1.5 and count < 9
                if going:
                    for _ in range(count):
                        value = value + 0.01 * value * value
            c.loss[None] += value

    return kernel


def case_affine_integers(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value, at, twice, down = c.x[i], i, 1, 40
            for _ in range(6):
                value = value * c.x[at % N] + 0.1 * twice - 0.01 * down
                at += 3
                twice *= 2
                down -= at
            c.loss[None] += value

    return kernel


def case_invertible_integers(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            a, b, seed, bits, flips = 1, i, 7, 85, 1.0
            value = c.x[i]
            for j in range(c.n[i] + 9):
                value = ti.sin(value * (a % 5) + flips * 0.1 * (seed % 8)) + c.x[bits % N]
                a, b = b, (a + b) % 1024 + j
                seed = seed * 5 + j * j
                bits = (bits ^ (j * 3)) + 1
                flips = -flips
            c.loss[None] += value * flips

    return kernel


def case_two_step_recurrence(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            older, old = c.x[i], c.x[(i + 1) % N]
            for j in range(c.n[i] + 7):
                new = 1.5 * old - 0.7 * older * old + 0.1 * c.x[j % N]
                older, old = old, new
            c.loss[None] += old * older

    return kernel


def case_long_loops_inside(c):
    @ti.kernel
    def kernel():
        for i in c.x:
            value, u = c.x[i], c.v[i]
            for j in range(c.n[i] + 20):
                part = value
                for k in range(j % 7 + 11):
                    part = ti.sin(part + 0.1 * u[k % 3]) + 0.05 * k
                    if part > 0.9:
                        u = u * 0.9 + part * part
                value = 0.5 * value + ti.cos(part)
                while value > 1.0:
                    value = value * 0.9 - 0.05 * u[1] * value
            c.loss[None] += value + u.dot(u)

    return kernel


CASES = {name[5:]: case for name, case in list(globals().items()) if name.startswith("case_")}


@pytest.mark.parametrize("name", CASES)
def test_against_differences(name):
    case = Case(ti.f64)
    kernel = CASES[name](case)

    def run():
        case.loss[None] = 0
        kernel()

    result = ti.ad.check(run, loss=case.loss, wrt=case.inputs)
    assert result, str(result)
    assert any(probe.reverse != 0 for field in result.fields for probe in field.probes)


@pytest.mark.parametrize("name", CASES)
def test_single_precision(name):
    gradients = []
    for dtype in (ti.f64, ti.f32):
        ti.init(default_fp=dtype, offline_cache=False)
        case = Case(dtype)
        kernel = CASES[name](case)
        with ti.ad.Tape(case.loss):
            kernel()
        gradients.append([field.grad.to_numpy() for field in case.inputs])
    for exact, single in zip(*gradients, strict=True):
        np.testing.assert_allclose(single, exact, rtol=1e-4, atol=1e-4 * np.abs(exact).max())


@pytest.mark.parametrize("name", CASES)
def test_running_parts_again_changes_no_bit(name):
    """Histories in chunks of a few iterations, against whole ones."""
    gradients = []
    for history in (1 << 20, 40, 0):
        ti.init(
            default_fp=ti.f64, deterministic=True, ad_history_bytes=history, offline_cache=False
        )
        case = Case(ti.f64)
        kernel = CASES[name](case)
        with ti.ad.Tape(case.loss):
            kernel()
        gradients.append([field.grad.to_numpy() for field in case.inputs])
    for parts in gradients[1:]:
        for whole, part in zip(gradients[0], parts, strict=True):
            np.testing.assert_array_equal(whole, part)


def peak_memory():
    """Greatest resident size of this process, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def test_a_million_trips_in_bounded_memory():
    """The whole record would take 64 loops x 1e6 iterations x 32 bytes = 2 GB."""
    trips, lanes = 1_000_000, 64
    x = ti.field(ti.f64, shape=lanes, needs_grad=True)
    y = ti.field(ti.f64, shape=lanes, needs_grad=True)
    c = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def kernel(n: ti.i32):
        for i in x:
            u = ti.Vector([x[i], 1.0, x[i], 2.0])
            for _ in range(n):
                u *= c[None]
            y[i] = u.dot(u)

    def run(n):
        c[None] = base = 1 + 1 / n
        x.from_numpy(np.linspace(0.5, 1.5, lanes))
        ti.ad.clear_all_gradients()
        y.grad.fill(1.0)
        kernel.grad(n)
        return base, x.to_numpy()

    run(100)
    before = peak_memory()
    base, start = run(trips)
    assert peak_memory() - before < 64 << 20
    np.testing.assert_allclose(x.grad.to_numpy(), 4 * start * base ** (2 * trips), rtol=1e-9)
    slope = 2 * trips * base ** (2 * trips - 1) * (2 * start**2 + 5).sum()
    assert c.grad[None] == pytest.approx(slope, rel=1e-9)


def test_stack_sizes_are_not_needed():
    ti.init(default_fp=ti.f64, ad_stack_size=16, default_ad_stack_size=4, offline_cache=False)
    (c, n, x, y), kernels = power_kernels(ti.f64)
    c[None], n[None] = 1.01, 300
    x.fill(1.0)
    y.grad.fill(1.0)
    kernels["field"].grad()
    np.testing.assert_allclose(x.grad.to_numpy(), 1.01**300, rtol=1e-12)
