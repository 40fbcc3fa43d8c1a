"""Convex loops as columns: corner by corner, for many polygons at once, where splitting must cost little.

Coordinates come first and polygons last, so that every step runs along memory: three to four times as fast as with rows
of corners (`convex_loops`), which are easier to handle one polygon at a time. Splitting by a plane uses that corners on
one side of it follow each other in a convex loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LoopColumns:
    """m convex loops.

    Attributes
    ----------
    corners : (3, k, m) float64
        Shorter loops repeat their last corner.
    sizes : (m,) int64
        Corners of each that count.
    """

    corners: np.ndarray
    sizes: np.ndarray

    def __len__(self) -> int:
        return len(self.sizes)

    def take(self, columns: np.ndarray) -> LoopColumns:
        """Some of the loops, by number or as a mask."""
        return LoopColumns(self.corners[:, :, columns], self.sizes[columns])

    def heights(self, planes: np.ndarray) -> np.ndarray:
        """Heights (k, m) of the corners over one plane through the origin each, with normals (3, m)."""
        x, y, z = self.corners
        return planes[0] * x + planes[1] * y + planes[2] * z


def concatenate(parts: list[LoopColumns]) -> LoopColumns:
    """Loops of several arrays in one, padded to the longest."""
    longest = max(part.corners.shape[1] for part in parts)
    padded = [
        np.concatenate((part.corners, np.repeat(part.corners[:, -1:], longest - part.corners.shape[1], axis=1)), axis=1)
        if part.corners.shape[1] < longest
        else part.corners
        for part in parts
    ]
    return LoopColumns(np.concatenate(padded, axis=2), np.concatenate([part.sizes for part in parts]))


def split(loops: LoopColumns, heights: np.ndarray, tolerance: float):
    """Parts of loops above and below their planes.

    Parameters
    ----------
    loops : LoopColumns
    heights : (k, m) float
        Height of each corner over the plane that splits its loop.
    tolerance : float
        Heights up to this count as 0.

    Returns
    -------
    above, above_columns, below, below_columns
        Loops, and the loop that each comes from. A loop that lies in its plane is in neither.
    """
    up, down = heights.max(axis=0, initial=0) > tolerance, heights.min(axis=0, initial=0) < -tolerance
    mixed = np.flatnonzero(up & down)
    whole_up, whole_down = np.flatnonzero(up & ~down), np.flatnonzero(down & ~up)
    if not len(mixed):
        return loops.take(whole_up), whole_up, loops.take(whole_down), whole_down
    cut, values = loops.take(mixed), heights[:, mixed]
    values = np.where(np.abs(values) <= tolerance, 0.0, values)
    above, below = _above(cut, values), _above(cut, -values)
    return (
        concatenate([above, loops.take(whole_up)]),
        np.concatenate((mixed, whole_up)),
        concatenate([below, loops.take(whole_down)]),
        np.concatenate((mixed, whole_down)),
    )


def _above(loops, heights):
    """Parts above their planes of loops that have corners on both sides."""
    count = len(loops)
    columns, last = np.arange(count), loops.sizes - 1
    up = (heights > 0) & (np.arange(len(heights))[:, None] < loops.sizes)
    before = np.concatenate((up[last, columns][None], up[:-1]))
    first, run = (up & ~before).argmax(axis=0), up.sum(axis=0)
    # The corner before the run, the run, and the corner after it.
    steps = np.minimum(np.arange(run.max() + 2)[:, None], run + 1)
    places = first - 1 + steps
    places += np.where(places < 0, loops.sizes, 0)
    places -= np.where(places >= loops.sizes, loops.sizes, 0)
    index = places * count + columns
    corners = np.stack([axis.ravel()[index] for axis in loops.corners])
    values = heights.ravel()[index]
    ends = np.stack([corners[:, run, columns], corners[:, run + 1, columns]])
    low, high = values[run + 1, columns], values[run, columns]
    leaving = ends[0] + high / (high - low) * (ends[1] - ends[0])
    entering = corners[:, 0] + values[0] / (values[0] - values[1]) * (corners[:, 1] - corners[:, 0])
    corners = np.where(steps == run + 1, leaving[:, None], corners)
    corners[:, 0] = entering
    return LoopColumns(corners, run + 2)
