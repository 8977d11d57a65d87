"""`ti.profiler`: run times of kernels, and counters of skipped work.

Times need `ti.init(kernel_profiler=True)`; `skips` and `print_skips` do not. On a GPU, times are
measured by its events: the host does not wait for kernels. See docs/guides/gpu.md.
"""

from __future__ import annotations

import json
import math
import os
import weakref
from dataclasses import dataclass
from typing import Any

from ._impl.base import state
from ._impl.base.files import write_text
from ._impl.base.keywords import check_keywords
from ._impl.base.locks import snapshot
from ._impl.base.skips import Skips as Skips
from ._impl.base.skips import clear_skips as clear_skips
from ._impl.base.skips import print_skips as print_skips
from ._impl.base.skips import skips as skips
from ._impl.launch import bandwidth
from .errors import TaiRuntimeError, spelled

_KINDS = ("host", "device", "memory")

# The measured bandwidth of each program, in GB/s.
_roofs: weakref.WeakKeyDictionary[Any, float] = weakref.WeakKeyDictionary()


@dataclass
class KernelStats:
    """The times of one kernel, or of one of its loops on a GPU, in milliseconds.

    Attributes:
        kind: "host", "device", or "memory" for copies and fills that a GPU does.
        place: `file:line:column`, or empty.
        bytes: the number that a launch reads and writes if it touches each element of its fields
            once, or of the part of them that a constant index says; None where that is not known:
            for gradients, sparse fields, and loops of a kernel that has several.
        registers, local_bytes: of a thread; shared_bytes: of a block; None if not known.
        occupancy: resident threads of this kernel by the maximum of a GPU, 0 to 1.
        blocks, threads: of the last launch; threads of one block.
        roof: the bandwidth that `measure_bandwidth` has found, in GB/s; None before.
    """

    name: str
    counter: int
    total: float
    min: float
    max: float
    kind: str = "host"
    place: str = ""
    bytes: int | None = None
    registers: int | None = None
    local_bytes: int | None = None
    shared_bytes: int | None = None
    occupancy: float | None = None
    blocks: int = 0
    threads: int = 0
    roof: float | None = None

    @property
    def avg(self) -> float:
        return self.total / self.counter if self.counter else 0.0

    @property
    def gigabytes_per_second(self) -> float | None:
        """The memory bandwidth: `bytes` divided by the mean time."""
        if self.bytes is None or not self.total:
            return None
        return self.bytes * self.counter / self.total * 1e-6

    @property
    def roofline(self) -> float | None:
        """The share of the measured bandwidth that the kernel reaches, 0 to 1; more than 1 if its
        memory is in a cache. Kernels without `bytes` have None, as all have before
        `measure_bandwidth`."""
        used = self.gigabytes_per_second
        return None if used is None or not self.roof else used / self.roof


def _known(number: Any) -> Any:
    return None if number < 0 else number


def _context() -> Any:
    if not state.options.kernel_profiler:
        raise TaiRuntimeError("the profiler is off", "turn it on: ti.init(kernel_profiler=True)")
    return state.program.context


def measure_bandwidth() -> float:
    """Measures the memory bandwidth, in GB/s, by a kernel that reads and writes 64 MiB each.

    The number is of all threads of the program, or of the GPU, and is measured once for each
    program. Statistics have the share that each kernel reaches from then on: its `roofline`.

    Raises:
        TaiRuntimeError: a tape records, or `ti.init` was not called.
    """
    if state.program is None:
        raise TaiRuntimeError("there is no program to measure", "call ti.init first")
    if state.program not in _roofs:
        _roofs[state.program] = bandwidth.measure_bandwidth()
    return _roofs[state.program]


def get_stats(memory: bool = False) -> list[KernelStats]:
    """The statistics of all kernels since the last clear, longest first; waits for the GPU.

    Args:
        memory: include copies and fills of a GPU.
    """
    if state.program is None:
        return []
    rows = []
    roof = _roofs.get(state.program)
    for name, counter, total, least, most, place, kind, *rest in _context().profile():
        if spelled(name).startswith(bandwidth.PREFIX):
            continue
        if memory or _KINDS[kind] != "memory":
            known = [_known(number) for number in rest[:5]]
            row = KernelStats(
                spelled(name), counter, total, least, most, _KINDS[kind], place, *known, *rest[5:]
            )
            row.roof = roof
            rows.append(row)
    return sorted(rows, key=lambda row: -row.total)


def _line(place: str) -> str:
    """`file:line` without folders."""
    return os.path.basename(place.rpartition(":")[0])


def _print_counts() -> None:
    rows = get_stats(memory=True)
    total = sum(row.total for row in rows) or 1.0
    device = any(row.kind != "host" for row in rows)
    title = f"{'%':>7} {'total ms':>11} {'calls':>9} {'min ms':>9} {'avg ms':>9} {'max ms':>9}"
    title += f" {'GB/s':>8}"
    has_roof = any(row.roof for row in rows)
    if has_roof:
        title += f" {'roof':>6}"
    if device:
        title += f" {'regs':>5} {'local':>6} {'shared':>7} {'occup.':>7} {'blocks x threads':>17}"
    print(title + "  kernel")

    def show(number: Any, width: int, digits: str = "") -> str:
        return f" {'' if number is None else format(number, digits):>{width}}"

    for row in rows:
        line = f"{100 * row.total / total:6.2f}% {row.total:11.3f} {row.counter:9d} "
        line += f"{row.min:9.4f} {row.avg:9.4f} {row.max:9.4f}"
        line += show(row.gigabytes_per_second, 8, ".1f")
        if has_roof:
            line += show(row.roofline, 6, ".0%")
        if device:
            line += show(row.registers, 5) + show(row.local_bytes, 6) + show(row.shared_bytes, 7)
            line += show(row.occupancy, 7, ".0%")
            line += show(f"{row.blocks} x {row.threads}" if row.threads else None, 17)
        print(f"{line}  {row.name}" + (f" ({_line(row.place)})" if row.place else ""))


