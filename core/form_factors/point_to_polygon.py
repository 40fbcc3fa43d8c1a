"""Point to polygon: the configuration factor of a differential area to a polygon, in closed form.

Lambert's sum over edges, with the polygon clipped at the receiver's horizon. Exact for convex and concave planar
polygons, in float64, without occlusion: multiply by a visibility, or use it where nothing blocks. The cost is one
arc tangent per point and edge, independent of distance and of the sizes involved, so it is the kernel of choice close
to a polygon, where kernels that sample it (disk, point to point) fail.

Clipping needs no clipped polygon: each edge is shortened to its part above the horizon, and the closing pieces, which
all lie on the one line where the polygon's plane meets the horizon plane, add up to differences of the crossings'
azimuths, however many there are.

Limits: the polygon must be planar and simple, with its normal by the right-hand rule. A point in the polygon's plane
gets 0. Rounding grows to about 1e-12 of the factor for edges that are seen from 1e4 polygon sizes away; beyond that a
quadrature over triangles, whose own error falls with distance, takes over.
"""

from __future__ import annotations

import numpy as np

#: Points per block: with four corners the temporaries of one block, about 20 arrays, stay near 1 MB, inside a core's
#: second-level cache.
BLOCK_CORNERS = 8192

#: Distance in polygon sizes from which the quadrature is used. There the contour sum has lost 4 digits to cancellation
#: (terms of size/distance against a sum of their square), while the degree-2 quadrature errs by (size/distance)^3.
FAR_DISTANCE = 1e4

#: Sine of the angle by which a corner may dip below the horizon before clipping is needed. The part cut off weighs the
#: square of this, far below float64 resolution.
HORIZON_TOLERANCE = 1e-12

#: Distance from the polygon's plane, in polygon sizes, within which a point counts as lying in it: some hundred
#: roundings of float64. The rounding of the coordinates themselves is added to it.
PLANE_TOLERANCE = 1e-13


