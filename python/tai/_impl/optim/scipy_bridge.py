"""SciPy's minimisers on the parameters of a tape."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import TaiAutodiffError, TaiError, TaiRuntimeTypeError
from ..ad.forward import hvp
from ..ad.tape import Tape
from .objective import Objective
from .parameters import check_outside, check_parameters

# Methods of SciPy that use products with the Hessian matrix.
_SECOND_ORDER = {"newton-cg", "trust-ncg", "trust-krylov", "trust-constr"}


def scipy_minimize(function: Any, parameters: Any, method: str = "L-BFGS-B", **options: Any) -> Any:
    """Minimises a loss by `scipy.optimize.minimize`; SciPy must be installed.

    ```python
    with ti.ad.Tape(loss) as tape:
        simulate()
    result = ti.optim.scipy_minimize(tape, [x], method="L-BFGS-B", tol=1e-8)
    ```

    Parameters and gradients pass through NumPy, in f64. Methods that ask for products with the
    Hessian matrix (Newton-CG, trust-ncg, trust-krylov, trust-constr) get those of `ti.ad.hvp`, if
    `function` is a tape and its fields have duals.

    Args:
        function: a tape with a loss, which is replayed, or a function that runs a tape and
            returns the loss.
        parameters: a field or `ti.ndarray` with a gradient, or a list of them; not sparse. Their
            numbers, one parameter after the other, are SciPy's vector.
        method: as SciPy names it.
        options: all else goes to `scipy.optimize.minimize`: bounds, tol, callback, options, …

    Returns:
        SciPy's `OptimizeResult`. The parameters hold `result.x`.

    Raises:
        TaiAutodiffError: the loss or its gradient is not finite at the start, or the loss is a
            parameter.
    """
    user = "ti.optim.scipy_minimize"
    try:
        from scipy import optimize
    except ImportError:
        raise TaiError(f"{user} needs SciPy, which is not installed", "pip install scipy") from None
    check_outside(user)
    for name in ("fun", "x0", "jac"):
        if name in options:
            raise TaiRuntimeTypeError(
                f"{user} gives '{name}' to SciPy itself", f"leave {name}= away"
            )
    found = check_parameters(parameters, user)
    for p in found:
        p.require_dense(user)
    objective = Objective(function, user, found)

    def shape_of(p: Any) -> tuple[int, ...]:
        return tuple(p.value.shape) + tuple(p.value.element_shape)

    def parts(vector: np.ndarray) -> list[np.ndarray]:
        ends = np.cumsum([p.size for p in found])[:-1]
        return [v.reshape(shape_of(p)) for v, p in zip(np.split(vector, ends), found, strict=True)]

    def store(vector: np.ndarray) -> None:
        for p, part in zip(found, parts(vector), strict=True):
            p.value.from_numpy(part.astype(p.value.dtype.numpy))

    def gather(of: Any) -> np.ndarray:
        return np.concatenate([of(p).astype(np.float64).ravel() for p in found])

    def evaluate(vector: np.ndarray) -> tuple[float, np.ndarray]:
        store(vector)
        loss = objective.evaluate()
        return loss, gather(lambda p: p.value.grad.to_numpy())

    start = gather(lambda p: p.value.to_numpy())
    loss, gradient = evaluate(start)
    if not (np.isfinite(loss) and np.isfinite(gradient).all()):
        store(start)
        first = next(filter(None, (p.first_not_finite() for p in found)), "")
        raise TaiAutodiffError(
            f"{user}: the loss is {loss:g} at the start" + (f", and {first}" if first else ""),
            "begin where the loss and its gradient are finite",
        )
    if method.lower() in _SECOND_ORDER and "hess" not in options and "hessp" not in options:
        if not isinstance(function, Tape) or not all(_has_dual(p.value) for p in found):
            raise TaiAutodiffError(
                f"{user}: method {method} needs second derivatives",
                "give a tape, and make its fields with needs_dual=True; or take L-BFGS-B",
            )
        fields = [p.value for p in found]

        def multiply(vector: np.ndarray, direction: np.ndarray) -> np.ndarray:
            store(vector)
            products = hvp(function, function.loss, fields, parts(direction))
            return np.concatenate([np.asarray(p, np.float64).ravel() for p in products])

        options["hessp"] = multiply
    result = optimize.minimize(evaluate, start, method=method, jac=True, **options)
    evaluate(result.x if np.isfinite(result.x).all() else start)
    return result


def _has_dual(value: Any) -> bool:
    dual = getattr(value, "dual", None)
    return dual is not None and dual.snode is not None
