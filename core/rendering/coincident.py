"""Faces that lie in one another: which of them a picture shows.

Where two faces coincide a ray meets either, by the rounding of its depth, and the picture is hatched in the colors of
both. Here each such face gets a copy before it, by a distance that no pixel shows; the face itself stays, so that no
cracks open. A face turned to the viewer then comes before one turned away, whose light is that of the inside of a
solid, and of faces turned the same way the smaller part of the surface lies on top, as a label does on its bottle.

Cost: some sorts of triangles and edges, about 1 s for a million triangles. Limits: parts count as overlapping when
boxes around them do; faces that cross at a small angle are left alone, and so are tiny ones whose planes rounding has
tilted.
"""

from __future__ import annotations

import numpy as np

from ..discretization.nodes import connected_labels
from ..keys import row_keys
from ..visibility.embree import RayEngine

#: Distance between copies, in sizes of the scene: some ten roundings of a depth in float32.
STEP = 2e-6

#: Largest distance between planes that count as one, in sizes of the scene.
SAME_PLANE = 1e-6

#: Normals are grouped by rounding this multiple of them, with a shift that keeps those along the axes off the seams.
NORMAL_STEPS, NORMAL_SHIFT = 256, 0.3

#: Faces in one place that are told apart at most; a pile of more may still be hatched.
MAX_PILE = 30

#: Parts of one plane that are compared pair by pair; where there are more, all count as overlapping.
MAX_COMPARED = 64


class SortedEngine(RayEngine):
    """A `RayEngine` whose rays meet coincident triangles in one order, whatever the rounding of their depths."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, threads: int = 0):
        vertices, triangles, self._source = told_apart(vertices, triangles)
        super().__init__(vertices, triangles, threads)

    def closest(self, origins: np.ndarray, directions: np.ndarray):
        """See `RayEngine.closest`; the triangles are those given."""
        triangles, *place = super().closest(origins, directions)
        return np.where(triangles >= 0, self._source[triangles], -1), *place


def told_apart(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The triangles, and before those that coincide copies in an order that does not depend on the view.

    Parameters
    ----------
    vertices : (n, 3) float
        Finite where a triangle uses them.
    triangles : (m, 3) int

    Returns
    -------
    vertices : (k, 3) float64
        The given ones, then those of the copies.
    triangles : (l, 3) int32
        The given ones, then the copies.
    source : (l,) int32
        Given triangle that each stands for.
    """
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    triangles = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
    source = np.arange(len(triangles), dtype=np.int32)
    if len(triangles) < 2:
        return vertices, triangles, source
    corners = vertices[triangles]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    size = max(float((high - low).max()), 1e-300)
    corners = (corners - (low + high) / 2) / size
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    sound = np.nonzero(areas > 0)[0]
    corners, areas = corners[sound], areas[sound]
    normals = normals[sound] / areas[:, None]
    flips, planes = _planes(corners, normals)
    parts = _parts(corners, 2 * planes + flips)
    leaders, parts = np.unique(parts, return_inverse=True)
    sizes = np.bincount(parts, weights=areas)
    heights = STEP * size * _heights(corners, parts, sizes, planes[leaders])
    moved = np.nonzero(heights[parts] > 0)[0]
    # One normal for all of a part, or its triangles would come apart.
    shift = heights[parts[moved], None] * normals[leaders[parts[moved]]]
    places = vertices[triangles[sound[moved]]] + shift[:, None]
    copies = len(vertices) + np.arange(3 * len(moved), dtype=np.int32).reshape(-1, 3)
    return (
        np.concatenate([vertices, places.reshape(-1, 3)]),
        np.concatenate([triangles, copies]),
        np.concatenate([source, source[sound[moved]]]),
    )


def _planes(corners: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which triangles face against the direction that stands for their plane, and the number of that plane."""
    largest = np.take_along_axis(normals, np.abs(normals).argmax(axis=1)[:, None], axis=1)
    flips = largest[:, 0] < 0
    upright = np.where(flips[:, None], -normals, normals)
    keys = row_keys(*np.rint(upright * NORMAL_STEPS + NORMAL_SHIFT).astype(np.int64).T)
    depths = np.einsum("ij,ij->i", corners.mean(axis=1), upright)
    order = np.lexsort((depths, keys))
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(depths[order]) > SAME_PLANE) | (keys[order][1:] != keys[order][:-1])
    planes = np.empty(len(order), np.int64)
    planes[order] = np.cumsum(first) - 1
    return flips, planes


def _parts(corners: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Lowest triangle (m,) of the part of surface each belongs to: joined by edges that only two triangles of the same
    side of a plane have, in opposite directions."""
    places = np.rint(corners.reshape(-1, 3) * 1e7).astype(np.int64)
    _, welded = np.unique(row_keys(*places.T), return_inverse=True)
    welded = welded.reshape(-1, 3).astype(np.int64)
    count = int(welded.max()) + 1
    start, stop = welded.ravel(), np.roll(welded, -1, axis=1).ravel()
    owner = np.repeat(np.arange(len(corners)), 3)
    keys = row_keys(np.minimum(start, stop) * count + np.maximum(start, stop), sides[owner])
    order = np.lexsort((start > stop, keys))
    same = keys[order][1:] == keys[order][:-1]
    # Exactly two in a row, and one of each direction.
    alone = same & ~np.append(same[1:], False) & ~np.insert(same[:-1], 0, False)
    first = np.nonzero(alone & ((start > stop)[order][1:] != (start > stop)[order][:-1]))[0]
    return connected_labels(len(corners), np.stack([owner[order[first]], owner[order[first + 1]]], axis=1))


def _heights(corners: np.ndarray, parts: np.ndarray, sizes: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Steps (p,) by which a copy lies before each part: none where nothing overlaps it, more before a smaller one."""
    heights = np.zeros(len(sizes))
    members = np.bincount(planes)
    shared = np.nonzero(members[planes] > 1)[0]
    if not len(shared):
        return heights
    low, high = np.full((len(sizes), 3), np.inf), np.full((len(sizes), 3), -np.inf)
    np.minimum.at(low, parts, corners.min(axis=1))
    np.maximum.at(high, parts, corners.max(axis=1))
    shared = shared[np.argsort(planes[shared], kind="stable")]
    overlaps = members[planes[shared]] > MAX_COMPARED
    few = shared[~overlaps]
    starts = np.searchsorted(planes[few], planes[few])
    counts = members[planes[few]]
    one = np.repeat(np.arange(len(few)), counts)
    other = starts[one] + np.arange(len(one)) - np.repeat(np.cumsum(counts) - counts, counts)
    room = np.minimum(high[few[one]], high[few[other]]) - np.maximum(low[few[one]], low[few[other]])
    # In the plane two of the three axes have extent; a box that only touches another one overlaps in one of them.
    meet = ((room > SAME_PLANE).sum(axis=1) >= 2) & (one != other)
    touched = np.zeros(len(few), bool)
    touched[one[meet]] = True
    overlaps[~overlaps] = touched
    piled = shared[overlaps]
    piled = piled[np.lexsort((piled, -sizes[piled], planes[piled]))]
    place = np.arange(len(piled)) - np.searchsorted(planes[piled], planes[piled])
    heights[piled] = np.minimum(place + 1, MAX_PILE)
    return heights
