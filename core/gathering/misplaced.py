"""Receivers that stand where their light is not wanted, each kind lit from where it is.

Four kinds: those that a wall cuts off from most of their faces (`walled_off`), those inside solids (`burial`), those
in hollows among solids (`hollows`), and inner faces of meshes that modifiers reshape (`inner_faces`).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ..bake_plan import BakePlan
from ..progress import shared_progress
from ..scene import ReceiverMesh
from ..solvers.patch_solution import PatchSolution
from .burial import unbury
from .hollows import light_hollows
from .inner_faces import cover_inner_faces
from .receivers import Receivers
from .walled_off import WalledOff, relight_walled_off


@dataclass(frozen=True)
class Mended:
    """Receivers (r,) bool that lie inside solids, and those with light of another place; and the rays it took."""

    buried: np.ndarray
    moved: np.ndarray
    rays: int


def mend_misplaced(
    solution: PatchSolution,
    receivers: Receivers,
    walled: WalledOff,
    meshes: Sequence[ReceiverMesh],
    light: np.ndarray,
    buried: np.ndarray,
    plan: BakePlan,
    seed: int,
) -> Generator[float, None, tuple[np.ndarray, Mended]]:
    """Light (r, 2 c), direct and indirect, with that of misplaced receivers mended; the array given is changed.

    Parameters
    ----------
    meshes : sequence of ReceiverMesh
        Those that `receivers` are of, with or without geometry.
    buried : (r,) bool
        Receivers found inside solids.
    """
    work = relight_walled_off(solution, walled, light, buried, plan.penumbra_rays, seed)
    relit, rays = yield from shared_progress(work, 0.0, 0.4)
    work = unbury(solution, receivers, light, buried, plan.indirect.rays, plan.penumbra_rays, seed)
    light, spent = yield from shared_progress(work, 0.4, 0.7)
    work = light_hollows(solution, meshes, receivers, light, buried | relit, plan.penumbra_rays, seed)
    left, hollow_rays = yield from shared_progress(work, 0.7, 0.8)
    work = cover_inner_faces(solution, meshes, receivers, light, seed)
    inner, inner_rays = yield from shared_progress(work, 0.8, 1.0)
    buried = buried | inner
    return light, Mended(buried, buried | relit | left, rays + spent + hollow_rays + inner_rays)
