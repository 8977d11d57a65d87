"""`tai.torch`: kernels as differentiable operators of PyTorch.

Importing it imports torch; `import tai` does not.
"""

from __future__ import annotations

from typing import Any

from ._impl.base.keywords import check_keywords
from ._impl.frameworks.torch_operators import Module, Operator

__all__ = ["Module", "Operator", "module", "wrap"]


def wrap(function: Any, outputs: dict[str, Any], name: str | None = None) -> Operator:
    """Makes a kernel, or a function that launches kernels, a differentiable operator of torch.

    ```python
    @ti.kernel
    def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[i] = x[i] * x[i]


    op = tai.torch.wrap(square, outputs={"y": "x"})
    w = torch.tensor([1.0, 2.0, 3.0], requires_grad=True)
    (op(w) * w).sum().backward()  # w.grad is 3 w²
    ```

    A call gives the parameters that are not outputs, in order, and returns the outputs in order:
    one tensor, or a tuple. Outputs hold zeros when the kernels begin. Inputs are tensors and plain
    numbers; the gradient is by the tensors of floats. Kernels must not write to inputs.

    Args:
        function: a kernel whose parameters are arrays and numbers; or a function of tensors and
            numbers, annotated `float`, `int` or `bool`, that launches kernels. It must compute with
            kernels alone: torch's functions have no gradient within it.
        outputs: for each parameter that is a result, the name of the input that has its shape, type
            and device; or a function of the inputs that returns the shape (the type and device are
            those of the first tensor) or a tensor that is like it, as `torch.empty(…)`.
        name: by which torch knows the operator, `tai::name`; must be unique in the process.

    Returns:
        The operator, for eager calls, `torch.compile(fullgraph=True)`, `torch.func` and `vmap`.

    Raises:
        TaiRuntimeTypeError: a parameter that is neither an array nor a number, an output that is no
            parameter, and at the first call, an input that the kernels write.
        TaiAutodiffError: on a backward pass, a gradient that is differentiated again.
    """
    return Operator(function, outputs, name)


def module(function: Any, outputs: dict[str, Any] | None = None, **owned: Any) -> Module:
    """A layer of a network that calls an operator with tensors that it owns.

    ```python
    layer = tai.torch.module(scale, outputs={"y": "x"}, w=torch.nn.Parameter(torch.ones(3)))
    y = layer(x)
    ```

    Args:
        function: an operator, or what `wrap` takes, with its outputs.
        outputs: see `wrap`.
        owned: tensors for inputs, by name: a `torch.nn.Parameter` becomes a parameter of the layer,
            another tensor a buffer.
    """
    operator = function if isinstance(function, Operator) else wrap(function, outputs or {})
    return Module(operator, owned)


check_keywords(globals())
