"""Forward mode of whole programs: loops, branches, atomics, overwritten values, and its API."""

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiAutodiffError, TaiRuntimeError, TaiRuntimeTypeError

N = 7


@pytest.fixture(autouse=True)
def double_precision():
    ti.init(default_fp=ti.f64, offline_cache=False)


def dual(shape=(), dtype=ti.f64):
    return ti.field(dtype, shape=shape, needs_dual=True)


def forward(run, x, outputs):
    """The tangents of the outputs along a direction, and central differences of them."""
    start = x.to_numpy()
    direction = np.random.default_rng(1).standard_normal(start.shape)
    others = [(f, f.to_numpy()) for f in outputs if f is not x]

    def at(step):
        x.from_numpy(start + step * direction)
        for f, values in others:
            f.from_numpy(values)
        run()
        return [f.to_numpy() for f in outputs]

    h = 2e-4
    ahead, behind, near, rear = at(h), at(-h), at(h / 2), at(-h / 2)
    differences = [
        (4 * (c - d) / h - (a - b) / (2 * h)) / 3
        for a, b, c, d in zip(ahead, behind, near, rear, strict=True)
    ]
    x.from_numpy(start)
    for f, values in others:
        f.from_numpy(values)
    return ti.ad.jvp(run, x, direction, list(outputs)), differences


def check(run, x, *outputs):
    tangents, differences = forward(run, x, outputs)
    for tangent, difference in zip(tangents, differences, strict=True):
        np.testing.assert_allclose(tangent, difference, rtol=1e-7, atol=1e-8)
    assert any(np.any(tangent != 0) for tangent in tangents)


# Loops and branches


@pytest.mark.parametrize("trips", [0, 1, 100, 1000])
def test_carried_values(trips):
    x, y = dual(N), dual(N)

    @ti.kernel
    def kernel(n: int):
        for i in x:
            v = ti.Vector([x[i], 0.5])
            s = 0.0
            for k in range(n):
                v = ti.Vector([ti.sin(v.x + v.y), v.x * 0.5 - v.y * 0.1 * k / n])
                s += v.x * v.y
            y[i] = v.x + v.y + s

    x.from_numpy(np.linspace(0.1, 0.9, N))
    check(lambda: kernel(trips), x, y)


def test_nested_loops_with_statements_between():
    x, y, n = dual(N), dual(N), ti.field(ti.i32, shape=N)

    @ti.kernel
    def kernel():
        for i in x:
            a = x[i] * 2
            for j in range(n[i]):
                b = a * a * 0.1
                for _ in range(j):
                    b = ti.cos(b) + a * 0.1
                a += b * 0.3
            y[i] = a * a

    x.from_numpy(np.linspace(0.2, 0.6, N))
    n.from_numpy(np.arange(N, dtype=np.int32))
    check(kernel, x, y)


def test_while_break_continue():
    x, y = dual(N), dual(N)

    @ti.kernel
    def kernel():
        for i in x:
            v = x[i]
            k = 0
            while v < 10:
                k += 1
                if k % 3 == 0:
                    continue
                v = v * 1.7 + x[i]
                if k > 8:
                    break
            y[i] = v * v

    x.from_numpy(np.linspace(0.21, 3.2, N))
    check(kernel, x, y)


def test_branches():
    x, y = dual(N), dual(N)

    @ti.kernel
    def kernel():
        for i in x:
            r = 0.0
            if x[i] > 0.5:
                r = ti.log(x[i])
                if x[i] > 0.8:
                    r *= x[i]
            elif x[i] < 0:
                r = ti.sqrt(-x[i])
            else:
                r = x[i] ** 3
            y[i] = r

    x.from_numpy(np.linspace(-0.73, 1.12, N))
    check(kernel, x, y)


def test_a_branch_that_is_not_taken_leaves_no_trace():
    x, y = dual(2), dual(2)

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = 1.0
            if x[i] > 0:
                y[i] = ti.sqrt(x[i])

    x.from_numpy(np.array([-1.0, 4.0]))
    np.testing.assert_array_equal(ti.ad.jvp(kernel, x, [1.0, 1.0], y), [0.0, 0.25])


