# ruff: noqa: F507, UP031
"""`match`, `else` of loops, `:=`, ranges with a step known at run time, and their gradients."""

import re

import numpy as np
import pytest
import tai as ti

SIZES = [1, 7, 65]


@pytest.fixture(autouse=True)
def doubles(fresh_program):
    ti.init(default_fp=ti.f64, offline_cache=False)


def _fields(n):
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.linspace(0.5, 2.0, n))
    return x, loss


def test_match_of_a_number():
    x, loss = _fields(5)

    @ti.kernel
    def run(m: ti.i32):
        for i in x:
            match m:
                case 0:
                    loss[None] += x[i]
                case 1 | 2:
                    loss[None] += 2 * x[i]
                case -3:
                    loss[None] += x[i] ** 2
                case n if n > 10:
                    loss[None] += n * x[i]
                case _:
                    loss[None] += 7 * x[i]

    for m, slope in [(0, 1), (1, 2), (2, 2), (-3, 2 * x.to_numpy()), (11, 11), (5, 7)]:
        with ti.ad.Tape(loss):
            run(m)
        assert np.allclose(x.grad.to_numpy(), slope), m


def test_match_of_tuples_and_of_what_is_known_now():
    mode = "fast"

    @ti.func
    def kind(a, b):
        found = 0
        match (a, b):
            case (0, 0):
                found = 1
            case (0, other):
                found = 10 + other
            case (c, d) if c == d:
                found = 100
            case (1, _) | (_, 1):
                found = 1000
        return found

    @ti.kernel
    def run(a: ti.i32, b: ti.i32) -> ti.i32:
        result = kind(a, b)
        match mode:
            case "slow":
                result = ti.static_assert(False)
            case "fast":
                result += 1
        return result

    pairs = [(0, 0), (0, 4), (3, 3), (1, 2), (2, 1), (2, 3)]
    assert [run(*pair) for pair in pairs] == [2, 15, 101, 1001, 1001, 1]


def test_the_subject_is_evaluated_once():
    count = ti.field(ti.i32, shape=())

    @ti.func
    def draw():
        count[None] += 1
        return count[None]

    @ti.kernel
    def run() -> ti.i32:
        result = 0
        match draw():
            case 5:
                result = 1
            case 1:
                result = 2
            case _:
                result = 3
        return result

    assert run() == 2
    assert count[None] == 1


def test_match_that_returns_and_leaves_loops():
    @ti.kernel
    def run(n: ti.i32) -> ti.i32:
        total = 0
        for _ in range(1):
            for i in range(10):
                match i % 4:
                    case 0:
                        continue
                    case 3:
                        break
                total += i * n
        match total:
            case 3:
                return 30
        return total

    assert run(1) == 30
    assert run(2) == 6


def test_patterns_that_kernels_do_not_know():
    @ti.kernel
    def run(n: ti.i32):
        match n:
            case {"a": 1}:
                pass

    with pytest.raises(ti.TaiSyntaxError, match="kernels match numbers and tuples"):
        run(1)

    @ti.kernel
    def hidden(n: ti.i32):
        match (n, n):
            case (1, *_):
                pass

    with pytest.raises(ti.TaiSyntaxError, match=r"no '\*' in a pattern"):
        hidden(1)


def test_else_of_loops():
    @ti.kernel
    def find(n: ti.i32) -> ti.i32:
        result = 0
        for _ in range(1):
            for i in range(10):
                if i == n:
                    result = i
                    break
            else:
                result = -1
        return result

    @ti.kernel
    def climb(n: ti.i32) -> ti.i32:
        result, i = 0, 0
        while i < 10:
            if i == n:
                result = i
                break
            i += 1
        else:
            result = -1
        return result

    @ti.kernel
    def unrolled(n: ti.i32) -> ti.i32:
        result = 0
        for i in ti.static(range(10)):
            if ti.static(i == 20):
                break
            if i == n:
                result = i
        else:
            result += 100
        return result

    for function, found in ((find, [3, -1]), (climb, [3, -1]), (unrolled, [103, 100])):
        assert [function(3), function(30)] == found


def test_else_of_a_loop_inside_of_another_belongs_to_its_own():
    @ti.kernel
    def run(limit: ti.i32) -> ti.i32:
        found = 0
        for _ in range(1):
            for i in range(2, 30):
                for j in range(2, i):
                    if i % j == 0:
                        break
                else:
                    found += 1
                    if found == limit:
                        break
            else:
                found += 1000
        return found

    assert run(4) == 4
    assert run(100) == 1010  # 10 primes below 30


