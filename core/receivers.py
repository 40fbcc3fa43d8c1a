"""Receivers: the places where light is wanted, one per vertex and smooth group.

A vertex on a sharp edge belongs to several smooth groups and gets a receiver in each, so both sides of the edge have
their own light. Corners at the same place with the same normal share one receiver, also across split vertices and
touching objects, so seams of the mesh do not show in the light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .keys import row_keys, unique_pairs
from .scene import ReceiverMesh
from .visibility.embree import OFFSET, Frame

#: Corner normals of one smooth vertex agree to float rounding; Blender's custom normals are stored in 16 bits (6e-5).
SAME_NORMAL = 1e-3

#: Steps of the grid, in unit lengths, on which two receivers count as being at the same place.
SAME_PLACE = 1e-7

#: Receivers on the border of their face are moved towards its middle by this part of the way, so that their rays start
#: above their own face and not in the wall beside it (study, section 5: without it half the rays of a border go
#: astray).
INSET = 1e-3

#: A receiver lies on a border when the middle of its faces is off by more than this part of their size.
BORDER = 0.25


@dataclass(frozen=True)
class Receivers:
    """Receivers of all meshes, in the unit frame.

    Parameters
    ----------
    points, normals : (r, 3) float32
        Positions, moved off face borders; shading normals.
    sizes : (r,) float32
        Mean distance to the middle of the faces around: half the local mesh spacing.
    edges : (e, 2) int32
        Pairs of receivers joined by a mesh edge within their smooth group, each once.
    corner_receivers : list of (c,) int32
        Receiver of every corner of each mesh; -1 where the position or normal is not finite.
    borders : (r,) bool
        On the border of a smooth group.
    inward : (r, 3) float32
        From each receiver to the middle of the faces around it, along the surface; near 0 within a regular mesh.
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
    normals = mesh.corner_normals
    count = len(vertices)
    first = np.full(len(mesh.positions), -1, np.int32)
    first[vertices[::-1]] = np.arange(count - 1, -1, -1, dtype=np.int32)
    own = first[vertices]
    differs = np.abs(normals - normals[own]).max(axis=1) > SAME_NORMAL
    mixed = np.zeros(len(first), bool)
    mixed[vertices[differs]] = True
    group = own.copy()
    corners = np.nonzero(mixed[vertices])[0]
    if len(corners):
        steps = np.rint(normals[corners] / (2 * SAME_NORMAL)).astype(np.int64)
        keys = row_keys(vertices[corners], *steps.T)
        _, representative, inverse = np.unique(keys, return_index=True, return_inverse=True)
        group[corners] = corners[representative][inverse.reshape(-1)]
    leaders = np.nonzero(group == np.arange(count))[0]
    rank = np.full(count, -1, np.int32)
    rank[leaders] = np.arange(len(leaders), dtype=np.int32)
    return rank[group], leaders


def _arms(mesh: ReceiverMesh, place: np.ndarray) -> np.ndarray:
    """From each corner to the middle of its face (c, 3) float32; 0 where the face has a broken corner."""
    lengths = np.diff(mesh.face_offsets)
    corners = place[mesh.corner_vertices]
    middles = np.add.reduceat(corners, mesh.face_offsets[:-1].astype(np.intp), axis=0)
    middles /= lengths[:, None].astype(np.float32)
    np.subtract(np.repeat(middles, lengths, axis=0), corners, out=corners)
    # A face with a broken corner has no middle; its sound corners are placed by their other faces.
    broken = ~np.isfinite(middles).all(axis=1)
    if broken.any():
        corners[np.repeat(broken, lengths)] = 0
    return corners


