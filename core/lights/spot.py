"""Spot lamp: a point lamp within a cone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .point import PointLight


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

    @property
    def _lamp(self) -> PointLight:
        return PointLight(self.position, self.intensity, self.radius)

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
        """See `Light.geometry`."""
        away = points - np.asarray(self.position, dtype=float)
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        return self._lamp.geometry(points, normals) * self.falloff(away)

    def aim(self, points: np.ndarray, normals: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.aim`."""
        return self._lamp.aim(points, normals, count)

    def scout(self, points: np.ndarray) -> np.ndarray:
        """See `Light.scout`."""
        return self._lamp.scout(points)
