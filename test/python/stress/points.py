"""A function at many points in one parallel loop, with its gradient at each of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import tai as ti

MODES = ["reverse", "forward"]
TYPES = {"f64": ti.f64, "f32": ti.f32}


def number(dtype: str) -> Any:
    """NumPy's type of that name."""
    return np.dtype(dtype.replace("f", "float")).type


class Points:
    """A function of some numbers, compiled once.

    Args:
        function: gets a kernel's vector of the numbers and returns a number; it is traced.
        inputs: how many numbers.
        count: how many points.
        dtype: `f64` or `f32`.
        mode: `reverse`: one sweep; `forward`: one run for each number.
    """

    def __init__(
        self, function: Callable[[Any], Any], inputs: int, count: int, dtype: str, mode: str
    ):
        self.numpy, self.is_forward = number(dtype), mode == "forward"
        kinds = {"needs_dual": True} if self.is_forward else {"needs_grad": True}
        xs = self.xs = [ti.field(TYPES[dtype], shape=count, **kinds) for _ in range(inputs)]
        y = self.y = ti.field(TYPES[dtype], shape=count, **kinds)
        total = self.total = ti.field(TYPES[dtype], shape=(), **kinds)

        @ti.kernel
        def run():
            for i in y:
                y[i] = function(ti.Vector([x[i] for x in xs]))

        @ti.kernel
        def add():
            for i in y:
                total[None] += y[i]

        self.run, self.add = run, add

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (count,) and gradients (count, inputs) at `points` (count, inputs)."""
        for x, column in zip(self.xs, np.asarray(points, self.numpy).T, strict=True):
            x.from_numpy(np.ascontiguousarray(column))
        if not self.is_forward:
            with ti.ad.Tape(self.total):
                self.run()
                self.add()
            return self.y.to_numpy(), np.stack([x.grad.to_numpy() for x in self.xs], axis=1)
        columns = []
        for x in self.xs:
            with ti.ad.FwdMode(loss=self.y, param=x, seed=[1.0] * len(points)):
                self.run()
            columns.append(self.y.dual.to_numpy())
        return self.y.to_numpy(), np.stack(columns, axis=1)
