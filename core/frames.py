"""Local frames around normals."""

from __future__ import annotations

import numpy as np


def tangents(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) that make a right-handed frame with each unit normal (n, 3).

    Duff et al. 2017, "Building an Orthonormal Basis, Revisited": no branch and no cancellation near the poles.
    """
    x, y, z = normals[:, 0], normals[:, 1], normals[:, 2]
    sign = np.copysign(np.ones_like(z), z)
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1), np.stack([b, sign + y * y * a, -y], axis=1)


def turned_frames(normals: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Frames (n, 3, 3) whose rows are the two tangents, turned by `turns` (n,) radians, and the normal."""
    one, other = tangents(normals)
    cos, sin = np.cos(turns)[:, None], np.sin(turns)[:, None]
    return np.stack([cos * one + sin * other, cos * other - sin * one, normals], axis=1)
