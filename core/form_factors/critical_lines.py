"""Critical lines: where, on a receiver, the view of a polygon among blockers changes its make-up.

While a point moves over a receiver, the outline of what it sees of a source changes smoothly until a corner of one
polygon meets an edge of another, or a polygon is seen edge-on, or the point crosses one that touches the receiver. Each
of these happens on a straight line of the receiver [1]_. A rule of integration that is applied to either side of such a
line meets no kink. Events of three edges run along curves and are left to refinement.

Cost: corners^2 lines for each blocker of a pair, in whole arrays; nothing is traced along them.

References
----------
.. [1] Lischinski, Tampieri, Greenberg, "Discontinuity Meshing for Accurate Radiosity", IEEE Computer Graphics and
   Applications 12 (6), 1992.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..visibility.bsp import TOLERANCE

#: Sine of the angle between a plane and the receiver below which they count as parallel: no line.
PARALLEL = 1e-9

#: Part of a cell's height over a line, in scene sizes, that counts as none.
ON_LINE = 1e-11

#: Part of a cell's height that a line must leave on either side, unless it is strong: what a thin strip changes tells
#: nothing of how well the rest is integrated.
BALANCE = 0.15

#: Cells times lines times corners compared at once.
BLOCK_NUMBERS = 2**21


@dataclass(frozen=True)
class CriticalLines:
    """Lines on the receivers of p pairs, as planes that cut them, and how far each line reaches.

    Attributes
    ----------
    normals : (p, l, 3) float64
        Unit vectors in the receiver's plane, across each line; 0 for none.
    offsets : (p, l) float64
    directions : (p, l, 3) float64
        Along each line.
    reaches : (p, l, 2) float64
        From where to where along its direction.
    strong : (p, l) bool
        Whether the factor itself may jump or bend there, and not only its slope.
    """

    normals: np.ndarray
    offsets: np.ndarray
    directions: np.ndarray
    reaches: np.ndarray
    strong: np.ndarray

    def best(self, cells: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Line (c,) by which to cut each cell (c, 3, 3) of its pair, -1 for none, and the corners' heights (c, 3).

        Strong lines come first, then the one that divides the cell most evenly.
        """
        chosen, heights = np.full(len(cells), -1), np.zeros((len(cells), 3))
        count = self.normals.shape[1]
        block = max(1, BLOCK_NUMBERS // max(9 * count, 1))
        for start in range(0, len(cells) if count else 0, block):
            corners, rows = cells[start : start + block], pairs[start : start + block]
            # Three arrays, as a reduction over an axis of three is ten times slower.
            over = [np.einsum("cli,ci->cl", self.normals[rows], corner) for corner in corners.transpose(1, 0, 2)]
            over = [height - self.offsets[rows] for height in over]
            along = [np.einsum("cli,ci->cl", self.directions[rows], corner) for corner in corners.transpose(1, 0, 2)]
            least, most = _extremes(over)
            begin, end = _extremes(along)
            crossed = (least < -ON_LINE) & (most > ON_LINE)
            crossed &= (end > self.reaches[rows, :, 0]) & (begin < self.reaches[rows, :, 1])
            balance = np.minimum(-least, most) / np.where(crossed, most - least, 1)
            crossed &= self.strong[rows] | (balance > BALANCE)
            score = np.where(crossed, balance + self.strong[rows], -1)
            best = score.argmax(axis=1)
            lines = np.arange(len(corners))
            chosen[start : start + block] = np.where(score[lines, best] > 0, best, -1)
            heights[start : start + block] = np.stack([height[lines, best] for height in over], axis=1)
        return chosen, heights


def critical_lines(planes, sources: np.ndarray, blockers: np.ndarray, there: np.ndarray) -> CriticalLines:
    """Critical lines of p pairs.

    Parameters
    ----------
    planes : (p, 3) and (p,) float
        Unit normals and offsets of the receivers.
    sources : (p, k, 3) float
        Loops looked at, padded by their last corner.
    blockers : (p, b, k, 3) float
        Loops that may stand between.
    there : (p, b) bool
        Which of the blockers exist.
    """
    normals, offsets = planes
    pairs, count = blockers.shape[:2]
    corners, edges = _flat(blockers), _edges(blockers)
    alive = np.repeat(there, blockers.shape[2], axis=1)
    lines = [_edge_on(normals, offsets, np.concatenate((sources[:, None], blockers), axis=1), there)]
    always = np.ones(sources.shape[:2], dtype=bool)
    for (points, use), (starts, ends, real) in (
        ((sources, always), (*edges, alive)),
        ((corners, alive), (*_edges(sources[:, None]), always)),
    ):
        lines.append(_wedges(normals, offsets, points, starts, ends, use, real))
    for one in range(count):
        others = np.flatnonzero(np.arange(count) != one)
        if len(others):
            use = np.repeat(there[:, others], blockers.shape[2], axis=1)
            real = np.repeat(there[:, [one]], blockers.shape[2], axis=1)
            parts = _flat(blockers[:, others]), *_edges(blockers[:, [one]])
            lines.append(_wedges(normals, offsets, *parts, use, real))
    joined = [np.concatenate(part, axis=1) for part in zip(*lines, strict=True)]
    # Lines that exist first, so that the width is that of the pair with the most.
    real = joined[0].any(axis=2)
    order = np.argsort(~real, axis=1, kind="stable")[:, : int(real.sum(axis=1).max(initial=0))]
    rows = np.arange(pairs)[:, None]
    return CriticalLines(*(part[rows, order] for part in joined))


def _extremes(three):
    return (
        np.minimum(np.minimum(three[0], three[1]), three[2]),
        np.maximum(np.maximum(three[0], three[1]), three[2]),
    )


def _flat(loops):
    return loops.reshape(len(loops), loops.shape[1] * loops.shape[2], 3)


def _edges(loops):
    return _flat(loops), _flat(np.roll(loops, -1, axis=2))


def _line(normals, offsets, plane_normals, anchors):
    """Where planes (p, l) through anchors cut the receivers: unit normals in the receiver, offsets, directions."""
    lengths = np.linalg.norm(plane_normals, axis=2, keepdims=True)
    unit = plane_normals / np.where(lengths > TOLERANCE * TOLERANCE, lengths, np.inf)
    sines = np.einsum("pli,pi->pl", unit, normals)
    across = unit - sines[:, :, None] * normals[:, None]
    widths = np.linalg.norm(across, axis=2, keepdims=True)
    across = across / np.where(widths > PARALLEL, widths, np.inf)
    # On the receiver x is offset n + its part in the plane, so the normal's part along n moves to the offset.
    distances = np.einsum("pli,pli->pl", unit, anchors) - sines * offsets[:, None]
    shifts = distances / np.where(widths[:, :, 0] > PARALLEL, widths[:, :, 0], np.inf)
    return across, shifts, np.cross(normals[:, None], across)


def _edge_on(normals, offsets, loops, there):
    """Planes of source (first) and blockers, and edges that lie in the receiver."""
    arms = loops - loops[:, :, :1]
    planes = np.cross(arms[:, :, :-1], arms[:, :, 1:]).sum(axis=2)
    real = np.concatenate((np.ones((len(there), 1), dtype=bool), there), axis=1)
    across, shifts, along = _line(normals, offsets, planes * real[:, :, None], loops[:, :, 0])
    reaches = np.broadcast_to([-np.inf, np.inf], (*shifts.shape, 2))
    return across, shifts, along, reaches, np.ones(shifts.shape, dtype=bool)


def _wedges(normals, offsets, points, starts, ends, use, real):
    """Lines where one of points (p, a, 3) and one of the edges (p, e, 3) are seen in one place."""
    shape = (len(points), points.shape[1] * starts.shape[1])
    apex = np.repeat(points, starts.shape[1], axis=1)
    first, last = (np.tile(ends_, (1, points.shape[1], 1)) for ends_ in (starts, ends))
    exists = np.repeat(use, starts.shape[1], axis=1) & np.tile(real, (1, points.shape[1]))
    planes = np.cross(first - apex, last - apex) * exists[:, :, None]
    across, shifts, along = _line(normals, offsets, planes, apex)
    height = np.einsum("pli,pi->pl", apex, normals) - offsets[:, None]
    reaches = np.empty((*shape, 2))
    for place, end in enumerate((first, last)):
        rise = np.einsum("pli,pi->pl", end - apex, normals)
        flat = np.abs(rise) <= TOLERANCE
        share = height / np.where(flat, 1, -rise)
        hits = np.einsum("pli,pli->pl", apex + share[:, :, None] * (end - apex), along)
        # A ray that runs level never arrives: the line goes on without end.
        reaches[:, :, place] = np.where(flat, np.nan, hits)
    # Seen from the apex through the edge and back: the two ends must lie on one side of the apex, else the line runs
    # through infinity.
    sides = [np.einsum("pli,pi->pl", end, normals) - offsets[:, None] > height for end in (first, last)]
    endless = np.isnan(reaches).any(axis=2) | (sides[0] != sides[1])
    reaches = np.sort(reaches, axis=2) + np.array([-ON_LINE, ON_LINE])
    reaches[endless] = [-np.inf, np.inf]
    return across, shifts, along, reaches, np.zeros(shape, dtype=bool)
