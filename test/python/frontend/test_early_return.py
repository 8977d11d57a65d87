"""`return` in branches and loops: values as Python gives them, and their gradients."""

import math

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True, params=["f32", "f64"])
def precision(request):
    ti.init(default_fp=getattr(ti, request.param), offline_cache=False)
    return {"f32": 1e-5, "f64": 1e-13}[request.param]


@ti.func
def sign_of(a):
    if a > 0:
        return 1.0
    elif a < 0:
        return -1.0
    return 0.0


def test_return_in_a_branch_of_a_function():
    @ti.kernel
    def kernel(a: float) -> float:
        return 2 * sign_of(a) + sign_of(-a)

    assert [kernel(a) for a in (3.0, -2.0, 0.0)] == [1, -1, 0]


def test_return_in_a_branch_of_a_kernel():
    @ti.kernel
    def kernel(n: ti.i32, m: ti.i32) -> ti.i32:
        total = n
        if n > 10:
            if m > 10:
                return 1
            total += 100
            if m > 5:
                return total
        elif m == 3:
            return 7
        total += 1000
        return total

    def python(n, m):
        total = n
        if n > 10:
            if m > 10:
                return 1
            total += 100
            if m > 5:
                return total
        elif m == 3:
            return 7
        return total + 1000

    for n in (1, 20):
        for m in (1, 3, 6, 20):
            assert kernel(n, m) == python(n, m)


def test_statements_after_a_return_do_not_run():
    x = ti.field(ti.i32, shape=8)

    @ti.kernel
    def kernel(n: ti.i32):
        x[0] += 1
        if n > 3:
            x[1] += 1
            return
        for i in x:
            x[i] += 10
        if n > 2:
            return
        for i in range(8):
            x[i] += 100

    kernel(4)
    assert x.to_numpy().tolist() == [1, 1, 0, 0, 0, 0, 0, 0]
    kernel(3)
    assert x.to_numpy().tolist() == [12, 11, 10, 10, 10, 10, 10, 10]
    kernel(0)
    assert x.to_numpy().tolist() == [123, 121, 120, 120, 120, 120, 120, 120]


def test_what_follows_a_return_runs_in_parallel():
    x = ti.field(ti.i32, shape=8)

    @ti.kernel
    def kernel(n: ti.i32):
        if n > 3:
            return
        for i in x:
            x[i] = n

    kernel(1)
    assert kernel.mlir().count("tai.parallel_for") == 1


def test_return_from_nested_loops():
    @ti.func
    def search(limit):
        for i in range(10):
            for j in range(i):
                if i * j > limit:
                    return i, j
        return -1, -1

    @ti.kernel
    def kernel(limit: ti.i32) -> ti.types.vector(2, ti.i32):
        i, j = 0, 0
        for _ in range(1):
            i, j = search(limit)
        return ti.Vector([i, j])

    def python(limit):
        for i in range(10):
            for j in range(i):
                if i * j > limit:
                    return [i, j]
        return [-1, -1]

    for limit in (0, 5, 30, 71, 72):
        assert kernel(limit).to_list() == python(limit)


def test_return_from_loops_of_all_kinds():
    @ti.kernel
    def counted(n: ti.i32) -> ti.i32:
        ti.loop_config(serialize=True)
        for i in range(3, 100, 7):
            if i >= n:
                return i
        return -1

    @ti.kernel
    def endless(n: ti.i32) -> ti.i32:
        i = 0
        while True:
            if i * i > n:
                return i
            i += 1

    @ti.kernel
    def mixed(n: ti.i32) -> ti.i32:
        i = 0
        total = 0
        while i < 20:
            i += 1
            if i % 3 == 0:
                continue
            if i > 15:
                break
            for j in range(i):
                if total + j > n:
                    return 1000 + total
            total += i
        return total

    @ti.kernel
    def two_dimensions(n: ti.i32) -> ti.i32:
        ti.loop_config(serialize=True)
        for i, j in ti.ndrange(5, 4):
            if i * j == n:
                return 10 * i + j
        return -1

    def python_mixed(n):
        i = total = 0
        while i < 20:
            i += 1
            if i % 3 == 0:
                continue
            if i > 15:
                break
            for j in range(i):
                if total + j > n:
                    return 1000 + total
            total += i
        return total

    def python_two(n):
        found = [(i, j) for i in range(5) for j in range(4) if i * j == n]
        return 10 * found[0][0] + found[0][1] if found else -1

    assert [counted(n) for n in (0, 11, 94, 95)] == [3, 17, 94, -1]
    assert [endless(n) for n in (0, 8, 9, 50)] == [1, 3, 4, 8]
    assert [mixed(n) for n in (0, 7, 30, 1000)] == [python_mixed(n) for n in (0, 7, 30, 1000)]
    assert [two_dimensions(n) for n in (0, 6, 12, 7)] == [python_two(n) for n in (0, 6, 12, 7)]


