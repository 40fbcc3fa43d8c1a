"""Triangulation of planar polygons, many at once.

Triangles and convex loops become fans in whole arrays, concave quadrilaterals are cut from their inward corner, and
what remains, concave loops of five corners and more, is cut ear by ear, one polygon at a time, at a cost of k^3 for k
corners. Loops that repeat a corner or run straight on are fine; loops that cross themselves are found and named.
"""

from __future__ import annotations

import numpy as np

#: Sine below which a corner counts as straight: it bounds no area worth a triangle, and rounding alone can give it a
#: sign. Coordinates that went through float32 carry angles of about 1e-7.
STRAIGHT = 1e-6


def triangulate(corners: np.ndarray, offsets: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, list]:
    """Split planar polygons into triangles of the same orientation.

    Parameters
    ----------
    corners : (c, 3) float
        Corners of all polygons, one after the other, each loop about its normal by the right-hand rule.
    offsets : (n + 1,) int
        Corners of polygon i are ``corners[offsets[i]:offsets[i + 1]]``.
    normals : (n, 3) float
        Unit normals; polygons whose normal is zero get no triangles.

    Returns
    -------
    triangles : (m, 3) int32
        Rows of `corners`, in order of polygons.
    polygons : (m,) int32
        Polygon that each triangle belongs to.
    crossing : list of int
        Polygons that cross themselves and were left out.
    """
    counts = np.diff(offsets)
    usable = np.any(normals != 0, axis=1)
    triangles, polygons, crossing = [np.empty((0, 3), np.int32)], [np.empty(0, np.int32)], []
    for count in np.unique(counts[usable & (counts >= 3)]):
        members = np.flatnonzero(usable & (counts == count))
        loops = offsets[members, None] + np.arange(count)
        sines, turns = _corner_turns(corners[loops], normals[members])
        # A loop that turns one way only, once around, is convex.
        convex = np.all(sines >= -STRAIGHT, axis=1) & (np.abs(turns - 1) < 0.25)
        fans = np.stack([loops[:, [0, i, i + 1]] for i in range(1, count - 1)], axis=1)[convex]
        triangles.append(fans.reshape(-1, 3))
        polygons.append(np.repeat(members[convex], count - 2))
        rest = np.flatnonzero(~convex)
        if count == 4 and len(rest):
            cuts, valid = _cut_quads(corners, loops[rest], sines[rest], normals[members[rest]])
            triangles.append(cuts[valid].reshape(-1, 3))
            polygons.append(np.repeat(members[rest[valid]], 2))
            crossing.extend(members[rest[~valid]].tolist())
            continue
        for row in rest:
            ears = _clip_ears(corners[loops[row]], normals[members[row]])
            if ears is None:
                crossing.append(int(members[row]))
            else:
                triangles.append(loops[row][ears])
                polygons.append(np.full(len(ears), members[row]))
    triangles, polygons = np.concatenate(triangles), np.concatenate(polygons)
    order = np.argsort(polygons, kind="stable")
    return triangles[order].astype(np.int32), polygons[order].astype(np.int32), sorted(crossing)


def _corner_turns(loops: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sine (n, k) of the turn at each corner, positive to the left, and the number of full turns (n,) of each loop."""
    edges = np.roll(loops, -1, axis=1) - loops
    lengths = np.linalg.norm(edges, axis=2, keepdims=True)
    directions = edges / np.where(lengths > 0, lengths, 1)
    # A repeated corner has no direction: it takes the one before, so that its neighbor carries the turn.
    for i in range(2 * loops.shape[1]):
        i = i % loops.shape[1]
        directions[:, i] = np.where(lengths[:, i] > 0, directions[:, i], directions[:, i - 1])
    before = np.roll(directions, 1, axis=1)
    sines = np.einsum("nki,ni->nk", np.cross(before, directions), normals)
    angles = np.arctan2(sines, np.einsum("nki,nki->nk", before, directions))
    return sines, angles.sum(axis=1) / (2 * np.pi)


def _cut_quads(corners, loops, sines, normals):
    """Two triangles (n, 2, 3) per concave quadrilateral, cut from its inward corner, and whether both are upright."""
    start = sines.argmin(axis=1)
    turned = np.take_along_axis(loops, (start[:, None] + np.arange(4)) % 4, axis=1)
    cuts = turned[:, [[0, 1, 2], [0, 2, 3]]]
    first, second, third = (corners[cuts[:, :, i]] for i in range(3))
    areas = np.einsum("nti,ni->nt", np.cross(second - first, third - first), normals)
    return cuts, np.all(areas >= 0, axis=1)


def _clip_ears(loop: np.ndarray, normal: np.ndarray) -> np.ndarray | None:
    """Triangles (k - 2, 3) of one loop (k, 3), or None when it crosses itself."""
    drop = np.abs(normal).argmax()
    # Dropping the normal's largest axis keeps shape and order; a negative axis mirrors, which swapping undoes.
    first, second = ((drop + 1) % 3, (drop + 2) % 3) if normal[drop] > 0 else ((drop + 2) % 3, (drop + 1) % 3)
    flat = loop[:, [first, second]] - loop[0, [first, second]]
    scale = np.abs(flat).max()
    if _crosses_itself(flat):
        return None
    left, ears = list(range(len(loop))), []
    while len(left) > 3:
        ear = _find_ear(flat, left, STRAIGHT * STRAIGHT * scale * scale)
        if ear is None:
            return None
        ears.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    ears.append(left)
    return np.array(ears)


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the signed area of triangles abc in the plane."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])


def _crosses_itself(flat: np.ndarray) -> bool:
    """Whether two edges of a loop (k, 2) cross; those that merely touch, as along a bridge to a hole, do not."""
    starts, ends = flat, np.roll(flat, -1, axis=0)
    here = np.sign(_side(starts[:, None], ends[:, None], starts)) * np.sign(_side(starts[:, None], ends[:, None], ends))
    return bool(np.any((here < 0) & (here.T < 0)))


def _find_ear(flat: np.ndarray, left: list, tolerance: float) -> int | None:
    """Position in `left` of a corner that can be cut off; the widest one, which keeps slivers away."""
    here = flat[left]
    before, after = np.roll(here, 1, axis=0), np.roll(here, -1, axis=0)

    doubled = _side(before, here, after)
    points = here[None, :, :]
    inside = np.all(
        [
            _side(a[:, None, :], b[:, None, :], points) > -tolerance
            for a, b in ((before, here), (here, after), (after, before))
        ],
        axis=0,
    )
    # The ear's own corners lie on its border, and so do corners that coincide with them, as along a bridge to a hole.
    for corner in (before, here, after):
        inside &= np.any(np.abs(points - corner[:, None, :]) > np.sqrt(tolerance), axis=2)
    free = ~inside.any(axis=1) & (doubled >= -tolerance)
    if not free.any():
        return None
    straight = np.flatnonzero(free & (doubled <= tolerance))
    if len(straight):
        return int(straight[0])
    return int(np.where(free, doubled, -1).argmax())
