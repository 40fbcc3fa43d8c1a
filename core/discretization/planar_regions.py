"""Flat regions of a triangle mesh: sets of triangles with equal key that hang together by edges and lie in one plane.

Found without comparing triangles pair by pair: planes are hashed, edges are matched by one sort, and regions are the
connected parts of what the matched edges link. A region is then measured against one plane as a whole, so that many
small bends cannot add up to a curve. Cost: O(m log m) for the triangles that share a plane with others, and one pass
for those that do not, which are most of a curved mesh.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from .edge_matching import MIX, PARTS, match_edges, next_corner

# Largest distance between a region and its plane, in units of the scene's diagonal. With an equal allowance for
# straightening borders, the merged surface stays within 1e-6 of the scene: ten times float32's rounding at that scale.
SCENE_TOLERANCE = 5e-7
# The same in units of the region itself: a small object in a big scene keeps its shape.
REGION_TOLERANCE = 1e-6
# Rounding of float32 coordinates, the precision in which meshes arrive, in units of the coordinate: two ulps.
ROUNDING = 2.4e-7
# Cells in which planes are hashed: of the normal's components, and of the distance to the origin in scene diagonals.
# Only a prefilter: equal cells are measured again, and neighbors in different cells are compared exactly.
NORMAL_CELL = 1e-4
OFFSET_CELL = 1e-5
# A second, coarser grid finds the odd triangle that rounding pushed out of its plane's cells.
COARSE = 10.0
# Cosine of the largest angle between neighbors in one region, about 8 degrees: noise on small triangles, not a shape.
LARGEST_BEND = 0.99
# Fewer triangles than this can hardly shrink: a quadrilateral takes two anyway.
SMALLEST_REGION = 4

_CHUNK = 1 << 16  # triangles per block: their corners fit into the processor's cache


@dataclass(frozen=True)
class PlanarRegions:
    """Flat regions and the half-edges around them.

    Parameters
    ----------
    triangles : (k,) int64
        Triangles that were looked at; all others share their plane with nobody.
    labels : (k,) int32
        Region of each of them, -1 for none.
    normals : (r, 3) float64
        Unit normal of each region.
    tolerances : (r,) float64
        How far the surface may move at each region, in scene units.
    border_origins, border_targets : (b,) int32
        Vertices of the half-edges on the borders of regions, the region to their left, vertices at equal positions
        given one number.
    border_regions : (b,) int32
    weld : (n,) int32
        That number for each vertex of the mesh, a row of the vertices.
    """

    triangles: np.ndarray
    labels: np.ndarray
    normals: np.ndarray
    tolerances: np.ndarray
    border_origins: np.ndarray
    border_targets: np.ndarray
    border_regions: np.ndarray
    weld: np.ndarray


def find_planar_regions(vertices: np.ndarray, triangles: np.ndarray, keys: np.ndarray) -> PlanarRegions | None:
    """Regions of triangles with equal key in one plane, connected by edges; None when there are none.

    Parameters
    ----------
    vertices : (n, 3) float64
    triangles : (m, 3) int32
    keys : (m,) int

    Notes
    -----
    Triangles that are not finite or have no area belong to no region.
    """
    size = scene_size(vertices, triangles)
    if size <= 0.0:
        return None
    cells, coarse_cells = _plane_cells(vertices, triangles, keys, size)
    shared = _is_shared(coarse_cells)
    del coarse_cells
    shared |= _is_shared(cells)
    candidates = np.flatnonzero(shared).astype(np.int32)
    if len(candidates) < SMALLEST_REGION:
        return None
    # Nothing is copied where all are looked at.
    rows = slice(None) if len(candidates) == len(triangles) else candidates
    cells, keys, corners = cells[rows], np.asarray(keys)[rows], triangles[rows]
    twins, weld = match_edges(vertices, triangles, candidates, corners, keys, cells)
    links = _links(vertices, corners, cells, twins, size)
    del cells
    labels, big, flat, planes, tolerances = _measure(vertices, corners, _components(links, twins), size)
    failed = (big & ~flat)[labels]
    if failed.any():
        # Cells took in triangles of two planes; now only neighbors that lie in each other's plane stay together.
        links = np.where(np.repeat(failed, 3), _links(vertices, corners, None, twins, size), links)
        labels, big, flat, planes, tolerances = _measure(vertices, corners, _components(links, twins), size)
    if not flat.any():
        return None
    del links
    labels = np.where(flat, np.cumsum(flat) - 1, -1).astype(np.int32)[labels]
    half_edges = _border_edges(labels, twins)
    return PlanarRegions(
        triangles=candidates,
        labels=labels,
        normals=planes[flat],
        tolerances=tolerances[flat],
        border_origins=weld[corners.ravel()[half_edges]],
        border_targets=weld[corners.ravel()[next_corner(half_edges)]],
        border_regions=labels[half_edges // 3],
        weld=weld,
    )


def _border_edges(labels, twins):
    """Half-edges of regions whose twin belongs to another or to none."""
    parts = []
    for start in range(0, len(labels), _CHUNK):
        own = np.repeat(labels[start : start + _CHUNK], 3)
        other = twins[3 * start : 3 * start + len(own)]
        other = np.where(other >= 0, labels[other // 3], -2)
        parts.append(3 * start + np.flatnonzero((other != own) & (own >= 0)))
    return np.concatenate(parts)


def scene_size(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Diagonal of the box around all finite vertices that triangles use; 0 when there are none."""
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles.ravel()] = True
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for axis in range(3):
        values = vertices[:, axis]
        values = values[used & np.isfinite(values)]
        if len(values) == 0:
            return 0.0
        low[axis], high[axis] = values.min(), values.max()
    return float(np.linalg.norm(high - low))


