"""Parameters and results of functions that leave their type open: `typing.Any` and `object`."""

from typing import Any

import numpy as np
import pytest
import tai as ti


@ti.func
def scaled(value: Any, by: object) -> Any:
    value *= by
    return value


@ti.func
def both(value: Any) -> tuple[Any, ti.i32]:
    return 0.5 * value, int(3.75)


@pytest.mark.parametrize("number", [2.5, -3.0])
def test_numbers_keep_their_type(number):
    @ti.kernel
    def run(x: ti.f64, n: ti.i32) -> ti.f64:
        return scaled(x, n) + ti.cast(scaled(n, 2), ti.f64) / 4

    assert run(number, 3) == 3 * number + 1.5


def test_vectors_are_copied():
    x = ti.Vector.field(2, ti.f64, shape=3)

    @ti.kernel
    def run() -> ti.f64:
        start = ti.Vector([1.0, 2.0])
        for i in range(3):
            x[i] = scaled(start, i + 1)
        return start.sum()

    assert run() == 3
    np.testing.assert_array_equal(x.to_numpy(), [[1, 2], [2, 4], [3, 6]])


def test_parts_of_a_result():
    @ti.kernel
    def run(x: ti.f64) -> ti.f64:
        half, whole = both(x)
        return half + 10 * whole

    assert run(1.0) == 30.5


def test_fields():
    x = ti.field(ti.f32, shape=4)

    @ti.func
    def first(field: Any):
        return field[0]

    @ti.kernel
    def run() -> ti.f32:
        return first(x)

    x[0] = 7
    assert run() == 7


def test_text_of_an_annotation():
    def plain(a, b):
        return a + b

    plain.__annotations__ = {"a": "Any", "b": "object", "return": "Any"}
    added = ti.func(plain)

    @ti.kernel
    def run(x: ti.f32) -> ti.f32:
        return added(x, 1)

    assert run(1.5) == 2.5


def test_kernels_have_to_know():
    with pytest.raises(ti.TaiSyntaxError, match="parameter 'x' of 'run' may have any type") as hint:

        @ti.kernel
        def run(x: Any):
            pass

        run(1)
    assert "ti.template()" in str(hint.value) and "test_open_types.py" in str(hint.value)
    with pytest.raises(ti.TaiSyntaxError, match="the result of 'result' may have any type"):

        @ti.kernel
        def result() -> object:
            return 1

        result()