def _print_launches() -> None:
    print(f"{'start ms':>12} {'ms':>9} {'blocks x threads':>17}  kernel")
    on_device = any(event["device"] for event in _events())
    for event in _events():
        if event["device"] == on_device:
            shape = f"{event['blocks']} x {event['threads']}" if event["threads"] else ""
            print(
                f"{event['start'] / 1000:12.4f} {event['duration'] / 1000:9.4f} "
                f"{shape:>17}  {event['name']}"
            )


def print_kernel_profiler_info(mode: str = "count") -> None:
    """Prints the times of kernels as a table.

    Args:
        mode: `count`, a table of kernels; `roofline`, the same with the share of the measured
            bandwidth that each reaches; or `trace`, each launch in order.
    """
    if mode == "count":
        _print_counts()
    elif mode == "roofline":
        print(f"measured bandwidth: {measure_bandwidth():.1f} GB/s")
        _print_counts()
    elif mode == "trace":
        _print_launches()
    else:
        raise TaiRuntimeError(
            f"there is no mode {mode!r}", "the modes are 'count', 'roofline' and 'trace'"
        )


def _events() -> list[dict[str, Any]]:
    if state.program is None:
        return []
    names = (
        "name", "place", "kind", "device", "thread", "start", "duration", "queued", "blocks",
        "threads",
    )  # fmt: skip
    events = [dict(zip(names, event, strict=True)) for event in _context().trace()[0]]
    return [one for one in events if not one["name"].startswith(bandwidth.PREFIX)]


def save_trace(path: Any) -> None:
    """Writes all events since the last clear, for Perfetto (ui.perfetto.dev) or Chrome.

    Threads of the host and the GPU have a row each, by one clock; an arrow leads from where work
    was queued to where it was done.

    Args:
        path: of the file, JSON.
    """
    host, gpu = 1, 2
    events: list[dict[str, Any]] = []

    def name(what: str, process: int, thread: int | None, text: str) -> None:
        where = {"pid": process} if thread is None else {"pid": process, "tid": thread}
        events.append({"ph": "M", "name": what, **where, "args": {"name": text}})

    found = _events()
    name("process_name", host, None, "host")
    for thread in sorted({event["thread"] for event in found}):
        name("thread_name", host, thread, f"thread {thread}")
    if any(event["device"] for event in found):
        name("process_name", gpu, None, "GPU")
        name("thread_name", gpu, 0, "queue")
    for number, event in enumerate(found):
        where = {"pid": gpu, "tid": 0} if event["device"] else {"pid": host, "tid": event["thread"]}
        details = {key: event[key] for key in ("place", "blocks", "threads") if event[key]}
        events.append(
            {
                "ph": "X",
                "name": event["name"],
                "cat": _KINDS[event["kind"]],
                **where,
                "ts": event["start"],
                "dur": event["duration"],
                "args": details,
            }  # fmt: skip
        )
        if event["device"]:
            arrow = {"name": "queued", "cat": "queued", "id": number}
            begin = {"pid": host, "tid": event["thread"], "ts": event["queued"]}
            events.append({"ph": "s", **arrow, **begin})
            events.append({"ph": "f", "bp": "e", **arrow, **where, "ts": event["start"]})
    write_text(path, json.dumps({"traceEvents": events, "displayTimeUnit": "ms"}))


def clear_kernel_profiler_info() -> None:
    """Forgets the times measured so far."""
    if state.program is not None:
        state.program.context.clear_profile()


def query_kernel_profiler_info(name: str) -> KernelStats:
    """Returns the statistics of all kernels of this name together."""
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
    """Returns the statistics of one kernel, or of all kernels."""
    return get_stats() if name is None else query_kernel_profiler_info(name)


def get_kernel_profiler_total_time() -> float:
    """Returns the seconds that all kernels took together."""
    return sum(row.total for row in get_stats()) / 1000


def set_kernel_profiler_toolkit(name: str = "default") -> bool:
    """Returns whether the toolkit exists; "default" is the only one."""
    return name == "default"


def print_scoped_profiler_info() -> None:
    """Scopes are not timed."""


def clear_scoped_profiler_info() -> None:
    """Scopes are not timed."""


def print_memory_profiler_info() -> None:
    """Prints how much memory the elements of each field take, the greatest first.

    The number of a field below sparse levels is for all of its cells, active or not.
    """
    rows = []
    for field in snapshot(state.program.fields.values()) if state.program is not None else ():
        count = math.prod(field.shape) * math.prod(field.element_shape)
        dt = field.dtype
        kind = f"{dt}" + "".join(f"×{n}" for n in field.element_shape)
        is_sparse = field.level.nearest_sparse() is not None
        rows.append((count * dt.numpy.itemsize, field.name, kind, field.shape, is_sparse))
    print(f"{'bytes':>16}  field")
    for size, name, kind, shape, is_sparse in sorted(rows, key=lambda row: -row[0]):
        print(f"{size:>16,}  {name}: {kind}, shape {shape}{', if all active' * is_sparse}")
    print(f"{sum(row[0] for row in rows):>16,}  together")


check_keywords(globals())
