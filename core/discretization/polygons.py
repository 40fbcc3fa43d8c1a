"""Triangulation of one planar polygon with holes by ear clipping, holes joined to the outline by bridges.

For the few corners that are left when a flat region has been merged; a loop over its corners, each step a few array
operations: O(n r) for n corners of which r are not convex. The input may touch itself at corners. The result is
checked, not trusted: every triangle must turn counter-clockwise. Since clipping an ear never changes the boundary
chain, positive triangles alone prove that each point is covered exactly as often as the outline winds around it.
Where this cannot be reached (crossing outlines, rounding), the answer is None and the caller keeps what it had.
"""

from __future__ import annotations

import numpy as np

# Twice the area of a triangle that counts as a line, in units of the polygon's extent squared: a thousand times what
# doubles resolve there, so that a cut never runs through another corner by rounding.
FLAT = 1e-12


def _turn(ax, ay, bx, by, cx, cy):
    """Twice the signed area of the triangles a, b, c: positive where they turn counter-clockwise."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def polygon_area(points: np.ndarray) -> float:
    """Signed area of a closed loop of (n, 2) points, positive when counter-clockwise."""
    # Relative to the first corner: far from the origin the products would cancel badly.
    x, y = (points - points[0]).T
    return 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(np.roll(x, -1), y))


def triangulate_polygon(points: np.ndarray, loop_starts: np.ndarray) -> np.ndarray | None:
    """Triangles that fill a polygon with holes, using its corners only.

    Parameters
    ----------
    points : (n, 2) float
        Corners of all loops, one loop after the other: the outline counter-clockwise, holes clockwise.
    loop_starts : (h + 1,) int
        Row of the first corner of each loop; the first is 0.

    Returns
    -------
    (n + 2 h - 2, 3) int64 or None
        Rows of `points`, counter-clockwise; None when the loops do not bound a region that can be filled this way.

    References
    ----------
    .. [1] G. H. Meisters, "Polygons have ears", American Mathematical Monthly 82, 1975.
    .. [2] D. Eberly, "Triangulation by Ear Clipping", Geometric Tools, 2002 (the order in which holes are joined).
    """
    points = np.asarray(points, dtype=np.float64)
    points = points - points.mean(axis=0)
    loops = [np.asarray(loop) for loop in np.split(np.arange(len(points)), loop_starts[1:-1])]
    areas = [polygon_area(points[loop]) for loop in loops]
    outlines = [loop for loop, area in zip(loops, areas, strict=True) if area > 0.0]
    holes = [loop for loop, area in zip(loops, areas, strict=True) if area <= 0.0]
    if len(outlines) != 1:
        return None
    chain = outlines[0]
    # Rightmost hole first: a corner of the chain built so far is then always in sight of the hole's rightmost corner.
    holes.sort(key=lambda loop: -points[loop, 0].max())
    # What a bridge must not cross: all loops, and the bridges built before, which are added as they come.
    following = np.concatenate([np.roll(loop, -1) for loop in loops])
    walls = [points, points[following]]
    for hole in holes:
        joined = _join_hole(points, chain, hole, walls)
        if joined is None:
            return None
        chain = joined
    triangles = _clip_ears(points, chain)
    if triangles is None or len(triangles) != len(points) + 2 * len(holes) - 2:
        return None
    a, b, c = (points[triangles[:, k]] for k in range(3))
    if not (_turn(*a.T, *b.T, *c.T) > 0.0).all():
        return None
    return triangles


def _inside_wedge(points, before, tip, after, targets):
    """Whether the directions from `tip` to `targets` point into a counter-clockwise polygon's inside."""
    corners = (*points[before].T, *points[tip].T, *points[after].T)
    target_x, target_y = points[targets].T
    left_of_entry = _turn(corners[0], corners[1], corners[2], corners[3], target_x, target_y)
    left_of_exit = _turn(corners[2], corners[3], corners[4], corners[5], target_x, target_y)
    convex = _turn(*corners) > 0.0
    both = (left_of_entry > 0.0) & (left_of_exit > 0.0)
    either = (left_of_entry > 0.0) | (left_of_exit > 0.0)
    return np.where(convex, both, either)


