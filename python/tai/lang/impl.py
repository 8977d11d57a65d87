"""`ti.lang.impl`: the program behind the package."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

from .._impl.base import program, state
from .._impl.base.options import Options
from .._impl.fields.arrays import ndarray
from .._impl.fields.make import field
from .._impl.fields.root import materialize, open_root, root
from .._impl.values.ops import grouped, ndrange, static


class Runtime:
    """What `get_runtime()` returns."""

    @property
    def prog(self) -> program.Program:
        return program.get_program()

    @property
    def materialized(self) -> bool:
        return not open_root(self.prog).children

    def materialize(self) -> None:
        """Allocates the fields that were placed in the layout."""
        materialize(self.prog, sys._getframe(1).f_globals)

    def sync(self) -> None:
        program.sync()

    @property
    def default_fp(self) -> Any:
        return state.options.default_fp

    @property
    def default_ip(self) -> Any:
        return state.options.default_ip


_runtime = Runtime()


def get_runtime() -> Runtime:
    return _runtime


def current_cfg() -> Options:
    """The options of `ti.init`."""
    return state.options


def get_cuda_compute_capability() -> int:
    """Returns the compute capability of the first GPU, such as 90 for 9.0; 0 without a GPU."""
    try:
        cuda = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return 0
    device, numbers = ctypes.c_int(), (ctypes.c_int(), ctypes.c_int())
    if cuda.cuInit(0) != 0 or cuda.cuDeviceGet(ctypes.byref(device), 0) != 0:
        return 0
    # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR and _MINOR
    for attribute, number in zip((75, 76), numbers, strict=True):
        if cuda.cuDeviceGetAttribute(ctypes.byref(number), attribute, device) != 0:
            return 0
    return 10 * numbers[0].value + numbers[1].value


__all__ = [
    "Runtime", "current_cfg", "field", "get_cuda_compute_capability", "get_runtime", "grouped",
    "ndarray", "ndrange", "root", "static",
]  # fmt: skip
