"""What stands next to a receiver, asked again by rays: the mend for patches too coarse to be looked at closely.

A patch has one radiosity. From afar that is as good as any, since many patches share a hemisphere; in a corner half the
hemisphere lies on one patch of the wall beside it, and what is wanted is the light at that very edge, not the patch's
mean. For receivers that see much of patches nearer than `NEAR` of their sides, a few of those hits are gathered
themselves, and the mean difference to what was looked up is added for all near hits (a control variate: where the
patches are right, nothing changes but for a little noise).

The places beside an edge light each other. A second gather that leads back to the patch on which the receiver stands
takes the receiver's own light, still to be found, instead of the patch's: one linear equation per receiver and channel,
which is the limit of all reflections between the two sides of an edge.

Cost: per receiver with something near, `samples` * (`rays` + those of the lights). A third surface, in the corner of a
room, is seen as patches by the second gather; its error counts by two reflectances.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ..form_factors.cached_hemispheres import Gathered, chosen_directions, gather
from ..light_groups import whole
from ..lights.direct_light import direct_light
from ..progress import shared_progress
from ..solvers.patch_solution import PatchSolution
from ..visibility.embree import CHUNK_RAYS, OFFSET

#: A patch is near when its middle is closer than this many of its sides.
NEAR = 2.0

#: Least part of the hemisphere on near patches for which they are asked again.
LEAST_SHARE = 0.2

#: Hits of second gathers held at a time: some MB each of rows, directions and light.
BLOCK_ROWS = 400_000

#: Cosine between normals up to which a patch counts as one with the surface that the receiver lies on.
ALIKE = 0.9


@dataclass(frozen=True)
class NearHits:
    """Receivers `which` (m,) that have something near, the `shares` (m,) of their rays that meet it, and some of those
    rays, `picks` (m, k), spread over all of them."""

    which: np.ndarray
    shares: np.ndarray
    picks: np.ndarray

    def only(self, kept: np.ndarray) -> NearHits:
        """Those of them that are `kept` (m,)."""
        return NearHits(self.which[kept], self.shares[kept], self.picks[kept])


@dataclass(frozen=True)
class NearHitsSettings:
    """How many near hits of a receiver are gathered again, with how many rays each, and the standard error, as part of
    the light of a receiver, above which there are to be more."""

    samples: int
    rays: int
    noise: float


def gather_near_hits(
    solution: PatchSolution,
    points: np.ndarray,
    normals: np.ndarray,
    seen: Gathered,
    near: NearHits,
    arriving: np.ndarray,
    direct: np.ndarray,
    settings: NearHitsSettings,
    seed: int,
    names: np.ndarray,
) -> Generator[float, None, tuple[np.ndarray, np.ndarray, int]]:
    """Irradiance (n, c) float32 of receivers that have `seen` their hemispheres, with what is `near` mended; the
    standard error (n,) that the choice of hits leaves in its brightest channel; and the rays it took.

    Parameters
    ----------
    points, normals : (n, 3) float32
    seen : Gathered
        By `gather` with the same `seed` and `names` (n,).
    near : NearHits
        Whose near hits to gather again.
    arriving : (n, c) float
        Irradiance as looked up.
    direct : (n, c) float
        Direct light at the receivers.
    """
    out, errors, spent = arriving.astype(np.float32), np.zeros(len(points)), 0
    block = max(1, BLOCK_ROWS // max(near.picks.shape[1] * settings.rays, 1))
    for start in range(0, len(near.which), block):
        part = near.only(slice(start, start + block))
        who = part.which
        work = _gather_block(
            solution,
            points[who],
            normals[who],
            seen.rows[who],
            part,
            arriving[who],
            direct[who],
            settings,
            seed,
            names[who],
        )
        low, high = start / len(near.which), (start + len(who)) / len(near.which)
        out[who], errors[who], rays = yield from shared_progress(work, low, high)
        spent += rays
    return out, errors, spent


def _gather_block(solution, points, normals, seen, near, arriving, direct, settings, seed, names):
    """The same for some receivers, all of which have near hits, in the table rows `seen` (n, N)."""
    samples = near.picks.shape[1]
    who = np.repeat(np.arange(len(points)), samples)
    directions = chosen_directions(normals, seen.shape[1], seed, names, near.picks).reshape(-1, 3)
    rows = np.take_along_axis(seen, near.picks, axis=1).ravel()
    places, facing, sound = _hit_again(solution, points[who], normals[who], directions, rows)
    who, rows = who[sound], rows[sound]
    places, facing = places[sound], facing[sound]
    name = (names[:, None] * samples + np.arange(samples)).ravel()[sound]
    work = gather(
        solution.tracer, solution.hits_to_rows, places, facing, settings.rays, solution.pool, seed + 1, names=name
    )
    again = yield from shared_progress(work, 0.0, 0.6)
    if solution.meet(again.rows):
        yield from solution.follow()
    alone = np.empty((0, 2), np.int32)
    work = direct_light(
        solution.tracer,
        solution.lights,
        places,
        facing,
        alone,
        solution.penumbra_rays,
        solution.pool,
        seed + 2,
        colors=solution.light_colors,
    )
    lit, shadow = yield from shared_progress(work, 0.6, 1.0)
    count, returned = _returning(solution, points[who], normals[who], places, again)
    table = solution.table()
    # Means over the samples of a receiver whose ray found its patch again.
    found = np.maximum(np.bincount(who, minlength=len(points)), 1)[:, None]
    reflectance, emitted = solution.reflectances[rows], solution.emitted[rows]
    far = again.irradiance(table) - returned
    differences = reflectance * (lit + far) + emitted - table[rows, :-1]
    known = _sums(who, differences, len(points)) / found
    squares = _sums(who, whole(differences) ** 2, len(points)) / found
    scatter = np.maximum(squares - whole(known) ** 2, 0).max(axis=1)
    own = _sums(who, reflectance * count, len(points)) / found
    weight = near.shares[:, None]
    mended = (arriving + weight * (known + own * direct)) / (1 - weight * own)
    errors = weight[:, 0] * np.sqrt(scatter / found[:, 0])
    return np.maximum(mended, 0).astype(np.float32), errors, shadow + settings.rays * len(who) + len(places)


def find_near_hits(solution: PatchSolution, points: np.ndarray, seen: Gathered, samples: int) -> NearHits:
    """The near hits of all receivers at `points` (n, 3) that have `seen` their hemispheres, `samples` of each."""
    patches = solution.patches
    middles, sides = patches.points.mean(axis=1), np.sqrt(patches.areas).astype(np.float32)
    candidates = np.flatnonzero(seen.distances < 1.5 * NEAR * sides.max())
    which, shares, picks = [], [], []
    rays = seen.rows.shape[1]
    block = max(1, CHUNK_RAYS // rays)
    for start in range(0, len(candidates), block):
        part = candidates[start : start + block]
        rows = seen.rows[part]
        on_patch = rows < 2 * patches.count
        patch = np.where(on_patch, rows % patches.count, 0)
        apart = middles[patch] - points[part, None]
        near = on_patch & (np.einsum("nri,nri->nr", apart, apart) < (NEAR * sides[patch]) ** 2)
        counts = near.sum(axis=1)
        enough = counts >= max(LEAST_SHARE * rays, 1)
        order = np.argsort(~near[enough], axis=1, kind="stable")
        marks = ((np.arange(samples) + 0.5) / samples * counts[enough, None]).astype(int)
        which.append(part[enough])
        shares.append(counts[enough] / rays)
        picks.append(np.take_along_axis(order, marks, axis=1))
    if not which:
        return NearHits(candidates, np.empty(0), np.empty((0, samples), int))
    return NearHits(np.concatenate(which), np.concatenate(shares), np.concatenate(picks))


def _hit_again(solution, points, normals, directions, rows):
    """Where rays (n, 3) hit, the normals there towards where they come from, and whether that is on the patch that they
    were looked up on and in sight: behind a veil it may not be."""
    starts = (points + np.float32(OFFSET) * normals).astype(np.float32)
    places, facing = np.empty_like(starts), np.empty_like(starts)
    sound = np.empty(len(starts), bool)

    def work(start: int, stop: int) -> None:
        along = directions[start:stop]
        hits = solution.tracer.closest(starts[start:stop], along)
        sound[start:stop] = solution.hits_to_rows.look_up(hits, along) == rows[start:stop]
        sound[start:stop] &= hits["primID"] >= 0
        towards = hits["Ng"] / np.maximum(np.linalg.norm(hits["Ng"], axis=1, keepdims=True), np.float32(1e-20))
        towards = np.where(np.einsum("ij,ij->i", towards, along)[:, None] > 0, -towards, towards)
        places[start:stop] = starts[start:stop] + hits["tfar"][:, None] * along
        facing[start:stop] = towards
        # In an acute corner a place lifted off one wall may end up behind the other: back to the receiver it must see.
        lifted = places[start:stop] + np.float32(OFFSET) * towards
        sound[start:stop] &= solution.tracer.visibility(lifted, starts[start:stop] - lifted) > 0

    solution.pool.run(work, len(starts), CHUNK_RAYS)
    return places, facing, sound


def _returning(solution, points, normals, places, again):
    """Of each second gather: mean reflectance (n, c) over the rays that return to where the receiver stands, zero for
    the others, and the mean (n, c) of what these look up but for emission."""
    patches = solution.patches
    middles, sides = patches.points.mean(axis=1), np.sqrt(patches.areas).astype(np.float32)
    distance = np.linalg.norm(places - points, axis=1)
    count, rays = again.rows.shape
    reflected, looked_up = (np.zeros((count, solution.columns), np.float32) for _ in range(2))
    table = solution.table()[:, :-1]
    reflectances, emitted = solution.reflectances, solution.emitted
    block = max(1, CHUNK_RAYS // rays)
    for start in range(0, count, block):
        part = slice(start, start + block)
        rows = again.rows[part]
        on_patch = rows < 2 * patches.count
        patch = np.where(on_patch, rows % patches.count, 0)
        apart = middles[patch] - points[part, None]
        own = on_patch & (np.einsum("nri,nri->nr", apart, apart) < sides[patch] ** 2)
        own &= distance[part, None] < 0.5 * sides[patch]
        front = np.where(rows < patches.count, 1, -1)
        own &= front * np.einsum("nri,ni->nr", patches.normals[patch, 0], normals[part]) > ALIKE
        who, ray = np.nonzero(own)
        row = rows[who, ray]
        reflected[part] = _sums(who, reflectances[row], len(rows)) / rays
        looked_up[part] = _sums(who, table[row] - emitted[row], len(rows)) / rays
    return reflected, looked_up


def _sums(groups: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, c) sums of values (n, c) by group."""
    columns = range(values.shape[1])
    return np.stack([np.bincount(groups, weights=values[:, i], minlength=count) for i in columns], axis=1)
