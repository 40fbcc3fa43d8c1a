"""Sun lamp: parallel light from a disk in the sky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SunLight:
    """`irradiance` (W/m2 per channel, on a surface that faces it) from the unit vector `direction` (towards the sun),
    whose disk has the full angle `angle` (radians, may be 0)."""

    direction: np.ndarray
    irradiance: np.ndarray
    angle: float = 0.0
