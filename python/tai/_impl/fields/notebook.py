"""Fields as notebooks show them: statistics, and a picture of those with two dimensions."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

import numpy as np

# The longer side of a picture in pixels, and the most numbers that are looked at.
_SIDE, _MOST = 256, 1 << 24


def field_html(field: Any) -> str:
    """A line about the field, one about its numbers, and a picture where it has two dimensions."""
    head = html.escape(repr(field))
    if field.level is None:
        return f"<code>{head}</code>"
    if int(np.prod(field.shape + field.element_shape, dtype=np.int64)) > _MOST:
        return f"<code>{head}</code><br>too large to summarise; see to_numpy()"
    array = field.to_numpy()
    return f"<code>{head}</code><br>{statistics(array)}{_picture(array, field)}"


def statistics(array: np.ndarray) -> str:
    """Least, greatest and mean number, and how many are not finite."""
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
    if len(field.shape) != 2 or (field.element_shape and not is_colour):
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
