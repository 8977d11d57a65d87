"""Kernels of which the compile cache keeps the code, and processes that run them.

A process is forked from one that has imported all modules that a kernel makes Python import, but
has no program and no thread of its own: its time is compiling and loading. Its standard error is
kept, with a line for each function that says whether the cache had it.
"""

from __future__ import annotations

import functools
import importlib
import json
import os
import re
import select
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import tai as ti
from bars import is_idle

N = 64
ENTRIES = 2  # of the cache, for each kernel: it and its gradient
PROFILE = re.compile(r"^(\S+)\s+(primal|adjoint|taking)\s+(hit|miss)\b.*$", re.MULTILINE)


def make(number: int, x: ti.Field, y: ti.Field):
    """A kernel whose code and name are not those of another number."""

    def kernel():
        for i in x:
            y[None] += (number + 0.5) * x[i] * x[i]

    kernel.__name__ = kernel.__qualname__ = f"kernel_{number}"
    return ti.kernel(kernel)


def run_kernels(first: int, count: int) -> list[list[float]]:
    """A sum and one of its derivatives, for each kernel."""
    ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=ti.f64)
    x = ti.field(ti.f64, shape=N, needs_grad=True)
    y = ti.field(ti.f64, shape=(), needs_grad=True)
    for i in range(N):
        x[i] = i / N
    answer = []
    for number in range(first, first + count):
        kernel = make(number, x, y)
        with ti.ad.Tape(y):
            kernel()
        answer.append([y[None], x.grad[3]])
    return answer


def expected(first: int, count: int) -> list[list[float]]:
    """The expected results: all numbers have few bits, so that no sum is rounded."""
    squares = sum((i / N) ** 2 for i in range(N))
    return [[(k + 0.5) * squares, 2 * (k + 0.5) * 3 / N] for k in range(first, first + count)]


@functools.cache
def import_all() -> None:
    """Imports what running a kernel imports, as a process has found out that did.

    That takes as long as to compile ten kernels, and each process would do it anew.
    """
    pipe, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            run_kernels(0, 1)
            with os.fdopen(write, "w") as out:
                out.write("\n".join(sys.modules))
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(pipe) as names:
        wanted = [name for name in names.read().split("\n") if name.startswith("tai.")]
    os.waitpid(child, 0)
    assert wanted, "no kernel ran"
    for name in wanted:
        importlib.import_module(name)


@dataclass
class Ended:
    """How a process ended.

    Attributes:
        problem: the fault, or nothing. A process that was killed has none.
        warnings: the lines of its standard error.
        compiled: how often each function was compiled, by its name.
        hits: how many functions came from the cache.
    """

    problem: str = ""
    warnings: list[str] = field(default_factory=list)
    compiled: Counter = field(default_factory=Counter)
    hits: int = 0


class Process:
    """A forked process that runs kernels on a cache."""

    def __init__(
        self, first: int, count: int, cache: Path | None, prepare: Callable[[], None] | None = None
    ):
        self.first, self.count = first, count
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115, read when the process has ended
        self.killed = False
        import_all()
        self.pipe, write = os.pipe()
        self.id = os.fork()
        if self.id == 0:
            self._work(write, cache, prepare)
        os.close(write)

    def _work(self, write: int, cache: Path | None, prepare: Callable[[], None] | None) -> None:
        status = 1
        try:
            os.dup2(self.errors.fileno(), 2)
            os.environ["TAI_COMPILE_PROFILE"] = "1"
            os.environ.pop("TAI_CACHE_DIR", None)
            if cache is not None:
                os.environ["TAI_CACHE_DIR"] = str(cache)
            if prepare:
                prepare()
            answer = run_kernels(self.first, self.count)
            ti.reset()  # writes the buffered output
            with os.fdopen(write, "wb") as pipe:
                pipe.write(json.dumps(answer).encode())
            status = 0
        except BaseException as error:  # noqa: BLE001
            os.write(2, f"{type(error).__name__}: {error}\n".encode())
        finally:
            os._exit(status)

    def seconds(self) -> float:
        """How long a processor has worked for it, until it has been waited for."""
        return time.clock_gettime(~self.id << 3 | 2)  # Linux's clock of a process

    def has_ended(self) -> bool:
        return bool(os.waitid(os.P_PID, self.id, os.WEXITED | os.WNOHANG | os.WNOWAIT))

    def kill(self) -> None:
        os.kill(self.id, signal.SIGKILL)
        self.killed = True

    def wait(self, seconds: float = 120) -> Ended:
        """Waits until the process ends; one that does not is killed, and that is a problem.

        On a busy machine one that computes may take many times as long.
        """
        text, late = b"", False
        begun = time.monotonic()
        end = begun + seconds
        while True:
            if not select.select([self.pipe], [], [], max(0.0, end - time.monotonic()))[0]:
                if end < begun + 20 * seconds and not is_idle(self.id):
                    end += seconds
                    continue
                os.kill(self.id, signal.SIGKILL)
                late = True
                break
            piece = os.read(self.pipe, 1 << 16)
            if not piece:
                break
            text += piece
        os.close(self.pipe)
        status = os.waitpid(self.id, 0)[1]
        self.errors.seek(0)
        said = self.errors.read().decode(errors="replace")
        self.errors.close()
        ended = Ended(warnings=PROFILE.sub("", said).split("\n"))
        ended.warnings = [line for line in ended.warnings if line]
        for name, goal, what in PROFILE.findall(said):
            if what == "hit":
                ended.hits += 1
            else:
                ended.compiled[f"{name} {goal}"] += 1
        if self.killed:
            return ended
        if late:
            ended.problem = f"hangs for {seconds:.0f} s"
        elif status != 0:
            ended.problem = f"ended with {status}: {said[-300:]}"
        elif json.loads(text) != expected(self.first, self.count):
            ended.problem = "gave wrong numbers"
        return ended


def run(first: int, count: int, cache: Path | None, prepare=None) -> Ended:
    return Process(first, count, cache, prepare).wait()


def entries(cache: Path) -> list[Path]:
    return sorted(cache.glob("*.tai"))


if __name__ == "__main__":
    print(run(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])))