def _join_hole(points, chain, hole, walls):
    """The chain led along a bridge to the hole, around it and back; None when no corner sees the hole."""
    hole = np.roll(hole, -int(np.argmax(points[hole, 0])))
    start = hole[0]
    origin = points[start]
    (ax, ay), (bx, by) = walls[0].T, walls[1].T
    before, after = np.roll(chain, 1), np.roll(chain, -1)
    visible = _inside_wedge(points, before, chain, after, np.full(len(chain), start))
    visible &= _inside_wedge(
        points, np.full(len(chain), hole[-1]), np.full(len(chain), start), np.full(len(chain), hole[1]), chain
    )
    places = np.flatnonzero(visible)
    distances = ((points[chain[places]] - origin) ** 2).sum(axis=1)
    for place in places[np.argsort(distances, kind='stable')]:
        target = points[chain[place]]
        # Edges that end where the bridge ends meet it there by right; the wedges above have judged them.
        ends = ((ax == origin[0]) & (ay == origin[1])) | ((bx == origin[0]) & (by == origin[1]))
        ends |= ((ax == target[0]) & (ay == target[1])) | ((bx == target[0]) & (by == target[1]))
        side_a = _turn(*origin, *target, ax, ay)
        side_b = _turn(*origin, *target, bx, by)
        side_origin = _turn(ax, ay, bx, by, *origin)
        side_target = _turn(ax, ay, bx, by, *target)
        low, high = np.minimum(origin, target), np.maximum(origin, target)
        near = (np.minimum(ax, bx) <= high[0]) & (np.maximum(ax, bx) >= low[0])
        near &= (np.minimum(ay, by) <= high[1]) & (np.maximum(ay, by) >= low[1])
        crossed = ~ends & near & (side_a * side_b <= 0.0) & (side_origin * side_target <= 0.0)
        if not crossed.any():
            walls[0] = np.concatenate([walls[0], origin[None]])
            walls[1] = np.concatenate([walls[1], target[None]])
            return np.concatenate([chain[: place + 1], hole, hole[:1], chain[place:]])
    return None


def _clip_ears(points, chain):
    """Ears cut from a weakly simple chain until one triangle is left, as rows of `points`; None when stuck."""
    count = len(chain)
    if count < 3:
        return None
    x, y = np.ascontiguousarray(points[chain].T)
    following = np.roll(np.arange(count), -1).tolist()
    previous = np.roll(np.arange(count), 1).tolist()
    extent = float(max(np.ptp(x), np.ptp(y)))
    flat = FLAT * extent * extent
    turns = _turn(np.roll(x, 1), np.roll(y, 1), x, y, np.roll(x, -1), np.roll(y, -1))
    blocking = turns <= flat
    # Corners visited more than once (bridges, touching loops) need a look at where the other visit goes.
    _, inverse, visits = np.unique(points[chain], axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    repeated = visits[inverse] > 1
    alive = np.ones(count, dtype=bool)
    triangles = np.empty((count - 2, 3), dtype=np.int64)
    made, corner, waited, remaining = 0, 0, 0, count
    while remaining > 3:
        if waited > remaining:
            return None
        before, after = previous[corner], following[corner]
        ear = not blocking[corner] and _is_ear(
            x, y, flat, before, corner, after, blocking, repeated, inverse, alive, previous, following
        )
        if not ear:
            corner = after
            waited += 1
            continue
        triangles[made] = before, corner, after
        made += 1
        remaining -= 1
        waited = 0
        alive[corner] = False
        blocking[corner] = False
        following[before], previous[after] = after, before
        for changed in (before, after):
            left, right = previous[changed], following[changed]
            turn = _turn(x[left], y[left], x[changed], y[changed], x[right], y[right])
            blocking[changed] = turn <= flat
        # Skipping one corner spreads the ears around the outline; always taking the next would make one long fan.
        corner = following[after]
    last = np.flatnonzero(alive)[0]
    triangles[made] = previous[last], last, following[last]
    return chain[triangles]


def _is_ear(x, y, flat, before, tip, after, blocking, repeated, visits_of, alive, previous, following):
    """Whether the convex corner `tip` can be cut off without cutting off a part of the chain."""
    corners = (x[before], y[before], x[tip], y[tip], x[after], y[after])
    rows = np.flatnonzero(blocking)
    px, py = x[rows], y[rows]
    inside = _turn(corners[0], corners[1], corners[2], corners[3], px, py) >= -flat
    inside &= _turn(corners[2], corners[3], corners[4], corners[5], px, py) >= -flat
    inside &= _turn(corners[4], corners[5], corners[0], corners[1], px, py) >= -flat
    if inside.any():
        px, py = px[inside], py[inside]
        corner = (px == corners[0]) & (py == corners[1])
        corner |= (px == corners[2]) & (py == corners[3])
        corner |= (px == corners[4]) & (py == corners[5])
        if not corner.all():
            return False
    if repeated[tip]:
        for visit in np.flatnonzero((visits_of == visits_of[tip]) & alive):
            if visit == tip:
                continue
            for other in (previous[visit], following[visit]):
                into = _turn(corners[0], corners[1], corners[2], corners[3], x[other], y[other]) > 0.0
                into &= _turn(corners[2], corners[3], corners[4], corners[5], x[other], y[other]) > 0.0
                if into:
                    return False
    return True
