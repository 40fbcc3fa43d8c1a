"""Indirect light at receivers: hemispheres at a few nodes, interpolation to all others.

Interreflected light is smooth nearly everywhere, so it is gathered at coarse nodes first, and at finer ones only where
it has been seen to change: where neighbors differ, where a finer node disagrees with what was interpolated for it, or
where something stands near. This is the survey's adaptive subdivision (ccl.5) on receivers instead of patches, and the
economy of irradiance caching (Ward, Rubinstein, Clear 1988) without its search.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import dataclass
from math import inf

import numpy as np

from ..discretization.nodes import NodeLevel, build_levels
from ..form_factors.cached_hemispheres import gather
from ..progress import shared_progress
from ..solvers.patch_solution import BURIED, PatchSolution
from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .contacts import find_contacts, find_ends
from .interpolation import interpolate
from .near_field import NearFieldSettings, near_field
from .receivers import Receivers

#: Nodes are refined where something stands nearer than this many spacings: light changes over the distance to what
#: sends it.
NEAR = 0.4

#: Clusters of the finest level with at most so many receivers are done to the last one where something stands near: a
#: shelf's back edge is one cluster wide, and its two sides are lit differently.
FEW = 4

#: With no more receivers than this, nodes save nothing: gather everywhere.
DENSE_RECEIVERS = 1200


@dataclass(frozen=True)
class IndirectSettings:
    """How finely to gather: rays per hemisphere, spacing of the coarse nodes in sides of a patch, levels of refinement,
    the relative difference above which a level is refined, and how finely to look at what is near."""

    rays: int
    spacing: float
    levels: int
    tolerance: float
    near: NearFieldSettings


@dataclass
class IndirectLight:
    """Irradiance (r, 3) from patches and sky, which receivers are buried, what it took, and whether
    refinement ended before it was done."""

    irradiance: np.ndarray
    buried: np.ndarray
    nodes: int
    rays: int
    is_cut_short: bool = False


def uncut_edges(tracer: Tracer, receivers: Receivers, pool: RayPool) -> np.ndarray:
    """(e,) bool: receiver edges along which nothing stands on the surface. Others cross a wall."""
    edges = receivers.edges
    free = np.ones(len(edges), bool)

    def work(start: int, stop: int) -> None:
        one, other = edges[start:stop, 0], edges[start:stop, 1]
        lift = np.float32(0.02) * (receivers.sizes[one] + receivers.sizes[other]) + np.float32(4 * OFFSET)
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
        self.settings = settings
        self.rays_traced = 0
        count = len(receivers)
        self.values = np.zeros((count, 3), np.float32)
        self.traced = np.zeros(count, bool)
        self.dark = np.zeros(count, np.float32)
        self.distances = np.zeros(count, np.float32)

    def trace(self, who: np.ndarray) -> Generator[float, None, None]:
        """Gather at receivers `who` (n,) that are not traced yet, in blocks of bounded memory."""
        who = who[~self.traced[who]]
        rays = self.settings.rays
        block = max(1, 4_000_000 // rays)
        solution, receivers = self.solution, self.receivers
        for start in range(0, len(who), block):
            part = who[start : start + block]
            work = gather(
                solution.tracer,
                solution.hits_to_rows,
                receivers.points[part],
                receivers.normals[part],
                rays,
                solution.pool,
                self.seed,
                names=part,
            )
            begin, end = start / len(who), (start + len(part)) / len(who)
            seen = yield from shared_progress(work, begin, 0.3 * begin + 0.7 * end)
            if solution.meet(seen.rows):
                yield from solution.follow()
            work = near_field(
                solution,
                receivers.points[part],
                receivers.normals[part],
                seen,
                self.direct[part],
                self.settings.near,
                self.seed,
                part,
            )
            self.values[part], spent = yield from shared_progress(work, 0.3 * begin + 0.7 * end, end)
            self.rays_traced += spent + rays * len(part)
            self.dark[part] = solution.dark_rows()[seen.rows].mean(axis=1)
            self.distances[part] = seen.distances
            self.traced[part] = True

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
    direct : (r, 3) float
        Direct light of the receivers.
    deadline : float
        Of `time.perf_counter`; no further level of refinement is started after it.
    """
    gatherer = _Gatherer(solution, receivers, direct, settings, seed)
    count = len(receivers)
    if count <= DENSE_RECEIVERS:
        yield from gatherer.trace(np.arange(count))
        return IndirectLight(gatherer.values, gatherer.dark > BURIED, count, gatherer.rays_traced)
    spacing = solution.patches.spacing * settings.spacing
    contacts = find_contacts(solution.tracer, receivers, solution.pool)
    levels = build_levels(receivers.points, receivers.normals, edges, spacing, settings.levels + 1, contacts)
    values, valid, is_cut_short = yield from _refine(gatherer, levels, contacts, settings, deadline)
    finest = levels[-1]
    if not is_cut_short:
        yield from gatherer.trace(_left_to_see(gatherer, finest, contacts))
    irradiance, found = interpolate(
        receivers.points, receivers.normals, np.arange(count), finest.clusters, finest, values, valid, solution.pool
    )
    _keep_own(irradiance, gatherer, 0.5 * settings.tolerance)
    buried = ~(found & valid[finest.clusters]) | (gatherer.dark > BURIED)
    return IndirectLight(irradiance, buried, gatherer.count, gatherer.rays_traced, is_cut_short)


