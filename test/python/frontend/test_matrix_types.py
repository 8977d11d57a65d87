"""The types of vectors and matrices in Python, which are those of a kernel."""

import numpy as np
import pytest
import tai as ti

FLOATS = [ti.f32, ti.f64]


@pytest.mark.parametrize("default", FLOATS)
@pytest.mark.parametrize(
    "made",
    [
        lambda v: v + 1.5, lambda v: 1.5 - v, lambda v: v * 0.5, lambda v: v / 2, lambda v: v**0.5,
        lambda v: v % 1.5, lambda v: 1.5 // v, lambda v: v + [0.5, 0.25], lambda v: v / v,
        lambda v: v + ti.Vector([0.5, 0.25]), lambda v: ti.max(v, 1.5), lambda v: ti.min(1.5, v),
        lambda v: ti.atan2(v, 2), lambda v: ti.select(v > 1, v, 0.5), lambda v: v.normalized(),
        lambda v: ti.Matrix([[1, 2], [3, 4]]) @ ti.Vector([0.5, 0.25]),
        lambda v: v.outer_product(ti.Vector([0.5, 0.25])),
    ],
)  # fmt: skip
def test_whole_numbers_meet_floats_in_the_default(default, made):
    ti.init(default_fp=default, offline_cache=False)
    assert made(ti.Vector([1, 2])).dtype is default


@pytest.mark.parametrize("default", FLOATS)
@pytest.mark.parametrize("other", [2, 1.5, True, [1, 2.5], ti.Vector([1, 2], ti.i64)])
def test_floats_keep_their_type_beside_numbers(default, other):
    ti.init(default_fp=default, offline_cache=False)
    for dt in (ti.f32, ti.f64):
        assert (ti.Vector([1, 2], dt) * ti.Vector([1, 2])).dtype is dt
        if isinstance(other, list):
            continue  # takes default_fp, as a vector does that is made of it
        assert (ti.Vector([1, 2], dt) * other).dtype is dt
        assert (other + ti.Vector([1, 2], dt)).dtype is dt


def test_what_is_typed_as_f64_stays_f64():
    ti.init(default_fp=ti.f32, offline_cache=False)
    assert (ti.Vector([1, 2]) + np.float64(1.5)).dtype is ti.f64
    assert (ti.Vector([1, 2]) + ti.Vector([1, 2], ti.f64)).dtype is ti.f64
    assert (ti.Vector([1, 2]) + 1).dtype is ti.i32
    assert (ti.Vector([7, 8]) // 2).dtype is ti.i32


def test_the_sum_is_rounded_as_in_a_kernel():
    ti.init(default_fp=ti.f32, offline_cache=False)
    whole = 2**24 + 1
    field = ti.field(ti.f32, 1)

    @ti.kernel
    def add():
        for i in field:
            v = ti.Vector([whole, 2]) + 0.5
            field[i] = v[0]

    add()
    assert (ti.Vector([whole, 2]) + 0.5)[0] == field[0]


@pytest.mark.parametrize("number", [2.5e9, -1e300, float("nan"), float("inf")])
def test_numbers_that_do_not_fit_the_named_type_are_refused(number):
    with pytest.raises(ti.TaiTypeError, match="i32"):
        ti.Vector(np.array([1.0, number]), ti.i32)


def test_numbers_are_converted_to_the_named_type_as_in_a_kernel():
    @ti.kernel
    def cast(v: ti.types.vector(3, ti.f64)) -> ti.types.vector(3, ti.i32):
        return ti.Vector(v, ti.i32)

    @ti.kernel
    def same(v: ti.types.vector(3, ti.f64)) -> ti.types.vector(3, ti.f64):
        return ti.Vector(v)

    numbers = np.array([-2.7, 300.9, 0.5])
    assert list(ti.Vector(numbers, ti.i32)) == list(cast(numbers)) == [-2, 300, 0]
    assert list(ti.Vector(np.array([300, -1]), ti.u8)) == [44, 255]
    assert list(same(numbers)) == list(numbers)
