"""Outlines: the corners and edges of an environment's polygons, each once, and the polygons that meet there.

What discontinuities of visibility are made from. Faces of a box share edges and corners, so that working on polygons
would meet each of them two or three times; and an edge between two faces shows only where they do not hide each other,
which is told by the two alone. Edges between coplanar polygons, or triangles of one, never show.

Cost: a sort of all corners and edges. Limits: an edge that meets two shorter ones along its way counts by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from .convex_loops import ConvexPieces

#: Grid, in scene sizes, on which corners are one: far above rounding, far below the gaps that must not close (1e-6).
WELD = 1e-9


@dataclass(frozen=True)
class Outlines:
    """Corners and edges of all patches with an area, in the unit frame of some pieces.

    Attributes
    ----------
    corners : (c, 3) float64
    edges : (e, 2) int64
        Corners at the ends of each edge.
    inward : (e, 2, 3) float64
        Unit vectors from an edge into its two faces, at a right angle to it. Twice the same where it has one face
        only; a flap that way is on the outline whatever is behind it. So are edges of three faces and more.
    normals : (n, 3) float64
        Unit normals of the patches.
    sides : (s,) int64
        Edge that each side of each polygon is, patch by patch and around it; -1 for sides without length.
    places : (s,) int64
        Corner at which each side begins.
    starts, counts : (n,) int64
        Sides of each patch: where they begin, and how many there are.
    """

    corners: np.ndarray
    edges: np.ndarray
    inward: np.ndarray
    normals: np.ndarray
    sides: np.ndarray
    places: np.ndarray
    starts: np.ndarray
    counts: np.ndarray

    @classmethod
    def build(cls, environment: Environment, pieces: ConvexPieces) -> Outlines:
        """Outlines of an environment, in the frame of its pieces."""
        lengths = np.array([len(polygon) for polygon in environment.polygons])
        ends = np.cumsum(lengths)
        owners = np.repeat(np.arange(len(lengths)), lengths)
        following = np.arange(len(owners)) + 1
        following[ends - 1] -= lengths
        points = pieces.to_unit(environment.vertices)
        _, first, names = np.unique(np.round(points / WELD), axis=0, return_index=True, return_inverse=True)
        names, corners = names.reshape(-1), points[first]
        used = environment.areas[owners] > 0
        pairs = np.sort(np.stack((names, names[following]), axis=1), axis=1)
        real = np.flatnonzero(used & (pairs[:, 0] != pairs[:, 1]))
        edges, sides = np.unique(pairs[real], axis=0, return_inverse=True)
        along = corners[names[following]] - corners[names]
        inward = np.cross(environment.normals[owners], along)[real]
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        all_sides = np.full(len(owners), -1)
        all_sides[real] = sides.reshape(-1)
        return cls(
            corners=corners,
            edges=edges.reshape(-1, 2),
            inward=_two_of_each(sides.reshape(-1), inward, len(edges)),
            normals=environment.normals,
            sides=all_sides,
            places=names,
            starts=ends - lengths,
            counts=np.where(environment.areas > 0, lengths, 0),
        )


def _two_of_each(edges, vectors, count):
    """(count, 2, 3): the two vectors of each edge that has two, else one of them twice."""
    order = np.argsort(edges, kind="stable")
    sizes = np.bincount(edges, minlength=count)
    first = np.cumsum(sizes) - sizes
    second = np.where(sizes == 2, first + 1, first)
    return vectors[order[np.stack((first, second), axis=1)]]
