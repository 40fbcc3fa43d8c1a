"""Directions spread evenly over the solid angle in which a triangle is seen.

A point close to a triangle gets most of its factor from the part that is close to it, which few points spread over the
triangle's area hit. Spread over the solid angle they hit it as often as it counts, up to the cosine at the receiver.
Choose it to test what is visible of a near polygon. Cost: some twenty operations a direction. Limits: triangles seen
under less than `LEAST_ANGLE` lose digits in the formula, and are sampled by area, which is the same for them.
"""

from __future__ import annotations

import numpy as np

from .sampling import points_in_triangles

#: Solid angle below which points are spread over the area: the formula has lost half of its digits there.
LEAST_ANGLE = 1e-7


def solid_angles(origins: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) solid angles of n triangles (n, 3, 3), each seen from its own point (n, 3).

    References
    ----------
    .. [1] Van Oosterom, Strackee, "The Solid Angle of a Plane Triangle", IEEE Trans. Biomed. Eng. 30(2), 1983.
    """
    a, b, c = _directions(origins, triangles)
    volume = np.abs(np.einsum("ni,ni->n", a, np.cross(b, c)))
    return 2 * np.arctan2(volume, 1 + _dot(a, b) + _dot(b, c) + _dot(c, a))


def points_by_solid_angle(
    origins: np.ndarray, triangles: np.ndarray, square: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points on triangles, spread evenly over the solid angle.

    Parameters
    ----------
    origins : (n, 3) float
        From which each triangle is seen.
    triangles : (n, 3, 3) float
    square : (n, 2) float
        Numbers between 0 and 1.

    Returns
    -------
    points : (n, 3) float64
    angles : (n,) float64
        Solid angles.

    References
    ----------
    .. [1] Arvo, "Stratified Sampling of Spherical Triangles", SIGGRAPH 1995.
    """
    points = points_in_triangles(triangles, square)
    angles = solid_angles(origins, triangles)
    rows = np.flatnonzero(angles > LEAST_ANGLE)
    a, b, c = _directions(origins[rows], triangles[rows])
    left, right = np.cross(a, b), np.cross(a, c)
    norms = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=1)
    cosine = (_dot(left, right) / np.maximum(norms, np.finfo(np.float64).tiny)).clip(-1, 1)
    sine = np.sqrt(1 - cosine**2)
    turned = square[rows, 0] * angles[rows] - np.arccos(cosine)
    s, t = np.sin(turned), np.cos(turned)
    u, v = t - cosine, s + sine * _dot(a, b)
    below = (v * s + u * t) * sine
    along = ((v * t - u * s) * cosine - v) / np.where(below != 0, below, 1)
    corner = _between(a, c, np.where(below != 0, along, 1).clip(-1, 1))
    directions = _between(b, corner, 1 - square[rows, 1] * (1 - _dot(corner, b)))
    # Where the ray meets the triangle's plane; rounding may put it beside the triangle by as much.
    first = triangles[rows, 0]
    normals = np.cross(triangles[rows, 1] - first, triangles[rows, 2] - first)
    heights, slopes = _dot(first - origins[rows], normals), _dot(directions, normals)
    usable = slopes * heights > 0
    distances = heights[usable] / slopes[usable]
    points[rows[usable]] = origins[rows[usable]] + distances[:, None] * directions[usable]
    return points, angles


def _directions(origins, triangles):
    """Unit vectors (n, 3) from each point to the three corners of its triangle."""
    rays = triangles - origins[:, None]
    lengths = np.linalg.norm(rays, axis=2, keepdims=True)
    rays = rays / np.maximum(lengths, np.finfo(np.float64).tiny)
    return rays[:, 0], rays[:, 1], rays[:, 2]


def _between(axis, other, cosine):
    """Unit vectors at an angle from `axis` towards `other`."""
    across = other - _dot(other, axis)[:, None] * axis
    across /= np.maximum(np.linalg.norm(across, axis=1), np.finfo(np.float64).tiny)[:, None]
    return cosine[:, None] * axis + np.sqrt(np.maximum(1 - cosine**2, 0))[:, None] * across


def _dot(a, b):
    return np.einsum("ni,ni->n", a, b)
