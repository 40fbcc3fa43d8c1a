"""Convex polygons in one array, and how planes split many of them at once.

What the BSP tree, the exact clipping and the silhouettes have in common. Loops are (m, k, 3): shorter ones repeat their
last corner, so that the extra edges have no length and add nothing to any sum over edges. Splitting costs a few
microseconds a polygon, whatever the number of planes in play.

Limits: the loops must be convex; `convex_pieces` makes them so, by triangles where a polygon is concave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment

#: Sine of the turn to the wrong side up to which a corner counts as straight, so that collinear corners do not make a
#: polygon concave: some thousand roundings.
STRAIGHT = 1e-12


@dataclass(frozen=True)
class ConvexPieces:
    """Convex pieces of an environment's polygons, in a frame around the origin whose longest side is 1.

    Attributes
    ----------
    loops : (m, k, 3) float64
        Corners in the unit frame, counter-clockwise seen from the front.
    patches : (m,) int64
        Patch of each piece, in ascending order.
    normals : (m, 3) float64
        Unit normals of the patches' fronts.
    center : (3,) float64
    size : float
        The frame: unit coordinates are ``(x - center) / size``.
    """

    loops: np.ndarray
    patches: np.ndarray
    normals: np.ndarray
    center: np.ndarray
    size: float

    def to_unit(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) points in the unit frame."""
        return (np.asarray(points, dtype=np.float64) - self.center) / self.size


def convex_pieces(environment: Environment) -> ConvexPieces:
    """Each patch with an area as one convex loop, or as its triangles where it is concave."""
    loops, patches = [], []
    for patch in np.flatnonzero(environment.areas > 0):
        polygon = environment.polygons[patch]
        if is_convex(polygon, environment.normals[patch]):
            parts = [polygon]
        else:
            parts = list(environment.vertices[environment.triangles[environment.triangle_patches == patch]])
        loops += parts
        patches += [patch] * len(parts)
    owners = np.array(patches, dtype=np.int64)
    padded = pad(loops)
    low, high = (padded.reshape(-1, 3).min(axis=0), padded.reshape(-1, 3).max(axis=0)) if loops else (0.0, 0.0)
    center = np.broadcast_to(np.asarray(low) / 2 + np.asarray(high) / 2, 3)
    size = float(np.max(np.asarray(high) - low)) if loops else 1.0
    return ConvexPieces((padded - center) / size, owners, environment.normals[owners], center, size)


def is_convex(polygon: np.ndarray, normal: np.ndarray) -> bool:
    """Whether a simple planar (k, 3) loop turns left all the way, seen against its normal; straight on is allowed."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.linalg.norm(edges, axis=1)
    edges = edges[lengths > 0] / lengths[lengths > 0, None]
    return bool((np.cross(edges, np.roll(edges, -1, axis=0)) @ normal >= -STRAIGHT).all())


def pad(loops) -> np.ndarray:
    """(m, k, 3) array of loops of up to k corners each, the last corner repeated."""
    longest = max((len(loop) for loop in loops), default=3)
    padded = np.empty((len(loops), longest, 3))
    for row, loop in enumerate(loops):
        padded[row, : len(loop)] = loop
        padded[row, len(loop) :] = loop[-1]
    return padded


def join(parts: list[np.ndarray]) -> np.ndarray:
    """Loops of several arrays in one, padded to the longest."""
    longest = max(part.shape[1] for part in parts)
    return np.concatenate([widen(part, longest) for part in parts])


def widen(loops: np.ndarray, corners: int) -> np.ndarray:
    """Loops (m, k, 3) padded to `corners`."""
    missing = corners - loops.shape[1]
    return np.concatenate((loops, np.repeat(loops[:, -1:], missing, axis=1)), axis=1) if missing > 0 else loops


def split(loops: np.ndarray, heights: np.ndarray, tolerance: float):
    """Parts of convex loops above and below their planes.

    Parameters
    ----------
    loops : (m, k, 3) float
    heights : (m, k) float
        Height of each corner over the plane that splits its loop.
    tolerance : float
        Heights up to this count as 0.

    Returns
    -------
    above, above_rows, below, below_rows
        Loops (a, k', 3) and (b, k', 3), and the row that each comes from. A loop that lies in its plane is in neither.
    """
    heights = np.where(np.abs(heights) <= tolerance, 0.0, heights)
    up, down = (heights > 0).any(axis=1), (heights < 0).any(axis=1)
    mixed = np.flatnonzero(up & down)
    whole_up, whole_down = np.flatnonzero(up & ~down), np.flatnonzero(down & ~up)
    if not len(mixed):
        return loops[whole_up], whole_up, loops[whole_down], whole_down
    corners, values = loops[mixed], heights[mixed]
    following, next_values = np.roll(corners, -1, axis=1), np.roll(values, -1, axis=1)
    crossing = values * next_values < 0
    share = np.where(crossing, values, 0) / np.where(crossing, values - next_values, 1)
    hits = corners + share[:, :, None] * (following - corners)
    repeated = (corners == np.roll(corners, 1, axis=1)).all(axis=2)
    parts = [
        join([_kept(corners, hits, (values * sign >= 0) & ~repeated, crossing), loops[whole]])
        for sign, whole in ((1, whole_up), (-1, whole_down))
    ]
    return parts[0], np.concatenate((mixed, whole_up)), parts[1], np.concatenate((mixed, whole_down))


def _kept(corners, hits, kept, crossing):
    """Loops (m, k', 3) of the corners kept and the crossings, in their order around."""
    count = corners.shape[1]
    candidates = np.stack((corners, hits), axis=2).reshape(len(corners), 2 * count, 3)
    mask = np.stack((kept, crossing), axis=2).reshape(len(corners), 2 * count)
    totals = mask.sum(axis=1)
    order = np.argsort(~mask, axis=1, kind="stable")[:, : totals.max()]
    place = np.minimum(np.arange(order.shape[1]), totals[:, None] - 1)
    chosen = np.take_along_axis(order, place, axis=1)
    return np.take_along_axis(candidates, chosen[:, :, None], axis=1)
