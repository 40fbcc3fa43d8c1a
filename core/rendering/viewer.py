"""Pictures of a lit scene: the last step of the survey's figure 4, rendering.

A radiosity solution does not depend on the view, so a picture costs visibility only: one ray per sample to the first
triangle, whose corner colors are interpolated over it (Gouraud). Several rays per pixel and a filter wider than a pixel
keep edges smooth. No light is computed here.

Cost: about 1 s per megapixel and core at the default 9 rays per pixel; memory is bounded by bands of rows.
Limits: what is not triangles is not seen; linear interpolation shows the triangles of coarse meshes; surfaces are
opaque, and seen from both sides alike unless the view says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .coincident import SortedEngine
from .color import compress_highlights, dither_to_bytes, exposure_scale, linear_to_srgb

#: Rays in flight. About 150 bytes each, so some 80 MB.
_BAND_SAMPLES = 500_000

#: Back faces that one ray may pass, in a view that skips them; whatever lies behind more is not seen.
_MAX_SKIPPED = 64

#: Rays that judge whether a view stands outside a closed room.
_OUTSIDE_SAMPLES = 2_000

#: Rays that choose the exposure: enough for a percentile to be good to a percent.
_EXPOSURE_SAMPLES = 40_000


@dataclass(frozen=True)
class View:
    """A camera: where it stands, its axes, and the window it looks through.

    Parameters
    ----------
    position : (3,) float
        In meters.
    right, up, forward : (3,) float
        Unit vectors, perpendicular to each other.
    half_width, half_height : float
        Of the window: at depth 1 (so the tangent of half the angle) in perspective, in meters otherwise.
    center : (2,) float
        Middle of the window off the axis, in the same unit: the lens shift.
    perspective : bool
    near, far : float
        Depths in meters before and beyond which nothing is seen.
    skips_backs : bool
        Whether back faces are looked through: a closed room seen from outside opens like a doll's house.
    """

    position: np.ndarray
    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    half_width: float
    half_height: float
    center: tuple[float, float] = (0.0, 0.0)
    perspective: bool = True
    near: float = 0.0
    far: float = np.inf
    skips_backs: bool = False

    def rays(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions (..., 3) of rays through points of the window, -1 to 1 from left to right, bottom to
        top. One length of a direction is one meter of depth; origins lie in the plane of the camera."""
        across = (self.center[0] + np.asarray(x) * self.half_width)[..., None] * self.right
        upward = (self.center[1] + np.asarray(y) * self.half_height)[..., None] * self.up
        if self.perspective:
            directions = across + upward + self.forward
            return np.broadcast_to(np.asarray(self.position, dtype=np.float64), directions.shape), directions
        origins = self.position + across + upward
        return origins, np.broadcast_to(np.asarray(self.forward, dtype=np.float64), origins.shape)


