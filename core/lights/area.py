"""Area light: a planar polygon that emits diffusely, a lamp or an emissive face."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..form_factors.point_to_polygon import point_to_polygon
from . import sampling

#: Scouts per unit of area beside those to the middle and the corners, and how many at most: on a light as wide as the
#: scene they are a fifth of it apart.
SCOUT_DENSITY = 32
MAX_SCOUTS = 24

#: Distance from the middle, in radii of the polygon, within which places are spread as the point sees them. Beyond it
#: the nearest place of those spread evenly is at most 3 times as near as the farthest.
CLOSE = 2.0


@dataclass(frozen=True)
class AreaLight:
    """A planar convex polygon `vertices` (k, 3) with `exitance` (W/m2 per channel) on its front, by the right-hand
    rule, and on its back too where `two_sided`."""

    vertices: np.ndarray
    exitance: np.ndarray
    two_sided: bool = False

    @cached_property
    def _vector_area(self) -> np.ndarray:
        center = self.vertices - self.vertices[0]
        return np.cross(center[1:-1], center[2:]).sum(axis=0) / 2

    @property
    def area(self) -> float:
        """Area in m2."""
        return float(np.linalg.norm(self._vector_area))

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit normal of the front."""
        return self._vector_area / max(self.area, 1e-300)

    @property
    def power(self) -> np.ndarray:
        """(3,) flux in W."""
        return np.asarray(self.exitance, dtype=float) * self.area * (2 if self.two_sided else 1)

    @property
    def color(self) -> np.ndarray:
        """(3,) exitance in W/m2."""
        return np.asarray(self.exitance, dtype=float)

    @property
    def is_sharp(self) -> bool:
        """Never: every polygon casts a penumbra."""
        return False

    def in_frame(self, center: np.ndarray, size: float) -> AreaLight:
        """See `Light.in_frame`: exitance does not depend on the unit of length."""
        return replace(self, vertices=(np.asarray(self.vertices, dtype=float) - center) / size)

    def geometry(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """See `Light.geometry`: the configuration factor, in closed form."""
        return point_to_polygon(points, normals, self.vertices, two_sided=self.two_sided)

    def aim(self, points: np.ndarray, normals: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.aim`. The cosine at the light times its distance is the same for all places on a plane, so a
        place weighs cos(receiver) / r^3, which is (segment . normal) / r^4."""
        vertices = np.asarray(self.vertices, dtype=float)
        middle = vertices.mean(axis=0)
        reach = CLOSE**2 * ((vertices - middle) ** 2).sum(axis=1).max()
        segments = sampling.polygon(vertices, count) - points[:, None]
        shares = np.ones(segments.shape[:2])
        close = np.nonzero(((points - middle) ** 2).sum(axis=1) < reach)[0]
        if len(close):
            corner, sides = self._rectangle
            places, shares[close] = sampling.near_rectangle(corner, sides, points[close], count)
            shares[close] *= self._holds(places) * (np.linalg.norm(sides, axis=1).prod() / self.area)
            segments[close] = places - points[close, None]
        square = np.einsum("nci,nci->nc", segments, segments)
        along = np.einsum("nci,ni->nc", segments, normals)
        return segments, shares * np.maximum(along, 0) / np.maximum(square, 1e-30) ** 2

    def ends(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.ends`."""
        # Places near a point are spread over the rectangle around the polygon.
        corner, (one, other) = self._rectangle
        corners = np.array([corner, corner + one, corner + other, corner + one + other])
        return np.broadcast_to(corners.min(axis=0), points.shape), np.broadcast_to(corners.max(axis=0), points.shape)

    @cached_property
    def _rectangle(self) -> tuple[np.ndarray, np.ndarray]:
        """Corner (3,) and sides (2, 3) of the rectangle around the polygon, along its longest side."""
        vertices = np.asarray(self.vertices, dtype=float)
        edges = np.roll(vertices, -1, axis=0) - vertices
        lengths = np.linalg.norm(edges, axis=1)
        one = edges[lengths.argmax()] / lengths.max()
        axes = np.stack([one, np.cross(self.normal, one)])
        along = (vertices - vertices[0]) @ axes.T
        low, high = along.min(axis=0), along.max(axis=0)
        return vertices[0] + low @ axes, (high - low)[:, None] * axes

    def _holds(self, places: np.ndarray) -> np.ndarray:
        """(n, c) bool: whether places (n, c, 3) in the plane of the polygon lie in it."""
        vertices = np.asarray(self.vertices, dtype=float)
        edges = np.roll(vertices, -1, axis=0) - vertices
        inward = np.cross(self.normal, edges)
        # Places on the border belong to it: a rectangle is its own, whatever the rounding.
        slack = 1e-9 * np.linalg.norm(edges, axis=1).max() * np.linalg.norm(inward, axis=1)
        heights = places @ inward.T - (vertices * inward).sum(axis=1)
        return (heights >= -slack).all(axis=2)

    def scout(self, points: np.ndarray) -> np.ndarray:
        """See `Light.scout`. Between the corners of a wide light a whole table finds room: it sends more."""
        within = min(int(SCOUT_DENSITY * self.area), MAX_SCOUTS)
        return sampling.polygon_scouts(np.asarray(self.vertices, dtype=float), within) - points[:, None]
