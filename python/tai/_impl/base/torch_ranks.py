"""Communication between the ranks of a mesh by torch.distributed."""

from __future__ import annotations

import datetime
from collections.abc import Sequence

import numpy as np
import torch
import torch.distributed as dist

# The seconds after which a rank that does not answer ends the others.
TIMEOUT = 30

_OPS = {"sum": dist.ReduceOp.SUM, "min": dist.ReduceOp.MIN, "max": dist.ReduceOp.MAX}


class TorchRanks:
    """The default process group; gloo, started from the variables that torchrun sets."""

    def __init__(self) -> None:
        if not dist.is_initialized():
            timeout = datetime.timedelta(seconds=TIMEOUT)
            dist.init_process_group("gloo", timeout=timeout)
        self.rank, self.size = dist.get_rank(), dist.get_world_size()

    def swap(
        self, sends: Sequence[tuple[int, np.ndarray]], receives: Sequence[tuple[int, np.ndarray]]
    ) -> None:
        """Sends arrays to ranks and fills arrays with those of ranks."""
        operations = [dist.P2POp(dist.isend, _bytes(array), peer) for peer, array in sends]
        operations += [dist.P2POp(dist.irecv, _bytes(array), peer) for peer, array in receives]
        if operations:
            for work in dist.batch_isend_irecv(operations):
                work.wait()

    def all_reduce(self, array: np.ndarray, kind: str) -> None:
        """Replaces the numbers by their sum, minimum or maximum over all ranks."""
        wide = array if array.dtype.itemsize >= 4 else array.astype(np.int64)
        dist.all_reduce(torch.from_numpy(wide.reshape(-1)), _OPS[kind])
        if wide is not array:
            array[...] = wide.astype(array.dtype)

    def all_gather(self, array: np.ndarray) -> list[np.ndarray]:
        """The arrays of all ranks, which have one shape."""
        found = [np.empty(array.shape, array.dtype) for _ in range(self.size)]
        dist.all_gather([_bytes(each) for each in found], _bytes(np.ascontiguousarray(array)))
        return found


def _bytes(array: np.ndarray) -> torch.Tensor:
    """The memory of a contiguous array as bytes."""
    return torch.from_numpy(array.reshape(-1).view(np.uint8))
