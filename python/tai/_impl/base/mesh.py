"""Meshes: processes that run one program, each on its rows of the sharded fields.

A kernel calls `Mesh._exchange` where ranks need rows of each other; the bytes travel by a
transport, by default torch.distributed. See docs/decisions/0075-shards.md.
"""

from __future__ import annotations

import ctypes
import importlib
import zlib
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError

# Types of numbers by the code of `tai-c/Mesh.h`. NumPy has no bf16, of which rows only travel.
_TYPES = {1: "u1", 8: "i1", 16: "i2", 32: "i4", 64: "i8"}
_TYPES |= {-16: "f2", -17: "u2", -32: "f4", -64: "f8"}


class Transport(Protocol):
    """Communication of a rank with the others, of contiguous NumPy arrays."""

    rank: int
    size: int

    def swap(
        self, sends: Sequence[tuple[int, np.ndarray]], receives: Sequence[tuple[int, np.ndarray]]
    ) -> None:
        """Sends arrays to ranks and fills arrays with those of ranks, all at the same time."""

    def all_reduce(self, array: np.ndarray, kind: str) -> None:
        """Replaces the numbers by their sum, minimum or maximum over all ranks."""

    def all_gather(self, array: np.ndarray) -> list[np.ndarray]:
        """The arrays of all ranks, which have one shape."""


class Mesh:
    """The processes that share fields; `ti.mesh` makes one.

    Attributes:
        name: the name of the mesh axis, for messages.
        ranks: the number of processes.
        rank: the number of this one.
    """

    def __init__(self, name: str, ranks: int, transport: Any = None):
        if not isinstance(name, str) or not isinstance(ranks, int) or ranks < 1:
            raise TaiRuntimeTypeError(
                f"a mesh has a name and a number of processes, but got {name!r} and {ranks!r}",
                'write ti.mesh("x", 4)',
            )
        self.name, self.ranks, self._given = name, ranks, transport
        self._transport: Any = None
        self._known: set[tuple] = set()

    def connect(self) -> None:
        """Meets the other processes.

        Raises:
            TaiRuntimeError: there are more or fewer of them.
        """
        if self._transport is None:
            self._transport = self._given or _torch_transport()
        size = self._transport.size
        if size != self.ranks:
            raise TaiRuntimeError(
                f"mesh '{self.name}' has {self.ranks} ranks, but {size} processes run",
                f"start the program by torchrun --nproc-per-node {self.ranks}",
            )
        self._known.clear()

    @property
    def rank(self) -> int:
        """The number of this process."""
        return int(self._transport.rank)

    # Exchanges of kernels

    def exchange(
        self, kind: str, field: str, where: str, element: int, digest: int, block: int,
        before: int, after: int, address: int, rows: int, extents: tuple, strides: tuple,
    ) -> None:  # fmt: skip
        """Carries out an exchange of a kernel; `TaiExchange` of tai-c/Mesh.h has the parameters."""
        plan = (kind, field, element, digest, block, before, after, rows, extents, strides)
        try:
            if plan not in self._known:
                self._compare(plan, where)
                self._known.add(plan)
            view = _view(address, np.dtype(_TYPES[element]), extents, strides)
            if rows >= 0:
                self._exchange_rows(kind, np.moveaxis(view, rows, 0), block, before, after)
            elif kind == "open":
                if self.rank:
                    view[...] = 0
            else:
                total = np.array(view)
                self._transport.all_reduce(total, kind)
                view[...] = total
        except TaiRuntimeError:
            raise
        except Exception as error:
            raise TaiRuntimeError(
                f"rank {self.rank} of {self.ranks} lost another rank in the exchange '{kind}' of "
                f"field '{field}': {error}"
            ) from error

    def _compare(self, plan: tuple, where: str) -> None:
        """Before the first exchange of a plan: all ranks have the same one."""
        own = np.array([plan[3], zlib.crc32(repr(plan).encode())], np.int64)
        for rank, other in enumerate(self._transport.all_gather(own)):
            if not np.array_equal(own, other):
                raise TaiRuntimeError(
                    f"rank {self.rank} and rank {rank} run different programs: they meet in "
                    f"different exchanges, here '{plan[0]}' of field '{plan[1]}' at {where}"
                )

    def _exchange_rows(
        self, kind: str, view: np.ndarray, block: int, before: int, after: int
    ) -> None:
        """Fetches, clears or collects halos; the rows are the first dimension."""
        rank, last = self.rank, self.ranks - 1
        low, high = rank * block, (rank + 1) * block
        # Halos of this rank, and its rows that are halos of others, with the other rank.
        halos, owned = [], []
        if before and rank > 0:
            halos.append((rank - 1, view[low - before : low]))
        if after and rank < last:
            halos.append((rank + 1, view[high : high + after]))
        if after and rank > 0:
            owned.append((rank - 1, view[low : low + after]))
        if before and rank < last:
            owned.append((rank + 1, view[high - before : high]))
        if kind == "clear":
            for _, rows in halos:
                rows[...] = 0
            return
        out, into = (owned, halos) if kind == "fetch" else (halos, owned)
        received = [(peer, np.empty(rows.shape, rows.dtype)) for peer, rows in into]
        self._transport.swap([(peer, np.ascontiguousarray(rows)) for peer, rows in out], received)
        for (_, rows), (_, got) in zip(into, received, strict=True):
            if kind == "fetch":
                rows[...] = got
            else:
                rows += got

    # Accesses of the host

    def gather_rows(self, array: np.ndarray, axis: int) -> None:
        """Fills the rows of other ranks in an array of the whole field."""
        rows = np.moveaxis(array, axis, 0)
        block = len(rows) // self.ranks
        own = np.ascontiguousarray(rows[self.rank * block : (self.rank + 1) * block])
        for rank, other in enumerate(self._transport.all_gather(own)):
            rows[rank * block : (rank + 1) * block] = other

    def from_owner(self, row: int, extent: int, values: Any) -> Any:
        """The numbers that the owner of a row has."""
        array = np.array(values)
        owner = row // (extent // self.ranks)
        got = self._transport.all_gather(array)[owner]
        return got.tolist()

    def __repr__(self) -> str:
        return f"ti.mesh({self.name!r}, {self.ranks})"


def mesh(name: str, ranks: int, transport: Any = None) -> Mesh:
    """A mesh of processes for `ti.init(mesh=…)`, along one axis.

    Each process runs the same program. Fields below `ti.root.shard(ti.i)` are divided among them;
    each has a copy of all other fields. docs/guides/many.md describes it.

    Args:
        name: a name for the axis of the mesh.
        ranks: the number of processes.
        transport: how they communicate; torch.distributed with gloo by default, as `torchrun`
            starts it.
    """
    return Mesh(name, ranks, transport)


def _torch_transport() -> Any:
    try:
        return importlib.import_module("tai._impl.base.torch_ranks").TorchRanks()
    except ImportError as error:
        raise TaiRuntimeError(
            f"the ranks of a mesh communicate by torch.distributed, which is not there: {error}",
            "install torch, or pass a transport to ti.mesh",
        ) from error


def _view(address: int, dtype: np.dtype, extents: tuple, strides: tuple) -> np.ndarray:
    """The memory at an address as an array."""
    size = dtype.itemsize + sum((n - 1) * s for n, s in zip(extents, strides, strict=True))
    memory = (ctypes.c_char * size).from_address(address)
    return np.ndarray(extents, dtype, memory, 0, strides)
