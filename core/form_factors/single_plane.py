"""Single plane: one plane above the point, parallel to its tangent plane, in place of five faces (survey fig. 9-11).

The plane is a square at height 1, cut into proxels that each stand for the same share of the power: rows of equal
share, and each row into cells of equal share. Directions between its rim and the horizon are lost; its extent follows
from the share that may be. One projection instead of five makes it the simplest projection there is; choose it where
little light comes from near the horizon, and the hemicube where patches touch at right angles.

Limits: light from near the horizon is missed up to `lost`, which is reported in the errors, and proxels near the rim
are large in angle, so that low and distant patches alias more than in a hemicube of as many pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.zbuffer import Loops, item_buffer
from .delta_factors import top_corner
from .hemisphere import SampledRows
from .point_rows import PointRows
from .projection import point_resolution, projection_points, projection_rows

#: Proxels along a side of the plane: about as many in all as a default hemicube has pixels.
RESOLUTION = 48

#: Proxels along a side of a single point's plane, at an accuracy of 3 % of its light.
POINT_RESOLUTION = 96

#: Independent repetitions of each row, for the error estimate.
REPETITIONS = 4

#: Part of the accuracy asked for that may be lost beside the plane.
LOST_PART = 0.1

#: Halvings of an interval of angles, down to the resolution of float64.
HALVINGS = 54


def captured_share(half_width: np.ndarray | float) -> np.ndarray | float:
    """Share of the power through a square of some half-width at height 1: ``4 w / (pi r) atan(w / r), r^2 = 1 + w^2``.

    References
    ----------
    .. [1] Sillion, Puech, "A General Two-Pass Method Integrating Specular and Diffuse Reflection", SIGGRAPH 1989.
    """
    return 4 * top_corner(half_width, half_width)


def half_width(lost: float) -> float:
    """Half-width of the square beside which a share `lost` of the power passes.

    Raises
    ------
    SettingsError
        If `lost` does not lie above 0 and below 1.
    """
    if not 0 < lost < 1:
        raise SettingsError(f"Share lost beside a single plane must lie between 0 and 1, not {lost}")
    # Near 1 the share captured changes by less than its rounding: the share lost beside a wide plane is about 1 / w^2.
    if lost < 1e-12:
        raise SettingsError(f"Share lost beside a single plane must be 1e-12 or more, not {lost}")
    return float(_invert(captured_share, np.array([1 - lost]), 0.0, np.pi / 2)[0])


def _invert(share: Callable, wanted: np.ndarray, low: float, high: float) -> np.ndarray:
    """Places where an ascending function takes the wanted values, by halving angles between `low` and `high`."""
    lows, highs = np.full(wanted.shape, low), np.full(wanted.shape, high)
    for _ in range(HALVINGS):
        middle = (lows + highs) / 2
        below = share(np.tan(middle)) < wanted
        lows, highs = np.where(below, middle, lows), np.where(below, highs, middle)
    return np.tan((lows + highs) / 2)


@dataclass(frozen=True)
class SinglePlane:
    """Proxels of equal share.

    Attributes
    ----------
    half_width : float
        Half of the square's side, at height 1.
    columns : (r, r) float64
        Horizontal positions of the samples in each row: they halve the share of their cells.
    rows : (r,) float64
        Vertical positions.
    deltas : (r * r,) float64
        Share of each proxel.
    lost : float
        Share that passes beside the plane.
    """

    half_width: float
    columns: np.ndarray
    rows: np.ndarray
    deltas: np.ndarray
    lost: float

    @classmethod
    def of(cls, lost: float, resolution: int = RESOLUTION) -> SinglePlane:
        """Plane beside which a share `lost` passes, of `resolution` rows of as many proxels.

        Raises
        ------
        SettingsError
            If the resolution is below 2 or no whole number, or `lost` out of range.
        """
        if resolution != int(resolution) or resolution < 2:
            raise SettingsError(f"Resolution of a single plane must be a whole number of 2 or more, not {resolution}")
        resolution = int(resolution)
        width = half_width(lost)
        rim = np.arctan(width)
        total = captured_share(width)
        steps = np.arange(2 * resolution + 1) / (2 * resolution) - 0.5

        def strip(y: np.ndarray) -> np.ndarray:
            return 2 * top_corner(width, y)

        # Lines and middles alternate.
        levels = _invert(strip, steps * total, -rim, rim)
        lower, upper = levels[:-1:2, None], levels[2::2, None]

        def cell(x: np.ndarray) -> np.ndarray:
            return top_corner(x, upper) - top_corner(x, lower)

        wanted = 2 * cell(np.full((resolution, 1), width)) * steps[1::2]
        return cls(
            half_width=width,
            columns=_invert(cell, wanted, -rim, rim),
            rows=levels[1::2],
            deltas=np.full(resolution * resolution, total / resolution**2),
            lost=float(1 - total),
        )

    def items(
        self, points: np.ndarray, frames: np.ndarray, loops: Loops, drawn: np.ndarray | None = None
    ) -> np.ndarray:
        """(p, c) int32: polygon seen through each proxel from points (p, 3) with frames (p, 3, 3), -1 for none.

        `drawn` (p, n) bool tells which polygons each point draws, if not all.
        """
        return item_buffer(points, frames, loops, self.columns, self.rows, drawn)[0].reshape(len(points), -1)


def single_plane_rows(
    environment: Environment,
    visibility: str,
    accuracy: float,
    seed: int = 0,
    threads: int = 0,
    resolution: int = RESOLUTION,
    lost: float | None = None,
) -> SampledRows:
    """Form factors of all patches by single planes at points of each.

    Parameters
    ----------
    environment : Environment
    visibility : str
        ``zbuffer``: the technique brings its own.
    accuracy : float
        Standard error wanted for the worst factor of each row, beside what is lost.
    seed : int
    threads : int
        Not used; one thread does it.
    resolution : int
        Proxels along a side of the plane; the independent repetitions take one more each.
    lost : float, optional
        Share of the power that may pass beside the plane, from which its extent follows; a tenth of the accuracy when
        left out.

    Returns
    -------
    SampledRows
        `errors` includes the lost share, `escaped` too.

    Raises
    ------
    SettingsError
        If the resolution or the lost share is out of range.
    """
    return projection_rows(environment, single_planes(accuracy, resolution, lost), accuracy, seed)


def single_planes(accuracy: float, resolution: int = RESOLUTION, lost: float | None = None) -> list[SinglePlane]:
    """Planes of the independent repetitions, each of one proxel more along a side than the one before."""
    lost = LOST_PART * accuracy if lost is None else lost
    return [SinglePlane.of(lost, resolution + more) for more in range(REPETITIONS)]


def single_plane_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches, by one plane above each.

    Parameters
    ----------
    environment : Environment
    visibility : str
        ``zbuffer``: the technique brings its own.
    accuracy : float
        Relative error wanted of the light that a point gathers; `LOST_PART` of it may be lost beside the plane, and the
        resolution follows: see `point_resolution`.
    seed : int
        Turns each plane about its normal.
    threads : int
        Not used.

    Returns
    -------
    PointRows
    """
    plane = SinglePlane.of(LOST_PART * accuracy, point_resolution(POINT_RESOLUTION, accuracy))
    return projection_points(environment, plane, seed)
