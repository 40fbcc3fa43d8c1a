"""Segments between two faces that tell what is visible of their exchange: by area, or by solid angle where near.

Points spread evenly over both areas, weighted by what a segment carries, serve faces that are apart. Near each other a
few short segments would weigh more than all the others. There a point of the smaller face sends directions, spread
evenly over the solid angle of the other, whose weights differ by a cosine only.

Cost: some ten or some fifty operations a segment, and its test.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from ..visibility.segments import Visibility
from .faces import Faces, smaller_first
from .sampling import PatchSampler
from .sobol import sobol_points
from .spherical_triangles import points_by_solid_angle

#: Distance of the centers, in sums of both radii, below which faces are near: segments by area then differ in what they
#: carry by more than 16.
NEAR = 2.0


class SegmentSamples:
    """Segments between faces of an environment, as of `visible_share.Samples`.

    Parameters
    ----------
    environment : Environment
    faces : Faces
        Its faces.
    visibility : Visibility
    """

    def __init__(self, environment: Environment, faces: Faces, visibility: Visibility):
        self.faces, self.visibility = faces, visibility
        self.sampler = PatchSampler(environment)

    def __call__(
        self, first: np.ndarray, second: np.ndarray, count: int, shifts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Weights of what is visible and of all, (m,) each: see `Samples`. Their means over `count` are factors."""
        faces = self.faces
        first, second = smaller_first(faces.areas, first, second)
        square = (sobol_points(count, 4) + shifts[:, None]) % 1
        apart = np.linalg.norm(faces.centers[first] - faces.centers[second], axis=1)
        near = apart < NEAR * (faces.radii[first] + faces.radii[second])
        sums = np.zeros((2, len(first)))
        for chosen, targets in ((near, self._by_solid_angle), (~near, self._by_area)):
            rows = np.flatnonzero(chosen)
            if not len(rows):
                continue
            origins = self.sampler(faces.owners[first[rows]], square[rows, :, :2])
            ends, weights = targets(origins, first[rows], second[rows], square[rows, :, 2:])
            lit = weights > 0
            seen = np.zeros(weights.shape)
            seen[lit] = self.visibility.visible(origins[lit], ends[lit])
            sums[:, rows] = (weights * seen).sum(axis=1), weights.sum(axis=1)
        return sums[0], sums[1]

    def _by_area(self, origins, first, second, square):
        """Targets (m, s, 3) and weights (m, s)."""
        faces = self.faces
        targets = self.sampler(faces.owners[second], square)
        rays = targets - origins
        squares = np.einsum("msi,msi->ms", rays, rays)
        here = np.maximum(np.einsum("msi,mi->ms", rays, faces.normals[first]), 0)
        there = np.maximum(-np.einsum("msi,mi->ms", rays, faces.normals[second]), 0)
        return targets, here * there / (squares * squares) * (faces.areas[second] / np.pi)[:, None]

    def _by_solid_angle(self, origins, first, second, square):
        """Targets (m, s, 3) and weights (m, s)."""
        faces, shape = self.faces, origins.shape
        triangles, shares, square = self.sampler.triangles(faces.owners[second], square)
        starts, triangles = origins.reshape(-1, 3), triangles.reshape(-1, 3, 3)
        ends, angles = points_by_solid_angle(starts, triangles, square.reshape(-1, 2))
        rays = ends - starts
        lengths = np.linalg.norm(rays, axis=1)
        cosines = np.einsum("msi,mi->ms", rays.reshape(shape), faces.normals[first])
        facing = np.einsum("msi,mi->ms", rays.reshape(shape), faces.normals[second]) < 0
        weights = np.maximum(cosines, 0) * facing / np.maximum(lengths, np.finfo(np.float64).tiny).reshape(shape[:2])
        # A triangle is chosen by its area, and weighs by its solid angle.
        return ends.reshape(shape), weights * angles.reshape(shape[:2]) / (np.pi * shares)
