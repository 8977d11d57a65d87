"""Locks that signal handlers and forked children may meet, too."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Iterable
from typing import Any, TypeVar

T = TypeVar("T")


class Lock:
    """A lock that a thread may take again, and that nobody holds in a forked child.

    Python calls a signal handler between any two of its steps, and the garbage collector what
    hangs on an object: with a plain lock either would wait for the thread that it runs on. What
    they find in the middle of a change must be usable. In a child the thread that held it is gone.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        _all.add(self)

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: Any) -> None:
        self._lock.release()

    def _begin_in_child(self) -> None:
        if not self._lock._is_owned():  # type: ignore[attr-defined]
            self._lock = threading.RLock()


def snapshot(things: Iterable[T]) -> list[T]:
    """What is in a set or dictionary that other threads, or handlers, may add to meanwhile."""
    while True:
        try:
            return list(things)
        except RuntimeError:
            # It has grown while it was read.
            continue


_all: weakref.WeakSet[Lock] = weakref.WeakSet()


def _begin_in_child() -> None:
    for lock in snapshot(_all):
        lock._begin_in_child()


os.register_at_fork(after_in_child=_begin_in_child)
