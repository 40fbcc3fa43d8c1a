"""Area quadrature of the point-to-polygon factor: closed form on one patch, samples on the other.

Only the outer of the two integrals is sampled, so where nothing occludes an adaptive rule reaches 1e-6 in milliseconds.
With occlusion the factor is multiplied by the share of it that is visible, of which rays tell that are spread over the
solid angle of the far polygon. Choose it for single pairs and for small or far patches, which a hemisphere of rays
misses; for an environment of n patches it costs n^2 evaluations.

Limits: rays are cast until the scatter of independent repetitions is below the error allowed; what all of them miss is
not seen.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from ..visibility.segments import make_visibility
from .allowed_error import AIM, allowed_error
from .contour_integral import exchanges, face_block
from .faces import Faces
from .hemisphere import SampledRows
from .pair_rows import pair_rows
from .point_to_polygon import point_to_polygon
from .scatter import pooled_shares
from .segment_samples import SegmentSamples
from .separated_pairs import GREATEST_RATIO
from .spherical_triangles import points_by_solid_angle
from .visible_share import REPETITIONS, visible_shares

#: Points of the Gauss rule along each side of a triangle.
GAUSS_POINTS = 4

#: Triangles after which adaptive refinement stops; the error it stops with is returned.
MOST_TRIANGLES = 60_000

#: Quarterings of a patch's triangles in successive rounds of a point's factor.
POINT_LEVELS = range(2, 9)

logger = logging.getLogger(__name__)


def integrate_pair(environment: Environment, receiver: int, source: int, tolerance: float) -> tuple[float, float]:
    """Form factor from one patch to another, nothing in between, by adaptive quadrature over the first.

    Returns
    -------
    factor, error : float
        The error is the sum of what the last refinement of each triangle changed.
    """
    corners = environment.vertices[environment.triangles[environment.triangle_patches == receiver]]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    shares = areas / areas.sum()
    normal, polygon = environment.normals[receiver], environment.polygons[source]
    two_sided = bool(environment.two_sided[source])
    values = _triangle_means(corners, normal, polygon, two_sided) * shares
    factor = error = 0.0
    spent = 0
    while len(corners):
        spent += 4 * len(corners)
        children = _quarter(corners)
        finer = _triangle_means(children, normal, polygon, two_sided).reshape(-1, 4) * (shares / 4)[:, None]
        changes = np.abs(finer.sum(axis=1) - values)
        # Errors may add up, so a triangle gets as much of the tolerance as of the area, at least a fair share of the
        # work: refinement along an edge would else never end.
        open_ = changes > tolerance * np.maximum(shares, 1e-3)
        if spent > MOST_TRIANGLES:
            open_[:] = False
        factor += finer[~open_].sum()
        error += changes[~open_].sum()
        corners = children.reshape(-1, 4, 3, 3)[open_].reshape(-1, 3, 3)
        values = finer[open_].ravel()
        shares = np.repeat(shares[open_] / 4, 4)
    return float(factor), float(error)


def quadrature_rows(environment, visibility, accuracy, seed=0, threads=0) -> SampledRows:
    """Form factors of all patches: the closed form averaged over points of each, times the visible share.

    Points are those of Gauss's rule, of an order that follows from the distance; pairs that are too near for it take
    the contour integral, which is the same average in closed form. `visibility` is any that tests segments, or ``none``
    to ignore occlusion. The other parameters and the result are those of `pair_rows`.
    """
    faces = Faces(environment)

    def unoccluded(rows, columns, wanted):
        return face_block(faces, rows, columns, 0.0, wanted, GREATEST_RATIO)

    sight = None if visibility == "none" else make_visibility(visibility, environment, threads)
    samples = None if sight is None else SegmentSamples(environment, faces, sight)
    return pair_rows(environment, faces, unoccluded, samples, accuracy, seed)


def sampled_pair(environment, receiver, source, accuracy, seed=0, threads=0) -> tuple[float, float, int]:
    """Form factor from one patch to another among blockers, its standard error, and the rays cast."""
    faces = Faces(environment)
    first, second = (np.flatnonzero(faces.owners == patch)[:1] for patch in (receiver, source))
    exchange, _ = exchanges(faces, first, second, 0.0, GREATEST_RATIO)
    sight = make_visibility("embree", environment, threads)
    smaller = min(environment.areas[receiver], environment.areas[source])
    share, error = visible_shares(
        SegmentSamples(environment, faces, sight), first, second, exchange / smaller, accuracy, seed
    )
    scale = smaller / environment.areas[receiver]
    return float(exchange[0] / environment.areas[receiver] * share[0]), float(error[0] * scale), sight.rays


def sampled_point(environment, point, normal, source, accuracy, seed=0, threads=0) -> tuple[float, float, int]:
    """Configuration factor of a differential area to a patch among blockers, its standard error, and the rays cast.

    The closed form times the visible share, of which rays tell that are spread evenly over the solid angle of each of
    the pieces that the patch is cut into.
    """
    polygon, two_sided = environment.polygons[source], bool(environment.two_sided[source])
    whole = float(point_to_polygon(point[None], normal[None], polygon, two_sided)[0])
    if whole <= 0:
        return 0.0, 0.0, 0
    sight = make_visibility("embree", environment, threads)
    generator = np.random.default_rng(seed)
    for level in POINT_LEVELS:
        pieces = environment.vertices[environment.triangles[environment.triangle_patches == source]]
        for _ in range(level):
            pieces = _quarter(pieces)
        origins, normals = (np.broadcast_to(np.asarray(v, float), (len(pieces), 3)) for v in (point, normal))
        sums = np.zeros((2, REPETITIONS))
        for repetition in range(REPETITIONS):
            targets, angles = points_by_solid_angle(origins, pieces, generator.random((len(pieces), 2)))
            rays = targets - origins
            lengths = np.maximum(np.linalg.norm(rays, axis=1), np.finfo(np.float64).tiny)
            weights = angles * np.maximum(np.einsum("ni,ni->n", rays, normals) / lengths, 0)
            seen = sight.visible(origins, targets)
            sums[:, repetition] = (weights * seen).sum(), weights.sum()
        share, error = pooled_shares(*sums)
        error = whole * max(float(error), 1 / (len(pieces) * REPETITIONS))
        if error <= AIM * allowed_error(whole * share, accuracy):
            break
    else:
        logger.warning("A configuration factor of %.2g is known to %.2g only: sample limit", whole * share, error)
    return float(whole * share), error, sight.rays


def _quarter(corners: np.ndarray) -> np.ndarray:
    """(4 m, 3, 3) triangles, four in place of each, by the middles of the sides; orientation is kept."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)


def _triangle_means(corners, normal, polygon, two_sided):
    """Mean point-to-polygon factor (n,) over each of n triangles, by a Gauss product rule on the collapsed square."""
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    nodes, weights = (nodes + 1) / 2, weights / 2
    first, second = (a.ravel() for a in np.meshgrid(nodes, nodes, indexing="ij"))
    # Collapsing one side of the square onto a corner brings in the density `first`, twice the area's share.
    weight = np.outer(weights * nodes * 2, weights).ravel()
    a, b, c = (corners[:, None, i] for i in range(3))
    points = a + first[:, None] * ((b - a) + second[:, None] * (c - b))
    normals = np.broadcast_to(normal, (len(corners) * len(weight), 3))
    factors = point_to_polygon(points.reshape(-1, 3), normals, polygon, two_sided)
    return factors.reshape(len(corners), -1) @ weight
