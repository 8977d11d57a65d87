"""`ti.algorithms`: sorting, and sums of all elements before each one.

They are kernels: they run where the program does, and a tape can record them.
"""

from __future__ import annotations

import functools
from typing import Any

from ._impl.base.dtypes import i32
from ._impl.fields.make import field
from ._impl.fields.scalar import ScalarField
from ._impl.launch.kernels import kernel
from ._impl.values.ops import loop_config, min, static
from ._impl.values.types import template
from .errors import TaiRuntimeTypeError

__all__ = ["PrefixSumExecutor", "parallel_sort"]

_BLOCK = 1024  # elements that one iteration adds up


@functools.cache
def _kernels() -> Any:
    class Kernels:
        @staticmethod
        @kernel
        def merge(
            keys: template(), values: template(), has_values: template(), width: i32, gap: i32,
            count: i32,
        ):  # fmt: skip
            # A stage of Batcher's network: pairs `gap` apart, in blocks of twice the width.
            first = gap % width
            for x in range(first, count - gap):
                is_lower = (x - first) // gap % 2 == 0
                if is_lower and x // (2 * width) == (x + gap) // (2 * width):
                    low, high = keys[x], keys[x + gap]
                    if high < low:
                        keys[x], keys[x + gap] = high, low
                        if static(has_values):
                            one, other = values[x], values[x + gap]
                            values[x], values[x + gap] = other, one

        @staticmethod
        @kernel
        def sum_blocks(x: template(), sums: template(), count: i32):
            for block in range((count + _BLOCK - 1) // _BLOCK):
                total = x[block * _BLOCK]
                for i in range(block * _BLOCK + 1, min((block + 1) * _BLOCK, count)):
                    total += x[i]
                    x[i] = total
                sums[block] = total

        @staticmethod
        @kernel
        def sum_sums(sums: template(), blocks: i32):
            loop_config(serialize=True)
            for block in range(1, blocks):
                sums[block] += sums[block - 1]

        @staticmethod
        @kernel
        def add_sums(x: template(), sums: template(), count: i32):
            for i in range(_BLOCK, count):
                x[i] += sums[i // _BLOCK - 1]

    return Kernels


def _length(x: Any, what: str) -> int:
    if not isinstance(x, ScalarField) or len(x.shape) != 1:
        raise TaiRuntimeTypeError(
            f"{what} takes a field of numbers with one index, but got {x!r}",
            "for arrays there are NumPy's functions",
        )
    return x.shape[0]


def parallel_sort(keys: Any, values: Any = None) -> None:
    """Sorts a field of numbers in place, the least one first.

    Args:
        keys: a field with one index.
        values: a field of as many numbers that is put in the same order, if any. Those of equal
            keys have no order.

    Raises:
        TaiRuntimeTypeError: something else than such fields, or fields of two lengths.
    """
    count = _length(keys, "parallel_sort")
    if values is not None and _length(values, "parallel_sort") != count:
        raise TaiRuntimeTypeError(
            f"parallel_sort takes as many values as keys: {count}, but got {values.shape[0]}"
        )
    merge, width = _kernels().merge, 1
    while width < count:
        gap = width
        while gap > 0:
            merge(keys, keys if values is None else values, values is not None, width, gap, count)
            gap //= 2
        width *= 2


class PrefixSumExecutor:
    """Replaces each number of a field by the sum of all up to it.

    Args:
        length: how many numbers there are.
    """

    def __init__(self, length: int):
        self.length = int(length)
        self._sums: dict[Any, Any] = {}

    def run(self, input_arr: Any) -> None:
        """Adds up the numbers of a field with one index, in place.

        Raises:
            TaiRuntimeTypeError: something else, or a field of another length.
        """
        count = _length(input_arr, "a prefix sum")
        if count != self.length:
            raise TaiRuntimeTypeError(
                f"this prefix sum is one of {self.length} numbers, but the field has {count}"
            )
        kernels, blocks = _kernels(), -(-count // _BLOCK)
        key = (input_arr.dtype, input_arr.grad is not None)
        if key not in self._sums:
            self._sums[key] = field(input_arr.dtype, shape=blocks, needs_grad=key[1])
        sums = self._sums[key]
        kernels.sum_blocks(input_arr, sums, count)
        if blocks > 1:
            kernels.sum_sums(sums, blocks)
            kernels.add_sums(input_arr, sums, count)
