"""Z-buffer: which polygon is seen through each pixel of a plane, for many views and all polygons at once.

Scan conversion of whole polygons, concave ones included: each edge gives one crossing to each row of samples that it
spans, a row's crossings sorted by column pair up to spans, and the nearest polygon of each sample remains. A sample
belongs to a span from its start up to, not including, its end. Polygons that share an edge compute its crossings from
the same numbers in the same order, so that every sample along it belongs to exactly one of them.

Views may look from within the scene. A crossing behind the viewpoint is moved to the infinite end of its row, toward
which the polygon leaves the field of view: that clips exactly at a near plane through the viewpoint, so nothing is too
near to be seen. Spans are cut at the ends of the row, which clips at the edges of the view.

Depth is no sample but exact: the reciprocal of a plane's depth is linear in the image.

Cost: some 20 nanoseconds a covered sample and 100 a crossing of an edge with a row. Polygons smaller than the distance
of two samples may go unseen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment

#: Corners, crossings or samples in one block: about ten temporaries of 2 MB each.
BLOCK = 2**18

#: Distance from its plane, in sizes of the scene, within which a viewpoint sees a polygon edge-on, that is, not at all.
#: Above the rounding of a normal whose polygon is 1e-6 as wide as long; below any gap that matters.
EDGE_ON = 1e-10

#: Share of its depth by which a face seen from behind is pushed back, so that of two coincident faces the one that
#: faces the viewpoint is seen. Far above rounding, far below any thickness that matters.
BACK_FACE = 1e-9


@dataclass(frozen=True)
class Loops:
    """Planar polygons as the z-buffer reads them.

    Attributes
    ----------
    corners : (c, 3) float64
        Loops one after the other.
    offsets : (n + 1,) int64
        Loop i is ``corners[offsets[i]:offsets[i + 1]]``.
    following : (c,) int64
        Row of the next corner of the same loop.
    normals, anchors : (n, 3) float64
        Unit normals, and a point of each plane.
    edge_on : float
        Distance from its plane within which a polygon is not seen.
    """

    corners: np.ndarray
    offsets: np.ndarray
    following: np.ndarray
    normals: np.ndarray
    anchors: np.ndarray
    edge_on: float

    @classmethod
    def of(cls, environment: Environment) -> Loops:
        """All polygons of an environment; those without area are never seen, as their normals are 0."""
        corners = environment.vertices
        size = np.ptp(corners, axis=0).max()
        edge_on = EDGE_ON * size + 8 * np.finfo(np.float64).eps * np.abs(corners).max()
        counts = np.array([len(loop) for loop in environment.polygons])
        return cls._joined(corners, counts, environment.normals, environment.centroids, float(edge_on))

    def select(self, rows: np.ndarray) -> Loops:
        """The polygons of these rows, in their order."""
        counts = np.diff(self.offsets)[rows]
        corners = self.corners[ranges(self.offsets[rows], counts)[1]]
        return self._joined(corners, counts, self.normals[rows], self.anchors[rows], self.edge_on)

    @classmethod
    def _joined(cls, corners, counts, normals, anchors, edge_on):
        offsets = np.concatenate(([0], np.cumsum(counts)))
        following = np.arange(len(corners)) + 1
        following[offsets[1:] - 1] = offsets[:-1]
        return cls(corners, offsets, following, normals, anchors, edge_on)

    def __len__(self) -> int:
        return len(self.normals)


def item_buffer(
    viewpoints: np.ndarray,
    projections: np.ndarray,
    loops: Loops,
    columns: np.ndarray,
    rows: np.ndarray,
    drawn: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Polygon seen through each sample of each view, and its depth.

    Parameters
    ----------
    viewpoints : (v, 3) float
    projections : (v, 3, 3) float
        Matrices that take a point, relative to the viewpoint, to image coordinates times depth, and depth: the point
        (x, y, z) after it appears at (x / z, y / z). A rotation looks along its third row; a window within the view is
        a projection, too. Must be invertible.
    loops : Loops
    columns : (w,) or (h, w) float
        Ascending horizontal positions of the samples, for all rows or for each row its own.
    rows : (h,) float
        Ascending vertical positions of the samples.
    drawn : (v, n) bool, optional
        Polygons that each view draws; all when left out. Pays where they are few.

    Returns
    -------
    items : (v, h, w) int32
        Rows of `loops`, -1 where nothing is seen.
    depths : (v, h, w) float64
        Third coordinate after projection, infinite where nothing is seen.
    """
    viewpoints, projections = np.asarray(viewpoints, dtype=np.float64), np.asarray(projections, dtype=np.float64)
    grid = _Grid(np.asarray(columns, dtype=np.float64), np.asarray(rows, dtype=np.float64))
    count = len(viewpoints)
    nearness = np.zeros(count * grid.size)
    items = np.full(count * grid.size, -1, np.int32)
    step = max(1, BLOCK // (len(loops.corners) + grid.size))
    for start in range(0, count, step):
        part = slice(start, min(start + step, count))
        block = slice(part.start * grid.size, part.stop * grid.size)
        chosen = None if drawn is None else drawn[part]
        _draw(viewpoints[part], projections[part], loops, grid, nearness[block], items[block], chosen)
    shape = (count, grid.height, grid.width)
    with np.errstate(divide="ignore"):
        return items.reshape(shape), (1 / nearness).reshape(shape)


class _Grid:
    """Samples of a view, and which of them lie beyond a position."""

    def __init__(self, columns: np.ndarray, rows: np.ndarray):
        self.rows = rows
        self.height, self.width = len(rows), columns.shape[-1]
        self.size = self.height * self.width
        self.low, self.high = columns.min(), columns.max()
        self.columns = np.broadcast_to(columns, (self.height, self.width)).ravel()
        self._shared = columns if columns.ndim == 1 else None
        if self._shared is None:
            # Rows laid end to end make one ascending list, so that one search serves all of them.
            self._stride = 2 * (self.high - self.low) + 1
            self._search = self.columns + np.repeat(np.arange(self.height) * self._stride, self.width)

    def column(self, positions: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Number of samples to the left of each position (k,) in its row (k,)."""
        if self._shared is not None:
            return np.searchsorted(self._shared, positions)
        margin = self._stride / 4
        inside = np.clip(positions, self.low - margin, self.high + margin)
        return np.searchsorted(self._search, inside + rows * self._stride) - rows * self.width


def ranges(starts: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All numbers of some ranges, one range after the other: which range (k,) and which number (k,)."""
    ends = np.cumsum(lengths)
    which = np.repeat(np.arange(len(lengths)), lengths)
    return which, np.arange(len(which)) + (starts - (ends - lengths))[which]


def _groups(lengths: np.ndarray):
    """Slices of consecutive items whose lengths add up to at most a block, or that hold one item only."""
    ends = np.cumsum(lengths)
    start = 0
    while start < len(lengths):
        before = ends[start] - lengths[start]
        stop = max(int(np.searchsorted(ends, before + BLOCK, side="right")), start + 1)
        yield slice(start, stop)
        start = stop


def _draw(viewpoints, projections, loops, grid, nearness, items, drawn):
    """Draw polygons in some views: update their `nearness`, which is 1 / depth, and `items`, both flat."""
    find = _all_in_view if drawn is None else _drawn_in_view
    views, polygons, heights, corners, ends = find(viewpoints, projections, loops, grid, drawn)
    if not len(views):
        return
    # The plane n . p = h becomes N . (x, y, z) = h, so 1 / z is N . (X, Y, 1) / h at the image point (X, Y).
    planes = np.einsum("kij,kj->ki", _cofactors(projections)[views], loops.normals[polygons]) / heights[:, None]
    planes[heights > 0] *= 1 - BACK_FACE
    pairs = np.repeat(np.arange(len(views)), np.diff(loops.offsets)[polygons])
    # The loops of all pairs lie end to end, too, so an edge's second end is the entry of the next corner.
    ahead = np.arange(len(corners)) + loops.following[corners] - corners
    edges = _edge_rows(ends, ahead, pairs, grid)
    spanned = np.bincount(edges[1], edges[3] - edges[2], len(views)).astype(np.int64)
    for group in _groups(spanned):
        whole = group == slice(0, len(views))
        part = edges if whole else [a[(edges[1] >= group.start) & (edges[1] < group.stop)] for a in edges]
        _fill(_spans(ends, ahead, part, planes, grid), views, polygons, planes, grid, nearness, items)


def _all_in_view(viewpoints, projections, loops, grid, _):
    """Pairs of a view and a polygon that may appear in it, views ascending.

    Returns views (k,), polygons (k,), heights (k,) of the polygons' planes above the viewpoints, their corners (c,) one
    after the other, and these after projection (3, c).
    """
    # Coordinates come first: the product of small matrices with long ones is fast, that of long with small is not.
    local = np.matmul(projections, loops.corners.T - viewpoints[:, :, None])
    beyond = _beyond(*(local[:, i] for i in range(3)), grid)
    views, polygons = np.nonzero(np.bitwise_and.reduceat(beyond, loops.offsets[:-1], axis=1) == 0)
    views, polygons, heights = _off_edge(viewpoints, loops, views, polygons)
    pairs, corners = ranges(loops.offsets[polygons], np.diff(loops.offsets)[polygons])
    return views, polygons, heights, corners, local[views[pairs], :, corners].T


def _drawn_in_view(viewpoints, projections, loops, grid, drawn):
    """`_all_in_view` among the pairs of `drawn` (v, n)."""
    views, polygons, heights = _off_edge(viewpoints, loops, *np.nonzero(drawn))
    counts = np.diff(loops.offsets)[polygons]
    pairs, corners = ranges(loops.offsets[polygons], counts)
    views_of = views[pairs]
    rays = [loops.corners[corners, i] - viewpoints[views_of, i] for i in range(3)]
    ends = np.empty((3, len(corners)))
    for i in range(3):
        x, y, z = (projections[views_of, i, j] * rays[j] for j in range(3))
        ends[i] = x + y + z
    inside = np.bitwise_and.reduceat(_beyond(*ends, grid), np.cumsum(counts) - counts) == 0
    kept = np.repeat(inside, counts)
    return views[inside], polygons[inside], heights[inside], corners[kept], ends[:, kept]


def _off_edge(viewpoints, loops, views, polygons):
    """Those pairs whose polygon is not seen edge-on, and the heights of their planes above the viewpoints."""
    heights = np.einsum("ki,ki->k", loops.anchors[polygons] - viewpoints[views], loops.normals[polygons])
    seen = np.flatnonzero(np.abs(heights) > loops.edge_on)
    return views[seen], polygons[seen], heights[seen]


def _beyond(x: np.ndarray, y: np.ndarray, z: np.ndarray, grid: _Grid) -> np.ndarray:
    """Borders of the view beyond which points lie, one bit each, and one for behind it.

    What all corners of a polygon have in common is left of them after a bitwise and: where that is anything, the
    polygon does not appear.
    """
    beyond = (z <= 0).view(np.uint8)
    sides = (x < grid.low * z, x > grid.high * z, y < grid.rows[0] * z, y > grid.rows[-1] * z)
    for bit, side in enumerate(sides, 1):
        beyond |= side.view(np.uint8) << np.uint8(bit)
    return beyond


def _cofactors(projections: np.ndarray) -> np.ndarray:
    """Transposed inverses of matrices (v, 3, 3), which take normals where the matrices take points."""
    one, two, three = (projections[:, i] for i in range(3))
    rows = np.stack((np.cross(two, three), np.cross(three, one), np.cross(one, two)), axis=1)
    return rows / np.einsum("vi,vi->v", rows[:, 0], one)[:, None, None]


def _edge_rows(ends, ahead, pairs, grid):
    """Edges by the rows they cross: (edge, pair, first row, row after the last), each (k,).

    The plane through the viewpoint and a row parts an edge when its ends lie on different sides. In front of the
    viewpoint, rows below a corner have it above them; behind, rows above the corner's image do.
    """
    # A corner beside the viewpoint lies infinitely high or low in the image.
    depth = np.where(ends[2] == 0, np.finfo(np.float64).tiny, ends[2])
    with np.errstate(over="ignore"):
        image = ends[1] / depth
    front = depth > 0
    rank = np.empty(len(pairs), np.int64)
    rank[front] = np.searchsorted(grid.rows, image[front], side="right")
    rank[~front] = np.searchsorted(grid.rows, image[~front])
    low, high = np.minimum(rank, rank[ahead]), np.maximum(rank, rank[ahead])
    # An edge that passes the viewpoint's side leaves the image at one end and comes back at the other.
    passing = np.flatnonzero(front != front[ahead])
    first, last = low.copy(), high.copy()
    first[passing], last[passing] = 0, low[passing]
    edge = np.concatenate((np.arange(len(pairs)), passing))
    first, last = np.concatenate((first, high[passing])), np.concatenate((last, np.full(len(passing), grid.height)))
    crossing = np.flatnonzero(first < last)
    edge = edge[crossing]
    # The end that comes first is the same whichever way round a polygon runs along the edge.
    swap = np.where(front == front[ahead], rank < rank[ahead], ~front)[edge]
    return np.where(swap, ~edge, edge), pairs[edge], first[crossing], last[crossing]


def _spans(ends, ahead, edges, planes, grid):
    """Spans of samples: pair, row, first column, column after the last, each (s,)."""
    edge, pair, first, last = edges
    which, row = ranges(first, last - first)
    swapped = edge < 0
    one = np.where(swapped, ~edge, edge)
    one, other = np.where(swapped, ahead[one], one), np.where(swapped, one, ahead[one])
    x, y, z = (ends[i, one][which] for i in range(3))
    along_x, along_y, along_z = ((ends[i, other] - ends[i, one])[which] for i in range(3))
    level = grid.rows[row]
    over, drop = y - level * z, level * along_z - along_y
    share = np.clip(over / np.where(drop == 0, 1, drop), 0, 1)
    x, z = x + share * along_x, z + share * along_z
    pair = pair[which]
    # Where a row's line on the polygon's plane comes to the viewpoint's side, N . (x, y, 0) = h tells x.
    leaving = np.copysign(np.inf, planes[pair, 0])
    with np.errstate(over="ignore"):
        position = np.where(z > 0, x / np.where(z > 0, z, 1), leaving)
    key = (pair * grid.height + row) * (grid.width + 1) + grid.column(position, row)
    key.sort()
    start, length = key[0::2], key[1::2] - key[0::2]
    start, length = start[length > 0], length[length > 0]
    line, column = np.divmod(start, grid.width + 1)
    return *np.divmod(line, grid.height), column, length


def _fill(spans, views, polygons, planes, grid, nearness, items):
    """Write spans where they are nearer than what was drawn before."""
    pair, row, column, length = spans
    slope = planes[pair, 0]
    base = planes[pair, 1] * grid.rows[row] + planes[pair, 2]
    start = row * grid.width + column
    shift = (views[pair]) * grid.size
    for group in _groups(length):
        which, cell = ranges(start[group], length[group])
        near = slope[group][which] * grid.columns[cell]
        near += base[group][which]
        # Rounding may put what is nearly edge-on behind the viewpoint: it stays as far away as can be.
        np.maximum(near, np.finfo(np.float64).tiny, out=near)
        cell += shift[group][which]
        owner = polygons[pair[group]][which]
        while len(cell):
            # Of several spans in one sample the last one stays; those nearer than that one try again.
            closer = np.flatnonzero(near > nearness[cell])
            cell, near, owner = cell[closer], near[closer], owner[closer]
            nearness[cell] = near
            items[cell] = owner
