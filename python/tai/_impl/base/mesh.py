"""Meshes: processes that run one program, each on its rows of the sharded fields.

A kernel calls `Mesh._exchange` where ranks need rows of each other; the bytes travel by a
transport, by default torch.distributed. See docs/decisions/0075-shards.md.
"""

from __future__ import annotations

import importlib
import itertools
import os
import re
import sys
import zlib
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from . import native
from .device_watch import Watch
from .exchanged import is_emulated, memory_of

# The bytes of a text that ranks compare when they meet.
_TEXT = 256

# The most exchanges that a GPU keeps ready.
_MOST_READY = 4096


class Transport(Protocol):
    """Communication of a rank with the others, of contiguous NumPy arrays.

    A method that fails raises any exception. If this exception has an attribute `rank`, the message
    names that rank. A transport may also have `fail(text, ranks)`, which tells the other ranks that
    this one gives up, and returns the texts of those that have told so, by rank; it waits a moment
    for the texts of `ranks`. `take(name)`, which it may have as well, adds 1 to a number that all
    ranks share, initially 0, and returns the number before.
    """

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
        counts: the exchanges of kernels since `ti.init`, by kind; "left out" are those whose rows
            were there already.
    """

    def __init__(self, name: str, ranks: int, transport: Any = None, timeout: float = 30):
        if not isinstance(name, str) or not isinstance(ranks, int) or ranks < 1:
            raise TaiRuntimeTypeError(
                f"a mesh has a name and a number of processes, but got {name!r} and {ranks!r}",
                'write ti.mesh("x", 4)',
            )
        if not isinstance(timeout, (int, float)) or not timeout > 0:
            raise TaiRuntimeTypeError(f"timeout is a number of seconds, but got {timeout!r}")
        self.name, self.ranks, self.timeout = name, ranks, float(timeout)
        self._given = transport
        self._transport: Any = None
        self._known: set[tuple] = set()
        # Exchanges of GPUs that need only be queued again, and those that are not done.
        self._ready: dict[tuple, Callable[[], None]] = {}
        self._watch: Any = None
        # The exchanges so far, by kind.
        self._counts: dict[str, int] = {}
        self._left_out = 0
        # The number of counters that the ranks have made together.
        self._counters = 0
        # The first failure; the ranks cannot communicate after it.
        self._lost: str | None = None

    def connect(self, on_gpus: bool = False) -> None:
        """Meets the other processes.

        Args:
            on_gpus: whether kernels run on GPUs, one for each process.

        Raises:
            TaiRuntimeError: there are more or fewer of them, or they run other versions of tai.
        """
        if self._transport is None:
            self._transport = self._given or self._connect_default(on_gpus)
        size = self._transport.size
        if size != self.ranks:
            raise TaiRuntimeError(
                f"mesh '{self.name}' has {self.ranks} ranks, but {_processes(size)}",
                f"start the program by torchrun --nproc-per-node {self.ranks}",
            )
        self._known.clear()
        self._ready.clear()
        self._counts.clear()
        self._left_out = native.exchanges_left_out()
        own = f"mesh '{self.name[:64]}' of {self.ranks} ranks in tai {native.version()}"
        for rank, other in enumerate(self.texts("its start", own)):
            if own != other:
                self._give_up(f"rank {self.rank} has {own}, and rank {rank} has {other}")
        if on_gpus and getattr(self._transport, "has_nccl", False):
            self._check_gpus()

    def _check_gpus(self) -> None:
        names = self.texts("its start", self._ranks_of_torch().name_of_gpu())
        for rank, name in enumerate(names):
            if rank != self.rank and name == names[self.rank]:
                self._give_up(f"rank {self.rank} and rank {rank} have the same {name}")

    def choose_gpu(self) -> None:
        """Leaves this process its GPU, before anything opens CUDA."""
        if self._given is None and not is_emulated() and "LOCAL_RANK" in os.environ:
            self._ranks_of_torch().choose_gpu(self.ranks)

    def _connect_default(self, on_gpus: bool) -> Any:
        if self.ranks == 1 and "WORLD_SIZE" not in os.environ:
            return OneRank()
        on_gpus = on_gpus and not is_emulated()
        return self._ranks_of_torch().connect(self.name, self.ranks, self.timeout, on_gpus)

    def _ranks_of_torch(self) -> Any:
        try:
            return importlib.import_module("tai._impl.base.torch_ranks")
        except ImportError as error:
            raise TaiRuntimeError(
                f"the ranks of a mesh communicate by torch.distributed, which is not there: "
                f"{error}",
                "install torch, or pass a transport to ti.mesh",
            ) from error

    @property
    def rank(self) -> int:
        """The number of this process."""
        return int(self._transport.rank)

    @property
    def counts(self) -> dict[str, int]:
        """The exchanges of kernels since `ti.init`, by kind, and those that were left out."""
        return {**self._counts, "left out": native.exchanges_left_out() - self._left_out}

    # Failures

    def together(self, action: str, run: Callable[[], Any]) -> Any:
        """Communicates with the other ranks.

        Args:
            action: the subject of the communication, for messages.

        Raises:
            TaiRuntimeError: it failed, or an earlier communication did.
        """
        if self._lost is not None:
            raise TaiRuntimeError(f"the ranks no longer communicate, since {self._lost}")
        try:
            return run()
        except TaiRuntimeError:
            raise
        except Exception as error:
            peer = getattr(error, "rank", None)
            name = "other ranks" if peer is None else f"rank {peer}"
            reason = " ".join(str(error).split()) or type(error).__name__
            text = f"rank {self.rank} of {self.ranks} lost {name} in {action}: {reason}"
            raise TaiRuntimeError(self._note(text, peer)) from error

    def _give_up(self, text: str) -> None:
        """Ends the communication with the other ranks with an error that all of them find."""
        raise TaiRuntimeError(self._note(text, self.rank))

    def _note(self, text: str, peer: int | None) -> str:
        """Tells the others of a failure; returns the message with those of the others."""
        fail = getattr(self._transport, "fail", None)
        if fail is not None:
            others = [rank for rank in range(self.ranks) if rank != self.rank]
            told = fail(text, others if peer is None else [peer] if peer in others else [])
            silent = [str(rank) for rank in others if rank not in told]
            if peer is None and silent:
                text += f"; no word from rank{'s' if silent[1:] else ''} {', '.join(silent)}"
            cause = _first_cause(told, min(told, default=None) if peer is None else peer)
            text += f"; {cause}" if cause else ""
        self._lost = text
        return text

    # Exchanges of kernels

    def exchange(
        self, kind: str, field: str, kernel: str, where: str, element: int, digest: int,
        block: int, before: int, after: int, address: int, rows: int, extents: tuple,
        strides: tuple, on_device: bool = False,
    ) -> None:  # fmt: skip
        """Carries out an exchange of a kernel; `TaiExchange` of tai-c/Mesh.h has the parameters."""
        if kind == "fail":
            if self._lost is None:
                work = f"the launch of kernel '{kernel}'" if kernel else "a launch"
                text = f"{work} failed on rank {self.rank}: {field}"
                self._note(text, self.rank)
            return
        plan = (kind, field, element, digest, block, before, after, rows, extents, strides)
        action = f"the exchange '{kind}' of field '{field}' in the launch of kernel '{kernel}'"
        self._counts[kind] = self._counts.get(kind, 0) + 1
        ready = self._ready.get((address, *plan)) if on_device else None
        if ready is not None:
            self.together(action, ready)
            return
        if plan not in self._known:
            self._compare(plan, action, where)
            self._known.add(plan)
        memory = memory_of(on_device)
        with memory.in_order():
            self._carry_out(memory, plan, address, action)

    def _carry_out(self, memory: Any, plan: tuple, address: int, action: str) -> None:
        kind, _, element, _, block, before, after, rows, extents, strides = plan
        view = memory.view(address, element, extents, strides)
        by_rows: Any = memory.rows_first(view, rows) if rows >= 0 else None
        low, high = self.rank * block, (self.rank + 1) * block
        if kind == "gather":
            found = self.together(
                action,
                lambda: memory.gather(self._transport, by_rows[low:high], self._watched(action)),
            )
            for rank, other in enumerate(found):
                by_rows[rank * block : (rank + 1) * block] = other
        elif kind == "open":
            if by_rows is not None:
                by_rows[:low] = 0
                by_rows[high:] = 0
            elif self.rank:
                view[...] = 0
        elif kind in ("sum", "min", "max"):
            self.together(
                action, lambda: memory.reduce(self._transport, view, kind, self._watched(action))
            )
        else:
            self.together(
                action, lambda: self._exchange_rows(memory, plan, by_rows, address, action)
            )

    def _compare(self, plan: tuple, action: str, where: str) -> None:
        """Before the first exchange of a plan: all ranks have the same one."""
        own = np.array([plan[3], _hash(plan)], np.int64)
        found = self.together(action, lambda: self._transport.all_gather(own))
        for rank, other in enumerate(found):
            if not np.array_equal(own, other):
                self._give_up(
                    f"rank {self.rank} and rank {rank} run different programs: they meet in "
                    f"different exchanges, here {action} at {where}"
                )

    def _exchange_rows(
        self, memory: Any, plan: tuple, view: Any, address: int, action: str
    ) -> None:
        """Fetches, clears or collects halos; the rows are the first dimension."""
        kind, (block, before, after) = plan[0], plan[4:7]
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
        # A message begins with a hash of its plan: the peer may be in another exchange.
        head, adds = _hash(plan), kind != "fetch"
        ready = memory.prepare(self._transport, head, out, into, adds, self._watched(action))
        if ready is not None:
            if len(self._ready) >= _MOST_READY:
                self._ready.clear()
            self._ready[(address, *plan)] = ready
            ready()
            return
        wrong = memory.carry(self._transport, head, out, into, adds)
        if wrong is not None:
            error = RuntimeError("it sends the rows of another exchange")
            error.rank = wrong  # type: ignore[attr-defined]
            raise error

    def _watched(self, action: str) -> tuple[Any, str]:
        """The exchanges of a GPU that are not done, and the subject of one."""
        if self._watch is None:
            self._watch = Watch(self.timeout, self._lose)
            on_failure = getattr(self._transport, "on_failure", None)
            if on_failure is not None:
                on_failure(self._watch.hurry)
        return self._watch, action

    def _lose(self, action: str, reason: str, peer: int | None) -> None:
        """Ends the process, whose GPU waits for another rank: no call of the host would return."""
        text = self._lost
        if text is None:
            name = "other ranks" if peer is None else f"rank {peer}"
            text = f"rank {self.rank} of {self.ranks} lost {name} in {action}: {reason}"
            text = self._note(text, peer)
        print(f"[tai] rank {self.rank} ends: {text}", file=sys.stderr, flush=True)
        os._exit(1)

    # Accesses of the host

    def gather_rows(self, array: np.ndarray, axis: int, field: str, action: str = "") -> None:
        """Fills the rows of other ranks in an array of the whole field."""
        rows = np.moveaxis(array, axis, 0)
        block = len(rows) // self.ranks
        own = np.ascontiguousarray(rows[self.rank * block : (self.rank + 1) * block])
        found = self.together(
            action or f"reading all of field '{field}'", lambda: self._transport.all_gather(own)
        )
        for rank, other in enumerate(found):
            rows[rank * block : (rank + 1) * block] = other

    def from_owner(self, row: int, extent: int, values: Any, field: str) -> Any:
        """The numbers that the owner of a row has."""
        array = np.array(values)
        owner = row // (extent // self.ranks)
        found = self.together(
            f"reading an element of field '{field}'", lambda: self._transport.all_gather(array)
        )
        return found[owner].tolist()

    def agree(self, action: str, problem: str = "") -> None:
        """Waits for all ranks.

        Args:
            action: for messages.
            problem: why this rank cannot go on.

        Raises:
            TaiRuntimeError: on all ranks, if one of them has a problem. They can go on.
        """
        for rank, text in enumerate(self.texts(action, problem)):
            if text:
                raise TaiRuntimeError(f"rank {rank} of {self.ranks}: {text}")

    def counter(self) -> Callable[[], int]:
        """A function that returns 0, 1, 2, … , each number on one of the ranks.

        All ranks make it together. With a transport that cannot count, the ranks take turns.
        """
        self._counters += 1
        name, take = f"counter{self._counters}", getattr(self._transport, "take", None)
        turns = itertools.count(self.rank, self.ranks)
        if take is None:
            return lambda: next(turns)
        return lambda: int(self.together("taking the next chunk", lambda: take(name)))

    def add_up(self, array: np.ndarray, action: str) -> None:
        """Replaces the numbers of an array by their sums over all ranks."""
        self.together(action, lambda: self._transport.all_reduce(array, "sum"))

    def texts(self, action: str, own: str) -> list[str]:
        """The texts of all ranks, each cut to 256 bytes."""
        line = np.frombuffer(own.encode()[:_TEXT].ljust(_TEXT, b"\0"), np.uint8)
        found = self.together(action, lambda: self._transport.all_gather(line))
        return [bytes(each).rstrip(b"\0").decode(errors="replace") for each in found]

    def __repr__(self) -> str:
        return f"ti.mesh({self.name!r}, {self.ranks})"


class OneRank:
    """The transport of a mesh of one process."""

    rank, size = 0, 1

    def swap(self, sends: Any, receives: Any) -> None:
        """There are no other ranks."""

    def all_reduce(self, array: np.ndarray, kind: str) -> None:
        """The numbers are those of all ranks."""

    def all_gather(self, array: np.ndarray) -> list[np.ndarray]:
        """The array of the only rank."""
        return [array]


def mesh(name: str, ranks: int, transport: Any = None, timeout: float = 30) -> Mesh:
    """A mesh of processes for `ti.init(mesh=…)`, along one axis.

    Each process runs the same program. Fields below `ti.root.shard(ti.i)` are divided among them;
    each has a copy of all other fields. docs/guides/many.md describes it.

    Args:
        name: a name for the axis of the mesh.
        ranks: the number of processes.
        transport: how they communicate; torch.distributed with gloo by default, as `torchrun`
            starts it.
        timeout: the seconds after which a rank gives up on one that does not answer, with
            torch.distributed.
    """
    return Mesh(name, ranks, transport, timeout)


def _processes(count: int) -> str:
    return "1 process runs" if count == 1 else f"{count} processes run"


def _first_cause(told: dict[int, str], rank: int | None) -> str:
    """From the text of a rank that has given up, the one that begins the chain of lost ranks."""
    cause, seen = "", set()
    while rank in told and rank not in seen:
        seen.add(rank)
        cause = told[rank]
        lost = re.search(r" lost rank (\d+) ", cause)
        rank = int(lost[1]) if lost else None
    return cause


def _hash(plan: tuple) -> int:
    return zlib.crc32(repr(plan).encode())
