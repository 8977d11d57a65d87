"""Estimates of the serial work of a thread, for warnings: a thread of a GPU is slow."""

from __future__ import annotations

import ast
import math
import warnings
from typing import Any

from ...errors import TaiCompilationWarning
from ..values.value import Value
from .context import Context, Part

# If a thread of a GPU runs this many operations in sequence, the user is warned that the thread may
# take long. Three million with their gradient took less than half a second on an H100.
_LONG = 1e7
# The number of iterations up to which a loop is not worth a GPU.
_FEW = 32


class SerialWork(Part):
    """Counts the operations of an iteration while kernels are compiled.

    Attributes:
        work: operations so far of one thread.
    """

    def __init__(self, context: Context):
        super().__init__(context)
        self.work = 0.0
        # The number of iterations of the surrounding parallel loop, and whether the warning was
        # given.
        self._threads = 1.0
        self._told = False

    def end_serial(self, before: float, low: Any, high: Any, step: Any, node: ast.For) -> None:
        """Called when a serial loop has been compiled; `before` is the number of operations counted
        before the loop.
        """
        self.repeat(before, count_trips(low, high, step, unknown=1), node)

    def repeat(self, before: float, trips: float, node: ast.For) -> None:
        """Multiplies the work counted since `before` by the number of trips of a loop."""
        self.work = before + (self.work - before) * trips
        is_long = self.work - before > _LONG and self._threads <= _FEW
        if is_long and not self._told and self.context.options.arch == "cuda":
            self._told = True
            self._warn(self.work - before, node)

    def begin_parallel(self, bounds: Any, shape: Any, is_serial: bool) -> tuple[float, float]:
        """Begins a loop at the top of a kernel; returns the state that `end_parallel` needs."""
        kept = self.work, self._threads
        if not is_serial:
            self._threads *= self._iterations(bounds, shape)
        return kept

    def end_parallel(
        self, kept: tuple[float, float], bounds: Any, shape: Any, is_serial: bool, node: ast.For
    ) -> None:
        if is_serial:
            self.repeat(kept[0], self._iterations(bounds, shape), node)
        else:
            self.work, self._threads = kept

    def _iterations(self, bounds: Any, shape: Any) -> float:
        if bounds is None:
            return math.prod(shape)
        pairs = zip(bounds.lower, bounds.upper, strict=True)
        return math.prod(count_trips(low, high, bounds.step, math.inf) for low, high in pairs)

    def _warn(self, work: float, node: ast.For) -> None:
        text = (
            f"kernel '{self.context.kernel_name}': this loop runs on one thread of the GPU, some "
            f"{work / 1e6:.1f} million operations one after another\n"
            "  hint: a CPU is usually faster at that: ti.init(arch=ti.cpu); on a GPU, make what is "
            "independent the outermost loop"
        )
        warnings.warn_explicit(
            text, TaiCompilationWarning, self.frame.filename, node.lineno, registry=_shown
        )


def count_trips(low: Any, high: Any, step: Any, unknown: float) -> float:
    """The number of iterations of a range; `unknown` if a bound is computed by the kernel."""
    if any(isinstance(part, Value) for part in (low, high, step)):
        return unknown
    return max(0, math.ceil((high - low) / abs(step)))


_shown: dict = {}
