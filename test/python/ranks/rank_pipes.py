"""Ranks of a mesh as processes of one test, which communicate through pipes."""

from __future__ import annotations

import multiprocessing
import pickle
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

# The seconds after which a rank gives up on another one.
PATIENCE = 60


class Pipes:
    """A transport of `ti.mesh` over pipes between all pairs of ranks."""

    def __init__(self, rank: int, ends: dict[int, Any]):
        self.rank, self.size, self.ends = rank, len(ends) + 1, ends

    def _send(self, peer: int, array: np.ndarray) -> None:
        self.ends[peer].send_bytes(np.ascontiguousarray(array).tobytes())

    def _receive(self, peer: int, array: np.ndarray) -> None:
        if not self.ends[peer].poll(PATIENCE):
            raise TimeoutError(f"rank {peer} does not answer")
        data = self.ends[peer].recv_bytes()
        if len(data) != array.nbytes:
            raise ValueError(f"rank {peer} sends {len(data)} bytes instead of {array.nbytes}")
        array[...] = np.frombuffer(data, array.dtype).reshape(array.shape)

    def swap(self, sends: Any, receives: Any) -> None:
        for peer, array in sends:
            self._send(peer, array)
        for peer, array in receives:
            self._receive(peer, array)

    def all_gather(self, array: np.ndarray) -> list[np.ndarray]:
        found = []
        for peer in self.ends:
            self._send(peer, array)
        for rank in range(self.size):
            found.append(np.array(array))
            if rank != self.rank:
                self._receive(rank, found[rank])
        return found

    def all_reduce(self, array: np.ndarray, kind: str) -> None:
        combine = {"sum": np.add, "min": np.minimum, "max": np.maximum}[kind]
        array[...] = combine.reduce(np.stack(self.all_gather(array)))


def _run(run: Callable, rank: int, ends: dict[int, Any], report: Any, given: tuple) -> None:
    try:
        result = run(Pipes(rank, ends), *given)
        report.send_bytes(pickle.dumps((True, result)))
    except BaseException:
        report.send_bytes(pickle.dumps((False, traceback.format_exc())))


def run_ranks(run: Callable, ranks: int, *given: Any) -> list[Any]:
    """The results of `run(transport, *given)` on each rank; a failure is a string.

    `run` is a function of a module, which each process imports.
    """
    context = multiprocessing.get_context("spawn")
    ends: list[dict[int, Any]] = [{} for _ in range(ranks)]
    for first in range(ranks):
        for second in range(first + 1, ranks):
            ends[first][second], ends[second][first] = context.Pipe()
    reports, processes = [], []
    for rank in range(ranks):
        own, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_run, args=(run, rank, ends[rank], theirs, given))
        process.start()
        theirs.close()
        reports.append(own)
        processes.append(process)
    # The ranks alone hold the pipes: one that ends closes its pipes for the others.
    for of_rank in ends:
        for end in of_rank.values():
            end.close()
    results = []
    for own, process in zip(reports, processes, strict=True):
        try:
            good, result = pickle.loads(own.recv_bytes())
            results.append(result if good else f"failed: {result}")
        except EOFError:
            process.join()  # Its pipe closes before it has ended.
            results.append(f"ended with {process.exitcode}")
    for process in processes:
        process.join()
    return results
