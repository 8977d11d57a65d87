"""Communication between the ranks of a mesh by torch.distributed."""

from __future__ import annotations

import atexit
import contextlib
import datetime
import itertools
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
import torch.distributed as dist

from ...errors import TaiRuntimeError

# The seconds in which other ranks may tell that they give up, too.
GRACE = 2.0

_numbers = itertools.count()

_OPS = {"sum": dist.ReduceOp.SUM, "min": dist.ReduceOp.MIN, "max": dist.ReduceOp.MAX}


class LostRank(Exception):
    """A rank that does not answer."""

    def __init__(self, rank: int, reason: str):
        super().__init__(reason)
        self.rank = rank


class TorchRanks:
    """The default process group, with the store of its start."""

    def __init__(self, store: Any, timeout: float) -> None:
        self._store, self._grace, self.timeout = store, min(GRACE, timeout / 4), timeout
        # Whether the group can carry memory of GPUs.
        self.has_nccl = "nccl" in str(getattr(dist, "get_backend_config", lambda: "")())
        self.rank, self.size = dist.get_rank(), dist.get_world_size()
        self._has_failed = False
        self._on_failure: list[Callable[[], None]] = []
        # Other meshes of the process have the same store.
        self._number = next(_numbers)
        self._has_ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="tai-ranks", daemon=True)
        self._thread.start()
        # Python stops threads in the middle of calls of torch, which abort the process.
        atexit.register(self._stop)

    def swap(
        self, sends: Sequence[tuple[int, np.ndarray]], receives: Sequence[tuple[int, np.ndarray]]
    ) -> None:
        """Sends arrays to ranks and fills arrays with those of ranks."""
        jobs = [(peer, dist.isend, array) for peer, array in sends]
        jobs += [(peer, dist.irecv, array) for peer, array in receives]
        begun = []
        for peer, begin, array in jobs:
            try:
                begun.append((peer, begin(_bytes(array), peer)))
            except RuntimeError as error:
                raise LostRank(peer, str(error)) from error
        for peer, work in begun:
            try:
                work.wait()
            except RuntimeError as error:
                raise LostRank(peer, str(error)) from error

    def all_reduce(self, array: np.ndarray, kind: str) -> None:
        """Replaces the numbers by their sum, minimum or maximum over all ranks."""
        wide = array if array.dtype.itemsize >= 4 else array.astype(np.int64)
        dist.all_reduce(torch.from_numpy(wide.reshape(-1)), _OPS[kind])
        if wide is not array:
            array[...] = wide.astype(array.dtype)

    def all_gather(self, array: np.ndarray) -> list[np.ndarray]:
        """The arrays of all ranks, which have one shape."""
        found = [np.empty(array.shape, array.dtype) for _ in range(self.size)]
        dist.all_gather([_bytes(each) for each in found], _bytes(np.array(array, order="C")))
        return found

    def take(self, name: str) -> int:
        """Adds 1 to a number in the store, and returns the number before."""
        return int(self._store.add(f"tai/{self._number}/{name}", 1)) - 1

    def fail(self, text: str, ranks: Sequence[int]) -> dict[int, str]:
        """Tells the other ranks that this one gives up; returns the texts of those that do."""
        told: dict[int, str] = {}
        self._has_failed = True
        end = time.monotonic() + self._grace
        try:
            self._store.set(f"tai/failed/{self.rank}", text)
            self._store.set("tai/failed", text)
            while True:
                for rank in range(self.size):
                    key = f"tai/failed/{rank}"
                    if rank != self.rank and rank not in told and self._store.check([key]):
                        told[rank] = self._store.get(key).decode()
                if all(rank in told for rank in ranks) or time.monotonic() > end:
                    return told
                time.sleep(0.05)
        except (RuntimeError, AttributeError):
            return told  # The process that serves the store has ended.

    def on_failure(self, call: Callable[[], None]) -> None:
        """Calls a function, on another thread, when a rank has given up."""
        self._on_failure.append(call)

    def _stop(self) -> None:
        self._has_ended.set()
        self._thread.join(1.0)

    def _watch(self) -> None:
        """Ends a process that hangs, after another rank has given up.

        The starter of another host does not know of the failure.
        """
        try:
            while not self._store.check(["tai/failed"]):
                if self._has_ended.wait(self._grace / 4):
                    return
            text = self._store.get("tai/failed").decode()
        except (RuntimeError, AttributeError):
            return  # The process that serves the store has ended.
        for call in self._on_failure:
            call()
        if self._has_ended.wait(self.timeout):
            return
        if not self._has_failed:
            print(f"[tai] rank {self.rank} ends: {text}", file=sys.stderr, flush=True)
            os._exit(1)


