"""Numbers of fields, arrays and tensors as NumPy arrays."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np

from ...errors import TaiRuntimeTypeError


def numbers(values: Any, dtype: Any = np.float32) -> np.ndarray:
    """The values of a field, an array or a tensor on any device, as one NumPy array."""
    if hasattr(values, "detach"):
        values = values.detach().cpu()
    elif hasattr(values, "to_numpy"):
        values = values.to_numpy()
    try:
        return np.ascontiguousarray(values, dtype)
    except (TypeError, ValueError):
        raise TaiRuntimeTypeError(
            f"{type(values).__name__} holds no numbers to draw",
            "pass a field, an array, a NumPy array or a tensor",
        ) from None


def canvas_size(res: Any, what: str) -> tuple[int, int]:
    """Returns the width and the height that an argument `res` means: a number is both.

    Args:
        res: one or two whole numbers.
        what: names the canvas in the error.

    Raises:
        TaiRuntimeTypeError: they are no whole numbers from 1 on.
    """
    try:
        sizes = [operator.index(n) for n in np.atleast_1d(res).tolist()]
    except TypeError:
        sizes = []
    if len(sizes) not in (1, 2) or min(sizes) < 1:
        raise TaiRuntimeTypeError(
            f"{what} has a width and a height in pixels, but got res={res!r}",
            "write res=512 or res=(640, 480)",
        )
    return sizes[0], sizes[-1]


def vectors(values: Any, sizes: tuple[int, ...], what: str) -> np.ndarray:
    """Returns vectors as the rows of an array of shape (count, n).

    Args:
        values: as many axes of vectors as they have; the last one is that of components.
        sizes: the numbers of components that will do.
        what: names the vectors in the error.
    """
    array = numbers(values)
    if array.ndim == 0 or array.shape[-1] not in sizes:
        wanted = " or ".join(map(str, sizes))
        raise TaiRuntimeTypeError(
            f"{what} have {wanted} components, but the shape is {array.shape}",
            f"pass a field of vectors of {wanted}, or an array of shape (count, {sizes[0]})",
        )
    return array.reshape(-1, array.shape[-1])


def pixels_of(image: Any) -> np.ndarray:
    """A picture, numbers from 0 to 1 or bytes, as bytes (width, height, 3).

    Args:
        image: (width, height), (width, height, 3) or (width, height, 4).
    """
    if hasattr(image, "detach"):
        image = image.detach().cpu()
    pixels = np.asarray(image.to_numpy() if hasattr(image, "to_numpy") else image)
    if pixels.dtype != np.uint8:
        pixels = (np.clip(np.nan_to_num(pixels.astype(float)), 0, 1) * 255).astype(np.uint8)
    if pixels.ndim == 2 or pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = np.repeat(pixels.reshape(*pixels.shape[:2], 1), 3, axis=2)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise TaiRuntimeTypeError(
            f"an image has one, three or four numbers for a pixel, but its shape is {pixels.shape}",
            "its first index runs to the right, and its second one upward",
        )
    return pixels[..., :3]
