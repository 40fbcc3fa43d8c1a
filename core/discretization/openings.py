"""Openings that polygons leave in a plane: the plane's section of a convex cell, less the polygons that lie in it.

All polygons are convex loops in a frame of size 1 around the origin (`convex_pieces`). Polygons are taken away one by
one, the largest first: each cuts what is left along its sides, but only where it meets it, so that an opening consists
of few loops. Cost: the polygons in the plane times the loops left.
"""

from __future__ import annotations

import numpy as np

from ..visibility.convex_loops import join, split

#: Distance from a plane, in scene sizes, that counts as none: some thousand roundings of float32 coordinates.
IN_PLANE = 1e-5

#: Share of a section's area below which a piece of it is dropped, as what rounding leaves of walls that meet.
SLIVER = 1e-9

#: Half the side of the square that stands for a whole plane: the frame's diagonal is below 2.
REACH = 4.0


def section(bounds: list[np.ndarray], plane: np.ndarray) -> np.ndarray:
    """The convex part (k, 3) of a plane (4,) above other planes; with no corners where there is none."""
    normal = plane[:3]
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    loop = [plane[3] * normal + REACH * (a * first + b * second) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    loops = np.array([loop])
    for bound in bounds:
        loops, _, _, _ = split(loops, loops @ bound[:3] - bound[3], IN_PLANE)
        if not len(loops):
            return np.empty((0, 3))
    return loops[0]


def openings_in(bounds: list[np.ndarray], plane: np.ndarray, covers: np.ndarray) -> np.ndarray:
    """Convex loops (k, c, 3) of a plane above other planes that no polygon of `covers` (m, c', 3), in it, covers."""
    whole = section(bounds, plane)
    if not len(whole):
        return np.empty((0, 3, 3))
    left = whole[None]
    least = SLIVER * loop_areas(left)[0]
    for cover in covers[np.argsort(-loop_areas(covers), kind="stable")]:
        left = _without(left, cover, plane[:3])
        if not len(left):
            break
        left = left[loop_areas(left) > least]
    return left


def loop_areas(loops: np.ndarray) -> np.ndarray:
    """Areas (m,) of convex loops (m, k, 3)."""
    local = loops - loops[:, :1]
    return np.linalg.norm(np.cross(local[:, 1:-1], local[:, 2:]).sum(axis=1), axis=1) / 2


def _without(loops, cover, normal):
    """Convex loops (m, k, 3) in a plane without the convex `cover` (c, 3) in it."""
    inward = np.cross(normal, np.roll(cover, -1, axis=0) - cover)
    middle = cover.mean(axis=0)
    inward *= np.sign(np.einsum("ki,ki->k", inward, middle - cover))[:, None]
    lengths = np.linalg.norm(inward, axis=1)
    sides = [
        (row / size, (row / size) @ corner) for row, size, corner in zip(inward, lengths, cover, strict=True) if size
    ]
    # What lies beyond one side as a whole is not cut by the lines of the others.
    apart = np.zeros(len(loops), bool)
    for row, offset in sides:
        apart |= (loops @ row - offset <= IN_PLANE).all(axis=1)
    outside, inside = [loops[apart]], loops[~apart]
    for row, offset in sides:
        inside, _, beyond, _ = split(inside, inside @ row - offset, IN_PLANE)
        outside.append(beyond)
        if not len(inside):
            break
    return join(outside)
