"""Light from what stands nearer than a patch is wide: followed by paths, not looked up.

A patch has one radiosity. Seen from afar its light and shade average out; seen from a gap that is narrower than itself
they do not: the floor under a wall's foot, a board's breadth wide, would shine with the light beside it. Rays that end
nearer than the size of the patch they meet go on from there, with light drawn at each stop, until one ends far enough
away for its patch to be trusted. Where light is even, both ways agree.

What is added to the gathered light is the difference between the two, found by a few rays of their own: it is small
wherever nothing is near, and so is its noise. Cost: some rays per near hit, so next to nothing in an open room, and
about that of the hemispheres themselves where all is narrow. In the terms of the survey's final gather: patches stay
the illuminators, but only from their own size on.

The paths are those of Kajiya 1986, "The Rendering Equation". None is ended by chance: where light is even each gives
the same.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ..form_factors.cached_hemispheres import VARIANTS, hemisphere_directions, turns_of_names
from ..frames import turned_frames
from ..light_groups import repeated, whole
from ..lights.direct_light import direct_light
from ..lights.sampling import PLASTIC
from ..progress import shared_progress
from ..solvers.patch_solution import PatchSolution
from ..visibility.before_hits import before_hits
from ..visibility.embree import CHUNK_RAYS, OFFSET

#: A hit is near when it is nearer than this many sides of the patch that it meets. At two, what a patch that a shadow
#: cuts gives too much here is what the next one gives too little; at one, a gap still got a third too much.
REACH = 2.0

#: From the first stop on the reach is this many times less: a path's error is one of many there, and dimmed.
LATER = np.float32(2)

#: Stops of a path at most: then the patch is trusted after all.
MAX_STOPS = 16

#: Rays to a light from each stop, and lights asked: other paths stop elsewhere, so little is needed.
SHADOW_RAYS = 2
MOST_LIGHTS = 6

#: What is left of a path's light when the patch is trusted after all.
FAINT = 0.05


def paths_for(rays: int) -> int:
    """Paths that go with this many directions of a hemisphere: what they find is added to what those have found."""
    return max(48, rays // 6)


def reach_of_rows(solution: PatchSolution) -> np.ndarray:
    """(rows,) float32 distance up to which a hit on each row of the table is near; 0 for sky and what is black."""
    reach = np.zeros(solution.hits_to_rows.rows, np.float32)
    count = solution.patches.count
    reach[:count] = reach[count : 2 * count] = REACH * np.sqrt(solution.patches.areas)
    return reach


def follow_paths(
    solution: PatchSolution, points: np.ndarray, normals: np.ndarray, rays: int, names: np.ndarray, seed: int
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """What n receivers' irradiance (n, c) differs by from what the patches give, and the rays it took.

    Parameters
    ----------
    points, normals : (n, 3) float32
    rays : int
        Paths per receiver.
    names : (n,) int
        Numbers of the receivers, which turn their directions.
    """
    count, columns = len(points), solution.columns
    out = np.zeros((count, columns))
    if not count:
        return out, 0
    frames = turned_frames(normals, turns_of_names(names, seed + 1)).astype(np.float32, copy=False)
    directions = np.matmul(hemisphere_directions(rays)[names % VARIANTS], frames).reshape(-1, 3)
    owners = np.repeat(np.arange(count), rays)
    starts = np.repeat(points + np.float32(OFFSET) * normals, rays, axis=0)
    generator = np.random.default_rng([seed, int(names[0]), count])
    reach, shares, spent = reach_of_rows(solution), np.ones((len(owners), 3), np.float32), 0
    for stop in range(MAX_STOPS + 1):
        rows, places, facing, distances = _met(solution, starts, directions, generator)
        spent += len(rows)
        if solution.meet(rows):
            yield from solution.follow()
        table = solution.table()[:, :-1]
        near = distances < reach[rows]
        if stop == 0:
            reach /= LATER
            # The patches' own answer is there already.
            _add(out, owners[near], -table[rows[near]])
        else:
            # Not by chance: a furnace would flicker.
            near &= (shares.max(axis=1) > FAINT) & (stop < MAX_STOPS)
            _add(out, owners[~near], repeated(shares[~near], columns) * table[rows[~near]])
        kept = np.nonzero(near)[0]
        if not len(kept):
            break
        owners, shares, rows, places, facing = (a[kept] for a in (owners, shares, rows, places, facing))
        reflectance = solution.reflectances[rows]
        light, cost = yield from _lit(solution, places, facing, seed + stop, stop / (MAX_STOPS + 1))
        spent += cost
        _add(out, owners, repeated(shares, columns) * (solution.emitted[rows] + reflectance * light))
        shares = shares * whole(reflectance)
        lasting = np.nonzero(shares.max(axis=1) > 0)[0]
        if not len(lasting):
            break
        owners, shares, places, facing = (a[lasting] for a in (owners, shares, places, facing))
        starts, directions = places, _directions(generator, facing)
    return out / rays, spent


def _lit(solution: PatchSolution, places: np.ndarray, facing: np.ndarray, seed: int, done: float):
    """Direct light (n, c) at the stops of paths, and the rays it took."""
    alone = np.empty((0, 2), np.int32)
    work = direct_light(
        solution.tracer,
        solution.lights,
        places,
        facing,
        alone,
        SHADOW_RAYS,
        solution.pool,
        seed,
        everywhere=True,
        most=MOST_LIGHTS,
        colors=solution.light_colors,
    )
    return (yield from shared_progress(work, done, done + 1 / (MAX_STOPS + 1)))


def _met(solution: PatchSolution, starts: np.ndarray, directions: np.ndarray, generator: np.random.Generator):
    """Row (n,), place (n, 3) just before it, normal (n, 3) towards it, and distance (n,) of what each ray meets."""
    count = len(starts)
    rows, distances = np.empty(count, np.int32), np.empty(count, np.float32)
    places, facing = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    luck = None if solution.tracer.veil is None else _numbers(generator, count)

    def work(start: int, stop: int) -> None:
        origins, along = starts[start:stop], directions[start:stop]
        hits = solution.tracer.closest(origins, along, None if luck is None else luck[start:stop])
        rows[start:stop] = solution.hits_to_rows.look_up(hits, along)
        far = np.where(hits["primID"] >= 0, hits["tfar"], np.float32(np.inf))
        places[start:stop], facing[start:stop], _ = before_hits(origins, along, hits)
        distances[start:stop] = far

    solution.pool.run(work, count, CHUNK_RAYS)
    return rows, places, facing, distances


def _directions(generator: np.random.Generator, normals: np.ndarray) -> np.ndarray:
    """(n, 3) float32, one direction by the cosine around each normal: those of neighboring rows, which are paths of one
    receiver, spread well."""
    index = np.arange(len(normals))
    shift = generator.random(2)
    square = ((shift[0] + index / PLASTIC) % 1.0).astype(np.float32)
    turns = (2 * np.pi * ((shift[1] + index / PLASTIC**2) % 1.0)).astype(np.float32)
    flat = np.sqrt(square)[:, None] * turned_frames(normals, turns)[:, 0]
    return (flat + np.sqrt(1 - square)[:, None] * normals).astype(np.float32)


def _numbers(generator: np.random.Generator, count: int) -> np.ndarray:
    return generator.random(count, dtype=np.float32)


def _add(out: np.ndarray, owners: np.ndarray, values: np.ndarray) -> None:
    for channel in range(out.shape[1]):
        out[:, channel] += np.bincount(owners, weights=values[:, channel], minlength=len(out))
