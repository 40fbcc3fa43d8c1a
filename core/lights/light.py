"""What every light can do, and nothing else.

Direct light is split in two factors, as in Baum et al. 1989: an unoccluded part in closed form, and a visibility that
is sampled by rays. A light therefore answers two questions: how much would arrive without occluders, and along which
segments must rays be cast to find the visible share.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Light(Protocol):
    """A source of direct light. Lengths are in the units of the points it is asked about; see `in_frame`."""

    @property
    def power(self) -> np.ndarray:
        """(3,) emitted flux in W; for a sun, the flux through one square meter across its rays."""
        ...

    @property
    def color(self) -> np.ndarray:
        """(3,) factor by which `geometry` is multiplied to give irradiance in W/m2."""
        ...

    @property
    def is_sharp(self) -> bool:
        """Whether one ray tells all about visibility: the source is a point, or its light parallel."""
        ...

    def in_frame(self, center: np.ndarray, size: float) -> Light:
        """The same light seen from a frame whose origin is `center` and whose unit of length is `size`; irradiance at
        corresponding points is equal."""
        ...

    def geometry(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(n,) unoccluded irradiance per unit of `color` at (n, 3) points with (n, 3) normals; 0 below the horizon."""
        ...

    def aim(self, points: np.ndarray, normals: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Segments (n, count, 3) from the points to well-spread places on the light, and the weights (n, count) of
        their contributions, not normalized, 0 where a place gives nothing."""
        ...

    def scout(self, points: np.ndarray) -> np.ndarray:
        """Segments (n, s, 3) from the points to the middle and the rim of the light: where they agree, and agree with
        those of the neighbors, the light is wholly seen or wholly hidden, unless something small stands between."""
        ...

    def ends(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corners, each (n, 3), of boxes around the ends of all segments from the points (n, 3) that
        `aim` and `scout` can give: nothing outside the hull of a point and its box stands between it and the light."""
        ...
