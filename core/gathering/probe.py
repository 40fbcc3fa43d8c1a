"""A quick look at the error of a bake: some receivers are done again with many more rays, and compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..bake_plan import BakePlan
from ..form_factors.cached_hemispheres import gather
from ..light_groups import total, whole
from ..lights.direct_light import direct_light
from ..progress import finish
from ..solvers.patch_solution import BURIED, PatchSolution
from .indirect_light import IndirectLight
from .near_field import near_field
from .receivers import Receivers

#: Receivers that are done again, half of them on borders where there are so many, and by what factor their rays grow.
#: Their own error is then half of what is measured, which raises the estimate by about a tenth.
PROBES = 192
FACTOR = 4

#: By what factor the near hits grow in number that are gathered again.
NEAR_FACTOR = 2

#: Rays that looking costs at most; with many lights fewer receivers are probed.
MAX_RAYS = 400_000


def probe_error(
    solution: PatchSolution,
    receivers: Receivers,
    light: np.ndarray,
    indirect: IndirectLight,
    moved: np.ndarray,
    plan: BakePlan,
    seed: int,
) -> tuple[float, int]:
    """Relative RMS error of irradiance, estimated, and the rays it took.

    Differences are taken over receivers and channels and divided by the mean irradiance. Receivers whose light was
    `moved` (r,) there from another place, because their own lies in a wall or behind it, are not asked: light is not
    wanted where they are. Nor are those found buried, whose cluster is not. Borders are probed as often as all others,
    and weigh by their number: they are few, but err most. Patches next to a receiver are asked again, so their error
    shows; that of patches further off is shared by both sides and does not.
    """
    usable = ~moved
    if not usable.any():
        return 0.0, 0
    hemisphere, shadow = FACTOR * plan.indirect.rays, FACTOR * plan.penumbra_rays
    near = replace(plan.indirect.near, samples=NEAR_FACTOR * plan.indirect.near.samples)
    each = hemisphere + near.samples * near.rays + shadow * min(len(solution.lights), 24)
    count = int(min(PROBES, max(16, MAX_RAYS // each)))
    chosen, weight = _draw(usable, receivers.borders, count, np.random.default_rng(seed))
    points, normals = receivers.points[chosen], receivers.normals[chosen]
    alone = np.empty((0, 2), np.int32)
    lit, rays = finish(
        direct_light(
            solution.tracer,
            solution.lights,
            points,
            normals,
            alone,
            shadow,
            solution.pool,
            seed + 1,
            everywhere=True,
            colors=solution.light_colors,
        )
    )
    seen = finish(
        gather(solution.tracer, solution.hits_to_rows, points, normals, hemisphere, solution.pool, seed + 7919)
    )
    even, names = seen.irradiance(solution.looked_up()), np.arange(len(chosen))
    marked = indirect.closeup.marked(chosen, points, normals, indirect.around(chosen))
    gathered, closer = finish(indirect.closeup.values(points, normals, seen.rows, marked, even, names, seed + 7919))
    if solution.exchange is not None:
        # By rays as well, which check the method that way.
        gathered = gathered + seen.irradiance(solution.table() - solution.looked_up())
    work = near_field(solution, points, normals, seen, gathered, lit, near, seed + 7919, names)
    mended, spent = finish(work)
    rays += hemisphere * len(chosen) + closer + spent
    better = whole(lit) + whole(mended)
    baked = total(light[chosen])
    free = solution.dark_rows()[seen.rows].mean(axis=1) <= BURIED
    if not free.any():
        return 0.0, rays
    better, baked, weight = better[free], baked[free], weight[free] / weight[free].sum()
    mean = float(weight @ baked.mean(axis=1))
    error = float(np.sqrt(weight @ ((baked - better) ** 2).mean(axis=1)))
    return (error / mean if mean > 0 else 0.0), rays


def _draw(usable: np.ndarray, borders: np.ndarray, count: int, generator) -> tuple[np.ndarray, np.ndarray]:
    """Up to `count` usable receivers, half of them on borders, and their weights, which sum to 1."""
    kinds = [np.nonzero(usable & borders)[0], np.nonzero(usable & ~borders)[0]]
    few = min(len(kind) for kind in kinds)
    wanted = [min(len(kind), max(count // 2, count - few)) for kind in kinds]
    chosen, weights = [], []
    for kind, number in zip(kinds, wanted, strict=True):
        picked = np.sort(generator.choice(kind, number, replace=False))
        chosen.append(picked)
        weights.append(np.full(number, len(kind) / max(number, 1)))
    weight = np.concatenate(weights)
    return np.concatenate(chosen), weight / weight.sum()
