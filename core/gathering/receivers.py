"""Receivers: the places where light is wanted, one per vertex and smooth group.

A vertex on a sharp edge belongs to several smooth groups and gets a receiver in each, so both sides of the edge have
their own light. Corners at the same place with the same normal share one receiver, also across split vertices and
touching objects, so seams of the mesh do not show in the light; unless a wall stands there, whose two sides are two
rooms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..keys import directed_pairs, row_keys
from ..scene import ReceiverMesh
from ..visibility.embree import OFFSET, Frame

#: Corner normals of one smooth vertex agree to float rounding; Blender's custom normals are stored in 16 bits (6e-5).
SAME_NORMAL = 1e-3

#: Steps of the grid, in unit lengths, on which two receivers count as being at the same place.
SAME_PLACE = 1e-7

#: Receivers on a border are moved into their face by this part of the way to its middle, so that their rays start above
#: their own face and not in the wall beside it (study, section 5: without it half the rays of a border go astray).
INSET = 1e-3

#: Part of the sum of a corner's two sides that leads towards the middle of its face: the middle itself is at a third in
#: a triangle and at half in a square.
MIDDLE = 0.4

#: Height of a triangle, in lengths of its longer side at a corner, up to which it has no area: a bevel clamped to
#: nothing leaves some, and float32 vertices a long way from the origin round to so much.
FLAT = 1e-5

#: Corners or places compared at a time.
BLOCK = 65536

#: Half the diagonal of a square, in its sides: what the mean length of edges is taken times for the size of a face.
HALF_DIAGONAL = 0.5**0.5


#: Whether something stands (n,) between places (n, 3) and others (n, 3).
Parts = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Receivers:
    """Receivers of all meshes, in the unit frame.

    Parameters
    ----------
    points, normals : (r, 3) float32
        Positions, moved off face borders; shading normals.
    sizes : (r,) float32
        About half the diagonal of the faces around: the local mesh spacing.
    edges : (e, 2) int32
        Pairs of receivers joined by a mesh edge within their smooth group, each once.
    corner_receivers : list of (c,) int32
        Receiver of every corner of each mesh; -1 where the position or normal is not finite.
    borders : (r,) bool
        On the border of a smooth group: at the end of an edge that has a face on one side only.
    inward : (r, 3) float32
        From a receiver on a border towards the middle of the face that lies most inward; 0 for all others.
    """

    points: np.ndarray
    normals: np.ndarray
    sizes: np.ndarray
    edges: np.ndarray
    corner_receivers: list[np.ndarray]
    borders: np.ndarray
    inward: np.ndarray

    def __len__(self) -> int:
        return len(self.points)


def _vertex_groups(mesh: ReceiverMesh) -> tuple[np.ndarray, np.ndarray]:
    """Corners to (vertex, smooth group): the group of each corner and one corner of each group."""
    vertices = mesh.corner_vertices
    count = len(vertices)
    first = np.full(len(mesh.positions), -1, np.int32)
    first[vertices[::-1]] = np.arange(count - 1, -1, -1, dtype=np.int32)
    group = first[vertices]
    if mesh.vertex_normals is None:
        _part_groups(group, vertices, mesh.corner_normals, len(first))
    leaders = np.nonzero(group == np.arange(count, dtype=np.int32))[0]
    rank = np.full(count, -1, np.int32)
    rank[leaders] = np.arange(len(leaders), dtype=np.int32)
    return rank[group], leaders


def _part_groups(group: np.ndarray, vertices: np.ndarray, normals: np.ndarray, count: int) -> None:
    """Part the group (c,) of each of `count` vertices, named by its first corner, by the normals of its corners."""
    mixed = np.zeros(count, bool)
    for start in range(0, len(group), BLOCK):
        part = slice(start, start + BLOCK)
        differs = np.abs(normals[part] - normals[group[part]]).max(axis=1) > SAME_NORMAL
        mixed[vertices[part][differs]] = True
    corners = np.nonzero(mixed[vertices])[0]
    if len(corners):
        steps = np.rint(normals[corners] / (2 * SAME_NORMAL)).astype(np.int64)
        keys = row_keys(vertices[corners], *steps.T)
        _, representative, inverse = np.unique(keys, return_index=True, return_inverse=True)
        group[corners] = corners[representative][inverse.reshape(-1)]


def next_corners(mesh: ReceiverMesh) -> np.ndarray:
    """(c,) int32 the corner that follows each around its face."""
    following = np.arange(1, len(mesh.corner_vertices) + 1, dtype=np.int32)
    following[mesh.face_offsets[1:] - 1] = mesh.face_offsets[:-1]
    return following


def previous_corners(mesh: ReceiverMesh) -> np.ndarray:
    """(c,) int32 the corner before each around its face."""
    previous = np.arange(-1, len(mesh.corner_vertices) - 1, dtype=np.int32)
    previous[mesh.face_offsets[:-1]] = mesh.face_offsets[1:] - 1
    return previous


def build_receivers(meshes: Sequence[ReceiverMesh], frame: Frame, parts: Parts | None = None) -> Receivers:
    """Receivers of all corners of all meshes.

    Parameters
    ----------
    meshes : sequence of ReceiverMesh
    frame : Frame
        The unit frame of the scene.
    parts : callable, optional
        Whether something stands (n,) between places (n, 3) and others (n, 3). Without it, floors of two rooms that meet
        under a wall without thickness have the receivers there in common.

    Returns
    -------
    Receivers
        In the order in which the meshes' corners first name them.
    """
    groups, points, normals, sizes, pairs, base = [], [], [], [], [], 0
    for mesh in meshes:
        if not len(mesh.corner_vertices):
            groups.append(np.empty(0, np.int32))
            continue
        group, leaders = _vertex_groups(mesh)
        place = frame.to_unit(mesh.positions)
        points.append(place[mesh.corner_vertices[leaders]])
        normals.append(np.asarray(mesh.normals_at(leaders), np.float32))
        sizes.append(_mean_sides(mesh, place, group))
        group += base
        pairs.append((group, group[next_corners(mesh)]))
        groups.append(group)
        base += len(leaders)
        del place, leaders
    if not base:
        empty = np.empty((0, 3), np.float32)
        return Receivers(empty, empty, empty[:, 0], np.empty((0, 2), np.int32), groups, np.empty(0, bool), empty)
    points, normals, sizes = (np.concatenate(each) for each in (points, normals, sizes))
    where, leaders = _weld(points, normals)
    if parts is not None and len(leaders) < (where >= 0).sum():
        where, leaders = _part_rooms(
            where, points, normals, _inward_steps(meshes, groups, frame, where, normals), parts
        )
    points, normals = points[leaders], normals[leaders]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    ends = [np.concatenate(side) for side in zip(*pairs, strict=True)]
    del pairs
    if len(leaders) < len(where):
        ends = [where[side] for side in ends]
        sound = (ends[0] >= 0) & (ends[1] >= 0)
        ends = [side[sound] for side in ends]
        groups = [where[group] for group in groups]
    edges, both = directed_pairs(*ends, max(len(leaders), 1))
    del ends
    borders = np.zeros(len(leaders), bool)
    # Two faces run along their common edge in opposite directions, also where a face is doubled.
    borders[edges[~both]] = True
    inward = _inward(meshes, groups, frame, borders, normals)
    points = points + _steps(inward)
    return Receivers(points, normals, HALF_DIAGONAL * sizes[leaders], edges, groups, borders, inward)


def _steps(inward: np.ndarray) -> np.ndarray:
    """(r, 3) float32 by how much receivers on borders are moved along their ways inward (r, 3)."""
    reach = np.linalg.norm(inward, axis=1)
    # At least four ray offsets, or the ray would start closer to the wall than it starts above the floor, but never
    # past half-way to the middle of a tiny face.
    step = np.minimum(np.maximum(INSET * reach, 4 * OFFSET), 0.5 * reach)
    return (step / np.maximum(reach, 1e-20))[:, None].astype(np.float32) * inward


def _inward_steps(meshes, groups, frame: Frame, where: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(g, 3) float32 by how much each group would be moved that shares a receiver now and had one of its own; 0 for all
    others."""
    shared = np.zeros(len(where), bool)
    shared[where >= 0] = np.bincount(where[where >= 0])[where[where >= 0]] > 1
    return _steps(_inward(meshes, groups, frame, shared, normals))


