"""The memory of exchanges on a GPU: torch packs rows there, and NCCL carries them.

A process group without NCCL, or a transport that is not torch's, carries them through the host.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
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
        self.got = torch.zeros(1, dtype=torch.int64, pin_memory=True)
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


class DeviceMemory:
    """Arrays of the GPU of this process, as tensors; the methods are those of `HostMemory`."""

    def __init__(self, types: dict[int, str]):
        self._types = types

    def view(self, address: int, element: int, extents: tuple, strides: tuple) -> torch.Tensor:
        return _view(address, self._types[element], extents, strides)

    def rows_first(self, view: torch.Tensor, dimension: int) -> torch.Tensor:
        return view.movedim(dimension, 0)

    def carry(
        self, transport: Any, head: int, out: Sequence, into: Sequence, adds: bool
    ) -> int | None:
        known = _messages.setdefault(transport, {})
        sends = [(peer, _message(known, transport, head, peer, True, rows), rows)
                 for peer, rows in out]  # fmt: skip
        receives = [(peer, _message(known, transport, head, peer, False, rows), rows)
                    for peer, rows in into]  # fmt: skip
        for _, message, rows in sends:
            message.rows.copy_(rows)
        self._swap(transport, sends, receives)
        for _, message, rows in receives:
            # The rows are lost if the head is wrong, but so is the program.
            message.got.copy_(message.head, non_blocking=True)
            rows.add_(message.rows) if adds else rows.copy_(message.rows)
        _wait(transport)
        return next((peer for peer, message, _ in receives if int(message.got) != head), None)

    def _swap(self, transport: Any, sends: Sequence, receives: Sequence) -> None:
        if not _has_nccl(transport):
            host = [(peer, np.empty(each.bytes.numel(), np.uint8)) for peer, each, _ in receives]
            transport.swap([(peer, each.bytes.cpu().numpy()) for peer, each, _ in sends], host)
            for (_, message, _), (_, got) in zip(receives, host, strict=True):
                message.bytes.copy_(torch.from_numpy(got))
            return
        jobs = [message.job for _, message, _ in (*sends, *receives)]
        for work in dist.batch_isend_irecv(jobs) if jobs else ():
            work.wait()

    def reduce(self, transport: Any, view: torch.Tensor, kind: str) -> None:
        total = view.contiguous()
        if total.dtype in (torch.int16, torch.int8, torch.uint8):
            total = total.to(torch.int64)
        if total is view or total.data_ptr() == view.data_ptr():
            total = total.clone()
        if _has_nccl(transport):
            dist.all_reduce(total, _OPS[kind])
            _wait(transport)
        else:
            host = total.cpu().numpy()
            transport.all_reduce(host, kind)
            total = torch.from_numpy(host).cuda()
        view.copy_(total)

    def gather(self, transport: Any, rows: torch.Tensor) -> list[torch.Tensor]:
        own = rows.contiguous()
        if not _has_nccl(transport):
            return [torch.from_numpy(np.ascontiguousarray(each)).cuda()
                    for each in transport.all_gather(own.cpu().numpy())]  # fmt: skip
        found = [torch.empty_like(own) for _ in range(transport.size)]
        # NCCL has no integers of 16 bits; bytes travel alike.
        dist.all_gather([_bytes(each) for each in found], _bytes(own))
        _wait(transport)
        return found

    def finish(self) -> None:
        torch.cuda.current_stream().synchronize()


def _bytes(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.view(-1).view(torch.uint8)


def _has_nccl(transport: Any) -> bool:
    return bool(getattr(transport, "has_nccl", False))


def _wait(transport: Any) -> None:
    """Waits for NCCL, which does not notice itself that a rank is gone."""
    event = torch.cuda.Event()
    event.record()
    end = time.monotonic() + transport.timeout
    while not event.query():
        if time.monotonic() > end:
            raise RuntimeError(f"no answer in {transport.timeout:g} s")
