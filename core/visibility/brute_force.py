"""Brute force: every segment against every triangle, in float64. The reference that the other visibilities agree with.

The side of each triangle's edge that a segment passes is the sign of one determinant, and neighbors that share an edge
compute it from the same numbers with opposite sign. So no segment slips through between the triangles of a polygon, or
between polygons that share corners. Cost: segments times triangles, at about 0.1 microseconds each; for tests and for
small scenes.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from .margins import end_margin, trim

#: Segments times triangles in one block: some twenty temporaries of 1 MB.
BLOCK_PAIRS = 2**17

#: Height above a triangle's plane, in largest coordinates, that rounding alone may give to a point of the plane: a few
#: roundings of float64 in the corners and in the normal.
ROUNDING = 1e-14


class BruteForce:
    """Visibility of segments by exact tests against all triangles; see `segments.Visibility`."""

    def __init__(self, environment: Environment):
        self.rays = 0
        self.margin = end_margin(environment)
        self._corners = environment.vertices[environment.triangles]

    def visible(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n,) bool: whether the segments meet no polygon between their ends."""
        starts, ends, remaining = trim(origins, targets, self.margin)
        self.rays += len(starts)
        free = np.ones(len(starts), bool)
        block = max(1, BLOCK_PAIRS // max(1, len(self._corners)))
        tested = np.flatnonzero(remaining)
        for begin in range(0, len(tested), block):
            rows = tested[begin : begin + block]
            for first in range(0, len(self._corners), BLOCK_PAIRS):
                triangles = self._corners[first : first + BLOCK_PAIRS]
                free[rows] &= ~crosses(starts[rows, None], ends[rows, None], triangles).any(axis=1)
        return free


def crosses(starts: np.ndarray, ends: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segments cross triangles, borders included; those within the triangle's plane pass along it.

    Parameters
    ----------
    starts, ends : (..., 3) float
    corners : (..., 3, 3) float
        Leading dimensions are broadcast against those of the segments.
    """
    along = ends - starts
    a, b, c = (corners[..., i, :] - starts for i in range(3))
    sides = [(np.cross(p, q) * along).sum(axis=-1) for p, q in ((a, b), (b, c), (c, a))]
    within = (np.minimum.reduce(sides) >= 0) | (np.maximum.reduce(sides) <= 0)
    normals = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals /= np.where(lengths > 0, lengths, 1)
    before = (a * normals).sum(axis=-1)
    after = before - (along * normals).sum(axis=-1)
    rounding = ROUNDING * max(np.abs(corners).max(initial=0), np.abs(starts).max(initial=0))
    apart = np.maximum(np.abs(before), np.abs(after)) > rounding
    return within & (before * after <= 0) & apart
