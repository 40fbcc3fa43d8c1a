"""All lights at once, roughly: which of a thousand lamps matter at a point.

Each light is taken as a point at its middle, its cosines raised by its own extent so that no light that reaches a
receiver is ever rated zero. Good enough to choose by; what is chosen is then computed exactly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .area import AreaLight
from .light import Light
from .mesh import MeshLight
from .spot import SpotLight
from .sun import SunLight


class LightTable:
    """Rates (n, L) of many lights at many points, by a few matrix products."""

    def __init__(self, lights: Sequence[Light]):
        count = len(lights)
        self.centers, self.axes = np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32)
        self.radii, self.strengths = np.zeros(count, np.float32), np.zeros(count, np.float32)
        self.rims = np.full(count, -2, np.float32)
        self.is_area, self.is_both, self.is_sun = (np.zeros(count, bool) for _ in range(3))
        for row, light in enumerate(lights):
            self.strengths[row] = light.color.max()
            if isinstance(light, AreaLight):
                self.is_area[row], self.is_both[row] = True, light.two_sided
                self.centers[row] = light.vertices.mean(axis=0)
                self.axes[row] = light.normal
                self.radii[row] = np.linalg.norm(light.vertices - light.vertices.mean(axis=0), axis=1).max()
                self.strengths[row] *= light.area / np.pi
            elif isinstance(light, MeshLight):
                self.centers[row], self.radii[row] = light.center, light.radius
                # A body shows each direction at most half of its surface, a sheet all of it.
                self.strengths[row] *= light.area / np.pi
            elif isinstance(light, SunLight):
                self.is_sun[row], self.axes[row] = True, light.direction
                self.radii[row] = np.sin(light.angle / 2)
            else:
                self.centers[row], self.radii[row] = light.position, light.radius
                if isinstance(light, SpotLight):
                    self.axes[row], self.rims[row] = light.direction, np.cos(light.angle / 2)

    def rates(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(n, L) float32 rough unoccluded irradiance, above zero wherever the exact one is."""
        points, normals = points.astype(np.float32), normals.astype(np.float32)
        square = (points**2).sum(axis=1)[:, None] + (self.centers**2).sum(axis=1) - 2 * points @ self.centers.T
        square = np.maximum(square, np.maximum(self.radii**2, np.float32(1e-10)))
        distance = np.sqrt(square)
        rise = normals @ self.centers.T - np.einsum("ij,ij->i", normals, points)[:, None]
        rate = np.maximum(rise + self.radii, 0) / (distance * square)
        lean = points @ self.axes.T - (self.centers * self.axes).sum(axis=1)
        if self.is_area.any():
            lean_area = np.where(self.is_both, np.abs(lean), lean) + self.radii
            rate = np.where(self.is_area, rate * np.maximum(lean_area, 0) / distance, rate)
        # Half a degree of room for the rounding of the cosine at the rim.
        rate = np.where(lean + self.radii >= (self.rims - np.float32(0.01)) * distance, rate, 0)
        if self.is_sun.any():
            rate = np.where(self.is_sun, np.maximum(normals @ self.axes.T + self.radii, 0), rate)
        return rate * self.strengths
