"""The place in the program that calls the package."""

from __future__ import annotations

import sys
from types import FrameType
from typing import Any


def calling_frame() -> Any:
    """Returns the innermost stack frame that belongs to the user's program, or None."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and _is_ours(frame):
        frame = frame.f_back
    return frame


def calling_level() -> int:
    """The number of calls between the caller of this function and the program: the `stacklevel` of
    a warning at the line of the program."""
    level = 1
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and _is_ours(frame):
        level, frame = level + 1, frame.f_back
    return level


def _is_ours(frame: FrameType) -> bool:
    return frame.f_globals.get("__name__", "").split(".")[0] == "tai"
