"""Point to polygon: the configuration factor of a differential area to a polygon, in closed form.

Lambert's sum over edges, with the polygon clipped at the receiver's horizon. Exact for convex and concave planar
polygons, in float64, without occlusion: multiply by a visibility, or use it where nothing blocks. The cost is one
arc tangent per point and edge, independent of distance and of the sizes involved, so it is the kernel of choice close
to a polygon, where kernels that sample it (disk, point to point) fail.

Clipping needs no clipped polygon: each edge is shortened to its part above the horizon, and the closing pieces, which
all lie on the one line where the polygon's plane meets the horizon plane, add up to differences of the crossings'
azimuths, however many there are.

Limits: the polygon must be planar and simple, with its normal by the right-hand rule. A point in the polygon's plane
gets 0. The sum over edges loses digits with distance; from 1e3 polygon sizes on, a quadrature over triangles, whose own
error falls with distance, takes over, so that the relative error stays below 1e-11.
"""

from __future__ import annotations

import numpy as np

#: Points per block: with four corners the temporaries of one block, about 20 arrays, stay near 1 MB, inside a core's
#: second-level cache.
BLOCK_CORNERS = 8192

#: Distance in polygon sizes from which the quadrature is used. Measured on a square at slanting angles, the contour sum
#: has lost 4 digits to cancellation there (relative error 2e-12, growing with distance), and the quadrature, whose
#: error falls with the fourth power of distance, is as good.
FAR_DISTANCE = 1e3

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
    # The first corner comes again at the end, so that an edge's two ends are views and not copies.
    loop = np.concatenate((corners, corners[:1]))
    rays = [loop[:, i, None] - points[i] for i in range(3)]  # x, y, z of point to corner, each (k + 1, n)
    elevations = _dot(rays, normals)
    lowest, highest = elevations.min(axis=0), elevations.max(axis=0)
    distances = np.sqrt(rays[0][0] ** 2 + rays[1][0] ** 2 + rays[2][0] ** 2)
    above = highest > 0
    clipped = above & (lowest < -HORIZON_TOLERANCE * distances)
    whole = above & ~clipped
    far = distances > FAR_DISTANCE * size
    if (whole & ~far).all():
        return (_contour(rays, normals, loop) * np.sign(heights)).clip(0, 1)
    factors = np.zeros(len(heights))
    for chosen, kernel in ((whole & ~far, _contour), (clipped, _clipped_contour)):
        rows = np.flatnonzero(chosen)
        if len(rows):
            factors[rows] = kernel([r[:, rows] for r in rays], normals[:, rows], loop) * np.sign(heights[rows])
    rows = np.flatnonzero(whole & far)
    if len(rows):
        factors[rows] = _quadrature(points[:, rows], normals[:, rows], corners, axis)
    return factors.clip(0, 1)


def _dot(left, right):
    """Dot products of vectors given as three arrays each."""
    total = left[0] * right[0]
    total += left[1] * right[1]
    total += left[2] * right[2]
    return total


def _cross(left, right):
    """Cross products, as three arrays, of vectors given as three arrays each."""
    result = []
    for i, j in ((1, 2), (2, 0), (0, 1)):
        component = left[i] * right[j]
        component -= left[j] * right[i]
        result.append(component)
    return result


def lambert_sum(crosses, normals, shares, cosines):
    """Sum (n,) over edges of angle times the direction of the edge's normal along the receiver's, over 2 pi.

    `crosses` are ray to start of edge cross edge, `shares` (k, n) the part of the edge that counts, `cosines` (k, n)
    the dot products of the rays to the ends of that part.
    """
    along = _dot(crosses, normals)
    lengths = np.sqrt(_dot(crosses, crosses))
    # A point in line with an edge sees it under no angle: 0 instead of 0 / 0.
    lengths[lengths == 0] = 1
    # The arc tangent of a quotient is half the price of the one of two arguments. A quotient over zero is a right
    # angle, as it should be; an obtuse angle comes out negative, by half a turn.
    with np.errstate(divide='ignore', over='ignore'):
        angles = np.arctan((lengths if shares is None else lengths * shares) / cosines)
    angles += np.pi * (angles < 0)
    angles *= along
    angles /= lengths
    # Corners run clockwise as seen from a point at the front.
    return angles.sum(axis=0) / (-2 * np.pi)


def _contour(rays, normals, loop):
    """Contour sum (n,) for polygons wholly above the horizon."""
    starts, ends = [r[:-1] for r in rays], [r[1:] for r in rays]
    edges = np.diff(loop, axis=0).T[:, :, None]
    return lambert_sum(_cross(starts, edges), normals, None, _dot(starts, ends))


def _clipped_contour(rays, normals, loop):
    """Contour sum (n,) for polygons that cross the horizon: edges shortened, closed along the horizon."""
    edges = np.diff(loop, axis=0).T[:, :, None]
    elevations = _dot(rays, normals)
    here, there = elevations[:-1], elevations[1:]
    rising, falling = (here < 0) & (there >= 0), (here >= 0) & (there < 0)
    crossing = np.where(rising | falling, here, 0) / np.where(rising | falling, here - there, 1)
    first = np.where(rising, crossing, 0)
    last = np.where(falling, crossing, np.where((here < 0) & (there < 0), 0, 1))
    starts = [r[:-1] for r in rays]
    cosines = _dot(*([r + share * e for r, e in zip(starts, edges, strict=True)] for share in (first, last)))
    # Edges below the horizon have no extent; a cosine of zero would make that 0 / 0.
    cosines[last == first] = 1
    total = lambert_sum(_cross(starts, edges), normals, last - first, cosines)
    # The line on which all crossings lie, seen from the point: azimuths are counted from its nearest point, so they
    # stay within a quarter turn and can be added in any order.
    axis = np.cross(loop[1:-2], loop[2:-1]).sum(axis=0)
    level = axis[:, None] - (axis @ normals) * normals
    level *= np.sign(_dot([r[0] for r in rays], axis))
    along = _cross(normals, level)
    hits = [r + crossing * e for r, e in zip(starts, edges, strict=True)]
    azimuths = np.arctan2(_dot(hits, along), _dot(hits, level))
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
    squares, here, there = _dot(rays, rays), _dot(rays, normals), np.abs(_dot(rays, axis))
    return (weights[:, None] * (here * there / (np.pi * squares * squares))).sum(axis=0)
