"""Cropped hemicube: the faces of a hemicube cut down to windows around one polygon, for single pairs and points.

A whole hemicube spends its pixels on all directions, and a polygon that is far or narrow falls between them. Here each
face that the polygon is seen on is cropped to the rectangle around its image, and all pixels go there. So the relative
error does not depend on how small the polygon appears; blockers are projected into the same windows. The pair's factor
is the mean over points of the receiver, each with its own random turn, until the scatter of independent repetitions is
small against the factor.

Cost: some hundred pixels a point and face, about 0.1 milliseconds. Limits: a blocker much smaller than the polygon's
image is met by chance only, as with any sampling. The same
holds for a polygon of extreme aspect itself, a million times as long as wide, which fills little of its window; the
error reported tells.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from ..frames import turned_frames
from ..visibility.zbuffer import Loops, item_buffer
from .delta_factors import top_density
from .hemicube import SIDES
from .patch_points import PatchPoints, fibonacci_lattice, fold
from .projection import GOLDEN, facing_sides, in_front

#: Pixels along a side of each window: coarse, since many points average its aliasing out.
RESOLUTION = 24

#: Independent repetitions, for the error estimate.
REPETITIONS = 8

#: Levels of the Fibonacci lattices of successive rounds: 21 to 1597 points in each repetition.
LEVELS = (6, 9, 12, 15)

#: Standard errors that fit into the accuracy asked for.
SAFETY = 2.0

#: Points projected at a time.
BLOCK_POINTS = 512

#: Lowest image positions on the top face and on the sides, which end at the horizon; the highest are 1.
FLOOR = np.array([[-1.0, -1.0]] + [[-1.0, 0.0]] * 4)

logger = logging.getLogger(__name__)


def cropped_pair(
    environment: Environment, receiver: int, source: int, accuracy: float, seed: int = 0
) -> tuple[float, float]:
    """Form factor from one patch to another among all others as blockers.

    Parameters
    ----------
    environment : Environment
    receiver, source : int
        Patches with an area; points are spread over the first, so it should be the smaller one.
    accuracy : float
        Error wanted, as a part of the factor: two standard errors.
    seed : int

    Returns
    -------
    factor, error : float
        The error is a standard error. It may exceed what was asked for where the largest number of points did not
        suffice; a warning is logged.
    """
    pieces = PatchPoints(environment)
    patch = np.array([receiver])

    def points(level: int, generator: np.random.Generator):
        square = fold(fibonacci_lattice(level) + generator.random(2))
        _, places, weights = pieces(patch, square[None])
        normals = np.broadcast_to(environment.normals[receiver], places.shape)
        # Every other point of a two-sided patch looks from its back.
        back = environment.two_sided[receiver] & (np.arange(len(places)) % 2 == 1)
        return places, np.where(back[:, None], -normals, normals), weights

    return _refine(environment, points, source, accuracy, seed)


def cropped_point(
    environment: Environment, point: np.ndarray, normal: np.ndarray, source: int, accuracy: float, seed: int = 0
) -> tuple[float, float]:
    """Configuration factor of a differential area to a patch; parameters and results as `cropped_pair`'s.

    `point` and unit `normal` are (3,); one hemicube for each of many turns takes the place of points.
    """

    def points(level: int, generator: np.random.Generator):
        count = len(fibonacci_lattice(level))
        return np.tile(point, (count, 1)), np.tile(normal, (count, 1)), np.full(count, 1 / count)

    return _refine(environment, points, source, accuracy, seed)


def _refine(environment, points, source, accuracy, seed):
    """Mean and standard error with more and more points."""
    loops = Loops.of(environment)
    for number, level in enumerate(LEVELS):
        values = np.zeros(REPETITIONS)
        for repetition in range(REPETITIONS):
            generator = np.random.default_rng((seed, number, repetition))
            places, normals, weights = points(level, generator)
            turns = 2 * np.pi * ((generator.random() + np.arange(len(places)) * GOLDEN) % 1)
            frames = turned_frames(normals, turns)
            for start in range(0, len(places), BLOCK_POINTS):
                part = slice(start, start + BLOCK_POINTS)
                factors = _factors(environment, loops, places[part], frames[part], source, generator)
                values[repetition] += weights[part] @ factors
        factor, error = values.mean(), values.std(ddof=1) / np.sqrt(REPETITIONS)
        # Nothing seen from some points is no proof that nothing is seen from any: a second round looks closer.
        if SAFETY * error <= accuracy * factor and (factor > 0 or number > 0):
            break
    else:
        logger.warning("Form factor is accurate to %.2g only, not %.2g: limit of points", error, accuracy * factor)
    return float(min(factor, 1.0)), float(error)


def _factors(environment, loops, points, frames, source, generator):
    """Factors (p,) from points with frames (p, 3, 3) to the visible part of a patch."""
    views = np.stack([frames, *[_side(frames, *side) for side in SIDES]], axis=1)
    low, high = _windows(views, environment.polygons[source] - points[:, None], environment.normals[source])
    facing = facing_sides(points, environment, np.array([source]))
    place, face = np.nonzero((low < high).all(axis=2) & facing)
    factors = np.zeros(len(points))
    if not len(place):
        return factors
    low, high = _loosened(low[place, face], high[place, face], face, generator)
    middle, half = (low + high) / 2, (high - low) / 2
    # The window becomes the square from -1 to 1.
    windows = views[place, face]
    windows[:, :2] = (windows[:, :2] - middle[:, :, None] * windows[:, 2:]) / half[:, :, None]
    candidates = in_front(points, frames[:, 2], loops)
    centers = (np.arange(RESOLUTION) * 2 + 1) / RESOLUTION - 1
    items, _ = item_buffer(points[place], windows, loops.select(candidates), centers, centers)
    shares = (_densities(middle, half, face, centers) * (candidates[items] == source) * (items >= 0)).sum(axis=(1, 2))
    return np.bincount(place, shares * (4 * half.prod(axis=1) / RESOLUTION**2), len(points))


def _side(frames, axis, sign, along):
    """Views (p, 3, 3) at a side face, from frames."""
    side = frames[:, [along, 2, axis]]
    side[:, 2] *= sign
    return side


def _windows(views: np.ndarray, rays: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest image positions (p, 5, 2) of polygons (p, k, 3) on the faces, within their borders."""
    local = np.einsum("pfij,pkj->pfki", views, rays)
    ahead = np.roll(local, -1, axis=2)
    low, high = np.full((*local.shape[:2], 2), np.inf), np.full((*local.shape[:2], 2), -np.inf)
    # Across the face, an edge that passes beside the viewpoint runs to infinity. Up the face that would be too loose:
    # a sheet just above the horizon runs there, too, yet never rises.
    depth, following = local[..., 2], ahead[..., 2]
    front, passing = depth > 0, (depth > 0) != (following > 0)
    image = local[..., 0] / np.where(front, depth, 1)
    beside = local[..., 0] + depth / np.where(passing, depth - following, 1) * (ahead - local)[..., 0]
    low[..., 0] = np.where(front, image, np.inf).min(axis=2)
    high[..., 0] = np.where(front, image, -np.inf).max(axis=2)
    low[..., 0][(passing & (beside <= 0)).any(axis=2)] = -np.inf
    high[..., 0][(passing & (beside >= 0)).any(axis=2)] = np.inf
    axis, across, floor = 1, 0, FLOOR[:, 0, None]
    # What lies between the face's two borders across this axis is bounded by corners between them and by the
    # points where edges cross them, unless the polygon meets the line in which these borders' planes meet.
    inside = (local[..., across] >= floor * local[..., 2]) & (local[..., across] <= local[..., 2])
    ends = [(local, inside)]
    for border in (floor, 1.0):
        here, there = (side[..., across] - border * side[..., 2] for side in (local, ahead))
        crossing = (here < 0) != (there < 0)
        share = here / np.where(crossing, here - there, 1)
        ends.append((local + share[..., None] * (ahead - local), crossing))
    for place, valid in ends:
        valid = valid & (place[..., 2] > 0)
        position = place[..., axis] / np.where(valid, place[..., 2], 1)
        low[..., axis] = np.minimum(low[..., axis], np.where(valid, position, np.inf).min(axis=2))
        high[..., axis] = np.maximum(high[..., axis], np.where(valid, position, -np.inf).max(axis=2))
    # There it runs to infinity in the image, on the side where it meets the line.
    here, there = local[..., across], ahead[..., across]
    crossing = (here < 0) != (there < 0)
    share = here / np.where(crossing, here - there, 1)
    beyond = local[..., 2] + share * (ahead - local)[..., 2] > 0
    met = (crossing & beyond).sum(axis=2) % 2 == 1
    side = (views[:, :, axis] @ normal) * (rays[:, 0] @ normal)[:, None]
    low[..., axis] = np.where(met & (side < 0), -np.inf, low[..., axis])
    high[..., axis] = np.where(met & (side > 0), np.inf, high[..., axis])
    return np.maximum(low, FLOOR), np.minimum(high, 1)


def _loosened(low, high, face, generator):
    """Windows wider by up to a pixel at each end, within their faces.

    Samples at fixed places between the polygon's own extremes would miss or meet it too often, always the same way.
    """
    pixel = (high - low) / RESOLUTION
    wider = low - pixel * generator.random(low.shape), high + pixel * generator.random(low.shape)
    return np.maximum(wider[0], FLOOR[face]), np.minimum(wider[1], 1)


def _densities(middle, half, face, centers):
    """Mean densities (v, h, w) of the power through each pixel, from two by two Gauss points."""
    total = 0
    nodes = np.array([-1, 1]) / np.sqrt(3) / len(centers)
    for across in nodes:
        x = middle[:, 0, None] + half[:, 0, None] * (centers + across)
        for up in nodes:
            y = middle[:, 1, None] + half[:, 1, None] * (centers + up)
            density = top_density(x[:, None, :], y[:, :, None])
            total = total + density * np.where(face > 0, y.T, 1).T[:, :, None]
    return total / 4
