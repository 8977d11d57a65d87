"""Whole numbers in types of a few bits: what fits, shifts, powers, truth values."""

import math
import warnings

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiCompilationWarning

SIGNED = [ti.i8, ti.i16, ti.i32, ti.i64]
UNSIGNED = [ti.u8, ti.u16, ti.u32, ti.u64]
WHOLE = SIGNED + UNSIGNED


def wrapped(number, dt):
    number &= (1 << dt.bits) - 1
    return number - (1 << dt.bits) if number > dt.max else number


# Numbers that do not fit


@pytest.fixture
def targets():
    return {
        "wide": ti.field(ti.i32, 4), "narrow": ti.field(ti.u8, 4),
        "vector": ti.Vector.field(2, ti.u8, 4),
    }  # fmt: skip


def refuse(kernel, *args, match):
    with pytest.raises(ti.TaiTypeError, match=match) as caught:
        kernel(*args)
    assert caught.value.lineno is not None and caught.value.column is not None
    assert caught.value.hint


def test_results_and_arguments_that_do_not_fit():
    @ti.kernel
    def returned() -> ti.i32:
        return 3000000000

    @ti.kernel
    def negative() -> ti.u8:
        return -1

    @ti.func
    def typed(a: ti.u8):
        return a + 0

    @ti.kernel
    def called() -> ti.i32:
        return typed(300)

    @ti.kernel
    def early(n: ti.i32) -> ti.i32:
        if n > 0:
            return 3000000000
        return 0

    refuse(returned, match="3000000000 does not fit i32")
    refuse(negative, match="-1 does not fit u8")
    refuse(called, match="300 does not fit u8")
    refuse(early, 1, match="3000000000 does not fit i32")


def test_stores_that_do_not_fit(targets):
    wide, narrow, vector = targets["wide"], targets["narrow"], targets["vector"]

    @ti.kernel
    def stored():
        wide[0] = 3000000000

    @ti.kernel
    def added():
        wide[0] += 3000000000

    @ti.kernel
    def atomic():
        ti.atomic_max(narrow[0], 256)

    @ti.kernel
    def negative():
        narrow[0] = -1

    @ti.kernel
    def local(n: ti.i32):
        a = n
        a = -3000000000
        wide[0] = a

    @ti.kernel
    def annotated():
        a: ti.u8 = 300
        wide[0] = a

    @ti.kernel
    def component():
        vector[0][1] = 1000

    @ti.kernel
    def array(a: ti.types.ndarray(ti.i16)):
        a[0] = 40000

    refuse(stored, match="3000000000 does not fit i32")
    refuse(added, match="3000000000 does not fit i32")
    refuse(atomic, match="256 does not fit u8")
    refuse(negative, match="-1 does not fit u8")
    refuse(local, 1, match="-3000000000 does not fit i32")
    refuse(annotated, match="300 does not fit u8")
    refuse(component, match="1000 does not fit u8")
    refuse(array, np.zeros(2, np.int16), match="40000 does not fit i16")


def test_operands_that_do_not_fit():
    @ti.kernel
    def plus(n: ti.i32) -> ti.i64:
        return n + 3000000000

    @ti.kernel
    def less(n: ti.i32) -> ti.i32:
        return n < 3000000000

    @ti.kernel
    def chosen(n: ti.i32) -> ti.i64:
        return ti.select(n > 0, 3000000000, n)

    @ti.kernel
    def below(n: ti.u32) -> ti.i32:
        return n > -1

    @ti.kernel
    def named() -> ti.i64:
        return ti.cast(3000000000, ti.i32)

    @ti.kernel
    def endless() -> ti.i32:
        return ti.cast(math.inf, ti.i32)

    @ti.kernel
    def real() -> ti.i32:
        a = 3e9
        return ti.cast(a, ti.i32)

    for kernel in (plus, less, chosen):
        refuse(kernel, 1, match="3000000000 does not fit i32")
    refuse(below, 1, match="never below zero")
    refuse(named, match="3000000000 does not fit i32")
    with pytest.raises(ti.TaiTypeError, match="inf is no whole number"):
        endless()
    refuse(real, match="3000000000 does not fit i32")


