"""What an accuracy asked for costs: patches, nodes, rays and thresholds, and the memory they take.

The numbers follow the measurements of the algorithm study (sections 2 and 6): its settings lo, mid and hi reached 2,
1.1 and 0.85 % on a Cornell box and 3, 1.5 and 1 % in a furnished room. Halving the error takes about twice the patches
and one and a half times the directions.
"""

from __future__ import annotations

from dataclasses import dataclass

from .discretization.patches import POINTS
from .gathering.indirect_light import IndirectSettings
from .gathering.near_hits import NearHitsSettings

#: Bytes, rounded up from the largest resident memory of whole bakes in Blender (`benchmarks/memory.py`), reading
#: included: of curved meshes, since those with flat walls take a third. A triangle while it is traced, a corner with
#: its share of a receiver, a patch with the rays around it that are worked on at a time, and what does not grow.
TRIANGLE_BYTES = 240
CORNER_BYTES = 50
PATCH_BYTES = 20_000
FIXED_BYTES = 60_000_000

#: What a corner takes more for each light group: its light, direct and indirect, while it is gathered and once more
#: while it is shared out, each 24 bytes, and 32 for the color as it is written and as Blender keeps it.
GROUP_BYTES = 80


@dataclass(frozen=True)
class BakePlan:
    """How finely to work.

    `patches` wanted; rays per sample point of a patch; rays per light in a penumbra; the relative change at which the
    bounces stop; the part of a patch's light that one ray to the sky may carry; and how the indirect light is gathered.
    """

    patches: int
    patch_rays: int
    penumbra_rays: int
    tolerance: float
    patch_detail: float
    indirect: IndirectSettings


def plan_for(accuracy: float) -> BakePlan:
    """The plan for a relative RMS error of irradiance."""
    effort = 0.03 / accuracy
    return BakePlan(
        patches=int(min(max(2700 * effort, 800), 25000)),
        # A receiver in a corner sees half of its hemisphere on one patch, and all of that patch's noise.
        patch_rays=_rays(32 * effort**0.5, 16, 64),
        penumbra_rays=_rays(64 * effort**0.6, 16, 256),
        tolerance=0.002 * accuracy,
        # A receiver sees many patches, and their noise with it evens out.
        patch_detail=max(accuracy, 0.02),
        indirect=IndirectSettings(
            rays=_rays(384 * effort**0.5, 128, 1024),
            spacing=3.0 * effort**0.15,
            levels=3,
            tolerance=0.08 * effort**-0.4,
            detail=0.5 * accuracy,
            near=NearHitsSettings(samples=6, rays=_rays(48 * effort**0.5, 32, 96), noise=2 * accuracy),
        ),
    )


def _rays(wanted: float, low: int, high: int) -> int:
    return int(min(max(8 * round(wanted / 8), low), high))


def foreseen_memory(triangles: int, corners: int, plan: BakePlan, groups: int = 0) -> int:
    """Bytes that a bake with so many light groups will take at its peak, above what the scene itself takes."""
    rows = plan.patches * POINTS * plan.patch_rays * 4
    corner = CORNER_BYTES + GROUP_BYTES * groups
    return FIXED_BYTES + TRIANGLE_BYTES * triangles + corner * corners + PATCH_BYTES * plan.patches + rows
