"""Choosing a view of a scene that has no camera.

Rays from points spread over the bounding box tell what kind of place it is, as a person looking around would:

- walls around and one side open (the usual Cornell box, a doll's house): seen through that side;
- walls and a ceiling, at least over part of it: seen from inside, from the spot and in the direction that show most;
- open to the sky: a model seen from above and outside, at three quarters.

Cost: about half a million rays, whatever the scene. Limits: up is +Z; "shows most" is depth, variety of directions and
outlines, not beauty; a maze is shown by one of its halls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..visibility.embree import RayEngine
from .viewer import View

#: Points that look around, and directions each looks in. More changed no choice on the test scenes.
_LOOKOUTS = 1024
_DIRECTIONS = 256

#: Share of a lookout's directions that meet a back face above which it is taken to be inside a solid.
_SOLID = 0.1

#: A lookout that sees less sky than this is indoors; a scene with this share of such lookouts has an inside to show.
_INDOOR_SKY = 0.15
_INDOORS = 0.1

#: The sky counts as this far away, in lengths of the scene's diagonal: it must not outshine everything else.
_SKY_DEPTH = 0.2

#: Lengths of the mean direction of all sky seen, 0 to 1: above this it lies on one side. A half space has 0.5.
_ONE_SIDED = 0.6

#: Share of sky below which an opening is a window, not a missing wall.
_WINDOW = 0.03

#: Tangents of half the horizontal angle: a wide lens indoors (24 mm), a normal one outdoors (50 mm).
_WIDE = 18.0 / 24.0
_NORMAL = 18.0 / 50.0

#: Share of neighboring rays on different planes in a bare room; makes edges beyond it count by their logarithm.
_EDGES_OF_AN_EMPTY_ROOM = 0.03

#: Rays across and down with which a view is judged.
_JUDGE = (48, 27)


@dataclass(frozen=True)
class _Surroundings:
    """What the lookouts saw."""

    points: np.ndarray  # (p, 3)
    directions: np.ndarray  # (d, 3)
    distances: np.ndarray  # (p, d), infinite at the sky
    backs: np.ndarray  # (p, d) bool, a back face was met


def framed_view(engine: RayEngine, vertices: np.ndarray, triangles: np.ndarray, aspect: float) -> View:
    """A view that shows the scene well.

    Parameters
    ----------
    engine : RayEngine
        Of the same triangles.
    vertices : (n, 3) float
        In meters; up is +Z.
    triangles : (m, 3) int
        At least one.
    aspect : float
        Width of the picture over its height.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    around = _look_around(engine, normals, low, high)
    free = _free(around)
    sky = ~np.isfinite(around.distances)
    towards_sky = (sky[free] @ around.directions).sum(axis=0) / max(sky[free].sum(), 1)
    if np.hypot(*towards_sky[:2]) > _ONE_SIDED and sky[free].mean() > _WINDOW:
        return fitted_view(corners.reshape(-1, 3), _nearest_axis(-towards_sky), aspect)
    indoors = free & (sky.mean(axis=1) < _INDOOR_SKY)
    if indoors.sum() > _INDOORS * free.sum():
        return _from_inside(engine, normals, around, indoors, float(np.linalg.norm(high - low)), aspect)
    return _from_above(engine, normals, corners, aspect)


def fitted_view(points: np.ndarray, forward: np.ndarray, aspect: float, half_width: float = _NORMAL) -> View:
    """The nearest perspective view along `forward` with all points (n, 3) in it, a small margin around them."""
    right, up, forward = _axes(forward)
    margin = 1.04
    half_height = half_width / aspect
    middle = points.mean(axis=0)
    x, y, z = ((points - middle) @ axis for axis in (right, up, forward))
    place, back = [], []
    for offset, tangent in ((x, half_width / margin), (y, half_height / margin)):
        # A point is inside both borders when its distance from the axis is at most tangent times its depth.
        first, second = (offset - tangent * z).max(), (-offset - tangent * z).max()
        place.append((first - second) / 2)
        back.append((first + second) / (2 * tangent))
    size = float(np.ptp(points, axis=0).max())
    depth = max(max(back), 1e-3 * size, np.finfo(np.float32).tiny)
    position = middle + place[0] * right + place[1] * up - depth * forward
    return View(position, right, up, forward, half_width, half_height)