def test_return_from_an_unrolled_loop():
    @ti.func
    def lookup(v):
        for i in ti.static(range(4)):
            if v == i:
                return i * 10
            if v == 10 + i:
                return -i
        return 99

    @ti.kernel
    def kernel(v: ti.i32) -> ti.i32:
        return lookup(v)

    assert [kernel(v) for v in (0, 2, 3, 4, 11, 13)] == [0, 20, 30, 99, -1, -3]


def test_return_known_at_compile_time():
    @ti.func
    def chosen(kind: ti.template(), a):
        if ti.static(kind == 0):
            return a
        if a > 1:
            return a * 10
        return a * 100

    @ti.kernel
    def kernel(a: ti.i32) -> ti.i32:
        return chosen(0, a) * 10000 + chosen(1, a)

    assert [kernel(a) for a in (1, 2)] == [10100, 20020]


def test_types_of_several_returns_are_joined():
    @ti.func
    def f(a):
        if a > 2:
            return 1
        if a > 1:
            return 0.5
        return ti.cast(a, ti.i32)

    @ti.func
    def vectors(a):
        if a > 0:
            return ti.Vector([a, 1]), 2
        return ti.Vector([0, 0]), 0.5

    @ti.kernel
    def kernel(a: float) -> float:
        return f(a)

    @ti.kernel
    def tuples(a: float) -> ti.types.vector(3, float):
        v, s = vectors(a)
        return ti.Vector([v[0], v[1], s])

    assert [kernel(a) for a in (3.0, 1.5, 0.0)] == [1, 0.5, 0]
    assert tuples(3.0).to_list() == [3, 1, 2]
    assert tuples(-3.0).to_list() == [0, 0, 0.5]


def test_a_function_changes_its_arguments_and_returns():
    @ti.func
    def take(count: ti.template(), n):
        if n > 3:
            count += 1
            return
        count += 10

    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        count = 0
        take(count, n)
        take(count, n + 2)
        return count

    assert [kernel(n) for n in (0, 2, 4)] == [20, 11, 2]


def test_functions_that_return_early_nest():
    @ti.func
    def inner(a):
        if a > 1:
            return a * 2
        return a * 3

    @ti.func
    def outer(a):
        b = inner(a)
        if b > 5:
            return inner(b) + a
        return inner(b + 1)

    @ti.kernel
    def kernel(a: float) -> float:
        return outer(a)

    def python_inner(a):
        return a * 2 if a > 1 else a * 3

    def python(a):
        b = python_inner(a)
        return python_inner(b) + a if b > 5 else python_inner(b + 1)

    assert [kernel(a) for a in (0.25, 1.5, 3.0)] == [python(a) for a in (0.25, 1.5, 3.0)]


def test_gradient_through_a_branch(precision):
    x = ti.field(float, shape=6, needs_grad=True)
    loss = ti.field(float, shape=(), needs_grad=True)
    values = np.array([-2.0, -0.5, 0.0, 0.25, 1.5, 3.0])
    x.from_numpy(values.astype(x.dtype.numpy))

    @ti.func
    def huber(a):
        if a > 1:
            return a - 0.5
        if a < -1:
            return -a - 0.5
        return 0.5 * a * a

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += huber(x[i])

    with ti.ad.Tape(loss):
        kernel()
    expected = np.clip(values, -1, 1)
    np.testing.assert_allclose(x.grad.to_numpy(), expected, rtol=precision)


def test_gradient_is_finite_where_the_branch_returned(precision):
    """The statement after the return has an infinite derivative there, and did not run."""
    x = ti.field(float, shape=3, needs_grad=True)
    loss = ti.field(float, shape=(), needs_grad=True)
    x.from_numpy(np.array([-1, 0, 4], x.dtype.numpy))

    @ti.func
    def root(a):
        if a <= 0:
            return 3 * a
        return ti.sqrt(a)

    @ti.kernel
    def kernel():
        for i in x:
            loss[None] += root(x[i])

    with ti.ad.Tape(loss):
        kernel()
    np.testing.assert_allclose(x.grad.to_numpy(), [3, 3, 0.25], rtol=precision)


