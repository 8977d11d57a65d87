"""The memory of exchanges on a GPU: torch packs rows there, and NCCL carries them.

A process group without NCCL, or a transport that is not torch's, carries them through the host.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

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


class DeviceMemory:
    """Arrays of the GPU of this process, as tensors; the methods are those of `HostMemory`."""

    def __init__(self, types: dict[int, str]):
        self._types = types

    def view(self, address: int, element: int, extents: tuple, strides: tuple) -> torch.Tensor:
        memory = _Memory(address, self._types[element], extents, strides)
        return torch.as_tensor(memory, device="cuda")

    def rows_first(self, view: torch.Tensor, dimension: int) -> torch.Tensor:
        return view.movedim(dimension, 0)

    def message(self, head: int, rows: torch.Tensor) -> torch.Tensor:
        made = self.room(rows)
        made[:8].view(torch.int64).fill_(head)
        self._rows(made, rows).copy_(rows)
        return made

    def room(self, rows: torch.Tensor) -> torch.Tensor:
        size = HEAD + rows.numel() * rows.element_size()
        return torch.empty(size, dtype=torch.uint8, device="cuda")

    def _rows(self, message: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
        return message[HEAD:].view(rows.dtype).view(rows.shape)

    def read(self, message: torch.Tensor, rows: torch.Tensor) -> tuple[int, torch.Tensor]:
        return int(message[:8].view(torch.int64).item()), self._rows(message, rows)

    def swap(self, transport: Any, sends: Sequence, receives: Sequence) -> None:
        if not _has_nccl(transport):
            host = [(peer, np.empty(each.numel(), np.uint8)) for peer, each in receives]
            transport.swap([(peer, each.cpu().numpy()) for peer, each in sends], host)
            for (_, room), (_, got) in zip(receives, host, strict=True):
                room.copy_(torch.from_numpy(got))
            return
        jobs = [dist.P2POp(dist.isend, each, peer) for peer, each in sends]
        jobs += [dist.P2POp(dist.irecv, each, peer) for peer, each in receives]
        if jobs:
            for work in dist.batch_isend_irecv(jobs):
                work.wait()
            _wait(transport)

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
