"""Area light: a planar polygon that emits diffusely, a lamp or an emissive face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class AreaLight:
    """A planar polygon `vertices` (k, 3) with `exitance` (W/m2 per channel) on its front, by the right-hand rule, and on
    its back too where `two_sided`."""

    vertices: np.ndarray
    exitance: np.ndarray
    two_sided: bool = False
