"""Merging of flat parts of a mesh into few large triangles, for tracing rays.

An artist divides a mesh for the sake of the light stored at its vertices; a ray does not care. Tracing the merged mesh
is several times faster, and it is the same surface: it moves by less than 1e-6 of the scene's diagonal, and far less in
small objects (see `planar_regions`). Corners that a neighbor needs stay, so merged parts join without cracks. A part
that cannot be merged by the rules keeps its triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .planar_regions import PlanarRegions, find_planar_regions
from .polygons import FLAT, triangulate_polygon

# A region is merged when at most this share of its triangles is left: else long thin triangles would cost more in the
# ray tree than their number saves.
LARGEST_SHARE_LEFT = 0.5
# Corners that are clipped one by one, squared and summed over regions: clipping takes time with the square, about a
# second for this many. Regions beyond keep their triangles.
LARGEST_CLIPPING = 16e6


@dataclass(frozen=True)
class MergedTriangles:
    """The merged mesh.

    Parameters
    ----------
    vertices : (n, 3) float64
        The array that was given, unchanged.
    triangles : (k, 3) int32
        Rows of `vertices`.
    source : (k,) int32
        For each triangle, an original triangle with its key and its plane.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    source: np.ndarray


@dataclass
class _Borders:
    """Half-edges around regions; each stands for the visit of a border at its origin vertex."""

    vertices: np.ndarray  # (b,) origin
    regions: np.ndarray  # (b,)
    following: np.ndarray  # (b,) next half-edge of the loop
    previous: np.ndarray  # (b,)
    loops: np.ndarray  # (b,) smallest half-edge of the loop
    straight: np.ndarray  # (b,) bool: the border goes straight on at the vertex
    points: np.ndarray  # (b, 2) in the region's plane, seen from the front


