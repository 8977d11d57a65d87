"""Ranks of a mesh as processes of one test, which communicate through pipes."""

from __future__ import annotations

import contextlib
import fcntl
import multiprocessing
import pickle
import shutil
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

# The seconds after which a rank gives up on another one.
PATIENCE = 60


class LostRank(Exception):
    """A rank that does not answer, or has ended."""

    def __init__(self, rank: int, reason: str):
        super().__init__(reason)
        self.rank = rank


class Pipes:
    """A transport of `ti.mesh` over pipes between all pairs of ranks."""

    def __init__(self, rank: int, ends: dict[int, Any], folder: str):
        self.rank, self.size, self.ends = rank, len(ends) + 1, ends
        self.folder, self.patience = Path(folder), PATIENCE
        # The communications so far.
        self.swaps = self.gathers = 0

    def _send(self, peer: int, array: np.ndarray) -> None:
        try:
            self.ends[peer].send_bytes(np.ascontiguousarray(array).tobytes())
        except OSError as error:
            raise LostRank(peer, "its pipe is closed") from error

    def _receive(self, peer: int, array: np.ndarray) -> None:
        try:
            if not self.ends[peer].poll(self.patience):
                raise LostRank(peer, f"no answer in {self.patience:g} s")
            data = self.ends[peer].recv_bytes()
        except (EOFError, OSError) as error:
            raise LostRank(peer, "its pipe is closed") from error
        if len(data) != array.nbytes:
            raise LostRank(peer, f"it sends {len(data)} bytes instead of {array.nbytes}")
        array[...] = np.frombuffer(data, array.dtype).reshape(array.shape)

    def hang(self) -> None:
        """Answers no rank until all others have ended."""
        for end in self.ends.values():
            with contextlib.suppress(EOFError, OSError):
                while True:
                    end.recv_bytes()

    def fail(self, text: str, ranks: Any) -> dict[int, str]:
        """Tells the other ranks by a file that this one gives up, and reads theirs."""
        part = self.folder / f"part{self.rank}"
        part.write_text(text)
        part.rename(self.folder / str(self.rank))
        end = time.monotonic() + min(self.patience, 2)
        while not all((self.folder / str(rank)).exists() for rank in ranks):
            if time.monotonic() > end:
                break
            threading.Event().wait(0.02)
        return {int(path.name): path.read_text() for path in self.folder.glob("[0-9]*")
                if path.name != str(self.rank)}  # fmt: skip

    def take(self, name: str) -> int:
        """Adds 1 to a number in a file, and returns the number before."""
        with open(self.folder / f"take-{name}", "a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            number = len(file.read())
            file.write(b"x")
        return number

    def swap(self, sends: Any, receives: Any) -> None:
        self.swaps += 1
        for peer, array in sends:
            self._send(peer, array)
        for peer, array in receives:
            self._receive(peer, array)

    def all_gather(self, array: np.ndarray) -> list[np.ndarray]:
        self.gathers += 1
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


def _run(
    run: Callable, rank: int, ends: dict[int, Any], folder: str, report: Any, given: tuple
) -> None:
    try:
        result = run(Pipes(rank, ends, folder), *given)
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
    folder = tempfile.mkdtemp(prefix="tai-ranks-")
    for rank in range(ranks):
        own, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_run, args=(run, rank, ends[rank], folder, theirs, given))
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
    shutil.rmtree(folder)
    return results
