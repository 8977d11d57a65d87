"""Tangents of arguments and results of kernels in forward mode.

In forward mode a number that a kernel returns is also stored to an element of a field, whose
dual is its tangent, and a kernel with such a number as an argument loads it from there.
Python arithmetic on such numbers is done by kernels, too. So second derivatives pass through
them as through fields.
"""

from __future__ import annotations

from typing import Any

from ...errors import TaiRuntimeError
from ..base import dtypes, state
from ..base.program import get_program
from ..fields.scalar import ScalarField
from ..fields.snode import FieldsBuilder, axes

# A function that returns the kernel for arithmetic on tangents; module `ad.library` sets this
# variable when it is loaded.
get_kernel: Any = None

# The most numbers that forward mode can follow at a time.
SIZE = 4096


class Pool:
    """A field that keeps tangents of numbers, and which of its elements are in use.

    Attributes:
        number: the number of the pool.
        field: a field of f64 with a gradient and a dual.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.field = ScalarField(dtypes.f64, "returned")
        self.field.needs_grad = self.field.needs_dual = True
        builder = FieldsBuilder()
        builder.dense(axes(0), SIZE).place(self.field)
        builder.finalize()
        # The free elements of the pool: contiguous runs by their length, and the first element that
        # was never in use.
        self._free: dict[int, list[int]] = {}
        self._next = 0

    def take(self, count: int) -> int:
        """Takes `count` free elements in a row; returns the number of the first."""
        free = self._free.get(count)
        if free:
            return free.pop()
        if self._next + count > SIZE:
            raise TaiRuntimeError(
                f"forward mode follows at most {SIZE} numbers that kernels have returned at a time",
                "keep them in a field",
            )
        self._next += count
        return self._next - count

    def give_back(self, first: int, count: int) -> None:
        self._free.setdefault(count, []).append(first)


def pool_besides(inputs: list[Any]) -> Pool:
    """Selects the pool of tangents for a value computed from values at these places; it differs
    from all of their pools.

    A kernel that reads and writes the same field may, to a tape, overwrite elements that it has
    read.
    """
    pools, taken = get_program().pools, {place.pool for place in inputs}
    for pool in pools:
        if pool not in taken:
            return pool
    pools.append(Pool(len(pools)))
    return pools[-1]


class Cell:
    """The place of the tangent of a number, vector or matrix in a pool; the place is free again
    when this object is deleted.
    """

    __slots__ = ("__weakref__", "count", "first", "pool")

    def __init__(self, pool: Pool, count: int):
        self.pool, self.count = pool, count
        self.first = pool.take(count)
        if state.tape is not None:
            state.tape.keep(self)

    def __del__(self) -> None:
        if hasattr(self, "first"):
            self.pool.give_back(self.first, self.count)

    @property
    def is_current(self) -> bool:
        """Whether forward mode is on, in the same program in which the number was made."""
        program = state.program
        return state.forward and program is not None and self.pool in program.pools


class Component:
    """The element of the pool that keeps the tangent of a component of a vector or matrix."""

    __slots__ = ("_whole", "count", "first", "pool")

    def __init__(self, whole: Cell, number: int):
        self._whole, self.pool = whole, whole.pool
        self.first, self.count = whole.first + number, 1

    @property
    def is_current(self) -> bool:
        return self._whole.is_current


def cell_of(value: Any) -> Any:
    """Returns the element that keeps the tangent of a value, if forward mode follows it."""
    cell = getattr(value, "_cell", None) if state.forward else None
    return cell if cell is not None and cell.is_current else None


def combine(name: str, a: Any, b: Any) -> Cell | None:
    """The place of the tangent of a result of Python arithmetic on two numbers; None if the result
    is a constant.
    """
    first, second = cell_of(a), cell_of(b)
    if first is None and second is None:
        return None
    out = Cell(pool_besides([cell for cell in (first, second) if cell is not None]), 1)
    get_kernel()(
        name, out.pool.field, None if first is None else first.pool.field,
        None if second is None else second.pool.field, out.first,
        -1 if first is None else first.first, -1 if second is None else second.first,
        float(a), float(b),
    )  # fmt: skip
    return out
