"""Hemisphere: rays from points all over a patch, in directions of equal contribution (Nusselt's analog, survey fig. 6).

A ray stands for an equal share of the power that leaves the patch, so a form factor is the share of rays that meet the
other patch's front. Occlusion, partial visibility, and patches that touch need no special case, and one set of rays
gives a whole row of the matrix, including what escapes. Choose it for whole environments; for a single far or
unoccluded pair a closed form is better.

Origins and directions come from one four-dimensional low-discrepancy sequence. Each row is computed several times with
independent random shifts; their scatter is the error estimate, and rows whose error is above the wanted one are
computed again with as many more rays as its measured fall, samples^-0.6, asks for. Cost: rays, at 0.1 to 0.5
microseconds each; a few ten thousand per patch for an error of 1e-3.

Limits: factors far below the wanted accuracy come out as noise or 0. Rays start `RayEngine.offset`, 1e-5 of the scene,
above their patch, so gaps and wedges below that are lost. Where two patches lie back to back, the one that faces the
ray is met: faces are traced slightly in front of their polygons.
"""

from __future__ import annotations

import logging
from copy import copy
from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.embree import OFFSET, RayEngine
from .point_rows import PointRows, shifts_of_names
from .sampling import PatchSampler, frames, hemisphere_directions, kronecker_points
from .scatter import steadied_by_class
from .sobol import sobol_points

#: Independent repetitions of each row: enough for an error estimate that is itself good to a quarter.
REPETITIONS = 8

#: Rays per patch and repetition in the first round, at most and at least. A coarser accuracy than the one at which the
#: most are wanted takes fewer, by the fall of the error: 948 patches of a furnished room err by 0.007 with the most.
FIRST_RAYS, FIRST_ACCURACY = 512, 1e-2
FEWEST_RAYS = 32

#: The most rays per patch and repetition.
MOST_RAYS = 2**21

#: Rays in flight: about 60 MB of origins, directions and hits.
BLOCK_RAYS = 2**18

#: Rays of a single point at an accuracy of 3 % of its light, as many as the automatic bake takes.
POINT_RAYS = 384

#: Fall of the error with the number of rays, by sampling: 1/2 for independent rays; low discrepancy lies between that
#: and 5/8, the limit for edges of patches seen in four dimensions.
FALLS = {"low_discrepancy": 0.6, "random": 0.5}

#: How far in front of its polygon a one-sided face is traced, in `RayEngine.offset`s: above the rounding of float32 hit
#: distances, below the start of rays.
FACE_SHIFT = 0.1

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SampledRows:
    """Rows of a form-factor matrix as counted.

    Attributes
    ----------
    matrix : (n, n) float64
    escaped : (n,) float64
        Share that meets nothing, or the back of a one-sided patch.
    errors : (n,) float64
        Standard error of each row's worst factor.
    samples : (n,) int64
        Samples behind each row.
    rays : int
        Rays cast in all, abandoned rounds included.
    leaks : (n,) float64
        Share of each row that rays may lose through seams of a closed scene, because they start off the surface.
    deviations : (n, n) float64, optional
        Standard error of each factor, by methods that fill whole rows.
    variances : (n, n) float64, optional
        Of exchange areas, joined from both ends of each pair, where these are known: see `uncertain_pairs`.
    """

    matrix: np.ndarray
    escaped: np.ndarray
    errors: np.ndarray
    samples: np.ndarray
    rays: int
    leaks: np.ndarray
    deviations: np.ndarray | None = None
    variances: np.ndarray | None = None


def hemisphere_rows(
    environment: Environment,
    accuracy: float,
    seed: int = 0,
    threads: int = 0,
    sampling: str = "low_discrepancy",
    wanted: np.ndarray | None = None,
) -> SampledRows:
    """Form factors of all patches, or of some, by ray casting.

    Parameters
    ----------
    environment : Environment
    accuracy : float
        Standard error wanted for the worst factor of each row.
    seed : int
    threads : int
        Threads of the ray engine; 0 takes all cores. The result does not depend on it.
    sampling : str
        ``low_discrepancy``, or ``random`` for independent rays, whose error falls more slowly.
    wanted : (n,) bool, optional
        Patches to cast rays from; the rows of others stay 0. A row does not depend on which others are wanted.

    Returns
    -------
    SampledRows
        Errors may exceed `accuracy` where the largest number of rays did not suffice; a warning is logged.

    Raises
    ------
    SettingsError
        If the sampling is unknown.

    References
    ----------
    .. [1] Nusselt, "Graphische Bestimmung des Winkelverhältnisses bei der Wärmestrahlung", VDI Zeitschrift 72, 1928.
    """
    if sampling not in FALLS:
        raise SettingsError(f"Unknown sampling {sampling!r} of the hemisphere: choose {', '.join(FALLS)}")
    caster = RowCaster(environment, threads, sampling)
    count = len(environment)
    rows = np.arange(count) if wanted is None else np.flatnonzero(wanted)
    *found, cast = caster.refined(rows, accuracy, seed)
    matrix, escaped, errors, samples, deviations = (_spread(values, rows, count) for values in found)
    if count and errors.max() > accuracy:
        logger.warning("Form factors are accurate to %.2g only, not %.2g: ray limit", errors.max(), accuracy)
    return SampledRows(matrix, escaped, errors, samples, cast, seam_leaks(environment, caster.offset), deviations)


