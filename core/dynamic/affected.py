"""Between which points light can have changed: boxes against segments and against the hulls of points and boxes.

The hull of a point p and a box with the middle m and the half sides s is swept by the boxes around p + t (m - p) with
the half sides t s, for t from 0 to 1. One of them meets a box with the middle c and the half sides h where, on each
axis, |p + t (m - p) - c| <= h + t s: two inequalities linear in t, so an interval, and the three must share a t. This
is the slab test of Kay and Kajiya 1986 ("Ray Tracing Complex Scenes") with slabs that widen; s = 0 is a segment. The
test is exact but for the margin.
"""

from __future__ import annotations

import numpy as np

from ..visibility.embree import OFFSET

#: Added to each side of a box, in the unit frame: what rays of a tracer are moved at their start, and their rounding in
#: float32, which is a hundredth of that.
MARGIN = 2 * OFFSET


def hull_meets(points: np.ndarray, low: np.ndarray, high: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """(n,) bool: whether the hull of each point (n, 3) and the box from `low` to `high`, each (n, 3), meets any of the
    boxes (k, 2, 3). All in the unit frame."""
    met = np.zeros(len(points), bool)
    # Axes first: NumPy reduces over a short last axis several times more slowly.
    starts, low, high = (np.ascontiguousarray(np.asarray(places, dtype=float).T) for places in (points, low, high))
    towards = (low + high) / 2 - starts
    widening = (high - low) / 2
    for box in np.asarray(boxes, dtype=float)[..., None]:
        lowest, highest = box
        met |= _meets(starts - (lowest + highest) / 2, towards, widening, (highest - lowest) / 2 + MARGIN)
    return met


def _meets(start: np.ndarray, towards: np.ndarray, widening: np.ndarray, half: np.ndarray) -> np.ndarray:
    """(n,) bool: whether some t in 0..1 has |start + t towards| <= half + t widening on all axes (3, n)."""
    # Both inequalities as slope * t <= room.
    slope = np.concatenate([towards - widening, -towards - widening])
    room = np.concatenate([half - start, half + start])
    with np.errstate(divide="ignore", invalid="ignore"):
        border = room / slope
    latest = np.where(slope > 0, border, np.inf).min(axis=0)
    earliest = np.where(slope < 0, border, -np.inf).max(axis=0)
    possible = ((slope != 0) | (room >= 0)).all(axis=0)
    return possible & (np.maximum(earliest, 0) <= np.minimum(latest, 1))