def _left_to_see(gatherer: _Gatherer, finest: NodeLevel, contacts: np.ndarray) -> np.ndarray:
    """Receivers of clusters that are still too wide for what stands near, where that is few; and ends of contacts."""
    nodes = finest.nodes
    wide = (gatherer.distances[nodes] < NEAR * finest.spacing) & ~contacts[nodes]
    wide &= gatherer.traced[nodes] & (np.bincount(finest.clusters, minlength=len(nodes)) <= FEW)
    return np.nonzero(wide[finest.clusters] | find_ends(gatherer.receivers, contacts))[0]


def _keep_own(irradiance: np.ndarray, gatherer: _Gatherer, tolerance: float) -> None:
    """Give traced receivers their own value back where the fit through their neighbors departs from it.

    Where they agree the fit stays: it has less noise than any single hemisphere.
    """
    traced = np.nonzero(gatherer.traced)[0]
    own = gatherer.values[traced]
    scale = np.maximum(own, 0.5 * own.mean(axis=0))
    apart = (np.abs(irradiance[traced] - own) > tolerance * scale).any(axis=1)
    irradiance[traced[apart]] = own[apart]


def _refine(
    gatherer: _Gatherer, levels: list[NodeLevel], contacts: np.ndarray, settings: IndirectSettings, deadline: float
):
    """Values (k, 3) and validity (k,) of all nodes of the finest level, and whether time ran out."""
    receivers = gatherer.receivers
    level = levels[0]
    share = 1 / len(levels)
    yield from shared_progress(gatherer.trace(level.nodes), 0.0, share)
    values = gatherer.values[level.nodes]
    valid = gatherer.dark[level.nodes] <= BURIED
    rough = _contrast(level, values, valid) > settings.tolerance
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
        chosen = finer.nodes[(wanted[parents] & (not is_late)) | ~found]
        yield from shared_progress(gatherer.trace(chosen), depth * share, (depth + 1) * share)
        known = gatherer.traced[finer.nodes]
        values = np.where(known[:, None], gatherer.values[finer.nodes], guess)
        valid = np.where(known, gatherer.dark[finer.nodes] <= BURIED, found)
        scale = np.maximum(values, 0.5 * values[valid].mean(axis=0) if valid.any() else 1)
        error = (np.abs(values - guess) / np.maximum(scale, 1e-30)).max(axis=1)
        rough = known & found & (error > settings.tolerance)
        level = finer
    return values, valid, time.perf_counter() > deadline


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
