"""Sun lamp: parallel light from a disk in the sky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import sampling
from .point import sphere_irradiance

#: Length of a segment towards the sun in the scene's own unit: well beyond a scene of size 1, and so short that float32
#: still resolves the offset at its start.
REACH = 8.0


@dataclass(frozen=True)
class SunLight:
    """`irradiance` (W/m2 per channel, on a surface that faces it) from the unit vector `direction` (towards the sun),
    whose disk has the full angle `angle` (radians, may be 0)."""

    direction: np.ndarray
    irradiance: np.ndarray
    angle: float = 0.0

    @property
    def power(self) -> np.ndarray:
        """(3,) flux in W through one square meter across the rays."""
        return np.asarray(self.irradiance, dtype=float)

    @property
    def color(self) -> np.ndarray:
        """(3,) irradiance in W/m2 across the rays."""
        return np.asarray(self.irradiance, dtype=float)

    @property
    def is_sharp(self) -> bool:
        """Whether the angle is 0."""
        return self.angle <= 0

    def in_frame(self, center: np.ndarray, size: float) -> SunLight:
        """See `Light.in_frame`: parallel light is the same everywhere."""
        return self

    def geometry(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """See `Light.geometry`: the cosine, softened where the horizon cuts the disk."""
        cosines = normals @ np.asarray(self.direction, dtype=float)
        sine = np.sin(min(self.angle, np.pi) / 2)
        if sine <= 0:
            return np.maximum(cosines, 0)
        # The disk is that of a sphere of radius sine at distance 1; its horizon cut is in closed form there.
        return sphere_irradiance(cosines, np.ones(len(points)), sine)

    def aim(self, points: np.ndarray, normals: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.aim`: segments of length `REACH` units, so the scene must be in its unit frame."""
        rays = self._rays(sampling.disk(1 if self.is_sharp else count))
        return np.broadcast_to(rays * REACH, (len(points), *rays.shape)), np.maximum(normals @ rays.T, 0)

    def scout(self, points: np.ndarray) -> np.ndarray:
        """See `Light.scout`."""
        rays = self._rays(sampling.disk(1) if self.is_sharp else sampling.disk_scouts())
        return np.broadcast_to(rays * REACH, (len(points), *rays.shape))

    def ends(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.ends`."""
        # Unit rays are never more than 2 apart.
        spread = REACH * min(np.tan(self.angle / 2), 2.0) if self.angle < np.pi else 2 * REACH
        middles = points + REACH * np.asarray(self.direction, dtype=float)
        return middles - spread, middles + spread

    def _rays(self, pattern: np.ndarray) -> np.ndarray:
        direction = np.asarray(self.direction, dtype=float)[None]
        rays = direction + sampling.facing_disks(direction, pattern * np.tan(self.angle / 2))[0]
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)
