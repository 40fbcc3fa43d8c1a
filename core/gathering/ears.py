"""Ears: the triangle of a corner and its two neighbors around a face, and samples of the corner's share of the face.

A value stored at a corner shows over its ears, most near the corner and not at all at the opposite side. A sample
stands for as much of the picture as its area times the corner's own weight there in the interpolation.

An ear of a face with more than three corners may hang over where the face is not: ask the surface itself.
"""

from __future__ import annotations

import numpy as np

from ..scene import ReceiverMesh
from .receivers import next_corners, previous_corners

#: Divisions of each side of an ear. A sample is the middle of one of the triangles this makes.
DIVISIONS = 4


def lattice() -> tuple[np.ndarray, np.ndarray]:
    """Samples (m, 2) of an ear in lengths of the two sides at its corner, and the corner's weight (m,) there."""
    one, other = np.meshgrid(np.arange(DIVISIONS), np.arange(DIVISIONS))
    upright = np.stack([one, other], axis=-1)[one + other < DIVISIONS] + 1 / 3
    inverted = np.stack([one, other], axis=-1)[one + other < DIVISIONS - 1] + 2 / 3
    samples = np.concatenate([upright, inverted]) / DIVISIONS
    return samples, 1 - samples.sum(axis=1)


def around_corners(mesh: ReceiverMesh, corners: np.ndarray) -> np.ndarray:
    """(n, 3) corners (n,), each with the one that follows and the one before it around its face."""
    return np.stack([corners, next_corners(mesh)[corners], previous_corners(mesh)[corners]], axis=1)


def ears(places: np.ndarray, normals: np.ndarray, flipped: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sides (n, 2, 3) and areas (n,) of the ears with corners at places (n, 3, 3), and which (n,) are sound: finite,
    and not of corners that reach inward, by the normals (n, 3), or in mirrored meshes against them."""
    with np.errstate(invalid="ignore"):  # broken vertices are not finite
        sides = places[:, 1:] - places[:, :1]
        across = np.cross(sides[:, 0], sides[:, 1])
        facing = np.einsum("ij,ij->i", across, normals) * (-1 if flipped else 1)
        return sides, np.linalg.norm(across, axis=1) / 2, (facing > 0) & np.isfinite(across).all(axis=1)
