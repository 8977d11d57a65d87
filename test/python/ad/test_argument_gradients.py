"""Gradients by numbers that kernels take and return, against closed forms."""

import math

import numpy as np
import pytest
import tai as ti

N = 1000


@pytest.fixture(autouse=True, params=["f32", "f64"])
def precision(request):
    ti.init(default_fp=getattr(ti, request.param), offline_cache=False)
    return {"f32": 1e-5, "f64": 1e-13}[request.param]


def scalar_loss():
    return ti.field(float, shape=(), needs_grad=True, name="loss")


@ti.kernel
def product(a: float, b: float) -> float:
    return a * a * b


def close(actual, expected, precision):
    np.testing.assert_allclose(np.asarray(actual), expected, rtol=10 * precision, atol=precision)


# Arguments


def test_numbers_as_arguments(precision):
    loss = scalar_loss()

    @ti.kernel
    def kernel(a: float, n: ti.i32, b: float):
        loss[None] += ti.sin(a) * n + a * b

    a, b = ti.ad.variable(0.3), ti.ad.variable(2)
    with ti.ad.Tape(loss):
        kernel(a, 3, b)
        kernel(a, 1, 5.0)
    close(a.grad, 4 * math.cos(0.3) + 2 + 5, precision)
    close(b.grad, 0.3, precision)
    assert isinstance(a, float) and a == 0.3


def test_a_reduction_over_many_iterations(precision):
    x = ti.field(float, shape=N, needs_grad=True)
    loss = scalar_loss()
    values = np.random.default_rng(1).uniform(0.5, 1.5, N)
    x.from_numpy(values.astype(x.dtype.numpy))

    @ti.kernel
    def kernel(a: float, v: ti.types.vector(3, float), m: ti.types.matrix(2, 2, float)):
        for i in x:
            s = ti.sin(a * x[i]) + v[i % 3] * x[i]
            if i % 2 == 0:
                s += (m @ ti.Vector([x[i], 1.0])).sum()
            loss[None] += s

    a = ti.ad.variable(0.7)
    v = ti.ad.variable(ti.Vector([1.0, 2.0, 3.0]))
    m = ti.ad.variable([[1.0, 2.0], [3.0, 4.0]])
    with ti.ad.Tape(loss):
        kernel(a, v, m)
    close(a.grad, (values * np.cos(0.7 * values)).sum(), 100 * precision)
    close(v.grad, [values[k::3].sum() for k in range(3)], 100 * precision)
    even = values[::2].sum()
    close(m.grad.to_numpy(), [[even, N / 2]] * 2, 100 * precision)
    # The sums are in registers: no iteration waits for another.
    adjoint = kernel.mlir(stage="adjoint.scf")
    assert "tai_rt_parallel_for" in adjoint and "atomicrmw" not in adjoint


