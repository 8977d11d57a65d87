"""Shows the window of a program: `python -m tai.view examples/mass_spring.py --robot 2`.

With a display, in a window of matplotlib: each frame of a `ti.GUI` as it is drawn, and videos
(`ti.tools.write_gif`) when they are complete. `gui.get_event` reports its keyboard and mouse
events, and `gui.running` becomes false when it is closed. Without a display, or with `--frames
FOLDER`, frames are written to files. Options after the program's name are passed to it.
"""

from __future__ import annotations

import argparse
import os
import runpy
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ._impl.base.files import save_picture
from .gui import GUI, Event

BACKENDS = ("QtAgg", "TkAgg", "GTK4Agg", "GTK3Agg", "MacOSX")


# Matplotlib's names of the keys that `ti.GUI` has names for; all others are letters.
_KEYS = {
    "escape": GUI.ESCAPE, "enter": GUI.RETURN, "shift": GUI.SHIFT, "control": GUI.CTRL,
    "ctrl": GUI.CTRL, "alt": GUI.ALT, "left": GUI.LEFT, "right": GUI.RIGHT, "up": GUI.UP,
    "down": GUI.DOWN, "tab": GUI.TAB, "backspace": GUI.BACKSPACE, " ": GUI.SPACE,
}  # fmt: skip
_BUTTONS = {1: GUI.LMB, 2: GUI.MMB, 3: GUI.RMB}


def _key_of(event: Any) -> str | None:
    """The key or button of an event of matplotlib; None of one that has no name."""
    if hasattr(event, "button"):
        return _BUTTONS.get(event.button)
    key = event.key
    while key and "+" in key[1:]:  # "ctrl+a", and also "+" and "ctrl++"
        key = key.split("+", 1)[1]
    if not key:
        return None
    return _KEYS.get(key) or (key.lower() if len(key) == 1 else key)


class Window:
    """A window of matplotlib.

    Raises:
        ImportError: none of the backends can be loaded here.
    """

    def __init__(self, title: str, backends: Sequence[str] = BACKENDS):
        import matplotlib
        from matplotlib import pyplot

        errors = []
        for backend in backends:
            try:
                matplotlib.use(backend)
                pyplot.switch_backend(backend)
                break
            except ImportError as error:
                errors.append(str(error))
        else:
            raise ImportError(errors[0] if errors else "no backends")
        self._title = title
        self._image: Any = None
        self._figure: Any = None
        self.is_open = True
        self._events: deque[Event] = deque(maxlen=10_000)  # of a program that never asks
        self._connections: list[int] = []
        self.held: set[str] = set()
        self.cursor = (0.5, 0.5)

    def _make(self, height: int, width: int) -> None:
        from matplotlib import pyplot

        if self._figure is not None:  # of another size
            for number in self._connections:
                self._figure.canvas.mpl_disconnect(number)
            pyplot.close(self._figure)
        self._figure = pyplot.figure(figsize=(width / 100, height / 100), dpi=100)
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._image = axes.imshow(np.zeros((height, width, 3), np.uint8))
        canvas, manager = self._figure.canvas, self._figure.canvas.manager
        if manager is not None:
            manager.set_window_title(self._title)
            if manager.key_press_handler_id is not None:
                canvas.mpl_disconnect(manager.key_press_handler_id)  # keys are the program's
        actions = (
            ("close_event", self._close), ("key_press_event", self._press),
            ("key_release_event", self._release), ("button_press_event", self._press),
            ("button_release_event", self._release), ("scroll_event", self._scroll),
            ("motion_notify_event", self._move),
        )  # fmt: skip
        self._connections = [canvas.mpl_connect(name, action) for name, action in actions]
        self._figure.show()

    def _close(self, _: Any) -> None:
        self.is_open = False
        self._note(GUI.PRESS, GUI.EXIT)

    def _note(self, kind: str, key: str, delta: tuple[float, float] = (0.0, 0.0)) -> None:
        modifier = tuple(k for k in (GUI.SHIFT, GUI.CTRL, GUI.ALT) if k in self.held)
        self._events.append(Event(kind, key, self.cursor, modifier, delta))

    def _place(self, event: Any) -> None:
        width, height = self._figure.canvas.get_width_height(physical=True)
        if event.x is not None and event.y is not None:
            self.cursor = (event.x / width, event.y / height)

    def _press(self, event: Any) -> None:
        self._place(event)
        key = _key_of(event)
        if key:
            self._note(GUI.PRESS, key)
            self.held.add(key)

    def _release(self, event: Any) -> None:
        self._place(event)
        key = _key_of(event)
        if key:
            self.held.discard(key)
            self._note(GUI.RELEASE, key)

    def _scroll(self, event: Any) -> None:
        self._place(event)
        self._note(GUI.MOTION, GUI.WHEEL, (0.0, float(event.step)))

    def _move(self, event: Any) -> None:
        self._place(event)
        self._note(GUI.MOTION, GUI.MOVE)

    def events(self) -> Iterator[Event]:
        """Takes one event after the other."""
        self.has_events()
        while self._events:
            yield self._events.popleft()

    def has_events(self) -> bool:
        """Whether there is one, now."""
        if self.is_open and self._figure is not None:
            self._figure.canvas.flush_events()
        return bool(self._events)

    def show(self, picture: Any) -> None:
        """Shows a picture, rows downward, in the place of the one before."""
        if not self.is_open:
            return
        pixels = np.asarray(picture)
        if self._image is None or self._image.get_array().shape[:2] != pixels.shape[:2]:
            self._make(*pixels.shape[:2])
        self._image.set_data(pixels)
        self._figure.canvas.draw_idle()
        self._figure.canvas.flush_events()

    def play(self, frames: Sequence[Any], framerate: float) -> None:
        """Shows a film."""
        for frame in frames:
            begin = time.monotonic()
            self.show(frame)
            while self.is_open and time.monotonic() - begin < 1 / framerate:
                self._figure.canvas.flush_events()
                time.sleep(0.005)

    def wait(self) -> None:
        """Returns when the window is closed."""
        while self.is_open and self._figure is not None:
            self._figure.canvas.flush_events()
            time.sleep(0.02)


