"""The memory bandwidth of the device that runs kernels: the roof of kernels that compute little."""

from __future__ import annotations

import functools
import time
from typing import Any

from ...errors import TaiRuntimeError
from ..base import state
from ..base.dtypes import f32
from ..base.program import sync
from ..fields.make import make_field
from ..fields.snode import FieldsBuilder
from ..values.types import template
from .kernels import kernel

# The names of the kernels of a measurement begin so; `ti.profiler` leaves them out.
PREFIX = "tai_bandwidth_"
# Arrays of so many bytes are larger than most caches.
_BYTES = 1 << 26
_ROUNDS, _LAUNCHES = 5, 4


@functools.cache
def _get_kernel() -> Any:
    @kernel
    def tai_bandwidth_scale(target: template(), source: template()):  # type: ignore
        for at in target:
            target[at] = 2.0 * source[at]

    return tai_bandwidth_scale


def measure_bandwidth() -> float:
    """Measures the bandwidth by a kernel that reads one field and writes another, in GB/s.

    Raises:
        TaiRuntimeError: a tape records, or forward mode is on.
    """
    if state.tape is not None or state.forward:
        raise TaiRuntimeError(
            "the bandwidth is measured by launches, which a tape would record",
            "measure it outside of the tape",
        )
    builder = FieldsBuilder()
    target, source = (make_field((), f32, None, None, None, None, False, False) for _ in range(2))
    for field in (target, source):
        builder.dense((0,), (_BYTES // 4,)).place(field)
    tree = builder.finalize()
    try:
        source.fill(1.0)
        scale = _get_kernel()
        scale(target, source)
        seconds = []
        for _ in range(_ROUNDS):
            sync()
            begin = time.perf_counter()
            for _ in range(_LAUNCHES):
                scale(target, source)
            sync()
            seconds.append(time.perf_counter() - begin)
    finally:
        tree.destroy()
    return 2 * _BYTES * _LAUNCHES / min(seconds) * 1e-9
