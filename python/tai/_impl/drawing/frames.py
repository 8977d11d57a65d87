"""Frames that go to a window, to files, or nowhere; what `ti.GUI` and `ti.ui.Window` share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

from ..base.files import save_picture
from . import events, library
from .events import Event, fits
from .panels import Panels, paint
from .window import Window


class FrameLoop:
    """The base of canvases whose frames are shown in a window or written to files.

    Attributes:
        frame: number of frames that were shown.
        event: the last one that `get_event` found.
        fps_limit: frames in a second of a window, at most; None or 0 for no limit.
    """

    # The names of keys and events, for programs that compare with them.
    ESCAPE, SPACE, RETURN = events.ESCAPE, events.SPACE, events.RETURN
    SHIFT, CTRL, ALT, TAB = events.SHIFT, events.CTRL, events.ALT, events.TAB
    LEFT, RIGHT, UP, DOWN = events.LEFT, events.RIGHT, events.UP, events.DOWN
    BACKSPACE, CAPSLOCK, EXIT = events.BACKSPACE, events.CAPSLOCK, events.EXIT
    LMB, MMB, RMB, WHEEL, MOVE = events.LMB, events.MMB, events.RMB, events.WHEEL, events.MOVE
    PRESS, RELEASE, MOTION = events.PRESS, events.RELEASE, events.MOTION

    # The object by which `tai.view` shows the frames of all canvases: a window, or files.
    screen: Any = None
    # Whether the user was told where frames go.
    _is_told = False

    fps_limit: float | None = 60

    def __init__(self, size: tuple[int, int], frames_dir: str | None, max_frames: int | None):
        self.frames_dir = frames_dir or os.environ.get("TAI_GUI_DIR")
        self.max_frames = max_frames or int(os.environ.get("TAI_GUI_FRAMES", 1000))
        self.frame = 0
        self.event: Any = None
        self._is_running = True
        self._window: Window | None = None
        self._reason = ""
        self._panels = Panels(size)

    def _open(self, *settings: Any, is_shared: bool = True) -> None:
        """Opens a window for a picture, if there is none yet and the machine can open one.

        Args:
            settings: arguments of `Window`.
            is_shared: whether the window of `tai.view` will do.
        """
        if self.screen and (is_shared or not isinstance(self.screen, Window)):
            self._panels = getattr(self.screen, "panels", self._panels)
            return
        try:
            self._window = Window(*settings)
        except library.NoWindow as reason:
            self._reason = str(reason)
        else:
            self._panels = self._window.panels

    @property
    def _screen(self) -> Any:
        """The window that shows frames, or the file writer of `tai.view`; None if there is
        neither.
        """
        return self._window or self.screen

    @property
    def running(self) -> bool:
        """Whether the program's loop over frames should go on.

        It ends when the window is closed, by its button or the key ESC. Without a window it ends
        after `max_frames` frames.
        """
        is_open = self._screen.is_open if self._screen else None
        if self.frame >= self.max_frames if is_open is None else not is_open:
            self._is_running = False
        return self._is_running

    @running.setter
    def running(self, value: bool) -> None:
        self._is_running = bool(value)

    def _show(self, picture: Callable[[], Any], file: str | None, title: str) -> None:
        """Ends a frame: says once in which folder frames are written, and writes the frame if there
        is a folder.

        Args:
            picture: makes the Pillow image.
            file: the file of this frame alone.
            title: names the class in the message.
        """
        if file is None and not self._screen and not FrameLoop._is_told:
            FrameLoop._is_told = True
            where = (
                f"frames go to the folder {self.frames_dir}"
                if self.frames_dir
                else "frames_dir=… or TAI_GUI_DIR names a folder for frames"
            )
            because = f" ({self._reason})" if self._reason else ""
            print(f"{title} opens no window{because}: {where}, and `python -m tai.view` shows them",
                  file=sys.stderr)  # fmt: skip
        if file is None and self.frames_dir:
            file = os.path.join(self.frames_dir, f"{self.frame:06d}.png")
        if file is not None:
            folder = os.path.dirname(str(file))
            if folder:
                os.makedirs(folder, exist_ok=True)
            save_picture(picture(), file)
        self.frame += 1

    def _keep_pace(self) -> None:
        if isinstance(self._screen, Window):
            self._screen.keep_pace(self.fps_limit)

    def _with_panels(self, picture: Any) -> Any:
        """Returns a Pillow image with the widgets drawn over the picture."""
        return paint(picture, self._panels.shown)

    def close(self) -> None:
        """Closes the window, and ends the program's loop over frames."""
        self._is_running = False
        if self._window is not None:
            self._window.close()

    def __del__(self) -> None:
        window = self.__dict__.get("_window")
        if window is not None:
            window.close()

    # Keyboard and mouse of the window. Without a window, no key is ever pressed.

    def get_events(self, *filters: Any) -> Iterator[Event]:
        """Events since the last call that match a filter; others are discarded.

        Args:
            filters: a type or key of events, a pair of both, or a list of these; all events, if
                there are none.
        """
        filters = tuple(one for one in filters if one is not None)
        for event in self._screen.events() if self._screen else ():
            if not filters or any(fits(event, one) for one in filters):
                yield event

    def get_event(self, *filters: Any) -> bool:
        """Whether a matching event is pending; it is stored in `event`, and later events stay
        pending.
        """
        found = next(self.get_events(*filters), None)
        self.event = self.event if found is None else found
        return found is not None

    def get_key_event(self) -> Event | None:
        """Returns the next press or release of a key; None if none is pending."""
        return next(self.get_events(self.PRESS, self.RELEASE), None)

    def has_key_event(self) -> bool:
        """Whether an event of a key is pending."""
        return bool(self._screen and self._screen.has_events())

    def is_pressed(self, *keys: Any) -> bool:
        """Whether one of the given keys and mouse buttons is held."""
        held = self._screen.held if self._screen else ()
        return any(key in held for key in keys)

    def get_cursor_pos(self) -> tuple[float, float]:
        """The position of the mouse in the window; the centre of the picture if there is no
        window.
        """
        return self._screen.cursor if self._screen else (0.5, 0.5)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()
