"""Pairs of faces that lie apart, wholly in front of each other: rules whose error falls with distance, as foreseen.

Three rules, by what they cost. The moment rule is the point-to-point formula between centers of area, with the share
that the second moments of both faces change of it, which makes its error cubic in size over distance where that of the
plain formula is quadratic; the four-point rule puts four equal weights on each face, at one standard deviation along
its principal axes (Gauss's 2 x 2 rule, where the face is a rectangle), so that all second moments are right; and the
mean rule integrates the closed form of a point and a polygon over one face, by Gauss's rule of the order that the
distance asks for. The last two lose no digits with distance, which the contour integral does.

The first two serve whole environments at a known error: an absolute bound on the factor of either face. Cost of a pair:
20 to 30 ns by the moment rule, 0.3 us by four points, 1 to 3 us by means.
"""

from __future__ import annotations

import numpy as np

from .edge_integrals import gauss_rule
from .faces import Faces
from .point_to_polygon import lambert_sum

#: Bound of the moment rule's relative error, in cubes and fourth powers of ratio, and of the four-point rule's, in
#: cubes: ratio is the sum of both radii over the distance of the centers. Twice the largest that 4e5 random pairs of
#: triangles, quadrilaterals and hexagons showed against exact values, and more than a search for the worst among
#: deformed ones found, by 60 climbs of 500 steps.
MOMENT_BOUNDS = (0.3, 0.5)
FOUR_POINT_BOUND = 0.4

#: Radius over distance to the other's outline up to which the mean rule is used.
GREATEST_RATIO = 0.75

#: Orders of the mean rule.
ORDERS = (2, 3, 4, 6, 8, 12, 16, 24)

#: Pairs of a tile of the moment rule: a dozen temporaries stay in the second-level cache, and no page is asked of the
#: system anew. With 2^15 it may take twice as long.
TILE_ENTRIES = 3 * 2**13

#: Points times edges handled at once: temporaries stay below 64 MB.
BLOCK_ANGLES = 2**17


