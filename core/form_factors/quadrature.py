"""Area quadrature of the point-to-polygon factor: closed form on one patch, samples on the other.

Only the outer of the two integrals is sampled, so near contact, shared edges and sharp angles cost little accuracy, and
where nothing occludes an adaptive rule reaches 1e-6 in milliseconds. With occlusion, the far polygon is cut into
pieces, each with its exact factor, and one ray tells whether a piece is visible. Choose it for single pairs and for
small or far patches, which a hemisphere of rays misses; for an environment of n patches it costs n^2 evaluations.

Limits: visibility by one ray per piece errs by the part of a piece that a shadow's edge cuts; refinement goes on until
the scatter of independent repetitions is below the wanted error.
"""

from __future__ import annotations

import logging
from copy import copy

import numpy as np

from ..environment import Environment
from ..visibility.embree import RayEngine
from ..visibility.segments import make_visibility
from .hemisphere import SampledRows, seam_leaks
from .point_to_polygon import point_to_polygon
from .sampling import PatchSampler, kronecker_points

#: Points of the Gauss rule along each side of a triangle.
GAUSS_POINTS = 4

#: Triangles after which adaptive refinement stops; the error it stops with is returned.
MOST_TRIANGLES = 60_000

#: Independent repetitions of sampled quadrature, for the error estimate.
REPETITIONS = 8

#: Points per patch and pieces per triangle of the far polygon (as a power of 4) in successive rounds.
ROUNDS = ((32, 1), (128, 2), (512, 2), (2048, 3), (8192, 4))

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
    """Form factors of all patches: closed form to every patch from points spread over each.

    `visibility` is any that tests segments, or ``none`` to ignore occlusion. The other parameters and the result are
    those of `hemisphere_rows`; what escapes is the rest of each row.
    """
    count = len(environment)
    source = QuadratureRows(environment, visibility, threads)
    matrix, errors, samples, rays = source.refined(np.arange(count), accuracy, seed)
    if errors.max(initial=0) > accuracy:
        logger.warning("Form factors are accurate to %.2g only, not %.2g: sample limit", errors.max(), accuracy)
    leaks = np.zeros(count) if source.engine is None else seam_leaks(environment, source.engine.offset)
    return SampledRows(matrix, np.maximum(1 - matrix.sum(axis=1), 0), errors, samples, rays, leaks)


class QuadratureRows:
    """Closed forms to the patches of an environment from points of receivers: the patches, or those of `of_receivers`.

    Parameters
    ----------
    environment : Environment
    visibility : str
        Any that tests segments, or ``none``.
    threads : int
    """

    def __init__(self, environment: Environment, visibility: str, threads: int = 0):
        self.environment = self.receivers = environment
        self.names = self.own = np.arange(len(environment))
        if visibility == "none":
            self.engine = None
        elif visibility == "embree":
            self.engine = _engine(environment, threads)
        else:
            self.engine = _Segments(make_visibility(visibility, environment, threads))

    def of_receivers(self, receivers: Environment, names: np.ndarray, own: np.ndarray) -> QuadratureRows:
        """The same patches as seen from other polygons, whose random shifts go by their `names` (r,) int.

        `own` (r,) int is the patch that each lies on, and does not see.
        """
        other = copy(self)
        other.receivers, other.names, other.own = receivers, names, own
        return other

    def refined(self, rows: np.ndarray, accuracy: float, seed: int):
        """Factors (r, n), errors and samples (r,) of some receivers, and rays cast.

        Where nothing blocks, a row does not depend on which others are asked for.
        """
        columns = np.arange(len(self.environment))
        matrix, errors = np.zeros((len(rows), len(columns))), np.zeros(len(rows))
        samples, rays = np.zeros(len(rows), dtype=np.int64), 0
        pending = np.flatnonzero(self.receivers.areas[rows] > 0)
        for number, (points, level) in enumerate(ROUNDS):
            if not len(pending):
                break
            matrix[pending], errors[pending], cast = self.sampled(rows[pending], columns, points, level, (seed, number))
            samples[pending] = points * REPETITIONS
            rays += cast
            pending = pending[errors[pending] > accuracy]
        return matrix, errors, samples, rays

    def sampled(self, rows, columns, points, level, seed):
        """Factors (r, c), standard error of each row's worst (r,), and rays cast, from `points` points per patch."""
        environment, receivers, engine = self.environment, self.receivers, self.engine
        sampler = PatchSampler(receivers)
        table = kronecker_points(points, 2)
        total, squares, rays = np.zeros((len(rows), len(columns))), np.zeros((len(rows), len(columns))), 0
        normals = np.repeat(receivers.normals[rows], points, axis=0)
        # A two-sided patch is sampled on either side in turn.
        flips = receivers.two_sided[rows][:, None] & (np.arange(points) % 2 == 1)
        normals = np.where(flips.reshape(-1, 1), -normals, normals)
        for repetition in range(REPETITIONS):
            generator = np.random.default_rng((*seed, repetition))
            shifts = generator.random((self.names.max() + 1, 2))[self.names[rows]]
            origins = sampler(rows, (table + shifts[:, None]) % 1).reshape(-1, 3)
            for column, source in enumerate(columns):
                if environment.areas[source] <= 0:
                    continue
                two_sided = bool(environment.two_sided[source])
                if engine is None:
                    factors = point_to_polygon(origins, normals, environment.polygons[source], two_sided)
                else:
                    pieces = _pieces(environment, source, level)
                    jitter = np.random.default_rng((*seed, repetition, int(source)))
                    factors, cast = _visible_factors(origins, normals, pieces, two_sided, engine, jitter)
                    rays += cast
                means = factors.reshape(len(rows), points).mean(axis=1)
                means[self.own[rows] == source] = 0
                total[:, column] += means
                squares[:, column] += means * means
        mean = total / REPETITIONS
        variance = np.maximum(squares / REPETITIONS - mean * mean, 0) / (REPETITIONS - 1)
        return mean, np.sqrt(variance.max(axis=1)), rays


