"""Indices of components out of range, and the messages about arrays."""

import numpy as np
import pytest
import tai as ti

from refused_indices import refused


@pytest.mark.parametrize("options", [{}, {"bounds": "check"}, {"debug": True}], ids=str)
def test_components_and_arrays_have_extents_of_their_own(options):
    ti.init(offline_cache=False, **options)
    v = ti.Vector.field(3, ti.f32, shape=8, name="speed")
    n = ti.field(ti.i32, shape=8)
    n.fill(5)

    @ti.kernel
    def component(j: ti.i32):
        for i in v:
            v[i][j] = 1

    @ti.kernel
    def element(a: ti.types.ndarray(ndim=2), j: ti.i32):
        for i in v:
            a[j, 0] = i

    @ti.kernel
    def by_data(a: ti.types.ndarray(ndim=2)):
        for i in v:
            a[n[i], 0] = i

    array = np.zeros((5, 2), np.float32)
    calls = {
        "an element of shape [3] of field 'speed'": lambda: component(3),
        "of shape [5, 2]": lambda: element(array, 5),
    }
    if options:
        calls["of shape [5, 2] "] = lambda: by_data(array)
    for what, call in calls.items():
        with pytest.raises(ti.TaiAssertionError, match="is out of range for") as caught:
            call()
            ti.sync()
        assert str(caught.value).splitlines()[0].endswith(what.strip())


@pytest.mark.parametrize("options", [{}, {"bounds": "check"}, {"debug": True}], ids=str)
def test_a_column_out_of_range_is_none_of_the_next_row(options):
    ti.init(offline_cache=False, **options)
    m = ti.Matrix.field(2, 3, ti.f32, shape=4, name="stress")
    array = ti.Matrix.ndarray(2, 3, ti.f32, 4)

    @ti.kernel
    def of_field(row: ti.i32, column: ti.i32):
        for i in m:
            m[i][row, column] += 1

    @ti.kernel
    def of_array(a: ti.types.ndarray(dtype=ti.types.matrix(2, 3, ti.f32)), column: ti.i32):
        for i in m:
            a[i][0, column] = 1

    refused(of_field, 0, 3, index="0, 3", line="an element of shape [2, 3] of field 'stress'")
    refused(of_field, 1, -1, index="1, -1")
    refused(of_array, array, 3, index="0, 0, 3", line="of shape [4, 2, 3]")
    assert not m.to_numpy().any() and not array.to_numpy().any()
    of_field(1, 0)
    of_array(array, 2)
    assert m.to_numpy().sum(0).tolist() == [[0, 0, 0], [4, 0, 0]]
    assert array.to_numpy().sum(0).tolist() == [[0, 0, 4], [0, 0, 0]]


@pytest.mark.parametrize("options", [{"bounds": "check"}, {"debug": True}], ids=str)
@pytest.mark.parametrize("count", [3, 20])
def test_components_of_variables_are_checked(options, count):
    ti.init(offline_cache=False, **options)

    @ti.kernel
    def read(j: ti.i32) -> ti.i32:
        v = ti.Vector([2 * i for i in range(count)])
        return ti.select(j == 77, 0, v[j])

    @ti.kernel
    def write(j: ti.i32, k: ti.i32) -> ti.i32:
        m = ti.Matrix([[0 for _ in range(count)] for _ in range(2)])
        m[j, k] = 1
        return m.sum()

    assert (read(0), read(count - 1), read(77), write(1, 2)) == (0, 2 * count - 2, 0, 1)
    refused(read, count, index=count, line=f"for a vector of {count} i32")
    refused(read, -1, index=-1)
    refused(write, 0, count, index=f"0, {count}", line="m[j, k] = 1")
    refused(write, 2, 0, index="2, 0")


def test_clamped_components_of_variables():
    ti.init(offline_cache=False, bounds="clamp")

    @ti.kernel
    def kernel(j: ti.i32, k: ti.i32) -> ti.types.vector(2, ti.i32):
        m = ti.Matrix([[1, 2, 3], [4, 5, 6]])
        old = m[j, k]
        m[j, k] = 10
        return ti.Vector([old, m[1, 0]])

    assert kernel(-3, 5).to_list() == [3, 4] and kernel(9, -1).to_list() == [4, 10]
