"""A window of GLFW: shows pictures, and collects events."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from . import events, library
from .events import Event
from .panels import Panels
from .shaders import PROGRAMS

# The size of a window before the first picture says how large it should be.
_SIZE = (640, 480)

_NAMES = {
    "ESCAPE": events.ESCAPE, "ENTER": events.RETURN, "KP_ENTER": events.RETURN,
    "SPACE": events.SPACE, "TAB": events.TAB, "BACKSPACE": events.BACKSPACE,
    "LEFT_SHIFT": events.SHIFT, "RIGHT_SHIFT": events.SHIFT, "LEFT_CONTROL": events.CTRL,
    "RIGHT_CONTROL": events.CTRL, "LEFT_ALT": events.ALT, "RIGHT_ALT": events.ALT,
    "LEFT": events.LEFT, "RIGHT": events.RIGHT, "UP": events.UP, "DOWN": events.DOWN,
    "CAPS_LOCK": events.CAPSLOCK, "DELETE": "Delete", "INSERT": "Insert", "HOME": "Home",
    "END": "End", "PAGE_UP": "Page_Up", "PAGE_DOWN": "Page_Down",
    **{f"F{n}": f"F{n}" for n in range(1, 13)},
}  # fmt: skip
_BUTTONS = {0: events.LMB, 1: events.RMB, 2: events.MMB}


class Window:
    """A window on the screen, and the events of its keyboard and mouse.

    Args:
        title: its title.
        size: in pixels; without a size the window appears with its first picture.
        fullscreen: fills the first screen.
        position: of its upper left corner on the screen, in pixels.
        has_vsync: pictures wait for the screen.

    Attributes:
        context: that of ModernGL.
        is_open: false when its button or the key ESC has closed it.
        held: keys and buttons that are down.
        cursor: the place of the mouse, from 0 to 1, the second coordinate upward.
        panels: widgets, which take presses of the left button before the program.

    Raises:
        NoWindow: none can be opened here.
    """

    def __init__(
        self, title: str, size: tuple[int, int] | None = None, fullscreen: bool = False,
        position: tuple[int, int] | None = None, has_vsync: bool = False,
    ):  # fmt: skip
        self._glfw = glfw = library.start_glfw()
        glfw.default_window_hints()
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 3)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 3)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
        glfw.window_hint(glfw.VISIBLE, size is not None)
        monitor = glfw.get_primary_monitor() if fullscreen else None
        self._handle = glfw.create_window(*(size or _SIZE), title, monitor, None)
        if not self._handle:
            raise library.NoWindow(library.last_message())
        try:
            self.context = library.context_of(glfw, self._handle)
        except Exception as error:
            glfw.destroy_window(self._handle)
            raise library.NoWindow(str(error).splitlines()[0]) from None
        if position is not None:
            glfw.set_window_pos(self._handle, *position)
        with self.context:
            glfw.swap_interval(int(has_vsync))
        library.windows.add(self)
        self._size = size
        self._texture: Any = None
        self._blit: Any = None
        self._last_shown = 0.0
        self.is_open = True
        self._events: deque[Event] = deque(maxlen=10_000)  # of a program that never asks
        self.held: set[str] = set()
        self.cursor = (0.5, 0.5)
        self.panels = Panels(size or _SIZE)
        self._key_names = {getattr(glfw, f"KEY_{key}"): name for key, name in _NAMES.items()}
        glfw.set_key_callback(self._handle, self._on_key)
        glfw.set_mouse_button_callback(self._handle, self._on_button)
        glfw.set_cursor_pos_callback(self._handle, self._on_motion)
        glfw.set_scroll_callback(self._handle, self._on_wheel)
        glfw.set_window_close_callback(self._handle, self._on_close)

    # Callbacks for events, which GLFW calls while it is polled.

    def _note(self, kind: str, key: str, delta: tuple[float, float] = (0.0, 0.0)) -> None:
        modifier = tuple(k for k in (events.SHIFT, events.CTRL, events.ALT) if k in self.held)
        self._events.append(Event(kind, key, self.cursor, modifier, delta))

    def _on_key(self, _: Any, key: int, code: int, action: int, mods: int) -> None:
        name = self._key_names.get(key) or (self._glfw.get_key_name(key, code) or "").lower()
        if not name or action == self._glfw.REPEAT:
            return
        if action == self._glfw.PRESS:
            self._note(events.PRESS, name)
            self.held.add(name)
            if name == events.ESCAPE:
                self._hide()
        else:
            self.held.discard(name)
            self._note(events.RELEASE, name)

    def _on_button(self, _: Any, button: int, action: int, mods: int) -> None:
        name = _BUTTONS.get(button)
        if name is None:
            return
        is_left, is_press = name == events.LMB, action == self._glfw.PRESS
        if is_left and (self.panels.press() if is_press else self.panels.release()):
            return
        if is_press:
            self._note(events.PRESS, name)
            self.held.add(name)
        else:
            self.held.discard(name)
            self._note(events.RELEASE, name)

    def _on_motion(self, _: Any, x: float, y: float) -> None:
        width, height = self._glfw.get_window_size(self._handle)
        self.cursor = (x / max(width, 1), 1 - y / max(height, 1))
        self.panels.move(self.cursor)
        self._note(events.MOTION, events.MOVE)

    def _on_wheel(self, _: Any, x: float, y: float) -> None:
        self._note(events.MOTION, events.WHEEL, (float(x), float(y)))

    def _on_close(self, _: Any) -> None:
        self._note(events.PRESS, events.EXIT)
        self._hide()

    def _hide(self) -> None:
        self.is_open = False
        self._glfw.hide_window(self._handle)

    def add(self, event: Event) -> None:
        """Adds an event that a widget has caused."""
        self._events.append(event)

    def events(self) -> Iterator[Event]:
        """Yields the pending events one after the other."""
        self.has_events()
        while self._events:
            yield self._events.popleft()

    def has_events(self) -> bool:
        """Whether an event is pending at present."""
        if self.is_open and self._handle:
            self._glfw.poll_events()
        return bool(self._events)

    # Pictures

    @property
    def pixels(self) -> tuple[int, int]:
        """The width and height of the inside of the window in pixels, as the user has resized it;
        at least one.
        """
        width, height = self._glfw.get_framebuffer_size(self._handle)
        return max(width, 1), max(height, 1)

    def show(self, picture: Any) -> None:
        """Shows a picture in the window in place of the previous picture; rows run downward."""
        if not self.is_open:
            return
        array = np.ascontiguousarray(np.asarray(picture)[..., :3])
        size = (array.shape[1], array.shape[0])
        if self._size != size:
            self._glfw.set_window_size(self._handle, *size)
            self._glfw.show_window(self._handle)
            self._size = self.panels.size = size
        with self.context:
            if self._texture is None or self._texture.size != size:
                if self._texture is not None:
                    self._texture.release()
                self._texture = self.context.texture(size, 3, alignment=1)
            self._texture.write(array)
            self.present(self._texture, is_upright=False)

    def present(self, texture: Any, is_upright: bool = True) -> None:
        """Draws a texture over the whole window, whose OpenGL context is the current one.

        Args:
            is_upright: whether its rows run upward, as those of OpenGL do.
        """
        if self._blit is None:
            corners, pixels = PROGRAMS["image"]
            program = self.context.program(vertex_shader=corners, fragment_shader=pixels)
            self._blit = self.context.vertex_array(program, [])
        self.context.screen.use()
        self.context.viewport = (0, 0, *self.pixels)
        self.context.disable(self.context.DEPTH_TEST | self.context.BLEND)
        texture.use(0)
        self._blit.program["is_upright"].value = is_upright
        self._blit.render(self.context.TRIANGLE_STRIP, vertices=4)
        self._glfw.swap_buffers(self._handle)
        self._glfw.poll_events()

    def keep_pace(self, rate: float | None) -> None:
        """Waits until a frame has had its time, at most `rate` frames in a second."""
        if rate and self.is_open:
            rest = self._last_shown + 1 / rate - time.monotonic()
            if rest > 0:
                time.sleep(rest)
        self._last_shown = time.monotonic()

    def play(self, frames: Sequence[Any], framerate: float) -> None:
        """Shows a film."""
        for frame in frames:
            if self.is_open:
                self.show(frame)
                self.keep_pace(framerate)

    def wait(self) -> None:
        """Returns when the user has closed the window."""
        while self.is_open and self._size is not None:
            if self._texture is not None:  # another window may have covered it
                with self.context:
                    self.present(self._texture, is_upright=False)
            self._glfw.wait_events_timeout(0.1)

    def close(self) -> None:
        """Removes the window from the screen."""
        self.is_open = False
        if self._handle:
            library.windows.discard(self)
            self._glfw.destroy_window(self._handle)
            self._handle = None