def _axes(forward: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    forward = np.asarray(forward, dtype=np.float64) / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    length = np.linalg.norm(right)
    right = right / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return right, np.cross(right, forward), forward


def _spread(count: int, dimensions: int) -> np.ndarray:
    """(count, dimensions) points in the unit cube: Roberts' additive sequence (see `color.dither_to_bytes`)."""
    root = {1: 1.6180339887498949, 2: 1.3247179572447460, 3: 1.2207440846057596}[dimensions]
    return (0.5 + np.arange(count)[:, None] * root ** -np.arange(1.0, dimensions + 1)) % 1


def _look_around(engine: RayEngine, normals: np.ndarray, low: np.ndarray, high: np.ndarray) -> _Surroundings:
    # Walls lie on the border of the box: stay off it.
    points = low + (high - low) * (0.02 + 0.96 * _spread(_LOOKOUTS, 3))
    z = 1 - (2 * np.arange(_DIRECTIONS) + 1) / _DIRECTIONS
    azimuth = 2 * np.pi * _spread(_DIRECTIONS, 1)[:, 0]
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
    met, _, _, distances = engine.closest(np.repeat(points, _DIRECTIONS, axis=0), np.tile(directions, (_LOOKOUTS, 1)))
    met = met.reshape(_LOOKOUTS, _DIRECTIONS)
    backs = (np.einsum("pdi,di->pd", normals[met], directions) > 0) & (met >= 0)
    return _Surroundings(points, directions, distances.reshape(met.shape), backs)


def _free(around: _Surroundings) -> np.ndarray:
    """(p,) bool: lookouts in the air, not inside a solid."""
    free = around.backs.mean(axis=1) < _SOLID
    # Normals that point outwards all over (a room drawn from outside) say nothing.
    return free if free.mean() > 0.02 else np.ones(len(free), bool)


def _nearest_axis(direction: np.ndarray) -> np.ndarray:
    """The direction made level, and moved onto a coordinate axis if it lies within 20 degrees of one."""
    level = np.array([direction[0], direction[1], 0.0])
    level /= np.linalg.norm(level)
    axis = np.where(np.abs(level) == np.abs(level).max(), np.sign(level), 0.0)
    return axis if axis @ level > np.cos(np.radians(20)) else level


def _subject(corners: np.ndarray) -> np.ndarray:
    """Corners of what a picture from above is about: without a ground that reaches far beyond the rest."""
    low, high = corners.min(axis=1)[:, :2], corners.max(axis=1)[:, :2]
    extent = high.max(axis=0) - low.min(axis=0)
    rest = ~((high - low) > 0.5 * extent).all(axis=1)
    if not rest.any():
        return corners.reshape(-1, 3)
    smaller = np.ptp(corners[rest][..., :2].reshape(-1, 2), axis=0)
    return corners[rest].reshape(-1, 3) if (smaller < 0.8 * extent).any() else corners.reshape(-1, 3)


def _from_above(engine: RayEngine, normals: np.ndarray, corners: np.ndarray, aspect: float) -> View:
    points = _subject(corners)
    views = []
    for elevation in np.radians([35, 50]):
        # Off the axes by an uneven angle: walls in line with the view show nothing.
        for azimuth in np.radians(np.arange(8) * 45 + 30):
            across = -np.cos(elevation)
            forward = np.array([across * np.cos(azimuth), across * np.sin(azimuth), -np.sin(elevation)])
            views.append(fitted_view(points, forward, aspect))
    return max(views, key=lambda view: _worth(engine, normals, view, None))


def _from_inside(
    engine: RayEngine, normals: np.ndarray, around: _Surroundings, indoors: np.ndarray, size: float, aspect: float
) -> View:
    azimuth = np.radians(np.arange(16) * 22.5)
    forwards = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(16, -0.12)], axis=1)
    forwards /= np.linalg.norm(forwards, axis=1, keepdims=True)
    in_sight = around.directions @ forwards.T > 1 / np.sqrt(1 + _WIDE**2 * (1 + aspect**-2) / 2)
    # First sieve, by what the lookouts have seen already: the logarithm punishes what stands close before the eye.
    score = (_log_depth(around.distances, size) - 4 * around.backs) @ in_sight / np.maximum(in_sight.sum(axis=0), 1)
    score += _eye_level(around)[:, None]
    score[~indoors] = -np.inf
    # The best direction of each of the best spots.
    spots = np.argsort(-score.max(axis=1), kind="stable")[:48]
    views = []
    for spot in spots:
        for direction in np.argsort(-score[spot], kind="stable")[:2]:
            axes = _axes(forwards[direction])
            views.append(View(around.points[spot], *axes, _WIDE, _WIDE / aspect))
    return max(views, key=lambda view: _worth(engine, normals, view, size))


