"""A display in memory for tests of windows (Xvfb), and somebody who types and clicks there."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tai._impl.drawing import library

SIZE = (800, 600)


class Screen:
    """A display without a window manager: windows are at its upper left corner."""

    def __init__(self, name: str):
        from Xlib import display

        self.name = name
        self._display = display.Display(name)

    def _settle(self) -> None:
        """Waits until other programs have their events.

        The server may send the first answer before them. It takes the second request when it has
        sent all that came of the first one.
        """
        self._display.sync()
        self._display.sync()

    def grab(self) -> np.ndarray:
        """The colours on the screen, (height, width, 3), rows downward."""
        from Xlib import X

        root = self._display.screen().root
        data = root.get_image(0, 0, *SIZE, X.ZPixmap, 0xFFFFFFFF).data
        return np.frombuffer(data, np.uint8).reshape(SIZE[1], SIZE[0], 4)[..., 2::-1]

    def _windows(self, root: Any = None) -> Iterator[Any]:
        for window in (root or self._display.screen().root).query_tree().children:
            if window.get_wm_name():
                yield window
            yield from self._windows(window)

    def window(self, title: str) -> Any:
        """The window with a title."""
        return next(window for window in self._windows() if window.get_wm_name() == title)

    def titles(self) -> list[str]:
        """The titles of the windows that are on the screen."""
        from Xlib import X

        shown = [w for w in self._windows() if w.get_attributes().map_state == X.IsViewable]
        return sorted(window.get_wm_name() for window in shown)

    def focus(self, title: str) -> None:
        """Gives a window the keyboard."""
        from Xlib import X

        window = self.window(title)
        window.configure(stack_mode=X.Above)
        window.set_input_focus(X.RevertToParent, X.CurrentTime)
        self._settle()

    def move(self, title: str, x: int, y: int) -> None:
        """Moves a window."""
        self.window(title).configure(x=x, y=y)
        self._settle()

    def _fake(self, kind: int, detail: int = 0, **place: int) -> None:
        from Xlib.ext import xtest

        xtest.fake_input(self._display, kind, detail, **place)
        self._settle()

    def point(self, x: int, y: int) -> None:
        """Moves the mouse."""
        from Xlib import X

        self._fake(X.MotionNotify, x=x, y=y)

    def press(self, what: str | int) -> None:
        """Presses a key by the name of its symbol, or a mouse button by its number."""
        from Xlib import X

        self._fake(
            *((X.ButtonPress, what) if isinstance(what, int) else (X.KeyPress, self._key(what)))
        )

    def release(self, what: str | int) -> None:
        from Xlib import X

        self._fake(
            *((X.ButtonRelease, what) if isinstance(what, int) else (X.KeyRelease, self._key(what)))
        )

    def tap(self, what: str | int) -> None:
        """Presses and releases."""
        self.press(what)
        self.release(what)

    def _key(self, name: str) -> int:
        from Xlib import XK

        return self._display.keysym_to_keycode(XK.string_to_keysym(name))

    def close(self, title: str) -> None:
        """Presses the button of a window that closes it."""
        from Xlib.protocol import event

        window, atom = self.window(title), self._display.intern_atom
        message = event.ClientMessage(
            window=window, client_type=atom("WM_PROTOCOLS"),
            data=(32, [atom("WM_DELETE_WINDOW"), 0, 0, 0, 0]),
        )  # fmt: skip
        window.send_event(message)
        self._settle()

    def resize(self, title: str, width: int, height: int) -> None:
        """Drags the corner of a window."""
        self.window(title).configure(width=width, height=height)
        self._settle()


@pytest.fixture(scope="module")
def display() -> Iterator[Screen]:
    """A display for the tests of a module.

    A machine without Xvfb has no such tests: `apt install xvfb`, and `pip install "tai[view]"
    python-xlib`.
    """
    if not shutil.which("Xvfb"):
        pytest.skip("Xvfb is missing: apt install xvfb libgl1 libegl1 libgl1-mesa-dri")
    for module in ("glfw", "moderngl", "Xlib"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    end, begin = os.pipe()
    words = ["Xvfb", "-displayfd", str(begin), "-screen", "0", f"{SIZE[0]}x{SIZE[1]}x24"]
    server = subprocess.Popen(
        [*words, "-nolisten", "tcp", "-noreset"], pass_fds=[begin], stderr=subprocess.DEVNULL
    )
    os.close(begin)
    try:
        with os.fdopen(end) as numbers:
            yield Screen(f":{numbers.readline().strip()}")
    finally:
        library.stop()
        server.terminate()
        server.wait()


@pytest.fixture
def screen(display: Screen, monkeypatch: pytest.MonkeyPatch) -> Screen:
    """The display, which programs see while a test runs."""
    monkeypatch.setenv("DISPLAY", display.name)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return display
