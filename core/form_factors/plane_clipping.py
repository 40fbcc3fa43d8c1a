"""Loops clipped by half-spaces, many at once: what of a polygon lies in front of another's plane.

The clipped boundary stays one closed chain. A concave polygon that falls into several parts is joined along the cutting
line by stretches that are run through in both directions, which cancel in every integral along the boundary or over the
area (Stokes), so that nothing else is needed. Cost: linear in corners; no loop over polygons.
"""

from __future__ import annotations

import numpy as np


def clip_loops(loops: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Parts of n loops above a plane.

    Parameters
    ----------
    loops : (n, k, 3) float
        Corners; repeated ones are fine.
    heights : (n, k) float
        Heights of the corners above each loop's plane; a corner at 0 counts as above. At least one per loop is
        positive.

    Returns
    -------
    (n, m, 3) float64
        The clipped loops, m at most ``2 k``, filled up with copies of their last corner.
    """
    following = np.roll(loops, -1, axis=1)
    here, there = heights, np.roll(heights, -1, axis=1)
    crossed = (here >= 0) != (there >= 0)
    shares = np.where(crossed, here, 0) / np.where(crossed, here - there, 1)
    crossings = loops + shares[..., None] * (following - loops)
    count, corners = heights.shape
    # Each edge contributes its start, if above, and its crossing, if it has one.
    points = np.stack((loops, crossings), axis=2).reshape(count, 2 * corners, 3)
    kept = np.stack((here >= 0, crossed), axis=2).reshape(count, 2 * corners)
    order = np.argsort(~kept, axis=1, kind="stable")
    sizes = kept.sum(axis=1)
    longest = int(sizes.max(initial=1))
    columns = np.minimum(np.arange(longest), np.maximum(sizes - 1, 0)[:, None])
    chosen = np.take_along_axis(order, columns, axis=1)
    return np.take_along_axis(points, chosen[..., None], axis=1)