# Overwritten values and atomics


def test_overwritten_elements():
    x, y = dual(N), dual(N)

    @ti.kernel
    def kernel():
        for i in x:
            x[i] *= 2
            y[i] = x[i]
            x[i] += x[i] * x[i]
            y[i], x[i] = x[i], y[i]
        for _ in range(1):
            for i in range(1, N):
                x[i] = 0.5 * x[i] + ti.sin(x[i - 1])

    x.from_numpy(np.linspace(0.1, 0.7, N))
    check(kernel, x, x, y)


def test_a_stored_constant_has_no_tangent():
    x, y = dual(), dual()

    @ti.kernel
    def kernel():
        y[None] = 3 * x[None]
        y[None] = 5

    assert ti.ad.jvp(kernel, x, 1.0, y) == 0


def test_sums_are_atomic():
    x, total = dual(1000), dual()

    @ti.kernel
    def kernel():
        for i in x:
            total[None] += x[i] ** 2
            total[None] -= x[i]

    x.from_numpy(np.linspace(0, 1, 1000))

    def run():
        total[None] = 0
        kernel()

    direction = np.random.default_rng(0).standard_normal(1000)
    expected = ((2 * x.to_numpy() - 1) * direction).sum()
    assert ti.ad.jvp(run, x, direction, total) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("kind", ["mul", "max", "min"])
@pytest.mark.parametrize("shared", [False, True])
def test_atomics_that_are_no_sums(kind, shared):
    x, y = dual(20), dual(() if shared else 20)
    atomic = {"mul": ti.atomic_mul, "max": ti.atomic_max, "min": ti.atomic_min}[kind]

    @ti.kernel
    def kernel():
        for i in x:
            if ti.static(shared):
                atomic(y[None], x[i] * x[i])
            else:
                atomic(y[i], x[i] * x[i])

    x.from_numpy(np.random.default_rng(5).uniform(0.8, 1.2, 20))
    y.fill(1.0)
    check(kernel, x, y)


@pytest.mark.parametrize("threads", [1, 0])
def test_the_value_before_an_update(threads):
    ti.init(default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=threads)
    x, y, z = dual(50), dual(), dual(50)

    @ti.kernel
    def kernel():
        for i in x:
            z[i] = ti.atomic_add(y[None], x[i]) * x[i]

    x.from_numpy(np.linspace(0.5, 1, 50))
    direction = np.linspace(1, -1, 50)
    tangent = ti.ad.jvp(lambda: (y.fill(0), kernel()), x, direction, z)
    # In order, whatever the number of threads: its tangent could not follow otherwise.
    values = x.to_numpy()
    before = np.concatenate([[0], np.cumsum(values)[:-1]])
    d_before = np.concatenate([[0], np.cumsum(direction)[:-1]])
    np.testing.assert_allclose(tangent, d_before * values + before * direction, rtol=1e-12)


def test_locals_that_iterations_share():
    x, y = dual(N), dual()

    @ti.kernel
    def kernel():
        s = 1.0
        for i in x:
            s += x[i] ** 2
        y[None] = s * s

    x.from_numpy(np.linspace(0.1, 1, N))
    check(kernel, x, y)


def test_indirect_indices_and_components():
    v = ti.Vector.field(3, ti.f64, shape=N, needs_dual=True)
    y, p = dual((N, 2)), ti.field(ti.i32, shape=N)

    @ti.kernel
    def kernel():
        for i in v:
            for c in range(3):
                y[p[i], i % 2] += v[p[(i + 1) % N]][c] * v[i][(c + 1) % 3]

    v.from_numpy(np.random.default_rng(4).standard_normal((N, 3)))
    p.from_numpy(np.random.default_rng(4).permutation(N).astype(np.int32))

    def run():
        y.fill(0)
        kernel()

    check(run, v, y)


