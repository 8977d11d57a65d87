"""PyTorch and tai on one GPU: memory is shared, and work is in order on any stream.

Needs a GPU and a torch that uses it: `pytest --arch=cuda`.
"""

import os

import numpy as np
import pytest
import tai as ti


def find_torch():
    """torch, or why these tests cannot run."""
    if os.environ.get("TI_ARCH") != "cuda" or os.environ.get("TAI_CUDA_EMULATION") == "1":
        return None, "needs a GPU: pytest --arch=cuda"
    try:
        import torch
    except ImportError:
        return None, "needs torch"
    if not torch.cuda.is_available():
        return None, "torch is here, but sees no GPU"
    return torch, ""


torch, missing = find_torch()
pytestmark = pytest.mark.skipif(torch is None, reason=missing)

N = 1 << 20


@pytest.fixture(params=["default stream", "another stream"])
def stream(request):
    """Torch's current stream while the test runs."""
    chosen = torch.cuda.default_stream() if request.param[0] == "d" else torch.cuda.Stream()
    with torch.cuda.stream(chosen):
        yield chosen
    torch.cuda.synchronize()


@ti.kernel
def scale(a: ti.types.ndarray(dtype=ti.f32, ndim=1), by: ti.f32):
    for i in range(a.shape[0]):
        a[i] *= by


def slowly(tensor, times=200):
    """Work that keeps the stream busy for a while."""
    for _ in range(times):
        tensor += 1.0


def test_views_change_with_the_field(stream):
    x = ti.field(ti.f32, shape=N)

    @ti.kernel
    def add(by: ti.f32):
        for i in x:
            x[i] += by

    x.fill(1.0)
    view = torch.from_dlpack(x)
    assert view.is_cuda and view.shape == (N,)
    for _ in range(50):
        add(1.0)
    # The stream waits for the launches, without the host.
    ti.let_stream_wait()
    assert (view == 51.0).all().item()
    slowly(view)
    ti.wait_for_stream()
    add(1.0)
    assert x[7] == 252.0
    assert x.to_numpy()[N - 1] == 252.0
    x[3] = 5.0
    ti.let_stream_wait()
    assert view[3].item() == 5.0


def test_from_dlpack_asks_the_stream_to_wait(stream):
    x = ti.field(ti.f32, shape=N)

    @ti.kernel
    def add():
        for i in x:
            x[i] += 1

    for _ in range(200):
        add()
    assert (torch.from_dlpack(x) == 200.0).all().item()


def test_tensors_as_arguments(stream):
    t = torch.zeros(N, device="cuda")
    for _ in range(5):
        slowly(t)
        scale(t, 2.0)
        t -= 1.0
    expected = 0.0
    for _ in range(5):
        expected = (expected + 200) * 2 - 1
    assert (t == expected).all().item()
    found = ti.from_dlpack(t)
    scale(found, 0.5)
    ti.let_stream_wait()
    assert (t == expected / 2).all().item()


def test_copies_stay_on_the_gpu(stream):
    x = ti.Vector.field(2, ti.f32, shape=N)

    @ti.kernel
    def add():
        for i in x:
            x[i] += ti.Vector([1.0, 2.0])

    t = torch.zeros(N, 2, device="cuda")
    slowly(t)
    x.from_torch(t)
    add()
    copy = x.to_torch(device="cuda")
    add()
    assert copy.is_cuda and copy.data_ptr() != torch.from_dlpack(x).data_ptr()
    torch.testing.assert_close(copy[5].cpu(), torch.tensor([201.0, 202.0]))
    torch.testing.assert_close(x.to_torch()[5], torch.tensor([202.0, 204.0]))
    x.from_torch(t.double())
    assert x[1][1] == 200.0


def test_autograd_without_the_host(stream):
    n = 4096
    x = ti.field(ti.f32, shape=n, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def cubes():
        for i in x:
            loss[None] += x[i] ** 3 / n

    class Cubes(torch.autograd.Function):
        tape = None

        @staticmethod
        def forward(ctx, given):
            x.from_torch(given)
            loss.fill(0.0)
            if Cubes.tape is None:
                with ti.ad.Tape(loss) as Cubes.tape:
                    cubes()
            else:
                Cubes.tape.replay()
            ctx.gradient = x.grad.to_torch(device=given.device)
            return loss.to_torch(device=given.device)

        @staticmethod
        def backward(ctx, bar):
            return bar * ctx.gradient

    for seed in range(6):
        given = torch.randn(n, device="cuda", generator=torch.Generator("cuda").manual_seed(seed))
        given.requires_grad_()
        value = Cubes.apply(given)
        (2.0 * value).backward()
        exact = given.detach().double()
        torch.testing.assert_close(value.double(), (exact**3).mean(), rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(given.grad.double(), 6 * exact**2 / n, rtol=1e-4, atol=1e-7)


def test_gradients_of_tensors_by_hand(stream):
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def squares(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in range(a.shape[0]):
            loss[None] += a[i] ** 2

    t = torch.arange(100, dtype=torch.float32, device="cuda", requires_grad=True)
    squares(t)
    loss.grad[None] = 1.0
    squares.grad(t)
    torch.testing.assert_close(t.grad.cpu(), 2 * torch.arange(100, dtype=torch.float32))
    t.grad = None
    with ti.ad.Tape(loss):
        squares(t)
    torch.testing.assert_close(t.grad.cpu(), 2 * torch.arange(100, dtype=torch.float32))


def test_what_kernels_cannot_take():
    with pytest.raises(ti.TaiRuntimeTypeError, match="not contiguous"):
        scale(torch.zeros(10, 2, device="cuda")[:, 0], 2.0)
    if torch.cuda.device_count() > 1:
        with pytest.raises(ti.TaiRuntimeTypeError, match="GPU number 1"):
            scale(torch.zeros(4, device="cuda:1"), 2.0)


def test_views_outlive_the_program():
    x = ti.field(ti.f64, shape=1000)
    x.fill(3.0)
    view = torch.from_dlpack(x)
    ti.init(arch=ti.cuda, offline_cache=False)
    y = ti.field(ti.f64, shape=1000)
    y.fill(5.0)
    assert (view == 3.0).all().item()
    np.testing.assert_array_equal(y.to_numpy(), 5.0)
