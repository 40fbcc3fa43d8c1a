"""Hybrid: analytic factors everywhere, projection or rays only to tell what is visible (Baum 1989).

Pairs that nothing can come between take the contour integral, and no visibility is tested. Of the others the source is
cut, as seen from points of the receiver, until each piece is wholly visible or wholly hidden; visible pieces count with
the closed form of a point and a polygon, which a hemicube's delta factors only approach. How a piece is judged is the
`detection`: by an item buffer around the point, or by rays, toward its corners and center, which must agree. Pieces
too small to be cut further count by the share of random places, one in each quarter, that are seen.

The hemicube's assumptions fail for sources that are near for their size, where few pixels decide over much of the
factor, and an error of a bright source weighs as much as its light; so both are cut further than others. The sum over
pieces yields the visible share of the pair, which multiplies the exact factor of the contour integral.

Choose it where shadows matter and factors shall be smooth in what is unshadowed. Cost: some ten to hundred tests for
each point and blocked source. Limits: a blocker that falls between all tests of all points is overlooked.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.segments import make_visibility
from .cells import Cells
from .contour_integral import exchanges
from .faces import Faces
from .hemisphere import SampledRows
from .pair_rows import blockable_faces
from .plane_clipping import clip_loops
from .point_rows import PointRows
from .point_to_polygon import lambert_sum
from .receivers import Receivers, face_cells

#: Kinds of detection, and the visibility each uses.
DETECTIONS = {"item_buffer": "zbuffer", "rays": "embree"}

#: Pixels along a side of the item buffer: pieces are tested exactly against what these show.
RESOLUTION = 64

#: Independent repetitions, and cuts along each side of a receiver's cells in successive rounds.
REPETITIONS = 6
ROUNDS = (1, 2, 4, 8)

#: Levels of quartering before a piece may be called wholly visible or hidden, and at most. A piece of the last level
#: that is still mixed counts by the share of its tests that pass.
LEAST_LEVEL = 3
MOST_LEVEL = 3

#: Levels more for sources that are near or bright.
MORE_LEVELS = 1

#: Distance in radii below which a source is near: at it, the hemicube's error of taking it as far is about a percent.
NEAR = 5.0

#: Share of the greatest power of a source from which on it is bright.
BRIGHT = 0.1

#: Share of its size by which the tested corners of a piece lie within it: its border may be a blocker's foot.
INWARD = 0.02

#: Standard error aimed at, as a share of the accuracy asked for: the largest deviation of some hundred factors, at
#: three of it, is then still well within.
GOAL = 0.12

#: Points times pieces in hand at once.
BLOCK_PIECES = 2**16

#: For single points: quarterings at most, and the factors, over the relative error wanted, below which a piece that is
#: partly visible, or seems to be wholly so or not at all, is not cut further.
POINT_LEVELS = 4
POINT_SHARE = 0.05
UNTESTED = 0.5

logger = logging.getLogger(__name__)


def hybrid_rows(
    environment: Environment,
    visibility: str = "embree",
    accuracy: float = 1e-3,
    seed: int = 0,
    threads: int = 0,
    detection: str | None = None,
) -> SampledRows:
    """Form factors of all patches.

    Parameters
    ----------
    environment : Environment
        Its emission tells which sources are bright.
    visibility : str
        Any that tests segments; that of `detection`, where it is given.
    accuracy : float
        Error wanted.
    seed, threads : int
    detection : str, optional
        ``item_buffer`` or ``rays``.

    Returns
    -------
    SampledRows

    Raises
    ------
    SettingsError
        If the detection is unknown.

    References
    ----------
    .. [1] Baum, Rushmeier, Winget, "Improving Radiosity Solutions Through the Use of Analytically Determined
       Form-Factors", SIGGRAPH 1989.
    """
    if detection is not None and detection not in DETECTIONS:
        raise SettingsError(f"Unknown detection {detection!r}: choose {', '.join(DETECTIONS)}")
    faces = Faces(environment)
    count, total = len(faces), len(environment)
    name = DETECTIONS.get(detection, visibility)
    options = {"resolution": RESOLUTION} if name == "zbuffer" else {}
    sight = make_visibility(name, environment, threads, **options)
    here, there = np.nonzero(np.triu(np.ones((count, count), bool), 1))
    values, errors = exchanges(faces, here, there, 0.0)
    exchange, worst = np.zeros((count, count)), np.zeros((count, count))
    exchange[here, there], worst[here, there] = values, errors
    exchange, worst = exchange + exchange.T, worst + worst.T
    # From the smaller face the other's shadow is sharper, and its points lie closer together.
    smaller = faces.areas[:, None] <= faces.areas
    smaller[smaller & smaller.T] = np.triu(np.ones((count, count), bool), 1)[smaller & smaller.T]
    wanted = blockable_faces(faces) & (exchange > 0) & smaller
    shares, scatter = _shares(environment, faces, wanted, exchange / faces.areas[:, None], sight, accuracy, seed)
    shares = np.where(wanted.T, shares.T, shares)
    worst += np.where(wanted.T, scatter.T, scatter)
    areas, matrix, row_errors = environment.areas, np.zeros((total, total)), np.zeros(total)
    np.add.at(matrix, (faces.owners[:, None], faces.owners), exchange * shares)
    np.maximum.at(row_errors, faces.owners, worst.max(axis=1, initial=0))
    matrix = np.minimum(matrix / np.where(areas > 0, areas, 1)[:, None], 1)
    escaped = np.maximum(1 - matrix.sum(axis=1), 0)
    return SampledRows(matrix, escaped, row_errors, np.ones(total, dtype=np.int64), sight.rays, np.zeros(total))


def _shares(environment, faces, wanted, factors, sight, accuracy, seed):
    """Visible share (f, f) of wanted pairs, row the receiver, and the standard error of its factor; 1 elsewhere."""
    cells = face_cells(environment, faces)
    levels = _levels(environment, faces)
    shares, scatter = np.ones(wanted.shape), np.zeros(wanted.shape)
    pending = wanted.copy()
    for number, parts in enumerate(ROUNDS):
        rows = np.flatnonzero(pending.any(axis=1))
        if not len(rows):
            break
        samples = np.ones((REPETITIONS, *wanted.shape))
        for repetition in range(REPETITIONS):
            generator = np.random.default_rng((seed, number, repetition))
            receivers = Receivers.on(cells, faces, rows, parts, generator)
            samples[repetition][rows] = _visible(receivers, rows, faces, cells, pending, levels, sight, generator)
        shares[pending] = samples.mean(axis=0)[pending]
        error = factors * samples.std(axis=0, ddof=1) / np.sqrt(REPETITIONS)
        scatter[pending] = error[pending]
        pending &= error > GOAL * accuracy
    if scatter.max(initial=0) > accuracy:
        logger.warning("Form factors are accurate to %.2g only, not %.2g: sample limit", scatter.max(), accuracy)
    return shares, scatter


def _levels(environment, faces):
    """Levels of quartering (f, f) that each column's face may take, as seen from the row's.

    Reciprocity carries the factor over, so the bright source may be either of the two.
    """
    power = (environment.emission.max(axis=1) * environment.areas)[faces.owners]
    bright = (power > 0) & (power >= BRIGHT * power.max(initial=0))
    apart = np.linalg.norm(faces.centers[:, None] - faces.centers, axis=2)
    near = apart < NEAR * faces.radii
    return MOST_LEVEL + MORE_LEVELS * (near | bright | bright[:, None])


def _visible(receivers, rows, faces, cells, pending, levels, sight, generator):
    """Visible share (r, f) of what the rows' points get from each pending face, weighted by the closed form."""
    shape = (len(rows), len(faces))
    seen, whole = np.zeros(shape), np.zeros(shape)
    step = max(1, BLOCK_PIECES // (len(cells) * 4 ** (MOST_LEVEL + MORE_LEVELS) // 8 + 1))
    for begin in range(0, len(receivers.points), step):
        size = len(receivers.points[begin : begin + step])
        which = np.repeat(np.arange(begin, begin + size), len(cells))
        cell = np.tile(np.arange(len(cells)), size)
        kept = pending[rows[receivers.rows[which]], cells.patches[cell]]
        which, work = which[kept], cells[cell[kept]]
        for level in range(MOST_LEVEL + MORE_LEVELS + 1):
            if not len(which):
                break
            factors = piece_factors(receivers.points[which], receivers.normals[which], work)
            done = factors == 0
            passed = np.zeros(len(which))
            if level >= LEAST_LEVEL:
                open_ = np.flatnonzero(~done)
                passed[open_] = _seen_ends(receivers.points[which[open_]], work[open_], sight)
                done |= (passed == 0) | (passed == 1)
                last = level >= levels[rows[receivers.rows[which]], work.patches]
                mixed = np.flatnonzero(~done & last)
                passed[mixed] = _seen_quarters(receivers.points[which[mixed]], work[mixed], sight, generator)
                done |= last
            keys = receivers.rows[which[done]] * shape[1] + work.patches[done]
            weights = receivers.weights[which[done]] * factors[done]
            whole += np.bincount(keys, weights, whole.size).reshape(shape)
            seen += np.bincount(keys, weights * passed[done], whole.size).reshape(shape)
            which, work = np.repeat(which[~done], 4), work[~done].divided(2)
    return np.where(whole > 0, seen / np.where(whole > 0, whole, 1), 1)


def _seen_ends(points, pieces, sight):
    """Share (w,) of the corners and the center of each piece that its point sees."""
    near, far = INWARD, 1 - INWARD
    square = np.array([[near, near], [far, near], [near, far], [far, far], [0.5, 0.5]])
    triangle = np.array([[near, near], [far - near, near], [near, far - near], [0.5 - near / 2] * 2, [1 / 3, 1 / 3]])
    places = np.where(pieces.triangular[:, None, None], triangle, square)
    targets = pieces.origins[:, None] + places[:, :, :1] * pieces.u[:, None] + places[:, :, 1:] * pieces.v[:, None]
    seen = sight.visible(np.repeat(points, len(square), axis=0), targets.reshape(-1, 3))
    return seen.reshape(-1, len(square)).mean(axis=1)


def _seen_quarters(points, pieces, sight, generator):
    """Share (w,) of the quarters of each piece that its point sees, each at a random place."""
    quarters = pieces.divided(2)
    targets = quarters.points(generator.random((len(quarters), 2)))
    return sight.visible(np.repeat(points, 4, axis=0), targets).reshape(-1, 4).mean(axis=1)


def piece_factors(points: np.ndarray, normals: np.ndarray, pieces: Cells) -> np.ndarray:
    """Closed-form factor (w,) from each point and unit normal (w, 3) to its own piece, cut at the horizon."""
    third = pieces.u + np.where(pieces.triangular[:, None], 0, pieces.v)
    ends = [0 * pieces.u, pieces.u, np.where(pieces.triangular[:, None], pieces.v, third), pieces.v]
    rays = np.stack(ends, axis=1) + (pieces.origins - points)[:, None]
    front = -np.einsum("wi,wi->w", rays[:, 0], np.cross(pieces.u, pieces.v)) > 0
    heights = np.einsum("wki,wi->wk", rays, normals)
    factors = np.zeros(len(points))
    rows = np.flatnonzero(front & (heights > 0).any(axis=1))
    loops = clip_loops(rays[rows], heights[rows]).transpose(2, 1, 0)
    following = np.roll(loops, -1, axis=1)
    crosses = [loops[i] * following[j] - loops[j] * following[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    cosines = np.einsum("ikw,ikw->kw", loops, following)
    # A repeated corner at the point itself would make 0 / 0.
    cosines[cosines == 0] = np.finfo(np.float64).tiny
    factors[rows] = lambert_sum(crosses, normals[rows].T, None, cosines).clip(0, 1)
    return factors


def hybrid_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches: the closed form of each piece that is visible.

    Parameters
    ----------
    environment : Environment
    visibility : str
        Any that tests segments.
    accuracy : float
        Relative error wanted of the light that a point gathers. Pieces are cut while they are mixed and their factor
        is above `POINT_SHARE` of it, or may hide something and are above `UNTESTED` of it.
    seed : int
        Of the tests of the last pieces.
    threads : int
        Threads of the ray engine, where it is used.

    Returns
    -------
    PointRows
    """
    faces = Faces(environment)
    cells = face_cells(environment, faces)
    owners = faces.owners[cells.patches]
    sight = make_visibility(visibility, environment, threads)
    count = len(environment)

    def rows(points: np.ndarray, normals: np.ndarray, names: np.ndarray) -> np.ndarray:
        generator = np.random.default_rng((seed, int(names[0])))
        which, cell = (index.ravel() for index in np.indices((len(points), len(cells))))
        work, keys = cells[cell], which * count + owners[cell]
        out = np.zeros(len(points) * count)
        for level in range(POINT_LEVELS + 1):
            factors = piece_factors(points[which], normals[which], work)
            lit = np.flatnonzero(factors > 0)
            which, work, keys, factors = which[lit], work[lit], keys[lit], factors[lit]
            passed = _seen_ends(points[which], work, sight)
            even = (passed == 0) | (passed == 1)
            done = np.where(even, factors <= UNTESTED * accuracy, factors <= POINT_SHARE * accuracy)
            if level == POINT_LEVELS:
                done[:] = True
            mixed = np.flatnonzero(done & ~even)
            passed[mixed] = _seen_quarters(points[which[mixed]], work[mixed], sight, generator)
            out += np.bincount(keys[done], factors[done] * passed[done], len(out))
            which, keys, work = np.repeat(which[~done], 4), np.repeat(keys[~done], 4), work[~done].divided(2)
            if not len(which):
                break
        return np.minimum(out, 1).reshape(len(points), count)

    return rows
