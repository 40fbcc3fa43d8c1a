"""Grids of vertices on quadrilaterals, and the areas that their vertices and cells stand for (survey figure 12)."""

from __future__ import annotations

import numpy as np


def grid_steps(cells: int, graded: bool = False) -> np.ndarray:
    """(cells + 1,) places from 0 to 1 of the lines of a grid: even, or denser towards both ends by a cosine."""
    steps = np.linspace(0, 1, cells + 1)
    return (1 - np.cos(np.pi * steps)) / 2 if graded else steps


def vertex_grid(corners: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of patches and the areas that they stand for, each up to half way to its neighbors.

    Parameters
    ----------
    corners : (q, 4, 3) float
        Convex planar quadrilaterals; triangles repeat their last corner.
    steps : (m + 1,) float
        Lines of the grid, as of `grid_steps`.

    Returns
    -------
    vertices : (q, m + 1, m + 1, 3) float64
        By rows.
    areas : (q, m + 1, m + 1) float64
        Of a parallelogram with even steps ``w A / m^2``, where w is 1/4, 1/2 or 1. They sum to A.
    """
    widths = np.zeros(len(steps))
    widths[:-1] += np.diff(steps) / 2
    widths[1:] += np.diff(steps) / 2
    vertices, stretch = _bilinear(corners, steps)
    return vertices, stretch * widths[:, None] * widths


def cell_middles(corners: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles (q, m, m, 3) of the cells between the lines of a grid, and the areas (q, m, m) of the cells."""
    vertices, stretch = _bilinear(corners, (steps[1:] + steps[:-1]) / 2)
    return vertices, stretch * np.diff(steps)[:, None] * np.diff(steps)


def quartered(corners: np.ndarray) -> np.ndarray:
    """(4 m, 4, 3) quadrilaterals, four in place of each, cut by the lines through the middles of opposite sides."""
    a, b, c, d = (corners[:, place] for place in range(4))
    ab, bc, cd, da, middle = (a + b) / 2, (b + c) / 2, (c + d) / 2, (d + a) / 2, (a + b + c + d) / 4
    parts = [(a, ab, middle, da), (ab, b, bc, middle), (middle, bc, c, cd), (da, middle, cd, d)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 4, 3)


def _bilinear(corners, steps):
    """Places of the bilinear map of quadrilaterals at a grid of steps, and its area per unit of parameters."""
    a, b, c, d = (corners[:, place, None, None] for place in range(4))
    v, u = (grid[:, :, None] for grid in np.meshgrid(steps, steps, indexing="ij"))
    places = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    along = (1 - v) * (b - a) + v * (c - d)
    across = (1 - u) * (d - a) + u * (c - b)
    return places, np.linalg.norm(np.cross(along, across), axis=-1)