def _spread(values, rows, count):
    """Values of some rows among zeros for all others."""
    if len(rows) == count:
        return values
    spread = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
    spread[rows] = values
    return spread


def seam_leaks(environment: Environment, offset: float) -> np.ndarray:
    """Share (n,) of each patch's rays that start beyond a neighbor, having been moved by `offset` off their patch.

    A strip of about that width along the border, whatever the neighbor's slant down to 45 degrees, and twice that for
    sharper ones; never more than 1 %, so that patches of the offset's own size cannot make an open scene look closed.
    """
    lengths = [np.linalg.norm(np.diff(p, axis=0, append=p[:1]), axis=1).sum() for p in environment.polygons]
    areas = environment.areas / np.where(environment.two_sided, 2, 1)
    return np.minimum(2 * offset * np.array(lengths) / np.where(areas > 0, areas, np.inf), 0.01)


def _row_blocks(rows, size, count):
    """Split rows so that neither rays nor counts of a block outgrow their bounds."""
    length = max(1, min(BLOCK_RAYS // size, 2**23 // (count + 1)))
    return np.split(rows, range(length, len(rows), length))


def standard_error(factors: np.ndarray | float, rays: np.ndarray | float) -> np.ndarray | float:
    """Standard error of form factors counted with independent rays: ``sqrt(F (1 - F) / N)``."""
    return np.sqrt(factors * (1 - factors) / rays)


def _independent(rows: np.ndarray, count: int, seed: tuple[int, ...]) -> np.ndarray:
    """(r, count, 4) random points, each row's the same whatever other rows there are."""
    return np.stack([np.random.default_rng((*seed, int(row))).random((count, 4)) for row in rows])


class RowCaster:
    """Rays from receivers, counted by the patch they meet.

    Parameters
    ----------
    environment : Environment
        What is met, and what sends unless `of_receivers` puts others in its place.
    threads : int
    sampling : str
        A key of `FALLS`.
    """

    def __init__(self, environment: Environment, threads: int, sampling: str = "low_discrepancy"):
        self.sampling = sampling
        self.count = len(environment)
        self.met_normals, self.met_two_sided = environment.normals, np.append(environment.two_sided, False)
        corners = environment.vertices[environment.triangles]
        owners = environment.triangle_patches
        size = np.ptp(corners.reshape(-1, 3), axis=0).max() if len(corners) else 0.0
        shift = np.where(environment.two_sided, 0, FACE_SHIFT * OFFSET * size)[owners]
        corners = corners + (shift[:, None] * environment.normals[owners])[:, None, :]
        self.engine = RayEngine(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), threads)
        self.owners = np.append(owners, self.count)
        self.offset = self.engine.offset
        self._send_from(environment, np.arange(self.count))

    def _send_from(self, receivers, names):
        self.names = names
        self.areas, self.normals, self.two_sided = receivers.areas, receivers.normals, receivers.two_sided
        self.frames = frames(receivers.normals)
        self.sampler = PatchSampler(receivers)

    def of_receivers(self, receivers: Environment, names: np.ndarray) -> RowCaster:
        """The same patches as met from other polygons, whose random shifts go by their `names` (r,) int."""
        other = copy(self)
        other._send_from(receivers, names)
        return other

    def refined(self, rows: np.ndarray, accuracy: float, seed: int):
        """Factors (r, n), escaped shares, errors and samples (r,) of some receivers, deviations (r, n), and rays cast.

        A row does not depend on which others are asked for.
        """
        matrix, escaped, errors = np.zeros((len(rows), self.count)), np.zeros(len(rows)), np.zeros(len(rows))
        deviations = np.zeros_like(matrix)
        samples, rays = np.zeros(len(rows), dtype=np.int64), np.full(len(rows), self._first_rays(accuracy))
        pending, rounds, cast = np.flatnonzero(self.areas[rows] > 0), 0, 0
        while len(pending):
            cast += int(rays[pending].sum()) * REPETITIONS
            for size in np.unique(rays[pending]):
                for part in _row_blocks(pending[rays[pending] == size], int(size), self.count):
                    shares, deviations[part], errors[part] = self.rows(rows[part], int(size), (seed, rounds))
                    matrix[part], escaped[part] = shares[:, :-1], shares[:, -1]
                    samples[part] = size * REPETITIONS
            pending = pending[(errors[pending] > accuracy) & (rays[pending] < MOST_RAYS)]
            wanted = rays[pending] * np.clip((errors[pending] / accuracy) ** (1 / FALLS[self.sampling]), 2, 64)
            rays[pending] = np.minimum(2 ** np.ceil(np.log2(np.maximum(wanted, 2))), MOST_RAYS).astype(np.int64)
            rounds += 1
        return matrix, escaped, errors, samples, deviations, cast

    def _first_rays(self, accuracy):
        """Rays per patch and repetition of the first round, a power of two."""
        wanted = FIRST_RAYS * min(FIRST_ACCURACY / accuracy, 1) ** (1 / FALLS[self.sampling])
        return max(2 ** int(np.ceil(np.log2(wanted))), min(FEWEST_RAYS, FIRST_RAYS))

    def rows(self, rows: np.ndarray, size: int, seed: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean shares (r, n + 1) over all repetitions, last column escaped; their standard errors (r, n), and the worst
        of each row (r,)."""
        table = sobol_points(size, 4)
        total = np.zeros((len(rows), self.count + 1))
        squares = np.zeros_like(total)
        for repetition in range(REPETITIONS):
            # Drawn for all patches, so that a row's shift does not depend on the rows that share its block.
            shifts = np.random.default_rng((*seed, repetition)).random((self.names.max() + 1, 4))[self.names[rows]]
            shares = 0
            for begin in range(0, size, BLOCK_RAYS):
                part = table[begin : begin + BLOCK_RAYS]
                if self.sampling == "random":
                    points = _independent(self.names[rows], len(part), (*seed, repetition, begin))
                else:
                    points = (part + shifts[:, None]) % 1
                shares = shares + self._count(rows, points)
            shares = shares / size
            total += shares
            squares += shares * shares
        mean = total / REPETITIONS
        variance = np.maximum(squares / REPETITIONS - mean * mean, 0) / (REPETITIONS - 1)
        # Rays that never met a patch do not tell a factor of one ray's share from none.
        least = 1 / (size * REPETITIONS)
        known = np.sqrt(steadied_by_class(variance[:, :-1], mean[:, :-1]))
        deviations = np.where(mean[:, :-1] > 0, known, least)
        return mean, deviations, np.maximum(np.sqrt(variance[:, :-1].max(axis=1)), least)

    def _count(self, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Rays (r, n + 1) that meet each patch, or none, for points (r, s, 4) of the unit cube."""
        length = points.shape[1]
        origins = self.sampler(rows, points[:, :, :2])
        local = hemisphere_directions(points[:, :, 2:])
        # Half of the rays of a two-sided patch leave from its back: a run of them, spread as evenly as all are.
        # Every other one would not be, for even and odd Sobol' points lie in two halves of the patch.
        side = np.where(self.two_sided[rows][:, None] & (np.arange(length) >= (length + 1) // 2), -1.0, 1.0)
        local[:, :, 2] *= side
        directions = np.matmul(local, self.frames[rows])
        origins += (self.offset * side)[:, :, None] * self.normals[rows][:, None]
        directions = directions.reshape(-1, 3)
        bins = self.met(origins.reshape(-1, 3), directions) + np.repeat(np.arange(len(rows)) * (self.count + 1), length)
        return np.bincount(bins, minlength=len(rows) * (self.count + 1)).reshape(len(rows), -1)

    def met(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(r,) patch whose radiating side each ray meets, or the number of patches for none."""
        return self.seen(self.engine.closest(origins, directions)[0], directions)

    def seen(self, triangles: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(r,) patch whose radiating side a ray sees that has hit a triangle, or the number of patches for none."""
        met = self.owners[triangles]
        facing = np.einsum("ri,ri->r", directions, self.met_normals[np.minimum(met, self.count - 1)]) < 0
        seen = facing | self.met_two_sided[met]
        return np.where(seen, met, self.count)


def hemisphere_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches, as shares of rays of equal contribution.

    Parameters
    ----------
    environment : Environment
    visibility : str
        ``embree``.
    accuracy : float
        Relative error wanted of the light that a point gathers: `POINT_RAYS` at 3 %, and by the square root of that.
    seed : int
        Turns the directions of each point.
    threads : int

    Returns
    -------
    PointRows

    Raises
    ------
    MissingRayEngineError
        If rays cannot be traced on this platform.
    """
    caster = RowCaster(environment, threads, "low_discrepancy")
    rays = int(np.clip(8 * round(POINT_RAYS * (0.03 / accuracy) ** 0.5 / 8), 128, 1024))
    table = kronecker_points(rays, 2)

    def rows(points: np.ndarray, normals: np.ndarray, names: np.ndarray) -> np.ndarray:
        local = hemisphere_directions((table + shifts_of_names(names, seed, 2)[:, None]) % 1)
        directions = np.matmul(local, frames(normals)).reshape(-1, 3)
        bins = caster.met(np.repeat(points, rays, axis=0), directions) + np.repeat(
            np.arange(len(points)) * (caster.count + 1), rays
        )
        hits = np.bincount(bins, minlength=len(points) * (caster.count + 1)).reshape(len(points), -1)
        return hits[:, :-1] / rays

    return rows
