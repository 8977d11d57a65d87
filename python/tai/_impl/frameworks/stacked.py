"""The kernels by which `vmap` launches once for a batch."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ...errors import TaiError
from ..launch.kernels import Kernel
from ..launch.stacked import StackedKernel


class Stacks:
    """The kernels for batches of an operator, by the arrays that have a batch.

    Attributes:
        reasons: why a batch is launched element by element, by the names of these arrays.
    """

    def __init__(self, function: Any):
        self._function = function
        self._known: dict[frozenset[str], StackedKernel] = {}
        self.reasons: dict[frozenset[str], str] = {}

    def find(self, names: Iterable[str]) -> StackedKernel | None:
        """The kernel for arrays with a batch; None where each element has a launch of its own."""
        key = frozenset(names)
        if key in self.reasons:
            return None
        if not isinstance(self._function, Kernel):
            self.reasons[key] = f"'{self._function.__name__}' is a function, and no kernel"
        elif self._function.batch is not None:
            self.reasons[key] = f"'{self._function.__name__}' runs for a batch already"
        else:
            if key not in self._known:
                self._known[key] = StackedKernel(self._function, key)
            return self._known[key]
        return None

    def refuse(self, names: Iterable[str], error: TaiError) -> None:
        """From now on, each element of such a batch has a launch of its own."""
        self.reasons[frozenset(names)] = error.message
