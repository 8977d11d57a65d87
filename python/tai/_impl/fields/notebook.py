"""Fields, arrays, kernels and tapes as notebooks show them."""

from __future__ import annotations

import base64
import html
import inspect
import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

# The longer side of a picture in pixels, and the most numbers that are looked at.
_SIDE, _MOST = 256, 1 << 24
# The most letters of IR that a notebook shows.
_LETTERS = 100_000


def field_html(field: Any) -> str:
    """HTML of a field for notebooks: a line about the field, a line about its numbers, and a
    picture if it has two dimensions.
    """
    if field.level is None:
        return f"<code>{html.escape(repr(field))}</code>"
    return _summary(field, field.to_numpy)


def array_html(array: Any) -> str:
    """HTML of a `ti.ndarray` for notebooks, as that of a field.

    A tape that records does not note the array as read: a picture is no part of the program.
    """
    return _summary(array, lambda: array.array)


def _summary(value: Any, contents: Callable[[], np.ndarray]) -> str:
    head = html.escape(repr(value))
    if int(np.prod(value.shape + value.element_shape, dtype=np.int64)) > _MOST:
        return f"<code>{head}</code><br>too large to summarise; see to_numpy()"
    array = contents()
    return f"<code>{head}</code><br>{statistics(array)}{_picture(array, value)}"


def statistics(array: np.ndarray) -> str:
    """Describes an array by its least, greatest and mean number, and how many are not finite."""
    if not array.size:
        return "no elements"
    if array.dtype.kind != "f":
        return f"min {array.min()}, max {array.max()}, mean {array.mean():.6g}"
    good = array[np.isfinite(array)].astype(np.float64)
    bad = array.size - good.size
    if not good.size:
        return f"none of {array.size} numbers is finite"
    text = f"min {good.min():.6g}, max {good.max():.6g}, mean {good.mean():.6g}"
    return text if not bad else f"{text}; {bad} of {array.size} not finite"


def _picture(array: np.ndarray, field: Any) -> str:
    is_colour = field.element_shape in ((3,), (4,))
    if len(field.shape) != 2 or not array.size or (field.element_shape and not is_colour):
        return ""
    try:
        from PIL import Image
    except ImportError:
        return ""
    step = max(1, -(-max(field.shape) // _SIDE))
    pixels = np.nan_to_num(array[::step, ::step, ...].astype(np.float64))
    if not is_colour:
        low, high = pixels.min(), pixels.max()
        pixels = (pixels - low) / (high - low) if high > low else np.zeros_like(pixels)
    upright = (np.clip(pixels, 0, 1) * 255).astype(np.uint8).swapaxes(0, 1)[::-1]
    scale = max(1, _SIDE // 2 // max(upright.shape[:2]))
    image = Image.fromarray(np.ascontiguousarray(upright))
    image = image.resize((image.width * scale, image.height * scale), Image.Resampling.NEAREST)
    stream = io.BytesIO()
    image.save(stream, "PNG")
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<br><img src="data:image/png;base64,{data}">'


def kernel_html(kernel: Any, function: Any, last: Any, count: int) -> str:
    """HTML of a kernel for notebooks: a click shows the source of the kernel, another click its IR.

    Args:
        kernel: the text of the kernel for the first line.
        function: the Python function of the kernel.
        last: the specialisation that was used last, or None.
        count: the number of specialisations.
    """
    state = "not compiled yet: its first call compiles it"
    if last is not None:
        kinds = "one kind" if count == 1 else f"{count} kinds"
        state = f"compiled for {kinds} of arguments"
    parts = [f"<code>{html.escape(repr(kernel))}</code><br>{state}"]
    try:
        parts.append(_folded("source", inspect.getsource(function)))
    except (OSError, TypeError):  # typed into a plain prompt
        pass
    if last is not None:
        parts.append(_folded("IR", last.core.ir("tai")))
    return "".join(parts)


def _folded(title: str, text: str) -> str:
    if len(text) > _LETTERS:
        text = f"{text[:_LETTERS]}\n… and {len(text) - _LETTERS:,} letters more"
    return f"<details><summary>{title}</summary><pre>{html.escape(text)}</pre></details>"


def table_html(title: str, rows: Mapping[str, Any]) -> str:
    """Makes a line of HTML, and a table of names and numbers."""
    cells = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(f'{value:,}')}</td></tr>"
        for name, value in rows.items()
    )
    return f"<code>{html.escape(title)}</code><table>{cells}</table>"