@pytest.mark.parametrize("form", ["while", "for"])
def test_gradient_of_an_iteration_that_returns_when_it_is_done(form, precision):
    """Newton's square root, left as soon as it is accurate: the derivative is 1/(2√a)."""
    a = ti.field(float, shape=4, needs_grad=True)
    loss = ti.field(float, shape=(), needs_grad=True)
    values = np.array([0.5, 2.0, 9.0, 100.0])
    a.from_numpy(values.astype(a.dtype.numpy))
    accuracy = 30 * precision

    @ti.func
    def newton_while(v):
        x = v
        while True:
            following = 0.5 * (x + v / x)
            if abs(following - x) < accuracy * x:
                return following
            x = following

    @ti.func
    def newton_for(v):
        x = v
        for _ in range(100):
            following = 0.5 * (x + v / x)
            if abs(following - x) < accuracy * x:
                return following
            x = following
        return -1.0

    newton = newton_while if form == "while" else newton_for

    @ti.kernel
    def kernel():
        for i in a:
            loss[None] += newton(a[i])

    with ti.ad.Tape(loss):
        kernel()
    assert math.isclose(loss[None], np.sqrt(values).sum(), rel_tol=10 * precision)
    np.testing.assert_allclose(a.grad.to_numpy(), 0.5 / np.sqrt(values), rtol=1e3 * precision)


def test_gradient_of_a_power_that_returns(precision):
    """a**k by repeated products; k is known only when the kernel runs."""
    a = ti.field(float, shape=(), needs_grad=True)
    loss = ti.field(float, shape=(), needs_grad=True)
    a[None] = 1.25

    @ti.kernel
    def kernel(k: ti.i32):
        p = 1.0
        loss[None] += 1.0
        ti.loop_config(serialize=True)
        for i in range(50):
            if i == k:
                loss[None] += p
                return
            p *= a[None]
        loss[None] += 1e6

    for k in (0, 1, 7):
        with ti.ad.Tape(loss):
            kernel(k)
        assert math.isclose(loss[None], 1 + 1.25**k, rel_tol=precision * 10)
        expected = k * 1.25 ** (k - 1)
        assert math.isclose(a.grad[None], expected, rel_tol=precision * 10)


@pytest.mark.parametrize("in_branch", [False, True])
@pytest.mark.parametrize("in_function", [False, True])
def test_items_of_a_static_loop_behind_a_return_are_not_compiled(in_branch, in_function):
    """Like statements behind a return: "none" is no index, but nothing reads that component."""

    def run(v: ti.types.vector(2, float), n: ti.i32) -> float:
        if ti.static(in_branch):
            if n > 0:
                for k in ti.static((1, "none")):
                    return v[k]
        else:
            for k in ti.static((1, "none")):
                return v[k]
        return -1.0

    if in_function:
        inner = ti.func(run)

        @ti.kernel
        def kernel(v: ti.types.vector(2, float), n: ti.i32) -> float:
            return inner(v, n)
    else:
        kernel = ti.kernel(run)

    assert kernel([3, 4], 1) == 4
    assert kernel([3, 4], 0) == (-1 if in_branch else 4)


def test_returns_in_branches_are_those_that_the_kernel_announces():
    @ti.kernel
    def unannounced(n: ti.i32):
        if n > 1:
            return 3

    @ti.kernel
    def nothing(n: ti.i32) -> ti.i32:
        if n > 1:
            return
        return 2

    with pytest.raises(ti.TaiSyntaxError, match="returns a value needs a return type") as caught:
        unannounced(1)
    assert "return 3" in str(caught.value)
    with pytest.raises(ti.TaiSyntaxError, match="has a return type: return a value"):
        nothing(1)


def test_a_search_at_the_top_of_a_kernel():
    """A loop of a function that may return early runs in order."""
    x = ti.field(ti.f32, 1000)
    x.from_numpy(np.arange(1000, dtype=np.float32))

    @ti.func
    def find(least) -> ti.i32:
        for i in range(1000):
            if x[i] >= least:
                return i
        return -1

    @ti.kernel
    def search(least: ti.f32) -> ti.i32:
        return find(least)

    assert [search(v) for v in (-1, 500.5, 2000)] == [0, 501, -1]


def test_loops_of_real_functions_run_in_order():
    x = ti.field(ti.f32, 1000)
    x.fill(1)

    @ti.func
    def add_former(i):
        for j in range(i - 1, i):
            x[i] += x[j]

    @ti.real_func
    def scan(n: ti.i32) -> ti.f32:
        last = 0.0
        for i in range(1, n):
            add_former(i)
            last = last * 0.5 + x[i]
        return last

    @ti.kernel
    def run() -> ti.f32:
        return scan(1000)

    expected = 0.0
    for i in range(2, 1001):
        expected = expected * 0.5 + i
    assert run() == pytest.approx(expected)
    np.testing.assert_array_equal(x.to_numpy(), np.arange(1, 1001))
