"""Values and derivatives of a function at one point, for the tests of kinks and singular points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import tai as ti

MODES = ["reverse", "forward"]
TYPES = {"f64": ti.f64, "f32": ti.f32}


class Derivation:
    """A function of some numbers, compiled once, with its gradient.

    Args:
        function: gets a kernel's vector of the numbers (or the matrix of them) and returns a
            number; it is traced.
        shape: of the numbers: `(n,)` or `(n, m)`.
        dtype: `f64` or `f32`.
        mode: `reverse`: one sweep; `forward`: one run for each component.
        options: of `ti.init`.
    """

    def __init__(
        self, function: Callable[[Any], Any], shape: tuple[int, ...], dtype: str,
        mode: str = "reverse", **options: Any,
    ):  # fmt: skip
        ti.init(arch=ti.cpu, default_fp=TYPES[dtype], offline_cache=False, **options)
        self.shape, self.size = shape, int(np.prod(shape))
        self.numpy = np.dtype(dtype.replace("f", "float"))
        self.is_forward = mode == "forward"
        kinds = {"needs_dual": True} if self.is_forward else {"needs_grad": True}
        x = self.x = ti.field(TYPES[dtype], shape=self.size, name="x", **kinds)
        loss = self.loss = ti.field(TYPES[dtype], shape=(), name="loss", **kinds)

        @ti.kernel
        def run():
            for _ in range(1):  # loops of the function are inner, and so serial
                if ti.static(len(shape) == 1):
                    loss[None] = function(ti.Vector([x[i] for i in range(shape[0])]))
                else:
                    n, m = ti.static(shape[0], shape[1])
                    rows = [[x[i * m + j] for j in range(m)] for i in range(n)]
                    loss[None] = function(ti.Matrix(rows))

        self.run = run

    def __call__(self, at: Any) -> tuple[float, np.ndarray]:
        """The value, and the gradient in the shape of the point `at`."""
        self.x.from_numpy(np.asarray(at, self.numpy).ravel())
        if not self.is_forward:
            with ti.ad.Tape(self.loss):
                self.run()
            return self.loss[None], self.x.grad.to_numpy().reshape(self.shape)
        gradient = np.zeros(self.size)
        for k in range(self.size):
            seed = np.eye(self.size)[k].tolist()
            with ti.ad.FwdMode(loss=self.loss, param=self.x, seed=seed):
                self.run()
            gradient[k] = self.loss.dual[None]
        return self.loss[None], gradient.reshape(self.shape)


def derive(
    function: Callable[[Any], Any], at: Any, dtype: str, mode: str = "reverse", **options: Any
) -> tuple[float, np.ndarray]:
    """The value and the gradient of a function at one point; see `Derivation`."""
    return Derivation(function, np.shape(at), dtype, mode, **options)(at)
