"""Pairs of polygons that something might stand between, told by their planes alone.

A third polygon can only come between two others if it reaches in front of both, and if its plane parts them: if some of
what they are lies on one side of it and some on the other. In a convex room no plane does, so nothing has to be tested
for visibility there. Cost: three products of n x n matrices of 0 and 1, a second for 5000 polygons; and it never
says no where something does block.
"""

from __future__ import annotations

import numpy as np


def blockable(low: np.ndarray, high: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Whether each pair of polygons may be blocked by a third, as seen from both fronts.

    Parameters
    ----------
    low, high : (n, n) float
        Lowest and highest corner of the column's polygon above the plane of the row's.
    tolerance : (n, n) float
        Height within which a corner counts as lying in the plane.

    Returns
    -------
    (n, n) bool
        Symmetric.
    """
    before, behind = high > tolerance, low < -tolerance
    reached = before.astype(np.float32)
    # Rows are the polygons of the pair, columns the third.
    on_front, on_back = reached * before.T, reached * behind.T
    parted = on_front @ on_back.T + (reached * (before & behind).T) @ reached.T
    return (parted + parted.T) > 0
