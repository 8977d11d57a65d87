"""A line on the terminal that names the kernel being compiled, after one second of it.

Only where standard error is a terminal. `ti.init(compile_progress=False)` turns it off.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from typing import Any

from . import native, state
from .locks import Lock

PATIENCE = 1.0  # seconds without a line
GAP = 0.3  # a pause that is longer ends a series of compilations
CLEAR = "\r\x1b[K"


class Watcher:
    """Writes the status line of a compilation from its own thread, while other threads compile."""

    def __init__(self) -> None:
        self._lock = Lock()
        # The kernels that are being compiled; several threads may compile at once.
        self._compilations: list[_Compilation] = []
        self._begin = self._end = 0.0
        self._done = 0
        self._is_shown = False
        self._thread: threading.Thread | None = None

    def compiling(self, name: str) -> _Compilation:
        """Returns a context manager that shows a line while the kernel `name` is compiled."""
        return _Compilation(self, name)

    def begin(self, compilation: _Compilation) -> None:
        with self._lock:
            now = time.monotonic()
            if not self._compilations and now - self._end > GAP:
                self._begin, self._done = now, 0
            self._compilations.append(compilation)
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._run, name="tai-progress", daemon=True)
                self._thread.start()

    def end(self, compilation: _Compilation) -> None:
        with self._lock:
            if compilation in self._compilations:
                self._compilations.remove(compilation)
                self._done += 1
                self._end = time.monotonic()
            if not self._compilations and self._is_shown:
                self._write(CLEAR)
                self._is_shown = False

    def _run(self) -> None:
        while True:
            time.sleep(0.1)
            with self._lock:
                if not self._compilations:
                    self._thread = None
                    return
                seconds = time.monotonic() - self._begin
                if seconds > PATIENCE:
                    self._show(self._compilations[-1].name, seconds)

    def _show(self, name: str, seconds: float) -> None:
        text = f"compiling kernel '{name}'"
        if self._done:
            text += f", {self._done} done"
        # If another program draws a progress bar and puts whole lines above it, one status line is
        # enough.
        if sys.stderr is not sys.__stderr__:
            if not self._is_shown:
                self._write(f"{text} …\n")
        else:
            self._write(f"{CLEAR}{text}, {seconds:.0f} s")
        self._is_shown = True

    @staticmethod
    def _write(text: str) -> None:
        stream: Any = sys.stderr
        if text == CLEAR and stream is not sys.__stderr__:
            return
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, say
            stream.write(text)
            stream.flush()


class _Compilation(native.WithBlock):
    """The context manager around the compilation of one kernel."""

    def __init__(self, watcher: Watcher, name: str):
        self._watcher, self.name = watcher, name

    def _enter(self) -> None:
        self._watcher.begin(self)

    def _end(self) -> None:
        self._watcher.end(self)


_watcher = Watcher()


def is_shown() -> bool:
    """Whether the line about the compilation would be visible in this process."""
    if not state.options.compile_progress:
        return False
    try:
        return bool(sys.stderr.isatty())
    except (AttributeError, ValueError):  # no standard error, or a closed one
        return False


def compiling(name: str) -> contextlib.AbstractContextManager[None]:
    """Shows the name of a kernel on the terminal while it is being compiled."""
    return _watcher.compiling(name)
