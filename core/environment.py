"""Environment: the patches of a scene as plain arrays, one planar polygon each.

The entrance to the form factors and solvers for anyone who has polygons and no Blender. A patch emits and reflects
diffusely and evenly, on its front only unless two-sided, and blocks light from both sides.

Bad input is met by name: a polygon that is not finite, has fewer than three corners, is not planar or crosses itself is
refused; one without area stays in the list as a patch that exchanges nothing, with a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .errors import EmptySceneError, RadiosityError, SettingsError
from .triangulation import triangulate

#: How far corners may lie off their polygon's plane, in polygon sizes. Looser than any rounding, tight enough that the
#: area is right to 1e-9.
PLANARITY = 1e-5

#: The same, in largest coordinates: corners that passed through float32 far from the origin cannot do better.
COORDINATE_ROUNDING = 4 * float(np.finfo(np.float32).eps)

#: Area below which a polygon counts as a line or a point, in squares of its size.
THINNEST = 1e-14


class InvalidPolygonError(RadiosityError):
    """A polygon cannot be a patch; the text names it and says why."""


@dataclass(frozen=True)
class Environment:
    """Patches of a scene; made by `from_polygons`.

    Attributes
    ----------
    polygons : tuple of (k, 3) float64
        Corners as given.
    areas : (n,) float64
        Radiating areas: a two-sided patch counts both sides. 0 for patches that are left out.
    normals, centroids : (n, 3) float64
        Unit normals of the fronts (0 where left out), and centers of area.
    reflectance, emission : (n, 3) float64
        Diffuse reflectance from 0 to 1, and emitted exitance per radiating area.
    two_sided : (n,) bool
        Whether the back radiates as the front does, with the same radiosity.
    vertices : (c, 3) float64
    triangles : (m, 3) int32
        Rows of `vertices`.
    triangle_patches : (m,) int32
        Patch of each triangle, in ascending order.
    warnings : tuple of str
        What was clamped or left out.
    """

    polygons: tuple[np.ndarray, ...]
    areas: np.ndarray
    normals: np.ndarray
    centroids: np.ndarray
    reflectance: np.ndarray
    emission: np.ndarray
    two_sided: np.ndarray
    vertices: np.ndarray
    triangles: np.ndarray
    triangle_patches: np.ndarray
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.polygons)

    @classmethod
    def from_polygons(
        cls,
        polygons: Sequence[np.ndarray],
        reflectance: float | np.ndarray = 0.5,
        emission: float | np.ndarray | None = None,
        two_sided: bool | np.ndarray = False,
    ) -> Environment:
        """Environment of one patch per polygon.

        Parameters
        ----------
        polygons : sequence of (k, 3) float
            Planar loops of 3 corners or more, counter-clockwise seen from the front; convex or concave.
        reflectance : float, (n,) or (n, 3)
            Diffuse reflectance. Values outside 0 to 1 are clamped, with a warning.
        emission : float, (n,) or (n, 3), or None
            Emitted exitance, 0 or more; None emits nothing.
        two_sided : bool or (n,) bool
            Patches whose back emits, reflects and receives too, with one radiosity for both sides.

        Raises
        ------
        EmptySceneError
            If there are no polygons.
        InvalidPolygonError
            If a polygon has fewer than 3 corners, is not finite, not planar, or crosses itself.
        SettingsError
            If a reflectance or emission has the wrong shape, is not finite, or an emission is negative.
        """
        loops = [np.asarray(polygon, dtype=np.float64) for polygon in polygons]
        if not loops:
            raise EmptySceneError("There is nothing to light: give at least one polygon")
        _check_corners(loops)
        counts = np.array([len(loop) for loop in loops])
        offsets = np.concatenate(([0], np.cumsum(counts)))
        corners = np.concatenate(loops)
        areas, normals, centroids, flat = _measure(corners, offsets)
        triangles, patches, crossing = triangulate(corners, offsets, normals)
        if crossing:
            raise InvalidPolygonError(f"Polygon {crossing[0]} crosses itself: reorder its corners or split it")
        messages = []
        if flat.any():
            messages.append(
                f"{_name(np.flatnonzero(flat), 'Polygon')} without area: left out, all its form factors are 0"
            )
        sides = np.broadcast_to(np.asarray(two_sided, dtype=bool), (len(loops),)).copy()
        environment = cls(
            polygons=tuple(loops),
            areas=areas * np.where(sides, 2, 1),
            normals=normals,
            centroids=centroids,
            reflectance=clamp_reflectance(_per_patch("Reflectance", reflectance, len(loops)), messages),
            emission=_check_emission(_per_patch("Emission", 0.0 if emission is None else emission, len(loops))),
            two_sided=sides,
            vertices=corners,
            triangles=triangles,
            triangle_patches=patches,
            warnings=tuple(messages),
        )
        for array in (environment.areas, normals, centroids, environment.reflectance, environment.emission, sides):
            array.setflags(write=False)
        for message in messages:
            warnings.warn(message, stacklevel=2)
        return environment


def clamp_reflectance(reflectance: np.ndarray, messages: list[str]) -> np.ndarray:
    """Reflectance (n, ...) within 0 to 1, as a copy; what was clamped is added to `messages`.

    Raises
    ------
    SettingsError
        If a value is not a number.
    """
    bad = np.flatnonzero(np.isnan(reflectance).reshape(len(reflectance), -1).any(axis=1))
    if len(bad):
        raise SettingsError(f"Reflectance of {_name(bad, 'patch')} is not a number: give 0 to 1")
    clamped = np.clip(reflectance, 0, 1)
    changed = np.flatnonzero((clamped != reflectance).reshape(len(reflectance), -1).any(axis=1))
    if len(changed):
        messages.append(f"{_name(changed, 'Patch')} with a reflectance outside 0 to 1: clamped")
    return clamped


def _name(rows: np.ndarray, noun: str) -> str:
    """Numbers of a few patches or polygons, and how many more."""
    text = ", ".join(str(row) for row in rows[:5])
    more = f" and {len(rows) - 5} more" if len(rows) > 5 else ""
    plural = "es" if noun.endswith("ch") else "s"
    return f"{noun}{plural if len(rows) > 1 else ''} {text}{more}"


def _check_corners(loops: list[np.ndarray]) -> None:
    for row, loop in enumerate(loops):
        if loop.ndim != 2 or loop.shape[1] != 3 or len(loop) < 3:
            raise InvalidPolygonError(
                f"Polygon {row} needs 3 or more corners of x, y, z, not an array of shape {loop.shape}"
            )
    finite = np.isfinite(np.concatenate(loops)).all(axis=1)
    if not finite.all():
        ends = np.cumsum([len(loop) for loop in loops])
        row = int(np.searchsorted(ends, np.flatnonzero(~finite)[0], side="right"))
        raise InvalidPolygonError(f"Polygon {row} has a corner that is not finite: mend or remove it")


def _per_patch(label: str, values: float | np.ndarray, count: int) -> np.ndarray:
    """Values as (count, 3)."""
    values = np.asarray(values, dtype=np.float64)
    if values.ndim == 0:
        return np.full((count, 3), float(values))
    if values.shape == (count,):
        return np.repeat(values[:, None], 3, axis=1)
    if values.shape == (count, 3):
        return values.copy()
    raise SettingsError(
        f"{label} must be one number, one per polygon ({count},) or three per polygon ({count}, 3), "
        f"not of shape {values.shape}"
    )


def _check_emission(emission: np.ndarray) -> np.ndarray:
    bad = np.flatnonzero(~(np.isfinite(emission) & (emission >= 0)).all(axis=1))
    if len(bad):
        raise SettingsError(f"Emission of {_name(bad, 'patch')} must be finite and 0 or more")
    return emission


def _measure(corners, offsets):
    """Areas (n,), unit normals (n, 3), centroids (n, 3) of planar loops, and which have no area.

    All from the fan around each loop's first corner, whose signed triangles also sum up right for concave loops.
    """
    starts, counts = offsets[:-1], np.diff(offsets)
    origins = np.repeat(corners[starts], counts, axis=0)
    local = corners - origins
    # The last corner of a loop has no successor: it is paired with itself and adds nothing.
    following = np.arange(len(corners)) + 1
    following[offsets[1:] - 1] -= 1
    crosses = np.cross(local, local[following]) / 2
    vectors = np.add.reduceat(crosses, starts, axis=0)
    areas = np.linalg.norm(vectors, axis=1)
    sizes = np.sqrt(np.maximum.reduceat(np.einsum("ci,ci->c", local, local), starts))
    reach = np.maximum.reduceat(np.abs(corners).max(axis=1), starts)
    # Written so that a size whose square underflows counts as flat, too.
    flat = ~(areas > THINNEST * sizes * sizes)
    normals = np.where(flat[:, None], 0, vectors / np.where(flat, 1, areas)[:, None])
    heights = np.abs(np.einsum("ci,ci->c", local, np.repeat(normals, counts, axis=0)))
    bent = np.maximum.reduceat(heights, starts) > PLANARITY * sizes + COORDINATE_ROUNDING * reach
    if bent.any():
        row = int(np.flatnonzero(bent)[0])
        off = heights[offsets[row] : offsets[row + 1]].max()
        raise InvalidPolygonError(f"Polygon {row} is not planar: a corner lies {off:.3g} off its plane; triangulate it")
    signed = np.einsum("ci,ci->c", crosses, np.repeat(normals, counts, axis=0))
    moments = np.add.reduceat(signed[:, None] * (local + local[following]) / 3, starts, axis=0)
    means = np.add.reduceat(local, starts, axis=0) / counts[:, None]
    centers = np.where(flat[:, None], means, moments / np.where(flat, 1, areas)[:, None])
    return np.where(flat, 0, areas), normals, corners[starts] + centers, flat
