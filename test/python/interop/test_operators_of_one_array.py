"""Operators that get one array twice, and functions that compute with torch between kernels."""

import warnings

import numpy as np
import pytest
import tai as ti
from tai._impl.frameworks.parameters import copy_shared


@ti.kernel
def mix(x: ti.types.ndarray(), w: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i] * w[i]


@ti.kernel
def twice(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = 2 * x[i]


def mix_steps(x, w, y):
    middle = ti.ndarray(ti.f64, x.shape, needs_grad=True)
    mix(x, w, middle)
    twice(middle, y)


def test_only_arrays_in_earlier_memory_are_copied():
    a, b = np.zeros(2), np.ones(2)
    found = copy_shared([a, 3, a[:], b], lambda v: getattr(v, "ctypes", None) and v.ctypes.data,
                        np.copy)  # fmt: skip
    assert found[0] is a and found[1] == 3 and found[3] is b
    assert not np.shares_memory(found[2], a) and found[2].tolist() == [0, 0]


@pytest.mark.parametrize("function", [mix, mix_steps], ids=lambda f: f.__name__)
def test_one_tensor_for_two_inputs(function):
    torch = pytest.importorskip("torch", reason="torch is not installed")
    ti.init()
    factor = 1 if function is mix else 2
    op = ti.torch.wrap(function, outputs={"y": "x"})
    x = torch.tensor([1.0, 2.0], dtype=torch.float64, requires_grad=True)
    for _ in range(2):  # the first call compiles
        x.grad = None
        op(x, x).sum().backward()
        assert x.grad.tolist() == [factor * 3.0, factor * 12.0]
    whole = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64, requires_grad=True)
    op(whole[:2], whole[1:]).sum().backward()  # overlapping parts of one tensor
    assert whole.grad.tolist() == [factor * 4.0, factor * 13.0, factor * 4.0]


@pytest.mark.parametrize("function", [mix, mix_steps], ids=lambda f: f.__name__)
def test_one_array_of_jax_for_two_inputs(function):
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    ti.init()
    jax.config.update("jax_enable_x64", True)
    factor = 1 if function is mix else 2
    f = ti.jax.wrap(function, outputs={"y": "x"})
    gradient = jax.grad(lambda x: f(x, x).sum())
    for call in (gradient, jax.jit(gradient)):
        assert call(jax.numpy.array([1.0, 2.0])).tolist() == [factor * 3.0, factor * 12.0]


def test_a_function_that_computes_with_torch():
    torch = pytest.importorskip("torch", reason="torch is not installed")
    ti.init()

    def steps(x, y):
        scale = torch.ones_like(x) * 3  # a constant
        middle = x.new_zeros(x.shape, requires_grad=x.requires_grad)
        mix(x, scale, middle)
        twice(middle, y)

    def wrong(x, y):
        middle = x.new_zeros(x.shape, requires_grad=x.requires_grad)
        twice(x, middle)
        twice(middle.exp(), y)

    x = torch.ones(2, dtype=torch.float64)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ti.torch.wrap(steps, outputs={"y": "x"})(x).tolist() == [6, 6]
    op = ti.torch.wrap(wrong, outputs={"y": "x"})
    with pytest.warns(ti.ad.TaiGradientWarning, match=r"'wrong' computes with torch \(exp\)") as c:
        op(x)
    assert [w.filename for w in c] == [__file__]
