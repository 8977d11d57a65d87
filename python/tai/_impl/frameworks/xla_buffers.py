"""Memory of XLA: arrays of NumPy on the host, addresses with a stream on a GPU."""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError
from ..interop.device_arrays import DeviceArray


@functools.cache
def _driver() -> Any:
    return ctypes.CDLL("libcuda.so.1")


def _call(name: str, *args: Any) -> None:
    """Calls a function of the CUDA driver.

    Raises:
        TaiRuntimeError: the call failed.
    """
    status = getattr(_driver(), name)(*args)
    if status:
        raise TaiRuntimeError(f"{name} of the CUDA driver failed with status {status}")


def _address(value: int) -> Any:
    return ctypes.c_uint64(value)


class DeviceBuffer(DeviceArray):
    """An array in GPU memory that XLA owns.

    Attributes:
        queue: the stream of CUDA that orders work on it.
    """

    def __init__(self, address: int, shape: Any, dtype: Any, stream: int, owner: Any = None):
        super().__init__(address, shape, dtype, owner, stream=stream)
        self.queue = stream

    def __getitem__(self, index: tuple) -> DeviceBuffer:
        """Returns the part of the array at some first indices."""
        at = [i for i in index if i is not Ellipsis]
        rest = self.shape[len(at) :]
        step, offset = int(np.prod(rest, dtype=np.int64)), 0
        for i, extent in zip(at, self.shape, strict=False):
            offset = offset * extent + i
        address = self.ctypes.data + offset * step * self.dtype.itemsize
        part = DeviceBuffer(address, rest, self.dtype, self.queue, self)
        part.flags.writeable = self.flags.writeable
        return part

    def clear(self) -> None:
        _call("cuMemsetD8Async", _address(self.ctypes.data), ctypes.c_ubyte(0),
              ctypes.c_size_t(self.nbytes), ctypes.c_void_p(self.queue))  # fmt: skip


class _Allocation:
    """Device memory that is freed, in the order of the stream, when no buffer refers to it any
    more.
    """

    def __init__(self, size: int, stream: int):
        found = ctypes.c_uint64()
        _call("cuMemAllocAsync", ctypes.byref(found), ctypes.c_size_t(size),
              ctypes.c_void_p(stream))  # fmt: skip
        self.address, self._stream = found.value, stream

    def __del__(self) -> None:
        if hasattr(self, "address"):
            _driver().cuMemFreeAsync(_address(self.address), ctypes.c_void_p(self._stream))


def zeros_like(type_: Any, near: Any) -> Any:
    """Returns zeros of a shape and type, in the memory (host or GPU) where `near` is."""
    if isinstance(near, np.ndarray):
        return np.zeros(type_.shape, type_.dtype)
    size = int(np.prod(type_.shape, dtype=np.int64)) * np.dtype(type_.dtype).itemsize
    memory = _Allocation(max(size, 1), near.queue)
    made = DeviceBuffer(memory.address, type_.shape, type_.dtype, near.queue, memory)
    made.clear()
    return made


def copy_of(buffer: Any) -> Any:
    """Returns a copy of a buffer, in the memory (host or GPU) where it is."""
    made = zeros_like(buffer, buffer)
    if isinstance(buffer, np.ndarray):
        made[...] = buffer
    else:
        _call("cuMemcpyDtoDAsync_v2", _address(made.ctypes.data), _address(buffer.ctypes.data),
              ctypes.c_size_t(buffer.nbytes), ctypes.c_void_p(buffer.queue))  # fmt: skip
    made.flags.writeable = buffer.flags.writeable
    return made


def number_of(buffer: Any) -> Any:
    """The number in a buffer without dimensions; on a GPU this waits for the stream."""
    if isinstance(buffer, np.ndarray):
        return buffer.item()
    host = np.empty((), buffer.dtype)
    stream = ctypes.c_void_p(buffer.queue)
    _call("cuMemcpyDtoHAsync_v2", ctypes.c_void_p(host.ctypes.data),
          _address(buffer.ctypes.data), ctypes.c_size_t(host.nbytes), stream)  # fmt: skip
    _call("cuStreamSynchronize", stream)
    return host.item()


def store_number(buffer: Any, value: float) -> None:
    """Stores a number to a buffer without dimensions."""
    if isinstance(buffer, np.ndarray):
        buffer[...] = value
        return
    host = np.array(value, buffer.dtype)
    stream = ctypes.c_void_p(buffer.queue)
    _call("cuMemcpyHtoDAsync_v2", _address(buffer.ctypes.data),
          ctypes.c_void_p(host.ctypes.data), ctypes.c_size_t(host.nbytes), stream)  # fmt: skip
    _call("cuStreamSynchronize", stream)
