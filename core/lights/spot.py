"""Spot lamp: a point lamp within a cone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SpotLight:
    """As `PointLight`, within the cone of full angle `angle` (radians) around the unit vector `direction` (where it
    shines to), fading towards the rim over the share `blend` (0 to 1) of the cone."""

    position: np.ndarray
    direction: np.ndarray
    intensity: np.ndarray
    angle: float
    blend: float = 0.0
    radius: float = 0.0
