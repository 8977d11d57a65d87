"""`ti.GUI`: draws images, in a window where a display is.

Coordinates run from 0 to 1, the second one upward. `show("frame.png")` writes an image.
`show()` shows a frame in the window, and writes it into the folder given by the option `frames_dir`
or the environment variable TAI_GUI_DIR. Without a window and a folder it only counts frames, and
says so once. Without a window, `running` becomes false after `max_frames` frames (or
TAI_GUI_FRAMES; 1000 by default).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from ._impl.base.keywords import check_keywords
from ._impl.drawing.arrays import canvas_size, numbers, pixels_of
from ._impl.drawing.colors import color_map, rgb_bytes
from ._impl.drawing.events import Event
from ._impl.drawing.frames import FrameLoop
from .errors import TaiRuntimeError, TaiRuntimeTypeError

__all__ = ["GUI", "Event", "Widget", "hex_to_rgb", "rgb_to_hex"]

# Shapes are drawn at this multiple of the size and then reduced, so that their edges are smooth.
_SCALE = 2
# The panel of widgets: its place and width, in pixels.
_PANEL = (8, 8, 170)


def hex_to_rgb(color: Any) -> tuple[Any, Any, Any]:
    """Returns a colour 0xRRGGBB as three numbers from 0 to 1."""
    return ((color >> 16 & 255) / 255, (color >> 8 & 255) / 255, (color & 255) / 255)


def rgb_to_hex(rgb: Any) -> Any:
    """Returns three numbers (or arrays) from 0 to 1 as a colour 0xRRGGBB."""

    def channel(x: Any) -> Any:
        return np.clip(np.asarray(x) * 255, 0, 255).astype(np.int64)

    value = (channel(rgb[0]) << 16) | (channel(rgb[1]) << 8) | channel(rgb[2])
    return int(value) if np.ndim(value) == 0 else value


def _bytes(color: Any) -> tuple[int, int, int]:
    try:
        color = int(color)
    except (TypeError, ValueError):
        raise TaiRuntimeTypeError(
            f"a colour is one number, but got {color!r}",
            "write it as 0xRRGGBB, or ti.rgb_to_hex((1.0, 0.5, 0.0))",
        ) from None
    return (color >> 16 & 255, color >> 8 & 255, color & 255)


def _array(values: Any) -> np.ndarray:
    return numbers(values, float)


def _places(shape: tuple[int, ...], bound: float) -> np.ndarray:
    """The positions on the canvas of the elements of a field that fills the canvas, as an array (n
    * m, 2).
    """
    axes = [np.linspace(bound / n, 1 - bound / n, n) if n > 1 else np.array([0.5]) for n in shape]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)


def _each(values: np.ndarray, count: int, what: str) -> np.ndarray:
    """Repeats a value so that there is one value for each shape."""
    values = values.ravel()
    if values.size not in (1, count):
        raise TaiRuntimeTypeError(
            f"there are {values.size} {what} for {count} shapes", f"give one, or {count}"
        )
    return np.broadcast_to(values, count)


def _check_counts(*points: np.ndarray) -> None:
    """Raises an error if some points of a shape are more than the others.

    Raises:
        TaiRuntimeTypeError: the numbers of points differ.
    """
    counts = [len(p) for p in points]
    if len(set(counts)) > 1:
        raise TaiRuntimeTypeError(
            f"the points of the shapes are {' and '.join(map(str, counts))}",
            "give as many of one kind as of the other, one for each shape",
        )


def _are_finite(*points: Any) -> np.ndarray:
    """Whether all coordinates of a shape are finite numbers."""
    return np.all([np.isfinite(_array(p).reshape(-1, 2)).all(1) for p in points], axis=0)


def _tuples(colors: np.ndarray) -> list:
    return list(map(tuple, colors.tolist()))


class Widget:
    """A slider, or a label with a number.

    Attributes:
        value: its number; a program may set it.
    """

    def __init__(self, text: str, value: float, minimum: float, maximum: float, step: float):
        self.text, self.minimum, self.maximum, self.step = text, minimum, maximum, step
        self.value = value

    @property
    def value(self) -> Any:
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        try:
            is_wrong = isinstance(value, str) or not (math.isfinite(value) or not self.step)
        except (TypeError, ValueError):
            is_wrong = True
        if is_wrong:
            kind = "slider" if self.step else "label"
            raise TaiRuntimeTypeError(
                f"the value of {kind} '{self.text}' is a number, but got {value!r}",
                "a slider takes finite numbers; gui.text(…) draws words",
            )
        self._value = value


class GUI(FrameLoop):
    """A canvas of `res` pixels, in a window where a display is.

    Args:
        name: title of the window; not drawn.
        res: width and height, or one number for both.
        background_color: 0xRRGGBB.
        show_gui: false to draw into pictures alone.
        fullscreen: fills the screen.
        fast_gui: has no effect.
        frames_dir: folder for the frames of `show()`.
        max_frames: frames after which `running` is false, where no window is.

    Attributes:
        frame: number of frames that were shown.
        event: the last one that `get_event` found.
        fps_limit: frames in a second of a window, at most; None or 0 for no limit.
    """

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
        self.res = canvas_size(res, "a GUI")
        self.background_color = background_color
        super().__init__(self.res, frames_dir, max_frames)
        self._widgets: list[tuple[str, Any]] = []
        if show_gui:
            self._open(name, self.res, fullscreen)
        self.clear()

    def __repr__(self) -> str:
        return f"<ti.GUI '{self.name}' of {self.res[0]}×{self.res[1]} pixels, frame {self.frame}>"

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

        pixels = pixels_of(image)
        if pixels.shape[:2] != self.res:
            raise TaiRuntimeTypeError(
                f"the image has shape {pixels.shape[:2]}, but the GUI {self.res}",
                "make the GUI with res= the shape of the image",
            )
        upright = np.ascontiguousarray(pixels.swapaxes(0, 1)[::-1])
        size = (self.res[0] * _SCALE, self.res[1] * _SCALE)
        self._image = Image.fromarray(upright).resize(size, Image.Resampling.NEAREST)
        self._draw = ImageDraw.Draw(self._image)

    def _points(self, positions: Any, dimensions: int = 2) -> np.ndarray:
        """Returns positions in pixels of the enlarged canvas."""
        array = np.atleast_2d(_array(positions))
        if array.shape[-1] != dimensions:
            raise TaiRuntimeTypeError(f"a position has {dimensions} coordinates: {array.shape}")
        array = array.reshape(-1, dimensions)
        array = np.nan_to_num(array, nan=-9.0, posinf=9.0, neginf=-9.0).clip(-9.0, 9.0)
        size = np.array(self.res) * _SCALE
        return np.stack([array[:, 0] * size[0], (1 - array[:, 1]) * size[1]], axis=1)

    # Shapes

    def circle(self, pos: Any, color: int = 0xFFFFFF, radius: float = 1) -> None:
        """Draws a disc; the radius is in pixels."""
        self.circles([pos], radius, color)

    def circles(
        self, pos: Any, radius: Any = 1, color: Any = 0xFFFFFF, palette: Any = None,
        palette_indices: Any = None,
    ) -> None:  # fmt: skip
        """Draws many discs; radius and colour may be arrays."""
        points = self._points(pos)
        colors = self._colors(color, len(points), palette, palette_indices)
        radii = _each(_array(radius), len(points), "radii") * _SCALE
        if (radii < 0).any():
            raise TaiRuntimeTypeError(
                f"a radius is {radii.min() / _SCALE:g}", "radii are pixels, from 0 on"
            )
        kept = np.isfinite(radii)
        some = points[kept].tolist(), radii[kept].tolist(), _tuples(colors[kept])
        for (x, y), r, fill in zip(*some, strict=True):
            self._draw.ellipse((x - r, y - r, x + r, y + r), fill=fill)

    def _colors(self, color: Any, count: int, palette: Any, indices: Any) -> np.ndarray:
        """Returns the colours of shapes as bytes, (count, 3)."""
        if palette is not None:
            colors, chosen = np.asarray(palette), _array(indices).astype(int).ravel()
            if chosen.size and not 0 <= chosen.min() <= chosen.max() < len(colors):
                raise TaiRuntimeTypeError(
                    f"palette_indices are from {chosen.min()} to {chosen.max()}, but the palette "
                    f"has {len(colors)} colours",
                    "indices count from 0",
                )
            color = colors[chosen]
        return rgb_bytes(_each(numbers(color, np.int64), count, "colours"))

    def line(self, begin: Any, end: Any, radius: float = 1, color: int = 0xFFFFFF) -> None:
        """Draws a line; the radius, half of its width, is in pixels."""
        self.lines([begin], [end], radius, color)

    def lines(self, begin: Any, end: Any, radius: Any = 1, color: Any = 0xFFFFFF) -> None:
        """Many lines."""
        starts, ends = self._points(begin), self._points(end)
        _check_counts(starts, ends)
        colors = self._colors(color, len(starts), None, None)
        widths = _each(_array(radius), len(starts), "radii") * _SCALE
        kept = _are_finite(begin, end)
        some = starts[kept], ends[kept], widths[kept], _tuples(colors[kept])
        for a, b, w, fill in zip(*some, strict=True):
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
        _check_counts(*corners)
        colors = self._colors(color, len(corners[0]), None, None)
        kept = _are_finite(a, b, c)
        some = [corner[kept] for corner in corners]
        for p, q, r, fill in zip(*some, _tuples(colors[kept]), strict=True):
            self._draw.polygon([tuple(p), tuple(q), tuple(r)], fill=fill)

    def rect(
        self, topleft: Any, bottomright: Any, radius: float = 1, color: int = 0xFFFFFF
    ) -> None:
        """Draws the outline of a rectangle."""
        (x0, y0), (x1, y1) = _array(topleft), _array(bottomright)
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        self.lines(corners, [*corners[1:], corners[0]], radius, color)

    def arrow(self, orig: Any, direction: Any, radius: float = 1, color: int = 0xFFFFFF) -> None:
        """Draws a line with a head at its end."""
        start, way = _array(orig), _array(direction)
        tip = start + way
        self.line(start, tip, radius, color)
        side = np.array([-way[1], way[0]])
        for sign in (-1, 1):
            self.line(tip, tip - 0.25 * way + 0.15 * sign * side, radius, color)

    def arrows(self, orig: Any, direction: Any, radius: float = 1, color: Any = 0xFFFFFF) -> None:
        """Draws many arrows; arrows without a length are left out."""
        starts, ways = (_array(values).reshape(-1, 2) for values in (orig, direction))
        _check_counts(starts, ways)
        tips, sides = starts + ways, np.stack([-ways[:, 1], ways[:, 0]], 1)
        colors = _each(numbers(color, np.int64), len(starts), "colours")
        kept = np.isfinite(ways).all(1) & (ways != 0).any(1)
        starts, ways, tips, sides, colors = (a[kept] for a in (starts, ways, tips, sides, colors))
        self.lines(starts, tips, radius, colors)
        for sign in (-1, 1):
            self.lines(tips, tips - 0.25 * ways + 0.15 * sign * sides, radius, colors)

    def arrow_field(
        self, direction: Any, radius: float = 1, color: int = 0xFFFFFF, bound: float = 0.5
    ) -> None:
        """An arrow at each element of a field of vectors, which fills the canvas.

        Args:
            direction: (n, m, 2), in units of the canvas.
            bound: place of the first element, in distances of two elements, from the border.
        """
        ways = self._grid(direction, 2)
        self.arrows(_places(ways.shape[:2], bound), ways, radius, color)

    def point_field(self, radius: Any, color: Any = 0xFFFFFF, bound: float = 0.5) -> None:
        """A disc at each element of a field of radii in pixels, (n, m), which fills the canvas."""
        radii = self._grid(radius)
        self.circles(_places(radii.shape, bound), radii.ravel(), color)

    def vector_field(self, field: Any, arrow_spacing: int = 5, color: int = 0xFFFFFF) -> None:
        """Arrows for a field of vectors (n, m, 2), the longest one as long as their distance.

        Args:
            arrow_spacing: elements from one arrow to the next.
        """
        ways = self._grid(field, 2)
        step = max(int(arrow_spacing), 1)
        places = _places(ways.shape[:2], 0.5).reshape(ways.shape)
        start = min(step // 2, *(extent - 1 for extent in ways.shape[:2]))
        ways, places = ways[start::step, start::step], places[start::step, start::step]
        longest = np.linalg.norm(np.nan_to_num(ways, posinf=0, neginf=0), axis=-1).max()
        if longest > 0:
            scale = step / np.array(self._grid(field, 2).shape[:2]).max() / longest
            self.arrows(places - 0.5 * scale * ways, scale * ways, 1, color)

    def contour(self, field: Any, normalize: bool = False) -> None:
        """Colours for a field of numbers (n, m), interpolated over the canvas.

        Args:
            normalize: the smallest finite number gets the first colour and the largest one the
                last; otherwise 0 and 1 do. NaN has the first colour.
        """
        from PIL import Image

        values = self._grid(field)
        if normalize:
            finite = values[np.isfinite(values)]
            low, high = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
            values = (values - low) / (high - low) if high > low else np.zeros_like(values)
        values = np.nan_to_num(values).clip(-1e30, 1e30)
        fine = Image.fromarray(values.T.astype(np.float32)).resize(
            self.res, Image.Resampling.BILINEAR
        )
        self.set_image(color_map(np.asarray(fine).T))

    def _grid(self, values: Any, *components: int) -> np.ndarray:
        array = _array(values)
        if array.ndim != 2 + len(components) or array.shape[2:] != components or not array.size:
            wanted = ", ".join(["n", "m", *map(str, components)])
            raise TaiRuntimeTypeError(
                f"the field has the shape ({wanted}), but got {array.shape}",
                "take a slice, as field.to_numpy()[0]",
            )
        return array

    def text(self, content: Any, pos: Any, font_size: int = 15, color: int = 0xFFFFFF) -> None:
        """Draws a line of text; the position is its upper left corner."""
        from PIL import ImageFont

        ((x, y),) = self._points(pos)
        font = ImageFont.load_default(size=font_size * _SCALE)
        self._draw.text((x, y), str(content), fill=_bytes(color), font=font)

    # Frames

    def picture(self) -> Any:
        """Returns the canvas as a Pillow image of `res` pixels."""
        from PIL import Image

        return self._image.resize(self.res, Image.Resampling.BOX)

    def get_image(self) -> np.ndarray:
        """The canvas as an array of shape res + (4,) from 0 to 1, first index to the right."""
        pixels = np.asarray(self.picture(), np.float32)[::-1].swapaxes(0, 1) / 255
        return np.concatenate([pixels, np.ones((*self.res, 1), np.float32)], axis=2)

    def show(self, file: str | None = None) -> None:
        """Ends a frame: shows it in the window, writes it to a file if there is a place for it, and
        clears the canvas."""
        self._lay_out()
        picture = cache(lambda: self._with_panels(self.picture()))
        self._show(picture, file, "ti.GUI")
        if self._screen:
            self._screen.show(picture())
            self._keep_pace()
        self.clear()

    # Widgets, which are in a panel in the upper left corner of the window.

    def slider(self, text: str, minimum: float, maximum: float, step: float = 1) -> Widget:
        """A slider, whose `value` the mouse changes by multiples of `step`; at first `minimum`."""
        if not minimum < maximum or not step > 0:
            raise TaiRuntimeError(
                f"a slider from {minimum} to {maximum} by {step} has no room",
                "the minimum is below the maximum, and the step is above 0",
            )
        widget = Widget(text, minimum, minimum, maximum, step)
        self._widgets.append(("slider", widget))
        return widget

    def label(self, text: str) -> Widget:
        """Adds a text with a number, the label's `value`, to the panel."""
        widget = Widget(text, 0, 0, 0, 0)
        self._widgets.append(("label", widget))
        return widget

    def button(self, text: str, event_name: str | None = None) -> str:
        """A button; returns the key of the event, of type `GUI.PRESS`, that a click makes."""
        name = event_name or f"WidgetButton_{text}"
        self._widgets.append(("button", (text, name)))
        return name

    def _lay_out(self) -> None:
        panels = self._panels
        if self._widgets:
            panels.begin("", *_PANEL, None)
            for kind, widget in self._widgets:
                if kind == "button":
                    text, name = widget
                    if panels.button(text):
                        self._screen.add(Event(self.PRESS, name, self.get_cursor_pos()))
                elif kind == "label":
                    panels.text(f"{widget.text}  {widget.value:.6g}")
                else:
                    low, high, step = widget.minimum, widget.maximum, widget.step
                    value = panels.slider(widget.text, widget.value, low, high, ".6g")
                    if value != widget.value:
                        value = low + round((value - low) / step) * step
                        widget.value = min(value, high)
            panels.end()
        panels.finish()


check_keywords(globals())
