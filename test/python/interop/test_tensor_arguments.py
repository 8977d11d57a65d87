"""Tensors as arguments of kernels, and kernels as functions of torch.

On a GPU with torch these are its tensors; elsewhere stand-ins on the emulated device, and
tensors of torch on the CPU where it is there.
"""

import numpy as np
import pytest
import tai as ti

import device_tensors


@ti.kernel
def axpy(a: ti.f64, x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] += a * x[i]


@ti.kernel
def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def product(x: ti.types.ndarray(), w: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * w[i] + x[i]


def test_only_the_first_call_runs_python(library, slow_calls):
    x, y = library.tensor(np.arange(3.0)), library.tensor(np.zeros(3))
    told = library.parts()
    for _ in range(5):
        x.add_(1)
        axpy(2.0, x, y)
    assert library.numpy(y).tolist() == [30, 40, 50]
    # Tensors of another extent, and views that begin behind the first element.
    axpy(1.0, library.tensor(np.ones(7)), library.tensor(np.ones(7)))
    z = library.tensor(np.arange(6.0))
    axpy(1.0, z[1:3], y[1:])
    assert library.numpy(y).tolist() == [30, 41, 52]
    assert slow_calls == ["axpy"]
    if library.torch is None:
        assert library.parts() == told + 7


def test_other_types_are_other_kernels(library, slow_calls):
    @ti.kernel
    def double(x: ti.types.ndarray()):
        for i in ti.grouped(ti.ndrange(*x.shape)):
            x[i] *= 2

    @ti.kernel
    def twice(x: ti.types.ndarray(ndim=1)):
        for i in range(x.shape[0]):
            x[i] *= 2

    for dtype in ("float32", "float64", "int32", "int64", "uint8", "int16"):
        t = library.tensor(np.arange(4).astype(dtype))
        for _ in range(2):
            twice(t)
        assert library.numpy(t).tolist() == [0, 4, 8, 12]
        assert str(library.numpy(t).dtype) == dtype
    assert len(slow_calls) == 6
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects 1 dimensions, but got 2"):
        twice(library.tensor(np.zeros((2, 2))))


def test_kernels_that_run_forward_make_no_gradient(library, slow_calls):
    x = library.tensor(np.arange(3.0), True)
    y = library.tensor(np.zeros(3), True)
    for _ in range(3):
        square(x, y)
    assert library.numpy(y).tolist() == [0, 1, 4]
    assert x.grad is None and y.grad is None
    # Tensors with and without a gradient need two compilations.
    square(x.detach(), y.detach())
    square(x, y)
    assert slow_calls == ["square", "square"]


def test_gradients_by_hand(library, slow_calls):
    x = library.tensor(np.arange(3.0), True)
    y = library.tensor(np.zeros(3), True)
    for n in range(1, 4):
        y.grad = library.tensor(np.array([1.0, 10, 100]))
        square.grad(x, y)
        assert library.numpy(x.grad).tolist() == [0, 20 * n, 400 * n]
        assert library.numpy(y.grad).tolist() == [0, 0, 0]
    assert slow_calls == ["square.grad"]
    # Missing gradients are made.
    x.grad = None
    y.grad.copy_(np.ones(3) if library.torch is None else library.tensor(np.ones(3)))
    square.grad(x, y)
    assert library.numpy(x.grad).tolist() == [0, 2, 4]
    assert slow_calls == ["square.grad"]


def test_gradients_of_some(library, slow_calls):
    x, w, y = (library.tensor(np.arange(3.0) + n, n != 1) for n in range(3))
    for n in range(1, 3):
        y.grad = library.tensor(np.ones(3))
        product.grad(x, w, y)
        assert library.numpy(x.grad).tolist() == [2 * n, 3 * n, 4 * n]
        assert w.grad is None
    assert slow_calls == ["product.grad"]


def test_the_same_tensor_twice(library):
    """Kernels that run forward see the memory as it is; gradients know it is one array."""
    x = library.tensor(np.arange(4.0), True)
    for _ in range(2):
        axpy(1.0, x, x)
    assert library.numpy(x).tolist() == [0, 4, 8, 12]
    y = library.tensor(np.zeros(4), True)
    for n in range(1, 3):
        y.grad = library.tensor(np.ones(4))
        product.grad(x, x, y)
        assert library.numpy(x.grad).tolist() == [1 * n, 9 * n, 17 * n, 25 * n]
    y.grad = library.tensor(np.ones(4))
    product.grad(x, y, library.tensor(np.zeros(4), True))  # of three different ones
    for _ in range(2):
        with pytest.raises(ti.TaiAutodiffError, match="arrays 'x' and 'w' .* overlap"):
            product.grad(x, x.detach(), y)


def test_parts_and_empty_tensors(library, slow_calls):
    whole = library.tensor(np.arange(6.0))
    for _ in range(2):
        axpy(1.0, whole[:2], whole[3:5])
    assert library.numpy(whole).tolist() == [0, 1, 2, 3, 6, 5]
    for _ in range(2):
        axpy(1.0, library.tensor(np.zeros(0)), library.tensor(np.zeros(0)))
    assert slow_calls == ["axpy"]
    empty = library.tensor(np.zeros(0), True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def total(x: ti.types.ndarray()):
        for i in range(x.shape[0]):
            loss[None] += x[i]

    with ti.ad.Tape(loss) as tape:
        total(empty)
    tape.replay()
    assert empty.grad.shape == (0,)


def test_what_kernels_cannot_take(library):
    @ti.kernel
    def double(a: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for i in range(a.shape[0]):
            a[i] *= 2

    for _ in range(2):
        with pytest.raises(ti.TaiRuntimeTypeError, match="'a' .* is not contiguous") as caught:
            double(library.tensor(np.zeros((4, 2)))[:, 0])
        assert "contiguous()" in caught.value.hint
        with pytest.raises(ti.TaiRuntimeTypeError, match="expects an array of f64, but got f32"):
            double(library.tensor(np.zeros(3, np.float32)))
        double(library.tensor(np.zeros(3)))
    t = library.tensor(np.zeros((4, 2)), True)[:, 0]
    if library.torch is None:
        t.requires_grad = True
    with pytest.raises(ti.TaiRuntimeTypeError, match="must be contiguous"):
        double(t)


def test_types_that_kernels_do_not_have(library):
    @ti.kernel
    def double(a: ti.types.ndarray()):
        for i in range(a.shape[0]):
            a[i] *= 2

    t = library.tensor(np.zeros(3, np.float32))
    if library.torch is None:
        t.dtype = "torch.bfloat16"
    else:
        t = t.bfloat16()
    with pytest.raises(ti.TaiRuntimeTypeError, match="no numbers of type bfloat16") as caught:
        double(t)
    assert "t.float()" in caught.value.hint
    half = library.tensor(np.arange(3).astype(np.float16))
    double(half)
    assert library.numpy(half).tolist() == [0, 2, 4]
    with pytest.raises(ti.TaiRuntimeTypeError, match="expects numbers, but got complex64"):
        double(library.tensor(np.zeros(3, np.complex64)))


def test_a_tensor_of_another_gpu(library):
    if library.torch is not None and library.torch.cuda.device_count() < 2:
        pytest.skip("needs two GPUs")
    x, y = library.tensor(np.zeros(3)), library.tensor(np.zeros(3))
    axpy(1.0, x, y)
    with pytest.raises(ti.TaiRuntimeTypeError, match="GPU number 1, and kernels run on number 0"):
        axpy(1.0, x, library.tensor(np.zeros(3), index=1))


def test_kernels_on_the_cpu(library, monkeypatch):
    x = library.tensor(np.zeros(3))
    monkeypatch.setenv("TI_ARCH", "cpu")
    ti.init(offline_cache=False)
    axpy(1.0, np.zeros(3), np.zeros(3))
    with pytest.raises(ti.TaiRuntimeTypeError, match=r"'x' .* is on a GPU, and kernels run on the"):
        axpy(1.0, x, np.zeros(3))


# On every machine


def test_arrays_of_elements_and_of_numbers():
    """An array of vectors is not the same as an array of numbers with the same extents."""

    @ti.kernel
    def first(x: ti.types.ndarray()) -> ti.f64:
        s = 0.0
        for i in ti.static(range(1)):
            s = x[i][1] + x[i + 1][0]
        return s

    v = ti.Vector.ndarray(2, ti.f64, shape=3)
    v.from_numpy(np.arange(6.0).reshape(3, 2))
    assert first(v) == first(v) == 3
    for plain in (v.to_numpy(), ti.ndarray(ti.f64, shape=(3, 2))):
        with pytest.raises(ti.TaiCompilationError):
            first(plain)

    @ti.kernel
    def fixed(x: ti.types.ndarray(element_dim=1)) -> ti.f64:
        return x[0][1]

    assert fixed(v) == fixed(v.to_numpy()) == fixed(v) == 1


def test_ndarrays_take_the_quick_path(slow_calls):
    x = ti.ndarray(ti.f64, shape=3, needs_grad=True)
    y = ti.ndarray(ti.f64, shape=3, needs_grad=True)
    x.from_numpy(np.arange(3.0))
    for n in range(1, 4):
        square(x, y)
        y.grad.fill(1.0)
        square.grad(x, y)
        assert x.grad.to_numpy().tolist() == [0, 2 * n, 4 * n]
        assert y.grad.to_numpy().tolist() == [0, 0, 0]
    assert slow_calls == ["square", "square.grad"]
    constant = ti.ndarray(ti.f64, shape=3)
    square(constant, y)
    square(np.ones(3), y)
    assert y.to_numpy().tolist() == [1, 1, 1]
    with pytest.raises(ti.TaiAutodiffError, match="overlap"):
        square.grad(x, x.array)


# With torch, on the CPU if it sees no GPU


@pytest.fixture(params=["default stream", "another stream"])
def torch(request):
    module = pytest.importorskip("torch")
    on_gpu = device_tensors.find_torch() is not None
    module.set_default_device("cuda" if on_gpu else "cpu")
    if on_gpu and request.param == "another stream":
        with module.cuda.stream(module.cuda.Stream()):
            yield module
    else:
        yield module
    module.set_default_device("cpu")


def make_function(torch):
    """x · w + x, as a function of torch: each part of its gradient where it is wanted."""

    class Product(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x, w):
            x, w = x.contiguous(), w.contiguous()
            y = torch.empty_like(x)
            product(x.detach(), w.detach(), y)
            ctx.save_for_backward(x, w)
            return y

        @staticmethod
        def backward(ctx, bar):
            return ProductGradient.apply(*ctx.saved_tensors, bar, ctx.needs_input_grad)

    class ProductGradient(torch.autograd.Function):
        @staticmethod
        def forward(ctx, *args):
            *tensors, bar, wanted = args
            x, w = (t.detach().requires_grad_(w) for t, w in zip(tensors, wanted, strict=True))
            y = torch.empty_like(x).requires_grad_()
            y.grad = bar.clone(memory_format=torch.contiguous_format)
            product.grad(x, w, y)
            return x.grad, w.grad

        @staticmethod
        def backward(ctx, *bars):
            raise NotImplementedError("the gradient of 'product' has no gradient")

    return Product.apply


def test_kernels_as_functions_of_torch(torch, slow_calls):
    function = make_function(torch)
    generator = np.random.default_rng(1)
    for _ in range(3):
        x = torch.tensor(generator.normal(size=64), requires_grad=True)
        w = torch.tensor(generator.normal(size=64), requires_grad=True)
        # Not a leaf, and used twice.
        hidden = function(2 * x, w)
        loss = (function(hidden, w) ** 2).sum()
        loss.backward()
        a, b = x.detach().clone().requires_grad_(), w.detach().clone().requires_grad_()
        h = 2 * a * b + 2 * a
        ((h * b + h) ** 2).sum().backward()
        torch.testing.assert_close(x.grad, a.grad)
        torch.testing.assert_close(w.grad, b.grad)
    assert slow_calls == ["product", "product.grad"]


def test_a_second_derivative_is_refused(torch):
    function = make_function(torch)
    x = torch.ones(2, dtype=torch.float64, requires_grad=True)
    w = torch.ones(2, dtype=torch.float64, requires_grad=True)
    # By what torch computed the argument from, by another argument, and by the gradient given.
    for by, loss in ((x, function(x * x, w).sum()), (x, function(x, w**2).sum()),
                     (w, (function(x, w) ** 2).sum())):  # fmt: skip
        (first,) = torch.autograd.grad(loss, by, create_graph=True)
        with pytest.raises(NotImplementedError, match="has no gradient"):
            first.sum().backward()


def test_the_gradient_that_is_wanted(torch):
    function = make_function(torch)
    x = torch.arange(4, dtype=torch.float64, requires_grad=True)
    w = torch.ones(4, dtype=torch.float64)
    function(x, w).sum().backward()
    assert x.grad.tolist() == [2, 2, 2, 2] and w.grad is None
    with torch.no_grad():
        y = function(x, w)
        assert not y.requires_grad and y.tolist() == [0, 2, 4, 6]
    # Every second element, of which torch gives an expanded gradient.
    wide = torch.arange(8, dtype=torch.float64, requires_grad=True)
    function(wide[::2], w).sum().backward()
    assert wide.grad.tolist() == [2, 0] * 4
    empty = torch.zeros(0, dtype=torch.float64, requires_grad=True)
    function(empty, torch.zeros(0, dtype=torch.float64)).sum().backward()
    assert empty.grad.shape == (0,)


def test_parameters_of_networks(torch, slow_calls):
    x = torch.nn.Parameter(torch.arange(3, dtype=torch.float64))
    y = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    for n in range(1, 4):
        square(x, y)
        y.grad = torch.ones_like(y)
        square.grad(x, y)
        assert x.grad.tolist() == [0, 2 * n, 4 * n]
    assert y.tolist() == [0, 1, 4]
    assert slow_calls == ["square", "square.grad"]


def test_torch_checks_the_gradient(torch):
    function = make_function(torch)
    x = torch.randn(5, dtype=torch.float64, requires_grad=True)
    w = torch.randn(5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, (x, w))


def test_tapes_without_torch_knowing(torch):
    """A tape ignores settings that switch torch's gradients off."""
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x = torch.arange(3, dtype=torch.float64, requires_grad=True)
    y = torch.zeros(3, dtype=torch.float64, requires_grad=True)

    @ti.kernel
    def total(a: ti.types.ndarray()):
        for i in range(a.shape[0]):
            loss[None] += a[i]

    with torch.no_grad(), ti.ad.Tape(loss) as tape:
        square(x, y)
        total(y)
    assert x.grad.tolist() == [0, 2, 4]
    optimiser = torch.optim.SGD([x], lr=0.25)
    optimiser.step()
    assert x.tolist() == [0, 0.5, 1]
    with pytest.raises(ti.TaiRuntimeError, match="changed by its library after"):
        tape.grad()
    optimiser.zero_grad()
    tape.replay()
    assert x.grad.tolist() == [0, 1, 2]
    assert loss[None] == 1.25
    with pytest.raises(ti.TaiRuntimeTypeError, match="no numbers of type bfloat16"):
        total(torch.zeros(3, dtype=torch.bfloat16))


def test_each_shape_of_elements_has_code_of_its_own():
    """Arrays of as many dimensions and the same type; the quick path comes from the second call."""

    @ti.kernel
    def total(x: ti.types.ndarray(ndim=1)) -> ti.f64:
        s = 0.0
        for i in range(x.shape[0]):
            s += x[i].sum()
        return s

    @ti.kernel
    def square(x: ti.types.ndarray(ndim=1), y: ti.types.ndarray(ndim=1)):
        for i in range(x.shape[0]):
            y[i] = x[i] * x[i]

    sizes = ((2,), (3,), (2, 2), (4, 1), (1, 4), (3,), (2,))

    def make(size):
        if len(size) == 1:
            array = ti.Vector.ndarray(*size, ti.f64, shape=3)
        else:
            array = ti.Matrix.ndarray(*size, ti.f64, shape=3)
        array.from_numpy(np.arange(3.0 * np.prod(size)).reshape(3, *size) + 1)
        return array

    for _ in range(2):
        for size in sizes:
            x, y = make(size), make(size)
            ones = make(size)
            ones.from_numpy(np.ones((3, *size)))
            assert total(ones) == 3 * np.prod(size)
            square(x, y)
            assert (y.to_numpy() == x.to_numpy() ** 2).all()
