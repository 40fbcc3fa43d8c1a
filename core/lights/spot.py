"""Spot lamp: a point lamp within a cone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from . import sampling
from .point import PointLight

#: Places on the lamp at which the cone is evaluated.
CONE_PLACES = 64


@dataclass(frozen=True)
class SpotLight:
    """As `PointLight`, within the cone of full angle `angle` (radians) around the unit vector `direction` (where it
    shines to), fading towards the rim over the share `blend` (0 to 1) of the cone."""

    position: np.ndarray
    direction: np.ndarray
    intensity: np.ndarray
    angle: float
    blend: float = 0.0
    radius: float = 0.0
    soft: bool = False

    @property
    def _lamp(self) -> PointLight:
        return PointLight(self.position, self.intensity, self.radius, self.soft)

    @property
    def power(self) -> np.ndarray:
        """(3,) flux in W that leaves through the cone, its fading ignored."""
        return self._lamp.power * (1 - np.cos(self.angle / 2)) / 2

    @property
    def color(self) -> np.ndarray:
        """(3,) intensity in W/sr on the axis."""
        return self._lamp.color

    @property
    def is_sharp(self) -> bool:
        """Whether the radius is 0."""
        return self.radius <= 0

    def in_frame(self, center: np.ndarray, size: float) -> SpotLight:
        """See `Light.in_frame`."""
        lamp = self._lamp.in_frame(center, size)
        return replace(self, position=lamp.position, intensity=lamp.intensity, radius=lamp.radius)

    def falloff(self, directions: np.ndarray) -> np.ndarray:
        """(n,) share of the intensity that leaves towards the unit `directions` (n, 3), away from the lamp.

        Across the cone the cosine fades by a cubic smoothstep, between the rim and the start of the blend, as Cycles
        defines it.
        """
        cosine = directions @ np.asarray(self.direction, dtype=float)
        rim = np.cos(self.angle / 2)
        if self.blend <= 0:
            return (cosine >= rim).astype(float)
        fade = np.clip((cosine - rim) / max((1 - rim) * self.blend, 1e-12), 0, 1)
        return fade * fade * (3 - 2 * fade)

    def geometry(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """See `Light.geometry`. Every place on the lamp has its own cone, as in Cycles: the rim of the light is blurred
        by the lamp's size."""
        towards = np.asarray(self.position, dtype=float) - points
        if self.is_sharp:
            cone = self.falloff(-towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12))
        else:
            segments = self._lamp.disks_towards(towards, sampling.disk(CONE_PLACES))
            weights = np.maximum(np.einsum("nci,ni->nc", segments, normals), 0)
            if self.soft:
                # A disk gives by both cosines over the square of the distance; a sphere is even in solid angle.
                weights /= np.maximum(np.einsum("nci,nci->nc", segments, segments), 1e-30) ** 2
            total = weights.sum(axis=1)
            cone = (weights * self._cone(segments)).sum(axis=1) / np.maximum(total, 1e-300)
        return self._lamp.geometry(points, normals) * cone

    def aim(self, points: np.ndarray, normals: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.aim`."""
        segments, weights = self._lamp.aim(points, normals, count)
        return segments, weights * self._cone(segments)

    def _cone(self, segments: np.ndarray) -> np.ndarray:
        """(n, count) share of the intensity along segments (n, count, 3) towards the lamp."""
        length = np.maximum(np.linalg.norm(segments, axis=2, keepdims=True), 1e-12)
        return self.falloff((-segments / length).reshape(-1, 3)).reshape(segments.shape[:2])

    def scout(self, points: np.ndarray) -> np.ndarray:
        """See `Light.scout`."""
        return self._lamp.scout(points)

    def ends(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.ends`."""
        return self._lamp.ends(points)