def point_to_polygon(
    points: np.ndarray, normals: np.ndarray, polygon: np.ndarray, two_sided: bool = False
) -> np.ndarray:
    """Configuration factor from n differential areas to one fully visible polygon.

    The share of the power leaving a differential area that reaches the polygon; times the polygon's radiosity it is
    the irradiance at the point. The part of the polygon below the point's horizon does not count [1]_.

    Parameters
    ----------
    points : (n, 3) float
        Positions, in any unit of length.
    normals : (n, 3) float
        Unit normals at the points.
    polygon : (k, 3) float
        Planar loop of at least 3 corners, counter-clockwise seen from its front; may be concave.
    two_sided : bool
        Whether points behind the polygon see its back; else they get 0.

    Returns
    -------
    (n,) float64
        Factors from 0 to 1.

    Raises
    ------
    ValueError
        If a shape is wrong.

    References
    ----------
    .. [1] Baum, Rushmeier, Winget, "Improving Radiosity Solutions Through the Use of Analytically Determined
       Form-Factors", SIGGRAPH 1989; the formula is Lambert's, "Photometria", 1760.
    """
    points = np.asarray(points, dtype=np.float64)
    normals = np.asarray(normals, dtype=np.float64)
    polygon = np.asarray(polygon, dtype=np.float64)
    if polygon.ndim != 2 or polygon.shape[1] != 3 or len(polygon) < 3:
        raise ValueError(f"A polygon needs (k, 3) corners, k at least 3, not shape {polygon.shape}")
    if points.ndim != 2 or points.shape[1] != 3 or normals.shape != points.shape:
        raise ValueError(f"Points and normals must both be (n, 3), not {points.shape} and {normals.shape}")
    factors = np.zeros(len(points))
    origin = polygon[0]
    corners = polygon - origin
    # Twice the vector area: its direction is the plane's normal for any simple loop, concave ones included.
    vector_area = np.cross(corners[1:-1], corners[2:]).sum(axis=0)
    norm = np.linalg.norm(vector_area)
    size = np.linalg.norm(corners, axis=1).max()
    if not norm > 0:
        return factors
    plane = (vector_area / norm, PLANE_TOLERANCE * size + 4 * np.finfo(np.float64).eps * np.abs(polygon).max())
    block = max(BLOCK_CORNERS // len(polygon), 1)
    for start in range(0, len(points), block):
        stop = start + block
        local = np.ascontiguousarray((points[start:stop] - origin).T)
        factors[start:stop] = _block_factors(local, normals[start:stop].T, corners, plane, size, two_sided)
    return factors


def _block_factors(points, normals, corners, plane, size, two_sided):
    """Factors (n,) of one block: `points`, `normals` (3, n) relative to the polygon's first corner."""
    axis, tolerance = plane
    heights = axis @ points
    facing = np.abs(heights) > tolerance if two_sided else heights > tolerance
    factors = np.zeros(points.shape[1])
    if not facing.any():
        return factors
    if not facing.all():
        chosen = np.flatnonzero(facing)
        factors[chosen] = _facing_factors(points[:, chosen], normals[:, chosen], corners, axis, heights[chosen], size)
        return factors
    return _facing_factors(points, np.ascontiguousarray(normals), corners, axis, heights, size)


def _facing_factors(points, normals, corners, axis, heights, size):
    """Factors (n,) of points off the polygon's plane, sorted by what their horizon does to the polygon."""
    rays = [corners[:, i, None] - points[i] for i in range(3)]  # x, y, z of point to corner, each (k, n)
    elevations = rays[0] * normals[0] + rays[1] * normals[1] + rays[2] * normals[2]
    squares = rays[0] * rays[0] + rays[1] * rays[1] + rays[2] * rays[2]
    lowest, highest = elevations.min(axis=0), elevations.max(axis=0)
    dip = HORIZON_TOLERANCE * np.sqrt(squares[0])
    clipped = (lowest < -dip) & (highest > 0)
    whole = ~clipped & (highest > 0)
    far = squares[0] > (FAR_DISTANCE * size) ** 2
    near = whole & ~far
    if near.all():
        return np.minimum(_contour(rays, normals, corners) * np.sign(heights), 1).clip(min=0)
    factors = np.zeros(len(heights))
    for chosen, kernel in ((near, _contour), (clipped, _clipped_contour)):
        rows = np.flatnonzero(chosen)
        if len(rows):
            part = [r[:, rows] for r in rays]
            factors[rows] = kernel(part, normals[:, rows], corners) * np.sign(heights[rows])
    rows = np.flatnonzero(whole & far)
    if len(rows):
        factors[rows] = _quadrature(points[:, rows], normals[:, rows], corners, axis)
    return factors.clip(0, 1)


def _edge_crosses(rays, edges):
    """Cross products x, y, z, each (k, n), of the ray to an edge's start with the edge (3 columns of (k, 1))."""
    x, y, z = rays
    return y * edges[2] - z * edges[1], z * edges[0] - x * edges[2], x * edges[1] - y * edges[0]


def _sum_edges(crosses, normals, sines, cosines):
    """Sum (n,) over edges of angle times the cross product's direction along the normal, over 2 pi.

    `sines` (k, n) are the lengths of `crosses`, `cosines` (k, n) the dot products, scaled alike.
    """
    along = crosses[0] * normals[0]
    along += crosses[1] * normals[1]
    along += crosses[2] * normals[2]
    lengths = np.sqrt(crosses[0] ** 2 + crosses[1] ** 2 + crosses[2] ** 2)
    # A point in line with an edge sees it under no angle: 0 instead of 0 / 0.
    lengths[lengths == 0] = 1
    angles = np.arctan2(lengths if sines is None else sines * lengths, cosines)
    angles *= along
    angles /= lengths
    # Corners run clockwise as seen from a point at the front.
    return angles.sum(axis=0) / (-2 * np.pi)


def _contour(rays, normals, corners):
    """Contour sum (n,) for polygons wholly above the horizon."""
    edges = (np.roll(corners, -1, axis=0) - corners).T[:, :, None]
    crosses = _edge_crosses(rays, edges)
    cosines = rays[0] * np.roll(rays[0], -1, axis=0)
    cosines += rays[1] * np.roll(rays[1], -1, axis=0)
    cosines += rays[2] * np.roll(rays[2], -1, axis=0)
    return _sum_edges(crosses, normals, None, cosines)


def _clipped_contour(rays, normals, corners):
    """Contour sum (n,) for polygons that cross the horizon: edges shortened, closed along the horizon."""
    edges = (np.roll(corners, -1, axis=0) - corners).T[:, :, None]
    starts = rays[0] * normals[0] + rays[1] * normals[1] + rays[2] * normals[2]
    ends = np.roll(starts, -1, axis=0)
    rising, falling = (starts < 0) & (ends >= 0), (starts >= 0) & (ends < 0)
    drop = np.where(rising | falling, starts - ends, 1)
    crossing = np.where(rising | falling, starts / drop, 0).clip(0, 1)
    first = np.where(rising, crossing, 0)
    last = np.where(falling, crossing, np.where((starts < 0) & (ends < 0), 0, 1))
    crosses = _edge_crosses(rays, edges)
    cosines = sum((r + first * e) * (r + last * e) for r, e in zip(rays, edges, strict=True))
    total = _sum_edges(crosses, normals, last - first, cosines)
    # The line on which all crossings lie, seen from the point: azimuths are counted from its nearest point, so they
    # stay within a quarter turn and can be added in any order.
    vector_area = np.cross(corners[1:-1], corners[2:]).sum(axis=0)
    level = vector_area[:, None] - (vector_area @ normals) * normals
    level *= np.sign(sum(r[0] * a for r, a in zip(rays, vector_area, strict=True)))
    along = np.cross(normals, level, axis=0)
    hits = [r + crossing * e for r, e in zip(rays, edges, strict=True)]
    azimuths = np.arctan2(
        sum(h * a for h, a in zip(hits, along, strict=True)), sum(h * a for h, a in zip(hits, level, strict=True))
    )
    closing = np.where(rising, azimuths, 0) - np.where(falling, azimuths, 0)
    return total - closing.sum(axis=0) / (2 * np.pi)


def _quadrature(points, normals, corners, axis):
    """Factors (n,) of far points: three samples on each triangle of a fan, whose signed areas also serve concavity."""
    second, third = corners[1:-1], corners[2:]
    areas = np.cross(second, third) @ axis / 2
    # Edge midpoints with equal weights integrate quadratic functions exactly.
    samples = np.concatenate((second / 2, third / 2, (second + third) / 2))
    weights = np.tile(areas / 3, 3)
    rays = [samples[:, i, None] - points[i] for i in range(3)]
    squares = rays[0] ** 2 + rays[1] ** 2 + rays[2] ** 2
    here = sum(r * n for r, n in zip(rays, normals, strict=True))
    there = np.abs(sum(r * a for r, a in zip(rays, axis, strict=True)))
    return (weights[:, None] * (here * there / (np.pi * squares * squares))).sum(axis=0)