def merge_coplanar(vertices: np.ndarray, triangles: np.ndarray, keys: np.ndarray) -> MergedTriangles:
    """Fewer triangles for the same surface, by merging those of one key that lie in one plane and share edges.

    Parameters
    ----------
    vertices : (n, 3) float64
        In any unit. Positions that are not finite are tolerated.
    triangles : (m, 3) int32
        Rows of `vertices`, counter-clockwise seen from the front. Those without area or with positions that are not
        finite are passed through.
    keys : (m,) int
        Only triangles with equal keys are merged.

    Returns
    -------
    MergedTriangles
        First the triangles that were kept, in their order, then the merged ones by region.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.asarray(triangles, dtype=np.int32)
    keys = np.asarray(keys)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise ValueError("vertices and triangles must have three columns")
    if keys.shape != (len(triangles),):
        raise ValueError(f"{len(triangles)} triangles but {keys.shape} keys")
    regions = find_planar_regions(vertices, triangles, keys) if len(triangles) else None
    if regions is None:
        return MergedTriangles(vertices, triangles, np.arange(len(triangles), dtype=np.int32))
    merged, owners, active = _merge_regions(vertices, triangles, regions)
    kept = np.ones(len(triangles), dtype=bool)
    in_region = regions.labels >= 0
    kept[regions.triangles[in_region]] = ~active[regions.labels[in_region]]
    representatives = np.zeros(len(active), dtype=np.int64)
    # Written from last to first, so that a region's first triangle speaks for it.
    representatives[regions.labels[in_region][::-1]] = regions.triangles[in_region][::-1]
    kept = np.flatnonzero(kept)
    return MergedTriangles(
        vertices,
        np.concatenate([triangles[kept], merged]).astype(np.int32),
        np.concatenate([kept, representatives[owners]]).astype(np.int32),
    )


def _merge_regions(vertices, triangles, regions: PlanarRegions):
    """New triangles, the region of each, and which regions they replace."""
    count = len(regions.normals)
    sizes = np.bincount(regions.labels[regions.labels >= 0], minlength=count)
    borders, active = _trace_borders(vertices, regions, count)
    needed = np.zeros(len(vertices), dtype=bool)
    outside = np.ones(len(triangles), dtype=bool)
    outside[regions.triangles[regions.labels >= 0]] = False
    needed[regions.weld[triangles[outside].ravel()]] = True
    dropped = ~active
    known: dict[int, tuple[bytes, np.ndarray | None]] = {}
    while True:
        returning = (regions.labels >= 0) & dropped[regions.labels]
        needed[regions.weld[triangles[regions.triangles[returning]].ravel()]] = True
        active &= ~dropped
        stays = _needed_corners(vertices, borders, regions, active, needed)
        corners = np.flatnonzero(stays & active[borders.regions])
        corner_counts = np.bincount(borders.regions[corners], minlength=count)
        loop_counts = np.bincount(borders.regions[np.unique(borders.loops[corners])], minlength=count)
        left = corner_counts + 2 * loop_counts - 4
        dropped = active & (left > LARGEST_SHARE_LEFT * sizes)
        if dropped.any():
            continue
        ordered, loop_starts = _ordered(borders, corners, stays)
        merged, owners, failed = _fill(borders, ordered, loop_starts, known)
        if len(failed) == 0:
            return merged, owners, active
        # Their triangles come back with all their corners, which the neighbors must then keep: once more.
        dropped[failed] = True


def _trace_borders(vertices, regions: PlanarRegions, count):
    """Borders in order, and which regions have borders that close."""
    origins, targets = regions.border_origins, regions.border_targets
    owners = regions.border_regions.astype(np.int64)
    order = np.argsort(owners * len(vertices) + origins, kind='stable')
    origins, targets, owners = origins[order], targets[order], owners[order]
    leaving = owners * len(vertices) + origins
    arriving = owners * len(vertices) + targets
    first = np.searchsorted(leaving, arriving)
    choices = np.searchsorted(leaving, arriving, side='right') - first
    points = _project(vertices[origins], regions.normals[owners])
    following = np.where(choices > 0, np.minimum(first, len(leaving) - 1), np.arange(len(leaving)))
    many = np.flatnonzero(choices > 1)
    if len(many):
        following[many] = _sharpest(points, following, many, first[many], choices[many])
    arrivals = np.bincount(following, minlength=len(following))
    active = np.ones(count, dtype=bool)
    # An open border, or two that leave by one edge: the region is not a clean piece of a plane.
    broken = owners[(choices == 0) | (arrivals != 1)]
    active[broken] = False
    visits = np.searchsorted(leaving, leaving, side='right') - np.searchsorted(leaving, leaving)
    keep = np.flatnonzero(active[owners])
    renumber = np.full(len(owners), -1)
    renumber[keep] = np.arange(len(keep))
    following = renumber[following[keep]]
    previous = np.empty_like(following)
    previous[following] = np.arange(len(keep))
    origins, owners, points = origins[keep], owners[keep], points[keep]
    straight = (visits[keep] == 1) & _is_straight(vertices, origins, previous, following, regions.tolerances[owners])
    return _Borders(origins, owners, following, previous, _loop_names(following), straight, points), active


def _project(points, normals):
    """(b, 2) coordinates in the plane: the two axes nearest to it, so that no coordinate is rounded."""
    axis = np.argmax(np.abs(normals), axis=1)
    rows = np.arange(len(points))
    flip = normals[rows, axis] < 0.0
    u, v = points[rows, (axis + 1) % 3], points[rows, (axis + 2) % 3]
    return np.stack([np.where(flip, v, u), np.where(flip, u, v)], axis=1)


def _sharpest(points, following, arriving, first, choices):
    """Where a border touches itself: the way out that turns around the region's own corner at that vertex."""
    rows = np.repeat(np.arange(len(arriving)), choices)
    ways = first[rows] + np.arange(len(rows)) - np.repeat(np.cumsum(choices) - choices, choices)
    here = points[ways]
    back = points[arriving[rows]] - here
    out = points[following[ways]] - here
    # The inside lies between: clockwise from where the border came, the first way out.
    angle = np.arctan2(back[:, 1], back[:, 0]) - np.arctan2(out[:, 1], out[:, 0])
    angle = np.where(angle <= 0.0, angle + 2.0 * np.pi, angle)
    order = np.lexsort((angle, rows))
    return ways[order[np.cumsum(choices) - choices]]


def _is_straight(vertices, origins, previous, following, tolerances):
    before, here, after = vertices[origins[previous]], vertices[origins], vertices[origins[following]]
    along = after - before
    length = np.linalg.norm(along, axis=1)
    height = np.linalg.norm(np.cross(here - before, along), axis=1)
    forward = np.einsum('ij,ij->i', here - before, after - here) > 0.0
    return forward & (height <= tolerances * length)


def _loop_names(following):
    names = np.arange(len(following))
    jump = following
    for _ in range(len(following).bit_length()):
        names = np.minimum(names, names[jump])
        jump = jump[jump]
    return names


def _needed_corners(vertices, borders: _Borders, regions: PlanarRegions, active, needed):
    """(b,) bool, at which half-edges a corner must stay; everywhere in regions that are not active.

    A vertex goes only if every border goes straight on there, so that neighbors agree. Adds to `needed` what the
    straightened borders would move too far.
    """
    in_use = active[borders.regions]
    needed[borders.vertices[in_use & ~borders.straight]] = True
    while True:
        stays = needed[borders.vertices] | ~in_use
        # Less than a triangle is left of the loop: nothing in it is straight then, only short.
        few = np.bincount(borders.loops[stays], minlength=len(borders.loops))[borders.loops] < 3
        if (few & ~stays).any():
            needed[borders.vertices[few]] = True
            continue
        gone = np.flatnonzero(~stays)
        if len(gone) == 0:
            return stays
        ends = [_skip(way, stays)[gone] for way in (borders.previous, borders.following)]
        start, stop = (vertices[borders.vertices[end]] for end in ends)
        here = vertices[borders.vertices[gone]]
        chord = stop - start
        length = np.linalg.norm(chord, axis=1)
        height = np.linalg.norm(np.cross(here - start, chord), axis=1)
        forward = np.einsum('ij,ij->i', here - vertices[borders.vertices[borders.previous[gone]]], chord) > 0.0
        bad = ~forward | (height > regions.tolerances[borders.regions[gone]] * length)
        if not bad.any():
            return stays
        # The whole stretch between two corners: half of an arc would bend as well.
        needed[borders.vertices[gone[np.isin(ends[0], ends[0][bad])]]] = True