def _part_rooms(
    where: np.ndarray, points: np.ndarray, normals: np.ndarray, steps: np.ndarray, parts: Parts
) -> tuple[np.ndarray, np.ndarray]:
    """Receiver of each group as `_weld` gives it, and the first group of each, but with one for each room that meets
    there: groups stay together while nothing stands between their faces, a `steps` (g, 3) from where they meet."""
    lengths = np.linalg.norm(steps, axis=1)
    first, left = np.full(len(where), -1), np.flatnonzero(where >= 0)
    while len(left):
        # Of the groups of one place that have no receiver yet, the first is given one, and all that it sees.
        _, leading, which = np.unique(where[left], return_index=True, return_inverse=True)
        leaders = left[leading][which.reshape(-1)]
        others = np.flatnonzero(left != leaders)
        one, other = left[others], leaders[others]
        # High enough to look over a smooth ridge, whose faces fall away by half a right angle.
        lift = (np.maximum(lengths[one], lengths[other]) + np.float32(4 * OFFSET))[:, None] * normals[other]
        apart = np.zeros(len(left), bool)
        apart[others] = parts(points[one] + steps[one] + lift, points[other] + steps[other] + lift)
        first[left[~apart]] = leaders[~apart]
        left = left[apart]
    known = first >= 0
    leaders, numbers = np.unique(first[known], return_inverse=True)
    where = np.full(len(where), -1, np.int32)
    where[known] = numbers.reshape(-1)
    return where, leaders


