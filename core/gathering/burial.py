"""Light for receivers that lie inside other solids: from a place nearby that does not, or else from their neighbors.

A wall's foot lies below the floor, a floor's corner within the wall. Such a vertex sees nothing, but its face
is seen, and would be shaded black towards it.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ..progress import shared_progress
from ..solvers.patch_solution import PatchSolution
from .interpolation import fill_from_neighbors
from .looks import look
from .receivers import Receivers

#: Parts of the way to the middle of its faces at which a buried receiver looks again.
STEPS = (0.02, 0.1, 0.3, 0.6)

#: Rays over the hemisphere at most when looking again: these are few vertices in odd places.
LOOK_RAYS = 128

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
    """Light (r, 2 c), direct and indirect, with that of the `buried` (r,) mended, and the rays it took.

    The array given is changed: copies of it are a large part of what a bake holds.

    Receivers on the border of their faces look again from further in; the others take the mean of their neighbors, ring
    by ring. What neither reaches stays as it is.
    """
    known = ~buried
    rays = min(rays, LOOK_RAYS)
    left = np.nonzero(buried & receivers.borders)[0]
    spent = 0
    for number, step in enumerate(STEPS):
        if not len(left):
            break
        work = _look_again(solution, receivers, left, step, rays, penumbra_rays, seed)
        seen = yield from shared_progress(work, number / len(STEPS), (number + 1) / len(STEPS))
        light[left[seen.free]] = seen.light[seen.free]
        known[left[seen.free]] = True
        spent += seen.rays
        left = left[~seen.free]
    if not known.all():
        light, _ = fill_from_neighbors(light, known, receivers.edges, FILL_RINGS)
    return light, spent


def _look_again(solution, receivers, who, step, rays, penumbra_rays, seed):
    """What is seen from receivers `who` (n,) moved inward by `step`."""
    points = receivers.points[who] + np.float32(step) * receivers.inward[who]
    return look(solution, points, receivers.normals[who], who, rays, penumbra_rays, seed)