def connect(name: str, ranks: int, timeout: float, on_gpus: bool) -> TorchRanks:
    """Joins the process group, or that of the program; gloo, with the variables of torchrun.

    Args:
        on_gpus: whether memory of GPUs will travel, by NCCL.

    Raises:
        TaiRuntimeError: the variables are not set, or other ranks do not arrive in time.
    """
    wait = datetime.timedelta(seconds=timeout)
    if dist.is_initialized():
        return TorchRanks(_store_of_group(), timeout)
    start = f"start the program by torchrun --nproc-per-node {ranks}"
    try:
        own, size = int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])
        host = f"{os.environ['MASTER_ADDR']}:{os.environ['MASTER_PORT']}"
    except (KeyError, ValueError) as error:
        raise TaiRuntimeError(
            f"mesh '{name}' has {ranks} ranks, but this process runs alone: there is no {error} in "
            "its environment",
            start,
        ) from None
    if size != ranks:
        processes = "1 process runs" if size == 1 else f"{size} processes run"
        raise TaiRuntimeError(f"mesh '{name}' has {ranks} ranks, but {processes}", start)
    store = None
    try:
        store = next(iter(dist.rendezvous("env://", timeout=wait)))[0]
        # The store of torchrun outlives a restart, with the addresses of the former processes.
        attempt = os.environ.get("TORCHELASTIC_RESTART_COUNT", "0")
        store = dist.PrefixStore(f"attempt{attempt}", store)
        store.set(f"tai/here/{own}", "1")
        backend = "cpu:gloo,cuda:nccl" if on_gpus and dist.is_nccl_available() else "gloo"
        dist.init_process_group(backend, store=store, rank=own, world_size=size, timeout=wait)
    except (RuntimeError, ValueError, OSError) as error:
        missing = _missing(store, size)
        problem = f"no {missing} arrived" if missing else f"{host} does not answer"
        raise TaiRuntimeError(
            f"rank {own} of {ranks} waited {timeout:g} s for the mesh '{name}', and {problem}",
            "do all processes run the program, with the same MASTER_ADDR and MASTER_PORT?",
        ) from error
    ranks_here = TorchRanks(store, timeout)
    if ranks_here.has_nccl:
        _keep_waiting(timeout)
    return ranks_here


def _keep_waiting(timeout: float) -> None:
    """Lets NCCL wait longer than the ranks do, which tell more than NCCL does.

    NCCL counts from when the host queues a message, and a rank from when its GPU reaches it.
    """
    with contextlib.suppress(AttributeError, RuntimeError, TypeError):
        backend = dist.distributed_c10d._get_default_group()._get_backend(torch.device("cuda"))
        backend._set_default_timeout(datetime.timedelta(seconds=20 * timeout))


def choose_gpu(ranks: int) -> None:
    """Leaves this process the GPU of its number on the host, unless the program has chosen one.

    Raises:
        TaiRuntimeError: the host has fewer GPUs than ranks.
    """
    listed = os.environ.get("CUDA_VISIBLE_DEVICES")
    own, here = (int(os.environ.get(name, "0")) for name in ("LOCAL_RANK", "LOCAL_WORLD_SIZE"))
    devices = listed.split(",") if listed else [str(n) for n in range(torch.cuda.device_count())]
    if here < 2 or torch.cuda.is_initialized() or (listed and len(devices) == 1):
        return
    if len(devices) < here:
        raise TaiRuntimeError(
            f"the mesh of {ranks} ranks has {here} ranks on this host, which has {len(devices)} "
            f"GPU{'' if len(devices) == 1 else 's'}",
            "start one process for each GPU",
        )
    os.environ["CUDA_VISIBLE_DEVICES"] = devices[own]


def name_of_gpu() -> str:
    """A text that no other GPU has."""
    where = getattr(torch.cuda.get_device_properties(0), "uuid", os.environ.get("LOCAL_RANK"))
    return f"GPU {where} of {os.uname().nodename}"


def _missing(store: Any, size: int) -> str:
    """The ranks that have not arrived at a store, or nothing if it cannot be asked."""
    if store is None:
        return ""
    try:
        absent = [n for n in range(size) if not store.check([f"tai/here/{n}"])]
    except RuntimeError:
        return ""
    return "rank " + " and no rank ".join(map(str, absent[:4])) if absent else ""


def _store_of_group() -> Any:
    """The store of the program's process group, if torch still calls it so."""
    return getattr(dist.distributed_c10d, "_get_default_store", lambda: None)()


def _bytes(array: np.ndarray) -> torch.Tensor:
    """The memory of a contiguous array as bytes."""
    return torch.from_numpy(array.reshape(-1).view(np.uint8))
