"""Point lamp: a small sphere that shines equally in all directions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from . import sampling


def sphere_irradiance(cosines: np.ndarray, distances: np.ndarray, radius: float) -> np.ndarray:
    """Irradiance from a uniform sphere of unit intensity, cut by the receiver's horizon, in 1/m2 (n,).

    `cosines` (n,) are those between the normal and the direction to the center, `distances` (n,) those to it. A point
    within the sphere is treated as if on its surface. Closed form of the sphere-to-element configuration factor
    (Howell, Catalog of Radiation Heat Transfer Configuration Factors, B-43).
    """
    if radius <= 0:
        return np.maximum(cosines, 0) / distances**2
    distances = np.maximum(distances, radius * (1 + 1e-6))
    sine2 = (radius / distances) ** 2
    above = np.maximum(cosines, 0) * sine2 * np.pi
    cut = cosines**2 < sine2
    if np.any(cut):
        c, s2 = cosines[cut], sine2[cut]
        sine = np.sqrt(np.maximum(1 - c**2, 1e-12))
        x = np.sqrt(1 / s2 - 1)
        y = np.clip(-x * c / sine, -1, 1)
        root = sine * np.sqrt(np.maximum(1 - y**2, 0))
        above[cut] = np.maximum((c * np.arccos(y) - x * root) * s2 + np.arctan(root / np.maximum(x, 1e-12)), 0)
    return above / (np.pi * radius**2)


@dataclass(frozen=True)
class PointLight:
    """A sphere of radius `radius` (m, may be 0) at `position` with `intensity` in W/sr per channel.

    With `soft` it is a disk instead that turns to face whom it lights: Blender's Soft Falloff, which stays finite where
    a lamp touches a wall. The irradiance is then intensity * cos / (distance^2 + radius^2), as measured against Cycles.
    """

    position: np.ndarray
    intensity: np.ndarray
    radius: float = 0.0
    soft: bool = False

    @property
    def power(self) -> np.ndarray:
        """(3,) flux in W."""
        return 4 * np.pi * np.asarray(self.intensity, dtype=float)

    @property
    def color(self) -> np.ndarray:
        """(3,) intensity in W/sr."""
        return np.asarray(self.intensity, dtype=float)

    @property
    def is_sharp(self) -> bool:
        """Whether the radius is 0."""
        return self.radius <= 0

    def in_frame(self, center: np.ndarray, size: float) -> PointLight:
        """See `Light.in_frame`: irradiance falls with the square of distance, so intensity shrinks with it."""
        return replace(
            self,
            position=(np.asarray(self.position, dtype=float) - center) / size,
            intensity=np.asarray(self.intensity, dtype=float) / size**2,
            radius=self.radius / size,
        )

    def geometry(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """See `Light.geometry`."""
        towards = np.asarray(self.position, dtype=float) - points
        distances = np.maximum(np.linalg.norm(towards, axis=1), 1e-12)
        cosines = np.einsum("ij,ij->i", towards, normals) / distances
        if self.soft:
            return np.maximum(cosines, 0) / (distances**2 + self.radius**2)
        return sphere_irradiance(cosines, distances, self.radius)

    def aim(self, points: np.ndarray, normals: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.aim`: places on the disk that the sphere shows to each point."""
        towards = np.asarray(self.position, dtype=float) - points
        if self.is_sharp:
            return towards[:, None], np.ones((len(points), 1))
        segments = self.disks_towards(towards, sampling.disk(count))
        return segments, np.maximum(np.einsum("nci,ni->nc", segments, normals), 0)

    def scout(self, points: np.ndarray) -> np.ndarray:
        """See `Light.scout`."""
        towards = np.asarray(self.position, dtype=float) - points
        return towards[:, None] if self.is_sharp else self.disks_towards(towards, sampling.disk_scouts())

    def ends(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Light.ends`."""
        position = np.asarray(self.position, dtype=float)
        return np.broadcast_to(position - self.radius, points.shape), np.broadcast_to(
            position + self.radius, points.shape
        )

    def disks_towards(self, towards: np.ndarray, pattern: np.ndarray) -> np.ndarray:
        """Segments (n, count, 3) to places of the disk that the lamp shows, from the segments (n, 3) to its middle."""
        directions = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
        return towards[:, None] + sampling.facing_disks(directions, pattern * self.radius)
