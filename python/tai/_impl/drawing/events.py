"""Events of windows, and the names of keys and buttons."""

from __future__ import annotations

from typing import Any, NamedTuple

ESCAPE, SPACE, RETURN, SHIFT, CTRL, ALT = "Escape", " ", "Return", "Shift", "Control", "Alt"
LEFT, RIGHT, UP, DOWN, TAB, BACKSPACE = "Left", "Right", "Up", "Down", "Tab", "BackSpace"
CAPSLOCK = "Caps_Lock"
LMB, MMB, RMB, WHEEL, MOVE, EXIT = "LMB", "MMB", "RMB", "Wheel", "Motion", "WMClose"
PRESS, RELEASE, MOTION = "Press", "Release", "Motion"


class Event(NamedTuple):
    """An event of a window: a key, a mouse button, the wheel, or a motion of the mouse.

    Attributes:
        type: `GUI.PRESS`, `GUI.RELEASE` or `GUI.MOTION`.
        key: a letter, or a name as `GUI.ESCAPE`, `GUI.LMB`, `GUI.WHEEL` or `GUI.MOVE`.
        pos: where the mouse was, from 0 to 1, the second coordinate upward.
        modifier: those of `GUI.SHIFT`, `GUI.CTRL` and `GUI.ALT` that were held.
        delta: of the wheel, in steps.
    """

    type: str
    key: str
    pos: tuple[float, float] = (0.5, 0.5)
    modifier: tuple[str, ...] = ()
    delta: tuple[float, float] = (0.0, 0.0)


def fits(event: Event, wanted: Any) -> bool:
    """Tells whether an event matches a filter: a type, a key, a pair of both, or a list of
    these.
    """
    if isinstance(wanted, (list, set)):
        return any(fits(event, one) for one in wanted)
    if isinstance(wanted, tuple):
        return (event.type, event.key) == wanted
    return wanted in (event.type, event.key)
