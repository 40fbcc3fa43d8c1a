"""Mesh light: a surface of many emissive triangles taken as one light, a glowing bulb or a bent strip.

As so many area lights its triangles could not all be asked by every receiver, and drawing among them would speckle. As
one light it is asked by all: the unoccluded part comes from a tree over its triangles, the visible part from places
spread over it. Limits: one visible share stands for all of it, so it should be small against the scene; the caller
splits what is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from . import sampling
from .light_tree import LightTree

#: Places among which a receiver's scouts are chosen, and how many it sends to those that face it.
SCOUT_PLACES = 32
SCOUTS = 8


@dataclass(frozen=True)
class MeshLight:
    """Triangles (t, 3, 3) with `exitance` (W/m2 per channel) times `intensities` (t,), above 0, on their fronts by the
    right-hand rule, and on their backs too where `two_sided`."""

    triangles: np.ndarray
    intensities: np.ndarray
    exitance: np.ndarray
    two_sided: bool = False

    @cached_property
    def _tree(self) -> LightTree:
        return LightTree.of(np.asarray(self.triangles, dtype=float), np.asarray(self.intensities, dtype=float))

    @property
    def area(self) -> float:
        """Area in m2 of one side, each triangle times its intensity."""
        return float(self._weights.sum())

    @cached_property
    def _weights(self) -> np.ndarray:
        corners = self._tree.triangles
        vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        return np.linalg.norm(vectors, axis=1) * self._tree.intensities

    @property
    def center(self) -> np.ndarray:
        """(3,) the middle of what it emits."""
        return self._tree.centers[0]

    @property
    def radius(self) -> float:
        """Distance from the middle to the farthest corner."""
        return float(self._tree.radii[0])

    @property
    def power(self) -> np.ndarray:
        """(3,) flux in W."""
        return self.color * self.area * (2 if self.two_sided else 1)

    @property
    def color(self) -> np.ndarray:
        """(3,) exitance in W/m2 of a triangle of intensity 1."""
        return np.asarray(self.exitance, dtype=float)

    @property
    def is_sharp(self) -> bool:
        """Never: every surface casts a penumbra."""
        return False

    def in_frame(self, center: np.ndarray, size: float) -> MeshLight:
        """See `Light.in_frame`: exitance does not depend on the unit of length."""
        return replace(self, triangles=(np.asarray(self.triangles, dtype=float) - center) / size)

    def geometry(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """See `Light.geometry`: the sum of the triangles' configuration factors."""
        return self._tree.configuration_factors(points, normals, self.two_sided)

    def aim(self, points: np.ndarray, normals: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.aim`: places in proportion to what they emit, which weigh cos cos / r^2."""
        places, facing = self._places(count)
        segments = places - points[:, None]
        square = np.maximum(np.einsum("nci,nci->nc", segments, segments), 1e-30)
        rise = np.einsum("nci,ni->nc", segments, normals)
        lean = -np.einsum("nci,ci->nc", segments, facing)
        lean = np.abs(lean) if self.two_sided else np.maximum(lean, 0)
        return segments, np.maximum(rise, 0) * lean / square**2

    def scout(self, points: np.ndarray) -> np.ndarray:
        """See `Light.scout`: the first places, in an order that spreads them, whose fronts the point can see."""
        places, facing = self._scout_places
        segments = places - points[:, None]
        if self.two_sided or len(places) <= 1:
            return segments[:, :SCOUTS]
        hidden = np.einsum("nci,ci->nc", segments, facing) >= 0
        chosen = np.argsort(hidden, axis=1, kind="stable")[:, :SCOUTS]
        # Too few face the point: those are asked again, instead of places behind the light's own rim.
        lacking = np.take_along_axis(hidden, chosen, axis=1)
        chosen = np.where(lacking, chosen[:, :1], chosen)
        return np.take_along_axis(segments, chosen[:, :, None], axis=1)

    def ends(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.ends`."""
        corners = np.asarray(self.triangles, dtype=float).reshape(-1, 3)
        return np.broadcast_to(corners.min(axis=0), points.shape), np.broadcast_to(corners.max(axis=0), points.shape)

    def _places(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Places (count, 3) spread by emitted power along the order of the tree, and the unit normals there."""
        bounds = np.cumsum(self._weights)
        marks = (np.arange(count) + 0.5) / count * bounds[-1]
        which = np.minimum(np.searchsorted(bounds, marks, side="right"), len(bounds) - 1)
        return sampling.on_triangles(self._tree.triangles[which], sampling.square(count)), self._normals[which]

    @cached_property
    def _normals(self) -> np.ndarray:
        corners = self._tree.triangles
        vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)

    @cached_property
    def _scout_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles of some triangles, each next one farthest from those before in place and direction; their normals."""
        rows = np.unique(((np.arange(SCOUT_PLACES) + 0.5) / SCOUT_PLACES * len(self._normals)).astype(int))
        places, facing = self._tree.triangles[rows].mean(axis=1), self._normals[rows]
        where = np.concatenate([places, self.radius * facing], axis=1)
        order = [0]
        apart = np.full(len(rows), np.inf)
        for _ in range(len(rows) - 1):
            apart = np.minimum(apart, np.linalg.norm(where - where[order[-1]], axis=1))
            order.append(int(apart.argmax()))
        return places[order], facing[order]
