"""Locks that signal handlers and forked children may meet, too."""

from __future__ import annotations

import _thread
import os
import weakref
from collections.abc import Iterable
from typing import Any, TypeVar

from .handlers import is_of_a_handler

T = TypeVar("T")


class Lock(_thread.RLock):  # type: ignore[misc]  # typeshed calls it final; CPython does not
    """A lock that a thread may take again, and that is free in a forked child.

    Python may call a signal handler or a finaliser between any two steps: with a plain lock, either
    would wait for the thread that it runs on. Handlers and finalisers that come in the middle of a
    change must find usable data. In a child the thread that held it is gone.

    `with` calls the interpreter's own `__enter__` and `__exit__`. Were they written in Python, a
    Ctrl-C between the lock and their return would leave it held for ever.
    """

    def __new__(cls) -> Lock:
        lock: Any = super().__new__(cls)
        _all.add(lock)
        return lock

    def _begin_in_child(self) -> None:
        if not self._is_owned():  # type: ignore[attr-defined]
            self._at_fork_reinit()  # type: ignore[attr-defined]


def snapshot(things: Iterable[T]) -> list[T]:
    """The items of a set or dictionary to which other threads or handlers may add meanwhile."""
    while True:
        try:
            return list(things)
        except RuntimeError as error:
            # The collection has grown while it was read, or a signal handler has raised the error.
            if is_of_a_handler(error.__traceback__):
                raise


_all: weakref.WeakSet[Lock] = weakref.WeakSet()


def _begin_in_child() -> None:
    for lock in snapshot(_all):
        lock._begin_in_child()


os.register_at_fork(after_in_child=_begin_in_child)
