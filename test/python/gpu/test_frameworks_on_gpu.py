"""Kernels as operators of torch and functions of JAX, on a GPU that both libraries use.

`scripts/test_gpu.py --tests -k frameworks_on_gpu` runs these tests.
"""

import importlib.util

import numpy as np
import pytest
import tai as ti

from device_tensors import ON_GPU

pytestmark = pytest.mark.skipif(not ON_GPU, reason="needs a GPU")


@ti.kernel
def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def cube_by_steps(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]
        y[i] = y[i] * x[i]


KERNELS = {"stores": (square, 2), "reads its output": (cube_by_steps, 3)}


@pytest.fixture
def torch():
    found = pytest.importorskip("torch", reason="torch is not installed")
    if not found.cuda.is_available():
        pytest.skip("torch has no GPU")
    return found


@pytest.fixture
def jax(monkeypatch):
    # Else JAX takes three quarters of the memory at once.
    monkeypatch.setenv("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    found = pytest.importorskip("jax", reason="JAX is not installed: pip install jax[cuda12]")
    if not any(device.platform == "gpu" for device in found.devices()):
        pytest.skip("JAX has no GPU: pip install jax[cuda12]")
    before = found.config.jax_enable_x64
    found.config.update("jax_enable_x64", True)
    yield found
    found.config.update("jax_enable_x64", before)


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("n", [1, 5, 65_537])
def test_values_and_gradients_of_torch(torch, name, n):
    kernel, power = KERNELS[name]
    operator = ti.torch.wrap(kernel, outputs={"y": "x"})
    x = torch.linspace(0.5, 1.5, n, dtype=torch.float64, device="cuda").requires_grad_()
    for _ in range(3):  # the first launch checks the inputs, later ones do not
        x.grad = None
        y = operator(x)
        assert y.is_cuda
        y.sum().backward()
        torch.testing.assert_close(y, x.detach() ** power)
        torch.testing.assert_close(x.grad, power * x.detach() ** (power - 1))


@pytest.mark.parametrize("name", KERNELS)
def test_gradcheck_of_torch(torch, name):
    kernel, _ = KERNELS[name]
    operator = ti.torch.wrap(kernel, outputs={"y": "x"})
    x = torch.rand(5, dtype=torch.float64, device="cuda").requires_grad_()
    assert torch.autograd.gradcheck(operator, (x,))


def test_results_lie_in_memory_of_torch(torch):
    operator = ti.torch.wrap(square, outputs={"y": "x"})
    x = torch.rand(1 << 20, dtype=torch.float32, device="cuda")
    operator(x)
    torch.cuda.synchronize()
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    y = operator(x)
    torch.cuda.synchronize()
    assert y.is_cuda and torch.cuda.max_memory_allocated() - before == y.nbytes


def test_streams_of_torch(torch):
    """Each launch waits for the stream's earlier work, and later work waits for the launch."""
    operator = ti.torch.wrap(square, outputs={"y": "x"})
    streams = [torch.cuda.Stream() for _ in range(2)]
    big = torch.rand(2048, 2048, device="cuda")
    x = torch.ones(1 << 20, dtype=torch.float64, device="cuda")
    torch.cuda.synchronize()
    for turn in range(20):
        found = []
        for number, stream in enumerate(streams):
            with torch.cuda.stream(stream):
                for _ in range(4):
                    big @ big  # the input is written late
                given = x * (turn + number)
                found.append(operator(given) + 1)
        torch.cuda.synchronize()
        for number, y in enumerate(found):
            assert torch.all(y == (turn + number) ** 2 + 1)


def test_a_training_loop_of_torch(torch):
    operator = ti.torch.wrap(square, outputs={"y": "x"})
    w = torch.full((257,), 2.0, dtype=torch.float64, device="cuda").requires_grad_()
    optimiser = torch.optim.SGD([w], lr=0.02)
    expected = w.detach().clone()
    for _ in range(50):
        optimiser.zero_grad()
        ((operator(w) - 1) ** 2).sum().backward()
        optimiser.step()
        expected -= 0.02 * 4 * (expected**2 - 1) * expected
    torch.testing.assert_close(w.detach(), expected)
    assert abs(w[0].item() - 1) < 1e-3


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="triton is not installed")
def test_compiled_by_torch(torch):
    operator = ti.torch.wrap(square, outputs={"y": "x"})

    @torch.compile(fullgraph=True)
    def loss(x):
        return operator(torch.sin(x)).sum()

    x = torch.rand(33, dtype=torch.float64, device="cuda").requires_grad_()
    loss(x).backward()
    torch.testing.assert_close(x.grad, torch.sin(2 * x.detach()))


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("n", [1, 5, 65_537])
@pytest.mark.parametrize("is_jitted", [False, True])
def test_values_and_gradients_of_jax(jax, name, n, is_jitted):
    kernel, power = KERNELS[name]
    operator = ti.jax.wrap(kernel, outputs={"y": "x"})
    slope = jax.grad(lambda x: operator(x).sum())
    if is_jitted:
        operator, slope = jax.jit(operator), jax.jit(slope)
    x = jax.numpy.linspace(0.5, 1.5, n)
    for _ in range(3):
        y, gradient = operator(x), slope(x)
        assert next(iter(y.devices())).platform == "gpu"
        np.testing.assert_allclose(y, np.asarray(x) ** power)
        np.testing.assert_allclose(gradient, power * np.asarray(x) ** (power - 1))


@pytest.mark.parametrize("name", KERNELS)
def test_transforms_of_jax(jax, name):
    kernel, power = KERNELS[name]
    operator = ti.jax.wrap(kernel, outputs={"y": "x"})
    x = jax.numpy.linspace(0.5, 1.5, 12).reshape(3, 4)
    expected = power * np.asarray(x) ** (power - 1)
    slope = jax.grad(lambda x: operator(x).sum())
    np.testing.assert_allclose(jax.jit(jax.vmap(slope))(x), expected)
    np.testing.assert_allclose(jax.jacrev(operator)(x[0]), np.diag(expected[0]))

    def scanned(x):
        return jax.lax.scan(lambda c, _: (0.5 * operator(c), None), x, None, length=3)[0].sum()

    from jax.test_util import check_grads

    check_grads(scanned, (x[0],), order=1, modes=["rev"])


def test_work_of_jax_before_and_after(jax):
    """The kernel waits for what XLA computes before it, and XLA waits for the kernel."""
    operator = ti.jax.wrap(square, outputs={"y": "x"})

    @jax.jit
    def step(x, big):
        for _ in range(4):
            big = big @ big / 2048
        return operator(x + 0 * big[0, 0]) + 1

    big = jax.numpy.ones((2048, 2048))
    for turn in range(20):
        x = jax.numpy.full(1 << 20, float(turn))
        assert bool((step(x, big) == turn**2 + 1).all())