def sampled_pair(environment, receiver, source, accuracy, seed=0, threads=0) -> tuple[float, float, int]:
    """Form factor from one patch to another among blockers, its standard error, and the rays cast."""
    quadrature = QuadratureRows(environment, "embree", threads)
    rays = 0
    for number, (points, level) in enumerate(ROUNDS):
        value, error, cast = quadrature.sampled(np.array([receiver]), np.array([source]), points, level, (seed, number))
        rays += cast
        if error[0] <= accuracy:
            break
    else:
        logger.warning("Form factor is accurate to %.2g only, not %.2g: sample limit", error[0], accuracy)
    return float(value[0, 0]), float(error[0]), rays


def sampled_point(environment, point, normal, source, accuracy, seed=0, threads=0) -> tuple[float, float, int]:
    """Configuration factor of a differential area to a patch among blockers, its standard error, and the rays cast."""
    engine = _engine(environment, threads)
    polygon, two_sided = environment.polygons[source], bool(environment.two_sided[source])
    origin = np.asarray(point, dtype=np.float64) + engine.offset * np.asarray(normal)
    rays = 0
    generator = np.random.default_rng(seed)
    for level in range(2, 7):
        pieces = _pieces(environment, source, level)
        factors = np.array([point_to_polygon(point[None], normal[None], piece, two_sided)[0] for piece in pieces])
        seen = factors > 0
        shares = np.zeros(REPETITIONS)
        for repetition in range(REPETITIONS):
            targets = _jitter(pieces[seen], generator.random((int(seen.sum()), 2)))
            blocked = engine.occluded(np.broadcast_to(origin, targets.shape), targets)
            shares[repetition] = (factors[seen] * ~blocked).sum()
            rays += len(targets)
        error = shares.std(ddof=1) / np.sqrt(REPETITIONS)
        if error <= accuracy:
            break
    else:
        logger.warning("Configuration factor is accurate to %.2g only, not %.2g: sample limit", error, accuracy)
    # The pieces' factors sum to the whole polygon's, which rounds less.
    whole = point_to_polygon(point[None], normal[None], polygon, two_sided)[0]
    return float(min(shares.mean(), whole)), float(error), rays


class _Segments:
    """Visibility of segments in place of a ray engine."""

    #: Its segments begin on the surface itself.
    offset = 0.0

    def __init__(self, visibility):
        self._visibility = visibility

    def occluded(self, origins, targets):
        return ~self._visibility.visible(origins, targets)


def _engine(environment: Environment, threads: int) -> RayEngine:
    return RayEngine(environment.vertices, environment.triangles, threads)


def _visible_factors(origins, normals, pieces, two_sided, engine, generator):
    """Factors (n,) of points to the visible pieces (m, 3, 3) of a polygon, and the rays cast: one per lit piece."""
    factors, rays = np.zeros(len(origins)), 0
    for piece in pieces:
        part = point_to_polygon(origins, normals, piece, two_sided)
        lit = np.flatnonzero(part > 0)
        targets = _jitter(np.broadcast_to(piece, (len(lit), 3, 3)), generator.random((len(lit), 2)))
        blocked = engine.occluded(origins[lit] + engine.offset * normals[lit], targets)
        factors[lit] += part[lit] * ~blocked
        rays += len(lit)
    return factors, rays


def _pieces(environment: Environment, patch: int, level: int) -> np.ndarray:
    """(m, 3, 3) triangles of a patch, each cut into 4 `level` times."""
    corners = environment.vertices[environment.triangles[environment.triangle_patches == patch]]
    for _ in range(level):
        corners = _quarter(corners)
    return corners


def _quarter(corners: np.ndarray) -> np.ndarray:
    """(4 m, 3, 3) triangles, four in place of each, by the middles of the sides; orientation is kept."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)


def _jitter(triangles: np.ndarray, square: np.ndarray) -> np.ndarray:
    """(n, 3) random points on n triangles, from (n, 2) numbers between 0 and 1."""
    root = np.sqrt(square[:, :1])
    second = root * square[:, 1:]
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return a + (root - second) * (b - a) + second * (c - a)


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
