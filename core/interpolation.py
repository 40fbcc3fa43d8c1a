"""Interpolation of smooth values from nodes to receivers, along the surface of any mesh.

Each target fits a plane through the values of the node that stands for its cluster and those of the clusters joined to
it, weighted by distance and by likeness of the normal (moving least squares, Lancaster and Salkauskas 1981). A plane is
exact for linear change, so no steps show at the borders of clusters, and it damps the noise of single nodes.
"""

from __future__ import annotations

import numpy as np

from .frames import tangents

#: Weight of the tie that keeps slopes finite where the nodes lie on a line or on one side; relative to the spacing.
RIDGE = 0.02

#: Squared distance, in spacings, below which a node weighs no more for being nearer. Large enough that a node's noise
#: is shared with its neighbors.
SOFTNESS = 0.3

#: How far a value may leave the range of the nodes it is fitted to, as part of that range. Light does go on rising
#: towards an edge beyond the last node.
OVERSHOOT = 0.5

#: Targets handled at a time: with eleven nodes each the temporaries stay within a few MB.
BLOCK = 16384


def interpolate(
    points: np.ndarray,
    normals: np.ndarray,
    targets: np.ndarray,
    candidates: np.ndarray,
    nodes: np.ndarray,
    values: np.ndarray,
    valid: np.ndarray,
    spacing: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Values at targets from a few candidate nodes each.

    Parameters
    ----------
    points, normals : (r, 3) float32
        Receivers.
    targets : (n,) int
        Receivers that want a value.
    candidates : (n, c) int
        Rows of `nodes` to look at for each target; the first is that of its own cluster, and
        repeats of it are not counted
    nodes : (k,) int
        Receiver of each node.
    values : (k, 3) float32
    valid : (k,) bool
        Nodes whose value may be used.
    spacing : float
        Distance at which a node's weight has fallen to a quarter.

    Returns
    -------
    values : (n, 3) float32
    found : (n,) bool, False where no candidate is valid; the value is then 0
    """
    count = len(targets)
    out = np.zeros((count, values.shape[1]), np.float32)
    found = np.zeros(count, bool)
    node_points, node_normals = points[nodes], normals[nodes]
    for start in range(0, count, BLOCK):
        part = slice(start, min(start + BLOCK, count))
        out[part], found[part] = _fit(
            points[targets[part]],
            normals[targets[part]],
            candidates[part],
            node_points,
            node_normals,
            values,
            valid,
            np.float32(spacing),
        )
    return out, found


def _fit(points, normals, candidates, node_points, node_normals, values, valid, spacing):
    apart = (node_points[candidates] - points[:, None]) / spacing
    alike = np.einsum("nci,ni->nc", node_normals[candidates], normals)
    square = np.einsum("nci,nci->nc", apart, apart)
    weight = np.maximum(alike, 0) ** 4 / (square + np.float32(SOFTNESS)) ** 2
    # A cluster with few neighbors repeats its own number: count it once.
    weight[:, 1:][candidates[:, 1:] == candidates[:, :1]] = 0
    usable = valid[candidates]
    weight *= usable
    one, other = tangents(normals)
    a = np.einsum("nci,ni->nc", apart, one)
    b = np.einsum("nci,ni->nc", apart, other)
    s0 = weight.sum(axis=1)
    found = s0 > 1e-12
    s0 = np.maximum(s0, np.float32(1e-12))
    sa, sb = (weight * a).sum(axis=1), (weight * b).sum(axis=1)
    saa = (weight * a * a).sum(axis=1) + np.float32(RIDGE) * s0
    sbb = (weight * b * b).sum(axis=1) + np.float32(RIDGE) * s0
    sab = (weight * a * b).sum(axis=1)
    # First row of the inverse of the 3 x 3 moments: what each node's value adds to the plane's value at the target.
    c0, c1, c2 = saa * sbb - sab * sab, sab * sb - sbb * sa, sab * sa - saa * sb
    determinant = np.maximum(s0 * c0 + sa * c1 + sb * c2, np.float32(1e-20))
    share = weight * (c0[:, None] + c1[:, None] * a + c2[:, None] * b) / determinant[:, None]
    share[~found] = 0
    taken = values[candidates]
    fitted = np.einsum("nc,nck->nk", share, taken)
    low = np.where(usable[..., None], taken, np.inf).min(axis=1)
    high = np.where(usable[..., None], taken, -np.inf).max(axis=1)
    room = np.float32(OVERSHOOT) * np.maximum(high - low, 0)
    fitted = np.clip(fitted, np.maximum(low - room, 0), high + room)
    fitted[~found] = 0
    return fitted, found


def fill_from_neighbors(
    values: np.ndarray, known: np.ndarray, edges: np.ndarray, sweeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Values (n, 3) with those not `known` (n,) taken as means over known neighbors, ring by ring, `sweeps` rings deep.

    Returns the filled values and which are known now. What no ring reaches stays as it is.
    """
    values, known = values.copy(), known.copy()
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