def test_what_fits_is_kept():
    @ti.kernel
    def f(n: ti.i64, u: ti.u32) -> ti.i64:
        a: ti.u32 = 4000000000
        v = ti.Vector([5000000000, 1], ti.i64)
        w = ti.i64(6000000000)
        return n + 3000000000 + a + v[0] + w + (u == -1) + (u + -1)

    total = 1 + 3000000000 + 4000000000 + 5000000000 + 6000000000
    assert f(1, 2**32 - 1) == total + 1 + 2**32 - 2


@pytest.mark.parametrize("dt", WHOLE)
def test_conversions_that_are_asked_for_keep_the_low_bits_as_in_python(dt):
    numbers = [0, 1, -1, 127, 128, 255, 256, -129, 300, 2**31 - 1, -(2**31), dt.min, dt.max]
    out = ti.field(dt, len(numbers))

    @ti.kernel
    def f():
        for i in ti.static(range(len(numbers))):
            out[i] = ti.cast(ti.static(numbers[i]), dt)

    f()
    wanted = [wrapped(n, dt) for n in numbers]
    assert out.to_numpy().tolist() == wanted
    assert [ti.cast(n, dt) for n in numbers] == wanted
    assert [dt(n) for n in numbers] == wanted
    small = [n for n in numbers if -(2**31) <= n < 2**31]
    assert ti.Vector(small, dt).to_list() == [wrapped(n, dt) for n in small]


def test_what_python_stores_fits(targets):
    wide, narrow, vector = targets["wide"], targets["narrow"], targets["vector"]
    array = ti.ndarray(ti.i32, 4)
    for change, match in [
        (lambda: wide.__setitem__(0, 3000000000), "3000000000 does not fit i32"),
        (lambda: wide.__setitem__(0, np.int64(2**40)), "does not fit i32"),
        (lambda: wide.__setitem__(0, 2.5), "whole numbers .i32., not 2.5"),
        (lambda: wide.__setitem__(0, math.nan), "not nan"),
        (lambda: narrow.__setitem__(0, -1), "-1 does not fit u8"),
        (lambda: narrow.fill(256), "256 does not fit u8"),
        (lambda: vector.__setitem__(0, [1, 256]), "256 does not fit u8"),
        (lambda: vector.fill(-1), "-1 does not fit u8"),
        (lambda: vector.fill([1, 256]), "256 does not fit u8"),
        (lambda: vector[0].fill(300), "300"),
        (lambda: wide.from_numpy(np.full(4, 2**31)), "does not fit i32"),
        (lambda: wide.from_numpy(np.full(4, np.nan)), "nan"),
        (lambda: narrow.from_numpy(np.full(4, -1)), "-1 does not fit u8"),
        (lambda: ti.types.struct(a=ti.u8)(a=300), "member 'a': .* 300 does not fit u8"),
        (lambda: array.__setitem__(0, 2**31), "does not fit i32"),
        (lambda: array.__setitem__(0, 0.5), "not 0.5"),
        (lambda: array.fill(-(2**31) - 1), "does not fit i32"),
        (lambda: array.from_numpy(np.full(4, 1e10)), "does not fit i32"),
    ]:
        with pytest.raises((ti.TaiRuntimeTypeError, OverflowError), match=match):
            change()
    assert not wide.to_numpy().any() and not narrow.to_numpy().any() and not array.array.any()
    wide[0], narrow[0], wide[1] = 2.0, 255, np.float32(3)
    wide.from_numpy(np.full(4, 7.0))
    assert wide[0] == 7 and narrow[0] == 255


def test_negative_numbers_are_no_u64():
    @ti.kernel
    def f(a: ti.u64) -> ti.u64:
        return a

    assert f(5) == 5  # the next call finds its code ready
    with pytest.raises(ti.TaiRuntimeTypeError, match="-1 does not fit u64"):
        f(-1)
    assert f(2**64 - 1) == 2**64 - 1


# Shifts


