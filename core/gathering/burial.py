"""Light for receivers that lie inside other solids: from a place nearby that does not, or else from their neighbors.

A wall's foot lies below the floor, a floor's corner within the wall. Such a vertex sees nothing, but its face
is seen, and would be shaded black towards it.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ..form_factors.cached_hemispheres import gather
from ..lights.direct_light import direct_light
from ..progress import shared_progress
from ..solvers.patch_solution import BURIED, PatchSolution
from ..visibility.embree import CHUNK_RAYS, OFFSET
from .interpolation import fill_from_neighbors
from .receivers import Receivers

#: Parts of the way to the middle of its faces at which a buried receiver looks again.
STEPS = (0.02, 0.1, 0.3, 0.6)

#: A vertex behind a wall is given the light before it when its own is less than this part of that: what lies behind is
#: then not a room, but the outside that nobody sees.
DIM = 0.05

#: Surfaces looked through on the way inward: the two sides of a wall and of what leans on it.
MAX_WALLS = 4

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
) -> Generator[float, None, tuple[np.ndarray, np.ndarray, int]]:
    """Light (r, 6), direct and indirect, with that of the `buried` (r,) mended; whose light (r,) is that of another
    place now; and the rays it took.

    The array given is changed: copies of it are a large part of what a bake holds.

    Receivers on the border of their faces look again from further in; the others take the mean of their neighbors, ring
    by ring. What neither reaches stays as it is.
    """
    known, moved = ~buried, buried.copy()
    rays = min(rays, LOOK_RAYS)
    left = np.nonzero(buried & receivers.borders)[0]
    spent = 0
    for number, step in enumerate(STEPS):
        if not len(left):
            break
        work = _look_again(solution, receivers, left, np.full(len(left), step), rays, penumbra_rays, seed)
        found, free, cost = yield from shared_progress(work, 0.5 * number / len(STEPS), 0.5 * (number + 1) / len(STEPS))
        light[left[free]] = found[free]
        known[left[free]] = True
        spent += cost
        left = left[~free]
    level = light.sum(axis=1)
    dim = known & receivers.borders & (level < DIM * level.mean())
    behind, steps = _behind_walls(solution, receivers, np.nonzero(dim)[0])
    if len(behind):
        work = _look_again(solution, receivers, behind, steps, rays, penumbra_rays, seed)
        found, free, cost = yield from shared_progress(work, 0.5, 1.0)
        better = free & (light[behind].sum(axis=1) < DIM * found.sum(axis=1))
        light[behind[better]] = found[better]
        moved[behind[better]] = True
        spent += cost
    if not known.all():
        light, _ = fill_from_neighbors(light, known, receivers.edges, FILL_RINGS)
    return light, moved, spent


def _look_again(solution, receivers, who, steps, rays, penumbra_rays, seed):
    """Light (n, 6) at receivers `who` (n,) moved inward by `steps` (n,), whether it is free there, and the rays."""
    points = receivers.points[who] + steps[:, None].astype(np.float32) * receivers.inward[who]
    normals = receivers.normals[who]
    work = gather(solution.tracer, solution.hits_to_rows, points, normals, rays, solution.pool, seed, names=who)
    seen = yield from shared_progress(work, 0.0, 0.5)
    if solution.meet(seen.rows):
        yield from solution.follow()
    free = solution.dark_rows()[seen.rows].mean(axis=1) <= BURIED
    work = direct_light(
        solution.tracer,
        solution.lights,
        points,
        normals,
        np.empty((0, 2), np.int32),
        penumbra_rays,
        solution.pool,
        seed,
        everywhere=True,
    )
    direct, shadow = yield from shared_progress(work, 0.5, 1.0)
    # By rays, whatever the method: these are few places, and odd ones.
    return np.concatenate([direct, seen.irradiance(solution.table())], axis=1), free, shadow + rays * len(who)


def _behind_walls(solution, receivers, borders):
    """Border receivers from which the middle of their faces lies behind a wall, and the steps that lead just past its
    last side: a floor that reaches under and beyond the walls of its room."""
    if not len(borders):
        return borders, np.empty(0)
    lift = np.float32(0.02) * receivers.sizes[borders] + np.float32(4 * OFFSET)
    starts = receivers.points[borders] + lift[:, None] * receivers.normals[borders]
    inward = receivers.inward[borders]
    found = np.zeros(len(borders), np.float32)
    step = np.float32(OFFSET) / np.maximum(np.linalg.norm(inward, axis=1), np.float32(1e-12))

    def work(start: int, stop: int) -> None:
        travelled = np.zeros(stop - start, np.float32)
        going = np.arange(stop - start)
        for _ in range(MAX_WALLS):
            along = inward[start + going]
            hits = solution.tracer.closest(starts[start + going] + travelled[going, None] * along, along)
            travelled[going] += hits["tfar"] + step[start + going]
            met = (hits["primID"] >= 0) & (travelled[going] < STEPS[-1])
            left_behind = met & (np.einsum("ij,ij->i", hits["Ng"], along) > 0)
            found[start + going[left_behind]] = travelled[going[left_behind]]
            going = going[met]
            if not len(going):
                break

    solution.pool.run(work, len(borders), CHUNK_RAYS)
    near = found > 0
    return borders[near], found[near] + STEPS[0]
