"""Direct light at receivers: closed-form irradiance times visibility sampled by rays.

Scouts go to the middle and the rim of every light from everywhere. Where they disagree, or where a mesh neighbor sees a
different share, the receiver may lie in a penumbra and gets many rays. Measured in the study (section 2): 4 rays and 64
in the penumbra err as little as 64 everywhere, at a fifth of the rays.

With many lights a receiver does not ask all of them: the strongest, unoccluded, are asked for certain, and the rest are
drawn by their share, so that the cost per receiver is bounded and the expected value is right.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ..form_factors.cached_hemispheres import turns_of
from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from . import Light
from .table import LightTable

#: Lights that a receiver asks at most, where it is not told another number.
MAX_LIGHTS = 24

#: A light whose unoccluded irradiance is below this part of the receiver's sum is left to chance.
SURE_SHARE = 0.02

#: Scouts whose ways differ by more than this factor say little: most of the light then comes from near one of them, or
#: from between.
CLOSE = 3.0

#: Pairs of receiver and light looked at in one block when lights are chosen.
CHOICE_BLOCK = 2_000_000


@dataclass(frozen=True)
class LightChoice:
    """Which receivers ask one light: their numbers (k,), or None for all, and the factors (k,) that make up for lights
    not asked."""

    receivers: np.ndarray | None
    factors: np.ndarray | None


def choose_lights(
    lights: Sequence[Light], points: np.ndarray, normals: np.ndarray, seed: int, most: int = MAX_LIGHTS
) -> list[LightChoice]:
    """For every light the receivers that ask it; all of them while there are at most `most` lights.

    Shirley, Wang, Zimmerman 1996, "Monte Carlo Techniques for Direct Lighting Calculations": probability by unoccluded
    contribution. Here lights above `SURE_SHARE` are asked for certain and the rest by systematic sampling.
    """
    if len(lights) <= most:
        return [LightChoice(None, None)] * len(lights)
    chosen: list[list[np.ndarray]] = [[] for _ in lights]
    factors: list[list[np.ndarray]] = [[] for _ in lights]
    table = LightTable(lights)
    block = max(1, CHOICE_BLOCK // len(lights))
    luck = turns_of(len(points), seed + 1) / np.float32(2 * np.pi)
    for start in range(0, len(points), block):
        stop = min(start + block, len(points))
        asked, factor = _choose(table.rates(points[start:stop], normals[start:stop]), luck[start:stop], most)
        which, who = np.nonzero(asked.T)
        bounds = np.searchsorted(which, np.arange(len(lights) + 1))
        gains = factor.T[which, who]
        for column in range(len(lights)):
            mine = slice(bounds[column], bounds[column + 1])
            chosen[column].append(who[mine] + start)
            factors[column].append(gains[mine])
    return [LightChoice(np.concatenate(c), np.concatenate(f)) for c, f in zip(chosen, factors, strict=True)]


def _choose(strength: np.ndarray, luck: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Which lights (n, L) bool each receiver asks, and the factor by which the answer counts."""
    total = strength.sum(axis=1, keepdims=True)
    order = np.argsort(-strength, axis=1, kind="stable")
    ranked = np.take_along_axis(strength, order, axis=1)
    places = np.arange(strength.shape[1])
    sure = (ranked > SURE_SHARE * total) & (places < most // 2)
    rest = np.where(sure, 0, ranked)
    left = rest.sum(axis=1, keepdims=True)
    draws = most - most // 2
    # Systematic sampling: marks at equal steps of the cumulated strength; a light is drawn once per mark it covers.
    upto = np.cumsum(rest, axis=1) / np.maximum(left, 1e-30) * draws
    marks = np.floor(upto + luck[:, None])
    hits = np.diff(marks, axis=1, prepend=np.floor(luck)[:, None])
    hits[rest <= 0] = 0
    gain = np.where(hits > 0, hits * left / np.maximum(rest * draws, 1e-30), 0)
    factor = np.empty_like(strength)
    np.put_along_axis(factor, order, np.where(sure, 1, gain).astype(np.float32), axis=1)
    return factor > 0, factor


def direct_light(
    tracer: Tracer,
    lights: Sequence[Light],
    points: np.ndarray,
    normals: np.ndarray,
    edges: np.ndarray,
    penumbra_rays: int,
    pool: RayPool,
    seed: int = 0,
    everywhere: bool = False,
    most: int = MAX_LIGHTS,
    colors: np.ndarray | None = None,
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Irradiance (n, c) float32 from all lights at n oriented points, and the rays it took.

    Parameters
    ----------
    lights : sequence of Light
        In the unit frame.
    points, normals : (n, 3) float32
    edges : (e, 2) int
        Neighbors among the points, by which penumbras are found.
    penumbra_rays : int
        Rays per light where its visibility is in doubt.
    everywhere : bool
        Send the rays of a penumbra from all points, and no scouts.
    most : int
        Lights that a point asks at most.
    colors : (l, c) float or None
        What counts for the color of each light, c being 3 by default: `core.light_groups` has more columns.
    """
    if colors is None:
        colors = np.array([light.color for light in lights]).reshape(-1, 3)
    colors = colors.astype(np.float32)
    out = np.zeros((len(points), colors.shape[1]), np.float32)
    rays = 0
    if not len(points) or not len(lights):
        return out, rays
    # Lifted for the closed forms too: a vertex of an emissive face would see that face on all sides, or not at all, by
    # the rounding of its own position.
    points = (points + np.float32(OFFSET) * normals).astype(np.float32)
    choices = choose_lights(lights, points, normals, seed, most)
    for number, (light, choice) in enumerate(zip(lights, choices, strict=True)):
        lit, strength = _unoccluded(light, choice, points, normals, pool)
        if not len(lit):
            continue
        starts = points[lit]
        seen = np.empty(len(lit), np.float32)
        close = np.empty(len(lit), bool)
        if light.is_sharp or not everywhere:
            scouts = _visibility(tracer, light, starts, normals[lit], 0, pool, seen, close)
            for done in scouts:
                yield (number + 0.5 * done) / len(lights)
            rays += light.scout(starts[:1]).shape[1] * len(lit)
        if not light.is_sharp:
            doubtful = np.arange(len(lit)) if everywhere else _penumbra(seen, close, lit, edges, len(points))
            more = np.empty(len(doubtful), np.float32)
            turn = _visibility(tracer, light, starts[doubtful], normals[lit[doubtful]], penumbra_rays, pool, more)
            for done in turn:
                yield (number + 0.5 + 0.5 * done) / len(lights)
            seen[doubtful] = more
            rays += penumbra_rays * len(doubtful)
        out[lit] += (strength * seen)[:, None] * colors[number]
    return out, rays


def _unoccluded(light: Light, choice: LightChoice, points, normals, pool: RayPool) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the points that the light can reach, and what it gives them per unit of its color."""
    asked = choice.receivers
    count = len(points) if asked is None else len(asked)
    strength = np.empty(count, np.float32)

    def work(start: int, stop: int) -> None:
        who = slice(start, stop) if asked is None else asked[start:stop]
        strength[start:stop] = light.geometry(points[who], normals[who])

    pool.run(work, count, CHUNK_RAYS)
    if choice.factors is not None:
        strength *= choice.factors
    lit = np.nonzero(strength > 0)[0]
    return (lit if asked is None else asked[lit]), strength[lit]


def _visibility(tracer, light, starts, normals, rays, pool, out, close=None) -> Generator[float, None, None]:
    """Fill `out` (n,) with the share of the light that each start sees; 0 rays stands for the light's scouts, which
    also fill `close` (n,) with whether they go to places of the light at very different distances."""

    def work(start: int, stop: int) -> None:
        if rays:
            segments, weights = light.aim(starts[start:stop], normals[start:stop], rays)
        else:
            segments, weights = light.scout(starts[start:stop]), None
        count = segments.shape[1]
        origins = np.repeat(starts[start:stop], count, axis=0)
        passed = tracer.visibility(origins, np.ascontiguousarray(segments.reshape(-1, 3), dtype=np.float32))
        passed = passed.reshape(-1, count)
        if weights is None:
            square = np.einsum("nci,nci->nc", segments, segments)
            close[start:stop] = square.max(axis=1) > CLOSE**2 * square.min(axis=1)
            out[start:stop] = passed.mean(axis=1)
            return
        total = weights.sum(axis=1)
        share = (weights * passed).sum(axis=1)
        # No sampled place contributes, only a sliver of the light does: nothing to weigh by, so count the rays.
        out[start:stop] = np.where(total > 0, share / np.maximum(total, 1e-300), passed.mean(axis=1))

    yield from pool.chunks(work, len(starts), max(1, CHUNK_RAYS // max(rays, 8)))


def _penumbra(seen: np.ndarray, close: np.ndarray, lit: np.ndarray, edges: np.ndarray, count: int) -> np.ndarray:
    """Which of the lit points see the light in part, see another share of it than a neighbor, or are `close` to it."""
    doubt = (seen > 0) & (seen < 1) | close
    if len(edges):
        everywhere = np.full(count, -1, np.float32)
        everywhere[lit] = seen
        one, other = everywhere[edges[:, 0]], everywhere[edges[:, 1]]
        apart = (one >= 0) & (other >= 0) & (one != other)
        marked = np.zeros(count, bool)
        marked[edges[apart].ravel()] = True
        doubt |= marked[lit]
    return np.nonzero(doubt)[0]
