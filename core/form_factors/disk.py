"""Ray-traced disks: factors from points to patches that are sampled by small disks (survey eq. 11).

Each sample stands for a cell of the patch, taken as a disk of the same area that looks where the cell looks; rays tell
whether it is seen. So every receiver, such as a vertex, gets its own visibility, and the kernel stays finite at contact
where the point-to-point formula does not. The number of samples is the same for each pair, on an even grid or jittered
within its cells, or, by default, adapted: cells are quartered until the bound of their error, known from size and
distance, is what the accuracy allows. Choose it for receivers in points; between patches the area average over points
of the receiver is taken, until its scatter is below the accuracy, too.

Cost: a ray per sample; with adaption about ``F / accuracy`` samples for each point and patch, fewer where both are far
apart. Limits: the error falls as 1 / samples, so beyond 1e-4 other methods are cheaper. The bound is that of the
kernel; what visibility adds shows in the scatter.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.segments import make_visibility
from .cells import Cells
from .faces import Faces
from .hemisphere import SampledRows
from .pair_rows import blockable_faces
from .point_rows import PointRows
from .receivers import Receivers, face_cells, patch_rows

#: Bound of a disk's relative error, in squares of cell radius over distance to the cell: 1.3 for a square that looks at
#: the point, up to 2 for slanted and skewed ones; and that of a cell through which the receiver's horizon passes, in
#: cell radius over distance.
BOUND = 2.0
HORIZON_BOUND = 0.25

#: Quarterings after which a cell is taken as it is; its bound says what that may cost.
DEEPEST = 12

#: Independent repetitions of the area average, and cuts along each side of a patch's cells in successive rounds: each
#: part gets two or three points.
REPETITIONS = 8
ROUNDS = (1, 2, 4, 8)

#: Standard error of the average that is aimed at, as a share of the accuracy asked for: see `visible_share`.
GOAL = 0.08

#: Bound of a point's error, in units of the factor, over the accuracy asked for between patches: factors are seldom
#: above a half, and the error is a fifth of its bound.
SLACK = 2.0

#: Bound of a point's error, relative to each factor or in units of it, over the relative error of its light.
POINT_SLACK = 2.0

#: Points times cells in hand at once: about 100 MB.
BLOCK_CELLS = 2**18

SAMPLINGS = ("adaptive", "uniform", "jittered")

logger = logging.getLogger(__name__)


def point_to_disks(here: np.ndarray, there: np.ndarray, squares: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Factors from points to fully visible cells, each as a disk.

    As printed in the survey (eq. 11) the formula lacks the patch's area; here it stands.

    Parameters
    ----------
    here, there : (n,) float
        Heights of the cell above the point's horizon, and of the point above the cell's plane. Negative ones yield 0.
    squares : (n,) float
        Squared distances to the center of the cell, above 0.
    areas : (n,) float
        Areas of the cells.

    Returns
    -------
    (n,) float64

    References
    ----------
    .. [1] Wallace, Elmquist, Haines, "A Ray Tracing Algorithm for Progressive Radiosity", SIGGRAPH 1989.
    """
    return areas * np.maximum(here, 0) * np.maximum(there, 0) / (squares * (np.pi * squares + areas))


def disk_factor(
    point: np.ndarray, normal: np.ndarray, polygon: np.ndarray, samples: int = 16, jitter: int | None = None
) -> float:
    """Factor from a differential area to a fully visible polygon, by the same number of disks everywhere.

    Parameters
    ----------
    point, normal : (3,) float
        Place, and unit normal.
    polygon : (k, 3) float
        Planar loop, counter-clockwise seen from its front.
    samples : int
        Disks: the square of a whole number for a parallelogram, that many for each triangle of other polygons.
    jitter : int, optional
        Seed of random places within the cells; else their centers.

    Returns
    -------
    float

    Raises
    ------
    SettingsError
        If `samples` is not a square.
    InvalidPolygonError
        If the polygon is malformed.
    """
    cells = Cells.of(Environment.from_polygons([polygon])).divided(_grid_side(samples))
    square = None if jitter is None else np.random.default_rng(jitter).random((len(cells), 2))
    rays = (cells.centers() if square is None else cells.points(square)) - np.asarray(point, dtype=np.float64)
    squares = np.einsum("ci,ci->c", rays, rays)
    there = -np.einsum("ci,ci->c", rays, _unit_normals(cells))
    return float(point_to_disks(rays @ np.asarray(normal), there, squares, cells.areas()).sum())


def adaptive_disk_factor(
    point: np.ndarray, normal: np.ndarray, polygon: np.ndarray, accuracy: float = 1e-3
) -> tuple[float, float, int]:
    """Factor from a differential area to a fully visible polygon, by as many disks as its error bound asks for.

    Returns
    -------
    factor, bound : float
        `bound` is that of the error; it exceeds the accuracy only where point and polygon nearly touch, or the horizon
        crosses the polygon.
    samples : int
    """
    environment = Environment.from_polygons([polygon])
    receivers = Receivers(
        np.atleast_2d(point).astype(float), np.atleast_2d(normal).astype(float), np.zeros(1, int), np.ones(1)
    )
    tally, targets = (
        _Tally(np.ones((1, 1), bool)),
        _Targets(Cells.of(environment), environment.areas, environment.normals),
    )
    _gather(receivers, targets, accuracy / 2, None, tally)
    return float(tally.values[0, 0]), float(tally.bounds[0, 0]), tally.samples


