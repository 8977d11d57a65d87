"""Exchanges that a GPU carries out later than the host queues them.

NCCL does not notice itself that a rank is gone, and the host does not wait for it: a thread looks
whether an exchange that the GPU has reached ends in time, and whether its messages are those of
the same exchange.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

# The seconds between two looks of the thread.
PAUSE = 0.25


class _Queued(NamedTuple):
    begin: Any
    end: Any
    heads: Sequence[tuple[int, Any]]
    head: int
    action: str


class Watch:
    """The exchanges of a mesh that its GPU has not done.

    Args:
        timeout: the seconds that an exchange may take, from when the GPU reaches it.
        lose: called on the thread with the subject of an exchange that failed, the reason, and
            the rank that is the cause, or None.
    """

    def __init__(self, timeout: float, lose: Callable[[str, str, int | None], None]):
        self._timeout, self._lose = timeout, lose
        self._queued: deque[_Queued] = deque()
        self._lock = threading.Lock()
        self._since: float | None = None
        self._thread: threading.Thread | None = None
        self._has_ended = threading.Event()

    def add(self, begin: Any, end: Any, heads: Sequence[tuple[int, Any]], head: int,
            action: str) -> None:  # fmt: skip
        """Notes an exchange between two events of the GPU.

        Args:
            heads: ranks, and memory of the host that gets the heads of their messages.
            head: the number that these heads are to have.
        """
        self._queued.append(_Queued(begin, end, heads, head, action))
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="tai-exchanges", daemon=True)
            self._thread.start()
            # Python stops threads in the middle of calls of libraries, which abort the process.
            atexit.register(self.stop)

    def look(self) -> bool:
        """Forgets exchanges that are done; False if one has failed."""
        with self._lock:
            while self._queued:
                first = self._queued[0]
                try:
                    is_done, has_begun = first.end.query(), first.begin.query()
                except RuntimeError as error:
                    self._fail(first, f"the GPU has failed: {error}", None)
                    return False
                if not is_done:
                    now = time.monotonic()
                    self._since = now if self._since is None and has_begun else self._since
                    if self._since is None or now - self._since <= self._timeout:
                        return True
                    self._fail(first, f"no answer in {self._timeout:g} s", None)
                    return False
                for peer, got in first.heads:
                    if int(got) != first.head:
                        self._fail(first, "it sends the rows of another exchange", peer)
                        return False
                self._queued.popleft()
                self._since = None
        return True

    def hurry(self) -> None:
        """Another rank has given up: exchanges with it will not end."""
        self._timeout = min(self._timeout, 2.0)

    def _fail(self, first: _Queued, reason: str, peer: int | None) -> None:
        self._queued.clear()
        self._lose(first.action, reason, peer)

    def stop(self) -> None:
        """Ends the thread."""
        self._has_ended.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(1.0)

    def _run(self) -> None:
        while not self._has_ended.wait(PAUSE) and self.look():
            pass