def test_random_numbers_are_constants():
    x, y = dual(N), dual(N)

    @ti.kernel
    def kernel():
        for i in x:
            y[i] = ti.random(ti.f64)
            y[i] = y[i] * x[i]

    x.fill(2.0)
    tangent = ti.ad.jvp(kernel, x, np.ones(N), y)
    np.testing.assert_array_equal(2 * tangent, y.to_numpy())
    assert len(set(tangent.tolist())) == N


def test_several_launches_with_arguments_and_results():
    x, v = dual(N), dual(N)

    @ti.kernel
    def step(dt: float, k: int) -> float:
        for i in x:
            v[i] += dt * (x[(i + k) % N] - x[i] ** 3)
            x[i] += dt * v[i]
        return x[0]

    x.from_numpy(np.linspace(-1, 1, N))

    def run():
        v.fill(0)
        for n in range(20):
            assert step(0.05, n) == x[0]

    check(run, x, x, v)


def test_a_tape_is_replayed_with_tangents():
    x = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)

    @ti.kernel
    def kernel(a: float):
        loss[None] += a * x[None] ** 2

    x[None] = 3
    with ti.ad.Tape(loss) as tape:
        kernel(1.0)
        kernel(10.0)
    assert ti.ad.jvp(tape, x, 2.0, loss) == 2 * x.grad[None] == 132
    assert loss[None] == 99


def test_functions_that_replace_their_gradient():
    x, loss = dual(), dual()

    @ti.kernel
    def kernel():
        loss[None] = x[None] ** 3

    @ti.ad.grad_replaced
    def complex_step():
        kernel()

    @ti.ad.grad_for(complex_step)
    def complex_step_grad():
        raise AssertionError("forward mode follows the function itself")

    x[None] = 2
    assert ti.ad.jvp(complex_step, x, 1.0, loss) == 12


# FwdMode


def make_pair():
    x, v, loss = dual(), dual(3), dual()

    @ti.kernel
    def kernel():
        for i in v:
            loss[None] += x[None] * v[i] ** 2

    x[None] = 2
    v.from_numpy(np.array([1.0, 2, 3]))
    return x, v, loss, kernel


def test_forward_mode_by_one_number():
    x, v, loss, kernel = make_pair()
    loss.dual[None] = 5
    with ti.ad.FwdMode(loss=loss, param=x):
        assert x.dual[None] == 1
        assert loss.dual[None] == 0
        kernel()
        assert loss.dual[None] == 14
    assert loss.dual[None] == 14
    assert x.dual[None] == 0
    kernel()  # no longer in forward mode
    assert loss.dual[None] == 14


def test_seeds():
    x, v, loss, kernel = make_pair()
    with ti.ad.FwdMode(loss=loss, param=v, seed=[1.0, 0.0, 2.0]):
        kernel()
    assert loss.dual[None] == 28
    with ti.ad.FwdMode(loss=[loss], param=x, seed=[2.0]):
        kernel()
    assert loss.dual[None] == 28
    grid = dual((2, 2))
    total = dual()

    @ti.kernel
    def weigh():
        for i, j in grid:
            total[None] += (1 + i + 2 * j) * grid[i, j]

    for seed in (np.array([[1.0, 0], [0, 1]]), [1, 0, 0, 1]):
        with ti.ad.FwdMode(loss=total, param=grid, seed=seed):
            weigh()
        assert total.dual[None] == 5


def test_tangents_are_kept_on_request():
    x, v, loss, kernel = make_pair()
    loss.dual[None] = 5
    with ti.ad.FwdMode(loss=loss, param=x, clear_gradients=False):
        kernel()
    assert loss.dual[None] == 19


def test_lazy_dual():
    x, v = ti.field(ti.f64), ti.Vector.field(2, ti.f64)
    ti.root.dense(ti.i, 3).place(x, v)
    ti.root.lazy_dual()

    @ti.kernel
    def kernel():
        for i in x:
            v[i] = ti.Vector([x[i], 2 * x[i]])

    with ti.ad.FwdMode(loss=v, param=x, seed=[1, 2, 3]):
        kernel()
    np.testing.assert_array_equal(v.dual.to_numpy(), [[1, 2], [2, 4], [3, 6]])


