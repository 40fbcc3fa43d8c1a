"""Triangles as cells of an integral: Radon's rule on each, and how they are divided.

Cells are (c, 3, 3) arrays of corners. A cell is cut along a line, or in four where no line crosses it.
"""

from __future__ import annotations

import numpy as np

from ..visibility.convex_loops import split
from .critical_lines import ON_LINE, CriticalLines

_A, _B = (6 - 15**0.5) / 21, (6 + 15**0.5) / 21

#: Radon's rule of degree 5 on the triangle: barycentric coordinates (7, 3) and weights (7,).
RULE_POINTS = np.array(
    [[1 / 3] * 3]
    + [[1 - 2 * a if place == corner else a for place in range(3)] for a in (_A, _B) for corner in range(3)]
)
RULE_WEIGHTS = np.array([9 / 40] + [(155 - 15**0.5) / 1200] * 3 + [(155 + 15**0.5) / 1200] * 3)

#: What Radon's rule differs by from the one of degree 2 on six of its points: 0 for parabolas.
_SQUARES = [2 * a * a + (1 - 2 * a) ** 2 for a in (_A, _B)]
_FIRST = (0.5 - _SQUARES[1]) / (_SQUARES[0] - _SQUARES[1])
NULL_WEIGHTS = RULE_WEIGHTS - np.array([0.0] + [_FIRST / 3] * 3 + [(1 - _FIRST) / 3] * 3)


def divide(cells: np.ndarray, pairs: np.ndarray, lines: CriticalLines):
    """Smaller triangles in place of each cell.

    Parameters
    ----------
    cells : (c, 3, 3) float
    pairs : (c,) int
        Pair of the lines that each belongs to.
    lines : CriticalLines
        Cells that one of them crosses are cut along it, others in four.

    Returns
    -------
    children : (d, 3, 3) float64
    parents : (d,) int64
        Cell that each is a part of.
    parts : (d,) float64
        Share of that cell's area.
    strongly : (c,) bool
        Cells that a strong line cuts.
    """
    best, heights = lines.best(cells, pairs)
    whole, crossed = np.flatnonzero(best < 0), np.flatnonzero(best >= 0)
    children, parents = [_quarter(cells[whole])], [np.repeat(whole, 4)]
    above, above_rows, below, below_rows = split(cells[crossed], heights[crossed], ON_LINE)
    for loops, rows in ((above, above_rows), (below, below_rows)):
        triangles, places = fans(loops)
        children.append(triangles)
        parents.append(crossed[rows[places]])
    children, parents = np.concatenate(children), np.concatenate(parents)
    sizes = areas(children)
    strongly = np.zeros(len(cells), dtype=bool)
    strongly[crossed] = lines.strong[best[crossed]]
    return children, parents, sizes / np.bincount(parents, sizes, len(cells))[parents], strongly


def fans(loops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles with an area that fill convex loops (m, k, 3), and the loop of each."""
    triangles = [loops[:, [0, corner, corner + 1]] for corner in range(1, loops.shape[1] - 1)]
    triangles, owners = np.concatenate(triangles), np.tile(np.arange(len(loops)), len(triangles))
    real = areas(triangles) > 0
    return triangles[real], owners[real]


def areas(triangles: np.ndarray) -> np.ndarray:
    """Areas (t,) of triangles (t, 3, 3)."""
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2


def _quarter(cells):
    """(4 c, 3, 3) triangles, the four of each one after the other."""
    middles = (cells + np.roll(cells, -1, axis=1)) / 2
    a, b, c = cells.transpose(1, 0, 2)
    ab, bc, ca = middles.transpose(1, 0, 2)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)
