"""Light for receivers that lie inside other solids: from a place nearby that does not, or else from their neighbors.

A wall's foot lies below the floor, a floor's corner within the wall. Such a vertex sees nothing, but its face
is seen, and would be shaded black towards it.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from .direct_light import direct_light
from .gathering import gather
from .interpolation import fill_from_neighbors
from .patch_solution import BURIED, PatchSolution
from .progress import shared_progress
from .receivers import Receivers

#: Parts of the way to the middle of its faces at which a buried receiver looks again.
STEPS = (0.02, 0.1, 0.3, 0.6)

#: Rings of buried receivers that are filled from their neighbors. Deeper ones lie where nobody sees them.
FILL_RINGS = 64


def unbury(
    solution: PatchSolution,
    receivers: Receivers,
    light: np.ndarray,
    buried: np.ndarray,
    rays: int,
    penumbra_rays: int,
    seed: int,
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Light (r, 6), direct and indirect, with that of the `buried` (r,) mended, and the rays it took.

    Receivers on the border of their faces look again from further in; the others take the mean of their neighbors, ring
    by ring. What neither reaches stays as it is.
    """
    light, known = light.copy(), ~buried
    left = np.nonzero(buried & receivers.borders)[0]
    spent = 0
    for number, step in enumerate(STEPS):
        if not len(left):
            break
        points = receivers.points[left] + np.float32(step) * receivers.inward[left]
        normals = receivers.normals[left]
        work = gather(solution.tracer, solution.hits_to_rows, points, normals, rays, solution.pool, seed, names=left)
        seen = yield from shared_progress(work, number / len(STEPS), (number + 0.5) / len(STEPS))
        spent += rays * len(left)
        if solution.meet(seen.rows):
            yield from solution.follow()
        free = solution.dark_rows()[seen.rows].mean(axis=1) <= BURIED
        out = left[free]
        work = direct_light(
            solution.tracer,
            solution.lights,
            points[free],
            normals[free],
            np.empty((0, 2), np.int32),
            penumbra_rays,
            solution.pool,
            seed,
            everywhere=True,
        )
        direct, shadow = yield from shared_progress(work, (number + 0.5) / len(STEPS), (number + 1) / len(STEPS))
        light[out, :3] = direct
        light[out, 3:] = seen.irradiance(solution.table())[free]
        known[out] = True
        spent += shadow
        left = left[~free]
    light, _ = fill_from_neighbors(light, known, receivers.edges, FILL_RINGS)
    return light, spent
