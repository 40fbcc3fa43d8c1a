"""Visibility of segments by z-buffer: six item buffers around each origin.

The buffer tells which polygon is seen in the direction of the target, and where the segment itself meets that polygon's
plane decides whether it stands in between. So depth is exact, and no surface hides itself; only along silhouettes,
within a pixel of them, may the wrong polygon be asked. Choose it without a ray engine, and where many targets belong to
few origins: six projections are made for each distinct origin, at a few milliseconds.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from .margins import end_margin
from .zbuffer import BLOCK, Loops, item_buffer

#: Pixels along a side of each of the six faces: half a degree each.
RESOLUTION = 180


class CubeMaps:
    """Visibility of segments by item buffers around their origins; see `segments.Visibility`.

    Parameters
    ----------
    environment : Environment
    resolution : int
        Pixels along a side of each face, 1 or more.

    Raises
    ------
    SettingsError
        If the resolution is below 1.
    """

    def __init__(self, environment: Environment, resolution: int = RESOLUTION):
        if resolution != int(resolution) or resolution < 1:
            raise SettingsError(f"Resolution of the z-buffer must be a whole number of 1 or more, not {resolution}")
        self.rays = 0
        self.margin = end_margin(environment)
        self.resolution = int(resolution)
        self._loops = Loops.of(environment)

    def visible(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n,) bool: whether the segments meet no polygon between their ends."""
        origins, targets = (np.asarray(points, dtype=np.float64).reshape(-1, 3) for points in (origins, targets))
        self.rays += len(origins)
        free = np.ones(len(origins), bool)
        viewpoints, places = np.unique(origins, axis=0, return_inverse=True)
        places = places.ravel()
        order = np.argsort(places, kind="stable")
        step = max(1, BLOCK // (6 * self.resolution**2))
        bounds = np.searchsorted(places[order], np.arange(0, len(viewpoints) + step, step))
        for number, start in enumerate(range(0, len(viewpoints), step)):
            rows = order[bounds[number] : bounds[number + 1]]
            block = viewpoints[start : start + step]
            free[rows] = self._block(block, places[rows] - start, targets[rows] - origins[rows])
        return free

    def _block(self, viewpoints, places, along):
        """(k,) bool: whether vectors (k, 3) from some of the viewpoints meet nothing before their end."""
        size = self.resolution
        faces = _faces()
        centers = (np.arange(size) * 2 + 1) / size - 1
        items, _ = item_buffer(
            np.repeat(viewpoints, 6, axis=0), np.tile(faces, (len(viewpoints), 1, 1)), self._loops, centers, centers
        )
        axis = np.abs(along).argmax(axis=1)
        longest = along[np.arange(len(along)), axis]
        face = 2 * axis + (longest < 0)
        local = np.einsum("kij,kj->ki", faces[face], along)
        lengths = np.linalg.norm(along, axis=1)
        # A segment without length looks nowhere, and is visible.
        cells = local[:, :2] / np.where(lengths > 0, local[:, 2], 1)[:, None]
        column, row = np.clip(((cells + 1) / 2 * size).astype(np.int64), 0, size - 1).T
        met = items.reshape(-1, 6, size, size)[places, face, row, column]
        normals, anchors = self._loops.normals[met], self._loops.anchors[met]
        slopes = np.einsum("ki,ki->k", along, normals)
        heights = np.einsum("ki,ki->k", anchors - viewpoints[places], normals)
        # A segment along the plane of the polygon asked does not meet it.
        shares = heights / np.where(slopes != 0, slopes, np.inf)
        margins = self.margin / np.where(lengths > 0, lengths, np.inf)
        blocked = (met >= 0) & (shares > margins) & (shares < 1 - margins)
        return ~blocked


def _faces() -> np.ndarray:
    """(6, 3, 3) rotations that look along x, -x, y, -y, z and -z."""
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.zeros((3, 3))
            face[0, (axis + 1) % 3], face[1, (axis + 2) % 3], face[2, axis] = 1, 1, sign
            faces.append(face)
    return np.array(faces)
