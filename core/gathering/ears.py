"""Ears: triangles over which a value stored at a corner shows, and samples of the corner's share of them.

It shows most near the corner and not at all at the opposite side: a sample stands for as much of the picture as its
area times the corner's own weight there in the interpolation. In a face of three or four corners the ear is the
triangle of the corner and its two neighbors; a face of more is drawn as triangles, and all that meet at the corner are
its ears. Which triangles they are differs from program to program, and so does the picture.

An ear of four corners may hang over where the face is not: ask the surface itself.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scene import ReceiverMesh
from ..triangulation import triangulate
from .receivers import next_corners, previous_corners

#: Where corners (n,) are, as (n, 3): those of a whole mesh at once would take as much memory as all its receivers.
Places = Callable[[np.ndarray], np.ndarray]

#: Divisions of each side of an ear. A sample is the middle of one of the triangles this makes.
DIVISIONS = 4


def lattice() -> tuple[np.ndarray, np.ndarray]:
    """Samples (m, 2) of an ear in lengths of the two sides at its corner, and the corner's weight (m,) there."""
    one, other = np.meshgrid(np.arange(DIVISIONS), np.arange(DIVISIONS))
    upright = np.stack([one, other], axis=-1)[one + other < DIVISIONS] + 1 / 3
    inverted = np.stack([one, other], axis=-1)[one + other < DIVISIONS - 1] + 2 / 3
    samples = np.concatenate([upright, inverted]) / DIVISIONS
    return samples, 1 - samples.sum(axis=1)


def around_corners(mesh: ReceiverMesh, corners: np.ndarray, places: Places, least: float = 0.0) -> np.ndarray:
    """(n, 3) ears of corners (m,): each with two others of its face, in their order around it.

    Parameters
    ----------
    places : callable
        Places (n, 3) of corners (n,).
    least : float
        Longest side from which on a face of more than four corners has the ears of its triangles; those of smaller
        ones are as of four.
    """
    faces = np.searchsorted(mesh.face_offsets, corners, side="right") - 1
    many = np.diff(mesh.face_offsets)[faces] > 4
    around = np.stack([corners, next_corners(mesh)[corners], previous_corners(mesh)[corners]], axis=1)
    if many.any() and least > 0:
        with np.errstate(invalid="ignore"):  # broken vertices are not finite, and no side to them is longer
            sides = np.linalg.norm(places(around[many, 1]) - places(around[many, 0]), axis=1)
            many[np.flatnonzero(many)] = np.isin(faces[many], faces[many][sides > least])
    if not many.any():
        return around
    drawn, _ = _drawn_triangles(mesh, np.unique(faces[many]), places)
    turned = np.concatenate([drawn, np.roll(drawn, -1, axis=1), np.roll(drawn, -2, axis=1)])
    return np.concatenate([around[~many], turned[np.isin(turned[:, 0], corners[many])]])


def whole_faces(mesh: ReceiverMesh, corners: np.ndarray, places: Places, most: int) -> tuple[np.ndarray, ...]:
    """All triangles of the faces of corners (m,), of those with more than four corners and at most so many.

    Returns
    -------
    owners : (n,) int
        Row of `corners` that each triangle is for.
    triangles : (n, 3) int
        Its corners.
    """
    faces = np.searchsorted(mesh.face_offsets, corners, side="right") - 1
    counts = np.diff(mesh.face_offsets)[faces]
    rows = np.flatnonzero((counts > 4) & (counts <= most))
    if not len(rows):
        return rows, np.empty((0, 3), np.int64)
    different, which = np.unique(faces[rows], return_inverse=True)
    drawn, of = _drawn_triangles(mesh, different, places)
    numbers = np.bincount(of, minlength=len(different))
    starts = np.cumsum(numbers) - numbers
    each = numbers[which]
    inside = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    return np.repeat(rows, each), drawn[np.repeat(starts[which], each) + inside]


def _drawn_triangles(mesh: ReceiverMesh, faces: np.ndarray, places: Places) -> tuple[np.ndarray, np.ndarray]:
    """Corners (t, 3) of the triangles as which faces (n,) are drawn, none of those that cross themselves, and the row
    (t,) of each one's face; in the order of faces."""
    counts = np.diff(mesh.face_offsets)[faces]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    members = np.repeat(mesh.face_offsets[faces] - offsets[:-1], counts) + np.arange(offsets[-1])
    loops = np.asarray(places(members), dtype=np.float64)
    # From a corner of its own: far from the origin the products would round to nothing.
    arms = loops - np.repeat(loops[offsets[:-1]], counts, axis=0)
    after = np.arange(1, len(members) + 1)
    after[offsets[1:] - 1] = offsets[:-1]
    with np.errstate(invalid="ignore"):  # broken vertices are not finite
        normals = np.add.reduceat(np.cross(arms, arms[after]), offsets[:-1], axis=0)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        sound = np.isfinite(lengths) & (lengths > 0)
        normals = np.where(sound, normals / np.where(sound, lengths, 1), 0)
    triangles, rows, _ = triangulate(loops, offsets, normals)
    return members[triangles], rows


def ears(places: np.ndarray, normals: np.ndarray, flipped: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sides (n, 2, 3) and areas (n,) of the ears with corners at places (n, 3, 3), and which (n,) are sound: finite,
    and not of corners that reach inward, by the normals (n, 3), or in mirrored meshes against them."""
    with np.errstate(invalid="ignore"):  # broken vertices are not finite
        sides = places[:, 1:] - places[:, :1]
        across = np.cross(sides[:, 0], sides[:, 1])
        facing = np.einsum("ij,ij->i", across, normals) * (-1 if flipped else 1)
        return sides, np.linalg.norm(across, axis=1) / 2, (facing > 0) & np.isfinite(across).all(axis=1)
