"""Numbers that Python has read from values with a history, known by their objects.

The text of a program does not always show where a number comes from: a property may return it, an
object hold it, and a text without a file read it. Such a number is the same object until Python
computes with it, so that the objects of a recording are kept, and compared with arguments and with
what is written.
"""

from __future__ import annotations

import threading
from typing import Any

from ..base import native

# A recording that reads more numbers forgets all of them, and then remembers the next ones.
_MOST = 1 << 16


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.read: dict[int, Any] = {}


_of_thread = _OfThread()


def note(value: Any) -> None:
    """Python has read a number that has a history."""
    if not isinstance(value, float):
        return
    read = _of_thread.read
    if len(read) >= _MOST:
        clear()
    read[id(value)] = value
    native.note_number(value)


def is_read(value: Any) -> bool:
    """Whether the value is a number that the recording has read."""
    return bool(_of_thread.read) and _of_thread.read.get(id(value)) is value is not None


def clear() -> None:
    """The tape records no more."""
    if _of_thread.read:
        _of_thread.read.clear()
        native.forget_numbers()
