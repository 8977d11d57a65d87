"""Shows the window of a program: `python -m tai.view examples/mass_spring.py --robot 2`.

With a display, in a window that stays until it is closed: each frame of a `ti.GUI` as it is drawn,
and videos (`ti.tools.write_gif`) when they are complete. `gui.get_event` reports its keyboard and
mouse events, and `gui.running` becomes false when it is closed. A `ti.ui.Window` opens its own.
Without a display, or with `--frames FOLDER`, frames are written to files. Options after the
program's name are passed to it.
"""

from __future__ import annotations

import argparse
import runpy
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ._impl.base.files import save_picture
from ._impl.drawing.events import Event
from ._impl.drawing.frames import FrameLoop
from ._impl.drawing.library import NoWindow
from ._impl.drawing.window import Window


class Frames:
    """Writes frames to files, in the place of a window."""

    # A folder of files is never closed by a user, and has no keyboard.
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
        """Writes an animation, unless its frames were just drawn by a `ti.GUI`."""
        if not self.count:
            for frame in frames:
                self.show(frame)

    def events(self) -> Iterator[Event]:
        """Returns no events, because frames are written to files."""
        return iter(())

    def has_events(self) -> bool:
        """Returns false, because there are never events."""
        return False

    def wait(self) -> None:
        """Returns at once, because a picture that is written to a file has no event queue."""


def fail(message: str) -> NoReturn:
    """Prints one line as the error, and ends the program."""
    print(f"view: {message}", file=sys.stderr)
    sys.exit(2)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        fail(f"{message} (--help tells more)")


def _open(title: str) -> tuple[Window | None, str]:
    """Opens a window; returns it, or None and the reason why there is none."""
    try:
        return Window(title), ""
    except NoWindow as reason:
        return None, str(reason)


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
    FrameLoop.screen = screen
    sys.argv[:] = [str(program), *args.options]
    sys.path[0] = str(program.resolve().parent)
    runpy.run_path(str(program), run_name="__main__")
    screen.wait()


if __name__ == "__main__":
    main()
