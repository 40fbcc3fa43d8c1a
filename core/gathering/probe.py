"""A quick look at the error of a bake: some receivers are done again with many more rays, and compared."""

from __future__ import annotations

import numpy as np

from ..bake_plan import BakePlan
from ..form_factors.cached_hemispheres import gather
from ..lights.direct_light import direct_light
from ..progress import finish
from ..solvers.patch_solution import BURIED, PatchSolution
from .indirect_light import IndirectLight
from .near_field import near_field, paths_for
from .receivers import Receivers

#: Receivers that are done again, and by what factor their rays grow. Their own error is then half of what is measured,
#: which raises the estimate by about a tenth.
PROBES = 192
FACTOR = 4

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
    wanted where they are. Nor are those found buried, whose cluster is not. The error of the patches themselves is
    shared by both sides and does not show.
    """
    candidates = np.nonzero(~moved)[0]
    if not len(candidates):
        return 0.0, 0
    hemisphere, shadow = FACTOR * plan.indirect.rays, FACTOR * plan.penumbra_rays
    each = hemisphere + shadow * min(len(solution.lights), 24)
    count = int(min(PROBES, max(16, MAX_RAYS // each), len(candidates)))
    generator = np.random.default_rng(seed)
    chosen = np.sort(generator.choice(candidates, count, replace=False))
    points, normals = receivers.points[chosen], receivers.normals[chosen]
    alone = np.empty((0, 2), np.int32)
    lit, rays = finish(
        direct_light(
            solution.tracer, solution.lights, points, normals, alone, shadow, solution.pool, seed + 1, everywhere=True
        )
    )
    seen = finish(
        gather(solution.tracer, solution.hits_to_rows, points, normals, hemisphere, solution.pool, seed + 7919)
    )
    even, names = seen.irradiance(solution.table()), np.arange(count)
    marked = indirect.closeup.marked(chosen, normals, indirect.around(chosen))
    gathered, closer = finish(indirect.closeup.values(points, normals, seen.rows, marked, even, names, seed + 7919))
    # By twice the paths: the near field is a small part, or else it is dim.
    near, spent = finish(near_field(solution, points, normals, 2 * paths_for(plan.indirect.rays), chosen, seed + 7919))
    better = lit + np.maximum(gathered + near, 0)
    baked = light[chosen, :3] + light[chosen, 3:]
    free = solution.dark_rows()[seen.rows].mean(axis=1) <= BURIED
    if not free.any():
        return 0.0, rays + hemisphere * count
    better, baked = better[free], baked[free]
    mean = float(baked.mean())
    error = float(np.sqrt(((baked - better) ** 2).mean()))
    return (error / mean if mean > 0 else 0.0), rays + hemisphere * count + closer + spent
