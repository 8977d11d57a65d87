"""A camera: where it is, how it projects, and how a user moves it."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np


def look_at(position: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The matrix from world coordinates to camera coordinates, whose x is to the right and whose z
    is backward.
    """
    front = _unit(target - position, np.array([0.0, 0.0, -1.0]))
    right = np.cross(front, up)
    if not np.linalg.norm(right) > 1e-9:  # it looks along `up`
        right = np.cross(front, np.roll(front, 1) + [0.1, 0.2, 0.3])
    right = _unit(right, right)
    rows = np.stack([right, np.cross(right, front), -front])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rows, -rows @ position
    return matrix


def perspective(angle: float, aspect: float, near: float, far: float) -> np.ndarray:
    """The matrix of a perspective projection whose height spans `angle` degrees."""
    scale = 1 / math.tan(math.radians(angle) / 2)
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = scale / aspect, scale
    matrix[2, 2:] = (near + far) / (near - far), 2 * near * far / (near - far)
    matrix[3, 2] = -1
    return matrix


def orthographic(
    left: float, right: float, bottom: float, top: float, near: float, far: float
) -> np.ndarray:
    """The matrix of a projection by parallel rays."""
    low, high = np.array([left, bottom, -far]), np.array([right, top, -near])
    matrix = np.eye(4)
    matrix[[0, 1, 2], [0, 1, 2]] = 2 / (high - low) * [1, 1, -1]
    matrix[:3, 3] = -(high + low) / (high - low) * [1, 1, -1]
    return matrix


def _unit(vector: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else otherwise


class Steering:
    """Moves a camera by the keys W, A, S, D, E (up) and Q (down), and by the mouse."""

    def __init__(self) -> None:
        self._then: float | None = None
        self._cursor: tuple[float, float] | None = None

    def step(
        self, window: Any, position: np.ndarray, target: np.ndarray, up: np.ndarray,
        speed: float, yaw_speed: float, pitch_speed: float, hold_key: str | None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Returns the position and target of the camera after a step.

        Args:
            speed: distance in a sixtieth of a second.
            yaw_speed, pitch_speed: radians for a motion over the whole window.
            hold_key: key or button that is held while the mouse turns the camera; None for none.
        """
        now = time.monotonic()
        frames = 0.0 if self._then is None else 60 * (now - self._then)
        self._then = now
        front = _unit(target - position, np.array([0.0, 0.0, -1.0]))
        top = _unit(up, np.array([0.0, 1.0, 0.0]))
        left = _unit(np.cross(top, front), np.zeros(3))
        keys = {"w": front, "s": -front, "a": left, "d": -left, "e": top, "q": -top}
        shift = sum((way for key, way in keys.items() if window.is_pressed(key)), np.zeros(3))
        shift = shift * speed * frames
        cursor = window.get_cursor_pos()
        if hold_key is None or window.is_pressed(hold_key):
            if self._cursor is not None:
                yaw = -yaw_speed * (cursor[0] - self._cursor[0])
                pitch = pitch_speed * (cursor[1] - self._cursor[1])
                front = _turned(front, top, yaw, pitch)
            self._cursor = cursor
        else:
            self._cursor = None
        reach = np.linalg.norm(target - position) or 1.0
        return position + shift, position + shift + reach * front


def _turned(front: np.ndarray, top: np.ndarray, yaw: float, pitch: float) -> np.ndarray:
    """Turns a direction to the left and upward, but never as far upward as `top`."""
    height = float(np.clip(front @ top, -1, 1))
    flat = _unit(front - height * top, np.zeros(3))
    side = np.cross(top, flat)
    limit = math.radians(89)
    angle = min(max(math.asin(height) + pitch, -limit), limit)
    turned = math.cos(yaw) * flat + math.sin(yaw) * side
    return math.cos(angle) * turned + math.sin(angle) * top
