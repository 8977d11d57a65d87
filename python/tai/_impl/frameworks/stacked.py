"""The operators by which `vmap` launches once for a batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ...errors import TaiError
from ..launch.kernels import Kernel
from ..launch.stacked import StackedKernel


class Stacks:
    """The operators for batches of an operator, by the inputs that have a batch.

    Attributes:
        operators: those that were made, by the names of these inputs.
        reasons: why a batch is launched element by element, by the names of the arrays that have
            a batch.
    """

    def __init__(
        self, function: Any, outputs: Sequence[str], make: Callable[[StackedKernel, list[str]], Any]
    ):
        """Makes an empty collection of operators for batches.

        Args:
            function: the kernel or function of the operator for one element.
            outputs: the names of its results.
            make: the operator of a kernel for batches, and the names of the inputs that have one.
        """
        self._function, self._outputs, self._make = function, outputs, make
        self.operators: dict[frozenset[str], Any] = {}
        self.reasons: dict[frozenset[str], str] = {}

    def find(self, names: list[str]) -> Any:
        """The operator for inputs with a batch; None where each element has a launch of its
        own."""
        arrays, key = frozenset([*names, *self._outputs]), frozenset(names)
        if not names or arrays in self.reasons:
            return None
        if not isinstance(self._function, Kernel):
            self.reasons[arrays] = f"'{self._function.__name__}' is a function, and no kernel"
        elif self._function.batch is not None:
            self.reasons[arrays] = f"'{self._function.__name__}' runs for a batch already"
        else:
            if key not in self.operators:
                self.operators[key] = self._make(StackedKernel(self._function, arrays), names)
            return self.operators[key]
        return None

    def refuse(self, names: list[str], error: TaiError) -> None:
        """Notes that a batch of these inputs cannot run as one launch, so that each element gets
        its own launch from now on.
        """
        self.reasons[frozenset([*names, *self._outputs])] = error.message