def _sum_by(index: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    sums = np.empty((count, 3), np.float32)
    for axis in range(3):
        sums[:, axis] = np.bincount(index, weights=values[:, axis], minlength=count)
    return sums


def _next_corners(mesh: ReceiverMesh) -> np.ndarray:
    following = np.arange(1, len(mesh.corner_vertices) + 1, dtype=np.int32)
    following[mesh.face_offsets[1:] - 1] = mesh.face_offsets[:-1]
    return following


def build_receivers(meshes: Sequence[ReceiverMesh], frame: Frame) -> Receivers:
    """Receivers of all corners of all meshes.

    Parameters
    ----------
    meshes : sequence of ReceiverMesh
    frame : Frame
        The unit frame of the scene.

    Returns
    -------
    Receivers
        In the order in which the meshes' corners first name them.
    """
    groups, points, normals, inward, sizes, edges, base = [], [], [], [], [], [], 0
    for mesh in meshes:
        if not len(mesh.corner_vertices):
            groups.append(np.empty(0, np.int32))
            continue
        group, leaders = _vertex_groups(mesh)
        place = frame.to_unit(mesh.positions)
        arms = _arms(mesh, place)
        counts = np.bincount(group, minlength=len(leaders))
        points.append(place[mesh.corner_vertices[leaders]])
        normals.append(np.asarray(mesh.corner_normals[leaders], np.float32))
        inward.append(_sum_by(group, arms, len(leaders)) / counts[:, None].astype(np.float32))
        lengths = np.sqrt(np.einsum("ij,ij->i", arms, arms))
        sizes.append((np.bincount(group, weights=lengths, minlength=len(leaders)) / counts).astype(np.float32))
        del arms, lengths
        neighbor = group[_next_corners(mesh)]
        edges.append(unique_pairs(group, neighbor, len(leaders)) + base)
        groups.append(group + base)
        base += len(leaders)
    if not base:
        empty = np.empty((0, 3), np.float32)
        return Receivers(empty, empty, empty[:, 0], np.empty((0, 2), np.int32), groups, np.empty(0, bool), empty)
    return _welded(
        np.concatenate(points),
        np.concatenate(normals),
        np.concatenate(inward),
        np.concatenate(sizes),
        np.concatenate(edges),
        groups,
    )


def _welded(points, normals, inward, sizes, edges, groups) -> Receivers:
    finite = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1) & np.isfinite(inward).all(axis=1)
    finite &= np.einsum("ij,ij->i", normals, normals) > 0.25
    keys = np.zeros(len(points), np.uint64)
    keys[finite] = row_keys(
        *np.rint(points[finite] / SAME_PLACE).astype(np.int64).T,
        *np.rint(normals[finite] / (2 * SAME_NORMAL)).astype(np.int64).T,
    )
    # Receivers that are not finite keep no row; all others are numbered in order of first appearance.
    _, leaders, inverse = np.unique(keys[finite], return_index=True, return_inverse=True)
    order = np.argsort(leaders, kind="stable")
    rank = np.empty(len(leaders), np.int32)
    rank[order] = np.arange(len(leaders), dtype=np.int32)
    leaders = np.nonzero(finite)[0][leaders[order]]
    where = np.full(len(points), -1, np.int32)
    where[finite] = rank[inverse.reshape(-1)]

    count = len(leaders)
    shares = np.bincount(where[finite], minlength=count)
    inward = _sum_by(where[finite], inward[finite], count) / shares[:, None].astype(np.float32)
    points, normals, sizes = points[leaders], normals[leaders], sizes[leaders]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    if count < len(where):
        edges = where[edges]
        edges = edges[(edges >= 0).all(axis=1)]
        edges = unique_pairs(edges[:, 0], edges[:, 1], max(count, 1)) if len(edges) else edges
    inward -= np.einsum("ij,ij->i", inward, normals)[:, None] * normals
    reach = np.linalg.norm(inward, axis=1)
    borders = reach > BORDER * sizes
    # At least four ray offsets, or the ray would start closer to the wall than it starts above the floor, but never
    # past half-way to the middle of a tiny face.
    step = np.minimum(np.maximum(INSET * reach, 4 * OFFSET), 0.5 * reach) * borders
    points = points + (step / np.maximum(reach, 1e-20))[:, None] * inward
    corner_receivers = [np.where(g >= 0, where[g], -1).astype(np.int32) if len(g) else g for g in groups]
    return Receivers(points, normals, sizes, edges, corner_receivers, borders, inward)
