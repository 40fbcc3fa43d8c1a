"""The whole pipeline as a generator: contract (the body follows)."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np

from .scene import Scene
from .settings import BakeSettings


@dataclass(frozen=True)
class Progress:
    """One step of long work: `fraction` of all of it, 0 to 1, and what is being done."""

    fraction: float
    message: str


@dataclass(frozen=True)
class BakedMesh:
    """Light at one `ReceiverMesh`."""

    name: str
    buried_corners: np.ndarray  # (c,) bool: filled from neighbors

    def corner_colors(self, bake_type: str) -> np.ndarray:
        """(c, 3) float32 colors per face corner, in the units of design section 2 (exitance or irradiance over pi)."""

    def vertex_colors(self, bake_type: str) -> np.ndarray:
        """(v, 3) float32 colors per vertex: mean of its unburied corners."""


@dataclass(frozen=True)
class BakeResult:
    """What a bake gives back. `statistics` holds JSON-ready numbers: patches, receivers, lights, rays, seconds per stage,
    converged, iterations, light_absorbed, energy_balance_error, closure_error_max, reciprocity_error_max,
    estimated_error."""

    meshes: list[BakedMesh]  # one per Scene.receivers, same order
    statistics: dict
    warnings: list[str] = field(default_factory=list)


def bake_steps(scene: Scene, settings: BakeSettings) -> Generator[Progress, None, BakeResult]:
    """Bake in steps of some tens of milliseconds; the generator's return value is the result.

    Raises RadiosityError children for anything the user can mend. Nothing is written anywhere.
    """
    yield Progress(0.0, "")
