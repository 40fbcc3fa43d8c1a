"""Light at places that are no receivers: a hemisphere and all lights from each, for the few that need another look."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ..form_factors.cached_hemispheres import gather
from ..light_groups import joined
from ..lights.direct_light import direct_light
from ..progress import shared_progress
from ..solvers.patch_solution import BURIED, PatchSolution

#: Places looked from at a time: their rays stay within some tens of MB.
BLOCK = 65536


@dataclass(frozen=True)
class Look:
    """What n places saw: `light` (n, 2 c), direct and indirect irradiance as `light_groups.joined` orders them; whether
    each is `free` (n,) and not buried; the parts `outside` and `backs` (n,) of the rays that met nothing, and surfaces
    from behind; the harmonic mean `distances` (n,) to what is around, in unit lengths; and the `rays` it took."""

    light: np.ndarray
    free: np.ndarray
    outside: np.ndarray
    backs: np.ndarray
    distances: np.ndarray
    rays: int


def look(
    solution: PatchSolution,
    points: np.ndarray,
    normals: np.ndarray,
    names: np.ndarray,
    rays: int,
    penumbra_rays: int,
    seed: int,
) -> Generator[float, None, Look]:
    """Look from n oriented points (n, 3), in the unit frame and on the surface; yields the share done.

    `names` (n,) decide how each turns its `rays` directions. Each light is asked by `penumbra_rays`, whatever it looks
    like from there, since these places have no neighbors to tell. What is near is not asked again.
    """
    count, parts = len(points), []
    for start in range(0, max(count, 1), BLOCK):
        part = slice(start, start + BLOCK)
        work = _look(solution, points[part], normals[part], names[part], rays, penumbra_rays, seed)
        share = start / max(count, 1), min(start + BLOCK, count) / max(count, 1)
        parts.append((yield from shared_progress(work, *share)))
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0] if name != "rays"}
    return Look(**arrays, rays=sum(part["rays"] for part in parts))


def _look(solution, points, normals, names, rays, penumbra_rays, seed) -> Generator[float, None, dict]:
    """Fields of the `Look` from a block of points."""
    work = gather(solution.tracer, solution.hits_to_rows, points, normals, rays, solution.pool, seed, names=names)
    seen = yield from shared_progress(work, 0.0, 0.5)
    if solution.meet(seen.rows):
        yield from solution.follow()
    alone = np.empty((0, 2), np.int32)
    work = direct_light(
        solution.tracer,
        solution.lights,
        points,
        normals,
        alone,
        penumbra_rays,
        solution.pool,
        seed,
        everywhere=True,
        colors=solution.light_colors,
    )
    direct, shadow = yield from shared_progress(work, 0.5, 1.0)
    return {
        "light": joined(direct, seen.irradiance(solution.table())),
        "free": solution.dark_rows()[seen.rows].mean(axis=1) <= BURIED,
        "outside": solution.hits_to_rows.is_outside()[seen.rows].mean(axis=1),
        "backs": solution.hits_to_rows.is_back()[seen.rows].mean(axis=1),
        "distances": seen.distances,
        "rays": shadow + rays * len(points),
    }
