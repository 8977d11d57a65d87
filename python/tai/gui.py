"""`ti.GUI`: draws images, which `python -m tai.view` shows in a window.

Coordinates run from 0 to 1, the second one upward. `show("frame.png")` writes an image.
`show()` writes one per frame into the folder given by the option `frames_dir` or the environment
variable TAI_GUI_DIR; without a folder it only counts frames, and says so once. Without a window,
`running` becomes false after `max_frames` frames (or TAI_GUI_FRAMES; 1000 by default). Keyboard and
mouse events come from the window of `tai.view`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ._impl.base.files import save_picture
from .errors import TaiRuntimeTypeError

# Shapes are drawn this many times larger and then reduced: smooth edges.
_SCALE = 2


def hex_to_rgb(color: Any) -> tuple[Any, Any, Any]:
    """0xRRGGBB as three numbers from 0 to 1."""
    return ((color >> 16 & 255) / 255, (color >> 8 & 255) / 255, (color & 255) / 255)


def rgb_to_hex(rgb: Any) -> Any:
    """Three numbers (or arrays) from 0 to 1 as 0xRRGGBB."""

    def channel(x: Any) -> Any:
        return np.clip(np.asarray(x) * 255, 0, 255).astype(np.int64)

    value = (channel(rgb[0]) << 16) | (channel(rgb[1]) << 8) | channel(rgb[2])
    return int(value) if np.ndim(value) == 0 else value


def _bytes(color: Any) -> tuple[int, int, int]:
    color = int(color)
    return (color >> 16 & 255, color >> 8 & 255, color & 255)


def _array(values: Any) -> np.ndarray:
    return np.asarray(values.to_numpy() if hasattr(values, "to_numpy") else values, float)


def _fits(event: Event, wanted: Any) -> bool:
    if isinstance(wanted, (list, set)):
        return any(_fits(event, one) for one in wanted)
    if isinstance(wanted, tuple):
        return (event.type, event.key) == wanted
    return wanted in (event.type, event.key)


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


class GUI:
    """A canvas of `res` pixels.

    Args:
        name: title of the window; not drawn.
        res: width and height, or one number for both.
        background_color: 0xRRGGBB.
        frames_dir: folder for the frames of `show()`.
        max_frames: frames after which `running` is false.
    """

    # Keys and events, for programs that ask.
    ESCAPE, SPACE, RETURN, SHIFT, CTRL, ALT = "Escape", " ", "Return", "Shift", "Control", "Alt"
    LEFT, RIGHT, UP, DOWN, TAB, EXIT = "Left", "Right", "Up", "Down", "Tab", "WMClose"
    BACKSPACE = "BackSpace"
    LMB, MMB, RMB, WHEEL, MOVE = "LMB", "MMB", "RMB", "Wheel", "Motion"
    PRESS, RELEASE, MOTION = "Press", "Release", "Motion"

    # Where `tai.view` shows frames: a window, or files.
    screen: Any = None
    # Whether the user knows where frames go.
    _is_told = False

    def __init__(
        self,
        name: str = "tai",
        res: Any = 512,
        background_color: int = 0x000000,
        show_gui: bool = True,
        fullscreen: bool = False,
        fast_gui: bool = False,
        frames_dir: str | None = None,
        max_frames: int | None = None,
    ):
        self.name = name
        self.res = (int(res), int(res)) if np.ndim(res) == 0 else (int(res[0]), int(res[1]))
        self.background_color = background_color
        self.frames_dir = frames_dir or os.environ.get("TAI_GUI_DIR")
        self.max_frames = max_frames or int(os.environ.get("TAI_GUI_FRAMES", 1000))
        self.frame = 0
        self.running = True
        self.fps_limit = 60
        self.event: Any = None
        self.clear()

    # The canvas

    def clear(self, color: int | None = None) -> None:
        """Fills the canvas with one colour."""
        from PIL import Image, ImageDraw

        fill = _bytes(self.background_color if color is None else color)
        size = (self.res[0] * _SCALE, self.res[1] * _SCALE)
        self._image = Image.new("RGB", size, fill)
        self._draw = ImageDraw.Draw(self._image)

    def set_image(self, image: Any) -> None:
        """Shows an array of shape res, res + (3,) or res + (4,), first index to the right."""
        from PIL import Image, ImageDraw

        pixels = image.to_numpy() if hasattr(image, "to_numpy") else np.asarray(image)
        if pixels.shape[:2] != self.res:
            raise TaiRuntimeTypeError(
                f"the image has shape {pixels.shape[:2]}, but the GUI {self.res}",
                "make the GUI with res= the shape of the image",
            )
        if pixels.dtype != np.uint8:
            pixels = (np.clip(np.nan_to_num(pixels.astype(float)), 0, 1) * 255).astype(np.uint8)
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[..., None], 3, axis=2)
        upright = np.ascontiguousarray(pixels[..., :3].swapaxes(0, 1)[::-1])
        size = (self.res[0] * _SCALE, self.res[1] * _SCALE)
        self._image = Image.fromarray(upright).resize(size, Image.Resampling.NEAREST)
        self._draw = ImageDraw.Draw(self._image)

    def _points(self, positions: Any, dimensions: int = 2) -> np.ndarray:
        """Positions in pixels of the enlarged canvas."""
        array = np.atleast_2d(_array(positions))
        if array.shape[-1] != dimensions:
            raise TaiRuntimeTypeError(f"a position has {dimensions} coordinates: {array.shape}")
        array = np.nan_to_num(array, nan=-9.0, posinf=9.0, neginf=-9.0).clip(-9.0, 9.0)
        size = np.array(self.res) * _SCALE
        return np.stack([array[:, 0] * size[0], (1 - array[:, 1]) * size[1]], axis=1)

    # Shapes

    def circle(self, pos: Any, color: int = 0xFFFFFF, radius: float = 1) -> None:
        """A disc; the radius is in pixels."""
        self.circles([pos], radius, color)

    def circles(
        self, pos: Any, radius: Any = 1, color: Any = 0xFFFFFF, palette: Any = None,
        palette_indices: Any = None,
    ) -> None:  # fmt: skip
        """Many discs; radius and colour may be arrays."""
        points = self._points(pos)
        colors = self._colors(color, len(points), palette, palette_indices)
        radii = np.broadcast_to(_array(radius), len(points)) * _SCALE
        for (x, y), r, fill in zip(points.tolist(), radii.tolist(), colors, strict=True):
            self._draw.ellipse((x - r, y - r, x + r, y + r), fill=fill)

    def _colors(self, color: Any, count: int, palette: Any, indices: Any) -> list[Any]:
        if palette is not None:
            table = [_bytes(c) for c in palette]
            chosen = _array(indices).astype(int).ravel()
            return [table[c] for c in np.broadcast_to(chosen, count)]
        color = color.to_numpy() if hasattr(color, "to_numpy") else color
        if np.ndim(color) == 0:
            return [_bytes(color)] * count
        return [_bytes(c) for c in color]

    def line(self, begin: Any, end: Any, radius: float = 1, color: int = 0xFFFFFF) -> None:
        """A line; the radius, half of its width, is in pixels."""
        self.lines([begin], [end], radius, color)

    def lines(self, begin: Any, end: Any, radius: Any = 1, color: Any = 0xFFFFFF) -> None:
        """Many lines."""
        starts, ends = self._points(begin), self._points(end)
        colors = self._colors(color, len(starts), None, None)
        widths = np.broadcast_to(_array(radius), len(starts)) * _SCALE
        for a, b, w, fill in zip(starts, ends, widths, colors, strict=True):
            self._draw.line([*a.tolist(), *b.tolist()], fill=fill, width=max(1, round(2 * w)))
            for x, y in (a, b):
                if w > 1:
                    self._draw.ellipse((x - w, y - w, x + w, y + w), fill=fill)

    def triangle(self, a: Any, b: Any, c: Any, color: int = 0xFFFFFF) -> None:
        """A filled triangle."""
        self.triangles([a], [b], [c], color)

    def triangles(self, a: Any, b: Any, c: Any, color: Any = 0xFFFFFF) -> None:
        """Many filled triangles."""
        corners = [self._points(p) for p in (a, b, c)]
        colors = self._colors(color, len(corners[0]), None, None)
        for p, q, r, fill in zip(*corners, colors, strict=True):
            self._draw.polygon([tuple(p), tuple(q), tuple(r)], fill=fill)

    def rect(
        self, topleft: Any, bottomright: Any, radius: float = 1, color: int = 0xFFFFFF
    ) -> None:
        """The outline of a rectangle."""
        (x0, y0), (x1, y1) = _array(topleft), _array(bottomright)
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        self.lines(corners, [*corners[1:], corners[0]], radius, color)

    def arrow(self, orig: Any, direction: Any, radius: float = 1, color: int = 0xFFFFFF) -> None:
        """A line with a head at its end."""
        start, way = _array(orig), _array(direction)
        tip = start + way
        self.line(start, tip, radius, color)
        side = np.array([-way[1], way[0]])
        for sign in (-1, 1):
            self.line(tip, tip - 0.25 * way + 0.15 * sign * side, radius, color)

    def arrows(self, orig: Any, direction: Any, radius: float = 1, color: int = 0xFFFFFF) -> None:
        """Many arrows."""
        for start, way in zip(_array(orig), _array(direction), strict=True):
            self.arrow(start, way, radius, color)

    def text(self, content: str, pos: Any, font_size: int = 15, color: int = 0xFFFFFF) -> None:
        """A line of text; the position is its upper left corner."""
        from PIL import ImageFont

        ((x, y),) = self._points(pos)
        font = ImageFont.load_default(size=font_size * _SCALE)
        self._draw.text((x, y), content, fill=_bytes(color), font=font)

    # Frames

    def picture(self) -> Any:
        """The canvas as a Pillow image of `res` pixels."""
        from PIL import Image

        return self._image.resize(self.res, Image.Resampling.BOX)

    def get_image(self) -> np.ndarray:
        """The canvas as an array of shape res + (4,) from 0 to 1, first index to the right."""
        pixels = np.asarray(self.picture(), np.float32)[::-1].swapaxes(0, 1) / 255
        return np.concatenate([pixels, np.ones((*self.res, 1), np.float32)], axis=2)

    def show(self, file: str | None = None) -> None:
        """Ends a frame: writes the picture if there is a place for it, and clears the canvas."""
        if file is None and not self.screen and not GUI._is_told:
            GUI._is_told = True
            where = (
                f"frames go to the folder {self.frames_dir}"
                if self.frames_dir
                else "frames_dir=… or TAI_GUI_DIR names a folder for frames"
            )
            print(f"ti.GUI opens no window: {where}, and `python -m tai.view` shows them",
                  file=sys.stderr)  # fmt: skip
        if file is None and self.frames_dir:
            os.makedirs(self.frames_dir, exist_ok=True)
            file = os.path.join(self.frames_dir, f"{self.frame:06d}.png")
        if file is not None:
            folder = os.path.dirname(str(file))
            if folder:
                os.makedirs(folder, exist_ok=True)
            save_picture(self.picture(), file)
        if self.screen:
            self.screen.show(self.picture())
        self.frame += 1
        is_open = self.screen.is_open if self.screen else None
        if self.frame >= self.max_frames if is_open is None else not is_open:
            self.running = False
        self.clear()

    def close(self) -> None:
        """Ends the program's loop over frames."""
        self.running = False

    # Keys and mice: of the window of `tai.view`. Elsewhere there is no keyboard.

    def get_events(self, *filters: Any) -> Iterator[Event]:
        """Events since the last call that match a filter; others are discarded.

        Args:
            filters: a type or key of events, a pair of both, or a list of these; all events, if
                there are none.
        """
        for event in self.screen.events() if self.screen else ():
            if not filters or any(_fits(event, one) for one in filters):
                yield event

    def get_event(self, *filters: Any) -> bool:
        """Whether a matching event is pending; it becomes `event`, and later ones stay pending."""
        found = next(self.get_events(*filters), None)
        self.event = self.event if found is None else found
        return found is not None

    def get_key_event(self) -> Event | None:
        """The next press or release; None if none is pending."""
        return next(self.get_events(self.PRESS, self.RELEASE), None)

    def has_key_event(self) -> bool:
        """Whether an event is pending."""
        return bool(self.screen and self.screen.has_events())

    def is_pressed(self, *keys: Any) -> bool:
        """Whether one of the keys and buttons is held."""
        held = self.screen.held if self.screen else ()
        return any(key in held for key in keys)

    def get_cursor_pos(self) -> tuple[float, float]:
        """The position of the mouse; the centre without a window."""
        return self.screen.cursor if self.screen else (0.5, 0.5)

    def __enter__(self) -> GUI:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()
