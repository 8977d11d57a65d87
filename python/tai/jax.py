"""`tai.jax`: kernels as differentiable functions of JAX.

Importing it imports JAX; `import tai` does not.
"""

from __future__ import annotations

from typing import Any

from ._impl.base.keywords import check_keywords
from ._impl.frameworks.jax_operators import Operator

__all__ = ["Operator", "wrap"]


def wrap(function: Any, outputs: dict[str, Any]) -> Operator:
    """Makes a kernel, or a function that launches kernels, a differentiable function of JAX.

    ```python
    @ti.kernel
    def square(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[i] = x[i] * x[i]


    f = jax.jit(tai.jax.wrap(square, outputs={"y": "x"}))
    jax.grad(lambda x: f(x).sum())(jnp.arange(3.0))  # 2 x
    ```

    A call gives the parameters that are not outputs, in order, and returns the outputs in order:
    one array, or a tuple. Outputs hold zeros when the kernels begin. Kernels must not write to
    inputs. Gradients are by the arrays of floats and by numbers of type float.

    Args:
        function: a kernel whose parameters are arrays and numbers; or a function of arrays and
            numbers, annotated `float`, `int` or `bool`, that launches kernels.
        outputs: for each parameter that is a result, the name of the input that has its shape and
            type; or a function of the inputs that returns the shape (the type is that of the first
            array) or a `jax.ShapeDtypeStruct`.

    Returns:
        The function, for `jit`, `grad`, `vmap` and `scan`.

    Raises:
        TaiRuntimeTypeError: a parameter that is neither an array nor a number, or an output that is
            no parameter.
        TaiAutodiffError: as it is traced, a gradient that is differentiated again.
    """
    return Operator(function, outputs)


check_keywords(globals())
