"""`ti.algorithms`: sorting and prefix sums.

They are kernels: they run on the program's target, and tapes record them.
"""

from __future__ import annotations

from typing import Any

from ._impl.base.dtypes import i32
from ._impl.base.keywords import check_keywords
from ._impl.fields.make import field
from ._impl.fields.scalar import ScalarField
from ._impl.solvers.rows import BLOCK, kernels
from .errors import TaiRuntimeTypeError

__all__ = ["PrefixSumExecutor", "parallel_sort"]


def _length(x: Any, what: str) -> int:
    if not isinstance(x, ScalarField) or len(x.shape) != 1:
        raise TaiRuntimeTypeError(
            f"{what} takes a field of numbers with one index, but got {x!r}",
            "for arrays there are NumPy's functions",
        )
    return x.shape[0]


def parallel_sort(keys: Any, values: Any = None) -> None:
    """Sorts a field of numbers in place, in ascending order.

    Args:
        keys: a field with one index.
        values: a field of as many numbers that is put in the same order, if any. The order of equal
            keys is not defined.

    Raises:
        TaiRuntimeTypeError: something else than such fields, or fields of two lengths.
    """
    count = _length(keys, "parallel_sort")
    if values is not None and _length(values, "parallel_sort") != count:
        raise TaiRuntimeTypeError(
            f"parallel_sort takes as many values as keys: {count}, but got {values.shape[0]}"
        )
    fields = [keys] if values is None else [keys, values]
    if all(part.grad is None for part in fields):
        _sort(keys, values, count)
        return
    # The derivative of a sort is a permutation: it is found without gradients, and then applied.
    parts = kernels()
    order, plain = field(i32, shape=count), field(keys.dtype, shape=count)
    parts.number(order, count)
    parts.copy_numbers(keys, plain, count)
    _sort(plain, order, count)
    for part in fields:
        before = field(part.dtype, shape=count, needs_grad=part.grad is not None)
        parts.copy(part, before, count)
        parts.take(before, order, part, count)


def _sort(keys: Any, values: Any, count: int) -> None:
    """Sorts by Batcher's network, for fields without gradients."""
    merge, width = kernels().merge, 1
    while width < count:
        gap = width
        while gap > 0:
            merge(keys, keys if values is None else values, values is not None, width, gap, count)
            gap //= 2
        width *= 2


class PrefixSumExecutor:
    """Inclusive prefix sums: replaces each number of a field by the sum of all up to it.

    Args:
        length: how many numbers there are.
    """

    def __init__(self, length: int):
        self.length = int(length)
        self._sums: dict[Any, Any] = {}

    def run(self, input_arr: Any) -> None:
        """Replaces the numbers of a field with one index by their prefix sums, in place.

        Raises:
            TaiRuntimeTypeError: something else, or a field of another length.
        """
        count = _length(input_arr, "a prefix sum")
        if count != self.length:
            raise TaiRuntimeTypeError(
                f"this prefix sum is one of {self.length} numbers, but the field has {count}"
            )
        parts, blocks = kernels(), -(-count // BLOCK)
        key = (input_arr.dtype, input_arr.grad is not None)
        if key not in self._sums:
            self._sums[key] = field(input_arr.dtype, shape=blocks, needs_grad=key[1])
        sums = self._sums[key]
        parts.sum_blocks(input_arr, sums, count)
        if blocks > 1:
            parts.sum_sums(sums, blocks)
            parts.add_sums(input_arr, sums, count)


check_keywords(globals())
