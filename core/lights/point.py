"""Point lamp: a small sphere that shines equally in all directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PointLight:
    """A sphere of radius `radius` (m, may be 0) at `position` with `intensity` in W/sr per channel."""

    position: np.ndarray
    intensity: np.ndarray
    radius: float = 0.0
