"""Operators of torch: tensors without dense memory, batches without elements, shapes of results."""

import numpy as np
import pytest
import tai as ti

torch = pytest.importorskip("torch", reason="torch is not installed")


@ti.kernel
def multiply(x: ti.types.ndarray(), w: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * w[i]


def test_a_sparse_tensor_after_a_dense_one():
    """The types of the second call are known, so that it may go another way."""
    operator = ti.torch.wrap(multiply, outputs={"y": "x"})
    x = torch.ones(3, requires_grad=True)
    operator(x, torch.ones(3))
    for given in ((x, torch.ones(3).to_sparse()), (torch.ones(3).to_sparse(), x)):
        with pytest.raises(ti.TaiRuntimeTypeError, match="is sparse: kernels take dense memory"):
            operator(*given)


@pytest.mark.parametrize("in_dims", [(0, 0), (0, None), (None, 1)])
def test_a_batch_without_elements(in_dims):
    operator = ti.torch.wrap(multiply, outputs={"y": "x"})
    shapes = {0: (0, 3), 1: (3, 0), None: (3,)}
    x, w = (torch.rand(shapes[d], requires_grad=True) for d in in_dims)
    y = torch.vmap(operator, in_dims=in_dims)(x, w)
    assert y.shape == (0, 3) and y.requires_grad
    y.sum().backward()
    for one in (x, w):
        assert one.grad.shape == one.shape and not one.grad.any()
    gradient = torch.func.grad(lambda x, w: operator(x, w).sum(), argnums=(0, 1))
    found = torch.vmap(gradient, in_dims=in_dims)(x.detach(), w.detach())
    assert [one.shape for one in found] == [(0, 3), (0, 3)]


def test_a_batch_without_elements_of_two_results():
    def both(x, y, z):
        multiply(x, x.detach(), y)
        multiply(x, x.detach(), z)

    operator = ti.torch.wrap(both, outputs={"y": "x", "z": lambda x: 1})
    found = torch.vmap(operator)(torch.rand(0, 3, dtype=torch.float64))
    assert [one.shape for one in found] == [(0, 3), (0, 1)]
    assert found[1].dtype == torch.float64


@pytest.mark.parametrize("answer", ["a", -1, (2, -1), (2, "a"), None, 1.5])
def test_an_answer_that_is_no_shape(answer):
    operator = ti.torch.wrap(multiply, outputs={"y": lambda x, w: answer})
    with pytest.raises(ti.TaiRuntimeTypeError, match="as the shape of 'y'") as caught:
        operator(torch.rand(3), torch.rand(3))
    assert "(x.shape[0], 3)" in caught.value.hint


@pytest.mark.parametrize("answer", [3, np.int64(3), [3], torch.Size([3])])
def test_answers_that_are_shapes(answer):
    operator = ti.torch.wrap(multiply, outputs={"y": lambda x, w: answer})
    assert operator(torch.full((3,), 2.0), torch.full((3,), 3.0)).tolist() == [6, 6, 6]


def test_a_tensor_of_a_fraction_for_a_whole_number():
    @ti.kernel
    def fill(x: ti.types.ndarray(), n: ti.i32, y: ti.types.ndarray()):
        for i in range(n):
            y[i] = x[i]

    operator = ti.torch.wrap(fill, outputs={"y": "x"})
    with pytest.raises(ti.TaiRuntimeTypeError, match="'n' .* is a whole number") as caught:
        operator(torch.ones(3), torch.tensor(2.5))
    assert "int(n)" in caught.value.hint
    assert operator(torch.ones(3), torch.tensor(2)).tolist() == [1, 1, 0]
