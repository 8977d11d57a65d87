"""Gradients of atomic mul, min and max, and of the values that atomics return."""

import numpy as np
import pytest
import tai as ti

N = 12
TOLERANCE = {"f32": 1e-5, "f64": 1e-13}


@pytest.fixture(params=["f32", "f64"])
def dtype(request):
    return request.param


@pytest.fixture(params=[False, True], ids=["fast", "deterministic"])
def mode(request):
    ti.init(arch=ti.cpu, offline_cache=False, deterministic=request.param, cpu_max_num_threads=3)


def real(dtype, *shape, **options):
    return ti.field(getattr(ti, dtype), shape=shape, needs_grad=True, **options)


def close(actual, expected, dtype):
    np.testing.assert_allclose(
        actual, expected, rtol=TOLERANCE[dtype], atol=TOLERANCE[dtype] * np.abs(expected).max()
    )


class Combined:
    """y[g] = y[g] (kind)= f(x[i]) over the i of each group g, and loss = sum w y."""

    def __init__(self, kind, dtype, groups=3):
        x, y, w = real(dtype, N), real(dtype, groups), real(dtype, groups)
        loss = real(dtype)
        combine = {"mul": ti.atomic_mul, "min": ti.atomic_min, "max": ti.atomic_max}[kind]

        @ti.kernel
        def run():
            for i in x:
                combine(y[i % groups], x[i] * x[i] - 2)

        @ti.kernel
        def total():
            for g in y:
                loss[None] += w[g] * y[g]

        self.x, self.y, self.w, self.loss = x, y, w, loss
        self.run, self.total = run, total

    def differentiate(self, x, before, w):
        self.x.from_numpy(x)
        self.y.from_numpy(before)
        self.w.from_numpy(w)
        with ti.ad.Tape(self.loss):
            self.run()
            self.total()
        return self.y.to_numpy(), self.x.grad.to_numpy(), self.y.grad.to_numpy()


W = np.array([1.0, -2.0, 5.0])


@pytest.mark.parametrize("kind", ["min", "max"])
def test_extremes_over_iterations(mode, dtype, kind):
    sign = 1 if kind == "max" else -1
    x = np.array([0.5, 3, 1, 2, 1.5, -2, 0, -3, 2, 1.25, 2.5, 0.25])
    values = x * x - 2
    # Group 1: two equal winners for max. Group 2: what stood there wins. Group 0 for max: two
    # values that are equal, one winner.
    before = sign * np.array([-100.0, -100.0, 100.0])
    y, grad, rest = Combined(kind, dtype).differentiate(x, before, W)
    expected, expected_rest, expected_y = np.zeros(N), W.copy(), before.copy()
    for g in (0, 1):
        best = max(sign * values[g::3]) * sign
        wins = (values == best) & (np.arange(N) % 3 == g)
        expected += wins * W[g] / wins.sum() * 2 * x
        expected_rest[g], expected_y[g] = 0, best
    close(y, expected_y, dtype)
    close(grad, expected, dtype)
    close(rest, expected_rest, dtype)


