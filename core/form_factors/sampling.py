"""Sample points on polygons and directions above them, spread evenly by low-discrepancy sequences.

One table of points in the unit cube serves all patches, each shifted by its own random amount modulo 1: every patch is
sampled evenly, the errors of different patches are independent, and independent shifts of the same patch show how large
its error is.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment


def kronecker_steps(dimensions: int) -> np.ndarray:
    """(dimensions,) powers of a generalized golden ratio, whose multiples modulo 1 fill the unit cube evenly.

    The ratio g is the root of ``g^(d + 1) = g + 1``; for one dimension it is the golden ratio itself.

    References
    ----------
    .. [1] Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018.
    """
    ratio = 1.5
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    return (1 / ratio) ** np.arange(1, dimensions + 1)


def kronecker_points(count: int, dimensions: int) -> np.ndarray:
    """(count, dimensions) points in the unit cube: multiples of `kronecker_steps`, modulo 1."""
    return (0.5 + np.arange(count)[:, None] * kronecker_steps(dimensions)) % 1


def points_in_triangles(triangles: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Points (..., 3) spread evenly over triangles (..., 3, 3), from (..., 2) numbers between 0 and 1."""
    root = np.sqrt(square[..., :1])
    second = root * square[..., 1:]
    first = root - second
    a, b, c = (triangles[..., i, :] for i in range(3))
    return a + first * (b - a) + second * (c - a)


class PatchSampler:
    """Maps the unit square evenly onto each patch of an environment."""

    def __init__(self, environment: Environment):
        self.corners = environment.vertices[environment.triangles]  # (m, 3, 3)
        self.owners = environment.triangle_patches
        count = len(environment)
        first, second = self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        areas = np.linalg.norm(np.cross(first, second), axis=1)
        totals = np.bincount(self.owners, areas, count)
        shares = areas / np.where(totals > 0, totals, 1)[self.owners]
        # Patch number plus share of the patch's area up to and including the triangle: ascending over all triangles, so
        # that one search serves all patches.
        self.starts = np.searchsorted(self.owners, np.arange(count))
        self.counts = np.bincount(self.owners, minlength=count)
        running = np.cumsum(shares)
        before = np.concatenate(([0.0], running))[self.starts]
        self.ends = self.owners + np.minimum(running - before[self.owners], 1)
        self.shares = shares

    def __call__(self, patches: np.ndarray, square: np.ndarray) -> np.ndarray:
        """Points (p, s, 3) on p patches, from (p, s, 2) points of the unit square.

        Patches must have triangles.
        """
        triangles, _, inner = self.triangles(patches, square)
        return points_in_triangles(triangles, inner)

    def triangles(self, patches: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Triangles (p, s, 3, 3) chosen by their areas, and points of the unit square to choose places on them with.

        Parameters
        ----------
        patches : (p,) int
        square : (p, s, 2) float

        Returns
        -------
        triangles : (p, s, 3, 3) float64
        shares : (p, s) float64
            Of the patch's area.
        square : (p, s, 2) float64
        """
        key = patches[:, None] + square[:, :, 0]
        low = self.starts[patches][:, None]
        rows = np.clip(np.searchsorted(self.ends, key, side="right"), low, low + self.counts[patches][:, None] - 1)
        # The share of the first number that chose the triangle is stretched to choose the place in it.
        inner = 1 - (self.ends[rows] - key) / np.maximum(self.shares[rows], 1e-300)
        return self.corners[rows], self.shares[rows], np.stack((inner.clip(0, 1), square[:, :, 1]), axis=2)


def frames(normals: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotations whose rows are two tangents and the unit normal.

    References
    ----------
    .. [1] Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
    """
    x, y, z = np.asarray(normals, dtype=np.float64).T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack((1 + sign * x * x * a, sign * b, -sign * x), axis=1)
    second = np.stack((b, sign + y * y * a, -y), axis=1)
    return np.stack((first, second, np.stack((x, y, z), axis=1)), axis=1)


def hemisphere_directions(square: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) about +z, of equal contribution to a form factor, from points of the unit square.

    Nusselt's analog: points spread evenly over the unit disk, lifted to the hemisphere above.
    """
    radius = np.sqrt(square[..., 0])
    angle = 2 * np.pi * square[..., 1]
    height = np.sqrt(np.maximum(1 - square[..., 0], 0))
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), height), axis=-1)
