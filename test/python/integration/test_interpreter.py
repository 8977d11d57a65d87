"""`ti.init(arch=ti.python)`: kernels and gradients without a compiler."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def interpreted(monkeypatch):
    monkeypatch.delenv("TI_ARCH", raising=False)
    ti.init(arch=ti.python, default_fp=ti.f64, offline_cache=False)


def test_a_kernel_with_arguments_and_a_result():
    x = ti.Vector.field(2, ti.f32, shape=5)

    @ti.kernel
    def fill(a: ti.i32, v: ti.math.vec2) -> ti.f64:
        for i in x:
            x[i] = [i * a, v.sum()]
        return v[0] - v[1]

    assert fill(3, ti.Vector([1.5, 0.25])) == 1.25
    assert x.to_numpy().tolist() == [[3.0 * i, 1.75] for i in range(5)]


def test_the_gradient_of_a_tape():
    x = ti.field(ti.f64, shape=4, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def energy():
        for i in x:
            y = x[i]
            for _ in range(i):
                y *= ti.sin(y)
            loss[None] += y**2

    x.from_numpy(np.array([0.3, 0.7, 1.1, -0.4]))
    with ti.ad.Tape(loss):
        energy()
    found = x.grad.to_numpy(), loss[None]
    ti.init(arch=ti.cpu, default_fp=ti.f64, offline_cache=False)
    x = ti.field(ti.f64, shape=4, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.array([0.3, 0.7, 1.1, -0.4]))
    with ti.ad.Tape(loss):
        energy()
    np.testing.assert_allclose(found[0], x.grad.to_numpy(), rtol=1e-13)
    assert found[1] == pytest.approx(loss[None], rel=1e-14)


def test_an_index_out_of_range_names_the_line():
    x = ti.field(ti.f32, shape=4)
    at = ti.field(ti.i32, shape=())
    at[None] = 4

    @ti.kernel
    def set_one():
        x[at[None]] = 1.0

    with pytest.raises(ti.TaichiAssertionError, match=r"index \[4\] is out of range") as error:
        set_one()
    assert error.value.lineno is not None


def test_an_array_of_the_caller():
    @ti.kernel
    def scale(a: ti.types.ndarray(dtype=ti.i16, ndim=2), by: ti.i16):
        for i, j in a:
            a[i, j] *= by

    array = np.arange(6, dtype=np.int16).reshape(2, 3) * 9000
    expected = array * np.int16(3)
    scale(array, 3)
    assert array.tolist() == expected.tolist()


def test_cells_that_become_active():
    x = ti.field(ti.i32)
    ti.root.pointer(ti.i, 8).dense(ti.i, 4).place(x)
    visited = ti.field(ti.i32, shape=())

    @ti.kernel
    def fill():
        for i in range(32):
            if i % 9 == 0:
                x[i] = i

    @ti.kernel
    def visit():
        for _i in x:
            visited[None] += 1

    fill()
    visit()
    assert visited[None] == 16
    assert x.to_numpy().sum() == 0 + 9 + 18 + 27
