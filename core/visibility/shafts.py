"""Shafts: which polygons can stand between two others at all.

The convex hull of two polygons is the shaft between them. What lies wholly outside one of its planes blocks no line
from one to the other. The planes tried are those of the two polygons, of the blocker, the sides of the bounding box,
and those through an edge of one and a corner of the other that keep both on one side: for convex polygons these are the
hull's own. Neighboring points of a patch share the list, which is what makes exact clipping affordable.

Cost: corners^2 times blockers for each pair, in whole arrays. Limit: conservative; what touches the shaft is a
candidate.
"""

from __future__ import annotations

import numpy as np

from .bsp import TOLERANCE, BspTree

#: Pairs times planes times corners of blockers held at once: about 100 MB.
BLOCK_NUMBERS = 2**22


def shaft_candidates(tree: BspTree, first: np.ndarray, second: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Pieces of a tree that may block between pairs of polygons.

    Parameters
    ----------
    tree : BspTree
    first, second : (p, k, 3) and (p, l, 3) float
        Loops in the tree's unit frame that make pairs, padded by their last corner; only their hulls matter.
    candidates : (p, b) int
        Pieces to choose from, -1 for none.

    Returns
    -------
    (p, c) int64
        The candidates that remain, -1 where a pair has fewer than the pair with the most.
    """
    corners = tree.pieces.loops.shape[1]
    planes = 2 * first.shape[1] * second.shape[1] + 2
    block = max(1, BLOCK_NUMBERS // max(planes * candidates.shape[1] * corners, 1))
    result = np.full(candidates.shape, -1, dtype=np.int64)
    for start in range(0, len(first), block):
        rows = slice(start, start + block)
        between = _between(tree, first[rows], second[rows], candidates[rows])
        result[rows] = np.where(between, candidates[rows], -1)
    order = np.argsort(result < 0, axis=1, kind="stable")
    most = int((result >= 0).sum(axis=1).max(initial=0))
    return np.take_along_axis(result, order[:, :most], axis=1)


def _between(tree, first, second, candidates):
    """(p, b) bool: whether each candidate may stand between the pair of loops."""
    both = np.concatenate((first, second), axis=1)
    result = candidates >= 0
    # One coordinate after the other, as reductions over an axis of three are slow.
    for axis in range(3):
        ends = both[:, :, axis]
        lowest, highest = tree.pieces.loops[:, :, axis].min(axis=1), tree.pieces.loops[:, :, axis].max(axis=1)
        result &= highest[candidates] >= ends.min(axis=1)[:, None] - TOLERANCE
        result &= lowest[candidates] <= ends.max(axis=1)[:, None] + TOLERANCE
    lines, columns = np.nonzero(result)
    # A blocker has something of the pair on either side of its plane.
    nodes = tree.nodes[candidates[lines, columns]]
    heights = np.einsum("nki,ni->kn", both[lines], tree.normals[nodes]) - tree.offsets[nodes]
    parted = (heights.max(axis=0) > TOLERANCE) & (heights.min(axis=0) < -TOLERANCE)
    result[lines[~parted], columns[~parted]] = False
    lines, columns = lines[parted], columns[parted]
    if not len(lines):
        return result
    normals, offsets = hull_planes(first, second)
    nearest = None
    for corner in tree.pieces.loops[candidates[lines, columns]].transpose(1, 0, 2):
        beyond = np.matmul(normals[lines], corner[:, :, None])[:, :, 0]
        nearest = beyond if nearest is None else np.minimum(nearest, beyond)
    # Planes that do not bound the hull have no normal, and nothing lies beyond them.
    outside = (nearest - offsets[lines] >= -TOLERANCE) & normals.any(axis=2)[lines]
    result[lines, columns] = ~outside.any(axis=1)
    return result


def hull_planes(first, second):
    """Normals (p, e, 3) that point out of the hull of two loops, and offsets; 0 for planes that do not bound it."""
    both = np.concatenate((first, second), axis=1)
    normals, anchors = [], []
    for one, other in ((first, second), (second, first)):
        edges = np.roll(one, -1, axis=1) - one
        arms = other[:, None] - one[:, :, None]
        normals.append(np.cross(edges[:, :, None], arms).reshape(len(one), -1, 3))
        anchors.append(np.repeat(one, other.shape[1], axis=1))
    for loop in (first, second):
        arms = loop - loop[:, :1]
        normals.append(np.cross(arms[:, :-1], arms[:, 1:]).sum(axis=1)[:, None])
        anchors.append(loop[:, :1])
    normals, anchors = np.concatenate(normals, axis=1), np.concatenate(anchors, axis=1)
    lengths = np.linalg.norm(normals, axis=2, keepdims=True)
    normals = np.where(lengths > TOLERANCE, normals / np.where(lengths > 0, lengths, 1), 0)
    offsets = np.einsum("pei,pei->pe", normals, anchors)
    heights = np.einsum("pki,pei->pek", both, normals, optimize=True) - offsets[:, :, None]
    above, below = (heights > TOLERANCE).any(axis=2), (heights < -TOLERANCE).any(axis=2)
    signs = np.where(above & ~below, -1.0, np.where(below & ~above, 1.0, 0.0))
    return normals * signs[:, :, None], offsets * signs
