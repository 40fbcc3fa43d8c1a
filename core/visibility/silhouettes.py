"""Silhouettes: the shadows of convex polyhedra on a whole row of points at once (Nishita and Nakamae 1985).

Seen from a point, the shadow of a convex polyhedron is bounded by the planes through the point and the contour, the
edges between a face that looks at the point and one that does not, and begins behind the faces that look at it. A row
of points is a straight line, which each plane cuts once: so the shadow on a row is one interval with exact ends,
whatever the number of points on it. Two selections come first, as in the paper: polyhedra between the two surfaces, and
those that the triangle of point and row meets.

Choose it for point to point form factors among boxes and the like: a row of k points costs little more than one. The
polyhedra are found among the environment's polygons: groups joined by edges. Polygons that have the whole environment
in front, as the walls of a convex room do, block nothing in it and are left out. A lone convex polygon is a flat
polyhedron. An open group is one, too, if its holes are flat and nothing lies beyond them, as under a box on a floor.

Limits: blockers that are not convex polyhedra are refused by name; a BSP tree or rays take any.

References
----------
.. [1] Nishita, Nakamae, "Continuous Tone Representation of Three-Dimensional Objects Taking Account of Shadows and
   Interreflection", SIGGRAPH 1985.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from .convex_loops import is_convex

#: Distance, in scene sizes, up to which two corners are one, a corner lies in a plane, and a point on a surface: some
#: float32 roundings of scene coordinates would be 1e-7, float64 ones 1e-15; this joins neither gaps nor cracks.
TOLERANCE = 1e-9

#: Shadows are cut off this much beyond a row's ends, so that the vertices at its ends are within.
LONGER = 0.5

#: How far behind a surface, in scene sizes, its shadow begins: what lies on it is lit, whatever its rounding.
BEHIND = 1e-12

#: Rows clipped at once: temporaries near 20 MB.
BLOCK_ROWS = 65536


class NotConvexError(SettingsError):
    """Blockers are not convex polyhedra, which silhouettes need; the text names a polygon."""


@dataclass(frozen=True)
class Polyhedron:
    """A convex polyhedron in the unit frame, or a flat one of two faces back to back.

    Attributes
    ----------
    normals : (f, 3) float64
        Unit normals that point out.
    offsets : (f,) float64
    edges : (e, 2, 3) float64
        Ends of each edge.
    edge_faces : (e, 2) int64
        The two faces that meet there. The first has the edge in its counter-clockwise order.
    corners : (c, 3) float64
    patches : (p,) int64
        Patches that it is made of.
    """

    normals: np.ndarray
    offsets: np.ndarray
    edges: np.ndarray
    edge_faces: np.ndarray
    corners: np.ndarray
    patches: np.ndarray


def convex_polyhedra(environment: Environment) -> tuple[list[Polyhedron], np.ndarray, float]:
    """Convex polyhedra that may block in an environment, and the frame (center, size) that they are in.

    Raises
    ------
    NotConvexError
        If a blocker is no convex polyhedron.
    """
    alive = np.flatnonzero(environment.areas > 0)
    corners = np.concatenate([environment.polygons[patch] for patch in alive]) if len(alive) else np.zeros((1, 3))
    low, high = corners.min(axis=0), corners.max(axis=0)
    center, size = low / 2 + high / 2, float((high - low).max()) or 1.0
    corners = (corners - center) / size
    counts = np.array([len(environment.polygons[patch]) for patch in alive], dtype=int)
    starts = np.cumsum(counts) - counts
    normals = environment.normals[alive]
    offsets = np.einsum("fi,fi->f", normals, corners[starts]) if len(alive) else np.zeros(0)
    blocking = np.array(
        [_blocks(corners, normal, offset) for normal, offset in zip(normals, offsets, strict=True)], dtype=bool
    )
    _, names = np.unique(np.round(corners / TOLERANCE), axis=0, return_inverse=True)
    names = names.reshape(-1)
    loops = [names[start : start + count] for start, count in zip(starts, counts, strict=True)]
    # One place for each name: cells of rounding may part equal corners, which then count as apart.
    places = np.zeros((names.max(initial=0) + 1, 3))
    places[names] = corners
    rows = np.flatnonzero(blocking)
    return (
        [
            _polyhedron(environment, alive, [loops[f] for f in group], group, normals, offsets, places)
            for group in _groups([loops[row] for row in rows], rows, normals, offsets)
        ],
        center,
        size,
    )


def _blocks(corners, normal, offset):
    """Whether a polygon has some of the corners behind it."""
    return (corners @ normal - offset).min() < -TOLERANCE


def _groups(loops, rows, normals, offsets):
    """Rows of faces joined by edges, a list each. Faces in one plane stay apart if nothing else joins them."""
    owners: dict[tuple[int, int], list[int]] = {}
    for place, loop in enumerate(loops):
        for pair in zip(loop, np.roll(loop, -1), strict=True):
            owners.setdefault((min(pair), max(pair)), []).append(place)
    parent = np.arange(len(loops))

    def root(place):
        while parent[place] != place:
            parent[place] = parent[parent[place]]
            place = parent[place]
        return place

    for sharers in owners.values():
        for other in sharers[1:]:
            parent[root(other)] = root(sharers[0])
    roots = np.array([root(place) for place in range(len(loops))], dtype=int)
    for name in np.unique(roots):
        group = rows[roots == name]
        flat = np.abs(normals[group] @ normals[group[0]]) > 1 - TOLERANCE
        aligned = np.abs(offsets[group] - offsets[group[0]] * np.sign(normals[group] @ normals[group[0]])) <= TOLERANCE
        if (flat & aligned).all():
            yield from ([face] for face in group)
        else:
            yield list(group)


def _polyhedron(environment, alive, loops, group, normals, offsets, places):
    patches = alive[group]
    for patch in patches:
        if not is_convex(environment.polygons[patch], environment.normals[patch]):
            raise NotConvexError(_refusal(patch, "it is concave"))
    used = np.unique(np.concatenate(loops))
    corners = places[used]
    if len(group) == 1:
        normal, offset = normals[group[0]], offsets[group[0]]
        edges = np.stack((places[loops[0]], places[np.roll(loops[0], -1)]), axis=1)
        faces = np.tile([0, 1], (len(edges), 1))
        return Polyhedron(np.stack((normal, -normal)), np.array([offset, -offset]), edges, faces, corners, patches)
    own_normals, own_offsets = normals[group], offsets[group]
    heights = corners @ own_normals.T - own_offsets
    if (heights >= -TOLERANCE).all():
        # Seen from inside: turned inside out it is the same solid.
        own_normals, own_offsets, loops = -own_normals, -own_offsets, [loop[::-1] for loop in loops]
    elif not (heights <= TOLERANCE).all():
        raise NotConvexError(_refusal(patches[0], "the polygons joined to it are not in convex position"))
    owners: dict[tuple[int, int], int] = {}
    for face, loop in enumerate(loops):
        for pair in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True):
            if pair in owners:
                raise NotConvexError(_refusal(patches[face], "an edge of it has more than two polygons"))
            owners[pair] = face
    own_normals, own_offsets = _cap(owners, own_normals, own_offsets, places, corners, patches)
    pairs = [(pair, face) for pair, face in owners.items() if pair[0] < pair[1] or pair[::-1] not in owners]
    edges = np.array([places[list(pair)] for pair, _ in pairs])
    faces = np.array([(face, owners[pair[::-1]]) for pair, face in pairs])
    return Polyhedron(own_normals, own_offsets, edges, faces, corners, patches)


def _cap(owners, normals, offsets, places, corners, patches):
    """Close flat holes beyond which nothing of the environment lies; adds their edges to `owners`."""
    free = [pair for pair in owners if pair[::-1] not in owners]
    followers = {end: start for start, end in free}
    while followers:
        start, place = next(iter(followers.items()))
        loop = [start]
        del followers[start]
        while place != start:
            loop.append(place)
            if place not in followers:
                raise NotConvexError(_refusal(patches[0], "the polygons joined to it have a hole without a clear rim"))
            place = followers.pop(place)
        rim = places[loop]
        normal = np.cross(rim, np.roll(rim, -1, axis=0)).sum(axis=0)
        length = np.linalg.norm(normal)
        normal = normal / length if length > 0 else normal
        offset = normal @ rim[0]
        open_ = np.abs(rim @ normal - offset).max() > TOLERANCE or (places @ normal).max() > offset + TOLERANCE
        if not length > 0 or open_:
            raise NotConvexError(_refusal(patches[0], "the polygons joined to it do not close to a solid"))
        for pair in zip(loop, [*loop[1:], loop[0]], strict=True):
            owners[pair] = len(normals)
        normals, offsets = np.concatenate((normals, normal[None])), np.append(offsets, offset)
    return normals, offsets


def _refusal(patch, reason):
    return (
        f"Silhouettes need convex polyhedra as blockers, and polygon {patch} is part of none: {reason}. "
        "Choose visibility bsp or embree"
    )


class SilhouetteVisibility:
    """Shadow function of an environment whose blockers are convex polyhedra.

    Parameters
    ----------
    environment : Environment

    Raises
    ------
    NotConvexError
        If a blocker is no convex polyhedron.
    """

    def __init__(self, environment: Environment):
        self.polyhedra, self.center, self.size = convex_polyhedra(environment)
        self.rays = 0

    def between(self, corners: np.ndarray) -> np.ndarray:
        """(p,) bool: whether any polyhedron may stand within the hull of (p, k, 3) corners of two surfaces."""
        corners = (corners - self.center) / self.size
        low, high = corners.min(axis=1), corners.max(axis=1)
        found = np.zeros(len(corners), dtype=bool)
        for solid in self.polyhedra:
            near = (low <= solid.corners.max(axis=0) + TOLERANCE).all(axis=1)
            near &= (high >= solid.corners.min(axis=0) - TOLERANCE).all(axis=1)
            rows = np.flatnonzero(near & ~found)
            heights = corners[rows] @ solid.normals.T - solid.offsets
            # Nothing of it is between two surfaces that both lie outside of one of its faces.
            found[rows] = ~(heights >= -TOLERANCE).all(axis=1).any(axis=1)
        return found

    def visible(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n,) bool: whether the open segment from each origin (n, 3) to its target (n, 3) meets no polyhedron."""
        targets = np.asarray(targets, dtype=np.float64)
        return self.visible_rows(origins, targets, targets, np.array([0.5]))[:, 0]

    def visible_rows(self, points: np.ndarray, starts: np.ndarray, ends: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """(n, s) bool: which places of rows, at steps (s,) from 0 at the start to 1 at the end, the points see."""
        points, starts, ends = (np.asarray(a, dtype=np.float64) for a in (points, starts, ends))
        free = np.ones((len(points), len(steps)), dtype=bool)
        for first in range(0, len(points), BLOCK_ROWS):
            rows = slice(first, first + BLOCK_ROWS)
            for chosen, shadows in self._shadows(points[rows], starts[rows], ends[rows]):
                for low, high in shadows:
                    free[first + chosen] &= ~((steps > low[:, None]) & (steps < high[:, None]))
        self.rays += free.size
        return free

    def shadow_intervals(self, points: np.ndarray, starts: np.ndarray, ends: np.ndarray):
        """Shadows on rows, from 0 at the start of a row to 1 at its end; they may overlap.

        Parameters
        ----------
        points : (n, 3) float
            Where each row is seen from.
        starts, ends : (n, 3) float
            Ends of the rows.

        Returns
        -------
        rows : (s,) int64
        intervals : (s, 2) float64
            Exact ends of each shadow, in ascending order of rows.
        """
        rows, intervals = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
        for chosen, shadows in self._shadows(*(np.asarray(a, dtype=np.float64) for a in (points, starts, ends))):
            for low, high in shadows:
                low, high = np.maximum(low, 0), np.minimum(high, 1)
                real = high > low
                rows.append(chosen[real])
                intervals.append(np.stack((low[real], high[real]), axis=1))
        rows, intervals = np.concatenate(rows), np.concatenate(intervals)
        order = np.argsort(rows, kind="stable")
        return rows[order], intervals[order]

    def _shadows(self, points, starts, ends):
        """For each polyhedron, the rows it may shade and its one or two shadows (low, high) on each."""
        points, starts, ends = ((a - self.center) / self.size for a in (points, starts, ends))
        for solid in self.polyhedra:
            chosen = np.flatnonzero(_meets(solid, points, starts, ends))
            if len(chosen):
                yield chosen, _clip(solid, points[chosen], starts[chosen], ends[chosen])


def _meets(solid, points, starts, ends):
    """(n,) bool: whether a polyhedron may meet the triangle of point and row: boxes overlap, its plane is crossed."""
    low, high = solid.corners.min(axis=0), solid.corners.max(axis=0)
    reached = (np.minimum(np.minimum(points, starts), ends) <= high + TOLERANCE).all(axis=1)
    reached &= (np.maximum(np.maximum(points, starts), ends) >= low - TOLERANCE).all(axis=1)
    rows = np.flatnonzero(reached)
    planes = np.cross(starts[rows] - points[rows], ends[rows] - points[rows])
    heights = planes @ solid.corners.T - np.einsum("ni,ni->n", planes, points[rows])[:, None]
    # A row of one point has no plane, and all heights 0.
    reached[rows] = (heights.max(axis=1) >= -TOLERANCE) & (heights.min(axis=1) <= TOLERANCE)
    return reached


def _clip(solid, points, starts, ends):
    """Shadows [(low (n,), high (n,)), ...] of a polyhedron on rows; those without extent have high <= low."""
    heights = points @ solid.normals.T - solid.offsets
    first, last = (end @ solid.normals.T - solid.offsets for end in (starts, ends))
    outside = heights > TOLERANCE
    seen = outside.any(axis=1)
    # From outside: behind every face that looks at the point, and within the contour.
    low, high = _within(first + BEHIND, last + BEHIND, outside)
    for edge, faces in zip(solid.edges, solid.edge_faces, strict=True):
        here, there = outside[:, faces[0]], outside[:, faces[1]]
        rows = np.flatnonzero(here != there)
        if not len(rows):
            continue
        planes = np.cross(edge[0] - points[rows], edge[1] - points[rows])
        lengths = np.linalg.norm(planes, axis=1, keepdims=True)
        # Counter-clockwise around a face that looks at the point, the plane's normal points out of the shadow.
        planes *= np.where(here[rows], 1, -1)[:, None] / np.where(lengths > 0, lengths, 1)
        ends_over = [np.einsum("ni,ni->n", planes, (end - points)[rows]) for end in (starts, ends)]
        edge_low, edge_high = _below(*ends_over)
        low[rows], high[rows] = np.maximum(low[rows], edge_low), np.minimum(high[rows], edge_high)
    high = np.where(seen, high, low)
    # From inside or from its surface: through a far face, unless the way leads out of the surface at once.
    touching = np.abs(heights) <= TOLERANCE
    begin, end = _within(first, last, touching & ~seen[:, None])
    inner_low, inner_high = _within(first - 2 * TOLERANCE, last - 2 * TOLERANCE, ~touching & ~seen[:, None])
    end = np.where(seen, begin, end)
    lost = inner_high <= inner_low
    shadows = [
        (low, high),
        (begin, np.where(lost, end, np.minimum(end, inner_low))),
        (np.maximum(begin, inner_high), np.where(lost, begin, end)),
    ]
    return [(np.maximum(low, -LONGER), np.minimum(high, LONGER + 1)) for low, high in shadows]


def _within(first, last, planes):
    """Part (low, high) of rows below all of the chosen planes (n, f); beyond the row's ends where nothing bounds it."""
    lows, highs = _below(first, last)
    return (
        np.where(planes, lows, -np.inf).max(axis=1, initial=-np.inf),
        np.where(planes, highs, np.inf).min(axis=1, initial=np.inf),
    )


def _below(first, last):
    """Part (low, high) of rows below planes, given the heights of their ends; infinite where no end bounds it."""
    change = last - first
    share = -first / np.where(change == 0, 1, change)
    level = change == 0
    # A row in the plane is neither in nor out of the shadow: it is lit, as a point that touches a solid is.
    none = level & (first >= -TOLERANCE)
    low = np.where(change < 0, share, -np.inf)
    high = np.where(change > 0, share, np.inf)
    return np.where(none, np.inf, np.where(level, -np.inf, low)), np.where(none, -np.inf, np.where(level, np.inf, high))
