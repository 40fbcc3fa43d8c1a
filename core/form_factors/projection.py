"""Rows of form factors by projection: what a camera of pixels at points of a patch sees, averaged.

The part that hemicube and single plane share. A camera projects all polygons onto its pixels, each of which stands for
a known share of the power that leaves the point. A patch's row is the mean over points of a lattice rule, with the
camera turned about the normal by another angle at each, so that the errors of pixels that straddle a border average
out. Each row is computed several times with independent shifts of the points;
their scatter is the error estimate. Rows whose error is above the wanted one get as many more points as its fall asks
for, but only their uncertain factors are computed anew. These are mostly those of neighbors, so that only what lies
between a patch and these has to be drawn.

Coherence: points of one patch and of its neighbors in the list are projected together. What lies behind all their
tangent planes is dropped once for all of them and all their faces; what remains is the list from which each view takes
what it has in its field. Measured on 1,056 patches of a room with two subdivided boxes, CPU time of rows without the
shared list over time with it: 1.06 for a wall, 1.46 for a box.

Cost: about a millisecond for each point and a thousand polygons. Memory: blocks of rows, about 100 MB whatever n.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..environment import Environment
from ..frames import turned_frames
from ..visibility.zbuffer import Loops
from .hemisphere import SampledRows
from .patch_points import PatchPoints, fibonacci_lattice, fold

#: Cameras times accuracy that a computation takes at least, spread over its patches: where these are few they cost so
#: little that each gets more points than the accuracy asks for.
LEAST_CAMERAS = 8.0

#: Rounds after which the error reached is reported.
ROUNDS = 8

#: Largest level of the lattices, 17711 points a piece and repetition, and of its growth from round to round.
MOST_LEVEL = 20
MOST_STEPS = 7

#: Fall of the error with the number of points, measured on rooms with touching walls.
FALL = 1.2

#: Part of a turn by which each angle of the turned cameras differs from the one before.
GOLDEN = (5**0.5 - 1) / 2

#: Error, as a share of the one wanted, from which on a factor of a row is computed anew. Each factor's own error is
#: known from few repetitions only: one that seems right by luck shall not be left as it is.
UNCERTAIN = 0.5

#: Classes of factors that count as alike, each of a fourth of the one before: the last holds all below 4e-6.
CLASSES = 10

#: Uncertain factors of a row from which on everything is drawn.
MANY = 128

#: Share that escapes by rounding where nothing does.
NOTHING = 1e-9

#: Pixels plus polygons of all cameras in one block; entries of the rows computed together, and of pairs of a factor and
#: a polygon that may be in between.
BLOCK_PIXELS = 2**20
BLOCK_ENTRIES = 2**20

logger = logging.getLogger(__name__)


class Camera(Protocol):
    """Pixels around a normal.

    Attributes
    ----------
    deltas : (c,) float64
        Share of the power that leaves the point through each pixel.
    lost : float
        Share that leaves through none.
    """

    deltas: np.ndarray
    lost: float

    def items(
        self, points: np.ndarray, frames: np.ndarray, loops: Loops, drawn: np.ndarray | None = None
    ) -> np.ndarray:
        """(p, c) int32: polygon seen through each pixel from points (p, 3), -1 for none.

        `frames` (p, 3, 3) have two tangents and the normal as rows; `drawn` (p, n) bool tells which polygons each point
        draws, if not all.
        """


def projection_rows(environment: Environment, cameras: Sequence[Camera], accuracy: float, seed: int = 0) -> SampledRows:
    """Form factors of all patches by cameras.

    Parameters
    ----------
    environment : Environment
    cameras : sequence of Camera
        One for each independent repetition of a row, two or more. Let them differ a little in their pixels, so that
        what these have in common does not escape the error estimate.
    accuracy : float
        Standard error wanted for the worst factor of each row.
    seed : int

    Returns
    -------
    SampledRows
        `errors` holds standard errors of each row's worst factor, but no less than what a patch may contribute that no
        pixel has met; the camera's lost share is added. `rays` is 0.
    """
    count = len(environment)
    matrix, escaped, errors = np.zeros((count, count)), np.zeros(count), np.zeros(count)
    samples = np.zeros(count, dtype=np.int64)
    radiating = np.flatnonzero(environment.areas > 0)
    scene = _Scene(environment, cameras)
    lost = scene.lost
    level = _first_level(len(radiating) * len(cameras), accuracy)
    length = max(1, BLOCK_ENTRIES // count)
    for rows in np.split(radiating, range(length, len(radiating), length)):
        matrix[rows], escaped[rows], errors[rows], samples[rows] = scene.refined_rows(rows, level, accuracy, seed)
    if errors.max(initial=0) > accuracy:
        logger.warning("Form factors are accurate to %.2g only, not %.2g: limit of points", errors.max(), accuracy)
    return SampledRows(
        matrix=matrix,
        escaped=escaped,
        errors=np.where(environment.areas > 0, errors + lost, 0),
        samples=samples,
        rays=0,
        leaks=np.full(count, lost),
    )


def _first_level(count: int, accuracy: float) -> int:
    """Level of `count` lattices to begin with."""
    wanted = max(LEAST_CAMERAS / (accuracy * max(count, 1)), 1.0)
    # Fibonacci numbers grow by the golden ratio.
    return int(np.ceil(np.log(wanted) / np.log(1 + GOLDEN)))


def facing_sides(points: np.ndarray, environment: Environment, patches: np.ndarray | slice = slice(None)) -> np.ndarray:
    """(p, n) bool: whether each point is on a radiating side of each patch, or of the chosen ones."""
    normals, centroids = environment.normals[patches], environment.centroids[patches]
    return (points @ normals.T > np.einsum("ni,ni->n", normals, centroids)) | environment.two_sided[patches]


class _Scene:
    """Patches and the camera that looks at them."""

    def __init__(self, environment: Environment, cameras: Sequence[Camera]):
        self.environment = environment
        self.cameras = cameras
        self.loops = Loops.of(environment)
        self.points = PatchPoints(environment)
        self.lost = max(camera.lost for camera in cameras)

    def refined_rows(self, rows: np.ndarray, level: int, accuracy: float, seed: int):
        """Factors (r, n), escaped shares (r,), errors (r,) and cameras (r,) of rows, from a level of lattices up."""
        levels = np.full(len(rows), level)
        factors, escaped, scatter, cameras = self._sample(rows, level, (seed, 0))
        # A patch that no pixel met may still have up to a pixel's share at one of the points.
        pixel = max(camera.deltas.max() for camera in self.cameras)
        unseen = pixel / cameras
        errors = np.maximum(scatter.max(axis=1, initial=0), unseen)
        for number in range(1, ROUNDS):
            pending = np.flatnonzero((errors > accuracy) & (levels < MOST_LEVEL))
            if not len(pending):
                break
            # The growth that the measured error asks for; Fibonacci numbers grow by the golden ratio with each level.
            growth = np.log(errors[pending] / accuracy) / FALL
            steps = np.ceil(growth / np.log(1 + GOLDEN)).clip(1, MOST_STEPS).astype(np.int64)
            levels[pending] = np.minimum(levels[pending] + steps, MOST_LEVEL)
            for finer in np.unique(levels[pending]):
                part = pending[levels[pending] == finer]
                again = (scatter[part] > UNCERTAIN * accuracy) | (unseen[part] > accuracy)[:, None]
                new, beyond, spread, cameras[part] = self._sample(rows[part], int(finer), (seed, number), again)
                whole = again.all(axis=1)
                escaped[part[whole]], unseen[part[whole]] = beyond[whole], pixel / cameras[part[whole]]
                factors[part], scatter[part] = (
                    np.where(again, new, factors[part]),
                    np.where(again, spread, scatter[part]),
                )
                errors[part] = np.maximum(scatter[part].max(axis=1, initial=0), unseen[part])
        # What leaves is the rest of a row whose factors were refined; that nothing leaves is known from the whole row.
        open_ = escaped > self.lost + NOTHING
        return factors, np.where(open_, np.maximum(1 - factors.sum(axis=1), 0), escaped), errors, cameras

    def _sample(self, rows: np.ndarray, level: int, seed: tuple[int, int], wanted: np.ndarray | None = None):
        """Mean factors (r, n), escaped shares (r,), standard errors (r, n) and cameras (r,) with lattices of a level.

        Of rows whose `wanted` (r, n) factors are not all, the others and what escapes come out wrong.
        """
        count, cells = len(self.environment), max(len(camera.deltas) for camera in self.cameras)
        shape = len(rows), count + 1
        total, squares = np.zeros(shape), np.zeros(shape)
        table = fibonacci_lattice(level)
        at_once = max(1, BLOCK_PIXELS // (cells + count))
        length = max(1, at_once // len(table))
        drawn = None if wanted is None else self._between(rows, wanted)
        for repetition, camera in enumerate(self.cameras):
            # Drawn for all patches, so that a row's points do not depend on which others are computed.
            shifts = np.random.default_rng((*seed, repetition)).random((count, 3))[rows]
            for start in range(0, len(rows), length):
                part = slice(start, start + length)
                which, points, weights = self.points(rows[part], fold(table + shifts[part, None, :2]))
                # Angles advance by the golden ratio from point to point.
                turns = 2 * np.pi * (shifts[part][which, 2] + np.arange(len(which)) * GOLDEN)
                shares = np.zeros_like(total[part])
                lists = None if drawn is None else drawn[part]
                for first in range(0, len(which), at_once):
                    chunk = slice(first, first + at_once)
                    views = which[chunk], points[chunk], weights[chunk], turns[chunk]
                    self._add(camera, shares, rows[part], *views, lists)
                total[part] += shares
                squares[part] += shares * shares
        mean = total / len(self.cameras)
        variance = np.maximum(squares / len(self.cameras) - mean * mean, 0) / (len(self.cameras) - 1)
        cameras = self.points.pieces_of(rows) * len(table) * len(self.cameras)
        mean[np.arange(len(rows)), rows] = 0
        factors, variance = mean[:, :-1], variance[:, :-1]
        if wanted is not None:
            factors, variance = factors * wanted, variance * wanted
        return factors, mean[:, -1], np.sqrt(_steadied(variance, factors)), cameras

    def _between(self, rows: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """(r, n) bool: polygons that may block a row's patch from one of its `wanted` (r, n) patches, and these.

        They meet the box around both.
        """
        loops, count = self.loops, len(self.environment)
        starts = loops.offsets[:-1]
        low, high = (extreme.reduceat(loops.corners, starts, axis=0) for extreme in (np.minimum, np.maximum))
        low, high = low - loops.edge_on, high + loops.edge_on
        drawn = np.ones(wanted.shape, dtype=bool)
        few = np.flatnonzero(wanted.sum(axis=1) <= MANY)
        length = max(1, BLOCK_ENTRIES // (MANY * count))
        for part in np.split(few, range(length, len(few), length)):
            place, other = np.nonzero(wanted[part])
            patch = rows[part][place]
            least, most = np.minimum(low[patch], low[other]), np.maximum(high[patch], high[other])
            meets = np.ones((len(place), count), dtype=bool)
            for axis in range(3):
                meets &= (low[:, axis] <= most[:, axis, None]) & (high[:, axis] >= least[:, axis, None])
            firsts = np.flatnonzero(np.diff(place, prepend=-1))
            drawn[part] = False
            drawn[part[place[firsts]]] = np.logical_or.reduceat(meets, firsts, axis=0)
        return drawn

    def _add(self, camera, shares, rows, which, points, weights, turns, lists):
        """Add to `shares` (r, n + 1) what cameras at some points see, last column what meets no radiating side.

        `lists` (r, n) bool tells which polygons are drawn for each row, if not all.
        """
        environment = self.environment
        normals = environment.normals[rows[which]]
        # Every other point of a two-sided patch looks from its back, at double weight either way in the mean.
        back = environment.two_sided[rows[which]] & (np.arange(len(which)) % 2 == 1)
        normals = np.where(back[:, None], -normals, normals)
        # All points of a patch's side have one tangent plane.
        planes = np.unique(2 * which + back, return_index=True)[1]
        candidates = in_front(points[planes], normals[planes], self.loops)
        drawn = None
        if lists is not None:
            candidates = candidates[lists[which[0] : which[-1] + 1, candidates].any(axis=0)]
            drawn = lists[which[:, None], candidates]
        items = camera.items(points, turned_frames(normals, turns), self.loops.select(candidates), drawn)
        # Items count within the candidates; one more column takes what meets nothing.
        width = len(candidates) + 1
        bins = items.astype(np.int64)
        bins[bins < 0] = len(candidates)
        bins += np.arange(len(points))[:, None] * width
        deltas = np.broadcast_to(camera.deltas, bins.shape).ravel()
        seen = np.bincount(bins.ravel(), deltas, len(points) * width).reshape(len(points), width)[:, :-1]
        seen *= facing_sides(points, environment, candidates)
        seen *= weights[:, None]
        # Points come patch by patch.
        starts = np.flatnonzero(np.diff(which, prepend=-1))
        sums = np.add.reduceat(seen, starts, axis=0)
        there = which[starts]
        shares[there[:, None], candidates] += sums
        shares[there, -1] += np.maximum(np.add.reduceat(weights, starts) - sums.sum(axis=1), 0)


def _steadied(variances: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Variances (r, n), known from few repetitions, drawn halfway to the mean variance per factor of their like.

    The largest of a thousand variances of three degrees of freedom each would else be five times the true one. Alike
    are factors of a row that differ by less than 4: those of neighbors vary much more than those of distant patches.
    """
    classes = (np.log2(np.maximum(factors, 4.0**-CLASSES)) / -2).astype(np.int64).clip(0, CLASSES - 1)
    classes += np.arange(len(factors))[:, None] * CLASSES
    sums, spread = (np.bincount(classes.ravel(), a.ravel(), len(factors) * CLASSES) for a in (factors, variances))
    common = spread / np.where(sums > 0, sums, 1)
    return (variances + common[classes] * factors) / 2


def in_front(points: np.ndarray, normals: np.ndarray, loops: Loops) -> np.ndarray:
    """Rows of the polygons that rise above the tangent plane of at least one of the points."""
    heights = normals @ loops.corners.T - np.einsum("pi,pi->p", points, normals)[:, None]
    return np.flatnonzero(np.maximum.reduceat(heights.max(axis=0), loops.offsets[:-1]) > loops.edge_on)
