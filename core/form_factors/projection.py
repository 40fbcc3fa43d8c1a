"""Rows of form factors by projection: what a camera of pixels at points of a patch sees, averaged.

The part that hemicube and single plane share. A camera projects all polygons onto its pixels, each of which stands for
a known share of the power that leaves the point. A patch's row is the mean over points of a lattice rule, with the
camera turned about the normal by another angle at each, so that the errors of pixels that straddle a border average
out. Each row is computed several times with independent shifts of the points;
their scatter is the error estimate. Rows whose error is above the wanted one get as many more points as its fall asks
for, but only their uncertain factors are computed anew: see `uncertain_factors`.

Coherence: points of one patch and of its neighbors in the list are projected together. What lies behind all their
tangent planes is dropped once for all of them and all their faces; what remains is the list from which each view takes
what it has in its field. Measured on 1,056 patches of a room with two subdivided boxes, CPU time of rows without the
shared list over time with it: 1.06 for a wall, 1.46 for a box.

Cost: about a millisecond for each point and a thousand polygons. Memory: blocks of rows, bounded whatever n is.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from copy import copy
from typing import Protocol

import numpy as np

from ..environment import Environment
from ..frames import turned_frames
from ..visibility.zbuffer import Loops
from .hemisphere import SampledRows
from .patch_points import PatchPoints, fibonacci_lattice, fold
from .point_rows import PointRows, shifts_of_names
from .scatter import steadied_by_class
from .uncertain_factors import Between, rebalanced, uncertain

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

#: Pixels plus polygons of all cameras in one block, and entries of the rows refined together.
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
    lost = max(camera.lost for camera in cameras)
    matrix, escaped, errors, samples = ProjectedRows(environment, cameras).refined(np.arange(count), accuracy, seed)
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


class ProjectedRows:
    """Patches and the cameras that look at them from receivers: the patches themselves, or others of `of_receivers`."""

    def __init__(self, environment: Environment, cameras: Sequence[Camera]):
        self.environment = self.receivers = environment
        self.cameras = cameras
        self.loops = Loops.of(environment)
        self.points = PatchPoints(environment)
        self.between = Between(self.loops)
        self.names = self.own = np.arange(len(environment))

    def of_receivers(self, receivers: Environment, names: np.ndarray, own: np.ndarray) -> ProjectedRows:
        """The same patches as seen from other polygons, whose random shifts go by their `names` (r,) int.

        `own` (r,) int is the patch that each lies on, and does not see.
        """
        other = copy(self)
        other.receivers, other.points = receivers, PatchPoints(receivers)
        other.between = Between(self.loops, Loops.of(receivers))
        other.names, other.own = names, own
        return other

    def refined(self, rows: np.ndarray, accuracy: float, seed: int):
        """Factors (r, n), escaped shares, errors and numbers of cameras (r,) of some receivers.

        A row does not depend on which others are asked for.
        """
        matrix, escaped = np.zeros((len(rows), len(self.environment))), np.zeros(len(rows))
        errors, samples = np.zeros(len(rows)), np.zeros(len(rows), dtype=np.int64)
        radiating = np.flatnonzero(self.receivers.areas[rows] > 0)
        length = max(1, BLOCK_ENTRIES // len(self.environment))
        for part in np.split(radiating, range(length, len(radiating), length)):
            matrix[part], escaped[part], errors[part], samples[part] = self._refined(rows[part], accuracy, seed)
        return matrix, escaped, errors, samples

    def _refined(self, rows: np.ndarray, accuracy: float, seed: int):
        """`refined` of radiating receivers, in one block."""
        level = _first_level(int((self.environment.areas > 0).sum()) * len(self.cameras), accuracy)
        levels = np.full(len(rows), level)
        first, escaped, scatter, cameras = self._sample(rows, level, (seed, 0))
        factors, anew = first.copy(), np.zeros(first.shape, dtype=bool)
        # A patch that no pixel met may still have up to a pixel's share at one of the points.
        pixel = max(camera.deltas.max() for camera in self.cameras)
        lost = max(camera.lost for camera in self.cameras)
        unseen, doubts = pixel / cameras, scatter.copy()
        errors = np.maximum(doubts.max(axis=1, initial=0), unseen)
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
                wanted = uncertain(doubts[part], accuracy) | (unseen[part] > accuracy)[:, None]
                new, beyond, spread, cameras[part] = self._sample(rows[part], int(finer), (seed, number), wanted)
                whole = wanted.all(axis=1)
                first[part[whole]], escaped[part[whole]] = new[whole], beyond[whole]
                unseen[part[whole]] = pixel / cameras[part[whole]]
                anew[part] = (anew[part] | wanted) & ~whole[:, None]
                factors[part] = np.where(wanted, new, factors[part])
                scatter[part] = np.where(wanted, spread, scatter[part])
                balanced, _ = rebalanced(factors[part], first[part], escaped[part], anew[part], lost)
                doubts[part] = np.maximum(scatter[part], np.abs(balanced - factors[part]))
                errors[part] = np.maximum(doubts[part].max(axis=1, initial=0), unseen[part])
        factors, escaped = rebalanced(factors, first, escaped, anew, lost)
        return factors, escaped, errors, cameras

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
        drawn = None if wanted is None else self.between(rows, wanted)
        for repetition, camera in enumerate(self.cameras):
            # Drawn for all patches, so that a row's points do not depend on which others are computed.
            names = self.names[rows]
            shifts = np.random.default_rng((*seed, repetition)).random((self.names.max() + 1, 3))[names]
            for start in range(0, len(rows), length):
                part = slice(start, start + length)
                which, points, weights = self.points(rows[part], fold(table + shifts[part, None, :2]))
                # Numbered within each row, so that it does not depend on the others.
                places = np.arange(len(which)) - np.searchsorted(which, which)
                # Angles advance by the golden ratio from point to point.
                turns = 2 * np.pi * (shifts[part][which, 2] + places * GOLDEN)
                shares = np.zeros_like(total[part])
                lists = None if drawn is None else drawn[part]
                for first in range(0, len(which), at_once):
                    chunk = slice(first, first + at_once)
                    # Repetitions begin on either side in turn: their points may be odd in number.
                    back = self.receivers.two_sided[rows[part]][which[chunk]] & ((places[chunk] + repetition) % 2 == 1)
                    views = points[chunk], weights[chunk], turns[chunk], back
                    self._add(camera, shares, rows[part], which[chunk], *views, lists)
                total[part] += shares
                squares[part] += shares * shares
        mean = total / len(self.cameras)
        variance = np.maximum(squares / len(self.cameras) - mean * mean, 0) / (len(self.cameras) - 1)
        cameras = self.points.pieces_of(rows) * len(table) * len(self.cameras)
        mean[np.arange(len(rows)), self.own[rows]] = 0
        factors, variance = mean[:, :-1], variance[:, :-1]
        if wanted is not None:
            factors, variance = factors * wanted, variance * wanted
        return factors, mean[:, -1], np.sqrt(steadied_by_class(variance, factors)), cameras

    def _add(self, camera, shares, rows, which, points, weights, turns, back, lists):
        """Add to `shares` (r, n + 1) what cameras at some points see, last column what meets no radiating side.

        `lists` (r, n) bool tells which polygons are drawn for each row, if not all.
        """
        environment = self.environment
        normals = self.receivers.normals[rows[which]]
        # Every other point of a two-sided patch looks from its back, at double weight either way in the mean.
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


def in_front(points: np.ndarray, normals: np.ndarray, loops: Loops) -> np.ndarray:
    """Rows of the polygons that rise above the tangent plane of at least one of the points."""
    heights = normals @ loops.corners.T - np.einsum("pi,pi->p", points, normals)[:, None]
    return np.flatnonzero(np.maximum.reduceat(heights.max(axis=0), loops.offsets[:-1]) > loops.edge_on)


def point_resolution(pixels: int, accuracy: float) -> int:
    """Pixels along a side of a camera for single points, from those at an accuracy of 3 %.

    The pixels' number grows as the accuracy falls, as the rays of a hemisphere do, within a factor of 2 either way.
    """
    return int(np.clip(round(pixels * (0.03 / accuracy) ** 0.5), pixels // 2, 2 * pixels))


def projection_points(environment: Environment, camera: Camera, seed: int = 0) -> PointRows:
    """Factors from points to all patches, by one camera on each, turned about the normal by an angle of its own."""
    loops = Loops.of(environment)
    count = len(environment)

    def rows(points: np.ndarray, normals: np.ndarray, names: np.ndarray) -> np.ndarray:
        turns = 2 * np.pi * shifts_of_names(names, seed, 1)[:, 0]
        out = np.empty((len(points), count))
        at_once = max(1, BLOCK_PIXELS // (len(camera.deltas) + count))
        for start in range(0, len(points), at_once):
            part = slice(start, start + at_once)
            candidates = in_front(points[part], normals[part], loops)
            items = camera.items(points[part], turned_frames(normals[part], turns[part]), loops.select(candidates))
            # One bin for what is not seen, and from there to the patches' own numbers.
            names_of = np.append(candidates, count)
            bins = names_of[items] + np.arange(len(items))[:, None] * (count + 1)
            deltas = np.broadcast_to(camera.deltas, bins.shape).ravel()
            seen = np.bincount(bins.ravel(), deltas, len(items) * (count + 1)).reshape(len(items), count + 1)
            out[part] = seen[:, :-1] * facing_sides(points[part], environment)
        return out

    return rows