def test_gradients_behind_an_else():
    x, loss = _fields(6)

    @ti.kernel
    def run(limit: ti.f64):
        for i in x:
            for k in range(4):
                if k * x[i] > limit:
                    loss[None] += 3 * x[i]
                    break
            else:
                loss[None] += x[i] ** 3

    with ti.ad.Tape(loss):
        run(3.0)
    values = x.to_numpy()
    assert np.allclose(x.grad.to_numpy(), np.where(3 * values > 3.0, 3, 3 * values**2))


@pytest.mark.parametrize("n", SIZES)
def test_assignment_in_expressions(n):
    x, loss = _fields(n)

    @ti.kernel
    def run():
        for i in x:
            if (y := 2 * x[i]) > 1.5:
                loss[None] += y**2
            if x[i] > 1 and (z := ti.sqrt(x[i])) > 1.1:
                loss[None] += z
            w = (v := x[i]) if x[i] < 1 else (u := 3 * x[i])
            loss[None] += w + v + u

    with ti.ad.Tape(loss):
        run()
    a = x.to_numpy()
    wanted = np.where(2 * a > 1.5, 8 * a, 0) + np.where(a < 1, 2, 6)
    wanted += np.where((a > 1) & (np.sqrt(a) > 1.1), 0.5 / np.sqrt(a), 0)
    assert np.allclose(x.grad.to_numpy(), wanted)


def test_assignment_in_the_condition_of_a_while():
    @ti.kernel
    def count() -> ti.i32:
        n, total = 10, 0
        while (n := n - 1) > 0:
            if n == 5:
                continue
            total += n
        return total

    @ti.kernel
    def halve(x: ti.f64) -> ti.f64:
        k, total = 0, 0.0
        while (y := x * 0.5**k) > 1:  # a name that the condition makes
            total += y
            k += 1
        return total

    assert count() == 40
    assert halve(6.0) == 6 + 3 + 1.5


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("bounds", [(0, 20, 3), (19, -1, -2), (5, 5, 1), (3, 18, 7), (3, 9, -1)])
def test_steps_known_at_run_time(bounds, threads):
    ti.init(default_fp=ti.f64, offline_cache=False, cpu_max_num_threads=threads)
    x, loss = _fields(20)

    @ti.kernel
    def outer(a: ti.i32, b: ti.i32, s: ti.i32):
        for i in range(a, b, s):
            loss[None] += x[i] ** 2

    @ti.kernel
    def inner(a: ti.i32, b: ti.i32, s: ti.i32):
        for _ in range(1):
            for i in range(a, b, s):
                if i == 17:
                    break
                loss[None] += x[i] ** 2

    visited = np.zeros(20)
    visited[list(range(*bounds))] = 1
    for kernel in (outer, inner):
        with ti.ad.Tape(loss):
            kernel(*bounds)
        wanted = visited.copy()
        if kernel is inner and visited[17]:
            first = list(range(*bounds)).index(17)
            wanted[list(range(*bounds))[first:]] = 0
        assert np.allclose(x.grad.to_numpy(), 2 * x.to_numpy() * wanted)


def test_steps_of_other_types_and_the_step_zero():
    @ti.kernel
    def total(n: ti.i64, s: ti.u8) -> ti.i64:
        t = ti.i64(0)
        for _ in range(1):
            for i in range(n, n + 10, s):
                t += i
        return t

    assert total(2**40, 3) == sum(range(2**40, 2**40 + 10, 3))
    with pytest.raises(ti.TaiAssertionError, match="the step of a range must not be 0"):
        total(5, 0)


def test_and_or_not_of_vectors_are_those_of_the_components():
    Three = ti.types.vector(3, ti.i32)

    @ti.kernel
    def both(a: Three, b: Three) -> Three:
        return a and b

    @ti.kernel
    def either(a: Three, b: Three, n: ti.i32) -> Three:
        return (a > n) or (b > n)

    @ti.kernel
    def neither(a: Three, flag: ti.i32) -> Three:
        return not (flag and a)

    assert list(both([1, 0, 1], [1, 1, 0])) == [1, 0, 0]
    assert [bool(v) for v in either([5, 0, 0], [0, 7, 1], 2)] == [True, True, False]
    assert [bool(v) for v in neither([1, 0, 2], 1)] == [False, True, False]
    assert [bool(v) for v in neither([1, 0, 2], 0)] == [True, True, True]