@pytest.mark.parametrize("dt", WHOLE)
@pytest.mark.parametrize("counter", [ti.i8, ti.u8, ti.i32, ti.i64])
def test_shifts_by_any_number_of_bits(dt, counter):
    numbers = [0, 1, 5, dt.max, dt.min, dt.max // 3]
    counts = [0, 1, 7, 8, 15, 16, 31, 32, 33, 63, 64, 100]
    n, m = len(numbers), len(counts)
    x, c = ti.field(dt, n), ti.field(counter, m)
    left, right = ti.field(dt, (n, m)), ti.field(dt, (n, m))
    x.from_numpy(np.array(numbers, dt.numpy))
    c.from_numpy(np.array(counts, counter.numpy))

    @ti.kernel
    def f():
        for i, j in left:
            left[i, j] = ti.cast(x[i], ti.static(wide)) << c[j]
            right[i, j] = x[i] >> c[j]

    wide = dt
    f()
    # If two types have the same width, the unsigned one wins, otherwise the wider one.
    from tai._impl.base.dtypes import promote

    kind = promote(dt, counter)
    for i, number in enumerate(numbers):
        for j, count in enumerate(counts):
            inner = wrapped(number, kind)
            shifted = wrapped(inner << count, kind) if count < kind.bits else 0
            assert left[i, j] == wrapped(shifted, dt), (number, count)
            assert right[i, j] == wrapped(inner >> count, dt), (number, count)


@pytest.mark.parametrize("count", [32, 40, -3])
def test_shifts_by_a_constant_that_the_type_has_not(count):
    @ti.kernel
    def left(x: ti.i32) -> ti.i32:
        return x << count

    @ti.kernel
    def right(x: ti.i32) -> ti.i32:
        x_ = x
        x_ >>= count
        return x_

    @ti.kernel
    def vector(x: ti.i32) -> ti.i32:
        return (ti.Vector([x, x]) << count)[0]

    for kernel in (left, right, vector):
        refuse(kernel, 1, match="negative" if count < 0 else f"by {count}, but the .* 32 bits")


def test_shifts_by_a_negative_number_fail_in_debug_mode():
    ti.init(debug=True)

    @ti.kernel
    def f(x: ti.i32, n: ti.i32) -> ti.i32:
        return x << n

    assert f(1, 3) == 8
    with pytest.raises(ti.TaiAssertionError, match="negative number -3"):
        f(1, -3)


# Powers


@pytest.mark.parametrize("base", [ti.u1, ti.i8, ti.u8, ti.i32, ti.u32, ti.i64])
@pytest.mark.parametrize("exponent", [ti.u1, ti.i8, ti.u8, ti.i32, ti.u64])
def test_powers_of_whole_numbers(base, exponent):
    from tai._impl.base.dtypes import promote

    bases = [0, 1] if base is ti.u1 else [0, 1, 2, 3, 7, -1 if base.is_signed else 5]
    powers = (
        [0, 1] if exponent is ti.u1 else [0, 1, 2, 3, 5, 31, 127 if exponent.is_signed else 200]
    )
    kind = promote(base, exponent)
    kind = ti.i32 if kind is ti.u1 else kind
    x, p = ti.field(base, len(bases)), ti.field(exponent, len(powers))
    out = ti.field(kind, (len(bases), len(powers)))
    x.from_numpy(np.array(bases, base.numpy))
    p.from_numpy(np.array(powers, exponent.numpy))

    @ti.kernel
    def f():
        for i, j in out:
            out[i, j] = x[i] ** p[j]

    f()
    for i, b in enumerate(bases):
        for j, e in enumerate(powers):
            assert out[i, j] == wrapped(b**e, kind), (b, e)


@pytest.mark.parametrize("base", [ti.i8, ti.u8, ti.i32])
def test_negative_powers_are_fractions_that_are_dropped(base):
    @ti.kernel
    def f(b: base, e: ti.i8) -> ti.i32:
        return b**e

    for b in (1, 2, 3, -1, -2) if base.is_signed else (1, 2, 3):
        for e in (-1, -2, -3, -128):
            assert f(b, e) == int(float(b) ** e), (b, e)


# Truth values


@pytest.mark.parametrize("number", [0, 1, 2, 256, -1, 0.0, -0.0, 0.5, 1e-30, 256.0, math.nan])
def test_numbers_become_truth_values_alike_in_kernels_and_python(number):
    u, v = ti.field(ti.u1, 8), ti.Vector.field(2, ti.u1, 2)
    array = ti.ndarray(ti.u1, 2)
    kind = ti.f64 if isinstance(number, float) else ti.i32

    @ti.kernel
    def f(x: kind):
        u[0] = x
        u[1] = ti.cast(x, ti.u1)
        u[2] = bool(x)
        u[3] = ti.cast(ti.static(number), ti.u1)
        v[0] = ti.Vector([x, x])

    f(number)
    u[4] = number
    array[0] = number
    wanted = bool(number)
    assert u.to_numpy().tolist()[:5] == [wanted] * 5
    assert list(v[0]) == [wanted] * 2
    v[1] = [number, number]
    assert list(v[1]) == [wanted] * 2
    assert bool(array[0]) is wanted and ti.cast(number, ti.u1) is wanted
    u.fill(number)
    v.fill(number)
    assert u.to_numpy().all() == wanted and v.to_numpy().all() == wanted


def test_nothing_counts_in_a_truth_value():
    u = ti.field(ti.u1, 4)

    @ti.kernel
    def field():
        u[0] += True

    @ti.kernel
    def atomic():
        for _ in range(10):
            ti.atomic_add(u[0], True)

    @ti.kernel
    def local() -> ti.i32:
        a = True
        a += 1
        return a

    @ti.kernel
    def product():
        u[0] *= 2

    @ti.kernel
    def array(a: ti.types.ndarray(ti.u1)):
        a[0] -= 1

    for kernel in (field, atomic, local, product):
        refuse(kernel, match="counts, but the target holds u1")
    refuse(array, np.zeros(1, bool), match="counts, but the target holds u1")


def test_extremes_of_truth_values():
    u = ti.field(ti.u1, 4)

    @ti.kernel
    def f():
        for _ in range(10):
            ti.atomic_max(u[0], True)
            ti.atomic_min(u[1], True)
            ti.atomic_min(u[2], False)
            ti.atomic_or(u[3], True)

    u[1] = u[2] = True
    f()
    assert u.to_numpy().tolist() == [True, True, False, True]


# Floats in whole numbers


def test_fractions_that_are_dropped_are_said_once():
    x = ti.field(ti.i32, 4)

    @ti.kernel
    def divide():
        x[0] /= 2.0

    @ti.kernel
    def local(a: ti.f32) -> ti.i32:
        b = 1
        b = a
        return b

    @ti.kernel
    def returned(a: ti.f32) -> ti.i32:
        return a * 2

    x[0] = 7
    with pytest.warns(TaiCompilationWarning, match="'divide': field 'x' of type i32 takes a float"):
        divide()
    assert x[0] == 3
    with pytest.warns(TaiCompilationWarning, match="variable 'b' of type i32"):
        assert local(2.5) == 2
    with pytest.warns(TaiCompilationWarning, match="result"):
        assert returned(1.25) == 2


def test_conversions_that_are_said_do_not_warn():
    x = ti.field(ti.i32, 4)

    @ti.kernel
    def f(a: ti.f32) -> ti.i32:
        x[0] = int(a / 2.0)
        x[1] = ti.cast(a, ti.i32)
        x[2] = 3.0
        x[3] = ti.floor(a, ti.i32)
        return int(a)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert f(7.5) == 7
    assert x.to_numpy().tolist() == [3, 7, 3, 7]


def test_loop_variables_of_programs_with_64_bits():
    """With `default_ip=ti.i64` squares of loop variables do not wrap, whatever the loop is."""
    ti.init(default_ip=ti.i64)
    n = 100_000
    x = ti.field(ti.i32, n)

    @ti.kernel
    def by_range() -> ti.i64:
        t = 0
        for i in range(n):
            t += i * i
        return t

    @ti.kernel
    def by_field() -> ti.i64:
        t = 0
        for i in x:
            t += i * i
        return t

    @ti.kernel
    def in_order(m: ti.i32) -> ti.i64:
        t = 0
        for _ in range(1):
            for i in range(1, m, 2):
                t += i * i
        return t

    @ti.kernel
    def grouped() -> ti.i64:
        t = 0
        for k in ti.grouped(ti.ndrange((-n, n), 1)):
            t += k[0] * k[0]
        return t

    squares = sum(i * i for i in range(n))
    assert by_range() == by_field() == squares
    assert in_order(n) == sum(i * i for i in range(1, n, 2))
    assert grouped() == 2 * squares + n * n
