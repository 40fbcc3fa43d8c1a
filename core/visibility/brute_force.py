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
                free[rows] &= ~_crosses(starts[rows], ends[rows], triangles).any(axis=1)
        return free


def _crosses(starts: np.ndarray, ends: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(n, m) bool: whether each of n segments crosses each of m triangles (m, 3, 3), borders included."""
    along = (ends - starts)[:, None]
    a, b, c = (corners[None, :, i] - starts[:, None] for i in range(3))
    sides = [
        np.einsum("nmi,nmi->nm", np.cross(p, q), np.broadcast_to(along, p.shape)) for p, q in ((a, b), (b, c), (c, a))
    ]
    within = (np.minimum.reduce(sides) >= 0) | (np.maximum.reduce(sides) <= 0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals /= np.where(lengths > 0, lengths, 1)[:, None]
    before = np.einsum("nmi,mi->nm", a, normals)
    after = before - np.einsum("ni,mi->nm", ends - starts, normals)
    # Segments within the triangle's plane pass along it, which blocks nothing.
    rounding = ROUNDING * max(np.abs(corners).max(initial=0), np.abs(starts).max(initial=0))
    apart = np.maximum(np.abs(before), np.abs(after)) > rounding
    return within & (before * after <= 0) & apart
