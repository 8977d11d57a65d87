"""Operators of torch and JAX whose iterations store to one element: value and gradient agree."""

import warnings

import numpy as np
import pytest
import tai as ti

SIZES = [1, 3, 65537]


@ti.kernel
def last_square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        v = x[i]
        # The first half takes longer, so that it ends last where several threads run.
        for _ in range(400 if i < x.shape[0] // 2 else 1):
            v = ti.sqrt(v * v)
        y[0] = v * x[i]


@ti.kernel
def by_index(x: ti.types.ndarray(), p: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        v = x[i]
        for _ in range(400 if i < x.shape[0] // 2 else 1):
            v = ti.sqrt(v * v)
        y[p[i]] = v * x[i]


@ti.kernel
def apart(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def of_each(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        if ti.static(len(x.shape) == 2):
            y[0, 0] = x[i, 0] * x[i, 1]
        else:
            y[i] = x[i] * x[i]


def two_steps(x, y):
    middle = ti.ndarray(ti.f64, x.shape, needs_grad=True)
    apart(x, middle)
    last_square(middle, y)


def apart_or_not(x, y, joins: bool):
    if joins:
        last_square(x, y)
    else:
        apart(x, y)


def numbers(count):
    return np.random.default_rng(count).uniform(0.5, 2.0, count)


def check(x, value, gradient, expected, slope):
    """Compares with the last iteration, whose value and gradient are exact or nearly so."""
    assert abs(value - expected(x[-1])) <= 1e-14 * abs(value)
    wanted = np.zeros_like(x)
    wanted[-1] = slope(x[-1])
    np.testing.assert_allclose(gradient, wanted, rtol=1e-13, atol=0)


class TestTorch:
    torch = None

    @pytest.fixture(autouse=True)
    def tensors(self):
        TestTorch.torch = pytest.importorskip("torch", reason="torch is not installed")

    def leaf(self, x):
        return self.torch.tensor(x, requires_grad=True)

    @pytest.mark.parametrize("count", SIZES)
    def test_torch_value_is_of_the_iteration_of_the_gradient(self, count):
        operator = ti.torch.wrap(last_square, outputs={"y": lambda x: (1,)})
        x = numbers(count)
        for _ in range(3):
            leaf = self.leaf(x)
            value = operator(leaf)
            value.sum().backward()
            check(x, value.item(), leaf.grad.numpy(), lambda v: v * v, lambda v: 2 * v)
            assert operator(leaf.detach()).item() == value.item()

    @pytest.mark.parametrize("count", SIZES)
    def test_torch_operator_twice(self, count):
        operator = ti.torch.wrap(last_square, outputs={"y": lambda x: (1,)})
        x = numbers(count)
        leaf = self.leaf(x)
        first, second = operator(leaf), operator(leaf * leaf)
        (first * second).sum().backward()
        check(x, (first * second).item(), leaf.grad.numpy(), lambda v: v**6, lambda v: 6 * v**5)

    @pytest.mark.parametrize("count", SIZES)
    def test_torch_compiled(self, count):
        operator = ti.torch.wrap(last_square, outputs={"y": lambda x: (1,)})
        compiled = self.torch.compile(
            lambda x: (operator(x) * 3).sum(), fullgraph=True, backend="aot_eager"
        )
        x = numbers(count)
        leaf = self.leaf(x)
        value = compiled(leaf)
        value.backward()
        check(x, value.item(), leaf.grad.numpy(), lambda v: 3 * v * v, lambda v: 6 * v)

    @pytest.mark.parametrize("count", SIZES)
    def test_torch_function_of_two_kernels(self, count):
        operator = ti.torch.wrap(two_steps, outputs={"y": lambda x: (1,)})
        x = numbers(count)
        for _ in range(2):
            leaf = self.leaf(x)
            value = operator(leaf)
            value.sum().backward()
            check(x, value.item(), leaf.grad.numpy(), lambda v: v**4, lambda v: 4 * v**3)

    @pytest.mark.parametrize("count", SIZES)
    def test_torch_indices_from_data(self, count):
        operator = ti.torch.wrap(by_index, outputs={"y": lambda x, p: (7,)})
        x = numbers(count)
        p = np.random.default_rng(count).integers(0, 7, count).astype(np.int32)
        leaf = self.leaf(x)
        value = operator(leaf, self.torch.tensor(p))
        (value * self.torch.arange(1, 8)).sum().backward()
        owner = {place: number for number, place in enumerate(p.tolist())}
        expected, slope = np.zeros(7), np.zeros(count)
        for place, number in owner.items():
            expected[place] = x[number] ** 2
            slope[number] = 2 * x[number] * (place + 1)
        np.testing.assert_allclose(value.detach().numpy(), expected, rtol=1e-14)
        np.testing.assert_allclose(leaf.grad.numpy(), slope, rtol=1e-13)

    def test_torch_numbers_of_dimensions_are_told_apart(self):
        operator = ti.torch.wrap(of_each, outputs={"y": "x"})
        for shape in ((4,), (4, 2), (4,), (4, 2)):
            leaf = self.torch.arange(1.0, 1 + np.prod(shape)).reshape(shape).requires_grad_()
            value = operator(leaf)
            value.sum().backward()
            if len(shape) == 1:
                assert leaf.grad.tolist() == [2, 4, 6, 8]
            else:
                assert value[0, 0].item() == 56
                assert leaf.grad.tolist() == [[0, 0]] * 3 + [[8, 7]]

    def test_torch_function_that_launches_another_kernel_later(self):
        operator = ti.torch.wrap(apart_or_not, outputs={"y": "x"})
        x = self.leaf(numbers(3))
        operator(x, False).sum().backward()
        value = operator(x, True)
        with pytest.raises(ti.TaiAutodiffError, match="call it again"):
            value.sum().backward()
        x.grad = None
        operator(x, True).sum().backward()
        assert x.grad[:2].tolist() == [0, 0] and x.grad[2] != 0


class TestJax:
    jax = None

    @pytest.fixture(autouse=True)
    def wide(self):
        TestJax.jax = jax = pytest.importorskip("jax", reason="JAX is not installed")
        before = jax.config.jax_enable_x64
        jax.config.update("jax_enable_x64", True)
        ti.init()
        yield
        jax.config.update("jax_enable_x64", before)

    @pytest.mark.parametrize("is_compiled", [False, True])
    @pytest.mark.parametrize("count", SIZES)
    def test_jax_value_is_of_the_iteration_of_the_gradient(self, count, is_compiled):
        operator = ti.jax.wrap(last_square, outputs={"y": lambda x: (1,)})
        run = self.jax.value_and_grad(lambda x: operator(x).sum())
        run = self.jax.jit(run) if is_compiled else run
        x = numbers(count)
        for _ in range(3):
            value, gradient = run(x)
            check(x, float(value), np.array(gradient), lambda v: v * v, lambda v: 2 * v)

    @pytest.mark.parametrize("count", SIZES)
    def test_jax_gradient_before_the_value(self, count):
        operator = ti.jax.wrap(last_square, outputs={"y": lambda x: (1,)})
        run = lambda x: operator(x).sum()  # noqa: E731
        x = numbers(count)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # XLA drops a value that nobody asks for, and its forward run with it.
            gradient = self.jax.jit(self.jax.grad(run))(x)
            value = run(x)
        check(x, float(value), np.array(gradient), lambda v: v * v, lambda v: 2 * v)

    @pytest.mark.parametrize("count", SIZES)
    def test_jax_operator_twice(self, count):
        operator = ti.jax.wrap(last_square, outputs={"y": lambda x: (1,)})
        run = self.jax.jit(self.jax.value_and_grad(lambda x: (operator(x) * operator(x * x)).sum()))
        x = numbers(count)
        value, gradient = run(x)
        check(x, float(value), np.array(gradient), lambda v: v**6, lambda v: 6 * v**5)

    @pytest.mark.parametrize("count", SIZES)
    def test_jax_function_of_two_kernels(self, count):
        operator = ti.jax.wrap(two_steps, outputs={"y": lambda x: (1,)})
        run = self.jax.jit(self.jax.value_and_grad(lambda x: operator(x).sum()))
        x = numbers(count)
        for _ in range(2):
            value, gradient = run(x)
            check(x, float(value), np.array(gradient), lambda v: v**4, lambda v: 4 * v**3)
