"""Fields and arrays of no dimension: one element, and loops of one iteration."""

import pytest
import tai as ti


@pytest.mark.parametrize(
    "make",
    [
        lambda: ti.field(ti.f32, shape=()),
        lambda: ti.Vector.field(2, ti.f32, shape=()),
        lambda: ti.Matrix.field(2, 2, ti.f32, shape=()),
        lambda: ti.Vector.field(3, ti.f64, shape=(), layout=ti.Layout.SOA),
        lambda: ti.Struct.field({"a": ti.f32, "b": ti.i32}, shape=()).a,
    ],
)
def test_grouped_over_a_field_of_no_dimension(make):
    ti.init(offline_cache=False)
    x = make()
    runs = ti.field(ti.i32, shape=())

    @ti.kernel
    def add():
        for at in ti.grouped(x):
            x[at] += 3
            runs[None] += 1 + at.n

    add()
    add()
    assert (x.to_numpy() == 6).all()
    assert runs[None] == 2


def test_grouped_over_an_array_of_no_dimension():
    ti.init(offline_cache=False)

    @ti.kernel
    def add(x: ti.types.ndarray(ndim=0)):
        for at in ti.grouped(x):
            x[at] += 3

    x = ti.ndarray(ti.f32, shape=())
    add(x)
    add(x)
    assert x[None] == 6


@pytest.mark.parametrize("shape", [(), 3])
def test_a_field_is_true(shape):
    ti.init(offline_cache=False)
    assert ti.field(ti.f32, shape=shape)
    assert ti.Vector.field(2, ti.f32, shape=shape)
