"""The near field: patches nearer than they are wide are not good enough, and are asked again by rays.

Two ways, each where it is better. Beside an edge about half of the hemisphere is near: those hits are gathered again
(`near_hits`), with little noise. In a gap, where nearly all that is seen is near, what is near is dark or lit by what
is near in turn: there paths are followed until they are out of it (`near_paths`), whose noise is as small as the light
in a gap.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ..form_factors.cached_hemispheres import Gathered
from ..light_groups import whole
from ..progress import shared_progress
from ..solvers.patch_solution import PatchSolution
from .near_hits import NearHitsSettings, find_near_hits, gather_near_hits
from .near_paths import follow_paths, paths_for

#: Share of near hits from which a receiver counts as standing in a gap. In the corner of a room it is three quarters.
GAP = 0.85

#: By what factor near hits grow in number where they are too few.
MORE = 8

#: Light of a receiver, as part of the mean, below which its noise matters no more than there.
DIM = 0.25


def near_field(
    solution: PatchSolution,
    points: np.ndarray,
    normals: np.ndarray,
    seen: Gathered,
    arriving: np.ndarray,
    direct: np.ndarray,
    settings: NearHitsSettings,
    seed: int,
    names: np.ndarray,
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Irradiance (n, c) of receivers whose `arriving` (n, c) light has been looked up, with what is near asked again;
    and the rays it took. Parameters as of `gather_near_hits`."""
    near = find_near_hits(solution, points, seen, settings.samples)
    in_gap = near.shares > GAP
    beside = near.only(~in_gap)
    work = gather_near_hits(solution, points, normals, seen, beside, arriving, direct, settings, seed, names)
    mended, errors, spent = yield from shared_progress(work, 0.0, 0.4)
    level = whole(arriving).max(axis=1)
    # Where the edge of a shadow is near, a few hits lie on either side by chance.
    noisy = np.flatnonzero(errors > settings.noise * np.maximum(level, DIM * level.mean() if len(level) else 0))
    if len(noisy):
        those = Gathered(seen.rows[noisy], seen.distances[noisy])
        more = find_near_hits(solution, points[noisy], those, MORE * settings.samples)
        work = gather_near_hits(
            solution,
            points[noisy],
            normals[noisy],
            those,
            more,
            arriving[noisy],
            direct[noisy],
            replace(settings, samples=MORE * settings.samples),
            seed,
            names[noisy],
        )
        better, _, rays = yield from shared_progress(work, 0.4, 0.6)
        mended = mended.copy()
        mended[noisy] = better
        spent += rays
    gaps = near.which[in_gap]
    if len(gaps):
        paths = paths_for(seen.rows.shape[1])
        work = follow_paths(solution, points[gaps], normals[gaps], paths, names[gaps], seed)
        added, rays = yield from shared_progress(work, 0.6, 1.0)
        mended = mended.copy()
        mended[gaps] = np.maximum(arriving[gaps] + added, 0)
        spent += rays
    return mended, spent
