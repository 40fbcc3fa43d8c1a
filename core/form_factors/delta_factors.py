"""Delta form factors: what one pixel of a projection plane contributes, exactly and at pixel centers.

A point looks at a plane at distance 1, parallel to its tangent plane (top) or perpendicular to it (side). The share of
the power that leaves the point through a rectangle of that plane has a closed form (Howell's catalog, B-3 and B-4);
Cohen and Greenberg take the density at the pixel's center times its area instead, which errs by the square of its size.
"""

from __future__ import annotations

import numpy as np


def top_density(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Share of the power per area at (x, y, 1), seen from the origin whose normal is z [1]_.

    References
    ----------
    .. [1] Cohen, Greenberg, "The Hemi-Cube: A Radiosity Solution for Complex Environments", SIGGRAPH 1985, section 4.
    """
    square = 1 + x * x + y * y
    return 1 / (np.pi * square * square)


def side_density(x: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Share of the power per area at a point of a side face: x along the face, `height` above the tangent plane."""
    return height * top_density(x, height)


def top_integrals(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Shares (h, w) of the power through the cells between ascending lines (w + 1,) and (h + 1,) of the top plane."""
    x, y = np.asarray(columns, dtype=np.float64)[None, :], np.asarray(rows, dtype=np.float64)[:, None]
    return np.diff(np.diff(top_corner(x, y), axis=0), axis=1)


def top_corner(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Share of the power through the rectangle from the origin to (x, y) of the top plane; odd in either."""
    over_x, over_y = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    return (x / over_x * np.arctan(y / over_x) + y / over_y * np.arctan(x / over_y)) / (2 * np.pi)


def side_integrals(columns: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Shares (h, w) of the power through the cells between lines (w + 1,) and heights (h + 1,) of a side face."""
    x, over = np.asarray(columns)[None, :], np.sqrt(1 + np.square(np.asarray(heights, dtype=np.float64)))[:, None]
    corners = -np.arctan(x / over) / (2 * np.pi * over)
    return np.diff(np.diff(corners, axis=0), axis=1)