@dataclass(frozen=True)
class ShownScene:
    """What a picture shows.

    Parameters
    ----------
    vertices : (n, 3) float
        In meters, finite where a triangle uses them.
    triangles : (m, 3) int
    colors : (m, 3, 3) float32
        Scene-linear color at each corner of each triangle.
    is_light : (m,) bool
        Whether colors are light, to be exposed. The others are shown as they are, 0 to 1: surfaces that hold no bake.
    background : (3,) or (rows, columns, 3) float
        Color where a ray meets nothing, shown as it is unless `background_is_light`; by direction on the grid of
        `scene.Sky`, interpolated.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray
    is_light: np.ndarray
    background: np.ndarray = field(default_factory=lambda: np.full(3, 0.05))
    background_is_light: bool = False


class Viewer:
    """Renders pictures of one scene from any number of views; the ray structure is built once."""

    def __init__(self, scene: ShownScene, threads: int = 0):
        self.scene = scene
        self.engine = SortedEngine(scene.vertices, scene.triangles, threads)
        used = np.asarray(scene.vertices, dtype=np.float64)[np.unique(scene.triangles)]
        self._low, self._high = (used.min(axis=0), used.max(axis=0)) if len(used) else (np.zeros(3), np.zeros(3))

    def hits(self, view: View, x: np.ndarray, y: np.ndarray):
        """Triangle (-1 for none), u, v and depth in meters seen at each window point (r,), as `RayEngine.closest`."""
        origins, directions = view.rays(x, y)
        # Rays start at the scene's bounding sphere: a camera a thousand sizes away costs no precision.
        radius = float(np.linalg.norm(self._high - self._low)) / 2
        middle = (self._low + self._high) / 2
        start = max(view.near, float((middle - view.position) @ view.forward) - radius * 1.01, 0.0)
        triangles, u, v, depths = self.engine.closest(origins + start * directions, directions)
        depths += start
        for _ in range(_MAX_SKIPPED if view.skips_backs else 0):
            back = np.nonzero(self._is_back(triangles, directions))[0]
            if not len(back):
                break
            onward = depths[back] + self.engine.offset
            triangles[back], u[back], v[back], more = self.engine.closest(
                origins[back] + onward[:, None] * directions[back], directions[back]
            )
            depths[back] = onward + more
        triangles[depths > view.far] = -1
        return triangles, u, v, depths

    @cached_property
    def _normals(self) -> np.ndarray:
        corners = np.asarray(self.scene.vertices, dtype=np.float64)[self.scene.triangles]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    def _is_back(self, triangles: np.ndarray, directions: np.ndarray) -> np.ndarray:
        return (triangles >= 0) & (np.einsum("ri,ri->r", self._normals[triangles], directions) > 0)

    def opened(self, view: View) -> View:
        """The view, made to skip back faces if it looks at a closed room from outside.

        It does when more than half of what it meets are back faces, and as much as before is met behind them: a room
        drawn with its normals outwards, seen from inside, would vanish instead.
        """
        x, y = _window_grid(view, _OUTSIDE_SAMPLES)
        met = self.hits(view, x, y)[0]
        backs = self._is_back(met, view.rays(x, y)[1])
        through = replace(view, skips_backs=True)
        if backs.sum() <= 0.5 * (met >= 0).sum():
            return view
        behind = self.hits(through, x[backs], y[backs])[0]
        return through if (behind >= 0).mean() > 0.9 else view

    def colors(self, view: View, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Color (r, 3) seen at each window point, and whether it is light (r,)."""
        triangles, u, v, _ = self.hits(view, x, y)
        colors = np.empty((len(triangles), 3), np.float32)
        is_light = np.full(len(triangles), self.scene.background_is_light)
        met = triangles >= 0
        background = np.asarray(self.scene.background, dtype=np.float64)
        if background.ndim == 1 or background.shape[:2] == (1, 1):
            colors[~met] = background.reshape(3)
        else:
            colors[~met] = _sky_colors(background, view.rays(x[~met], y[~met])[1])
        seen = triangles[met]
        corners = self.scene.colors[seen]
        u, v = u[met, None], v[met, None]
        colors[met] = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        is_light[met] = self.scene.is_light[seen]
        return colors, is_light

    def exposure(self, view: View) -> float:
        """Factor that exposes the lit surfaces in this view well; the background does not count."""
        x, y = _window_grid(view, _EXPOSURE_SAMPLES)
        triangles, u, v, _ = self.hits(view, x, y)
        met = triangles >= 0
        met[met] = self.scene.is_light[triangles[met]]
        corners, u, v = self.scene.colors[triangles[met]], u[met, None], v[met, None]
        return exposure_scale((1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2])

    def picture(
        self, view: View, width: int, height: int, exposure: float | None = None, supersampling: int = 3
    ) -> np.ndarray:
        """A picture (height, width, 3) uint8, sRGB, first row on top.

        Parameters
        ----------
        view : View
        width, height : int
            In pixels; the window is stretched over them.
        exposure : float or None
            Factor on light; None chooses by `exposure`.
        supersampling : int
            Rays along each side of a pixel.

        Raises
        ------
        ValueError
            If a number of pixels or rays is below 1.
        """
        if min(width, height, supersampling) < 1:
            raise ValueError(f"No picture of {width} by {height} pixels at {supersampling} rays a side")
        if exposure is None:
            exposure = self.exposure(view)
        kernel, margin = _filter_weights(supersampling)
        columns = np.arange(-margin, width * supersampling + margin)
        band = max(1, _BAND_SAMPLES // (len(columns) * supersampling))
        pixels = np.empty((height, width, 3), np.uint8)
        for top in range(0, height, band):
            count = min(band, height - top)
            rows = np.arange(top * supersampling - margin, (top + count) * supersampling + margin)
            x, y = _window_points(columns, rows, width * supersampling, height * supersampling)
            colors, is_light = self.colors(view, x, y)
            # Highlights are compressed before filtering: one lamp sample must not outshine its pixel's others, or the
            # lamp's edge would be a staircase.
            colors[is_light] = compress_highlights(colors[is_light] * exposure)
            shown = np.clip(colors, 0, 1).reshape(len(rows), len(columns), 3)
            shown = _decimate(_decimate(shown, kernel, supersampling, count, 0), kernel, supersampling, width, 1)
            pixels[top : top + count] = dither_to_bytes(linear_to_srgb(shown), top)
        return pixels


def _sky_colors(background: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n, 3) colors of a sky (rows, columns, 3) in directions (n, 3) of any length."""
    rows, columns = background.shape[:2]
    height = directions[:, 2] / np.linalg.norm(directions, axis=1)
    # Centers of cells lie half a cell off the grid's start; azimuth goes around, height ends at the poles.
    row = np.clip((height + 1) / 2 * rows - 0.5, 0, rows - 1)
    column = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi) * columns - 0.5
    low, left = np.floor(row).astype(int), np.floor(column).astype(int)
    up, across = (row - low)[:, None], (column - left)[:, None]
    high, right = np.minimum(low + 1, rows - 1), (left + 1) % columns
    left %= columns
    lower = (1 - across) * background[low, left] + across * background[low, right]
    return (1 - up) * lower + up * ((1 - across) * background[high, left] + across * background[high, right])


def _window_points(columns: np.ndarray, rows: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Window coordinates of the centers of a grid's cells, row by row, the first row on top."""
    x = (columns + 0.5) * (2 / width) - 1
    y = 1 - (rows + 0.5) * (2 / height)
    return np.tile(x, len(rows)), np.repeat(y, len(columns))


def _window_grid(view: View, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """About this many points, evenly over the window."""
    rows = max(2, int(np.sqrt(samples * view.half_height / view.half_width)))
    columns = max(2, samples // rows)
    return _window_points(np.arange(columns), np.arange(rows), columns, rows)


def _filter_weights(supersampling: int) -> tuple[np.ndarray, int]:
    """Weights of the samples along one axis of a pixel, and how many lie beyond each of its borders.

    A raised cosine two pixels wide: wide enough to hide stairs, narrow enough to keep textures sharp.
    """
    # An odd number of samples has one on the pixel's middle, an even number straddles it.
    reach = supersampling - (1.0 if supersampling % 2 else 0.5)
    offsets = np.arange(-reach, supersampling)
    weights = 0.5 * (1 + np.cos(np.pi * offsets / supersampling))
    return (weights / weights.sum()).astype(np.float32), (len(offsets) - supersampling) // 2


def _decimate(samples: np.ndarray, kernel: np.ndarray, step: int, count: int, axis: int) -> np.ndarray:
    """Filter along an axis and keep one value per pixel; `count` pixels."""
    samples = np.moveaxis(samples, axis, 0)
    total = sum(weight * samples[tap : tap + step * (count - 1) + 1 : step] for tap, weight in enumerate(kernel))
    return np.moveaxis(total, 0, axis)