def test_percent_formats(capfd):
    x = ti.field(ti.f64, shape=2)
    x[0], x[1] = 2.5, -1

    @ti.kernel
    def show(n: ti.i32):
        print("%d and %.2f" % (n, x[0]))
        print("[%5d|%-5d|%05.1f|%+d|%x|%%|%s]" % (n, n, x[1], n, n, "text"))
        print("%s %s" % (ti.Vector([1, 2]), x[1]))
        print("%d" % x[0])

    show(42)
    ti.sync()
    lines = capfd.readouterr().out.splitlines()
    n, a = 42, -1.0
    assert lines == [
        "42 and 2.50", "[%5d|%-5d|%05.1f|%+d|%x|%%|%s]" % (n, n, a, n, n, "text"), "[1, 2] -1.0",
        "2",
    ]  # fmt: skip

    @ti.kernel
    def wrong(n: ti.i32):
        print("%d %d" % (n,))

    with pytest.raises(ti.TaiTypeError, match="more than there are values"):
        wrong(1)


PLACES = ["%8d", "%08d", "%-8d", "%-08d", "% d", "%+5d", "%#x", "%s", "%8s", "%-8s", "%08s", "%r",
          "%9.3f", "%-9.3f", "%09.3f", "%+.2e", "%6g"]  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_percent_formats_are_those_of_python(capfd, place):
    @ti.kernel
    def whole(n: ti.i32):
        print(f"[{place}]" % n)

    @ti.kernel
    def real(x: ti.f64):
        print(f"[{place}]" % x)

    values = [-5, 0, 1234] + [-2.5, 0.75] * (place[-1] not in "xr")
    for value in values:
        (whole if isinstance(value, int) else real)(value)
    ti.sync()
    assert capfd.readouterr().out.splitlines() == [f"[{place}]" % value for value in values]


def test_percent_formats_of_vectors_and_constants(capfd):
    @ti.kernel
    def show(v: ti.types.vector(2, ti.i32), x: ti.f64):
        print("%5s|%03d|%-4d|%s" % (v, v, v, v))
        print(("a", 1), [2], (3,), ("a", x), [x, (x,)])

    show([-1, 2], 1.5)
    ti.sync()
    assert capfd.readouterr().out.splitlines() == [
        "[   -1,     2]|[-01, 002]|[-1  , 2   ]|[-1, 2]",
        "('a', 1) [2] (3,) (a, 1.5) [1.5, (1.5,)]",
    ]


@pytest.mark.parametrize(
    ("place", "thing", "message"),
    [
        ("%c", "n", "kernels have no format '%c'"),
        ("%.2s", "n", "kernels have no format '%.2s'"),
        ("%.1r", "v", "kernels have no format '%.1r'"),
        ("%.2f", "v", "'%.2f' is for one number, but got a vector"),
        ("%d", "(n, n)", "'%d' is for one number, but got tuple"),
        ("%5s", "(n, n)", "'%5s' is for one number, but got tuple"),
        ("%d", "p", "'%d' is for one number, but got a struct"),
    ],
)
def test_percent_formats_that_kernels_do_not_have(place, thing, message):
    pair = ti.types.struct(a=ti.f32, b=ti.f32)

    def choose(n, v, p):
        return {"n": n, "v": v, "(n, n)": (n, n), "p": p}[thing]

    @ti.kernel
    def show(n: ti.i32, v: ti.types.vector(2, ti.f32)):
        p = pair(1.0, 2.0)
        print(place % (choose(n, v, p),))

    with pytest.raises(ti.TaiTypeError, match=re.escape(message)):
        show(3, [1, 2])


@pytest.mark.parametrize("is_alone", [True, False])
def test_the_message_of_an_assertion_may_be_a_tuple(is_alone):
    """A text, and values that are shown behind it."""
    ti.init(debug=True, offline_cache=False)

    @ti.kernel
    def kernel(n: ti.i32, x: ti.f32):
        if ti.static(is_alone):
            assert n > 3, ("too small",)
        else:
            assert n > 3, ("too small:", n, x)

    kernel(4, 0.5)
    with pytest.raises(ti.TaiAssertionError) as caught:
        kernel(1, 0.5)
    expected = "too small" if is_alone else "too small: 1 0.5"
    assert str(caught.value).splitlines()[0] == expected
