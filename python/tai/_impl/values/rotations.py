"""Matrices of rotations, translations and scalings, as Taichi defines them: those of 4 x 4, except
for `translate`, are for row vectors, v @ M.
"""

from __future__ import annotations

from typing import Any

from .matrix import Matrix
from .ops import cos, sin


def rotation2d(angle: Any) -> Any:
    """Returns the 2×2 matrix that turns by an angle, counter-clockwise."""
    c, s = cos(angle), sin(angle)
    return Matrix([[c, -s], [s, c]])


def translate(dx: Any, dy: Any, dz: Any) -> Any:
    """Returns the 4×4 matrix that moves column vectors."""
    return Matrix(
        [[1.0, 0.0, 0.0, dx], [0.0, 1.0, 0.0, dy], [0.0, 0.0, 1.0, dz], [0.0, 0.0, 0.0, 1.0]]
    )


def scale(sx: Any, sy: Any, sz: Any) -> Any:
    """Returns the 4×4 matrix that scales along the axes."""
    return Matrix(
        [[sx, 0.0, 0.0, 0.0], [0.0, sy, 0.0, 0.0], [0.0, 0.0, sz, 0.0], [0.0, 0.0, 0.0, 1.0]]
    )


def _affine(rows: list[list[Any]]) -> Any:
    return Matrix([*([*row, 0.0] for row in rows), [0.0, 0.0, 0.0, 1.0]])


def rot_by_axis(axis: Any, angle: Any) -> Any:
    """Returns the 4×4 matrix that turns about an axis of any length."""
    x, y, z = (axis.normalized()[i] for i in range(3))
    c, s = cos(angle), sin(angle)
    d = 1.0 - c
    return _affine(
        [
            [c + x * x * d, x * y * d + z * s, x * z * d - y * s],
            [x * y * d - z * s, c + y * y * d, y * z * d + x * s],
            [x * z * d + y * s, y * z * d - x * s, c + z * z * d],
        ]
    )


def rot_yaw_pitch_roll(yaw: Any, pitch: Any, roll: Any) -> Any:
    """Turns by `roll` about the third axis, then by `pitch` about the first, then by `yaw` about
    the second.
    """
    (cy, sy), (cx, sx), (cz, sz) = ((cos(a), sin(a)) for a in (yaw, pitch, roll))
    return _affine(
        [
            [cz * cy + sz * sx * sy, sz * cx, sz * sx * cy - cz * sy],
            [cz * sx * sy - sz * cy, cz * cx, sz * sy + cz * sx * cy],
            [cx * sy, -sx, cx * cy],
        ]
    )


def rotation3d(ang_x: Any, ang_y: Any, ang_z: Any) -> Any:
    """Turns by `ang_y` about the third axis, then by `ang_x` about the first, then by `ang_z` about
    the second: the order is Taichi's.
    """
    return rot_yaw_pitch_roll(ang_z, ang_x, ang_y)
