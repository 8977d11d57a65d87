"""Pictures to aim at: the yin-yang sign, the sign of peace, or a file of the user's."""

from pathlib import Path

import numpy as np

import studio


def _plane(n: int):
    """Coordinates of the pixels' centres, from -1/2 to 1/2: to the right and downward."""
    row, col = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    return (col + 0.5) / n - 0.5, (row + 0.5) / n - 0.5


def yin_yang(n: int):
    """White 1 and black 0, drawn by its circles."""
    x, y = _plane(n)
    upper, lower = x**2 + (y + 0.235) ** 2, x**2 + (y - 0.235) ** 2
    radius = x**2 + y**2
    rules = [
        (radius > 0.5**2, 1),
        (radius >= 0.47**2, 0),
        (upper < 0.07**2, 0),
        (lower < 0.07**2, 1),
        (upper < 0.235**2, 1),
        (lower < 0.235**2, 0),
        (x > 0, 0),
    ]
    return np.select([rule for rule, _ in rules], [value for _, value in rules], 1).astype(float)


def peace(n: int):
    """A ring, an upright bar and two slanted ones."""
    x, y = _plane(n)
    radius, width = np.hypot(x, y), 0.0415
    ring = abs(radius - 0.41) < width
    bar = abs(x) < width
    slanted = (abs(abs(x) - y) < width * 2**0.5) & (y > 0)
    return (ring | (bar | slanted) & (radius < 0.41)).astype(float)


def from_file(path: Path, n: int, centred: bool = False):
    """A picture of the user's in grey from 0 to 1, n × n; `centred` takes its mean away."""
    image = studio.need("PIL.Image", "a picture as target", "pillow")
    try:
        with image.open(path) as picture:
            grey = picture.convert("L")
    except OSError as error:
        studio.fail(f"--target {path}: not a picture that can be read ({error})")
    mean = np.asarray(grey).mean() / 255 if centred else 0.0
    return np.asarray(grey.resize((n, n), image.Resampling.BILINEAR)) / 255 - mean
