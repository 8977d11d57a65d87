"""Values and derivatives of a function at one point, for the tests of kinks and singular points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import tai as ti

MODES = ["reverse"]
TYPES = {"f64": ti.f64, "f32": ti.f32}


def derive(
    function: Callable[[Any], Any], at: Any, dtype: str, mode: str = "reverse", **options: Any
) -> tuple[float, np.ndarray]:
    """The value and the gradient of a function of some numbers.

    Args:
        function: gets a kernel's vector of the numbers (or the matrix of them) and returns a
            number; it is traced.
        at: the point, of the shape of what `function` gets: `(n,)` or `(n, m)`.
        dtype: `f64` or `f32`.
        mode: `reverse`: one sweep; `forward`: one run for each component.
        options: of `ti.init`.

    Returns:
        The value, and the gradient in the shape of `at`.
    """
    ti.init(arch=ti.cpu, default_fp=TYPES[dtype], offline_cache=False, **options)
    at = np.asarray(at, np.float64)
    flat = at.ravel()
    forward = mode == "forward"
    x = ti.field(TYPES[dtype], shape=flat.size, needs_grad=not forward, needs_dual=forward)
    loss = ti.field(TYPES[dtype], shape=(), needs_grad=not forward, needs_dual=forward)

    @ti.kernel
    def run():
        if ti.static(at.ndim == 1):
            loss[None] = function(ti.Vector([x[i] for i in range(at.size)]))
        else:
            rows = [[x[i * at.shape[1] + j] for j in range(at.shape[1])] for i in range(len(at))]
            loss[None] = function(ti.Matrix(rows))

    x.from_numpy(flat.astype(dtype.replace("f", "float")))
    if not forward:
        with ti.ad.Tape(loss):
            run()
        return loss[None], x.grad.to_numpy().reshape(at.shape)
    gradient = np.zeros(flat.size)
    for k in range(flat.size):
        with ti.ad.FwdMode(loss=loss, param=x, seed=np.eye(flat.size)[k].tolist()):
            run()
        gradient[k] = loss.dual[None]
    return loss[None], gradient.reshape(at.shape)
