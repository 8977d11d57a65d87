"""The memory of exchanges: arrays of the host by NumPy, and of a GPU by torch."""

from __future__ import annotations

import ctypes
import importlib
import os
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

# Types of numbers by the code of `tai-c/Mesh.h`. NumPy has no bf16, of which rows only travel.
_TYPES = {1: "u1", 8: "i1", 16: "i2", 32: "i4", 64: "i8"}
_TYPES |= {-16: "f2", -17: "i2", -32: "f4", -64: "f8"}

# The bytes in front of the rows of a message: its head, and padding.
HEAD = 16


class HostMemory:
    """Arrays of the host, which the transport of a mesh takes as they are."""

    def view(self, address: int, element: int, extents: tuple, strides: tuple) -> Any:
        """The memory at an address as an array."""
        dtype = np.dtype(_TYPES[element])
        size = dtype.itemsize + sum((n - 1) * s for n, s in zip(extents, strides, strict=True))
        memory = (ctypes.c_char * size).from_address(address)
        return np.ndarray(extents, dtype, memory, 0, strides)

    def rows_first(self, view: Any, dimension: int) -> Any:
        """The same array with the rows as its first dimension."""
        return np.moveaxis(view, dimension, 0)

    def carry(
        self, transport: Any, head: int, out: Sequence, into: Sequence, adds: bool
    ) -> int | None:
        """Sends rows to ranks, and stores or adds those of ranks.

        Args:
            head: the number in front of each message.
            out, into: pairs of a rank and rows.

        Returns:
            A rank whose message has another number, or None.
        """
        start = np.array([head, 0], np.int64).view(np.uint8)
        sends = [(peer, np.concatenate([start, _bytes(rows)])) for peer, rows in out]
        receives = [(peer, np.empty(HEAD + rows.nbytes, np.uint8)) for peer, rows in into]
        transport.swap(sends, receives)
        for (peer, rows), (_, got) in zip(into, receives, strict=True):
            if int(got[:8].view(np.int64)[0]) != head:
                return peer
            values = got[HEAD:].view(rows.dtype).reshape(rows.shape)
            if adds:
                rows += values
            else:
                rows[...] = values
        return None

    def prepare(
        self, transport: Any, head: int, out: Sequence, into: Sequence, adds: bool, watched: tuple
    ) -> None:
        """Memory of the host is not prepared."""

    def reduce(self, transport: Any, view: Any, kind: str, watched: tuple) -> None:
        """Replaces the numbers by those that all ranks combine."""
        total = np.array(view)
        transport.all_reduce(total, kind)
        view[...] = total

    def gather(self, transport: Any, rows: Any, watched: tuple) -> list[Any]:
        """The rows of all ranks."""
        return list(transport.all_gather(np.ascontiguousarray(rows)))

    def in_order(self) -> AbstractContextManager:
        """A context in which work on the memory is in order with that of tai."""
        return nullcontext()


def _bytes(rows: Any) -> Any:
    return np.ascontiguousarray(rows).reshape(-1).view(np.uint8)


def is_emulated() -> bool:
    """Whether the CPU runs the kernels for a GPU."""
    return bool(os.environ.get("TAI_CUDA_EMULATION"))


def memory_of(on_device: bool) -> Any:
    """The memory of an exchange. That of an emulated GPU is memory of the host."""
    if not on_device or is_emulated():
        return HostMemory()
    try:
        module = importlib.import_module("tai._impl.base.exchanged_cuda")
    except ImportError as error:
        raise RuntimeError(f"ranks on GPUs need torch: {error}") from error
    return module.DeviceMemory(_TYPES)