def _skip(way, stays):
    """From each half-edge along `way` to the first that stays."""
    way = way.copy()
    while True:
        moving = ~stays[way]
        if not moving.any():
            return way
        way = np.where(moving, way[way], way)


def _ordered(borders: _Borders, corners, stays):
    """Corners sorted by region, loop, and place in the loop; and where loops start."""
    if len(corners) == 0:
        return corners, corners
    numbers = np.zeros(len(stays), dtype=np.int64)
    numbers[corners] = np.arange(len(corners))
    jump = numbers[_skip(borders.following, stays)[corners]]
    loops = borders.loops[corners]
    is_leader = np.zeros(len(corners), dtype=bool)
    is_leader[np.unique(loops, return_index=True)[1]] = True
    # Steps to the loop's last corner, by doubling.
    steps = np.where(is_leader[jump], 0, 1)
    jump = np.where(is_leader[jump], np.arange(len(corners)), jump)
    for _ in range(len(corners).bit_length()):
        steps = steps + steps[jump]
        jump = jump[jump]
    order = np.lexsort((-steps, loops, borders.regions[corners]))
    loops = loops[order]
    return corners[order], np.flatnonzero(np.concatenate([[True], loops[1:] != loops[:-1]]))


def _fill(borders: _Borders, ordered, loop_starts, known):
    """Triangles for all regions, the region of each, and the regions that could not be filled."""
    if len(ordered) == 0:
        return np.zeros((0, 3), dtype=np.int32), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    owners = borders.regions[ordered]
    starts = np.flatnonzero(np.concatenate([[True], owners[1:] != owners[:-1]]))
    counts = np.diff(np.append(starts, len(ordered)))
    fans, fan_rows, done = _fans(borders.points[ordered], starts, counts)
    done &= np.diff(np.append(np.searchsorted(loop_starts, starts), len(loop_starts))) == 1
    use = done[fan_rows]
    parts, names, failed = [fans[use]], [owners[starts][fan_rows[use]]], []
    irregular = np.flatnonzero(~done)
    affordable = np.cumsum(counts[irregular].astype(float) ** 2) <= LARGEST_CLIPPING
    failed += owners[starts[irregular[~affordable]]].tolist()
    for row in irregular[affordable]:
        region = int(owners[starts[row]])
        inside = slice(starts[row], starts[row] + counts[row])
        fingerprint = ordered[inside].tobytes()
        if known.get(region, (b'', None))[0] != fingerprint:
            bounds = loop_starts[(loop_starts >= inside.start) & (loop_starts < inside.stop)] - inside.start
            filled = triangulate_polygon(borders.points[ordered[inside]], np.append(bounds, counts[row]))
            known[region] = (fingerprint, filled)
        filled = known[region][1]
        if filled is None:
            failed.append(region)
            continue
        parts.append(filled + inside.start)
        names.append(np.full(len(filled), region))
    triangles = borders.vertices[ordered[np.concatenate(parts)]]
    names = np.concatenate(names)
    by_region = np.argsort(names, kind='stable')
    return triangles[by_region].astype(np.int32), names[by_region], np.array(failed, dtype=np.int64)


def _fans(points, starts, counts):
    """A fan of triangles from the widest corner of each loop: rows of points, loop of each, and which fans are valid.

    Valid where all triangles turn counter-clockwise: then the fan covers what the loop winds around (see `polygons`).
    Most walls and floors are done by this, and so are Ls.
    """
    loops = np.repeat(np.arange(len(starts)), counts)
    place = np.arange(len(points)) - starts[loops]
    after = starts[loops] + (place + 1) % counts[loops]
    before = starts[loops] + (place - 1) % counts[loops]
    into, out = points - points[before], points[after] - points
    sine = into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]
    turn = np.arctan2(sine, (into * out).sum(axis=1))
    order = np.lexsort((turn, loops))
    apex = order[starts]
    # Corner k of the fan's loop, counted from the apex; triangle (apex, k, k + 1) for k = 1 .. count - 2.
    step = (np.arange(len(points)) - apex[loops]) % counts[loops]
    rows = np.flatnonzero((step >= 1) & (step <= counts[loops] - 2))
    triangles = np.stack([apex[loops[rows]], rows, after[rows]], axis=1)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    areas = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    extent = np.abs(c - a).max(axis=1) + np.abs(b - a).max(axis=1)
    valid = np.bincount(loops[rows], weights=areas <= FLAT * extent**2, minlength=len(starts)) == 0
    return triangles, loops[rows], valid
