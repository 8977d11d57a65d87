"""Loops over the rows of a matrix that are unrolled along each of them."""

import numpy as np
import pytest
import tai as ti


def integers(shape, seed: int) -> np.ndarray:
    """Small whole numbers, whose products and sums are exact in every order."""
    return np.random.default_rng(seed).integers(-4, 5, shape)


@pytest.mark.parametrize("dtype", [ti.f32, ti.f64])
@pytest.mark.parametrize("rows", [5, 32, 45])
@pytest.mark.parametrize("columns", [3, 4, 13, 40])
@pytest.mark.parametrize("deterministic", [False, True])
def test_layer(dtype, rows, columns, deterministic):
    """y = W x and its gradients, for numbers of rows and columns that leave remainders."""
    ti.init(arch=ti.cpu, deterministic=deterministic)
    w = ti.field(dtype, shape=(rows, columns), needs_grad=True)
    x = ti.field(dtype, shape=columns, needs_grad=True)
    y = ti.field(dtype, shape=rows, needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)

    @ti.kernel
    def layer():
        for i in range(rows):
            total = x[0] * 0.0
            for j in ti.static(range(columns)):
                total += w[i, j] * x[j]
            y[i] = total

    @ti.kernel
    def square():
        for i in range(rows):
            loss[None] += y[i] * y[i]

    weights, inputs = integers((rows, columns), 1), integers(columns, 2)
    w.from_numpy(weights.astype(float))
    x.from_numpy(inputs.astype(float))
    with ti.ad.Tape(loss):
        layer()
        square()
    outputs = weights @ inputs
    np.testing.assert_array_equal(y.to_numpy(), outputs)
    np.testing.assert_array_equal(w.grad.to_numpy(), 2 * np.outer(outputs, inputs))
    np.testing.assert_array_equal(x.grad.to_numpy(), 2 * outputs @ weights)


def test_columns_in_place():
    """Rows that are read and changed, in columns that are not in order."""
    ti.init(arch=ti.cpu)
    a = ti.field(ti.f32, shape=(40, 11))
    order = [3, 1, 2, 0, 8, 10, 9, 7, 6]

    @ti.kernel
    def update(scale: ti.f32):
        for i in range(40):
            for j in ti.static(order):
                a[i, j] = a[i, j] * scale + a[i, (j + 1) % 11]

    before = integers((40, 11), 3).astype(np.float32)
    a.from_numpy(before)
    update(3.0)
    expected = before.copy()
    for j in order:
        expected[:, j] = expected[:, j] * 3 + expected[:, (j + 1) % 11]
    np.testing.assert_array_equal(a.to_numpy(), expected)
