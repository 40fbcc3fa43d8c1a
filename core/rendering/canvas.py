"""A flat picture of filled shapes, for plots: coverage by winding number, edges smoothed by samples.

A shape is a set of directed edges; a point is inside where they wind around it (the nonzero rule of PostScript and
SVG), so triangles, outlines and letters with holes are all the same to it. Cost: one term for each edge and each sample
row that it crosses, and the shape's bounding box times the samples of a pixel.
"""

from __future__ import annotations

import numpy as np

#: Samples of a pixel along each side.
_SAMPLES = 4


class Canvas:
    """Pixels to draw on, first row on top; lengths are pixels, y grows downward.

    Parameters
    ----------
    width, height : int
    background : sequence of 3 float
        As shown on a screen (sRGB), 0 to 1, as are all colors here.
    """

    def __init__(self, width: int, height: int, background=(1.0, 1.0, 1.0)) -> None:
        self._pixels = np.tile(np.asarray(background, dtype=float), (height, width, 1))

    @property
    def pixels(self) -> np.ndarray:
        """(h, w, 3) uint8."""
        return np.round(255 * np.clip(self._pixels, 0, 1)).astype(np.uint8)

    def fill(self, edges: np.ndarray, color, opacity: float = 1.0) -> None:
        """Fill what directed edges (m, 2, 2), from (x, y) to (x, y), wind around; what lies outside is cut off."""
        height, width = self._pixels.shape[:2]
        if not len(edges):
            return
        low = np.maximum(np.floor(edges.min(axis=(0, 1))), 0).astype(int)
        high = np.minimum(np.ceil(edges.max(axis=(0, 1))), (width, height)).astype(int)
        if np.any(high <= low):
            return
        share = opacity * _coverage(edges - low, *(high - low))[..., None]
        part = self._pixels[low[1] : high[1], low[0] : high[0]]
        part += share * (np.asarray(color, dtype=float) - part)

    def polygon(self, points: np.ndarray, color, opacity: float = 1.0) -> None:
        """Fill a closed outline (k, 2)."""
        points = np.asarray(points, dtype=float)
        self.fill(np.stack([points, np.roll(points, -1, axis=0)], axis=1), color, opacity)

    def line(self, start, end, width: float, color, opacity: float = 1.0) -> None:
        """A straight line `width` wide with square ends."""
        start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        along = end - start
        aside = 0.5 * width * np.array([-along[1], along[0]]) / max(np.hypot(*along), 1e-12)
        self.polygon([start + aside, end + aside, end - aside, start - aside], color, opacity)


def _coverage(edges: np.ndarray, width: int, height: int) -> np.ndarray:
    """Share (height, width) of each pixel that the edges wind around."""
    edges = edges * _SAMPLES
    columns, rows = width * _SAMPLES, height * _SAMPLES
    down = edges[:, 1, 1] > edges[:, 0, 1]
    top = np.where(down[:, None], edges[:, 0], edges[:, 1])
    bottom = np.where(down[:, None], edges[:, 1], edges[:, 0])
    # Sample rows k + 1/2 between the two ends: half open, so that where edges meet only one of them counts.
    first = np.clip(np.ceil(top[:, 1] - 0.5), 0, rows).astype(int)
    last = np.clip(np.ceil(bottom[:, 1] - 0.5), 0, rows).astype(int)
    count = np.maximum(last - first, 0)
    edge = np.repeat(np.arange(len(edges)), count)
    row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[edge]
    slope = (bottom[edge, 0] - top[edge, 0]) / (bottom[edge, 1] - top[edge, 1])
    x = top[edge, 0] + slope * (row + 0.5 - top[edge, 1])
    column = np.clip(np.ceil(x - 0.5), 0, columns).astype(int)
    turns = np.bincount(
        row * (columns + 1) + column, weights=np.where(down, 1, -1)[edge], minlength=rows * (columns + 1)
    )
    inside = np.cumsum(turns.reshape(rows, columns + 1), axis=1)[:, :columns] != 0
    return inside.reshape(height, _SAMPLES, width, _SAMPLES).mean(axis=(1, 3))
