"""Division of big faces, so that vertices are dense enough to hold the light: each edge is cut to a maximum length.

How often an edge is cut depends on the edge alone, so neighbors agree and no vertex lies on another face's edge. A
face whose opposite edges are cut alike becomes a grid of its own shape: quadrilaterals stay quadrilaterals, long faces
are cut lengthwise only. Any other face is parted, at places where its edges are cut already, until its parts are such
grids; the cuts between parts follow the same rule of length, so no edge of the result is too long.

All new vertices are weighted means of a face's corners (`weights`), and with the same weights everything stored at
corners and vertices is carried over: linear things stay what they were. Costs are those of the result: O(faces made).
Limits: faces bent out of their plane become bilinear patches, as in Blender; others keep their surface exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .parting import Parts, part_quads, part_triangles

# Edges longer than the wanted length by this share are left: float32 coordinates cannot be cut more exactly, and a
# second run must find nothing to do.
SLACK = 1e-4
# Faces with more than four corners have long chords where edges are short. Up to this many lengths they stay whole.
LONGEST_CHORD = 2.0
# Parting ends after that many steps per bit of the largest count at most; nets of random faces need two to three.
_STEPS_PER_HALVING = 16
# Vertices that the proposed length leads to, in all selected meshes together: enough for soft shadows in a room, and
# baked in about a second.
PROPOSED_VERTICES = 20_000


@dataclass(frozen=True)
class PolygonMesh:
    """Topology of a mesh and positions in the space in which lengths count.

    Parameters
    ----------
    positions : (v, 3) float64
    edges : (e, 2) int
    face_offsets : (f + 1,) int
        Corners of face i are ``face_offsets[i]:face_offsets[i + 1]``.
    corner_vertices, corner_edges : (c,) int
        Vertex of each corner, and the edge from it to the next corner of the face.
    triangles : (t, 3) int
        Corners of the triangles that fill each face, as Blender draws it.
    triangle_faces : (t,) int
    """

    positions: np.ndarray
    edges: np.ndarray
    face_offsets: np.ndarray
    corner_vertices: np.ndarray
    corner_edges: np.ndarray
    triangles: np.ndarray
    triangle_faces: np.ndarray


@dataclass(frozen=True)
class SubdividedMesh:
    """The divided mesh, and what each of its elements is made of. The old vertices come first, unchanged.

    Parameters
    ----------
    vertex_sources : (n, 4) int32
        Old vertices that each vertex is a mean of, with `vertex_weights` (n, 4); unused ones have weight 0.
    corner_sources : (k, 4) int32
        Old corners, all of one face, with `corner_weights` (k, 4).
    corner_vertices, corner_edges : (k,) int32
    face_offsets : (m + 1,) int32
    face_sources : (m,) int32
        Old face.
    edges : (j, 2) int32
    edge_sources : (j,) int32
        Old edge that an edge is a piece of, -1 inside of faces. Pieces of old edges come first.
    """

    vertex_sources: np.ndarray
    vertex_weights: np.ndarray
    corner_sources: np.ndarray
    corner_weights: np.ndarray
    corner_vertices: np.ndarray
    corner_edges: np.ndarray
    face_offsets: np.ndarray
    face_sources: np.ndarray
    edges: np.ndarray
    edge_sources: np.ndarray


@dataclass
class _Pieces:
    """Triangles and quadrilaterals that are to be divided, and the lines that bound them."""

    corners: list[np.ndarray]  # (m, 3) and (m, 4) old corners
    lines: list[np.ndarray]  # (m, 3) and (m, 4) line from each corner to the next
    forward: list[np.ndarray]  # bool, whether the line runs that way
    line_vertices: np.ndarray  # (l, 2) old edges, then chords of faces with many corners
    line_counts: np.ndarray  # (l,) segments of each
    whole: np.ndarray  # (f,) bool: faces left as they are


def cut_counts(starts: np.ndarray, ends: np.ndarray, length: float) -> np.ndarray:
    """(n,) int64, equal segments that keep straight lines from `starts` to `ends`, (n, 3), within `length`."""
    with np.errstate(invalid='ignore', over='ignore'):
        ratio = np.linalg.norm(ends - starts, axis=-1) / length
    # Vertices that are not finite have no length to cut.
    ratio = np.where(np.isfinite(ratio), ratio, 1.0)
    return np.maximum(np.ceil(ratio - SLACK), 1.0).astype(np.int64)


def subdivide(mesh: PolygonMesh, length: float) -> SubdividedMesh | None:
    """Divide all faces so that no edge is longer than `length`; None when nothing has to be done.

    Raises
    ------
    ValueError
        If the length is not above 0.
    """
    pieces = _pieces(mesh, length)
    if pieces.whole.all():
        return None
    vertex_count = len(mesh.positions)
    inner = pieces.line_counts - 1
    line_bases = vertex_count - 1 + np.cumsum(inner) - inner
    parts = _divide(mesh, pieces, line_bases, vertex_count + int(inner.sum()), length, counting=False)
    sources, weights = _vertex_means(mesh, pieces, parts)
    order, sizes, vertices, corner_sources, corner_weights, faces = _assemble(mesh, pieces, parts)
    offsets = np.concatenate([[0], np.cumsum(sizes[order])])
    rows = np.repeat((np.cumsum(sizes) - sizes)[order] - offsets[:-1], sizes[order]) + np.arange(offsets[-1])
    vertices = vertices[rows]
    edges, edge_sources, corner_edges = _edges(mesh, pieces, line_bases, vertices, offsets, len(sources))
    return SubdividedMesh(
        vertex_sources=sources,
        vertex_weights=weights,
        corner_sources=corner_sources[rows],
        corner_weights=corner_weights[rows],
        corner_vertices=vertices.astype(np.int32),
        corner_edges=corner_edges,
        face_offsets=offsets.astype(np.int32),
        face_sources=faces[order].astype(np.int32),
        edges=edges,
        edge_sources=edge_sources,
    )


def predict_subdivision(mesh: PolygonMesh, length: float, limit: float = np.inf) -> tuple[int, int] | None:
    """Vertices and faces that `subdivide` would make, without making them. Exact.

    None as soon as the vertices pass `limit`: that makes the question cheap for lengths that are far too small.
    """
    pieces = _pieces(mesh, length)
    vertices = len(mesh.positions) + int((pieces.line_counts - 1).sum())
    if vertices > limit:
        return None
    bases = np.zeros(len(pieces.line_counts), dtype=np.int64)
    parts = _divide(mesh, pieces, bases, vertices, length, counting=True, limit=limit)
    return None if parts is None else (parts.vertex_count, int(pieces.whole.sum()) + parts.face_count)


def predict_all(meshes: Sequence[PolygonMesh], length: float, limit: float = np.inf) -> tuple[int, int] | None:
    """`predict_subdivision` for several meshes together."""
    vertices = faces = 0
    for mesh in meshes:
        counts = predict_subdivision(mesh, length, limit - vertices)
        if counts is None:
            return None
        vertices, faces = vertices + counts[0], faces + counts[1]
    return vertices, faces


def fitting_edge_length(meshes: Sequence[PolygonMesh], vertices: int, start: float = 0.0) -> float:
    """About the smallest length, in two digits, that divides the meshes into at most `vertices` vertices altogether.

    Infinity when they have more than that already.

    Parameters
    ----------
    meshes : sequence of PolygonMesh
    vertices : int
    start : float
        A length that is known to be too small; 0 for none.
    """
    if sum(len(mesh.positions) for mesh in meshes) > vertices:
        return float('inf')
    # A square grid has one vertex in each square of the length; edges of faces and their forms add to that.
    length = max(start, np.sqrt(sum(_area(mesh) for mesh in meshes) / vertices))
    if not length > 0.0:
        return float('inf')
    while predict_all(meshes, length, vertices) is None:
        length *= 1.15
    digits = 10.0 ** (np.floor(np.log10(length)) - 1.0)
    return float(f"{np.ceil(length / digits - 1e-9) * digits:.1e}")


def proposed_edge_length(meshes: Sequence[PolygonMesh], vertices: int = PROPOSED_VERTICES) -> float:
    """A length that divides the meshes into about `vertices` vertices altogether, in two digits; 0 when none has area.

    Meshes that are finer already get the side of a square of which they have `vertices`: only their large faces are
    divided then.
    """
    area = sum(_area(mesh) for mesh in meshes)
    if not area > 0.0:
        return 0.0
    length = fitting_edge_length(meshes, vertices)
    return length if np.isfinite(length) else float(f"{np.sqrt(area / vertices):.1e}")


def _area(mesh: PolygonMesh) -> float:
    a, b, c = (mesh.positions[mesh.corner_vertices[mesh.triangles[:, k]]] for k in range(3))
    with np.errstate(invalid='ignore', over='ignore'):
        areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(areas[np.isfinite(areas)].sum())


def _pieces(mesh: PolygonMesh, length: float) -> _Pieces:
    if not length > 0.0:
        raise ValueError(f"the maximum edge length must be above 0, not {length}")
    positions, vertices = mesh.positions, mesh.corner_vertices
    edge_counts = cut_counts(positions[mesh.edges[:, 0]], positions[mesh.edges[:, 1]], length)
    in_faces = np.zeros(len(mesh.edges), dtype=bool)
    in_faces[mesh.corner_edges] = True
    edge_counts[~in_faces] = 1  # loose edges bound no face
    offsets = np.asarray(mesh.face_offsets, dtype=np.int64)
    sizes = np.diff(offsets)
    whole = np.ones(len(sizes), dtype=bool)
    whole[np.repeat(np.arange(len(sizes)), sizes)[edge_counts[mesh.corner_edges] > 1]] = False
    simple = sizes == 3
    quads = np.flatnonzero(sizes == 4)
    simple[quads] = _is_convex(positions[vertices[offsets[quads, None] + np.arange(4)]])
    # All others are divided triangle by triangle, along chords.
    split = np.flatnonzero(~simple[mesh.triangle_faces])
    faces, corners = mesh.triangle_faces[split], mesh.triangles[split].astype(np.int64)
    following = np.roll(corners, -1, axis=1)
    start, stop = offsets[faces, None], offsets[faces + 1, None]
    after = np.where(corners + 1 == stop, start, corners + 1)
    before = np.where(corners == start, stop - 1, corners - 1)
    lines = np.where(following == after, mesh.corner_edges[corners], -1)
    lines = np.where(following == before, mesh.corner_edges[following], lines)
    chord = lines < 0
    ends = np.sort(np.stack([corners[chord], following[chord]], axis=1), axis=1)
    # Corners belong to one face, so a pair of them names a chord of that face and no other.
    names, inverse = np.unique(ends[:, 0] * (len(vertices) + 1) + ends[:, 1], return_inverse=True)
    chord_vertices = vertices[np.stack([names // (len(vertices) + 1), names % (len(vertices) + 1)], axis=1)]
    spans = np.linalg.norm(positions[chord_vertices[:, 1]] - positions[chord_vertices[:, 0]], axis=1)
    lines[chord] = len(mesh.edges) + inverse.ravel()
    chord_faces = np.zeros(len(names), dtype=np.int64)
    chord_faces[inverse.ravel()] = np.broadcast_to(faces[:, None], chord.shape)[chord]
    whole[chord_faces[spans > LONGEST_CHORD * length]] = False
    chord_counts = cut_counts(positions[chord_vertices[:, 0]], positions[chord_vertices[:, 1]], length)
    chord_counts[whole[chord_faces]] = 1
    line_vertices = np.concatenate([mesh.edges, chord_vertices]).astype(np.int64)
    cut = ~whole[faces]
    tri_faces = np.flatnonzero((sizes == 3) & ~whole)
    quad_faces = quads[simple[quads] & ~whole[quads]]
    tri_corners = np.concatenate([offsets[tri_faces, None] + np.arange(3), corners[cut]])
    quad_corners = offsets[quad_faces, None] + np.arange(4)
    tri_lines = np.concatenate([mesh.corner_edges[offsets[tri_faces, None] + np.arange(3)], lines[cut]])
    both_lines = [tri_lines.astype(np.int64), mesh.corner_edges[quad_corners].astype(np.int64)]
    both = [tri_corners, quad_corners]
    forward = [line_vertices[line, 0] == vertices[corner] for line, corner in zip(both_lines, both, strict=True)]
    return _Pieces(both, both_lines, forward, line_vertices, np.concatenate([edge_counts, chord_counts]), whole)


def _is_convex(corners):
    """(n,) whether quadrilaterals (n, 4, 3) turn the same way at every corner, seen along their normal."""
    out = np.roll(corners, -1, axis=1) - corners
    turns = np.cross(np.roll(out, 1, axis=1), out)
    with np.errstate(invalid='ignore', over='ignore'):
        normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        return (np.einsum('nki,ni->nk', turns, normals) >= 0.0).all(axis=1) & (normals != 0.0).any(axis=1)


def _divide(mesh, pieces: _Pieces, line_bases, first_free, length, counting, limit=np.inf) -> Parts | None:
    """Part all pieces; None when more vertices than `limit` were counted."""
    places, items = [], []
    first = 0
    for corners, lines, forward in zip(pieces.corners, pieces.lines, pieces.forward, strict=True):
        count, width = corners.shape
        numbers = first + np.arange(count)
        first += count
        places.append(mesh.positions[mesh.corner_vertices[corners[:, [0, 1, 2, width - 1]]]])
        segments = pieces.line_counts[lines]
        bases = np.where(forward, line_bases[lines], line_bases[lines] + segments)
        weights = np.broadcast_to(np.eye(4)[:width], (count, width, 4))
        vertices = mesh.corner_vertices[corners].astype(np.int64)
        items.append((numbers, vertices, weights, bases, np.where(forward, 1, -1), segments))
    parts = Parts(np.concatenate(places), first_free, lambda a, b: cut_counts(a, b, length), counting)
    triangles, quads = items
    # Each step halves a number of each piece, so a few times log2 of the largest is enough for all of them.
    for _ in range(_STEPS_PER_HALVING * (int(pieces.line_counts.max()).bit_length() + 1)):
        if parts.vertex_count > limit:
            return None
        if not (len(triangles[0]) or len(quads[0])):
            return parts
        more_triangles, more_quads = part_triangles(parts, triangles)
        also_triangles, also_quads = part_quads(parts, quads)
        triangles = tuple(np.concatenate(pair) for pair in zip(more_triangles, also_triangles, strict=True))
        quads = tuple(np.concatenate(pair) for pair in zip(more_quads, also_quads, strict=True))
    raise RuntimeError(f"{len(triangles[0]) + len(quads[0])} pieces are left after the last step of parting")


def _vertex_means(mesh, pieces: _Pieces, parts: Parts):
    """(n, 4) old vertices and (n, 4) weights of all vertices: old ones, those on lines, those inside."""
    old = np.arange(len(mesh.positions))
    inner = pieces.line_counts - 1
    lines = np.repeat(np.arange(len(inner)), inner)
    steps = 1 + np.arange(len(lines)) - np.repeat(np.cumsum(inner) - inner, inner)
    share = steps / pieces.line_counts[lines]
    ends = pieces.line_vertices[lines]
    numbers, weights = parts.inner_vertices()
    corners = _piece_corners(pieces)[numbers]
    sources = [np.repeat(old[:, None], 4, axis=1), ends[:, [0, 1, 0, 1]], mesh.corner_vertices[corners]]
    zero = np.zeros(len(share))
    shares = [np.tile([1.0, 0.0, 0.0, 0.0], (len(old), 1)), np.stack([1.0 - share, share, zero, zero], axis=1), weights]
    return np.concatenate(sources).astype(np.int32), np.concatenate(shares)


def _piece_corners(pieces: _Pieces):
    """(p, 4) old corners of each piece; triangles repeat their last."""
    return np.concatenate([pieces.corners[0][:, [0, 1, 2, 2]], pieces.corners[1]])


def _assemble(mesh, pieces: _Pieces, parts: Parts):
    """New faces, unordered, and the order that puts them where the old ones were."""
    offsets = np.asarray(mesh.face_offsets, dtype=np.int64)
    old_sizes = np.diff(offsets)
    kept = np.flatnonzero(pieces.whole)
    corner_faces = np.repeat(np.arange(len(old_sizes)), old_sizes)
    kept_corners = np.flatnonzero(pieces.whole[corner_faces])
    corner_table = _piece_corners(pieces)
    piece_faces = corner_faces[corner_table[:, 0]]
    sizes, vertices, faces = [old_sizes[kept]], [mesh.corner_vertices[kept_corners]], [kept]
    sources = [np.repeat(kept_corners[:, None], 4, axis=1)]
    weights = [np.tile([1.0, 0.0, 0.0, 0.0], (len(kept_corners), 1))]
    for numbers, corners, shares in parts.faces():
        width = corners.shape[1]
        sizes.append(np.full(len(numbers), width))
        vertices.append(corners.ravel())
        faces.append(piece_faces[numbers])
        sources.append(np.repeat(corner_table[numbers], width, axis=0))
        weights.append(shares.reshape(-1, 4))
    faces = np.concatenate(faces)
    return (
        np.argsort(faces, kind='stable'),
        np.concatenate(sizes),
        np.concatenate(vertices),
        np.concatenate(sources).astype(np.int32),
        np.concatenate(weights),
        faces,
    )


def _edges(mesh, pieces: _Pieces, line_bases, vertices, offsets, vertex_count):
    """Edges of the new mesh, the old edge of each, and the edge of each corner."""
    old = np.arange(len(mesh.edges))
    counts = pieces.line_counts[old]
    lines = np.repeat(old, counts)
    steps = np.arange(len(lines)) - np.repeat(np.cumsum(counts) - counts, counts)
    starts = np.where(steps == 0, pieces.line_vertices[lines, 0], line_bases[lines] + steps)
    stops = np.where(steps + 1 == counts[lines], pieces.line_vertices[lines, 1], line_bases[lines] + steps + 1)
    following = np.arange(1, len(vertices) + 1)
    following[offsets[1:] - 1] = offsets[:-1]
    first = np.concatenate([starts, vertices]).astype(np.int64)
    second = np.concatenate([stops, vertices[following]]).astype(np.int64)
    names = np.minimum(first, second) * vertex_count + np.maximum(first, second)
    _, seen, inverse = np.unique(names, return_index=True, return_inverse=True)
    # Numbered as first seen: the pieces of old edges, in their order, then the others along the faces.
    order = np.argsort(seen, kind='stable')
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    seen = seen[order]
    edges = np.stack([first[seen], second[seen]], axis=1).astype(np.int32)
    sources = np.concatenate([lines, np.full(len(vertices), -1)])[seen].astype(np.int32)
    return edges, sources, ranks[inverse.ravel()[len(lines) :]].astype(np.int32)
