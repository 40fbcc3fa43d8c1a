"""Nodes: a sparse, nested choice of receivers at which the smooth part of the light is computed.

Receivers that are joined along the surface and fall in one cell of a grid form a cluster; one of them stands for it.
Clusters of one level are joined into those of the next coarser one, so every coarse node is also a node of all finer
levels. Joining follows mesh edges, and edges that cross a wall are left out by the caller, so no cluster reaches
through or under a wall, whatever the shape of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..keys import row_keys, unique_pairs

#: Normals within one cluster are equal after rounding this multiple of them.
NORMAL_STEPS = 1.5

#: Neighboring clusters that are remembered for each.
MAX_NEIGHBORS = 8


@dataclass(frozen=True)
class NodeLevel:
    """Clusters of one level.

    Parameters
    ----------
    spacing : float
        Side of the grid's cells, in unit lengths.
    nodes : (k,) int32
        The receiver that stands for each cluster.
    clusters : (f,) int32
        Cluster of each item of the next finer level (of each receiver, at the finest).
    edges : (e, 2) int32
        Pairs of clusters joined along the surface.
    neighbors : (k, MAX_NEIGHBORS) int32
        Clusters joined to each, to those set apart only such; its own number where there are fewer.
    """

    spacing: float
    nodes: np.ndarray
    clusters: np.ndarray
    edges: np.ndarray
    neighbors: np.ndarray


def connected_labels(count: int, edges: np.ndarray) -> np.ndarray:
    """Lowest item (count,) int32 of the connected part that each item belongs to.

    Hooking and pointer jumping (Shiloach and Vishkin 1982): some rounds over all edges at once.
    """
    parent = np.arange(count, dtype=np.int32)
    one, other = edges[:, 0], edges[:, 1]
    while len(one):
        low, high = parent[one], parent[other]
        apart = low != high
        if not apart.any():
            break
        low, high, one, other = low[apart], high[apart], one[apart], other[apart]
        swapped = low > high
        low[swapped], high[swapped] = high[swapped], low[swapped]
        np.minimum.at(parent, high, low)
        while True:
            above = parent[parent]
            if np.array_equal(above, parent):
                break
            parent = above
    return parent


def neighbor_table(count: int, edges: np.ndarray, apart: np.ndarray | None = None) -> np.ndarray:
    """(count, MAX_NEIGHBORS) int32 what each item is joined to by undirected edges (e, 2), filled up with itself.

    Items that stand `apart` (count,) take no others for neighbors, but may be theirs.
    """
    table = np.repeat(np.arange(count, dtype=np.int32)[:, None], MAX_NEIGHBORS, axis=1)
    if not len(edges):
        return table
    source = np.concatenate([edges[:, 0], edges[:, 1]])
    target = np.concatenate([edges[:, 1], edges[:, 0]])
    kept = slice(None) if apart is None else ~apart[source] | apart[target]
    source, target = source[kept], target[kept]
    order = np.argsort(source, kind="stable")
    source, target = source[order], target[order]
    starts = np.searchsorted(source, np.arange(count))
    rank = np.arange(len(source)) - starts[source]
    kept = rank < MAX_NEIGHBORS
    table[source[kept], rank[kept]] = target[kept]
    return table


def _coarsen(
    points: np.ndarray, normals: np.ndarray, apart: np.ndarray, items: np.ndarray, edges: np.ndarray, spacing: float
) -> NodeLevel:
    """Clusters of `items` (receiver numbers), joined by `edges` between items."""
    count = len(items)
    # The finest level has all receivers for items, in order: no copies.
    place, facing = (points, normals) if count == len(points) else (points[items], normals[items])
    cells = row_keys(
        *np.floor(place / np.float32(spacing)).astype(np.int32).T,
        *np.rint(facing * np.float32(NORMAL_STEPS)).astype(np.int32).T,
        apart[items],
    )
    inside = cells[edges[:, 0]] == cells[edges[:, 1]]
    del cells
    labels = connected_labels(count, edges[inside])
    leaders = labels == np.arange(count)
    clusters = (np.cumsum(leaders) - 1).astype(np.int32)[labels]
    total = int(leaders.sum())
    shares = np.bincount(clusters, minlength=total)
    middle = np.stack([np.bincount(clusters, weights=place[:, k], minlength=total) / shares for k in range(3)], axis=1)
    away = ((place - middle[clusters]) ** 2).sum(axis=1)
    # The member nearest to the middle stands for all: of equal ones the first, whatever the order of the sort.
    order = np.lexsort((np.arange(count), away, clusters))
    first = np.searchsorted(clusters[order], np.arange(total))
    between = edges[~inside]
    joined = unique_pairs(clusters[between[:, 0]], clusters[between[:, 1]], max(total, 1))
    nodes = items[order[first]].astype(np.int32)
    return NodeLevel(spacing, nodes, clusters, joined, neighbor_table(total, joined, apart[nodes]))


def build_levels(
    points: np.ndarray,
    normals: np.ndarray,
    edges: np.ndarray,
    spacing: float,
    levels: int,
    apart: np.ndarray | None = None,
) -> list[NodeLevel]:
    """Levels from the coarsest, whose cells measure `spacing`, to the finest, each half as wide as the one before.

    Parameters
    ----------
    points, normals : (r, 3) float32
        Receivers.
    edges : (e, 2) int32
        Pairs joined along the surface, none across a wall.
    spacing : float
        Of the coarsest level, in unit lengths.
    levels : int
        How many.
    apart : (r,) bool or None
        Receivers that share clusters with each other only, and have no others for neighbors. The others do have these,
        as a boundary value.

    Returns
    -------
    list of NodeLevel
        ``out[l].clusters`` maps the nodes of level l + 1, or the receivers at the last level, to clusters of level l.
    """
    out: list[NodeLevel] = []
    items = np.arange(len(points), dtype=np.int32)
    apart = np.zeros(len(points), bool) if apart is None else apart
    for level in range(levels - 1, -1, -1):
        coarser = _coarsen(points, normals, apart, items, edges, spacing / 2**level)
        out.append(coarser)
        items, edges = coarser.nodes, coarser.edges
    return out[::-1]