def _log_depth(distances: np.ndarray, size: float) -> np.ndarray:
    return np.log(np.where(np.isfinite(distances), np.clip(distances / size, 1e-3, 1), _SKY_DEPTH))


def _eye_level(around: _Surroundings) -> np.ndarray:
    """(p,) 0 at half height between floor and ceiling, below 0 near either."""
    down, up = (
        np.where(side, around.distances * np.abs(around.directions[:, 2]), np.inf).min(axis=1)
        for side in (around.directions[:, 2] < -0.7, around.directions[:, 2] > 0.7)
    )
    up = np.where(np.isfinite(up), up, down)
    with np.errstate(invalid="ignore"):  # infinite over infinite, where there is neither floor nor ceiling
        share = down / np.maximum(down + up, np.finfo(np.float64).tiny)
    share = np.nan_to_num(share, nan=1.0)
    return -4 * (share - 0.55) ** 2


def _worth(engine: RayEngine, normals: np.ndarray, view: View, size: float | None) -> float:
    """How much a view shows; compares views of one kind. `size` (m) adds depth to the judgement, for inside views."""
    x, y = np.meshgrid(*((np.arange(count) + 0.5) * (2 / count) - 1 for count in _JUDGE))
    origins, directions = view.rays(x.ravel(), y.ravel())
    met, _, _, distances = engine.closest(origins, directions)
    hit = met >= 0
    if not hit.any():
        return -np.inf
    facing = normals[met] * hit[:, None]
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    backs = (np.einsum("ij,ij->i", facing, directions) > 0).mean()
    variety = 1 - float(np.sum(facing[hit].mean(axis=0) ** 2))
    worth = (
        float(np.log(_EDGES_OF_AN_EMPTY_ROOM + _edges(origins, directions, distances, facing))) + variety - 8 * backs
    )
    if size is None:
        # A wall right behind the front edge hides what it encloses, and is nearer than the rest.
        worth += 4 * float(np.log(distances[hit]).mean())
    else:
        worth += 2 * float(_log_depth(distances, size).mean()) - 4 * float((~hit).mean())
    return float(worth)


def _edges(origins: np.ndarray, directions: np.ndarray, distances: np.ndarray, facing: np.ndarray) -> float:
    """Share of neighboring rays that meet different planes: outlines and creases, however finely faces are divided."""
    points = origins + np.where(np.isfinite(distances), distances, 0)[:, None] * directions
    points, facing = (each.reshape(_JUDGE[1], _JUDGE[0], 3) for each in (points, facing))
    step, normal = np.diff(points, axis=1), facing[:, :-1]
    off_plane = np.abs(np.einsum("rci,rci->rc", step, normal))
    return float((off_plane > 0.1 * np.linalg.norm(step, axis=2)).mean())
