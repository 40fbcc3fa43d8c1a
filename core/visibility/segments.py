"""Visibility of segments: one signature for every way to tell whether two points see each other.

`embree` rays are the fastest where they exist; `zbuffer` needs no compiled code and serves many targets from few
origins, right but for a pixel's width along silhouettes; `bsp` is exact without compiled code; `silhouettes` is, too,
for blockers that are convex polyhedra; `brute_force` is the reference, for small scenes; `none` says that nothing
blocks, for convex rooms.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from .brute_force import BruteForce
from .bsp import BspVisibility
from .cube_map import CubeMaps
from .embree import SHADOW_LENGTH, RayEngine
from .margins import end_margin, trim
from .silhouettes import SilhouetteVisibility


class Visibility(Protocol):
    """Answers whether points see each other.

    Attributes
    ----------
    rays : int
        Segments tested so far.
    """

    rays: int

    def visible(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n,) bool: whether the open segment from each origin (n, 3) to its target (n, 3) meets no polygon.

        Both ends lie on surfaces: what is met within `margins.end_margin` of either does not count.
        """


class Unblocked:
    """Every point sees every other."""

    def __init__(self, environment: Environment):
        self.rays = 0

    def visible(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n,) bool: True."""
        return np.ones(len(origins), bool)


class EmbreeSegments:
    """Visibility of segments by embree's rays.

    Raises
    ------
    MissingRayEngineError
        If embreex does not exist on this platform.
    """

    def __init__(self, environment: Environment, threads: int = 0):
        self.rays = 0
        self.margin = end_margin(environment)
        self._engine = RayEngine(environment.vertices, environment.triangles, threads)

    def visible(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n,) bool: whether the segments meet no polygon between their ends."""
        starts, ends, remaining = trim(origins, targets, self.margin)
        self.rays += len(starts)
        # The engine leaves the last part of a segment untested; the margin has taken its own part off already.
        free = ~self._engine.occluded(starts, starts + (ends - starts) / SHADOW_LENGTH)
        return free | ~remaining


def _none(environment, threads, **options):
    return Unblocked(environment, **options)


def _embree(environment, threads, **options):
    return EmbreeSegments(environment, threads, **options)


def _zbuffer(environment, threads, **options):
    return CubeMaps(environment, **options)


def _bsp(environment, threads, **options):
    return BspVisibility(environment, **options)


def _silhouettes(environment, threads, **options):
    return SilhouetteVisibility(environment, **options)


def _brute_force(environment, threads, **options):
    return BruteForce(environment, **options)


#: Visibilities by name: ``make(environment, threads, **options)``, and the options it takes.
VISIBILITIES: dict[str, tuple[Callable[..., Visibility], tuple[str, ...]]] = {
    "none": (_none, ()),
    "embree": (_embree, ()),
    "zbuffer": (_zbuffer, ("resolution",)),
    "bsp": (_bsp, ()),
    "silhouettes": (_silhouettes, ()),
    "brute_force": (_brute_force, ()),
}


def make_visibility(name: str, environment: Environment, threads: int = 0, **options) -> Visibility:
    """Visibility in an environment, by name.

    Parameters
    ----------
    name : str
        One of `VISIBILITIES`.
    environment : Environment
        All its polygons block, from both sides.
    threads : int
        Threads of the ray engine; 0 takes all cores. The answers do not depend on it.
    **options
        Options of that visibility, such as the resolution of ``zbuffer``.

    Raises
    ------
    SettingsError
        If the name or an option is unknown, or the blockers are not convex polyhedra, which ``silhouettes`` need.
    MissingRayEngineError
        If rays are needed and cannot be traced on this platform.
    """
    if name not in VISIBILITIES:
        raise SettingsError(f"Unknown visibility {name!r}: choose {', '.join(VISIBILITIES)}")
    make, known = VISIBILITIES[name]
    for option in options:
        if option not in known:
            choices = f": choose {', '.join(known)}" if known else ", it has none"
            raise SettingsError(f"Unknown option {option!r} of visibility {name}{choices}")
    return make(environment, threads, **options)
