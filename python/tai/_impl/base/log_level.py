"""Taichi's log level: tai has no log, but stores the level for programs that query it."""

from __future__ import annotations

from ...errors import TaiRuntimeTypeError

_LEVELS = ["trace", "debug", "info", "warn", "error", "critical"]
_level = "info"


def _number(level: str) -> int:
    if level not in _LEVELS:
        raise TaiRuntimeTypeError(
            f"there is no level {level!r} of a log", f"the levels are {', '.join(_LEVELS)}"
        )
    return _LEVELS.index(level)


def set_logging_level(level: str) -> None:
    """Sets the lowest level of messages that are written; it does not filter Python's warnings."""
    global _level
    _number(level)
    _level = level


def is_logging_effective(level: str) -> bool:
    """Whether a log message of this level would be written."""
    return _number(level) >= _number(_level)
