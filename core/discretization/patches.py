"""Patches: the geometric unit that acts as an illuminator (survey, figure 14), made from the traced triangles.

A big triangle is divided into k * k equal cells; small triangles that lie near each other, face the same way and look
the same are clustered into one patch. Either way a ray's hit (triangle, u, v) leads to its patch by arithmetic alone.
Nothing of this touches the artist's mesh.

Where something stands on a cell, a wall's foot or a table's leg, the cell is split once more, so that light on one side
does not count for the other.

Every patch has a front and a back. Row i of a table is the front of patch i, row ``count + i`` its back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..keys import row_keys
from ..visibility.embree import OFFSET

#: Sample points per patch, one in each quarter of a cell.
POINTS = 4

#: Parts into which the side of a cell is cut that something stands on.
SPLIT = 4

#: A call of `split_cells` adds at most this many times the patches wanted. With half of it, the wall behind a shining
#: window of a cluttered garage stayed whole, and what it got behind the pane lit the room.
GROWTH = 3.0

#: Small triangles stay patches of their own while there are at most this many times the patches wanted: clusters lump
#: together what lies close, and the inside of a shelf is not lit as its front.
FREE_TRIANGLES = 4

#: Normals are grouped by rounding this multiple of them, so that a cluster's normals lie within about 30 degrees.
NORMAL_STEPS = 2.0

#: Triangles measured at a time.
BLOCK = 65536

#: Divisions of a triangle's side are kept below this, so that cell numbers within a triangle stay exact in float32.
MAX_DIVISIONS = 1024


@dataclass(frozen=True)
class Patches:
    """Patches over m traced triangles, in the unit frame.

    Parameters
    ----------
    count : int
        Number of patches (P).
    spacing : float
        Side that a cell is meant to have, in unit lengths.
    first : (m,) int32
        Patch of the first cell of each triangle.
    divisions : (m,) float32
        Cells along a side of each triangle, 1 where the triangle is a cell or lies in a cluster.
    areas : (P,) float64
        In unit lengths squared.
    points, normals : (P, POINTS, 3) float32
        Sample points on the front and the geometric normals there.
    point_triangles : (P, POINTS) int32
    point_weights : (P, POINTS, 3) float32
        Triangle of each sample point, and its barycentric weights there.
    cell_corners : (P, 3, 2) float64
        Weights of the triangle's second and third corner at the corners of each cell, so numbered that a place within
        it has the same weights in an inverted cell as in an upright one; unused where a patch is a cluster.
    splits : (P,) int32 or None
        First of the `SPLIT` * `SPLIT` patches that a cell was split into, -1 where it was not. A split cell has no area
        of its own any more.
    """

    count: int
    spacing: float
    first: np.ndarray
    divisions: np.ndarray
    areas: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    point_triangles: np.ndarray
    point_weights: np.ndarray
    cell_corners: np.ndarray
    splits: np.ndarray | None = None

    def at(self, triangles: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Patch (n,) int32 at hits given by triangle and barycentric weights of its second and third corner."""
        # Embree's robust test may put a hit just outside its triangle.
        u, v = np.maximum(u, 0), np.maximum(v, 0)
        k = self.divisions[triangles]
        rows = self.first[triangles]
        big = k > 1
        if big.all():
            rows += _cell(k, u, v)
        elif big.any():
            rows[big] += _cell(k[big], u[big], v[big])
        if self.splits is not None:
            self._descend(rows, k, u, v)
        return rows

    def _descend(self, rows: np.ndarray, k: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
        """Replace split cells among `rows` by the parts that the places lie in, and those by theirs."""
        which = np.nonzero(self.splits[rows] >= 0)[0]
        k, u, v = k[which], u[which], v[which]
        while len(which):
            u, v = _within_cell(k, u, v)
            k = np.full(len(which), SPLIT, np.float32)
            rows[which] = self.splits[rows[which]] + _cell(k, u, v)
            deeper = self.splits[rows[which]] >= 0
            which, k, u, v = which[deeper], k[deeper], u[deeper], v[deeper]


def _cell(k: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Number (n,) int32 of the cell within a triangle whose sides are cut into k (n,) parts.

    Row i along the second corner holds 2(k - i) - 1 cells, upright and inverted in turn.
    """
    along, up = k * u, k * v
    i, j = np.floor(along), np.floor(up)
    inverted = (along - i) + (up - j) > 1
    # The third side too may be passed by a rounding.
    i = np.minimum(i, k - 1)
    cell = i * (2 * k - i) + 2 * j + inverted
    return np.clip(cell, i * (2 * k - i), i * (2 * k - i) + 2 * (k - i) - 2).astype(np.int32)


def _within_cell(k: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric weights (n,), (n,) within the cell that holds each point, as if the cell were a triangle."""
    along, up = k * u, k * v
    s, t = along - np.floor(along), up - np.floor(up)
    inverted = s + t > 1
    return np.where(inverted, 1 - s, s), np.where(inverted, 1 - t, t)


def _triangle_shape(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(one, other)
    double = np.linalg.norm(cross, axis=1)
    third = other - one
    longest = np.sqrt(np.maximum.reduce([(e * e).sum(axis=1) for e in (one, other, third)]))
    return double / 2, cross / np.maximum(double, 1e-300)[:, None], longest


def _triangle_shapes(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, ...]:
    """Areas (m,), unit normals (m, 3), longest sides (m,) and middles (m, 3), in blocks of bounded memory."""
    count = len(triangles)
    areas, normals, longest, middles = np.empty(count), np.empty((count, 3)), np.empty(count), np.empty((count, 3))
    for start in range(0, count, BLOCK):
        part = slice(start, start + BLOCK)
        corners = vertices[triangles[part]]
        areas[part], normals[part], longest[part] = _triangle_shape(corners)
        middles[part] = corners.mean(axis=1)
    return areas, normals, longest, middles


def _divisions(areas: np.ndarray, longest: np.ndarray, size: float, most: float) -> np.ndarray:
    # A compact triangle is cut by its side; a thin one by the mean of its two extents, or it would become dust.
    extent = np.sqrt(np.sqrt(areas) * longest / 2)
    return np.clip(np.ceil(extent / size - 0.25), 1, most)


def _choose_size(areas: np.ndarray, longest: np.ndarray, target: int) -> tuple[float, np.ndarray]:
    """Side of a cell in unit lengths, and the divisions of each triangle, for about `target` cells of big triangles.

    No triangle gets more than a tenth of them: a ground plane around a house must not take the cells away from it.
    """
    most = float(min(max(2, int(np.sqrt(target / 10))), MAX_DIVISIONS))
    high = np.sqrt(areas.sum() / max(target, 1))
    low = high / 1024
    divisions = _divisions(areas, longest, high, most)
    if (divisions[divisions > 1] ** 2).sum() < target:
        for _ in range(12):
            size = np.sqrt(low * high)
            divisions = _divisions(areas, longest, size, most)
            small = areas[divisions <= 1].sum() / size**2
            if (divisions[divisions > 1] ** 2).sum() + small < target:
                high = size
            else:
                low = size
    return high, _divisions(areas, longest, high, most)


def build_patches(vertices: np.ndarray, triangles: np.ndarray, looks: np.ndarray, target: int) -> Patches:
    """Divide big triangles and cluster small ones into about `target` patches.

    Parameters
    ----------
    vertices : (n, 3) float
        In the unit frame.
    triangles : (m, 3) int
        Without zero-area triangles.
    looks : (m,) int
        Only triangles with equal numbers share a patch.
    target : int
        Patches wanted; kept within a factor of about 2.

    Returns
    -------
    Patches
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    areas, normals, longest, middles = _triangle_shapes(vertices, triangles)
    size, divisions = _choose_size(areas, longest, target)
    whole = divisions > 1
    small = np.nonzero(~whole)[0]
    if len(small) <= FREE_TRIANGLES * target:
        clusters, representatives = np.arange(len(small)), np.repeat(np.arange(len(small))[:, None], POINTS, axis=1)
    else:
        clusters, representatives = _cluster(middles[small], areas[small], normals[small], looks[small], size)

    cells = np.where(whole, divisions**2, 0).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(cells)])[:-1].astype(np.int32)
    divided = int(cells.sum())
    first[small] = divided + clusters
    count = divided + (int(clusters.max()) + 1 if len(small) else 0)

    patch_areas = np.empty(count)
    point_triangles = np.empty((count, POINTS), np.int32)
    weights = np.empty((count, POINTS, 3))
    owner = np.repeat(np.nonzero(whole)[0], cells[whole])
    patch_areas[:divided] = areas[owner] / divisions[owner] ** 2
    point_triangles[:divided] = owner[:, None]
    cell_corners = np.tile(_cell_corners(np.ones(1), np.zeros(1)), (count, 1, 1))
    cell_corners[:divided] = _cell_corners(divisions[owner], np.arange(divided) - first[owner])
    weights[:divided] = _at_cell(cell_corners[:divided], _QUARTERS)
    patch_areas[divided:] = np.bincount(clusters, weights=areas[small], minlength=count - divided)
    point_triangles[divided:] = small[representatives]
    weights[divided:] = _cluster_points(representatives)
    points = np.einsum("pcw,pcwi->pci", weights, vertices[triangles[point_triangles]])
    return Patches(
        count=count,
        spacing=float(size),
        first=first,
        divisions=divisions.astype(np.float32),
        areas=patch_areas,
        points=points.astype(np.float32),
        normals=normals[point_triangles].astype(np.float32),
        point_triangles=point_triangles,
        point_weights=weights.astype(np.float32),
        cell_corners=cell_corners,
    )


def _cell_origin(k: np.ndarray, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, place in the row, and whether inverted, of cells numbered as in `_cell`."""
    # Row i starts at i (2 k - i): solve for i, then mend what rounding did to the root.
    i = np.floor(k - np.sqrt(np.maximum(k * k - cell, 0)))
    i += cell >= (i + 1) * (2 * k - i - 1)
    i -= cell < i * (2 * k - i)
    rest = cell - i * (2 * k - i)
    return i, np.floor(rest / 2), rest % 2 > 0


def _cell_corners(k: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Weights (n, 3, 2) of a triangle's second and third corner at the corners of its cells, k (n,) along a side."""
    i, j, inverted = _cell_origin(k, cell)
    upright = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    inside = np.where(inverted[:, None, None], 1 - upright, upright)
    return (np.stack([i, j], axis=1)[:, None] + inside) / k[:, None, None]


def _at_cell(corners: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Barycentric weights (n, q, 3) in its triangle of the places `inside` (q, 2) of cells with `corners` (n, 3, 2)."""
    origin = corners[:, None, 0]
    along = corners[:, 1:] - corners[:, :1]
    uv = origin + np.einsum("qa,nab->nqb", inside, along)
    return np.concatenate([1 - uv.sum(axis=2, keepdims=True), uv], axis=2)


#: Middles of the four quarters of a triangle, as weights of its second and third corner.
_QUARTERS = np.array([[1 / 3, 1 / 3], [2 / 3, 1 / 6], [1 / 6, 2 / 3], [1 / 6, 1 / 6]])


def _cluster(middle, areas, normals, looks, size) -> tuple[np.ndarray, np.ndarray]:
    """Cluster (s,) of each small triangle, and four members (clusters, POINTS) of each, spread by area."""
    count = len(areas)
    if not count:
        return np.empty(0, np.int64), np.empty((0, POINTS), np.int64)
    place = np.floor(middle / size).astype(np.int64)
    # Parallel faces at different depths, the boards of a shelf, are kept apart by the depth of their plane.
    depth = np.floor(np.einsum("ij,ij->i", middle, normals) / (0.25 * size)).astype(np.int64)
    facing = np.rint(normals * NORMAL_STEPS).astype(np.int64)
    _, clusters = np.unique(row_keys(*place.T, *facing.T, depth, looks), return_inverse=True)
    clusters = clusters.reshape(-1)
    order = np.argsort(clusters, kind="stable")
    upto = np.cumsum(areas[order])
    starts = np.searchsorted(clusters[order], np.arange(clusters.max() + 1))
    before = upto[starts] - areas[order][starts]
    total = np.bincount(clusters, weights=areas)
    marks = before[:, None] + total[:, None] * (np.arange(POINTS) + 0.5) / POINTS
    chosen = np.searchsorted(upto, marks.ravel()).reshape(-1, POINTS)
    ends = np.concatenate([starts[1:], [count]])
    chosen = np.clip(chosen, starts[:, None], ends[:, None] - 1)
    return clusters, order[chosen]


def _cluster_points(representatives: np.ndarray) -> np.ndarray:
    """Barycentric weights (clusters, POINTS, 3): the middle of a triangle, or its quarters where it serves for all."""
    middle = np.full((len(representatives), POINTS, 3), 1 / 3)
    alone = representatives[:, 0] == representatives[:, -1]
    if alone.any():
        middle[alone] = _at_cell(_cell_corners(np.ones(1), np.zeros(1)), _QUARTERS)[0]
    return middle


def lone_cells(patches: Patches, start: int = 0) -> np.ndarray:
    """Patches (n,), those below number `start` passed over, that are one cell of one triangle."""
    owner = patches.point_triangles[:, 0]
    lone = (patches.point_triangles == owner[:, None]).all(axis=1)
    members = np.bincount(patches.first, minlength=patches.count)
    lone &= (patches.divisions[owner] > 1) | (members <= 1)
    lone[:start] = False
    return np.nonzero(lone & (patches.areas > 0))[0]


def probe_segments(patches: Patches, vertices: np.ndarray, triangles: np.ndarray, start: int = 0):
    """Segments just above each cell, along its sides and its middle, that nothing crosses unless it stands there.

    Patches below number `start` are passed over.

    Returns
    -------
    cells : (n,) int
        Those that are `lone_cells`.
    starts, segments : (n, 6, 3) float64
    """
    owner = patches.point_triangles[:, 0]
    cells = lone_cells(patches, start)
    # Sides are drawn in a little: what ends exactly on them belongs to the neighbor as well.
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    corners = corners + 0.02 * (1 / 3 - corners)
    middles = (np.roll(corners, -1, axis=0) + np.roll(corners, -2, axis=0)) / 2
    weights = _at_cell(patches.cell_corners[cells], np.concatenate([corners, middles]))
    places = np.einsum("cpw,cwi->cpi", weights, np.asarray(vertices, dtype=np.float64)[triangles[owner[cells]]])
    lift = np.maximum(4 * OFFSET, 0.005 * np.sqrt(patches.areas[cells]))
    places = places + lift[:, None, None] * patches.normals[cells][:, :1]
    starts, ends = places[:, [0, 1, 2, 0, 1, 2]], places[:, [1, 2, 0, 3, 4, 5]]
    return cells, starts, ends - starts


def split_cells(
    patches: Patches, vertices: np.ndarray, triangles: np.ndarray, cells: np.ndarray, target: int
) -> Patches:
    """Patches whose `cells` (n,), the most urgent first, are each cut into `SPLIT` * `SPLIT`, until `GROWTH` times the
    `target` have been added. What results may be split again."""
    cells = np.sort(cells[: int(GROWTH * target / SPLIT**2)])
    if not len(cells):
        return patches
    parts = SPLIT**2
    owner = np.repeat(patches.point_triangles[cells, 0], parts)
    inner = _cell_corners(np.full(parts, float(SPLIT)), np.arange(parts))
    corners = _at_cell(patches.cell_corners[cells], inner.reshape(-1, 2))[..., 1:].reshape(-1, 3, 2)
    weights = _at_cell(corners, _QUARTERS)
    points = np.einsum("cpw,cwi->cpi", weights, np.asarray(vertices, dtype=np.float64)[triangles[owner]])
    splits = np.full(patches.count + len(owner), -1, np.int32)
    if patches.splits is not None:
        splits[: patches.count] = patches.splits
    splits[cells] = patches.count + parts * np.arange(len(cells), dtype=np.int32)
    areas = np.concatenate([patches.areas, np.repeat(patches.areas[cells] / parts, parts)])
    areas[cells] = 0
    return Patches(
        count=patches.count + len(owner),
        spacing=patches.spacing,
        first=patches.first,
        divisions=patches.divisions,
        areas=areas,
        points=np.concatenate([patches.points, points.astype(np.float32)]),
        normals=np.concatenate([patches.normals, np.repeat(patches.normals[cells], parts, axis=0)]),
        point_triangles=np.concatenate([patches.point_triangles, np.repeat(owner[:, None], POINTS, axis=1)]),
        point_weights=np.concatenate([patches.point_weights, weights.astype(np.float32)]),
        cell_corners=np.concatenate([patches.cell_corners, corners]),
        splits=splits,
    )
