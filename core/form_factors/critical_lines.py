"""Critical lines: where, on a receiver, the view of a polygon among blockers changes its make-up.

While a point moves over a receiver, the outline of what it sees of a source changes smoothly until a corner of one
polygon meets an edge of another, or a polygon is seen edge-on, or the point crosses one that touches the receiver. Each
of these happens on a straight line of the receiver [1]_. A rule of integration that is applied to either side of such a
line meets no kink. Events of three edges run along curves and are left to refinement.

Kept are only lines that can matter: those of corners and edges between receiver and source that are seen from the
receiver in one direction, with the source behind them, where the edge is on an outline, and that cross the receiver.
Of some hundred for a pair in a furnished box about one in ten remains, and fewer cuts lead to the same accuracy.

Cost: corners times edges between a pair, in whole arrays; nothing is traced along the lines.

References
----------
.. [1] Lischinski, Tampieri, Greenberg, "Discontinuity Meshing for Accurate Radiosity", IEEE Computer Graphics and
   Applications 12 (6), 1992.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..visibility.bsp import TOLERANCE
from ..visibility.outlines import Outlines
from ..visibility.shafts import hull_planes
from ..visibility.zbuffer import ranges

#: Sine of the angle between a plane and the receiver below which they count as parallel: no line. The same for a face
#: and a plane through its edge: the line is that of the face seen edge-on.
PARALLEL = 1e-9

#: Part of a cell's height over a line, in scene sizes, that counts as none.
ON_LINE = 1e-11

#: Part of a cell's height that a line must leave on either side, unless it is strong: what a thin strip changes tells
#: nothing of how well the rest is integrated.
BALANCE = 0.1

#: Corners times edges, and cells times lines, worked on at once: temporaries near 100 MB.
BLOCK_LINES = 2**18


@dataclass(frozen=True)
class CriticalLines:
    """Lines on the receivers of p pairs, as planes that cut them.

    Attributes
    ----------
    starts, counts : (p,) int64
        Lines of each pair: where they begin, and how many there are.
    normals : (l, 3) float64
        Unit vectors in the receiver's plane, across each line.
    offsets : (l,) float64
    strong : (l,) bool
        Whether the factor itself may jump or bend there, and not only its slope.
    """

    starts: np.ndarray
    counts: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    strong: np.ndarray

    def best(self, cells: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Line (c,) by which to cut each cell (c, 3, 3) of its pair, -1 for none, and the corners' heights (c, 3).

        Strong lines come first, then the one that divides the cell most evenly.
        """
        chosen, heights = np.full(len(cells), -1), np.zeros((len(cells), 3))
        counts = self.counts[pairs]
        for begin, end in blocks(counts, BLOCK_LINES):
            rows, lines = ranges(self.starts[pairs[begin:end]], counts[begin:end])
            rows += begin
            over = np.einsum("nki,ni->kn", cells[rows], self.normals[lines]) - self.offsets[lines]
            least, most = _extremes(over)
            crossed = np.flatnonzero((least < -ON_LINE) & (most > ON_LINE))
            rows, lines, least, most = rows[crossed], lines[crossed], least[crossed], most[crossed]
            balance = np.minimum(-least, most) / (most - least)
            strong = self.strong[lines]
            kept = np.flatnonzero(strong | (balance > BALANCE))
            order = kept[np.lexsort((-(balance + strong)[kept], rows[kept]))]
            cut, leading = np.unique(rows[order], return_index=True)
            chosen[cut] = lines[order[leading]]
            heights[cut] = over[:, crossed[order[leading]]].T
        return chosen, heights


def blocks(counts: np.ndarray, size: int):
    """Begins and ends of runs of consecutive items whose counts add up to at most `size`, or of one item."""
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(counts):
        before = ends[begin] - counts[begin]
        end = max(int(np.searchsorted(ends, before + size, side="right")), begin + 1)
        yield begin, end
        begin = end


@dataclass(frozen=True)
class _Pairs:
    """Receivers' planes and hulls, and the sources' hulls, of p pairs."""

    normals: np.ndarray
    offsets: np.ndarray
    hulls: np.ndarray
    sources: np.ndarray


def critical_lines(
    outlines: Outlines, normals: np.ndarray, receivers: np.ndarray, sources: np.ndarray, source_patches, blockers
) -> CriticalLines:
    """Critical lines of p pairs.

    Parameters
    ----------
    outlines : Outlines
    normals : (p, 3) float
        Unit normals of the receivers, on the side that is looked from.
    receivers, sources : (p, k, 3) float
        Loops that make the pairs, padded by their last corner.
    source_patches : (p,) int
    blockers : (p, b) int
        Patches that may stand between, -1 for none, in any order.
    """
    offsets = np.einsum("pi,pi->p", normals, receivers[:, 0])
    pairs = _Pairs(normals, offsets, receivers, sources)
    rows, columns = np.nonzero(blockers >= 0)
    patches = np.unique(np.stack((rows, blockers[rows, columns]), axis=1), axis=0)
    everything = np.stack((np.arange(len(normals)), source_patches), axis=1)
    lines = [_edge_on(outlines, pairs, np.concatenate((everything, patches)))]
    corners, edges = _between(outlines, pairs, everything, patches)
    first = np.searchsorted(edges[0], np.arange(len(normals)))
    counts = np.bincount(edges[0], minlength=len(normals))
    for begin, end in blocks(counts[corners[0]], BLOCK_LINES):
        which, theirs = ranges(first[corners[0][begin:end]], counts[corners[0][begin:end]])
        lines.append(_wedges(outlines, pairs, [a[begin + which] for a in corners], [a[theirs] for a in edges[1:]]))
    owners, *joined = (np.concatenate(part) for part in zip(*lines, strict=True))
    order = np.argsort(owners, kind="stable")
    counts = np.bincount(owners, minlength=len(normals))
    return CriticalLines(np.cumsum(counts) - counts, counts, *(part[order] for part in joined))


