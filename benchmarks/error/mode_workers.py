"""Processes that each hold one scene in one mode, and answer requests in turns: see measure.py."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

HERE = Path(__file__).resolve().parent


def environment_of(tree: Path, arch: str = "cpu") -> dict[str, str]:
    """The environment in which the package of a checkout is imported, and no GPU seen in vain."""
    found = dict(os.environ, PYTHONPATH=str(tree / "python"))
    if arch == "cpu":
        found["CUDA_VISIBLE_DEVICES"] = ""
    # Other processes need memory of the GPU, too.
    found.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    return found


class Crowd:
    """The processes of a session. While a time is taken, all but one of them are stopped.

    An idle process may still have threads at work: it compiles for later runs, or tries sizes of
    blocks. They take cores from the process that is timed, and the card in slices of 2 ms.
    """

    def __init__(self):
        # Held while processes are stopped: none may start then.
        self._starts = threading.Lock()
        self._running: list[subprocess.Popen] = []

    def start(self, command: list[str], **options) -> subprocess.Popen:
        """As `subprocess.Popen`."""
        with self._starts:
            process = subprocess.Popen(command, **options)
            self._running = [other for other in self._running if other.poll() is None]
            self._running.append(process)
        return process

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """All processes are stopped, and go on afterwards."""
        with self._starts:
            try:
                for process in self._running:
                    stop(process)
                yield
            finally:
                for process in self._running:
                    process.send_signal(signal.SIGCONT)


def stop(process: subprocess.Popen) -> None:
    """Stops all threads of a process, and returns when they have stopped."""
    process.send_signal(signal.SIGSTOP)
    try:
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    except ChildProcessError:
        pass  # it has ended, and somebody has its status


class Worker:
    """A process of measure.py. The first answer comes when its program has run once.

    Attributes:
        failure: the row of a measurement that failed, with the reason.
    """

    def __init__(self, arguments: list[str], python: Path, tree: Path, log: IO[str], crowd: Crowd):
        """`tree` is the checkout whose package runs."""
        arch = arguments[arguments.index("--arch") + 1] if "--arch" in arguments else "cpu"
        self.failure: dict | None = None
        self._rest = b""
        command = [str(python), str(HERE / "measure.py"), *arguments]
        log.write(f"$ {' '.join(command)}\n")
        log.flush()
        try:
            self._process = crowd.start(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
                env=environment_of(tree, arch),
            )  # fmt: skip
        except OSError as error:
            self._process = None
            self.failure = {"status": "missing", "reason": f"no such Python: {error.strerror}"}

    def answer(self, seconds: float) -> dict | None:
        """The next answer; None where there is a failure."""
        if self.failure:
            return None
        line = self._line(time.monotonic() + seconds)
        if line is None:
            self._fail(f"longer than {seconds:.0f} s")
        elif not line:
            status = self._process.wait()
            if status == -signal.SIGINT:
                raise KeyboardInterrupt  # Ctrl-C reaches both: that is no failure of the scene
            self._fail(f"exit status {status}, see the log")
        else:
            said = json.loads(line)
            if said.get("status", "ok") == "ok":
                return said
            self.failure = said
        return None

    def ask(self, what: str, within: float, **more: object) -> dict | None:
        """The answer to a request; None where there is a failure."""
        if self.failure:
            return None
        try:
            self._process.stdin.write(json.dumps({"do": what, **more}).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            pass  # it has ended: the answer says how
        return self.answer(within)

    def ask_alone(self, what: str, within: float, **more: object) -> dict | None:
        """As `ask`, where the crowd is stopped: this process runs until it has answered."""
        if self.failure:
            return None
        self._process.send_signal(signal.SIGCONT)
        try:
            return self.ask(what, within, **more)
        finally:
            stop(self._process)

    def close(self) -> None:
        """Ends the process."""
        if self._process is None:
            return
        if self._process.poll() is None and not self.failure:
            self._process.stdin.close()
            try:
                self._process.wait(10)
            except subprocess.TimeoutExpired:
                pass
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._process.stdout.close()

    def _fail(self, reason: str) -> None:
        self.failure = {"status": "failed", "reason": reason}
        self._process.kill()

    def _line(self, deadline: float) -> bytes | None:
        """A line, b"" at the end of the output, None when the time is up."""
        stream = self._process.stdout.fileno()
        while b"\n" not in self._rest:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([stream], [], [], left)[0]:
                return None
            part = os.read(stream, 1 << 16)
            if not part:
                return b""
            self._rest += part
        line, self._rest = self._rest.split(b"\n", 1)
        return line


def interpreter(system: str, ours: str, peers: Path) -> Path:
    """The Python that has a system: the peers' own environment, or this one without it."""
    return Path(sys.executable) if system == ours or not peers.exists() else peers
