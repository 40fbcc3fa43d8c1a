"""What every light can do, and nothing else.

Direct light is split in two factors, as in Baum et al. 1989: an unoccluded part in closed form, and a visibility that is
sampled by rays. A light therefore answers two questions: how much would arrive without occluders, and towards which
points must rays be cast to find the visible share.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Light(Protocol):
    """A source of direct light."""

    @property
    def power(self) -> np.ndarray:
        """(3,) emitted flux in W; for a sun, irradiance times pi, to be scaled by the scene's cross-section."""
        ...

    @property
    def color(self) -> np.ndarray:
        """(3,) factor by which `geometry` is multiplied to give irradiance in W/m2."""
        ...

    @property
    def is_sharp(self) -> bool:
        """Whether one ray tells all about visibility (a point, or parallel light)."""
        ...

    def geometry(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(n,) unoccluded irradiance per unit of `color` at n oriented points; 0 behind and below the horizon."""
        ...

    def targets(self, count: int, seed: int) -> np.ndarray:
        """(count, 3) well-spread points on the light; for a sun, unit directions towards it."""
        ...

    def weights(self, points: np.ndarray, normals: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n, count) relative contribution of each target at each point, not normalized; 0 where it gives nothing."""
        ...
