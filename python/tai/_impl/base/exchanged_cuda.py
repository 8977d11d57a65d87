"""The memory of exchanges on a GPU: torch packs rows there, and NCCL carries them.

With NCCL, the host waits for nothing. tai's stream and the default stream of torch, on which all
of this runs, are in order; `device_watch` looks later whether the messages have come. A process
group without NCCL, or a transport that is not torch's, carries rows through the host.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
import torch.distributed as dist

from .exchanged import HEAD

_OPS = {"sum": dist.ReduceOp.SUM, "min": dist.ReduceOp.MIN, "max": dist.ReduceOp.MAX}


class _Memory:
    """An array of a GPU, for `torch.as_tensor`."""

    def __init__(self, address: int, code: str, extents: tuple, strides: tuple):
        self.__cuda_array_interface__ = {
            "data": (address, False), "shape": extents, "strides": strides, "typestr": f"<{code}",
            "version": 2,
        }  # fmt: skip


@lru_cache(maxsize=1024)
def _view(address: int, code: str, extents: tuple, strides: tuple) -> torch.Tensor:
    return torch.as_tensor(_Memory(address, code, extents, strides), device="cuda")


class _Message:
    """Memory of messages of one exchange with a rank, which are alike.

    Attributes:
        bytes: all of a message.
        rows: of the message.
        head: of the message, one number.
        got: memory of the host for the head of a message that has come.
        job: sends or receives the message by NCCL.
    """

    def __init__(self, head: int, peer: int, is_sent: bool, rows: torch.Tensor, has_nccl: bool):
        size = HEAD + rows.numel() * rows.element_size()
        self.bytes = torch.zeros(size, dtype=torch.uint8, device="cuda")
        self.rows = self.bytes[HEAD:].view(rows.dtype).view(rows.shape)
        self.head = self.bytes[:8].view(torch.int64)
        self.head.fill_(head)
        self.got = torch.full((1,), head, dtype=torch.int64, pin_memory=True)
        begin = dist.isend if is_sent else dist.irecv
        self.job = dist.P2POp(begin, self.bytes, peer) if has_nccl else None


# The messages of each transport, by their exchange.
_messages: WeakKeyDictionary[Any, dict[tuple, _Message]] = WeakKeyDictionary()


def _message(
    known: dict[tuple, _Message], transport: Any, head: int, peer: int, is_sent: bool,
    rows: torch.Tensor,
) -> _Message:  # fmt: skip
    key = (head, peer, is_sent, rows.dtype, rows.shape)
    found = known.get(key)
    if found is None:
        found = known[key] = _Message(head, peer, is_sent, rows, _has_nccl(transport))
    return found


class _Carried:
    """An exchange of certain rows by NCCL, which may be queued many times."""

    def __init__(self, head: int, sends: Sequence, receives: Sequence, adds: bool, watched: tuple):
        self._packs = [(message.rows, rows) for _, message, rows in sends]
        self._takes = [(message.got, message.head, message.rows, rows)
                       for _, message, rows in receives]  # fmt: skip
        self._jobs = [message.job for _, message, _ in (*sends, *receives)]
        self._heads = [(peer, message.got) for peer, message, _ in receives]
        self._head, self._adds, self._watched = head, adds, watched

    def __call__(self) -> None:
        if torch.cuda.current_stream().cuda_stream == 0:
            self._queue()
        else:
            with torch.cuda.stream(torch.cuda.default_stream()):
                self._queue()

    def _queue(self) -> None:
        for packed, rows in self._packs:
            packed.copy_(rows)
        begin = _mark()
        for work in dist.batch_isend_irecv(self._jobs) if self._jobs else ():
            work.wait()  # The stream waits, not the host.
        for got, head, packed, rows in self._takes:
            got.copy_(head, non_blocking=True)
            rows.add_(packed) if self._adds else rows.copy_(packed)
        watch, action = self._watched
        watch.add(begin, _mark(), self._heads, self._head, action)


class DeviceMemory:
    """Arrays of the GPU of this process, as tensors; the methods are those of `HostMemory`."""

    def __init__(self, types: dict[int, str]):
        self._types = types

    def view(self, address: int, element: int, extents: tuple, strides: tuple) -> torch.Tensor:
        return _view(address, self._types[element], extents, strides)

    def rows_first(self, view: torch.Tensor, dimension: int) -> torch.Tensor:
        return view.movedim(dimension, 0)

    def prepare(
        self, transport: Any, head: int, out: Sequence, into: Sequence, adds: bool, watched: tuple
    ) -> Callable[[], None] | None:
        """A function that queues an exchange of rows on the GPU; None without NCCL.

        Args:
            head: the number in front of each message.
            out, into: pairs of a rank and rows.
            adds: whether rows that come are added.
            watched: notes the exchanges that are not done, and the subject of this one.
        """
        if not _has_nccl(transport):
            return None
        sends, receives = self._find_messages(transport, head, out, into)
        return _Carried(head, sends, receives, adds, watched)

    def carry(
        self, transport: Any, head: int, out: Sequence, into: Sequence, adds: bool
    ) -> int | None:
        sends, receives = self._find_messages(transport, head, out, into)
        for _, message, rows in sends:
            message.rows.copy_(rows)
        host = [(peer, np.empty(each.bytes.numel(), np.uint8)) for peer, each, _ in receives]
        transport.swap([(peer, each.bytes.cpu().numpy()) for peer, each, _ in sends], host)
        for (peer, message, rows), (_, got) in zip(receives, host, strict=True):
            if int(got[:8].view(np.int64)[0]) != head:
                return peer
            message.bytes.copy_(torch.from_numpy(got))
            rows.add_(message.rows) if adds else rows.copy_(message.rows)
        return None

    def _find_messages(self, transport: Any, head: int, out: Sequence, into: Sequence) -> tuple:
        known = _messages.setdefault(transport, {})
        sends = [(peer, _message(known, transport, head, peer, True, rows), rows)
                 for peer, rows in out]  # fmt: skip
        receives = [(peer, _message(known, transport, head, peer, False, rows), rows)
                    for peer, rows in into]  # fmt: skip
        return sends, receives

    def reduce(self, transport: Any, view: torch.Tensor, kind: str, watched: tuple) -> None:
        total = view.contiguous()
        if total.dtype in (torch.int16, torch.int8, torch.uint8):
            total = total.to(torch.int64)
        if total is view or total.data_ptr() == view.data_ptr():
            total = total.clone()
        if _has_nccl(transport):
            begin = _mark()
            dist.all_reduce(total, _OPS[kind])
            watched[0].add(begin, _mark(), (), 0, watched[1])
        else:
            host = total.cpu().numpy()
            transport.all_reduce(host, kind)
            total = torch.from_numpy(host).cuda()
        view.copy_(total)

    def gather(self, transport: Any, rows: torch.Tensor, watched: tuple) -> list[torch.Tensor]:
        own = rows.contiguous()
        if not _has_nccl(transport):
            return [torch.from_numpy(np.ascontiguousarray(each)).cuda()
                    for each in transport.all_gather(own.cpu().numpy())]  # fmt: skip
        found = [torch.empty_like(own) for _ in range(transport.size)]
        # NCCL has no integers of 16 bits; bytes travel alike.
        begin = _mark()
        dist.all_gather([_bytes(each) for each in found], _bytes(own))
        watched[0].add(begin, _mark(), (), 0, watched[1])
        return found

    def in_order(self) -> AbstractContextManager:
        return torch.cuda.stream(torch.cuda.default_stream())


def _mark() -> torch.cuda.Event:
    """An event behind all work so far."""
    event = torch.cuda.Event()
    event.record()
    return event


def _bytes(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.view(-1).view(torch.uint8)


def _has_nccl(transport: Any) -> bool:
    return bool(getattr(transport, "has_nccl", False))
