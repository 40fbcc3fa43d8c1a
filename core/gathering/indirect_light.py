"""Indirect light at receivers: hemispheres at a few nodes, interpolation to all others.

Interreflected light is smooth nearly everywhere, so it is gathered at coarse nodes first, and at finer ones only where
it has been seen to change: where neighbors differ, where a finer node disagrees with what was interpolated for it, or
where something stands near. This is the survey's adaptive subdivision (ccl.5) on receivers instead of patches, and the
economy of irradiance caching (Ward, Rubinstein, Clear 1988) without its search.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from math import inf

import numpy as np

from ..discretization.nodes import NodeLevel, build_levels, neighbor_table
from ..form_factors.cached_hemispheres import gather
from ..light_groups import whole
from ..progress import shared_progress
from ..solvers.patch_solution import BURIED, PatchSolution
from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .closeup import Closeup
from .contacts import find_contacts, find_ends
from .interpolation import interpolate
from .near_field import near_field
from .near_hits import NearHitsSettings
from .receivers import Receivers

#: Nodes are refined where something stands nearer than this many spacings: light changes over the distance to what
#: sends it.
NEAR = 0.4

#: Where so near a thing gives more than this many times the mean light, every receiver is asked: behind a window's
#: frame, or in the shade of a lamp, the light changes within the finest cluster, and by more than there is elsewhere.
BRIGHT = 4.0
#: Clusters of the finest level with at most so many receivers are done to the last one where something stands near: a
#: shelf's back edge is one cluster wide, and its two sides are lit differently.
FEW = 4

#: Rays whose hits are kept at a time: 8 MB for their rows, and as much again while these are looked up.
BLOCK_RAYS = 2_000_000

#: With no more receivers than this, nodes save nothing: gather everywhere.
DENSE_RECEIVERS = 1200


@dataclass(frozen=True)
class IndirectSettings:
    """How finely to gather: rays per hemisphere, spacing of the coarse nodes in sides of a patch, levels of refinement,
    the relative difference above which a level is refined, the part of a receiver's light that a single ray may carry
    before its neighborhood is looked at closely, and how finely to look at what is near."""

    rays: int
    spacing: float
    levels: int
    tolerance: float
    detail: float
    near: NearHitsSettings


@dataclass
class IndirectLight:
    """Irradiance (r, c) from patches and sky, which receivers are buried, what it took, what was found to be worth a
    close look and by which receivers (r, k) around each, and whether refinement ended before it was done."""

    irradiance: np.ndarray
    buried: np.ndarray
    nodes: int
    rays: int
    closeup: Closeup
    around: Callable[[np.ndarray], np.ndarray]
    is_cut_short: bool = False


#: Height above a receiver edge, in sizes of the faces around its ends, up to which what stands there does not cut it,
#: and the most of it in lengths of the edge: the short side of a long floor passes no step.
LIFT = 0.02
MOST_LIFT = 0.05


def uncut_edges(tracer: Tracer, receivers: Receivers, pool: RayPool) -> np.ndarray:
    """(e,) bool: receiver edges along which nothing stands on the surface. Others cross a wall."""
    edges = receivers.edges
    free = np.ones(len(edges), bool)

    def work(start: int, stop: int) -> None:
        one, other = edges[start:stop, 0], edges[start:stop, 1]
        lengths = np.linalg.norm(receivers.points[other] - receivers.points[one], axis=1)
        lift = np.float32(LIFT) * (receivers.sizes[one] + receivers.sizes[other])
        lift = np.minimum(lift, np.float32(MOST_LIFT) * lengths) + np.float32(4 * OFFSET)
        begin = receivers.points[one] + lift[:, None] * receivers.normals[one]
        segment = receivers.points[other] + lift[:, None] * receivers.normals[other] - begin
        free[start:stop] = tracer.visibility(begin, segment, 1.0) > 0

    pool.run(work, len(edges), CHUNK_RAYS)
    return free


class _Gatherer:
    """Traces hemispheres of receivers, each at most once, and keeps their values."""

    def __init__(
        self, solution: PatchSolution, receivers: Receivers, direct: np.ndarray, settings: IndirectSettings, seed: int
    ):
        self.solution, self.receivers, self.direct, self.seed = solution, receivers, direct, seed
        self.settings, self.rays = settings, settings.rays
        count = len(receivers)
        self.closeup = Closeup(solution, count, settings.detail)
        self.values = np.zeros((count, solution.columns), np.float32)
        self.traced = np.zeros(count, bool)
        self.dark = np.zeros(count, np.float32)
        self.distances = np.zeros(count, np.float32)
        self.spent = 0

    def trace(self, who: np.ndarray, around: np.ndarray) -> Generator[float, None, None]:
        """Gather at receivers `who` (n,) that are not traced yet, in blocks of bounded memory; `around` (n, k) are
        receivers near each, which know what is bright there."""
        new = ~self.traced[who]
        who, around = who[new], around[new]
        block = max(1, BLOCK_RAYS // self.rays)
        solution = self.solution
        for start in range(0, len(who), block):
            part = who[start : start + block]
            points, normals = self.receivers.points[part], self.receivers.normals[part]
            work = gather(
                solution.tracer, solution.hits_to_rows, points, normals, self.rays, solution.pool, self.seed, names=part
            )
            first, second, third, last = np.linspace(start, start + len(part), 4) / len(who)
            seen = yield from shared_progress(work, first, second)
            if solution.meet(seen.rows):
                yield from solution.follow()
            self.dark[part] = solution.dark_rows()[seen.rows].mean(axis=1)
            self.distances[part] = seen.distances
            self.traced[part] = True
            self.spent += self.rays * len(part)
            self.values[part] = seen.irradiance(solution.looked_up())
            self.closeup.note(part, points, normals, seen.rows, self.values[part], self.seed)
            marked = self.closeup.marked(part, points, normals, around[start : start + block])
            work = self.closeup.values(points, normals, seen.rows, marked, self.values[part], part, self.seed)
            self.values[part], closer = yield from shared_progress(work, second, third)
            if solution.exchange is not None:
                work = solution.exchange.irradiance(points, normals, part)
                self.values[part] += yield from shared_progress(work, second, third)
            work = near_field(
                solution,
                points,
                normals,
                seen,
                self.values[part],
                self.direct[part],
                self.settings.near,
                self.seed,
                part,
            )
            self.values[part], nearer = yield from shared_progress(work, third, last)
            self.spent += closer + nearer

    @property
    def count(self) -> int:
        """Receivers traced."""
        return int(self.traced.sum())


def indirect_light(
    solution: PatchSolution,
    receivers: Receivers,
    edges: np.ndarray,
    direct: np.ndarray,
    settings: IndirectSettings,
    seed: int,
    deadline: float = inf,
) -> Generator[float, None, IndirectLight]:
    """Irradiance at all receivers from the solved patches; yields the share done.

    Parameters
    ----------
    edges : (e, 2) int32
        Receiver edges that cross no wall.
    direct : (r, c) float
        Direct light of the receivers.
    deadline : float
        Of `time.perf_counter`; no further level of refinement is started after it.
    """
    gatherer = _Gatherer(solution, receivers, direct, settings, seed)
    count = len(receivers)
    if count <= DENSE_RECEIVERS:
        near = _two_rings(neighbor_table(count, edges))
        yield from gatherer.trace(np.arange(count), near)
        buried = gatherer.dark > BURIED
        return IndirectLight(gatherer.values, buried, count, gatherer.spent, gatherer.closeup, near.__getitem__)
    spacing = solution.patches.spacing * settings.spacing
    contacts = find_contacts(solution.tracer, receivers, solution.pool)
    levels = build_levels(receivers.points, receivers.normals, edges, spacing, settings.levels + 1, contacts)
    values, valid, is_cut_short = yield from _refine(gatherer, levels, contacts, settings, deadline)
    finest = levels[-1]
    beside = _joined(finest)

    def around(who: np.ndarray) -> np.ndarray:
        return finest.nodes[_two_rings(beside, finest.clusters[who])]

    if not is_cut_short:
        left = _left_to_see(gatherer, finest, contacts, values, valid)
        yield from gatherer.trace(left, around(left))
    irradiance, found = interpolate(
        receivers.points, receivers.normals, np.arange(count), finest.clusters, finest, values, valid, solution.pool
    )
    _keep_own(irradiance, gatherer, 0.5 * settings.tolerance)
    buried = ~(found & valid[finest.clusters]) | (gatherer.dark > BURIED)
    return IndirectLight(irradiance, buried, gatherer.count, gatherer.spent, gatherer.closeup, around, is_cut_short)


def _left_to_see(
    gatherer: _Gatherer, finest: NodeLevel, contacts: np.ndarray, values: np.ndarray, valid: np.ndarray
) -> np.ndarray:
    """Receivers (n,) of clusters that are still too wide for what stands near, where they are few or much brighter than
    most; and ends of contacts."""
    nodes = finest.nodes
    near = gatherer.traced[nodes] & (gatherer.distances[nodes] < NEAR * finest.spacing)
    few = np.bincount(finest.clusters, minlength=len(nodes)) <= FEW
    wanted = near & few & ~contacts[nodes]
    if valid.any():
        light = whole(values)
        bright = (light > BRIGHT * light[valid].mean(axis=0)).any(axis=1)
        wanted |= _with_neighbors(finest, bright & near & valid)
    return np.nonzero(wanted[finest.clusters] | find_ends(gatherer.receivers, contacts))[0]


def _keep_own(irradiance: np.ndarray, gatherer: _Gatherer, tolerance: float) -> None:
    """Give traced receivers their own value back where the fit through their neighbors departs from it.

    Where they agree the fit stays: it has less noise than any single hemisphere.
    """
    traced = np.nonzero(gatherer.traced)[0]
    own, light = gatherer.values[traced], whole(gatherer.values)[traced]
    scale = np.maximum(light, 0.5 * light.mean(axis=0))
    apart = (np.abs(whole(irradiance)[traced] - light) > tolerance * scale).any(axis=1)
    irradiance[traced[apart]] = own[apart]


def _refine(
    gatherer: _Gatherer, levels: list[NodeLevel], contacts: np.ndarray, settings: IndirectSettings, deadline: float
):
    """Values (k, c) and validity (k,) of all nodes of the finest level, and whether time ran out."""
    receivers = gatherer.receivers
    level = levels[0]
    share = 1 / len(levels)
    yield from shared_progress(gatherer.trace(level.nodes, level.nodes[_two_rings(_joined(level))]), 0.0, share)
    values = gatherer.values[level.nodes]
    valid = gatherer.dark[level.nodes] <= BURIED
    rough = _contrast(level, whole(values), valid) > settings.tolerance
    # A contact within one cell or two has too few around it to see that it changes.
    fewer = (level.neighbors != np.arange(len(level.nodes))[:, None]).sum(axis=1) < 2
    rough |= contacts[level.nodes] & fewer
    for depth, finer in enumerate(levels[1:], 1):
        # At a contact something is near at every level; there it is the change along the edge that counts.
        near = (gatherer.distances[level.nodes] < NEAR * level.spacing) & ~contacts[level.nodes]
        wanted = _with_neighbors(level, rough | ~valid) | (near & gatherer.traced[level.nodes])
        parents = level.clusters
        guess, found = interpolate(
            receivers.points,
            receivers.normals,
            finer.nodes,
            parents,
            level,
            values,
            valid,
            gatherer.solution.pool,
        )
        is_late = time.perf_counter() > deadline
        chosen = np.flatnonzero((wanted[parents] & (not is_late)) | ~found)
        above = level.nodes[np.concatenate([parents[chosen, None], level.neighbors[parents[chosen]]], axis=1)]
        around = np.concatenate([finer.nodes[_two_rings(_joined(finer), chosen)], above], axis=1)
        yield from shared_progress(gatherer.trace(finer.nodes[chosen], around), depth * share, (depth + 1) * share)
        known = gatherer.traced[finer.nodes]
        values = np.where(known[:, None], gatherer.values[finer.nodes], guess)
        valid = np.where(known, gatherer.dark[finer.nodes] <= BURIED, found)
        light = whole(values)
        scale = np.maximum(light, 0.5 * light[valid].mean(axis=0) if valid.any() else 1)
        error = (np.abs(light - whole(guess)) / np.maximum(scale, 1e-30)).max(axis=1)
        rough = known & found & (error > settings.tolerance)
        level = finer
    return values, valid, time.perf_counter() > deadline


def _joined(level: NodeLevel) -> np.ndarray:
    """(k, n) all nodes joined to each: contacts see the same things as the rest."""
    return neighbor_table(len(level.nodes), level.edges)


def _two_rings(neighbors: np.ndarray, who: np.ndarray | None = None) -> np.ndarray:
    """Neighbors of the neighbors (n, k * k) of items `who` (n,), all by default, by the table (m, k) of neighbors."""
    near = neighbors if who is None else neighbors[who]
    return neighbors[near].reshape(len(near), neighbors.shape[1] ** 2)


def _contrast(level: NodeLevel, values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Largest relative difference (k,) between a node and those around it."""
    around = level.neighbors
    usable = valid[around]
    low = np.where(usable[..., None], values[around], values[:, None]).min(axis=1)
    high = np.where(usable[..., None], values[around], values[:, None]).max(axis=1)
    scale = np.maximum(values, 0.5 * values[valid].mean(axis=0) if valid.any() else 1)
    spread = np.maximum(high, values) - np.minimum(low, values)
    return (spread / np.maximum(scale, 1e-30)).max(axis=1)


def _with_neighbors(level: NodeLevel, marked: np.ndarray) -> np.ndarray:
    return marked | marked[level.neighbors].any(axis=1)
