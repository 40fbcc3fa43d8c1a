"""The disk as a square: an equal-area map that keeps neighbors together (Shirley and Chiu 1997).

Directions of a hemisphere, projected onto the disk below it (Nusselt), become places in a unit square: equal areas of
the square are equal form factors, and squares are divided more easily than disks.
"""

from __future__ import annotations

import numpy as np


def square_to_disk(square: np.ndarray) -> np.ndarray:
    """Places (..., 2) in the unit disk of places (..., 2) in the unit square."""
    a, b = 2 * square[..., 0] - 1, 2 * square[..., 1] - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    ratio = np.where(wide, b, a) / np.where(radius == 0, 1, radius)
    angle = np.where(wide, np.pi / 4 * ratio, np.pi / 2 - np.pi / 4 * ratio)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def disk_to_square(disk: np.ndarray) -> np.ndarray:
    """Places (..., 2) in the unit square, from 0 to 1, of places (..., 2) in the unit disk."""
    x, y = disk[..., 0], disk[..., 1]
    radius = np.minimum(np.hypot(x, y), 1)
    wide = np.abs(x) > np.abs(y)
    # The angle from the nearer axis, within an eighth of a turn: exact for either sign of the axis.
    short, long = np.where(wide, y, x), np.where(wide, x, y)
    ratio = np.arctan(short / np.where(long == 0, 1, long)) * (4 / np.pi)
    radius = np.copysign(radius, long)
    one, other = radius, radius * ratio
    return np.stack([np.where(wide, one, other), np.where(wide, other, one)], axis=-1) / 2 + 0.5
