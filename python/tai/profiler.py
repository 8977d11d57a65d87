"""`ti.profiler`: how long kernels run, and what was left out.

Times need `ti.init(kernel_profiler=True)`; `skips` and `print_skips` do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from . import _state
from ._skips import Skips as Skips
from ._skips import clear_skips as clear_skips
from ._skips import print_skips as print_skips
from ._skips import skips as skips
from .errors import TaiRuntimeError


@dataclass
class KernelStats:
    """The times of one kernel, in milliseconds."""

    name: str
    counter: int
    total: float
    min: float
    max: float

    @property
    def avg(self) -> float:
        return self.total / self.counter if self.counter else 0.0


def get_stats() -> list[KernelStats]:
    """The statistics of all kernels since the last clear, longest first."""
    if _state.program is None:
        return []
    if not _state.options.kernel_profiler:
        raise TaiRuntimeError("the profiler is off", "turn it on: ti.init(kernel_profiler=True)")
    rows = [KernelStats(*row) for row in _state.program.context.profile()]
    return sorted(rows, key=lambda row: -row.total)


def print_kernel_profiler_info(mode: str = "count") -> None:
    """Prints a table of the kernels and their times."""
    rows = get_stats()
    total = sum(row.total for row in rows) or 1.0
    print(
        f"{'%':>7} {'total ms':>11} {'calls':>9} {'min ms':>9} {'avg ms':>9} {'max ms':>9}  kernel"
    )
    for row in rows:
        print(
            f"{100 * row.total / total:6.2f}% {row.total:11.3f} {row.counter:9d} "
            f"{row.min:9.4f} {row.avg:9.4f} {row.max:9.4f}  {row.name}"
        )


def clear_kernel_profiler_info() -> None:
    """Forgets the times so far."""
    if _state.program is not None:
        _state.program.context.clear_profile()


def query_kernel_profiler_info(name: str) -> KernelStats:
    """The statistics of the kernels of this name together."""
    rows = [row for row in get_stats() if row.name == name or row.name.startswith(name + "_")]
    counter = sum(row.counter for row in rows)
    return KernelStats(
        name,
        counter,
        sum(row.total for row in rows),
        min((row.min for row in rows), default=0.0),
        max((row.max for row in rows), default=0.0),
    )


query_kernel_profiler_info_by_name = query_kernel_profiler_info


def get_kernel_stats(name: str | None = None) -> Any:
    """The statistics of one kernel, or of all."""
    return get_stats() if name is None else query_kernel_profiler_info(name)


def get_kernel_profiler_total_time() -> float:
    """Seconds that all kernels took together."""
    return sum(row.total for row in get_stats()) / 1000


def set_kernel_profiler_toolkit(name: str = "default") -> bool:
    """There is one toolkit."""
    return name == "default"


def print_scoped_profiler_info() -> None:
    """Scopes are not timed."""


def clear_scoped_profiler_info() -> None:
    """Scopes are not timed."""


print_memory_profiler_info = print_scoped_profiler_info
