"""A program whose derivative ends in the middle, where a field has no gradient and no dual."""

import numpy as np
import tai as ti

N = 5


class Program:
    """x (with gradient and dual) -> tmp (without) -> y (with) -> loss."""

    def __init__(self, dtype=ti.f64, **kinds):
        both = {"needs_grad": True, "needs_dual": True}
        x = self.x = ti.field(ti.f64, shape=N, name="x", **both)
        tmp = self.tmp = ti.field(dtype, shape=N, name="tmp", **kinds)
        y = self.y = ti.field(ti.f64, shape=N, name="y", **both)
        loss = self.loss = ti.field(ti.f64, shape=(), name="loss", **both)
        x.from_numpy(np.arange(1.0, N + 1))

        @ti.kernel
        def keep():
            for i in x:
                tmp[i] = 2 * x[i]

        @ti.kernel
        def go_on():
            for i in x:
                y[i] = tmp[i] * x[i]

        @ti.kernel
        def total():
            for i in y:
                loss[None] += y[i]

        self.keep, self.go_on, self.total = keep, go_on, total

    def run(self):
        self.keep()
        self.go_on()
        self.total()
