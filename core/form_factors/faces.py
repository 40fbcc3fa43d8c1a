"""One-sided faces of an environment as whole arrays, for kernels that work on many pairs of polygons at once.

A two-sided patch becomes two faces, so that kernels know one side only. Corners are kept relative to each face's center
of area, where they have all their digits even far from the origin. Loops of unequal length are held in classes of
rounded length, filled up with copies of their last corner, which bound nothing.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment

#: Lengths of loops to which shorter ones are filled up, then multiples of the last: at most a third is wasted.
CLASSES = np.array([3, 4, 6, 8, 12, 16, 24, 32, 48, 64])

#: Distance from a plane, in sizes of the two faces, within which a corner counts as lying in it: some hundred roundings
#: of float64, as in `point_to_polygon`. The rounding of the coordinates themselves is added to it.
PLANE_TOLERANCE = 1e-13


class Faces:
    """Faces with an area, of an environment.

    Attributes
    ----------
    owners : (f,) int
        Patch of each face.
    areas, radii : (f,) float
        Areas, and distances of the farthest corner from the center.
    normals, centers : (f, 3) float
        Unit normals; centers of area, relative to the middle of the environment.
    axes : (f, 2, 3) float
        Principal directions in the plane, as long as the standard deviation of the area along them.
    sizes : (f,) int
        Length class of each face's loop.
    rounding : float
        How far a coordinate may be off by rounding.
    """

    def __init__(self, environment: Environment):
        usable = np.flatnonzero(environment.areas > 0)
        backs = usable[environment.two_sided[usable]]
        self.owners = np.concatenate((usable, backs))
        self.count = len(environment)
        sides = np.where(environment.two_sided[self.owners], 2, 1)
        self.areas = environment.areas[self.owners] / sides
        self.normals = environment.normals[self.owners].copy()
        self.normals[len(usable) :] *= -1
        places = environment.centroids[self.owners]
        middle = (places.min(axis=0) / 2 + places.max(axis=0) / 2) if len(places) else np.zeros(3)
        self.centers = places - middle
        lengths = np.array([len(environment.polygons[owner]) for owner in self.owners], dtype=np.int64)
        self.sizes = _length_classes(lengths)
        self.radii = np.zeros(len(self.owners))
        self.axes = np.zeros((len(self.owners), 2, 3))
        self._loops, self._rows = {}, np.zeros(len(self.owners), dtype=np.int64)
        reach = 0.0
        for size in np.unique(self.sizes):
            members = np.flatnonzero(self.sizes == size)
            self._rows[members] = np.arange(len(members))
            loops = np.empty((len(members), size, 3))
            for row, face in enumerate(members):
                polygon = environment.polygons[self.owners[face]]
                loops[row, : len(polygon)] = polygon if face < len(usable) else polygon[::-1]
                loops[row, len(polygon) :] = loops[row, len(polygon) - 1]
            reach = max(reach, np.abs(loops).max())
            loops -= places[members][:, None]
            self._loops[size] = loops
            self.radii[members] = np.sqrt(np.einsum("nki,nki->nk", loops, loops).max(axis=1))
            self.axes[members] = _principal_axes(loops, self.normals[members], self.areas[members])
        self.rounding = 4 * np.finfo(np.float64).eps * reach

    def __len__(self) -> int:
        return len(self.owners)

    def loops(self, faces: np.ndarray) -> np.ndarray:
        """(m, k, 3) corners relative to the centers of m faces of one length class."""
        return self._loops[self.sizes[faces[0]]][self._rows[faces]]

    def height_ranges(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (r, c) of each column's face above the plane of each row's.

        Good to a few roundings of the environment's size.
        """
        lowest, highest = np.empty((len(rows), len(columns))), np.empty((len(rows), len(columns)))
        ground = np.einsum("ri,ri->r", self.normals[rows], self.centers[rows])[:, None]
        for size in np.unique(self.sizes[columns]):
            chosen = np.flatnonzero(self.sizes[columns] == size)
            corners = self.loops(columns[chosen]) + self.centers[columns[chosen]][:, None]
            low = high = None
            for corner in range(size):
                heights = self.normals[rows] @ corners[:, corner].T
                low = heights if low is None else np.minimum(low, heights)
                high = heights if high is None else np.maximum(high, heights)
            lowest[:, chosen], highest[:, chosen] = low - ground, high - ground
        return lowest, highest

    def tolerance(self, faces: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Height within which a corner counts as lying in a plane, for pairs of faces."""
        return PLANE_TOLERANCE * (self.radii[faces] + self.radii[others]) + self.rounding


def smaller_first(areas: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each pair (m,) and (m,) with the one of smaller area first, as given where both are alike.

    From the smaller one fewer points see all there is of the other, and reciprocity carries the factor over.
    """
    swap = areas[first] > areas[second]
    return np.where(swap, second, first), np.where(swap, first, second)


def _length_classes(lengths):
    beyond = -(-lengths // CLASSES[-1]) * CLASSES[-1]
    return np.where(lengths > CLASSES[-1], beyond, CLASSES[np.searchsorted(CLASSES, np.minimum(lengths, CLASSES[-1]))])


def _principal_axes(loops, normals, areas):
    """Axes (n, 2, 3) of the second moment of loops about their centers, each a standard deviation long."""
    following = np.roll(loops, -1, axis=1)
    # Signed areas of the triangles between the center and each edge: right for concave loops, too.
    signed = np.einsum("nki,ni->nk", np.cross(loops, following), normals) / 2
    sums = loops + following
    moment = np.einsum("nk,nki,nkj->nij", signed, loops, loops)
    moment = moment + np.einsum("nk,nki,nkj->nij", signed, following, following)
    moment = (moment + np.einsum("nk,nki,nkj->nij", signed, sums, sums)) / (12 * areas[:, None, None])
    values, vectors = np.linalg.eigh(moment)
    return np.sqrt(np.maximum(values[:, 1:], 0))[:, :, None] * vectors.transpose(0, 2, 1)[:, 1:]