def _extremes(three):
    return np.minimum(np.minimum(three[0], three[1]), three[2]), np.maximum(np.maximum(three[0], three[1]), three[2])


def _between(outlines, pairs, source_patches, blockers):
    """Corners and edges that may make lines: the pair, the corner or edge, and whether it is the source's."""
    planes, limits = hull_planes(pairs.hulls, pairs.sources)
    result = []
    for names in (outlines.places, outlines.sides):
        parts = []
        for patches, own in ((source_patches, True), (blockers, False)):
            which, sides = ranges(outlines.starts[patches[:, 1]], outlines.counts[patches[:, 1]])
            parts.append(np.stack((patches[which, 0], names[sides], np.full(len(sides), not own)), axis=1))
        found = np.concatenate(parts)
        # Sorted with the source's own first: they stay its own where blockers share them.
        found = np.unique(found[found[:, 1] >= 0], axis=0)
        found = found[np.append(True, (found[1:, :2] != found[:-1, :2]).any(axis=1))[: len(found)]]
        owners, items, own = found[:, 0], found[:, 1], found[:, 2] == 0
        ends = outlines.corners[items][:, None] if names is outlines.places else outlines.corners[outlines.edges[items]]
        seen = np.zeros(len(owners), dtype=bool)
        for begin, end in blocks(np.full(len(owners), planes.shape[1] * ends.shape[1]), BLOCK_LINES):
            part, here = owners[begin:end], ends[begin:end]
            up = np.einsum("nki,ni->nk", here, pairs.normals[part]) - pairs.offsets[part][:, None]
            beyond = np.einsum("nki,nei->nek", here, planes[part]) - limits[part][:, :, None]
            # Planes that do not bound the hull have no normal, and nothing lies beyond them.
            inside = ~((beyond > TOLERANCE).all(axis=2) & planes[part].any(axis=2)).any(axis=1)
            seen[begin:end] = (up > TOLERANCE).any(axis=1) & inside
        result.append((owners[seen], items[seen], own[seen]))
    return result


def _edge_on(outlines, pairs, patches):
    """Lines where a polygon is seen edge-on, or that an edge in the receiver makes."""
    rows, faces = patches.T
    anchors = outlines.corners[outlines.places[outlines.starts[faces]]]
    there, across, shifts = _lines(pairs, rows, outlines.normals[faces], anchors)
    return rows[there], across, shifts, np.ones(len(there), dtype=bool)


def _lines(pairs, rows, planes, anchors):
    """Where planes (n, 3) through anchors cut the receivers of pairs `rows`: which do, and the lines.

    The lines are unit normals in the receiver, and offsets.
    """
    lengths = np.linalg.norm(planes, axis=1, keepdims=True)
    unit = planes / np.where(lengths > TOLERANCE * TOLERANCE, lengths, np.inf)
    normals = pairs.normals[rows]
    sines = np.einsum("ni,ni->n", unit, normals)
    across = unit - sines[:, None] * normals
    widths = np.linalg.norm(across, axis=1)
    widths[widths <= PARALLEL] = np.inf
    across /= widths[:, None]
    # On the receiver x is offset n + its part in the plane, so the normal's part along n moves to the offset.
    shifts = (np.einsum("ni,ni->n", unit, anchors) - sines * pairs.offsets[rows]) / widths
    over = np.einsum("nki,ni->nk", pairs.hulls[rows], across) - shifts[:, None]
    there = np.flatnonzero((over.min(axis=1) < -ON_LINE) & (over.max(axis=1) > ON_LINE))
    return there, across[there], shifts[there]


def _wedges(outlines, pairs, corners, edges):
    """Lines where a corner and an edge are seen in one place; n of both, of which some do."""
    rows, points, own = corners
    edges, own_edges = edges
    apex = outlines.corners[points]
    first, last = outlines.corners[outlines.edges[edges]].transpose(1, 0, 2)
    planes = np.cross(first - apex, last - apex)
    # Faces on either side of the plane hide each other's edge, and a face in the plane is seen edge-on.
    lengths = np.linalg.norm(planes, axis=1)
    sides = np.einsum("nfi,ni->nf", outlines.inward[edges], planes) / np.where(lengths > 0, lengths, 1)[:, None]
    shown = np.where(own_edges, np.abs(sides).min(axis=1), sides.prod(axis=1)) > 0
    shown &= (np.abs(sides) > PARALLEL).all(axis=1) & ~(own & own_edges)
    # What happens before the source must have some of it behind.
    behind = np.einsum("nki,ni->nk", pairs.sources[rows] - apex[:, None], planes)
    scale = TOLERANCE * lengths
    shown &= (behind.min(axis=1) <= scale) & (behind.max(axis=1) >= -scale)
    shown = np.flatnonzero(shown)
    there, across, shifts = _lines(pairs, rows[shown], planes[shown], apex[shown])
    return rows[shown[there]], across, shifts, np.zeros(len(there), dtype=bool)