def disk_rows(
    environment, visibility="embree", accuracy=1e-3, seed=0, threads=0, sampling="adaptive", samples=16
) -> SampledRows:
    """Form factors of all patches, averaged over points of each.

    Parameters
    ----------
    environment : Environment
    visibility : str
        Any that tests segments, or ``none``.
    accuracy : float
        Bound wanted for each factor's error.
    seed, threads : int
    sampling : str
        ``adaptive``; or ``uniform`` or ``jittered``, with `samples` disks for each pair.
    samples : int
        A square.

    Returns
    -------
    SampledRows
        `errors` sum the bound of the kernel and the standard error of the average.

    Raises
    ------
    SettingsError
        If a name or number is unknown.
    """
    if sampling not in SAMPLINGS:
        raise SettingsError(f"Unknown sampling {sampling!r} of disks: choose {', '.join(SAMPLINGS)}")
    faces = Faces(environment)
    sight = (
        None if visibility == "none" else _Sight(environment, faces, make_visibility(visibility, environment, threads))
    )
    cells = face_cells(environment, faces)
    if sampling != "adaptive":
        cells = cells.divided(_grid_side(samples))
    plain = face_cells(environment, faces)
    count = len(faces)
    values, errors = np.zeros((count, count)), np.zeros((count, count))
    used = np.zeros(count, dtype=np.int64)
    wanted = ~np.eye(count, dtype=bool)
    for number, parts in enumerate(ROUNDS):
        step = max(1, BLOCK_CELLS // (12 * parts * parts * max(len(cells), 1)))
        pending = np.flatnonzero(wanted.any(axis=1))
        for block in np.split(pending, range(step, len(pending), step)):
            total, squares, bounds = (np.zeros((len(block), count)) for _ in range(3))
            for repetition in range(REPETITIONS):
                key = (seed, number, repetition)
                moved = _jittered(cells, np.random.default_rng((*key, 1))) if sampling == "jittered" else cells
                tally = _Tally(wanted[block])
                _gather(
                    Receivers.on(plain, faces, block, parts, np.random.default_rng(key)),
                    _Targets(moved, faces.areas, faces.normals),
                    SLACK * accuracy if sampling == "adaptive" else None,
                    None if sight is None else sight.of(block),
                    tally,
                )
                total += tally.values
                squares += tally.values**2
                bounds += tally.bounds
                used[block] += tally.samples // len(block)
            mean = total / REPETITIONS
            variance = np.maximum(squares / REPETITIONS - mean * mean, 0) / (REPETITIONS - 1)
            renewed = wanted[block]
            values[block] = np.where(renewed, mean, values[block])
            errors[block] = np.where(renewed, bounds / REPETITIONS + np.sqrt(variance), errors[block])
            wanted[block] = renewed & (variance > (GOAL * accuracy) ** 2)
        if not wanted.any():
            break
    # Of a share of 1 nothing can be further off.
    worst = np.minimum(errors.max(axis=1, initial=0), 1)
    if worst.max(initial=0) > accuracy:
        logger.warning("Form factors are accurate to %.2g only, not %.2g: sample limit", worst.max(), accuracy)
    return patch_rows(environment, faces, values, worst, used, 0 if sight is None else sight.visibility.rays)


def _grid_side(samples):
    side = round(samples**0.5)
    if side < 1 or side * side != samples:
        raise SettingsError(f"Disks fill a square grid: give a square such as 16 for samples, not {samples}")
    return side


def _unit_normals(cells):
    normals = np.cross(cells.u, cells.v)
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def _jittered(cells, generator):
    """Cells moved so that their centers are random points of where they were."""
    shift = cells.points(generator.random((len(cells), 2))) - cells.centers()
    return Cells(cells.origins + shift, cells.u, cells.v, cells.triangular, cells.patches)


class _Targets:
    """Cells to be seen, and the areas and normals of the faces they belong to."""

    def __init__(self, cells, areas, normals):
        self.cells, self.areas, self.normals = cells, areas, normals
        self.sizes, self.radii = cells.areas(), cells.radii()


class _Tally:
    """Averages over the points of each row, for each wanted face, of factors and of error bounds; samples in all."""

    def __init__(self, wanted):
        self.wanted = wanted
        self.values, self.bounds = np.zeros(wanted.shape), np.zeros(wanted.shape)
        self.samples = 0

    def add(self, rows, faces, values, bounds):
        shape = self.values.shape
        keys = rows * shape[1] + faces
        self.values += np.bincount(keys, values, shape[0] * shape[1]).reshape(shape)
        self.bounds += np.bincount(keys, bounds, shape[0] * shape[1]).reshape(shape)
        self.samples += len(values)


class _Sight:
    """Visibility, asked only for pairs of faces that something may block."""

    def __init__(self, environment, faces, visibility):
        self.visibility = visibility
        self._blocked = blockable_faces(faces)

    def of(self, block):
        """Visibility of points whose rows are numbered within a block of faces."""

        def see(rows, faces, origins, targets):
            seen = np.ones(len(rows), bool)
            asked = np.flatnonzero(self._blocked[block[rows], faces])
            seen[asked] = self.visibility.visible(origins[asked], targets[asked])
            return seen

        return see


def _gather(receivers, targets, accuracy, see, tally):
    """Add to `tally` the factors from receivers to all cells, quartered as `accuracy` asks for.

    Without accuracy cells are taken as they are.
    """
    cells = targets.cells
    step = max(1, BLOCK_CELLS // max(len(cells), 1))
    for begin in range(0, len(receivers.points), step):
        size = len(receivers.points[begin : begin + step])
        which = np.repeat(np.arange(begin, begin + size), len(cells))
        cell = np.tile(np.arange(len(cells)), size)
        kept = tally.wanted[receivers.rows[which], cells.patches[cell]]
        which, cell = which[kept], cell[kept]
        work = _Work(which, cells[cell], targets.sizes[cell], targets.radii[cell])
        for depth in range(DEEPEST + 1):
            rest = _take(receivers, work, targets, None if depth == DEEPEST else accuracy, see, tally)
            if not len(rest):
                break
            work = work.quartered(rest)


@dataclass(frozen=True)
class _Work:
    """Pairs of a point and a cell."""

    which: np.ndarray
    cells: Cells
    sizes: np.ndarray
    radii: np.ndarray

    def quartered(self, rows):
        """Some of the pairs, with each cell in four."""
        return _Work(
            np.repeat(self.which[rows], 4),
            self.cells[rows].divided(2),
            np.repeat(self.sizes[rows] / 4, 4),
            np.repeat(self.radii[rows] / 2, 4),
        )


def _take(receivers, work, targets, accuracy, see, tally):
    """Tally those pairs of point and cell that are fine enough; returns the rows of the others."""
    faces, radii, sizes = work.cells.patches, work.radii, work.sizes
    rays = work.cells.centers() - receivers.points[work.which]
    squares = np.einsum("wi,wi->w", rays, rays)
    here = np.einsum("wi,wi->w", rays, receivers.normals[work.which])
    there = -np.einsum("wi,wi->w", rays, targets.normals[faces])
    lit = (there > 0) & (here > -radii)
    nearest = np.maximum(np.sqrt(squares) - radii, there)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratios = radii / nearest
        relative = BOUND * ratios**2
        greatest = np.minimum(sizes / (np.pi * nearest**2), 1)
    if accuracy is None:
        done = lit
    else:
        # A cell's share of the accuracy is that of the area, or of the factor, whichever allows more.
        done = lit & ((relative <= accuracy) | (greatest * relative <= accuracy * sizes / targets.areas[faces]))
    chosen = np.flatnonzero(done)
    index, faces = work.which[chosen], faces[chosen]
    values = point_to_disks(here[chosen], there[chosen], squares[chosen], sizes[chosen])
    crossed = np.abs(here[chosen]) < radii[chosen]
    bounds = np.where(crossed, np.maximum(relative[chosen], HORIZON_BOUND * ratios[chosen]), relative[chosen])
    bounds = np.minimum(bounds, 1) * greatest[chosen]
    if see is not None:
        tested = np.flatnonzero(values > 0)
        origins = receivers.points[index[tested]]
        values[tested] *= see(receivers.rows[index[tested]], faces[tested], origins, origins + rays[chosen[tested]])
    weights = receivers.weights[index]
    tally.add(receivers.rows[index], faces, weights * values, weights * bounds)
    return np.flatnonzero(lit & ~done)


def disk_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches, by as many disks as the bound of each factor's error asks for.

    Parameters
    ----------
    environment : Environment
    visibility : str
        Any that tests segments.
    accuracy : float
        Relative error wanted of the light that a point gathers. Errors of factors are bounds of one sign or the other,
        and are shared out by area: the whole row keeps `POINT_SLACK` of it as its bound.
    seed : int
        Nothing is random.
    threads : int
        Threads of the ray engine, where it is used.

    Returns
    -------
    PointRows
    """
    faces = Faces(environment)
    targets = _Targets(face_cells(environment, faces), faces.areas, faces.normals)
    sight = make_visibility(visibility, environment, threads)
    count = len(environment)

    def see(rows, faces, origins, targets):
        return sight.visible(origins, targets)

    def rows(points: np.ndarray, normals: np.ndarray, names: np.ndarray) -> np.ndarray:
        receivers = Receivers(points, normals, np.arange(len(points)), np.ones(len(points)))
        tally = _Tally(np.ones((len(points), len(faces)), bool))
        _gather(receivers, targets, POINT_SLACK * accuracy, see, tally)
        out = np.zeros((len(points), count))
        np.add.at(out.T, faces.owners, tally.values.T)
        return np.minimum(out, 1)

    return rows
