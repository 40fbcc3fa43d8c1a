"""Emissive triangles that hang together, and which of them close around a space that nobody sees.

A bulb emits from both sides of its faces as long as the material does not say otherwise, but what goes inside stays
there. Whoever knows that need not look through its front for its far side's back.
"""

from __future__ import annotations

import numpy as np

from ..discretization.nodes import connected_labels
from ..keys import directed_pairs, row_keys

#: Corners this close, in unit lengths, are one: exporters split vertices along seams.
SAME_PLACE = 1e-7


def connected_groups(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group (t,) of each of (t, 3, 3) triangles, those that share a corner's place being together, and whether each
    group (g,) is a closed surface seen from outside."""
    count = len(corners)
    keys = row_keys(*np.rint(corners.reshape(-1, 3) / SAME_PLACE).astype(np.int64).T)
    _, welded = np.unique(keys, return_inverse=True)
    welded = welded.reshape(count, 3).astype(np.int32)
    ends = np.concatenate([welded[:, :2], welded[:, 1:]])
    labels = connected_labels(int(welded.max()) + 1 if count else 0, ends)
    _, groups = np.unique(labels[welded[:, 0]], return_inverse=True)
    groups = groups.reshape(-1)
    return groups, _are_closed(corners, welded, groups)


def _are_closed(corners: np.ndarray, welded: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """(g,) bool: every edge is run once each way, and the faces look out of the volume they enclose."""
    total = int(groups.max()) + 1 if len(groups) else 0
    one, other = welded.ravel(), np.roll(welded, -1, axis=1).ravel()
    pairs, both = directed_pairs(one, other, int(welded.max()) + 1 if len(welded) else 1)
    member = np.empty(int(welded.max()) + 1 if len(welded) else 0, np.int64)
    member[welded] = groups[:, None]
    edges = np.bincount(member[pairs[:, 0]], minlength=total)
    open_ = np.bincount(member[pairs[:, 0]], weights=~both, minlength=total) > 0
    sides = 3 * np.bincount(groups, minlength=total)
    size = np.maximum(np.bincount(groups, minlength=total), 1)
    # Volumes from each group's own middle: far from the origin the products would lose digits.
    middles = [
        np.bincount(groups, weights=corners[:, :, axis].mean(axis=1), minlength=total) / size for axis in (0, 1, 2)
    ]
    local = corners - np.stack(middles, axis=1)[groups][:, None]
    volumes = np.einsum("ti,ti->t", local[:, 0], np.cross(local[:, 1], local[:, 2])) / 6
    return ~open_ & (2 * edges == sides) & (np.bincount(groups, weights=volumes, minlength=total) > 0)


def are_empty(corners: np.ndarray, groups: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(g,) bool: none of the points `others` (k, 3) lies inside the box around each group of (t, 3, 3) triangles."""
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=-1))
    if not len(starts):
        return np.zeros(0, bool)
    sorted_ = corners[order]
    low = np.minimum.reduceat(sorted_.min(axis=1), starts)
    high = np.maximum.reduceat(sorted_.max(axis=1), starts)
    others = others[np.argsort(others[:, 0], kind="stable")]
    begin = np.searchsorted(others[:, 0], low[:, 0], side="right")
    end = np.searchsorted(others[:, 0], high[:, 0], side="left")
    empty = np.ones(len(starts), bool)
    for group in np.flatnonzero(end > begin):
        near = others[begin[group] : end[group], 1:]
        empty[group] = not ((near > low[group, 1:]) & (near < high[group, 1:])).all(axis=1).any()
    return empty
