"""Shows what a program draws: `python -m tai.view examples/mass_spring.py --robot 2`.

Where a display is, in a window of matplotlib: each frame of a `ti.GUI` as it is drawn, and films
(`ti.tools.write_gif`) played once they are made. Closing the window ends the loops of a program
that ask `gui.running`. Elsewhere, or with `--frames FOLDER`, the frames become files. Options
behind the program are its own.
"""

from __future__ import annotations

import argparse
import os
import runpy
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from .gui import GUI

BACKENDS = ("QtAgg", "TkAgg", "GTK4Agg", "GTK3Agg", "MacOSX")


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

    def _make(self, height: int, width: int) -> None:
        from matplotlib import pyplot

        self._figure = pyplot.figure(self._title, figsize=(width / 100, height / 100), dpi=100)
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._image = axes.imshow(np.zeros((height, width, 3), np.uint8))
        self._figure.canvas.mpl_connect("close_event", self._close)
        self._figure.show()

    def _close(self, _: Any) -> None:
        self.is_open = False

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

    is_open = None  # nobody closes it

    def __init__(self, folder: Path):
        self.folder, self.count = folder, 0

    def show(self, picture: Any) -> None:
        """Writes the next picture."""
        from PIL import Image

        Image.fromarray(np.asarray(picture)).save(self.folder / f"{self.count:06d}.png")
        self.count += 1

    def play(self, frames: Sequence[Any], framerate: float) -> None:
        """Writes a film, unless its frames were just drawn by a `ti.GUI`."""
        if not self.count:
            for frame in frames:
                self.show(frame)

    def wait(self) -> None:
        """There is nothing to wait for."""


def fail(message: str) -> NoReturn:
    """Ends the program with one line."""
    print(f"view: {message}", file=sys.stderr)
    sys.exit(2)


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
    except OSError as error:
        fail(f"cannot write frames to {folder}: {error.strerror}")
    print(f"view: {reason}: frames go to {folder.resolve()}", file=sys.stderr)
    return Frames(folder)


def main() -> None:
    """Runs the program that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m tai.view", description=__doc__)
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
