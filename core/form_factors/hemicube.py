"""Hemicube: the surroundings of a point projected onto the five faces of half a cube, by a z-buffer (survey eq. 8-9).

The factor from the point to a patch is the sum of the delta factors of the pixels through which it is seen; occlusion
comes with the projection, and one hemicube yields a whole row. Choose it where no ray engine exists and for
environments of many patches, each a few pixels wide or more.

A patch's row is the mean over hemicubes at points of the patch, not at its center alone: `accuracy` drives their
number. A single hemicube errs by aliasing, as the pixels' centers decide: its error falls about as 1 / resolution, and
with random turns about the normal it is independent from point to point.

Limits: a patch smaller than a pixel is met by some of the hemicubes only. What it may contribute unseen is part of the
reported error, and reciprocity takes its factors mostly from its own hemicubes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..frames import tangents
from ..visibility.zbuffer import Loops, item_buffer
from .delta_factors import side_density, side_integrals, top_density, top_integrals
from .hemisphere import SampledRows
from .point_rows import PointRows
from .projection import facing_sides, point_resolution, projection_points, projection_rows

#: Pixels along a side of the top face. Many coarse hemicubes serve a patch better than a few fine ones: aliasing of
#: independent hemicubes averages out, and their points integrate over the patch.
RESOLUTION = 32

#: Pixels along a side of the top face of a single point's hemicube, at an accuracy of 3 % of its light.
POINT_RESOLUTION = 64

#: Independent repetitions of each row, for the error estimate.
REPETITIONS = 4

#: Directions of the four side faces, as the frame's axis and sign, and the axis that runs along the face.
SIDES = ((0, 1.0, 1), (0, -1.0, 1), (1, 1.0, 0), (1, -1.0, 0))


@dataclass(frozen=True)
class Hemicube:
    """Pixels of a hemicube of half-width 1 and height 1: the top face first, then the sides of `SIDES`.

    Attributes
    ----------
    columns : (r,) float64
        Centers of pixels across all faces; also the rows of the top face.
    heights : (s,) float64
        Centers of pixels up the side faces.
    deltas : (r * r + 4 * s * r,) float64
        Delta form factor of each pixel, by face, row and column.
    lost : float
        0: every direction above the horizon meets a pixel.
    """

    columns: np.ndarray
    heights: np.ndarray
    deltas: np.ndarray
    lost: float = 0.0

    @classmethod
    def of(cls, resolution: int = RESOLUTION, rule: str = "integral") -> Hemicube:
        """Hemicube of `resolution` pixels along a side of its top face, even or odd.

        Where it is odd, the lowest pixels of the sides are halves, cut at the horizon.

        Parameters
        ----------
        resolution : int
            2 or more.
        rule : str
            ``integral``: delta factors are exact, with sum 1. ``center``: the density at the pixel's center times its
            area, as published [1]_, whose sum exceeds 1 by about 0.5 over the square of the resolution.

        Raises
        ------
        SettingsError
            If the resolution is below 2 or no whole number, or the rule unknown.

        References
        ----------
        .. [1] Cohen, Greenberg, "The Hemi-Cube: A Radiosity Solution for Complex Environments", SIGGRAPH 1985.
        """
        if resolution != int(resolution) or resolution < 2:
            raise SettingsError(f"Resolution of a hemicube must be a whole number of 2 or more, not {resolution}")
        if rule not in ("integral", "center"):
            raise SettingsError(f"Unknown rule {rule!r} for delta factors: choose integral, center")
        resolution = int(resolution)
        lines = np.arange(-resolution, resolution + 1, 2) / resolution
        levels = np.concatenate(([0.0], lines[lines > 0]))
        columns, heights = (lines[:-1] + lines[1:]) / 2, (levels[:-1] + levels[1:]) / 2
        if rule == "integral":
            top, side = top_integrals(lines, lines), side_integrals(lines, levels)
        else:
            top = top_density(columns, columns[:, None]) * (2 / resolution) ** 2
            side = side_density(columns, heights[:, None]) * (np.diff(levels) * 2 / resolution)[:, None]
        return cls(columns, heights, np.concatenate([top.ravel(), *[side.ravel()] * 4]))

    def face_sums(self) -> tuple[float, float]:
        """Sums of the delta factors of the top face and of one side face."""
        top = len(self.columns) ** 2
        return float(self.deltas[:top].sum()), float(self.deltas[top:].sum() / 4)

    def directions(self) -> np.ndarray:
        """(c, 3) directions of the pixels' centers in the frame of tangents and normal, reaching to the cube's face."""
        r, s = len(self.columns), len(self.heights)
        faces = [np.stack([*np.meshgrid(self.columns, self.columns), np.ones((r, r))], axis=-1).reshape(-1, 3)]
        for axis, sign, along in SIDES:
            face = np.empty((s, r, 3))
            face[:, :, axis], face[:, :, along], face[:, :, 2] = sign, self.columns, self.heights[:, None]
            faces.append(face.reshape(-1, 3))
        return np.concatenate(faces)

    def items(
        self, points: np.ndarray, frames: np.ndarray, loops: Loops, drawn: np.ndarray | None = None
    ) -> np.ndarray:
        """(p, c) int32: polygon seen through each pixel from points (p, 3) with frames (p, 3, 3), -1 for none.

        `drawn` (p, n) bool tells which polygons each point draws, if not all.
        """
        count = len(points)
        top, _ = item_buffer(points, frames, loops, self.columns, self.columns, drawn)
        sides = np.stack([frames[:, [along, 2, axis]] for axis, _, along in SIDES], axis=1)
        sides[:, :, 2] *= np.array([sign for _, sign, _ in SIDES])[:, None]
        points, drawn = np.repeat(points, 4, axis=0), None if drawn is None else np.repeat(drawn, 4, axis=0)
        seen, _ = item_buffer(points, sides.reshape(-1, 3, 3), loops, self.columns, self.heights, drawn)
        return np.concatenate((top.reshape(count, -1), seen.reshape(count, -1)), axis=1)


def hemicube_at(
    environment: Environment, point: np.ndarray, normal: np.ndarray, cube: Hemicube, tangent: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """One hemicube: the patch behind each pixel, and the factors from the point to all patches.

    Parameters
    ----------
    environment : Environment
    point, normal : (3,) float
        Place, and unit normal.
    cube : Hemicube
        Its `deltas` and `directions` belong to the pixels.
    tangent : (3,) float, optional
        Unit vector, perpendicular to the normal, to which the cube's columns run parallel.

    Returns
    -------
    items : (c,) int32
        Patch seen through each pixel, from its front or back; -1 for none.
    factors : (n,) float64
        Sums of the delta factors of the pixels that see a radiating side of each patch.
    """
    point, normal = np.asarray(point, dtype=np.float64)[None], np.asarray(normal, dtype=np.float64)[None]
    one = tangents(normal)[0] if tangent is None else np.asarray(tangent, dtype=np.float64)[None]
    frame = np.stack((one, np.cross(normal, one), normal), axis=1)
    items = cube.items(point, frame, Loops.of(environment))[0]
    factors = np.bincount(items + 1, cube.deltas, len(environment) + 1)[1:]
    return items, factors * facing_sides(point, environment)[0]


def hemicube_rows(
    environment: Environment,
    visibility: str,
    accuracy: float,
    seed: int = 0,
    threads: int = 0,
    resolution: int = RESOLUTION,
) -> SampledRows:
    """Form factors of all patches by hemicubes at points of each.

    Parameters
    ----------
    environment : Environment
    visibility : str
        ``zbuffer``: the technique brings its own.
    accuracy : float
        Standard error wanted for the worst factor of each row, as an absolute number.
    seed : int
    threads : int
        Not used; one thread does it.
    resolution : int
        Pixels along a side of the top face; the independent repetitions take one more each.

    Returns
    -------
    SampledRows
        `rays` is 0. Errors may exceed `accuracy` where the largest number of points did not suffice; a warning is
        logged.

    Raises
    ------
    SettingsError
        If the resolution is below 2 or no whole number.
    """
    return projection_rows(environment, hemicubes(resolution), accuracy, seed)


def hemicubes(resolution: int = RESOLUTION) -> list[Hemicube]:
    """Cubes of the independent repetitions, each of one pixel more than the one before."""
    return [Hemicube.of(resolution + more) for more in range(REPETITIONS)]


def hemicube_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches, by one hemicube on each.

    Parameters
    ----------
    environment : Environment
    visibility : str
        ``zbuffer``: the technique brings its own.
    accuracy : float
        Relative error wanted of the light that a point gathers, from which the resolution follows: see
        `point_resolution`.
    seed : int
        Turns each hemicube about its normal.
    threads : int
        Not used.

    Returns
    -------
    PointRows
    """
    return projection_points(environment, Hemicube.of(point_resolution(POINT_RESOLUTION, accuracy)), seed)