def test_sums_have_the_same_bits_in_deterministic_mode():
    ti.init(default_fp=ti.f32, deterministic=True, offline_cache=False)
    x = ti.field(ti.f32, shape=50000, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    x.from_numpy(np.random.default_rng(2).normal(size=50000).astype(np.float32))

    @ti.kernel
    def kernel(a: ti.f32):
        for i in x:
            loss[None] += ti.exp(a * x[i])

    def run():
        a = ti.ad.variable(0.5)
        with ti.ad.Tape(loss):
            kernel(a)
        return a.grad

    first = run()
    assert all(run() == first for _ in range(5))
    values = x.to_numpy().astype(np.float64)
    assert math.isclose(first, (values * np.exp(0.5 * values)).sum(), rel_tol=1e-4)


def test_gradients_add_up_and_are_cleared():
    loss = scalar_loss()

    @ti.kernel
    def kernel(a: float):
        loss[None] += 3 * a

    a = ti.ad.variable(1.0)
    for clear, expected in ((True, 3), (False, 6), (True, 3)):
        with ti.ad.Tape(loss, clear_gradients=clear) as tape:
            kernel(a)
        assert a.grad == expected
    tape.grad()
    assert a.grad == 3
    tape.replay()
    assert a.grad == 3
    ti.ad.clear_all_gradients()
    assert a.grad == 0


def test_a_plain_number_is_constant():
    loss = scalar_loss()

    @ti.kernel
    def kernel(a: float, b: float):
        loss[None] += a * b

    a = ti.ad.variable(2.0)
    with ti.ad.Tape(loss):
        kernel(float(a), 3.0)
        kernel(3.0, a)
    assert a.grad == 3


def test_both_types_of_one_variable():
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def kernel(a: ti.f32, b: ti.f64):
        loss[None] += 2 * a + 5 * b

    a = ti.ad.variable(1.0)
    with ti.ad.Tape(loss):
        kernel(a, a)
    assert a.grad == 7


def test_arithmetic_in_python(precision):
    loss = scalar_loss()

    @ti.kernel
    def kernel(a: float):
        loss[None] += a * a

    a, b = ti.ad.variable(2.0), ti.ad.variable(0.5)
    with ti.ad.Tape(loss):
        kernel(3 * a - b / a + a**2 - (-b) + abs(b) * np.float64(2))
    value = 6 - 0.25 + 4 + 0.5 + 1
    close(a.grad, 2 * value * (3 + 0.5 / 4 + 4), precision)
    close(b.grad, 2 * value * (-0.5 + 1 + 2), precision)
    # Outside of a tape, it is a float like any other.
    assert type(a - 0.1 * a.grad) is float


def test_gradient_descent():
    loss = scalar_loss()

    @ti.kernel
    def kernel(a: float, v: ti.types.vector(2, float)):
        loss[None] += (a - 3) ** 2 + (v - ti.Vector([1.0, 2.0])).norm_sqr()

    a, v = ti.ad.variable(0.0), ti.ad.variable(ti.Vector([0.0, 0.0]))
    for _ in range(60):
        with ti.ad.Tape(loss):
            kernel(a, v)
        a = ti.ad.variable(a - 0.2 * a.grad)
        v = ti.ad.variable(v - 0.2 * v.grad)
    assert abs(a - 3) < 1e-4
    assert np.abs(v.to_numpy() - [1, 2]).max() < 1e-4


def test_kernel_grad_by_hand():
    x = ti.field(float, shape=3, needs_grad=True)

    @ti.kernel
    def kernel(a: float):
        for i in x:
            x[i] = a * (i + 1)

    a = ti.ad.variable(2.0)
    x.grad.from_numpy(np.array([1, 10, 100], x.dtype.numpy))
    kernel.grad(a)
    assert a.grad == 1 + 20 + 300


# Results


def test_a_returned_value_is_a_loss(precision):
    a, b = ti.ad.variable(3.0), ti.ad.variable(5.0)
    with ti.ad.Tape() as tape:
        result = product(a, b)
    assert isinstance(result, float) and result == 45
    tape.backward(result)
    close([a.grad, b.grad], [30, 9], precision)


def test_several_losses_with_seeds(precision):
    a = ti.ad.variable(3.0)
    with ti.ad.Tape() as tape:
        first = product(a, 1.0)
        second = product(1.0, a)
        unused = product(a, a)
    assert unused == 27
    tape.backward(first, (second, 0.5))
    close(a.grad, 6 + 0.5, precision)
    ti.ad.clear_all_gradients()
    tape.backward(2 * first - second * first)
    close(a.grad, 2 * 6 - (9 + 3 * 6), precision)


def test_a_returned_value_goes_on_as_an_argument(precision):
    a = ti.ad.variable(2.0)
    with ti.ad.Tape() as tape:
        y = product(a, 3.0)  # 3 a²
        z = product(y, a)  # 9 a⁵
        w = product(z + y, 1.0)  # (9 a⁵ + 3 a²)²
    tape.backward(w)
    inner = 9 * 2.0**5 + 3 * 4
    close(a.grad, 2 * inner * (45 * 16 + 12), precision)


def test_returned_sum_over_a_field(precision):
    x = ti.field(float, shape=N, needs_grad=True)
    values = np.random.default_rng(4).uniform(0.5, 1.5, N)
    x.from_numpy(values.astype(x.dtype.numpy))

    @ti.kernel
    def norm() -> float:
        s = 0.0
        for i in x:
            s += x[i] ** 2
        return ti.sqrt(s)

    for _ in range(2):
        with ti.ad.Tape() as tape:
            first = norm()
            second = norm()
        tape.backward(first, (second, 2.0))
        close(x.grad.to_numpy(), 3 * values / np.linalg.norm(values), 100 * precision)


def test_vectors_and_matrices_returned(precision):
    @ti.kernel
    def rotate(angle: float, v: ti.types.vector(2, float)) -> ti.types.vector(2, float):
        c, s = ti.cos(angle), ti.sin(angle)
        return ti.Vector([c * v[0] - s * v[1], s * v[0] + c * v[1]])

    @ti.kernel
    def outer(v: ti.types.vector(2, float)) -> ti.types.matrix(2, 2, float):
        return v.outer_product(v)

    angle, v = ti.ad.variable(0.4), ti.ad.variable([1.0, 2.0])
    with ti.ad.Tape() as tape:
        w = rotate(angle, v)
        m = outer(w)
    c, s = math.cos(0.4), math.sin(0.4)
    rotation = np.array([[c, -s], [s, c]])
    vs = np.array([1.0, 2.0])
    ws = rotation @ vs
    np.testing.assert_allclose(m.to_numpy(), np.outer(ws, ws), rtol=10 * precision)
    seed = np.array([[1.0, 2.0], [-1.0, 3.0]])
    tape.backward((m, seed), (w, [0.5, -0.5]))
    dw = (seed + seed.T) @ ws + [0.5, -0.5]
    close(v.grad.to_numpy(), rotation.T @ dw, precision)
    close(angle.grad, dw @ (np.array([[-s, -c], [c, -s]]) @ vs), precision)
    ti.ad.clear_all_gradients()
    tape.backward(w[0] * w.y)
    close(v.grad.to_numpy(), rotation.T @ ws[::-1], precision)


def test_a_field_loss_and_a_returned_one(precision):
    loss = scalar_loss()

    @ti.kernel
    def kernel(a: float) -> float:
        loss[None] += 3 * a
        return a * a

    a = ti.ad.variable(4.0)
    with ti.ad.Tape(loss) as tape:
        result = kernel(a)
    assert a.grad == 3
    tape.backward(result)
    close(a.grad, 8, precision)
    tape.backward(result, {loss: 2.0})
    close(a.grad, 8 + 6, precision)


def test_a_kernel_that_returns_early(precision):
    @ti.kernel
    def power(a: float, k: ti.i32) -> float:
        p = 1.0
        ti.loop_config(serialize=True)
        for i in range(100):
            if i == k:
                return p
            p *= a
        return 0.0

    a = ti.ad.variable(1.5)
    with ti.ad.Tape() as tape:
        result = power(a, 6)
    tape.backward(result)
    close(result, 1.5**6, precision)
    close(a.grad, 6 * 1.5**5, precision)


def test_what_nothing_depends_on_costs_no_launch():
    a = ti.ad.variable(1.0)
    with ti.ad.Tape() as tape:
        product(a, 1.0)
        wanted = product(1.0, a)
    tape.backward(wanted)
    assert a.grad == 1
    tape.backward((wanted, 0.0))
    assert a.grad == 0


def test_what_a_tape_says_of_it():
    a = ti.ad.variable(1.0)
    with ti.ad.Tape() as tape:
        result = product(a, 1.0)
    tape.backward(result)
    assert (
        tape.explain() == "0: @product: replayed, from the adjoints of arrays or returned values\n"
    )
    assert tape.num_records == 1 and tape.num_skipped == 0


def test_whole_numbers_have_no_gradient():
    @ti.kernel
    def kernel(a: float) -> ti.i32:
        return ti.cast(a, ti.i32)

    with ti.ad.Tape() as tape:
        result = kernel(ti.ad.variable(3.5))
    assert type(result) is int
    with pytest.raises(ti.TaiRuntimeTypeError, match="begins with what a kernel returned"):
        tape.backward(result)


# What is refused


def test_seeds_that_do_not_fit():
    @ti.kernel
    def pair(a: float) -> ti.types.vector(2, float):
        return ti.Vector([a, 2 * a])

    a = ti.ad.variable(1.0)
    with ti.ad.Tape() as tape:
        v = pair(a)
    for losses, message in (
        ((v,), r"a loss of shape \(2,\) needs a seed"),
        (((v, [1.0, 2.0, 3.0]),), r"the seed has shape \(3,\), but the loss has shape \(2,\)"),
        ((1.0,), "begins with what a kernel returned"),
        ((a,), "begins with what a kernel returned"),
        ((), "the tape has no loss"),
    ):
        with pytest.raises(ti.TaiRuntimeTypeError, match=message):
            tape.backward(*losses)
    tape.backward((v, [1.0, 10.0]))  # the tape is as good as before
    assert a.grad == 21


def test_what_cannot_be_a_variable():
    for value in (True, "3", [], np.zeros((2, 2, 2)), None):
        with pytest.raises(ti.TaiRuntimeTypeError, match="a variable is a float"):
            ti.ad.variable(value)


def test_values_with_a_gradient_are_no_constants():
    a = ti.ad.variable(2.0)
    loss = scalar_loss()

    @ti.kernel
    def template(factor: ti.template()):
        loss[None] += factor

    @ti.kernel
    def captured():
        loss[None] += a

    with (
        pytest.raises(ti.TaiAutodiffError, match="'factor' of kernel 'template' is a constant"),
        ti.ad.Tape(loss),
    ):
        template(a)
    with pytest.raises(ti.TaiAutodiffError, match="a value with a gradient is a constant here"):
        captured()


def test_matrices_are_not_computed_with_in_python():
    v = ti.ad.variable([1.0, 2.0])
    assert (2 * v).to_list() == [2, 4]
    with ti.ad.Tape():
        for compute in (lambda: 2 * v, lambda: v.norm(), lambda: v @ v, lambda: -v):
            with pytest.raises(ti.TaiAutodiffError, match="not computed with in Python"):
                compute()
        assert v.to_numpy().tolist() == [1, 2]


def test_functions_of_numpy_have_gradients_under_a_tape():
    a = ti.ad.variable(2.0)
    assert np.sin(a) == math.sin(2.0)
    with ti.ad.Tape() as tape:
        energy = np.sin(product(a, 3.0))
        with pytest.raises(ti.TaiAutodiffError, match="knows no gradient"):
            np.interp(a, [0, 1], [0, 1])
    tape.backward(energy)
    assert a.grad == pytest.approx(12 * math.cos(12.0), rel=1e-6)
    assert np.asarray(a) == 2
    assert math.sin(a) == math.sin(2.0)


def test_a_tape_that_cannot_run_forward_again():
    a = ti.ad.variable(2.0)
    with ti.ad.Tape() as tape:
        product(product(a, 1.0), 1.0)
    with pytest.raises(ti.TaiRuntimeError, match="cannot run forward again"):
        tape.replay()


def test_a_tape_that_is_refused_leaves_the_outer_one_as_it_is():
    """Numbers that kernels return still carry their gradient to others."""
    x, loss = (ti.field(ti.f64, shape=(), needs_grad=True) for _ in range(2))
    x[None] = 3.0

    @ti.kernel
    def square() -> ti.f64:
        return x[None] ** 2

    @ti.kernel
    def add(a: ti.f64):
        loss[None] += a

    with ti.ad.Tape(loss):
        for _ in range(2):
            with pytest.raises(ti.TaiRuntimeError, match="do not nest"), ti.ad.Tape(loss):
                pass
        add(square())
    assert (loss[None], x.grad[None]) == (9.0, 6.0)
