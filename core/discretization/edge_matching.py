"""Which half-edges run along each other: by one sort of edges, over vertices welded where meshes were split.

Half-edge 3 t + k leaves corner k of triangle t for the next one. Cost: O(n log n), in parts that bound the memory.
"""

from __future__ import annotations

import itertools

import numpy as np

# Parts in which edges are matched: each takes an eighth of the memory, and one look at all edges.
PARTS = 8
# Odd numbers of 64 bits that mix hashes.
MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)


def match_edges(vertices, triangles, candidates, corners, keys, cells):
    """Twin of each half-edge (-1 for none) and the welded number of each vertex.

    Vertices at the same position are told apart only by what lies between: meshes split there for their normals or
    UVs. Welding is dear, so it is done for those that lie on an edge without a twin.
    """
    origins = corners.ravel()
    twins = np.full(len(origins), -1, dtype=np.int32)
    _pair_all(twins, None, corners, keys, cells, len(vertices))
    open_edges = np.flatnonzero(twins < 0).astype(np.int32)
    weld = np.arange(len(vertices), dtype=np.int32)
    if len(open_edges) == 0:
        return twins, weld
    on_border = np.zeros(len(vertices), dtype=bool)
    on_border[origins[open_edges]] = True
    on_border[origins[next_corner(open_edges)]] = True
    others = np.ones(len(triangles), dtype=bool)
    others[candidates] = False
    elsewhere = np.zeros(len(vertices), dtype=bool)
    elsewhere[triangles[others].ravel()] = True
    if _weld(weld, vertices, on_border, elsewhere):
        _pair_all(twins, open_edges, weld[corners], keys, cells, len(vertices))
    return twins, weld


def next_corner(half_edges):
    """Half-edges that follow in the same triangle."""
    return half_edges + np.where(half_edges % 3 == 2, -2, 1).astype(half_edges.dtype)


def _pair_all(twins, half_edges, corners, keys, cells, vertex_count):
    """Write the twins of `half_edges`, or of all where that is None: an edge belongs to its lower vertex, and those of
    a range of vertices are matched at a time."""
    following = corners[:, [1, 2, 0]]
    lower = np.minimum(corners, following).ravel() if half_edges is None else None
    del following
    if half_edges is not None:
        origins = corners.ravel()
        lower = np.minimum(origins[half_edges], origins[next_corner(half_edges)])
    bounds = np.linspace(0, vertex_count, PARTS + 1).astype(np.int64)
    for low, high in itertools.pairwise(bounds):
        part = np.flatnonzero((lower >= low) & (lower < high)).astype(np.int32)
        if len(part):
            _pair(twins, part if half_edges is None else half_edges[part], corners, keys, cells, vertex_count)


def _pair(twins, half_edges, corners, keys, cells, vertex_count):
    """Write the twins of `half_edges`: the same edge run the other way by a triangle with the same key."""
    origins = corners.ravel()
    first, second = origins[half_edges], origins[next_corner(half_edges)]
    edges = np.minimum(first, second).astype(np.uint64)
    edges *= np.uint64(vertex_count)
    edges += np.maximum(first, second).astype(np.uint64)
    del first, second
    index_bits = np.uint64(max(1, int(len(half_edges) - 1).bit_length()))
    if int(index_bits) + int(vertex_count * vertex_count).bit_length() <= 64:
        # Edge and index in one number: sorting it is several times faster than an argsort.
        edges <<= index_bits
        edges |= np.arange(len(edges), dtype=np.uint64)
        edges.sort()
        order = half_edges[(edges & np.uint64((1 << int(index_bits)) - 1)).astype(np.int32)]
        edges >>= index_bits
    else:
        order = np.argsort(edges, kind='stable')
        edges, order = edges[order], half_edges[order]
    same = np.zeros(len(edges) + 1, dtype=bool)
    np.equal(edges[1:], edges[:-1], out=same[1:-1])
    # Row i is the first of exactly two equal ones.
    first = ~same[:-1]
    first &= same[1:]
    first[:-1] &= ~same[2:]
    pairs = np.flatnonzero(first)
    _write_pairs(twins, order[pairs], order[pairs + 1], origins, keys)
    third = same[1:-1] & same[:-2]
    if not third.any():
        return
    group = np.cumsum(~same[:-1]) - 1
    # Three faces or more at one edge, a wall on a floor: those of one plane belong together.
    crowded = np.zeros(len(edges), dtype=bool)
    crowded[group[np.flatnonzero(third)]] = True
    rows = np.flatnonzero(crowded[group])
    members = order[rows]
    by_plane = np.lexsort((cells[members // 3], keys[members // 3], edges[rows]))
    members, edges = members[by_plane], edges[rows][by_plane]
    faces = members // 3
    alike = (edges[1:] == edges[:-1]) & (keys[faces[1:]] == keys[faces[:-1]]) & (cells[faces[1:]] == cells[faces[:-1]])
    # Exactly two of one plane: more would be coincident faces, and which one continues which is anybody's guess.
    before, after = np.concatenate([[False], alike[:-1]]), np.concatenate([alike[1:], [False]])
    alone = np.flatnonzero(alike & ~before & ~after)
    _write_pairs(twins, members[alone], members[alone + 1], origins, keys)


def _write_pairs(twins, a, b, origins, keys):
    fits = (origins[a] != origins[b]) & (keys[a // 3] == keys[b // 3])
    a, b = a[fits], b[fits]
    twins[a], twins[b] = b, a


def _weld(weld, vertices, on_border, elsewhere):
    """Give border vertices at one position one number, and those of other triangles there too; whether any changed."""
    rows = np.flatnonzero(on_border)
    hashes = _position_hashes(vertices[rows])
    table = np.zeros(1 << 22, dtype=bool)
    shift = np.uint64(42)
    table[(hashes >> shift).astype(np.int64)] = True
    others = np.flatnonzero(elsewhere & ~on_border)
    other_hashes = _position_hashes(vertices[others])
    met = table[(other_hashes >> shift).astype(np.int64)]
    rows = np.concatenate([rows, others[met]])
    hashes = np.concatenate([hashes, other_hashes[met]])
    by_row = np.argsort(rows, kind='stable')
    rows, hashes = rows[by_row], hashes[by_row]
    order = np.argsort(hashes, kind='stable')
    rows, hashes = rows[order], hashes[order]
    new = np.concatenate([[True], hashes[1:] != hashes[:-1]])
    leaders = rows[np.maximum.accumulate(np.where(new, np.arange(len(rows)), 0))]
    equal = (vertices[rows] == vertices[leaders]).all(axis=1)
    weld[rows[equal]] = leaders[equal]
    return bool((weld[rows] != rows).any())


def _position_hashes(positions):
    bits = np.ascontiguousarray(positions + 0.0).view(np.uint64)  # + 0.0: minus zero is zero
    mixed = np.zeros(len(bits), dtype=np.uint64)
    for axis in range(3):
        mixed = (mixed ^ bits[:, axis]) * MIX[axis]
        mixed ^= mixed >> np.uint64(31)
    return mixed * MIX[0]
