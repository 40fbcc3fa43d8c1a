"""Interpolation of smooth values from nodes to receivers, along the surface of any mesh.

Each target fits a plane through the values of the node that stands for its cluster and those of the clusters joined to
it, weighted by distance and by likeness of the normal (moving least squares, Lancaster and Salkauskas 1981). A plane is
exact for linear change, so no steps show at the borders of clusters, and it damps the noise of single nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..discretization.nodes import NodeLevel
from ..frames import tangents
from ..visibility.embree import RayPool

#: Weight of the tie that keeps slopes finite where the nodes lie on a line or on one side; relative to the spacing.
RIDGE = 0.02

#: Squared distance, in spacings, below which a node weighs no more for being nearer. Large enough that a node's noise
#: is shared with its neighbors.
SOFTNESS = 0.3

#: How far a value may leave the range of the nodes it is fitted to, as part of that range. Light does go on rising
#: towards an edge beyond the last node.
OVERSHOOT = 0.5

#: Targets handled at a time: the temporaries of a block stay within a few MB.
BLOCK = 8192


def interpolate(
    points: np.ndarray,
    normals: np.ndarray,
    targets: np.ndarray,
    clusters: np.ndarray,
    level: NodeLevel,
    values: np.ndarray,
    valid: np.ndarray,
    pool: RayPool,
) -> tuple[np.ndarray, np.ndarray]:
    """Values at targets from the nodes of their own clusters and of those joined to them.

    Parameters
    ----------
    points, normals : (r, 3) float32
        Receivers.
    targets : (n,) int
        Receivers that want a value.
    clusters : (n,) int
        Cluster of `level` that each target belongs to.
    level : NodeLevel
        Its k nodes carry the values.
    values : (k, 3) float32
    valid : (k,) bool
        Nodes whose value may be used.
    pool : RayPool
        Threads for blocks of targets.

    Returns
    -------
    values : (n, 3) float32
    found : (n,) bool, False where no node is valid; the value is then 0
    """
    count = len(targets)
    out = np.zeros((count, values.shape[1]), np.float32)
    found = np.zeros(count, bool)
    # Of the neighbors only as many columns as any cluster has: most have four or five.
    alone = level.neighbors == np.arange(len(level.nodes))[:, None]
    around = level.neighbors[:, : max(1, int((~alone).sum(axis=1).max(initial=1)))]
    around = np.concatenate([np.arange(len(level.nodes), dtype=np.int32)[:, None], around], axis=1)
    stencil = _Stencil(
        around=around,
        usable=valid[around] & ~np.pad(alone[:, : around.shape[1] - 1], ((0, 0), (1, 0))),
        points=points[level.nodes],
        normals=normals[level.nodes],
        values=values,
        bounds=_bounds(around, values, valid),
        spacing=np.float32(level.spacing),
    )

    def work(start: int, stop: int) -> None:
        part = slice(start, stop)
        who = targets[part]
        out[part], found[part] = stencil.fit(points[who], normals[who], clusters[part])

    pool.run(work, count, BLOCK)
    return out, found


@dataclass(frozen=True)
class _Stencil:
    """The nodes (k, c) around each of k nodes, its own first, and what is known there."""

    around: np.ndarray
    usable: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    values: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    spacing: np.float32

    def fit(self, points: np.ndarray, normals: np.ndarray, clusters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (n, 3) of the planes fitted at n points in the given clusters, and where there were nodes."""
        around = self.around[clusters]
        apart = self.points.take(around, axis=0)
        apart -= points[:, None]
        apart /= self.spacing
        alike = np.einsum("nci,ni->nc", self.normals.take(around, axis=0), normals)
        np.maximum(alike, 0, out=alike)
        alike *= alike
        nearness = np.einsum("nci,nci->nc", apart, apart) + np.float32(SOFTNESS)
        weight = (alike / nearness) ** 2 * self.usable[clusters]
        one, other = tangents(normals)
        a = np.einsum("nci,ni->nc", apart, one)
        b = np.einsum("nci,ni->nc", apart, other)
        s0 = weight.sum(axis=1)
        found = s0 > 1e-12
        s0 = np.maximum(s0, np.float32(1e-12))
        wa, wb = weight * a, weight * b
        sa, sb = wa.sum(axis=1), wb.sum(axis=1)
        saa = np.einsum("nc,nc->n", wa, a) + np.float32(RIDGE) * s0
        sbb = np.einsum("nc,nc->n", wb, b) + np.float32(RIDGE) * s0
        sab = np.einsum("nc,nc->n", wa, b)
        # First row of the inverse of the 3 x 3 moments: what each node's value adds to the plane's value at the target.
        c0, c1, c2 = saa * sbb - sab * sab, sab * sb - sbb * sa, sab * sa - saa * sb
        scale = 1 / np.maximum(s0 * c0 + sa * c1 + sb * c2, np.float32(1e-20))
        share = weight * (c0 * scale)[:, None] + wa * (c1 * scale)[:, None] + wb * (c2 * scale)[:, None]
        fitted = np.einsum("nc,nck->nk", share, self.values.take(around, axis=0))
        low, high = self.bounds
        fitted = np.clip(fitted, low[clusters], high[clusters])
        fitted[~found] = 0
        return fitted, found


def _bounds(around: np.ndarray, values: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and most (k, 3) that a plane through the valid nodes around each node may give."""
    usable = valid[around][..., None]
    taken = values[around]
    low = np.where(usable, taken, np.inf).min(axis=1)
    high = np.where(usable, taken, -np.inf).max(axis=1)
    none = ~np.isfinite(low)
    low[none], high[none] = 0, 0
    room = np.float32(OVERSHOOT) * (high - low)
    return np.maximum(low - room, 0), high + room


def fill_from_neighbors(
    values: np.ndarray, known: np.ndarray, edges: np.ndarray, sweeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Values (n, 3) with those not `known` (n,) taken as means over known neighbors, ring by ring, `sweeps` rings deep.

    Returns the filled values and which are known now. What no ring reaches stays as it is.
    """
    values, known = values.copy(), known.copy()
    # Only edges with an unknown end can ever carry a value onward.
    edges = edges[~(known[edges[:, 0]] & known[edges[:, 1]])]
    for _ in range(sweeps):
        open_edges = edges[known[edges[:, 0]] != known[edges[:, 1]]]
        if not len(open_edges):
            break
        known_end = known[open_edges[:, 0]]
        source = np.where(known_end, open_edges[:, 0], open_edges[:, 1])
        target = np.where(known_end, open_edges[:, 1], open_edges[:, 0])
        reached, slots = np.unique(target, return_inverse=True)
        shares = np.bincount(slots, minlength=len(reached))
        for k in range(values.shape[1]):
            sums = np.bincount(slots, weights=values[source, k], minlength=len(reached))
            values[reached, k] = sums / shares
        known[reached] = True
    return values, known