class Frames:
    """Files in the place of a window."""

    # A folder of files is never closed, and has no keyboard.
    is_open = None
    held: frozenset[str] = frozenset()
    cursor = (0.5, 0.5)

    def __init__(self, folder: Path):
        self.folder, self.count = folder, 0

    def show(self, picture: Any) -> None:
        """Writes the next picture."""
        from PIL import Image

        picture = Image.fromarray(np.asarray(picture))
        save_picture(picture, self.folder / f"{self.count:06d}.png")
        self.count += 1

    def play(self, frames: Sequence[Any], framerate: float) -> None:
        """Writes a film, unless its frames were just drawn by a `ti.GUI`."""
        if not self.count:
            for frame in frames:
                self.show(frame)

    def events(self) -> Iterator[Event]:
        """None ever."""
        return iter(())

    def has_events(self) -> bool:
        """Never."""
        return False

    def wait(self) -> None:
        """Returns at once: the window has no queue."""


def fail(message: str) -> NoReturn:
    """Ends the program with one line."""
    print(f"view: {message}", file=sys.stderr)
    sys.exit(2)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        fail(f"{message} (--help tells more)")


def _open(title: str) -> tuple[Window | None, str]:
    """A window, or why there is none."""
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not has_display:
        return None, "there is no display"
    try:
        return Window(title), ""
    except ImportError as error:
        return None, str(error).splitlines()[0]


def _frames(folder: Path, reason: str) -> Frames:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        for old in folder.glob("[0-9]" * 6 + ".png"):  # of a longer run
            old.unlink()
    except OSError as error:
        fail(f"cannot write frames to {folder}: {error.strerror}")
    print(f"view: {reason}: frames go to {folder.resolve()}", file=sys.stderr)
    return Frames(folder)


def main() -> None:
    """Runs the program that the command line names."""
    parser = _Parser(prog="python -m tai.view", description=__doc__)
    parser.add_argument("--frames", type=Path, metavar="FOLDER", help="files, and no window")
    parser.add_argument("program", type=Path)
    parser.add_argument("options", nargs=argparse.REMAINDER, help="of the program")
    args = parser.parse_args()
    program = args.program
    if not program.is_file():
        fail(f"there is no program {program}")
    window, reason = (None, "as asked") if args.frames else _open(program.stem)
    screen = window or _frames(args.frames or Path("out") / "view" / program.stem, reason)
    GUI.screen = screen
    sys.argv[:] = [str(program), *args.options]
    sys.path[0] = str(program.resolve().parent)
    runpy.run_path(str(program), run_name="__main__")
    screen.wait()


if __name__ == "__main__":
    main()
