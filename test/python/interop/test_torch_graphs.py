"""Tensors that torch has in a graph of its own, as arguments of kernels."""

import warnings

import numpy as np
import pytest
import tai as ti
from tai._impl.history import torch_graphs

torch = pytest.importorskip("torch", reason="torch is not installed")


@ti.kernel
def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]


@ti.kernel
def total(x: ti.types.ndarray(), loss: ti.template()):
    for i in range(x.shape[0]):
        loss[None] += x[i]


@ti.kernel
def energy(x: ti.types.ndarray()) -> ti.f64:
    sum = 0.0
    for i in range(x.shape[0]):
        sum += x[i] ** 2
    return sum


@ti.kernel
def half_length(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = 0.5 * i


def leaf(n=3, dtype=torch.float64):
    return torch.arange(1, n + 1, dtype=dtype).requires_grad_()


def zeros(n=3, dtype=torch.float64):
    return torch.zeros(n, dtype=dtype)


def scalar_loss():
    return ti.field(ti.f64, shape=(), needs_grad=True, name="loss")


def said(run):
    """The messages of the warnings, and their lines."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run()
    assert all(issubclass(w.category, ti.ad.TaiGradientWarning) for w in caught)
    assert all(w.filename == __file__ for w in caught)
    return [(str(w.message), w.lineno) for w in caught]


# Tapes

COMPUTED = {
    "product": lambda w: 2 * w,
    "slice": lambda w: w[:2],
    "strided": lambda w: w[::2],
    "cast": lambda w: w.float(),
    "view": lambda w: w.view(-1),
    "clone": lambda w: w.clone(),
    "of a network": lambda w: torch.nn.functional.softplus(w),
}


@pytest.mark.parametrize("how", COMPUTED)
def test_a_tape_refuses_what_torch_computed(how):
    w = leaf()
    # The second time, the kernel has been launched before.
    for _ in range(2):
        y, loss = zeros().requires_grad_(), scalar_loss()
        with ti.ad.Tape(loss):
            square(w, y)
            total(y, loss)
        given = COMPUTED[how](w)
        with (
            pytest.raises(
                ti.TaiAutodiffError, match="'x' of kernel 'square' is a tensor that torch computed"
            ) as caught,
            ti.ad.Tape(scalar_loss()),
        ):
            square(given, zeros(dtype=given.dtype))
        assert "torch.autograd.Function" in caught.value.hint
        assert w.grad.tolist() == [2, 4, 6]
        w.grad = None


def test_a_tape_refuses_it_between_two_kernels():
    """kernel → torch → kernel"""
    w, y, loss = leaf(), zeros().requires_grad_(), scalar_loss()
    with pytest.raises(ti.TaiAutodiffError, match="'x' of kernel 'total'"), ti.ad.Tape(loss):
        square(w, y)
        total(3 * y, loss)


@pytest.mark.parametrize("size", [1, 65_537])
def test_leaves_are_differentiated(size):
    w, loss = leaf(size), scalar_loss()
    y = zeros(size).requires_grad_()
    given = [w, torch.nn.Parameter(w.detach().clone()), w.detach().clone().requires_grad_()]
    for x in given:
        with ti.ad.Tape(loss):
            square(x, y)
            total(y, loss)
        assert torch.equal(x.grad, 2 * x.detach())
    # Torch computes constants here, which are no part of its graph.
    with torch.no_grad(), ti.ad.Tape(loss):
        square(2 * w, y)
        total(y, loss)


def test_a_gradient_by_hand_refuses_it_too():
    w, y = leaf(), zeros().requires_grad_()
    for _ in range(2):
        y.grad = torch.ones_like(y)
        square.grad(w, y)
        with pytest.raises(ti.TaiAutodiffError, match="'x' of kernel 'square.*torch computed"):
            square.grad(2 * w, y)
    assert w.grad.tolist() == [4, 8, 12]


# Graphs


def test_a_launch_that_cuts_a_graph_is_said():
    w, y = leaf(), zeros()

    def run():
        for _ in range(3):
            square(w, y)
        (y * w).sum().backward()

    ((message, line),) = said(run)
    assert line == run.__code__.co_firstlineno + 2
    for part in ("'square'", "'x'", "torch.autograd.Function", "ti.ad.Tape", "detach()", "no_grad"):
        assert part in message
    assert said(run) == []

    # A second call, of the compiled kernel, is reported at its own line.
    (other,) = said(lambda: square(2 * w, y))
    assert other[1] != line


def test_a_number_that_a_kernel_returns():
    w = leaf()
    ((message, _),) = said(lambda: energy(w))
    assert "'x'" in message


def test_a_numpy_array_that_is_written():
    (_,) = said(lambda: square(leaf(), np.zeros(3)))


def test_what_cuts_nothing():
    w, y, loss = leaf(), zeros(), scalar_loss()

    class Square(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            y = torch.empty_like(x)
            square(x, y)
            return y

    def run():
        with torch.no_grad():
            square(w, y)
        with torch.inference_mode():
            square(w, torch.zeros(3, dtype=torch.float64))
        square(w.detach(), y)
        square(y, y.clone())
        Square.apply(w)
        # The extents alone are no numbers of it.
        half_length(w, y)
        # Its gradient is done by hand.
        target = zeros().requires_grad_()
        square(w, target)
        target.grad = torch.ones_like(target)
        square.grad(w, target)
        with ti.ad.Tape(loss) as tape:
            square(w, target)
            total(target, loss)
        tape.replay()

    assert said(run) == []
    assert said(run) == []


def test_launches_that_follow_cost_no_python(monkeypatch):
    w, y, looks = leaf(), zeros(), []
    monkeypatch.setattr(torch_graphs, "is_grad_enabled", lambda: looks.append(1) or True)

    def run():
        for _ in range(5):
            square(w, y)
        with torch.no_grad():
            for _ in range(5):
                square(w, y)

    assert len(said(run)) == 1
    # Only the first of ten launches came to Python code of the package.
    assert len(looks) == 1


def test_a_field_that_takes_a_tensor_of_a_graph():
    w, x = leaf(), ti.field(ti.f64, shape=3, name="x")

    def run():
        for _ in range(2):
            x.from_torch(2 * w)

    ((message, _),) = said(run)
    assert "field 'x'" in message and "tensor.detach()" in message
    assert x.to_numpy().tolist() == [2, 4, 6]

    def constant():
        x.from_torch(w.detach())
        with torch.no_grad():
            x.from_torch(2 * w)

    assert said(constant) == []
