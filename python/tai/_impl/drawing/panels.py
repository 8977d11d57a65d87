"""Widgets in panels: text, buttons, check boxes, sliders.

A program calls each widget once per frame and gets its value back; the panel keeps only the place
of the mouse, and the widget that is held. Without a window no widget is ever touched, so that all
give the values that they were given. The same list of boxes and texts is drawn over the picture of
a window and of a file.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_ROW, _PAD, _FONT, _TITLE = 20, 5, 12, 13
_BACK, _FRAME, _FILL = (24, 28, 36, 205), (70, 80, 98, 255), (62, 124, 177, 255)
_HOT, _TEXT = (92, 104, 126, 255), (238, 238, 238, 255)
Color = tuple[int, int, int, int]
Place = tuple[float, float]
Box = tuple[float, float, float, float]


class Panels:
    """The panels of widgets in one window.

    Attributes:
        size: of the window in pixels.
        shown: boxes and texts of the last whole frame.
    """

    def __init__(self, size: tuple[int, int]):
        self.size = size
        self.shown: list[tuple] = []
        self._drawn: list[tuple] = []
        # The rectangles in which panels take the mouse, of the last complete frame and of the
        # present frame.
        self._areas: list[Box] = []
        self._next_areas: list[Box] = []
        self._left = self._top = self._width = self._row = 0.0
        self._height: float | None = None
        self._first = 0
        self._at = (-1.0, -1.0)
        # The point at which the mouse button was pressed that is down, and both ends of clicks
        # since the last frame.
        self._grip: Place | None = None
        self._clicks: list[tuple[Place, Place]] = []

    # The state of the mouse for panels; positions are from 0 to 1, the second coordinate upward.

    def move(self, place: Place) -> None:
        """Notes the new position of the mouse."""
        self._at = (place[0] * self.size[0], (1 - place[1]) * self.size[1])

    def press(self) -> bool:
        """Handles a press of the left mouse button; returns false if no panel is at that
        position.
        """
        if not any(_is_in(self._at, area) for area in self._areas):
            return False
        self._grip = self._at
        return True

    def release(self) -> bool:
        """Handles the release of the left mouse button; returns false if the button was pressed
        outside of all panels.
        """
        if self._grip is None:
            return False
        self._clicks.append((self._grip, self._at))
        self._grip = None
        return True

    # Frames

    def begin(self, name: str, x: float, y: float, width: float, height: float | None) -> None:
        """Opens a panel, to which the following widgets belong.

        Args:
            x, y: its upper left corner in pixels from that of the window.
            width, height: in pixels; it is as high as its rows at least.
        """
        self._left, self._top, self._width, self._height = x, y, width, height
        self._first, self._row = len(self._drawn), y + _PAD
        if name:
            self._write(x + _PAD, name, _TITLE)
            self._row += _ROW

    def end(self) -> None:
        """Ends the panel that is being filled with widgets, and draws its background below the
        widgets.
        """
        bottom = max(self._row + _PAD, self._top + (self._height or 0))
        area = (self._left, self._top, self._left + self._width, bottom)
        self._next_areas.append(area)
        self._drawn.insert(self._first, ("box", *area, _BACK))

    def finish(self) -> None:
        """Ends a frame, whose widgets have handled all clicks."""
        self.shown, self._drawn = self._drawn, []
        self._areas, self._next_areas = self._next_areas, []
        self._clicks.clear()

    # Widgets

    def text(self, content: str, color: Color = _TEXT) -> None:
        """Lines of text."""
        for line in content.splitlines() or [""]:
            self._write(self._left + _PAD, line, _FONT, color)
            self._row += _ROW

    def button(self, label: str) -> bool:
        """Whether the widget was clicked since the last frame."""
        box = self._row_box()
        self._box(box, _HOT if self._is_held(box) else _FRAME)
        self._write(box[0] + _PAD, label, _FONT)
        self._row += _ROW
        return self._count(box) > 0

    def checkbox(self, label: str, old: bool) -> bool:
        """Returns the new state of a check box, which a click changes."""
        box = self._row_box()
        new = bool(old) != bool(self._count(box) % 2)
        left, top, _, bottom = box
        self._box((left, top, left + bottom - top, bottom), _FRAME)
        if new:
            self._box((left + 4, top + 4, left + bottom - top - 4, bottom - 4), _FILL)
        self._write(left + bottom - top + _PAD, label, _FONT)
        self._row += _ROW
        return new

    def slider(self, label: str, old: float, low: float, high: float, shown: str = ".3f") -> float:
        """The number that the mouse has chosen on a slider, or the old number; it is between low
        and high.
        """
        box = self._row_box()
        value = min(max(old, low), high)
        ends = [end for begin, end in self._clicks if _is_in(begin, box)]
        if self._is_held(box):
            ends.append(self._at)
        if ends:
            share = (ends[-1][0] - box[0]) / (box[2] - box[0])
            value = low + min(max(share, 0.0), 1.0) * (high - low)
        self._box(box, _FRAME)
        share = (value - low) / (high - low) if high > low else 0.0
        self._box((box[0], box[1], box[0] + share * (box[2] - box[0]), box[3]), _FILL)
        self._write(box[0] + _PAD, f"{label}  {value:{shown}}", _FONT)
        self._row += _ROW
        return value

    def color(self, label: str, old: Any) -> tuple[float, float, float]:
        """A colour that the user chooses by sliders for red, green and blue, from 0 to 1."""
        names = (f"{label} {channel}" for channel in ("red", "green", "blue"))
        red, green, blue = (
            self.slider(name, float(value), 0, 1) for name, value in zip(names, old, strict=True)
        )
        fill = (round(255 * red), round(255 * green), round(255 * blue), 255)
        self._box((*self._row_box()[:3], self._row + 6), fill)
        self._row += 10
        return red, green, blue

    def _row_box(self) -> Box:
        right = self._left + self._width - _PAD
        return (self._left + _PAD, self._row, right, self._row + _ROW - 4)

    def _count(self, box: Box) -> int:
        """Returns the number of clicks on a widget since the last frame."""
        return sum(_is_in(begin, box) and _is_in(end, box) for begin, end in self._clicks)

    def _is_held(self, box: Box) -> bool:
        return self._grip is not None and _is_in(self._grip, box)

    def _box(self, box: tuple, color: Color) -> None:
        self._drawn.append(("box", *box, color))

    def _write(self, x: float, content: str, size: int, color: Color = _TEXT) -> None:
        self._drawn.append(("text", x, self._row + 1, content, size, color))


def _is_in(place: Place, box: Box) -> bool:
    return box[0] <= place[0] <= box[2] and box[1] <= place[1] <= box[3]


def layer(size: tuple[int, int], items: list[tuple]) -> Any:
    """The boxes and texts of panels as bytes (height, width, 4), rows downward."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGBA", size)
    draw = ImageDraw.Draw(image)
    for kind, x, y, *rest in items:
        if kind == "box":
            right, bottom, fill = rest
            if right > x and bottom > y:
                draw.rectangle((x, y, right - 1, bottom - 1), fill=fill)
        else:
            content, font_size, fill = rest
            draw.text((x, y), content, fill=fill, font=ImageFont.load_default(size=font_size))
    return np.asarray(image)


def paint(picture: Any, items: list[tuple]) -> Any:
    """A copy of a Pillow image, RGB, with the boxes and texts of panels over it."""
    if not items:
        return picture
    from PIL import Image

    over = Image.fromarray(layer(picture.size, items))
    return Image.alpha_composite(picture.convert("RGBA"), over).convert("RGB")
