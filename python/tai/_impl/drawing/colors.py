"""Colours as bytes and by a map."""

from __future__ import annotations

import numpy as np

# Nine colours of the map "viridis", dark to bright, from which others are interpolated.
_VIRIDIS = (
    0x440154,
    0x482878,
    0x3E4A89,
    0x31688E,
    0x26828E,
    0x1F9E89,
    0x35B779,
    0x6DCD59,
    0xFDE725,
)


def rgb_bytes(colors: np.ndarray) -> np.ndarray:
    """Turns colours 0xRRGGBB into bytes, along one more axis."""
    colors = np.asarray(colors).astype(np.int64)
    return np.stack([colors >> 16 & 255, colors >> 8 & 255, colors & 255], -1).astype(np.uint8)


def color_map(values: np.ndarray) -> np.ndarray:
    """Converts numbers from 0 to 1 to colours, which are three numbers from 0 to 1 each."""
    table = rgb_bytes(np.array(_VIRIDIS)) / 255
    values = np.nan_to_num(values).clip(0, 1)
    places = np.linspace(0, 1, len(table))
    return np.stack([np.interp(values, places, table[:, k]) for k in range(3)], -1)