def _plane_cells(vertices, triangles, keys, size):
    """A number for the plane and the key of each triangle, 0 where it spans no plane: on a fine and a coarse grid."""
    grids = np.zeros(len(triangles), dtype=np.uint64), np.zeros(len(triangles), dtype=np.uint64)
    cell_sizes = np.array([NORMAL_CELL, NORMAL_CELL, NORMAL_CELL, OFFSET_CELL * size])
    columns = [np.ascontiguousarray(vertices[:, axis]) for axis in range(3)]
    center = np.array([np.mean(column[np.isfinite(column)]) for column in columns])
    with np.errstate(invalid='ignore', divide='ignore', over='ignore'):
        for start in range(0, len(triangles), _CHUNK):
            rows = slice(start, start + _CHUNK)
            block = triangles[rows]
            x, y, z = ([column[block[:, k]] for k in range(3)] for column in columns)
            ux, uy, uz = x[1] - x[0], y[1] - y[0], z[1] - z[0]
            vx, vy, vz = x[2] - x[0], y[2] - y[0], z[2] - z[0]
            nx, ny, nz = _cross(ux, uy, uz, vx, vy, vz)
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            # Below this the normal is rounding: height under a 1e-12th of the longest edge.
            longest = np.maximum(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
            spans = np.isfinite(length) & (length > 1e-12 * longest)
            length[~spans] = 1.0
            # No plane, no number: zeros, so that the casts below stay defined.
            nx, ny, nz = (np.where(spans, component / length, 0.0) for component in (nx, ny, nz))
            offset = nx * (x[0] - center[0]) + ny * (y[0] - center[1]) + nz * (z[0] - center[2])
            offset = np.where(spans, offset, 0.0)
            key = np.asarray(keys[rows]).astype(np.int64).view(np.uint64) * MIX[0]
            for grid, factor in zip(grids, (1.0, COARSE), strict=True):
                mixed = key
                for value, cell in zip((nx, ny, nz, offset), cell_sizes * factor, strict=True):
                    # Half a cell of shift: common planes, axis-aligned ones, lie inside of cells and not between two.
                    whole = np.floor(value / cell + 0.5).astype(np.int64).view(np.uint64)
                    mixed = (mixed ^ whole) * MIX[1]
                    mixed ^= mixed >> np.uint64(29)
                grid[rows] = np.where(spans, mixed | np.uint64(1), np.uint64(0))
    return grids


def _is_shared(cells):
    """Whether the cell of each triangle holds at least three, by counting hash buckets; a few others slip through."""
    bits = int(np.clip(np.ceil(np.log2(len(cells) + 1)) + 2, 8, 22))
    buckets = (cells >> np.uint64(64 - bits)).astype(np.int32)
    buckets[cells == 0] = -1
    part = 1 << (bits - 3)
    shared = np.zeros(1 << bits, dtype=bool)
    for start in range(0, 1 << bits, part):
        counts = np.bincount(buckets[(buckets >= start) & (buckets < start + part)] - start, minlength=part)
        # Less than SMALLEST_REGION: what is flat but noisy may spread over cells.
        shared[start : start + part] = counts >= 3
    return shared[buckets] & (buckets >= 0)


def _links(vertices, corners, cells, twins, size):
    """(3 k,) bool: half-edges across which the neighbor may share the region.

    Neighbors of one cell may; others, and all where `cells` is None, only if they lie in each other's plane.
    """
    links = twins >= 0
    parted = []
    for start in range(0, len(twins), 3 * _CHUNK):
        linked = links[start : start + 3 * _CHUNK]
        other = twins[start : start + 3 * _CHUNK] // 3
        own = np.arange(start, start + len(other), dtype=np.int32) // 3
        linked &= other != own
        doubt = start + np.flatnonzero(linked if cells is None else linked & (cells[own] != cells[other]))
        parted.append(doubt[_is_parted(vertices, corners, twins, doubt, size)])
    parted = np.concatenate(parted)
    # On either side of the edge.
    links[parted] = links[twins[parted]] = False
    return links


def _is_parted(vertices, corners, twins, doubt, size):
    """Whether the triangles on both sides of half-edges `doubt` lie in different planes."""
    twin = twins[doubt]
    normal, base = _unit_normals(vertices, corners[doubt // 3])
    other_normal, _ = _unit_normals(vertices, corners[twin // 3])
    apex = vertices[corners.ravel()[twin // 3 * 3 + (twin + 2) % 3]]
    height = np.abs(np.einsum('ij,ij->i', normal, apex - base))
    reach = np.abs(apex - base).max(axis=1)
    allowed = np.minimum(SCENE_TOLERANCE * size, REGION_TOLERANCE * reach + ROUNDING * np.abs(apex).max(axis=1))
    # The angle too: among triangles smaller than the tolerance, heights say nothing.
    return (height > allowed) | (np.einsum('ij,ij->i', normal, other_normal) < LARGEST_BEND)


def _unit_normals(vertices, corners):
    base = vertices[corners[:, 0]]
    normals = np.cross(vertices[corners[:, 1]] - base, vertices[corners[:, 2]] - base)
    return normals / np.linalg.norm(normals, axis=1)[:, None], base


def _neighbors(links, twins, triangles):
    """(k, 3) the linked neighbor across each edge of a slice of triangles, the triangle itself where there is none."""
    part = slice(3 * triangles.start, 3 * triangles.stop)
    own = np.arange(part.start, part.start + len(links[part]), dtype=np.int32) // 3
    return np.where(links[part], twins[part] // 3, own).reshape(-1, 3)


def _components(links, twins):
    """Smallest triangle of the connected part that each triangle belongs to, from symmetric links."""
    blocks = [slice(start, start + _CHUNK) for start in range(0, len(links) // 3, _CHUNK)]
    parents = _flatten(np.concatenate([_neighbors(links, twins, block).min(axis=1) for block in blocks]))
    crossing = []
    for block in blocks:
        apart = parents[block, None] != parents[_neighbors(links, twins, block)]
        crossing.append(3 * block.start + np.flatnonzero(apart))
    crossing = np.concatenate(crossing)
    own, other = crossing // 3, twins[crossing] // 3
    while len(own):
        a, b = parents[own], parents[other]
        # Any of several writers may win: each sets a root's parent to a smaller root, which can never close a circle,
        # and in the end the smallest is everybody's parent.
        parents[np.maximum(a, b)] = np.minimum(a, b)
        parents = _flatten(parents)
        apart = parents[own] != parents[other]
        own, other = own[apart], other[apart]
    return parents


def _flatten(parents):
    while True:
        grand = parents[parents]
        if np.array_equal(grand, parents):
            return parents
        parents = grand


def _planes(vertices, corners, labels, count, size):
    """Normals (count, 3), tolerances (count,) and whether each region lies in its plane, for labels below `count`."""
    sizes = np.bincount(labels[labels >= 0], minlength=count)
    ends = np.concatenate([[0], np.cumsum(sizes)])
    normals, tolerances, flat = np.zeros((count, 3)), np.zeros(count), np.zeros(count, dtype=bool)
    for first, last in _groups(ends, max(ends[-1] // PARTS, _CHUNK)):
        rows = np.flatnonzero((labels >= first) & (labels < last)).astype(np.int32)
        if last - first > 1:
            # A radix sort, where the numbers fit into 16 bits.
            names = (labels[rows] - first).astype(np.uint16 if last - first <= 1 << 16 else np.int64)
            rows = rows[np.argsort(names, kind='stable')]
        for start, stop in _groups(ends[first : last + 1] - ends[first], _CHUNK):
            block = slice(first + start, first + stop)
            members = corners[rows[ends[block.start] - ends[first] : ends[block.stop] - ends[first]]]
            normals[block], tolerances[block], flat[block] = _region_planes(vertices, members, sizes[block], size)
    return normals, tolerances, flat


def _groups(ends, least):
    """First and last of consecutive regions that together hold about `least` triangles or more."""
    marks = np.searchsorted(ends[:-1], np.arange(0, ends[-1], least))
    return itertools.pairwise(np.unique(np.append(marks, len(ends) - 1)))


def _region_planes(vertices, members, sizes, size):
    """As `_planes`, of regions whose triangles (k, 3) follow one another, `sizes` (r,) of each."""
    ends = np.cumsum(sizes)
    starts = ends - sizes
    # Seen from the region's first corner: far from the world's origin the products would lose digits.
    origin = vertices[members[starts, 0]]
    parts = []
    for start in range(0, len(members), _CHUNK):
        stop = min(start + _CHUNK, len(members))
        held = slice(np.searchsorted(ends, start, side='right'), np.searchsorted(starts, stop))
        inner = np.maximum(starts[held] - start, 0)
        which = np.repeat(np.arange(held.start, held.stop), np.minimum(ends[held] - start, stop - start) - inner)
        parts.append((slice(start, stop), held, inner, which))

    def places(rows, which):
        return [
            [vertices[:, axis][members[rows, corner]] - origin[:, axis][which] for corner in range(3)]
            for axis in range(3)
        ]

    areas = np.empty((3, len(members)))
    low, high = np.full(origin.shape, np.inf), np.full(origin.shape, -np.inf)
    for rows, held, inner, which in parts:
        x, y, z = places(rows, which)
        areas[:, rows] = _cross(x[1] - x[0], y[1] - y[0], z[1] - z[0], x[2] - x[0], y[2] - y[0], z[2] - z[0])
        _widen(low[held], high[held], (x, y, z), inner)
    vector = np.stack([np.add.reduceat(area, starts) for area in areas], axis=1)
    length = np.linalg.norm(vector, axis=1)
    vector /= np.where(length > 0.0, length, 1.0)[:, None]
    bottom, top = np.full((len(sizes), 1), np.inf), np.full((len(sizes), 1), -np.inf)
    least = np.full(len(sizes), np.inf)
    for rows, held, inner, which in parts:
        if len(parts) > 1:
            x, y, z = places(rows, which)
        nx, ny, nz = (vector[:, axis][which] for axis in range(3))
        heights = [x[corner] * nx + y[corner] * ny + z[corner] * nz for corner in range(3)]
        _widen(bottom[held], top[held], [heights], inner)
        facing = areas[0, rows] * nx + areas[1, rows] * ny + areas[2, rows] * nz
        np.minimum(least[held], np.minimum.reduceat(facing, inner), out=least[held])
    magnitude = np.maximum(np.abs(low + origin), np.abs(high + origin)).max(axis=1)
    extent = np.linalg.norm(high - low, axis=1)
    tolerances = np.minimum(SCENE_TOLERANCE * size, REGION_TOLERANCE * extent + ROUNDING * magnitude)
    return vector, tolerances, (least > 0.0) & ((top - bottom)[:, 0] <= tolerances)


def _widen(low, high, columns, starts):
    """Widen the ranges (r, n) of n columns, each given at three corners, of the triangles from each start on."""
    for axis, column in enumerate(columns):
        np.minimum(low[:, axis], _extreme(np.minimum, column, starts), out=low[:, axis])
        np.maximum(high[:, axis], _extreme(np.maximum, column, starts), out=high[:, axis])


def _extreme(extreme, columns, starts):
    return extreme.reduceat(extreme(extreme(columns[0], columns[1]), columns[2]), starts)


def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def _measure(vertices, corners, parts, size):
    """Consecutive numbers for connected parts; of each, whether it is worth a look and flat, its normal, tolerance."""
    present = np.zeros(len(parts), dtype=bool)
    present[parts] = True
    labels = np.cumsum(present, dtype=np.int32)[parts]
    labels -= 1
    del parts
    big = np.bincount(labels) >= SMALLEST_REGION
    flat = np.zeros(len(big), dtype=bool)
    normals, tolerances = np.zeros((len(big), 3)), np.zeros(len(big))
    if big.any():
        chosen = np.where(big, np.cumsum(big) - 1, -1).astype(np.int32)[labels]
        normals[big], tolerances[big], flat[big] = _planes(vertices, corners, chosen, int(big.sum()), size)
    return labels, big, flat, normals, tolerances
