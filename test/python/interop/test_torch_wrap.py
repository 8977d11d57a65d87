"""Kernels as operators of torch: gradients, torch.compile, vmap, layers, and errors."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

torch = pytest.importorskip("torch", reason="torch is not installed")
wrap = ti.torch.wrap


@ti.kernel
def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def blend(x: ti.types.ndarray(), w: ti.types.ndarray(), a: ti.f64, y: ti.types.ndarray(),
          total: ti.types.ndarray()):  # fmt: skip
    for i in range(x.shape[0]):
        y[i] = a * x[i] * w[i] + ti.sin(x[i])
        total[0] += x[i] * w[i]


@ti.kernel
def double(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = 2 * x[i]


@ti.kernel
def cube_by_steps(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]
        y[i] = y[i] * x[i]


@ti.kernel
def spoil(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i]
        x[i] = 7.0


@pytest.fixture(autouse=True)
def start():
    ti.init(default_fp=ti.f64, offline_cache=False)


# Operators stay in torch's table for as long as the process.
SQUARE = wrap(square, outputs={"y": "x"})
BLEND = wrap(blend, outputs={"y": "x", "total": lambda x, w, a: 1}, name="blend_of_tests")


def chain(x, w, y):
    """Two kernels and a tensor between them."""
    middle = x.new_zeros(x.shape)
    if x.requires_grad:
        middle.requires_grad_()
    square(x, middle)
    product(middle, w, y)


@ti.kernel
def product(x: ti.types.ndarray(), w: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * w[i]


CHAIN = wrap(chain, outputs={"y": "x"})


def leaf(n=3, seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(n, dtype=dtype, generator=generator).requires_grad_()


@pytest.mark.parametrize("n", [0, 1, 3, 65_537])
def test_the_case_of_the_graph_that_was_cut(n):
    w = torch.arange(1, n + 1, dtype=torch.float64).requires_grad_()
    y = SQUARE(w)
    assert torch.equal(y, w.detach() ** 2)
    (y * w).sum().backward()
    torch.testing.assert_close(w.grad, 3 * w.detach() ** 2)


def test_arguments_that_torch_computed():
    w = leaf(6)
    for given in (2 * w, w[:2], w[::2], w.reshape(2, 3)[1], w.expand(1, 6)[0]):
        w.grad = None
        SQUARE(given).sum().backward(retain_graph=True)
        ours, w.grad = w.grad, None
        (given**2).sum().backward()
        torch.testing.assert_close(ours, w.grad)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_types(dtype):
    w = leaf(4, dtype=dtype)
    y = SQUARE(w)
    assert y.dtype == dtype
    y.sum().backward()
    torch.testing.assert_close(w.grad, 2 * w.detach())


def test_several_inputs_and_outputs():
    x, w = leaf(seed=1), leaf(seed=2)
    y, total = BLEND(x, w, 1.5)
    assert y.shape == (3,) and total.shape == (1,)
    (y.sum() + total.sum() ** 2).backward()
    a, b = x.detach().clone().requires_grad_(), w.detach().clone().requires_grad_()
    ((1.5 * a * b + a.sin()).sum() + (a * b).sum() ** 2).backward()
    torch.testing.assert_close(x.grad, a.grad)
    torch.testing.assert_close(w.grad, b.grad)
    # Only one is wanted, and only one output is used.
    c = leaf(seed=3)
    BLEND(x.detach(), c, 1.5)[0].sum().backward()
    torch.testing.assert_close(c.grad, 1.5 * x.detach())


GRADIENTS = {
    "square": (SQUARE, 1, ()),
    "blend": (BLEND, 2, (0.7,)),
    "chain": (CHAIN, 2, ()),
    "steps": (wrap(cube_by_steps, outputs={"y": "x"}), 1, ()),
}


@pytest.mark.parametrize("name", GRADIENTS)
def test_gradcheck(name):
    operator, count, numbers = GRADIENTS[name]
    leaves = [leaf(5, seed=n + 4) for n in range(count)]
    assert torch.autograd.gradcheck(lambda *x: operator(*x, *numbers), leaves)


@pytest.mark.parametrize("name", GRADIENTS)
def test_what_torch_checks_of_an_operator(name):
    operator, count, numbers = GRADIENTS[name]
    leaves = [leaf(5, seed=n + 4) + 3 for n in range(count)]
    torch.library.opcheck(operator._op, (*(x.detach().requires_grad_() for x in leaves), *numbers))


def test_second_derivatives_are_refused():
    x = leaf()
    with pytest.raises(ti.TaiAutodiffError, match="gradient of operator 'square' has no gradient"):
        torch.autograd.gradgradcheck(SQUARE, (x,))
    (first,) = torch.autograd.grad(SQUARE(x * x).sum(), x, create_graph=True)
    with pytest.raises(ti.TaiAutodiffError, match="differentiated once"):
        first.sum().backward()


@pytest.mark.parametrize("batched", [False, True])
def test_second_derivatives_of_functions_are_refused(batched):
    first = torch.func.grad(lambda x: SQUARE(x).sum())
    second = torch.func.grad(lambda x: first(x).sum())
    with pytest.raises(ti.TaiAutodiffError, match="gradient of operator 'square' has no gradient"):
        x = torch.ones(3, dtype=torch.float64)
        torch.vmap(second)(torch.stack([x, x])) if batched else second(x)


def test_results_begin_at_zero():
    """Kernels may add to them; torch fills memory that it does not clear with NaN here."""

    @ti.kernel
    def accumulate(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[i] += 2 * x[i]
            y[i] += x[i]

    operator = wrap(accumulate, outputs={"y": "x"})
    x = leaf(100)
    was = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(True)
    try:
        y = operator(x)
        y.sum().backward()
    finally:
        torch.use_deterministic_algorithms(was)
    torch.testing.assert_close(y, 3 * x)
    torch.testing.assert_close(x.grad, torch.full_like(x, 3))


@pytest.mark.parametrize("operator", [SQUARE, CHAIN], ids=["kernel", "function"])
def test_two_uses_and_two_sweeps(operator):
    x, w = leaf(), torch.ones(3, dtype=torch.float64)
    rest = () if operator is SQUARE else (w,)
    loss = operator(operator(x, *rest), *rest).sum()
    for times in (1, 2):
        loss.backward(retain_graph=True)
        torch.testing.assert_close(x.grad, times * 4 * x.detach() ** 3)


def test_without_a_graph():
    x = leaf()
    with torch.no_grad():
        y = SQUARE(x)
    assert not y.requires_grad
    assert not SQUARE(x.detach()).requires_grad
    with torch.inference_mode():
        assert torch.equal(SQUARE(x), x.detach() ** 2)


def test_checkpoints():
    from torch.utils.checkpoint import checkpoint

    x = leaf()
    checkpoint(lambda x: SQUARE(SQUARE(x)).sum(), x, use_reentrant=False).backward()
    torch.testing.assert_close(x.grad, 4 * x.detach() ** 3)


def test_autocast():
    x = leaf(4, dtype=torch.float32)
    weight = torch.eye(4)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        hidden = torch.nn.functional.linear(x, weight)
        assert hidden.dtype == torch.bfloat16
        y = SQUARE(hidden)
    assert y.dtype == torch.float32
    y.sum().backward()
    torch.testing.assert_close(x.grad, 2 * x.detach(), rtol=1e-2, atol=1e-2)


@pytest.mark.parametrize("dynamic", [False, True])
def test_compile(dynamic):
    @torch.compile(fullgraph=True, backend="aot_eager", dynamic=dynamic)
    def loss(x, w):
        y, total = BLEND(torch.sin(x), w, 0.5)
        return (y**2).sum() + total.sum()

    for n in (3, 7):
        x, w = leaf(n, seed=1), leaf(n, seed=2)
        value = loss(x, w)
        value.backward()
        a, b = x.detach().clone().requires_grad_(), w.detach().clone().requires_grad_()
        y, total = BLEND(torch.sin(a), b, 0.5)
        expected = (y**2).sum() + total.sum()
        expected.backward()
        torch.testing.assert_close(value, expected)
        torch.testing.assert_close(x.grad, a.grad)
        torch.testing.assert_close(w.grad, b.grad)


@pytest.mark.parametrize("operator", [SQUARE, wrap(lambda x, y: square(x, y), {"y": "x"})],
                         ids=["kernel", "function"])  # fmt: skip
def test_vmap(operator):
    x = torch.randn(4, 3, dtype=torch.float64)
    assert torch.equal(torch.vmap(operator)(x), x**2)
    assert torch.equal(torch.vmap(operator, in_dims=1, out_dims=1)(x), x**2)
    torch.testing.assert_close(torch.vmap(torch.vmap(operator))(x.reshape(2, 2, 3)),
                               x.reshape(2, 2, 3) ** 2)  # fmt: skip
    each = torch.vmap(torch.func.grad(lambda x: operator(x).sum()))(x)
    torch.testing.assert_close(each, 2 * x)
    x.requires_grad_()
    torch.vmap(operator)(x).sum().backward()
    torch.testing.assert_close(x.grad, 2 * x.detach())


def test_functions_of_torch():
    x, w = leaf(seed=1).detach(), leaf(seed=2).detach()
    jacobian = torch.func.jacrev(SQUARE)(x)
    torch.testing.assert_close(jacobian, torch.diag(2 * x))
    in_dims = (None, 0, None)
    y, total = torch.vmap(BLEND, in_dims=in_dims)(x, torch.stack([w, 2 * w]), 0.5)
    torch.testing.assert_close(total[:, 0], torch.stack([(x * w).sum(), 2 * (x * w).sum()]))


def test_layers():
    layer = ti.torch.module(blend, {"y": "x", "total": lambda x, w, a: 1},
                            w=torch.nn.Parameter(torch.ones(3, dtype=torch.float64)))  # fmt: skip
    assert [name for name, _ in layer.named_parameters()] == ["w"]
    optimiser = torch.optim.SGD(layer.parameters(), lr=0.1)
    x = leaf().detach()
    losses = []
    for _ in range(20):
        optimiser.zero_grad()
        loss = (layer(x, 1.0)[0] ** 2).sum()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]
    buffered = ti.torch.module(SQUARE, x=torch.ones(2))
    assert "x" in buffered.state_dict() and not list(buffered.parameters())
    assert buffered().tolist() == [1, 1]
    with pytest.raises(ti.TaiRuntimeTypeError, match="'v' is no tensor among the inputs"):
        ti.torch.module(SQUARE, v=torch.ones(2))
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes 2 inputs, but got 1"):
        layer(x)


# What is refused


def test_an_input_that_is_written():
    x = leaf()
    operator = wrap(spoil, outputs={"y": "x"})
    before = x.detach().clone()
    for _ in range(2):
        with pytest.raises(ti.TaiRuntimeTypeError, match="'spoil' writes to its input 'x'"):
            operator(x)
    assert torch.equal(x.detach(), before)


def test_a_call_in_a_tape():
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    with pytest.raises(ti.TaiRuntimeError, match="while a tape records"), ti.ad.Tape(loss):
        SQUARE(leaf())


def test_wrong_outputs():
    for outputs, said in [
        ({}, "must be a dict"), ({"z": "x"}, "name 'z', which is no array"),
        ({"y": "z"}, "say 'z' of 'y'"), ({"y": "y"}, "say 'y' of 'y'"), ({"y": 3}, "say 3 of 'y'"),
    ]:  # fmt: skip
        with pytest.raises(ti.TaiRuntimeTypeError, match=said):
            wrap(square, outputs=outputs)
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes a kernel or a function, but got 3"):
        wrap(3, outputs={"y": "x"})

    @ti.kernel
    def of_a_field(x: ti.types.ndarray(), f: ti.template()):
        x[0] = f[None]

    with pytest.raises(ti.TaiRuntimeTypeError, match="parameter 'f' of kernel 'of_a_field'"):
        wrap(of_a_field, outputs={"x": "x"})

    @ti.kernel
    def returns(x: ti.types.ndarray(), y: ti.types.ndarray()) -> ti.f64:
        y[0] = x[0]
        return x[0]

    with pytest.raises(ti.TaiRuntimeTypeError, match="'returns' returns a value"):
        wrap(returns, outputs={"y": "x"})(leaf())
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes 1 inputs, but got 2"):
        SQUARE(leaf(), leaf())


PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "torch.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.parametrize("number", range(3))
def test_programs_of_the_page(number, tmp_path):
    assert len(PROGRAMS) == 3
    file = tmp_path / "program.py"
    file.write_text(PROGRAMS[number])
    subprocess.run([sys.executable, "-W", "error::UserWarning", str(file)], check=True)


def test_tai_does_not_import_torch():
    code = "import sys, tai; assert 'torch' not in sys.modules; tai.ad; tai.testing; " \
           "assert 'torch' not in sys.modules"  # fmt: skip
    subprocess.run([sys.executable, "-c", code], check=True)


@ti.kernel
def parts(x: ti.types.ndarray(dtype=ti.f64, ndim=1), w: ti.types.ndarray(), y: ti.types.ndarray(),
          z: ti.types.ndarray(dtype=ti.f64)):  # fmt: skip
    n = x.shape[0]
    for i in range(n):
        y[i] = x[i] * x[i]
    z[0] = x[n - 1] * w[0]
    for i in x:
        z[i] += y[i] * y[i] * w[i]


def same_parts(x, w):
    y = x * x
    last = torch.zeros_like(x)
    last[0] = 1.0
    return y, y * y * w + last * x[-1] * w[0]


@pytest.mark.parametrize("in_dims", [(0, None), (None, 0), (0, 0), (1, None), (0, 1)])
@pytest.mark.parametrize("size", [1, 2, 65])
def test_a_batch_is_one_launch(in_dims, size):
    operator = wrap(parts, outputs={"y": "x", "z": "x"})
    torch.manual_seed(size)
    shapes = {0: (size, 3), 1: (3, size), None: (3,)}
    x, w = (torch.rand(shapes[d], dtype=torch.float64) for d in in_dims)
    for found, wanted in zip(torch.vmap(operator, in_dims)(x, w),
                             torch.vmap(same_parts, in_dims)(x, w), strict=True):  # fmt: skip
        torch.testing.assert_close(found, wanted)

    def slopes(function):
        one = torch.func.grad(lambda x, w: (function(x, w)[1] ** 2).sum(), argnums=(0, 1))
        return torch.vmap(one, in_dims)(x, w)

    for found, wanted in zip(slopes(operator), slopes(same_parts), strict=True):
        torch.testing.assert_close(found, wanted)
    jacobians = torch.vmap(torch.func.jacrev(lambda x, w: operator(x, w)[1]), in_dims)(x, w)
    wanted = torch.vmap(torch.func.jacrev(lambda x, w: same_parts(x, w)[1]), in_dims)(x, w)
    torch.testing.assert_close(jacobians, wanted)
    assert operator._stacks.operators
    assert all("batch already" in reason for reason in operator.one_by_one.values())


def test_a_batch_whose_gradient_is_by_what_all_elements_share():
    operator = wrap(parts, outputs={"y": "x", "z": "x"})
    x = torch.rand(5, 3, dtype=torch.float64, requires_grad=True)
    w = torch.rand(3, dtype=torch.float64, requires_grad=True)
    found = torch.autograd.grad(torch.vmap(operator, (0, None))(x, w)[1].sum(), (x, w))
    wanted = torch.autograd.grad(torch.vmap(same_parts, (0, None))(x, w)[1].sum(), (x, w))
    for one, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(one, other)
    assert operator.one_by_one == {}


def test_batches_that_launch_for_each_element():
    total = ti.field(ti.f64, shape=())

    @ti.kernel
    def counting(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[i] = x[i]
            total[None] += 1

    @ti.kernel
    def bounded(n: ti.types.ndarray(), x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(n[0]):
            y[i] = 2 * x[i]

    @ti.kernel
    def summing(x: ti.types.ndarray(), y: ti.types.ndarray()):
        s = 0.0
        for i in range(x.shape[0]):
            s += x[i]
        y[0] = s

    x = torch.rand(4, 3, dtype=torch.float64)
    operator = wrap(counting, outputs={"y": "x"})
    torch.testing.assert_close(torch.vmap(operator)(x), x)
    assert total[None] == 12
    assert "writes to field 'total'" in str(operator.one_by_one)
    operator = wrap(bounded, outputs={"y": "x"})
    n = torch.tensor([[0], [1], [3], [2]])
    found = torch.vmap(operator)(n, x)
    torch.testing.assert_close(found, 2 * x * (torch.arange(3) < n))
    assert "array 'n' has a part for each element" in str(operator.one_by_one)
    operator = wrap(summing, outputs={"y": lambda x: 1})
    torch.testing.assert_close(torch.vmap(operator)(x)[:, 0], x.sum(1))
    assert "'s' would be one variable" in str(operator.one_by_one)
    operator = wrap(chain, outputs={"y": "x"})
    torch.testing.assert_close(
        torch.vmap(operator, (0, None))(x, x[0]),
        torch.stack([operator(one, x[0]) for one in x]),
    )
    assert "a function, and no kernel" in str(operator.one_by_one)


WRONG_INPUTS = {
    "numpy": (lambda x: (x.numpy(), x, 1.0), "is a tensor, but got ndarray", "from_numpy(x)"),
    "list": (lambda x: ([1.0], x, 1.0), "is a tensor, but got list", "torch.tensor([1.0])"),
    "number": (lambda x: (x, 0.5, 1.0), "'w' of operator 'blend' is a tensor", "torch.tensor(0.5)"),
    "none": (lambda x: (x, None, 1.0), "but got NoneType", "torch.Tensor"),
    "gradient": (
        lambda x: (x, x, torch.tensor(1.0, requires_grad=True)),
        "'a' of operator 'blend' is a number, which has no gradient", "a.item()",
    ),
    "shape": (lambda x: (x, x, torch.ones(2)), "a tensor of shape (2,)", "a.item()"),
    "sparse": (lambda x: (x.to_sparse(), x, 1.0), "'x' of operator 'blend' is sparse",
               "pass x.to_dense()"),
    "rows": (lambda x: (x, torch.eye(3).to_sparse_csr(), 1.0), "'w' of operator 'blend' is sparse",
             "pass w.to_dense()"),
    "quantized": (
        lambda x: (torch.quantize_per_tensor(x.float(), 0.1, 0, torch.qint8), x, 1.0),
        "is quantized", "pass x.dequantize()",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_INPUTS)
def test_inputs_of_a_wrong_kind(name):
    make, message, hint = WRONG_INPUTS[name]
    with pytest.raises(ti.TaiRuntimeTypeError, match=re.escape(message)) as error:
        BLEND(*make(torch.ones(3, dtype=torch.float64)))
    assert hint in str(error.value)


def test_a_tensor_of_one_number_is_a_number():
    x, a = leaf(), torch.tensor(1.5, requires_grad=True)
    wanted = BLEND(x, x, 1.5)[0]
    assert torch.equal(BLEND(x, x, torch.tensor(1.5))[0], wanted)
    with torch.no_grad():  # no gradient is lost
        assert torch.equal(BLEND(x, x, a)[0], wanted)


def test_inputs_by_name():
    x, w = leaf(seed=1), leaf(seed=2)
    for found in (BLEND(x, a=1.5, w=w), BLEND(a=1.5, w=w, x=x)):
        assert torch.equal(found[0], BLEND(x, w, 1.5)[0])
    for call, message in (
        (lambda: BLEND(x, v=w, a=1.5), "has no input 'v'"),
        (lambda: BLEND(x, w, 1.5, x=x), "input 'x' of operator 'blend' is given twice"),
        (lambda: BLEND(x, w=w), "takes 3 inputs, but got 2"),
    ):
        with pytest.raises(ti.TaiRuntimeTypeError, match=message):
            call()


def test_copies_of_a_network():
    import copy
    import io

    layer = ti.torch.module(BLEND, w=torch.nn.Parameter(torch.ones(3, dtype=torch.float64)))
    other = copy.deepcopy(layer)
    with torch.no_grad():
        other.w += 1
    x = leaf()
    assert torch.equal(layer(x, 2.0)[0], BLEND(x, layer.w, 2.0)[0])
    assert torch.equal(other(x, 2.0)[0], BLEND(x, other.w, 2.0)[0])
    file = io.BytesIO()
    torch.save(other, file)
    file.seek(0)
    loaded = torch.load(file, weights_only=False)
    assert torch.equal(loaded(x, 2.0)[0], other(x, 2.0)[0])


def test_a_network_whose_operator_is_not_here():
    import pickle

    name = wrap(square, outputs={"y": "x"}, name="made_by_another_process")
    text = pickle.dumps(name).replace(b"made_by_another_process", b"made_by_another_Process")
    with pytest.raises(
        ti.TaiRuntimeError, match="operator 'made_by_another_Process' of '.*square'"
    ):
        pickle.loads(text)
    # Another function under the same name.
    text = pickle.dumps(wrap(double, outputs={"y": "x"}, name="Made_by_another_process"))
    with pytest.raises(ti.TaiRuntimeError, match="is not known here"):
        pickle.loads(text.replace(b"Made_by_another_process", b"made_by_another_process"))


def test_forward_mode_is_refused():
    x = leaf().detach()
    with pytest.raises(ti.TaiAutodiffError, match="no tangents") as error:
        torch.func.jvp(SQUARE, (x,), (torch.ones_like(x),))
    assert "jacrev" in str(error.value)
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(x, torch.ones_like(x))
        with pytest.raises(ti.TaiAutodiffError, match="no tangents"):
            SQUARE(dual)


def test_a_trace_of_torch_has_the_operator():
    traced = torch.jit.trace(lambda x: SQUARE(x) + 1, (torch.ones(3, dtype=torch.float64),))
    x = torch.arange(5, dtype=torch.float64)
    assert torch.equal(traced(x), x * x + 1)


def test_a_shape_from_too_few_inputs():
    with pytest.raises(ti.TaiRuntimeTypeError, match="does not take the 3 inputs") as error:
        wrap(blend, outputs={"y": lambda x: x.shape, "total": lambda x, w, a: 1})
    assert "lambda x, w, a: …" in str(error.value)


def test_the_hint_for_a_tensor_of_another_type():
    @ti.kernel
    def plain(x: ti.types.ndarray(dtype=ti.f32), y: ti.types.ndarray(dtype=ti.f32)):
        for i in range(x.shape[0]):
            y[i] = x[i]

    with pytest.raises(ti.TaiRuntimeTypeError, match=r"t\.to\(torch\.float32\)"):
        wrap(plain, outputs={"y": "x"})(torch.ones(3, dtype=torch.float64))


def test_calls_without_a_gradient_make_no_graph():
    x = leaf()
    with torch.no_grad():
        assert SQUARE(x).grad_fn is None
    assert SQUARE(x.detach()).grad_fn is None and SQUARE(x).grad_fn is not None


def test_adjoints_are_not_changed_by_the_sweep():
    x, bar = leaf(), torch.ones(3, dtype=torch.float64)
    for operator in (SQUARE, CHAIN):
        given = (x,) if operator is SQUARE else (x, x.detach())
        operator(*given).backward(bar, retain_graph=True)
        assert bar.tolist() == [1, 1, 1]


@ti.kernel
def last(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[0] = x[i] * x[i]


LAST = wrap(last, outputs={"y": lambda x: 1})


def test_stores_to_one_element():
    for _ in range(2):
        x = leaf()
        y = LAST(x)
        y.backward(torch.ones(1, dtype=torch.float64))
        # The gradient belongs to the iteration whose number remained.
        gradient = [2 * v if v * v == y.item() else 0.0 for v in x.tolist()]
        assert x.grad.tolist() == gradient and sum(g != 0 for g in gradient) == 1


@ti.kernel
def weigh(x: ti.types.ndarray(), w: ti.types.ndarray(), a: ti.f64, n: ti.types.ndarray(),
          y: ti.types.ndarray(), z: ti.types.ndarray()):  # fmt: skip
    for i, j in ti.ndrange(x.shape[0], x.shape[1]):
        y[i, j] = a * x[i, j] * w[i, j]
        z[i, j] = x[i, j] * n[i, j]


WEIGH = wrap(weigh, outputs={"y": "x", "z": "x"})


@pytest.mark.parametrize("wanted", [(True, True), (True, False), (False, True), (False, False)])
def test_known_types_go_to_the_launcher_at_once(wanted, monkeypatch):
    numbers = torch.arange(6).reshape(2, 3)

    def check(arrange=lambda t: t):
        x, w = (arrange(leaf(6, seed=s).detach().reshape(2, 3)) for s in (1, 2))
        x.requires_grad_(wanted[0])
        w.requires_grad_(wanted[1])
        y, z = WEIGH(x, w, 0.5, numbers)
        torch.testing.assert_close(y.detach(), 0.5 * (x * w).detach())
        assert y.requires_grad == any(wanted)
        if any(wanted):
            (arrange(torch.full((2, 3), 2.0, dtype=torch.float64)) * y + z.cos()).sum().backward()
        expected = (w - numbers * (x * numbers).sin()).detach() if wanted[0] else None
        assert x.grad is None if expected is None else torch.allclose(x.grad, expected)
        assert torch.equal(w.grad, x.detach()) if wanted[1] else w.grad is None

    def permuted(tensor):
        return tensor.t().contiguous().t()

    check()
    check(permuted)  # copied first
    monkeypatch.setattr(WEIGH, "_launch", None)
    check()


def test_an_input_that_is_written_is_found_after_plain_launches():
    x = torch.ones(3, dtype=torch.float64)
    spoil(x, torch.zeros(3, dtype=torch.float64))
    x.fill_(1.0)
    operator = wrap(spoil, outputs={"y": "x"})
    for _ in range(2):
        with pytest.raises(ti.TaiRuntimeTypeError, match="writes to its input 'x'"):
            operator(x)
        assert x.tolist() == [1, 1, 1]


def test_a_tensor_that_a_transform_left_behind():
    left = []

    def keep(x):
        left.append(x)
        return (x * x).sum()

    torch.func.grad(keep)(torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64))
    for _ in range(2):
        assert SQUARE(left[0]).tolist() == [1, 4, 9]
    wanted = leaf()
    torch.testing.assert_close(BLEND(left[0], wanted, 0.5)[1].detach(), (left[0] @ wanted)[None])


@pytest.mark.parametrize("n", [1, 512, 513, 65_537])  # 512 adjoints of f64 are copied to the stack
@pytest.mark.parametrize("kind", ["dense", "expanded", "of the input", "strided"])
def test_adjoints_of_all_layouts(n, kind):
    for _ in range(2):
        x = leaf(n)
        bar = {
            "dense": torch.arange(float(n), dtype=torch.float64),
            "expanded": torch.full((1,), 3.0, dtype=torch.float64).expand(n),
            "of the input": x.detach(),
            "strided": torch.arange(2.0 * n, dtype=torch.float64)[::2],
        }[kind]
        before = bar.clone()
        SQUARE(x).backward(bar)
        assert torch.equal(x.grad, 2 * x.detach() * before) and torch.equal(bar, before)


def test_larger_tensors_are_cleared():
    dirty = [torch.full((40_000,), 5.0, dtype=torch.float64) for _ in range(4)]
    del dirty  # whose memory the next tensors may have
    for _ in range(2):
        x, w = leaf(40_000), leaf(40_000, seed=1)
        y, total = BLEND(x, w, 0.5)
        assert torch.allclose(total, (x @ w).detach())
        (y.sum() + total.sum()).backward()
        torch.testing.assert_close(w.grad, 1.5 * x.detach())


def test_numbers_of_numpy():
    x = leaf()
    for a in (np.float32(0.5), np.int64(2), True):
        y, _ = BLEND(x, x, a)
        torch.testing.assert_close(y, a * x * x + x.sin())


@pytest.mark.parametrize("count", [31, 40])
def test_operators_with_many_parameters(count, tmp_path):
    names = [f"x{i}" for i in range(count)]
    parameters = ", ".join(f"{name}: ti.types.ndarray()" for name in [*names, "y"])
    (tmp_path / f"many_{count}.py").write_text(
        f"import tai as ti\n@ti.kernel\ndef run({parameters}):\n    for i in range(y.shape[0]):\n"
        f"        y[i] = {' + '.join(f'{name}[i] * {name}[i]' for name in names)}\n"
    )
    specification = importlib.util.spec_from_file_location("many", tmp_path / f"many_{count}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    operator = wrap(module.run, outputs={"y": "x0"})
    for _ in range(2):
        inputs = [leaf(3, seed=i) for i in range(count)]
        y = operator(*inputs)
        torch.testing.assert_close(y, sum(x * x for x in inputs))
        y.sum().backward()
        assert all(torch.equal(x.grad, 2 * x.detach()) for x in inputs)


def test_a_call_that_is_hooked():
    x, seen = leaf(), []
    y = SQUARE(x)
    y.register_hook(lambda bar: 2 * bar)
    y.grad_fn.register_hook(lambda found, bars: seen.append((found, bars)))
    with torch.autograd.graph.saved_tensors_hooks(lambda t: t.numpy(), torch.from_numpy):
        z = SQUARE(y)
    z.sum().backward()
    ((found, bars),) = seen
    torch.testing.assert_close(x.grad, 8 * x.detach() ** 3)
    torch.testing.assert_close(found[0], x.grad)
    torch.testing.assert_close(bars[0], 4 * y.detach())


def test_inputs_that_are_changed_before_the_sweep():
    x = leaf()
    y = SQUARE(x)
    with torch.no_grad():
        x += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        y.sum().backward()