def moment_rule(faces: Faces, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exchange areas (r, c) by centers and second moments, and bounds of their error as factors of the smaller face.

    With unit normals a and b, the vector r between the centers, and the moments ``M = M_1 + M_2`` of both faces about
    them, the mean of ``K = -(a . r) (b . r) / pi r^4`` over both is ``K + M : grad grad K / 2`` up to third moments;
    ``a M_1`` and ``b M_2`` are 0. All of it is made of heights above planes, which are products of matrices.
    """
    shape = len(rows), len(columns)
    values, bounds = np.empty(shape), np.empty(shape)
    step = max(1, TILE_ENTRIES // max(len(columns), 1))
    for begin in range(0, len(rows), step):
        tile = slice(begin, begin + step)
        values[tile], bounds[tile] = _moment_tile(faces, rows[tile], columns)
    return values, bounds


def _moment_tile(faces, rows, columns):
    """`moment_rule` without tiles."""
    centers, others = faces.centers[rows], faces.centers[columns]
    normals, other_normals = faces.normals[rows], faces.normals[columns]
    squares = np.zeros((len(rows), len(columns)))
    for axis in range(3):
        apart = others[:, axis] - centers[:, axis][:, None]
        squares += apart * apart
    squares[squares == 0] = np.inf
    inverse = 1 / squares
    # Differences of products, where products of differences would take ten times as long: rounded to the scene's size.
    here = normals @ others.T - np.einsum("ri,ri->r", normals, centers)[:, None]
    there = centers @ other_normals.T - np.einsum("ci,ci->c", other_normals, others)
    stretch, turn = np.zeros_like(squares), np.zeros_like(squares)
    for k in range(2):
        axes, other_axes = faces.axes[rows, k], faces.axes[columns, k]
        along = axes @ others.T - np.einsum("ri,ri->r", axes, centers)[:, None]
        stretch += along * along
        turn += along * (axes @ other_normals.T) * here
        along = centers @ other_axes.T - np.einsum("ci,ci->c", other_axes, others)
        stretch += along * along
        turn += along * (normals @ other_axes.T) * there
    moments = np.einsum("fki,fki->f", faces.axes, faces.axes)
    spread = moments[rows][:, None] + moments[columns]
    product = here * there
    product += (4 * turn + product * (12 * stretch * inverse - 2 * spread)) * inverse
    product *= inverse * inverse
    product *= faces.areas[rows][:, None] * faces.areas[columns] / np.pi
    ratios = (faces.radii[rows][:, None] + faces.radii[columns]) * np.sqrt(inverse)
    bounds = np.maximum(faces.areas[rows][:, None], faces.areas[columns]) * inverse / np.pi
    bounds *= (MOMENT_BOUNDS[0] + MOMENT_BOUNDS[1] * ratios) * (ratios * ratios * ratios)
    # The bound is one of the far field's expansion: it means nothing where the ratio is not small.
    bounds[ratios > 0.5] = np.inf
    return np.maximum(product, 0), bounds


def four_point_errors(faces: Faces, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (m,) of the error of `four_point`: as a factor of the smaller face, and as a share of the far field.

    The far field is the factor that the faces would have if they looked straight at each other.
    """
    apart = faces.centers[second] - faces.centers[first]
    square = np.einsum("mi,mi->m", apart, apart)
    larger = np.maximum(faces.areas[first], faces.areas[second])
    with np.errstate(divide='ignore', over='ignore'):
        ratios = (faces.radii[first] + faces.radii[second]) / np.sqrt(square)
        relative = np.where(ratios < 0.5, FOUR_POINT_BOUND * ratios**3, np.inf)
        return relative * larger / (np.pi * square), relative


def four_point(faces: Faces, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Exchange areas (m,) by four points on each face."""
    signs = np.array([[1.0, 1], [1, -1], [-1, 1], [-1, -1]])
    apart = faces.centers[second] - faces.centers[first]
    places = np.einsum("pa,mai->pmi", signs, faces.axes[first])
    others = np.einsum("pa,mai->pmi", signs, faces.axes[second]) + apart
    total = np.zeros(len(first))
    for place in places:
        for other in others:
            ray = other - place
            square = np.einsum("mi,mi->m", ray, ray)
            here = np.einsum("mi,mi->m", ray, faces.normals[first])
            there = np.einsum("mi,mi->m", ray, faces.normals[second])
            total -= here * there / (square * square)
    return total * faces.areas[first] * faces.areas[second] / (16 * np.pi)


def outline_ratios(loops: np.ndarray, centers: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Radius over distance from a center to the other's outline (m,), for other's `loops` (m, k, 3)."""
    starts = loops - centers[:, None]
    edges = np.roll(loops, -1, axis=1) - loops
    squares = np.einsum("mki,mki->mk", edges, edges)
    places = -np.einsum("mki,mki->mk", starts, edges) / np.where(squares > 0, squares, 1)
    nearest = starts + places.clip(0, 1)[..., None] * edges
    distances = np.sqrt(np.einsum("mki,mki->mk", nearest, nearest).min(axis=1))
    with np.errstate(divide='ignore'):
        return radii / distances


def orders_for(ratios: np.ndarray, tolerance: np.ndarray | float) -> np.ndarray:
    """Order (m,) of the mean rule at which its relative error stays below `tolerance`.

    Gauss's rule errs by the parameter of the largest ellipse free of singularities, to the power of minus twice the
    order.
    """
    parameter = 1 / ratios + np.sqrt(np.maximum(1 / ratios**2 - 1, 0))
    wanted = np.log(tolerance) / (-2 * np.log(parameter))
    return np.array(ORDERS)[np.minimum(np.searchsorted(ORDERS, wanted), len(ORDERS) - 1)]


def mean_rule(loops: np.ndarray, normals: np.ndarray, others: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """Exchange areas (m,) from Gauss points on `loops` (m, k, 3), by the closed form to `others` (m, l, 3)."""
    result = np.zeros(len(loops))
    for order in np.unique(orders):
        chosen = np.flatnonzero(orders == order)
        points = order * order * (loops.shape[1] - 1) // 2
        step = max(1, BLOCK_ANGLES // (points * others.shape[1]))
        for block in np.split(chosen, range(step, len(chosen), step)):
            result[block] = _mean_block(loops[block], normals[block], others[block], int(order))
    return result


def _mean_block(loops, normals, others, order):
    """`mean_rule` of one order."""
    points, weights = _gauss_points(loops, normals, order)
    count, number, corners = len(loops), points.shape[1], others.shape[1]
    ends = np.concatenate((others, others[:, :1]), axis=1)
    rays = [(ends[:, None, :, i] - points[:, :, i, None]).reshape(-1, corners + 1).T for i in range(3)]
    starts, stops = [ray[:-1] for ray in rays], [ray[1:] for ray in rays]
    edges = np.repeat(np.diff(ends, axis=1), number, axis=0).transpose(2, 1, 0)
    crosses = [starts[i] * edges[j] - starts[j] * edges[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    cosines = sum(a * b for a, b in zip(starts, stops, strict=True))
    along = np.repeat(normals, number, axis=0).T
    factors = lambert_sum(crosses, along, None, cosines).reshape(count, number)
    return np.einsum("mg,mg->m", factors, weights)


def _gauss_points(loops, normals, order):
    """Points (m, g, 3) and weights (m, g), whose sum is the area, on loops cut into quadrilaterals.

    Each is the image of a square; a triangle is one with two corners in one place. Where a concave loop makes the map
    fold over, weights turn negative, and the sum stays right.
    """
    nodes, weights = gauss_rule(order)
    nodes, weights = (nodes + 1) / 2, weights / 2
    u, v = (a.ravel() for a in np.meshgrid(nodes, nodes, indexing="ij"))
    weight = np.outer(weights, weights).ravel()
    last = loops.shape[1] - 1
    points, sizes = [], []
    for i in range(1, last, 2):
        a, b, c, d = (loops[:, j, None] for j in (0, i, i + 1, min(i + 2, last)))
        along, across, twist = b - a, d - a, a - b + c - d
        points.append(a + u[:, None] * along + v[:, None] * across + (u * v)[:, None] * twist)
        jacobian = np.cross(along + v[:, None] * twist, across + u[:, None] * twist)
        sizes.append(np.einsum("mgi,mi->mg", jacobian, normals) * weight)
    return np.concatenate(points, axis=1), np.concatenate(sizes, axis=1)
