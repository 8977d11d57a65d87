"""Cases that random trees have shown once: writes, fills and lists of sparse levels."""

import numpy as np
import pytest
import tai as ti


@pytest.mark.parametrize("value", [3, [3, 3]], ids=["number", "vector"])
@pytest.mark.parametrize("split", [False, True], ids=["together", "split"])
def test_fill_sets_what_is_active(split, value):
    x = ti.Vector.field(2, ti.i32)
    level = ti.root.pointer(ti.i, 8)
    if split:
        level.place(x.get_scalar_field(0), x.get_scalar_field(1))
    else:
        level.place(x)
    x[5] = [1, 2]
    x.fill(value if isinstance(value, int) else ti.Vector(value))
    assert level.active_cells().tolist() == [[5]]
    expected = np.zeros((8, 2), np.int32)
    expected[5] = 3
    np.testing.assert_array_equal(x.to_numpy(), expected)


@pytest.mark.parametrize("value", [0, 5])
@pytest.mark.parametrize("step", [1, 3, 700])
@pytest.mark.parametrize("inner", [1, 4])
def test_fill_between_kernels(step, value, inner):
    """Few or many cells, alone or side by side, of one of two fields that share them."""
    x, y = ti.field(ti.i32), ti.field(ti.f64)
    level = ti.root.pointer(ti.i, 2000)
    (level.dense(ti.i, inner) if inner > 1 else level).place(x, y)

    @ti.kernel
    def write():
        for b in range(2000):
            if b % step == 0:
                for k in range(inner):
                    x[b * inner + k] = b + 1
                    y[b * inner + k] = 2 * b

    write()
    x.fill(value)
    cells = np.repeat(np.arange(2000), inner)
    active = cells % step == 0
    np.testing.assert_array_equal(x.to_numpy(), np.where(active, value, 0))
    np.testing.assert_array_equal(y.to_numpy(), np.where(active, 2 * cells, 0))
    assert level.num_active == -(-2000 // step)


@pytest.mark.parametrize("step", [1, 3, 700])
@pytest.mark.parametrize("nested", [False, True])
def test_deactivate_all_between_kernels(step, nested):
    x, y = ti.field(ti.i32), ti.field(ti.i32, shape=2000)
    outer = ti.root.pointer(ti.i, 500)
    level = outer.bitmasked(ti.i, 4) if nested else ti.root.bitmasked(ti.i, 2000)
    level.place(x)

    @ti.kernel
    def write(first: ti.i32):
        for i in range(2000):
            if i % step == first % step:
                x[i] = i + 1

    @ti.kernel
    def read():
        for i in x:
            y[i] += x[i]

    expected = np.zeros(2000, np.int32)
    where = np.arange(2000)
    for first in range(3):
        write(first)
        read()
        expected += np.where(where % step == first % step, where + 1, 0)
        (outer if nested else level).deactivate_all()
        assert level.num_active == 0
    np.testing.assert_array_equal(y.to_numpy(), expected)
    assert not x.to_numpy().any()


def test_fill_of_a_component():
    x = ti.Vector.field(2, ti.f32, shape=3)
    x.fill(1)
    x.get_scalar_field(1).fill(4)
    np.testing.assert_array_equal(x.to_numpy(), [[1, 4]] * 3)


def test_equal_indices_may_mean_other_cells():
    """Two fields below one level, of which each divides its cells in its own way."""
    x, y = ti.field(ti.i32), ti.field(ti.i32)
    block = ti.root.pointer(ti.i, 4)
    block.dense(ti.i, 8).place(x)
    block.dense(ti.i, 2).place(y)

    @ti.kernel
    def copy():
        for i in x:
            if i < 8:
                y[i] = i + 1

    x[3] = 1  # block 0: elements 0 to 7 of x, 0 and 1 of y
    copy()
    assert block.active_cells().ravel().tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(y.to_numpy(), np.arange(1, 9))
    block.deactivate_all()
    assert not y.to_numpy().any()


def test_lists_of_a_field_with_an_offset():
    x = ti.field(ti.i32)
    lists = ti.root.dense(ti.i, 3)
    lists.dynamic(ti.j, 4).place(x, offset=(-2, 5))

    @ti.kernel
    def run() -> ti.i32:
        x[-2].append(7)
        x[0].append(8)
        x[0].append(9)
        x[-2].deactivate()
        return x[0].length() * 10 + x[-2].length()

    assert run() == 20
    np.testing.assert_array_equal(x.to_numpy(), [[0, 0, 0, 0], [0, 0, 0, 0], [8, 9, 0, 0]])


@pytest.mark.parametrize("kind", ["pointer", "bitmasked", "hash", "dynamic"])
@pytest.mark.parametrize("index", [-1, 16, 1 << 30])
def test_activity_out_of_range(kind, index):
    """An error without the checks of debug mode, too, and nothing changes."""
    x = ti.field(ti.i32)
    level = getattr(ti.root, kind)(ti.i, 16)
    level.place(x)

    @ti.kernel
    def activate(i: ti.i32):
        ti.activate(level, i)

    @ti.kernel
    def deactivate(i: ti.i32):
        ti.deactivate(level, i)

    x[3] = 5
    active = level.num_active
    for kernel in (activate, deactivate):
        with pytest.raises(ti.TaiError, match="out of range"):
            kernel(index)
            ti.sync()
    assert level.num_active == active
    assert x[3] == 5


def test_append_to_a_list_out_of_range():
    x = ti.field(ti.i32)
    ti.root.dense(ti.i, 3).dynamic(ti.j, 4).place(x)

    @ti.kernel
    def append(i: ti.i32):
        x[i].append(1)

    with pytest.raises(ti.TaiError, match=r"index \[3\] is out of range"):
        append(3)
        ti.sync()
    append(2)
    assert x[2, 0] == 1


def test_a_dense_gradient_of_a_sparse_field():
    x, loss = ti.field(ti.f64), ti.field(ti.f64, shape=(), needs_grad=True)
    level = ti.root.pointer(ti.i, 4)
    level.place(x)
    ti.root.dense(ti.i, 4).place(x.grad)

    @ti.kernel
    def square():
        for i in x:
            loss[None] += x[i] ** 2

    x[2] = 3
    loss.grad[None] = 1
    square.grad()
    np.testing.assert_array_equal(x.grad.to_numpy(), [0, 0, 6, 0])