@pytest.mark.parametrize("kind", ["min", "max"])
def test_ties(mode, dtype, kind):
    # Four contributions are equal in each group, and equal to what stood there in group 0:
    # that loses, and they share.
    x = np.array([1.5, -1.5] * (N // 2))
    far = -50.0 if kind == "max" else 50.0
    _, grad, rest = Combined(kind, dtype).differentiate(x, np.array([0.25, far, -far]), W)
    share = np.array([W[0] / 4, W[1] / 4, 0])
    close(grad, share[np.arange(N) % 3] * 2 * x, dtype)
    close(rest, np.array([0, 0, W[2]]), dtype)


@pytest.mark.parametrize("zeros", [(), (4,), (4, 7), (4, 5), (4, 7, 5)])
@pytest.mark.parametrize("zero_before", [False, True])
def test_products_over_iterations(mode, dtype, zeros, zero_before):
    rng = np.random.default_rng(3)
    x = rng.uniform(0.5, 1.2, N)
    x[::4] *= -1
    factors_x = x.copy()
    before = np.array([1.5, -0.5, 0.0 if zero_before else 2.0])

    fields = Combined("mul", dtype)
    x2, y, w, loss = fields.x, fields.y, fields.w, fields.loss

    @ti.kernel
    def run():
        for i in x2:
            ti.atomic_mul(y[i % 3], x2[i])

    factors_x[list(zeros)] = 0
    x2.from_numpy(factors_x)
    y.from_numpy(before)
    w.from_numpy(W)
    with ti.ad.Tape(loss):
        run()
        fields.total()
    y0, grad, rest = y.to_numpy(), x2.grad.to_numpy(), y.grad.to_numpy()

    factors_x = factors_x.astype(dtype.replace("f", "float")).astype(float)
    group = np.arange(N) % 3
    expected = [
        W[group[i]]
        * before[group[i]]
        * np.prod(factors_x[(group == group[i]) & (np.arange(N) != i)])
        for i in range(N)
    ]
    close(y0, [before[g] * np.prod(factors_x[group == g]) for g in range(3)], dtype)
    close(grad, np.array(expected), dtype)
    close(rest, np.array([W[g] * np.prod(factors_x[group == g]) for g in range(3)]), dtype)


def test_a_zero_adjoint_of_an_infinite_product():
    x, y, loss = real("f64", 4), real("f64"), real("f64")

    @ti.kernel
    def run():
        for i in x:
            ti.atomic_mul(y[None], x[i])

    @ti.kernel
    def total():
        loss[None] += 0.0 * y[None]

    x.fill(1e100)
    y[None] = 1.0
    with ti.ad.Tape(loss):
        run()
        total()
    assert x.grad.to_numpy().tolist() == [0] * 4


def test_factors_of_a_denormal_number():
    """The derivative by what stood there before is the product of all factors, to the last bit."""
    x, y, loss = real("f64", 3), real("f64"), real("f64")

    @ti.kernel
    def run():
        for i in x:
            ti.atomic_mul(y[None], x[i])

    @ti.kernel
    def total():
        loss[None] += y[None]

    for before in (5e-324, 1e-310, 0.0, 1.0):
        x.from_numpy(np.array([1.8, 1.7, 1.6]))
        y[None] = before
        with ti.ad.Tape(loss):
            run()
            total()
        assert y.grad[None] == pytest.approx(1.8 * 1.7 * 1.6, rel=1e-15)
        expected = before * np.array([1.7 * 1.6, 1.8 * 1.6, 1.8 * 1.7])
        np.testing.assert_allclose(x.grad.to_numpy(), expected, rtol=1e-14, atol=1e-323)


def test_one_element_for_all(mode, dtype):
    x, y, loss = real(dtype, N), real(dtype), real(dtype)

    @ti.kernel
    def run():
        for i in x:
            ti.atomic_max(y[None], ti.sin(x[i]))

    @ti.kernel
    def total():
        loss[None] += 3 * y[None]

    values = np.linspace(0.3, 2.9, N)
    x.from_numpy(values)
    y[None] = -5
    with ti.ad.Tape(loss):
        run()
        total()
    best = np.argmax(np.sin(values))
    expected = np.zeros(N)
    expected[best] = 3 * np.cos(values[best])
    close(x.grad.to_numpy(), expected, dtype)


def test_under_a_condition_and_in_a_loop(mode, dtype):
    x, y, loss = real(dtype, N), real(dtype), real(dtype)

    @ti.kernel
    def run():
        for i in x:
            if i % 2 == 1:
                for j in range(1, 4):
                    ti.atomic_mul(y[None], x[i] + j)

    @ti.kernel
    def total():
        loss[None] += y[None]

    values = np.linspace(-1.1, 0.9, N)
    x.from_numpy(values)
    y[None] = 0.25
    with ti.ad.Tape(loss):
        run()
        total()
    odd = np.arange(N) % 2 == 1
    product = 0.25 * np.prod([np.prod(values[odd] + j) for j in (1, 2, 3)])
    slope = sum(1 / (values + j) for j in (1, 2, 3))
    close(loss[None], product, dtype)
    close(x.grad.to_numpy(), np.where(odd, product * slope, 0), dtype)


def test_vectors(mode, dtype):
    x, loss = real(dtype, N), real(dtype)
    v = ti.Vector.field(2, getattr(ti, dtype), shape=2, needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            ti.atomic_min(v[i % 2], ti.Vector([x[i], -x[i] * x[i]]))

    @ti.kernel
    def total():
        for g in v:
            loss[None] += v[g][0] + 10 * v[g][1]

    values = np.array([3, 1, -2, 5, 4, 2, 1, -3, 0.5, 7, 2, -6.0])
    x.from_numpy(values)
    v.fill(100)
    with ti.ad.Tape(loss):
        run()
        total()
    expected = np.zeros(N)
    for g in (0, 1):
        own = np.where(np.arange(N) % 2 == g, values, np.nan)
        expected[np.nanargmin(own)] += 1
        greatest = np.nanargmax(own**2)
        expected[greatest] -= 20 * values[greatest]
    close(x.grad.to_numpy(), expected, dtype)


def test_components_that_are_updated_in_different_ways(mode, dtype):
    x, loss = real(dtype, N), real(dtype)
    v = ti.Vector.field(2, getattr(ti, dtype), shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            ti.atomic_max(v[None][0], x[i])
            v[None][1] += x[i] * x[i]

    @ti.kernel
    def total():
        loss[None] += 2 * v[None][0] + 3 * v[None][1]

    values = np.array([3, 1, -2, 5, 4, 2, 1, -3, 0.5, 7, 2, -6.0])
    x.from_numpy(values)
    v.fill(-100)
    with ti.ad.Tape(loss):
        run()
        total()
    close(v.to_numpy(), np.array([7, np.sum(values**2) - 100]), dtype)
    close(x.grad.to_numpy(), 6 * values + 2 * (values == 7), dtype)


def test_elements_of_their_own(mode, dtype):
    x, y, loss = real(dtype, N), real(dtype, N), real(dtype)

    @ti.kernel
    def scale():
        for i in x:
            y[i] *= x[i]

    @ti.kernel
    def cut():
        for i in x:
            ti.atomic_max(y[i], 0.5 * x[i])
            ti.atomic_min(y[i], 4.0)

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * (i + 1)

    values, before = np.linspace(-2, 3, N), np.linspace(3, -1, N)
    x.from_numpy(values)
    y.from_numpy(before)
    with ti.ad.Tape(loss):
        scale()
        cut()
        total()
    product = values * before
    upper = np.maximum(product, values / 2)
    by_x = np.where(upper >= 4, 0, np.where(product > values / 2, before, 0.5))
    by_y = np.where((upper < 4) & (product > values / 2), values, 0)
    weights = np.arange(1.0, N + 1)
    close(x.grad.to_numpy(), by_x * weights, dtype)
    close(y.grad.to_numpy(), by_y * weights, dtype)


def test_returned_values_of_ones_own_element(mode, dtype):
    x, y, z, loss = real(dtype, N), real(dtype, N), real(dtype, N), real(dtype)

    @ti.kernel
    def run():
        for i in x:
            old = ti.atomic_add(y[i], x[i])
            z[i] = old * x[i]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] + 2 * z[i]

    values, before = np.linspace(-2, 3, N), np.linspace(3, -1, N)
    x.from_numpy(values)
    y.from_numpy(before)
    with ti.ad.Tape(loss):
        run()
        total()
    close(x.grad.to_numpy(), 1 + 2 * before, dtype)
    close(y.grad.to_numpy(), 1 + 2 * values, dtype)


def test_in_one_kernel_with_what_comes_before_and_after(dtype):
    x, y, loss = real(dtype, N), real(dtype), real(dtype)

    @ti.kernel
    def run():
        y[None] = -100.0
        for i in x:
            ti.atomic_max(y[None], x[i])
        loss[None] += y[None] * y[None]

    values = np.array([1, 2, -1, 4, 0, 4, 3, 1, 2, 0, 1, 2.0])
    x.from_numpy(values)
    with ti.ad.Tape(loss):
        run()
    assert loss[None] == 16
    close(x.grad.to_numpy(), np.where(values == 4, 4.0, 0), dtype)


def test_a_slot_from_a_counter_is_refused():
    x, y, loss = real("f32", N), real("f32", N), real("f32")
    n = ti.field(ti.i32, shape=())

    @ti.kernel
    def compact():
        for i in x:
            if x[i] > 0:
                k = ti.atomic_add(n[None], 1)
                y[k] = 2 * x[i]

    x.fill(1)
    with pytest.raises(ti.TaiAutodiffError) as caught, ti.ad.Tape(loss):
        compact()
        loss[None]  # the adjoint is asked for in the sweep
        compact.grad()
    assert "atomic_add" in str(caught.value)
    assert "slot" in str(caught.value)


def test_slots_kept_in_a_field():
    x, y, loss = real("f64", N), real("f64", N), real("f64")
    n, slot = ti.field(ti.i32, shape=()), ti.field(ti.i32, shape=N)

    @ti.kernel
    def count():
        for i in x:
            if x[i] > 0:
                slot[i] = ti.atomic_add(n[None], 1)

    @ti.kernel
    def compact():
        for i in x:
            if x[i] > 0:
                y[slot[i]] = 2 * x[i]

    @ti.kernel
    def total():
        for k in range(n[None]):
            loss[None] += y[k] ** 2

    values = np.where(np.arange(N) % 3 == 0, -1.0, np.arange(N))
    x.from_numpy(values)
    with ti.ad.Tape(loss):
        count()
        compact()
        total()
    np.testing.assert_array_equal(x.grad.to_numpy(), np.where(values > 0, 8 * values, 0))


def test_the_old_value_of_a_sum_of_iterations_is_refused():
    x, y, loss = real("f32", N), real("f32"), real("f32")

    @ti.kernel
    def run():
        for i in x:
            loss[None] += ti.atomic_add(y[None], x[i])

    with pytest.raises(ti.TaiAutodiffError, match="the value before the accumulation is used"):
        with ti.ad.Tape(loss):
            run()


def test_a_product_of_all_iterations_is_an_atomic():
    # `*=` loads, multiplies and stores: of one element by all iterations, that is a reduction.
    x, loss = real("f64", N), real("f64")
    factors = np.linspace(0.5, 1.5, N)
    x.from_numpy(factors)

    @ti.kernel
    def run():
        for i in x:
            loss[None] *= x[i]

    with ti.ad.Tape(loss):
        loss[None] = 2.0
        run()
    close(x.grad.to_numpy(), 2 * factors.prod() / factors, "f64")


@pytest.mark.parametrize("kind", ["max", "min", "mul"])
def test_a_value_written_beside_an_element_that_is_needed_as_it_was(kind):
    """One field cannot be both as before and as the kernel left it: no gradient is a guess."""
    ti.init(arch=ti.cpu)
    x, y = (ti.field(ti.f64, shape=5, needs_grad=True) for _ in range(2))
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    update = getattr(ti, f"atomic_{kind}")

    @ti.kernel
    def step():
        for _ in range(1):
            y[0] += 0.5
            loss[None] += ti.sin(y[0])
            update(y[3], x[1])

    with (
        pytest.raises(ti.TaiAutodiffError, match="needs what stood there before the kernel"),
        ti.ad.Tape(loss),
    ):
        step()
