"""Visibility of segments by z-buffer: six item buffers around each origin.

The buffer tells which polygons are seen through the four pixels around the direction of the target, and the segment is
tested against these alone, exactly. So no surface hides itself, and what is called blocked is blocked; only within a
pixel of a silhouette may a blocker be overlooked that lies behind another polygon or is smaller than a pixel. Choose it without a ray engine, and where many targets belong to
few origins: six projections are made for each distinct origin, at a few milliseconds.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from .brute_force import crosses
from .margins import end_margin, trim
from .zbuffer import BLOCK, Loops, item_buffer, ranges

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
        self._corners = environment.vertices[environment.triangles]
        self._first = np.searchsorted(environment.triangle_patches, np.arange(len(environment) + 1))

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
            items = self._items(viewpoints[start : start + step])
            free[rows] = self._block(items, places[rows] - start, origins[rows], targets[rows])
        return free

    def _items(self, viewpoints: np.ndarray) -> np.ndarray:
        """(v, 6, size, size) item buffers."""
        size = self.resolution
        centers = (np.arange(size) * 2 + 1) / size - 1
        faces = np.tile(_faces(), (len(viewpoints), 1, 1))
        items, _ = item_buffer(np.repeat(viewpoints, 6, axis=0), faces, self._loops, centers, centers)
        return items.reshape(-1, 6, size, size)

    def _block(self, items, places, origins, targets):
        """(k,) bool: whether segments from the viewpoints of some buffers are free."""
        size, along = self.resolution, targets - origins
        axis = np.abs(along).argmax(axis=1)
        face = 2 * axis + (along[np.arange(len(along)), axis] < 0)
        local = np.einsum("kij,kj->ki", _faces()[face], along)
        # A segment without length looks nowhere, and is visible.
        image = local[:, :2] / np.where(local[:, 2] > 0, local[:, 2], 1)[:, None]
        corner = np.floor((image + 1) / 2 * size - 0.5).astype(np.int64)
        starts, ends, remaining = trim(origins, targets, self.margin)
        free = np.ones(len(along), bool)
        for right in (0, 1):
            for up in (0, 1):
                column, row = np.clip(corner + [right, up], 0, size - 1).T
                met = items[places, face, row, column]
                tested = np.flatnonzero((met >= 0) & remaining & free)
                first = self._first[met[tested]]
                which, triangles = ranges(first, self._first[met[tested] + 1] - first)
                segment = tested[which]
                hit = crosses(starts[segment], ends[segment], self._corners[triangles])
                free[segment[hit]] = False
        return free


def _faces() -> np.ndarray:
    """(6, 3, 3) rotations that look along x, -x, y, -y, z and -z."""
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.zeros((3, 3))
            face[0, (axis + 1) % 3], face[1, (axis + 2) % 3], face[2, axis] = 1, 1, sign
            faces.append(face)
    return np.array(faces)