def _mean_sides(mesh: ReceiverMesh, places: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Mean length (g,) float32 of the sides that start at the corners of each group; `places` (v, 3) of vertices."""
    following = next_corners(mesh)
    lengths = np.empty(len(following), np.float32)
    for start in range(0, len(lengths), BLOCK):
        part = slice(start, start + BLOCK)
        sides = places[mesh.corner_vertices[following[part]]] - places[mesh.corner_vertices[part]]
        lengths[part] = np.sqrt(np.einsum("ij,ij->i", sides, sides))
    # An edge to a broken vertex has no length, nor has a side between two vertices in one place; their ends are
    # measured by their other edges.
    lengths[~np.isfinite(lengths)] = 0
    del following
    counts = np.bincount(group, weights=lengths > 0)
    return (np.bincount(group, weights=lengths) / np.maximum(counts, 1)).astype(np.float32)


def _weld(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of each (vertex, smooth group) among those that differ in place or normal, -1 where either is not finite,
    and the first that has each number."""
    finite = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1)
    finite &= np.einsum("ij,ij->i", normals, normals) > 0.25
    rows = np.flatnonzero(finite)
    keys = np.empty(len(rows), np.uint64)
    for start in range(0, len(rows), BLOCK):
        part = rows[start : start + BLOCK]
        keys[start : start + BLOCK] = row_keys(
            *np.rint(points[part] / SAME_PLACE).astype(np.int64).T,
            *np.rint(normals[part] / (2 * SAME_NORMAL)).astype(np.int64).T,
        )
    _, leaders, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(leaders, kind="stable")
    rank = np.empty(len(leaders), np.int32)
    rank[order] = np.arange(len(leaders), dtype=np.int32)
    where = np.full(len(points), -1, np.int32)
    where[finite] = rank[inverse.reshape(-1)]
    return where, rows[leaders[order]]


def _inward(
    meshes: Sequence[ReceiverMesh], groups: list[np.ndarray], frame: Frame, borders: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """From each border receiver towards the middle of one of its faces (r, 3) float32, 0 for all others.

    The directions in which faces extend from a vertex sum to a vector that points away from where there is none, also
    at a corner that reaches inward, where the middles of its faces cancel. Of its faces that which lies most along this
    sum is taken, so that the way leads through a face whatever their shapes.
    """
    count = len(borders)
    arms, scores = np.zeros((count, 3), np.float32), np.full(count, -np.inf, np.float32)
    collected = []
    total = np.zeros((count, 3))
    for mesh, group in zip(meshes, groups, strict=True):
        if not len(group):
            continue
        # The last place stands for corners without a receiver, -1.
        corners = np.flatnonzero(np.append(borders, False)[group])
        around = [corners, next_corners(mesh)[corners], previous_corners(mesh)[corners]]
        places = frame.to_unit(mesh.positions[mesh.corner_vertices[around]])
        ahead, back = places[1] - places[0], places[2] - places[0]
        sound = np.isfinite(ahead).all(axis=1) & np.isfinite(back).all(axis=1) & ~_empty(mesh, corners, ahead, back)
        corners, ahead, back = corners[sound], ahead[sound], back[sound]
        who = group[corners]
        # The integral of all directions between the two sides: their difference, turned by a right angle.
        wedge = np.cross(_unit(back) - _unit(ahead), normals[who])
        for axis in range(3):
            total[:, axis] += np.bincount(
                who, weights=-wedge[:, axis] if mesh.flipped else wedge[:, axis], minlength=count
            )
        arm = MIDDLE * (ahead + back)
        reflex = np.einsum("ij,ij->i", np.cross(ahead, back), normals[who]) * (-1 if mesh.flipped else 1) < 0
        arm[reflex] *= -1
        collected.append((who, arm - np.einsum("ij,ij->i", arm, normals[who])[:, None] * normals[who]))
    for who, arm in collected:
        score = np.einsum("ij,ij->i", _unit(arm), total[who]).astype(np.float32)
        order = np.lexsort((-score, who))
        best = order[np.r_[True, who[order][1:] != who[order][:-1]]] if len(order) else order
        better = score[best] > scores[who[best]]
        arms[who[best[better]]], scores[who[best[better]]] = arm[best[better]], score[best[better]]
    return arms


def _empty(mesh: ReceiverMesh, corners: np.ndarray, ahead: np.ndarray, back: np.ndarray) -> np.ndarray:
    """(n,) bool: corners (n,) of triangles without area, by the sides (n, 3) at them: they lead nowhere. In a face of
    more corners a straight one is as good as any."""
    sides = np.diff(mesh.face_offsets)[np.searchsorted(mesh.face_offsets, corners, side="right") - 1]
    with np.errstate(invalid="ignore"):  # broken vertices are not finite, and left out by the caller
        across = np.linalg.norm(np.cross(ahead, back), axis=1)
        longest = np.maximum(np.linalg.norm(ahead, axis=1), np.linalg.norm(back, axis=1))
        return (sides == 3) & (across <= FLAT * longest**2)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