def test_what_forward_mode_refuses():
    x, v, loss, kernel = make_pair()
    plain = ti.field(ti.f64, shape=3, name="plain")
    whole = ti.field(ti.i32, shape=3)
    with pytest.raises(TaiAutodiffError, match="the parameter 'plain' has no dual"):
        ti.ad.FwdMode(loss=loss, param=plain)
    with pytest.raises(TaiAutodiffError, match="the loss 'plain' has no dual"):
        ti.ad.FwdMode(loss=plain, param=x)
    with pytest.raises(TaiAutodiffError, match="of type i32"):
        ti.ad.FwdMode(loss=loss, param=whole)
    with pytest.raises(TaiRuntimeTypeError, match="the parameter must be a field, but got nothing"):
        ti.ad.FwdMode(loss=loss, param=None)
    with pytest.raises(RuntimeError, match="the seed is not set"):
        ti.ad.FwdMode(loss=loss, param=v)
    for seed in ([1.0], [1.0] * 4, "abc", [[1.0, 2, 3]]):
        with pytest.raises(TaiRuntimeTypeError, match="the tangent of field"):
            ti.ad.FwdMode(loss=loss, param=v, seed=seed)
    with ti.ad.FwdMode(loss=loss, param=x):
        with pytest.raises(TaiRuntimeError, match="forward mode is on already"):
            ti.ad.FwdMode(loss=loss, param=x).__enter__()
        with pytest.raises(TaiRuntimeError, match="reset in forward mode"):
            ti.init()
        kernel()
    assert loss.dual[None] == 14
    with pytest.raises(TaiAutodiffError, match="field 'plain' has no dual"):
        plain.dual[0] = 1
    with pytest.raises(TaiRuntimeTypeError, match="2 fields need a list"):
        ti.ad.jvp(kernel, [x, v], 1.0, loss)


def test_an_error_ends_forward_mode():
    x, v, loss, kernel = make_pair()
    with pytest.raises(ZeroDivisionError), ti.ad.FwdMode(loss=loss, param=x):
        kernel()
        _ = 1 / 0
    assert x.dual[None] == 0
    kernel()
    assert loss.dual[None] == 14


def test_arrays_are_constants_and_take_no_tangent():
    x, loss = dual(3), dual()

    @ti.kernel
    def read(a: ti.types.ndarray()):
        for i in x:
            loss[None] += a[i] * x[i]

    @ti.kernel
    def write(a: ti.types.ndarray()):
        for i in x:
            a[i] = 2 * x[i]

    x.fill(1.0)
    array = np.array([1.0, 2, 3])
    assert ti.ad.jvp(lambda: read(array), x, [1, 1, 1], loss) == 6
    with pytest.raises(TaiAutodiffError, match="a tangent is lost in an array") as caught:
        ti.ad.jvp(lambda: write(array), x, [1, 1, 1], loss)
    assert "a[i] = 2 * x[i]" in str(caught.value)
    write(array)  # and the program goes on
    np.testing.assert_array_equal(array, [2, 2, 2])


def test_access_rules_are_not_checked_in_forward_mode():
    x = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True, needs_dual=True)

    @ti.kernel
    def kernel():
        loss[None] += x[None] ** 2

    with (
        pytest.raises(TaiRuntimeError, match="cannot check the access rules in forward mode"),
        ti.ad.FwdMode(loss=loss, param=x),
        ti.ad.Tape(loss, validation=True),
    ):
        kernel()


def test_no_grad_is_refused():
    x, v, loss, kernel = make_pair()

    @ti.ad.no_grad
    def aside():
        kernel()

    with (
        pytest.raises(TaiAutodiffError, match="no_grad"),
        ti.ad.FwdMode(loss=loss, param=x),
    ):
        aside()


def test_the_ir_of_the_forward_kernel():
    x, v, loss, kernel = make_pair()
    text = kernel.mlir(stage="tangent.autodiff")
    assert "tai.atomic add" in text
    assert f"@{loss.symbol}_dual" in text
