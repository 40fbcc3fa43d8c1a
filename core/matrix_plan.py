"""Bakes by a method or a solver chosen by name: how many patches they get, and what they refuse before the slow part.

A matrix has the square of the patches' number of factors, and most methods take microseconds for each, so patches are
fewer than in an automatic bake, and grow less with the accuracy: their number with its inverse square root. What stands
next to a receiver is asked again by rays anyway, which is what so coarse patches would err in most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .bake_plan import BakePlan
from .discretization.patch_polygons import PatchPolygons
from .discretization.patches import Patches
from .errors import SceneTooLargeError, SettingsError
from .scene import Surfaces
from .settings import BakeSettings

#: Patches wanted at an accuracy of 3 %, and at least and at most. Where walls stand on floors, splitting makes about
#: four times as many of them.
PATCHES, LEAST_PATCHES, MOST_PATCHES = 100, 60, 250

#: Polygons beyond which no matrix is tried: the slowest methods take some 10 minutes for so many.
MOST_POLYGONS = 3000

#: Bytes of one factor of the matrix; a bake holds a few such arrays at a time.
FACTOR_BYTES = 8

#: Error of the worst form factor, as a share of the accuracy of the light: factors of small patches are themselves only
#: so large, and errors of many even out.
FACTOR_SHARE = 1.0


def has_name(settings: BakeSettings) -> bool:
    """Whether a method or a solver was chosen by name."""
    return settings.method != "auto" or settings.solver != "auto"


def chosen_names(settings: BakeSettings) -> str:
    """What was chosen, for messages."""
    kinds = (("method", settings.method), ("solver", settings.solver))
    return " and ".join(f"{kind} {name}" for kind, name in kinds if name != "auto")


def matrix_plan(plan: BakePlan, accuracy: float) -> BakePlan:
    """The plan with as many patches as a matrix bears."""
    wanted = PATCHES * (0.03 / accuracy) ** 0.5
    return replace(plan, patches=int(min(max(wanted, LEAST_PATCHES), MOST_PATCHES)))


def check_surfaces(surfaces: Surfaces, settings: BakeSettings) -> None:
    """Raise SettingsError where light passes surfaces: polygons block it."""
    veils = surfaces.wearing(surfaces.transmittance > 0)
    if has_name(settings) and veils.any():
        names = [surfaces.object_names[row] for row in np.unique(surfaces.objects[veils])]
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        raise SettingsError(
            f"Form factors by {chosen_names(settings)} cannot see through {', '.join(map(repr, names[:3]))}{more}: "
            f"choose {_remedy(settings)}, or make the material opaque"
        )


def check_size(patches: Patches, settings: BakeSettings) -> None:
    """Raise SceneTooLargeError where a matrix would be too large."""
    polygons = PatchPolygons.count_of(patches)
    if has_name(settings) and polygons > MOST_POLYGONS:
        raise SceneTooLargeError(
            f"Form factors by {chosen_names(settings)} between {polygons:,} polygons would be {polygons**2:,}, "
            f"{_megabytes(polygons)}, and {MOST_POLYGONS:,} polygons, {_megabytes(MOST_POLYGONS)}, are the limit: "
            f"choose {_remedy(settings)}, or bake fewer and plainer objects"
        )


def _remedy(settings: BakeSettings) -> str:
    kinds = (("method", settings.method), ("solver", settings.solver))
    return " and ".join(f"{kind} auto (--{kind} auto)" for kind, name in kinds if name != "auto")


def _megabytes(polygons: int) -> str:
    """Size of the matrix between so many polygons, for messages."""
    return f"{polygons**2 * FACTOR_BYTES / 1e6:,.0f} MB"
