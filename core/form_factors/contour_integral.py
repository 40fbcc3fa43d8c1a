"""Contour integral: the factor between two polygons by Stokes' theorem, twice (survey eq. 3).

The double area integral becomes one over the two outlines, ``A_1 F_12 = sum of edge pairs of (mean ln r) a . b / 2 pi``
(`edge_integrals`), for convex and concave polygons alike, whether they share edges or corners, nearly touch, or cross
each other's plane: of each polygon the part behind the other's plane is cut off exactly. This is the method for pairs
that are near or touch, and where all digits count.

Two of its limits are met by other exact forms. The sum over edges loses digits as the square of distance over size, so
pairs that are small for their distance, or slivers, integrate the closed form of a point and a polygon over one of
them by Gauss's rule, of an order that follows from the distance (`separated_pairs`). And for an environment of n
patches, `fast` lets pairs far apart take one or four samples instead, with an error that is bounded in advance by what
accuracy was asked for; then most pairs cost some ten nanoseconds, and only neighbors the full formula.

It knows no occlusion itself: any visibility by segments may be joined to it (`visible_share`).

Cost: some microseconds for each pair of patches that see each other's fronts.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from ..visibility.segments import make_visibility
from .edge_integrals import EXACT as EDGE_EXACT
from .edge_integrals import PERPENDICULAR, edge_integrals
from .faces import Faces
from .hemisphere import SampledRows
from .pair_rows import pair_rows
from .plane_clipping import clip_loops
from .segment_samples import SegmentSamples
from .separated_pairs import (
    GREATEST_RATIO,
    center_rule,
    four_point,
    four_point_errors,
    mean_rule,
    orders_for,
    outline_ratios,
)

#: Pairs worked on at once: temporaries stay below 100 MB.
BLOCK_PAIRS = 2**13
BLOCK_EDGES = 2**17

#: Relative error that an exact factor is allowed where a choice of formula decides it.
EXACT = 1e-10

#: Radius over distance from the other's outline up to which the mean rule costs less than the contour.
NEAR = 0.3

#: Share of the accuracy asked for that the error of near pairs may take.
SHARE = 0.1

#: Rounding of the contour sum, as a share of both perimeters multiplied: measured on random pairs, a few eps.
ROUNDING = 4 * float(np.finfo(np.float64).eps)


def contour_integral(polygon_a: np.ndarray, polygon_b: np.ndarray) -> float:
    """Share of the power leaving the front of one polygon that reaches the front of another, nothing in between.

    Parameters
    ----------
    polygon_a, polygon_b : (k, 3) float
        Planar loops, counter-clockwise seen from their fronts; convex or concave, in any position.

    Returns
    -------
    float
        Exact to about 1e-12, and to a relative 1e-9 or so where the factor itself is small.

    Raises
    ------
    InvalidPolygonError
        If a polygon is malformed.

    References
    ----------
    .. [1] Goral, Torrance, Greenberg, Battaile, "Modeling the Interaction of Light Between Diffuse Surfaces",
       SIGGRAPH 1984.
    """
    environment = Environment.from_polygons([polygon_a, polygon_b])
    if environment.areas.min() <= 0:
        return 0.0
    exchange, _ = exchanges(Faces(environment), np.array([0]), np.array([1]), 0.0)
    return float(min(exchange[0] / environment.areas[0], 1.0))


def contour_rows(environment, visibility="none", accuracy=1e-3, seed=0, threads=0, fast=False) -> SampledRows:
    """Form factors of all patches.

    Parameters
    ----------
    environment : Environment
    visibility : str
        ``none``, or the name of one that tests segments: then factors of pairs that something may block are multiplied
        by their sampled visible share. Where no plane parts two patches, nothing is sampled.
    accuracy : float
        Error allowed to a factor by visibility, and by `fast`; else all are exact.
    seed : int
        Places of the samples.
    threads : int
        Threads of the ray engine, where it is used.
    fast : bool
        Whether pairs far apart may be computed from one or four points.

    Returns
    -------
    SampledRows
        `errors` are bounds, and standard errors where visibility was sampled; what escapes is the rest of each row.

    Raises
    ------
    SettingsError
        If the visibility is unknown.
    """
    faces = Faces(environment)

    def unoccluded(rows, columns, wanted):
        return face_block(faces, rows, columns, accuracy if fast else 0.0, wanted)

    sight = None if visibility == "none" else make_visibility(visibility, environment, threads)
    samples = None if sight is None else SegmentSamples(environment, faces, sight)
    return pair_rows(environment, faces, unoccluded, samples, accuracy, seed)


def face_block(faces, rows, columns, accuracy, wanted=True, near=NEAR):
    """Exchange areas (r, c) of wanted pairs, and bounds of the error of the factor of the smaller one.

    Up to the ratio `near` pairs that lie apart take the mean rule, a closed form from points.
    """
    tolerance = faces.tolerance(rows[:, None], columns)
    low, high = faces.height_ranges(rows, columns)
    other_low, other_high = (array.T for array in faces.height_ranges(columns, rows))
    seen = (high > tolerance) & (other_high > tolerance) & wanted
    values, errors = np.zeros(seen.shape), np.zeros(seen.shape)
    if accuracy > 0:
        sampled, bounds = center_rule(faces, rows, columns)
        done = seen & (low >= 0) & (other_low >= 0) & (bounds <= accuracy)
        values[done], errors[done] = sampled[done], bounds[done]
        seen &= ~done
    first, second = np.nonzero(seen)
    for begin in range(0, len(first), BLOCK_PAIRS):
        chosen = first[begin : begin + BLOCK_PAIRS], second[begin : begin + BLOCK_PAIRS]
        values[chosen], errors[chosen] = exchanges(faces, rows[chosen[0]], columns[chosen[1]], accuracy, near)
    return values, errors


def exchanges(
    faces: Faces, first: np.ndarray, second: np.ndarray, accuracy: float, near: float = NEAR
) -> tuple[np.ndarray, np.ndarray]:
    """Exchange areas ``A_1 F_12`` (m,) of pairs of faces, and bounds (m,) of the error of the smaller one's factor.

    With accuracy 0 they are exact.
    """
    values, errors = np.zeros(len(first)), np.zeros(len(first))
    keys = faces.sizes[first] * (faces.sizes.max(initial=0) + 1) + faces.sizes[second]
    for key in np.unique(keys):
        chosen = np.flatnonzero(keys == key)
        values[chosen], errors[chosen] = _class_exchanges(faces, first[chosen], second[chosen], accuracy, near)
    return values, errors


def _class_exchanges(faces, first, second, accuracy, near):
    """`exchanges` of pairs whose loops have the same two lengths."""
    shifts = (faces.centers[second] - faces.centers[first])[:, None]
    loops, others = faces.loops(first), faces.loops(second) + shifts
    tolerance = faces.tolerance(first, second)[:, None]
    heights = _heights(others, faces.normals[first], tolerance)
    other_heights = _heights(loops - shifts, faces.normals[second], tolerance)
    seen = (heights > 0).any(axis=1) & (other_heights > 0).any(axis=1)
    whole = (heights >= 0).all(axis=1) & (other_heights >= 0).all(axis=1)
    values, errors = np.zeros(len(first)), np.zeros(len(first))
    rows = np.flatnonzero(seen & whole)
    bounds, relative = four_point_errors(faces, first[rows], second[rows])
    sampled = (bounds <= accuracy) | (relative <= EXACT)
    far = rows[sampled]
    values[far], errors[far] = four_point(faces, first[far], second[far]), bounds[sampled]
    rows = rows[~sampled]
    values[rows], errors[rows] = _outline_exchanges(
        faces, first[rows], second[rows], loops[rows], others[rows], accuracy, near
    )
    rows = np.flatnonzero(seen & ~whole)
    parts, other_parts = clip_loops(loops[rows], other_heights[rows]), clip_loops(others[rows], heights[rows])
    values[rows], errors[rows] = _outline_exchanges(
        faces, first[rows], second[rows], parts, other_parts, accuracy, near
    )
    return np.maximum(values, 0), errors


def _heights(loops, normals, tolerance):
    """Heights (m, k) of corners above planes through the origin, 0 where within tolerance."""
    heights = np.einsum("mki,mi->mk", loops, normals)
    return np.where(np.abs(heights) > tolerance, heights, 0)


def _outline_exchanges(faces, first, second, loops, others, accuracy, greatest_ratio):
    """`exchanges` of loops in front of each other, both relative to the centers of `first`.

    The loops may be parts of the faces.
    """
    smaller = np.minimum(faces.areas[first], faces.areas[second])
    shifts = faces.centers[second] - faces.centers[first]
    here = outline_ratios(others, np.zeros_like(shifts), faces.radii[first])
    there = outline_ratios(loops, shifts, faces.radii[second])
    ratios = np.minimum(here, there)
    values, errors = np.zeros(len(first)), np.full(len(first), SHARE * accuracy)
    near = ratios > greatest_ratio
    rows = np.flatnonzero(near)
    values[rows], rounding = contour_sums(loops[rows], others[rows], SHARE * accuracy * smaller[rows])
    errors[rows] += rounding / smaller[rows]
    # Slivers, whose outlines are long for what they bound: the mean rule, where it converges.
    near[rows[(rounding > EXACT * values[rows]) & (ratios[rows] <= GREATEST_RATIO)]] = False
    tolerance = max(EXACT, SHARE * accuracy)
    for chosen, outer, inner, outlines, targets, ratio in (
        (here <= there, first, second, loops, others, here),
        (here > there, second, first, others, loops, there),
    ):
        rows = np.flatnonzero(~near & chosen)
        values[rows] = mean_rule(
            outlines[rows], faces.normals[outer[rows]], targets[rows], orders_for(ratio[rows], tolerance)
        )
        # Relative to the factor of a face that looks straight at the other: slanted ones may vary more than they are.
        distances = faces.radii[outer[rows]] / ratio[rows]
        greatest = np.minimum(faces.areas[inner[rows]] / (np.pi * distances**2), 1)
        errors[rows] = tolerance * greatest * faces.areas[outer[rows]] / smaller[rows]
    return values, errors


def contour_sums(loops, others, tolerance=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Contour integrals of pairs of loops in front of each other.

    Parameters
    ----------
    loops, others : (m, k, 3), (m, l, 3) float
        Closed loops, relative to a point near them.
    tolerance : (m,) float
        Error allowed to the result; 0 asks for all digits.

    Returns
    -------
    exchanges, rounding : (m,) float64
        Exchange areas, and about how far rounding may put them off.
    """
    size = np.sqrt(np.maximum((loops**2).sum(axis=2).max(axis=1), (others**2).sum(axis=2).max(axis=1)))
    loops, others = loops / size[:, None, None], others / size[:, None, None]
    edges, other_edges = np.roll(loops, -1, axis=1) - loops, np.roll(others, -1, axis=1) - others
    lengths, other_lengths = (np.sqrt(np.einsum("mki,mki->mk", a, a)) for a in (edges, other_edges))
    scale = size**2 / (2 * np.pi)
    perimeters = lengths.sum(axis=1) * other_lengths.sum(axis=1)
    allowed = np.maximum(tolerance / (perimeters * scale), EDGE_EXACT)
    # Perpendicular edges and those that only fill up a loop are the most: they are left out before anything is copied.
    weights = np.abs(np.einsum("mki,mli->mkl", edges, other_edges))
    pairs, here, there = np.nonzero(weights > PERPENDICULAR * lengths[:, :, None] * other_lengths[:, None])
    totals = np.zeros(len(loops))
    for begin in range(0, len(pairs), BLOCK_EDGES):
        m, k, n = (index[begin : begin + BLOCK_EDGES] for index in (pairs, here, there))
        terms = edge_integrals(loops[m, k], edges[m, k], others[m, n], other_edges[m, n], allowed[m])
        totals += np.bincount(m, terms, len(totals))
    return totals * scale, ROUNDING * perimeters * scale
