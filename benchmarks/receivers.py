"""Fair receivers on meshes that were not made for benchmarks, and enough of them.

`geometry.Model` knows which vertices lie inside a plane and outside all solids; for a mesh from elsewhere it has to be
found out.
"""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
from mathutils.bvhtree import BVHTree
from radiosity.core.visibility.embree import RayEngine

#: Faces whose normals differ by less than this angle (radians) are one plane.
_FLAT = 1e-3

#: Share of rays over a vertex that may meet back faces; a vertex that sees more lies in a solid or against one.
_BURIED = 0.02
_RAYS = 128

#: What is nearer than this many ray offsets touches: neither program's rays can tell on which side they are. An offset
#: is 1e-5 of the scene's longest side.
_CONTACT = 4

#: Height of a triangle, in longest sides, below which it has no area in float32. Cycles has no normal there and stores
#: black for its corners, so a vertex that such a triangle shares with one other keeps half its light.
_FLAT_TRIANGLE = 1e-6


def divide_edges(obj: bpy.types.Object, longest: float) -> None:
    """Cut the edges of a mesh in halves until none is longer than this (m), so that its planes get inner vertices."""
    work = bmesh.new()
    work.from_mesh(obj.data)
    while True:
        edges = [edge for edge in work.edges if edge.calc_length() > longest]
        if not edges:
            break
        bmesh.ops.subdivide_edges(work, edges=edges, cuts=1, use_grid_fill=True)
    work.to_mesh(obj.data)
    work.free()


def inner_vertices(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """(n,) bool: vertices inside a plane of the mesh, on no border of it; and the normals (n, 3) there."""
    mesh = obj.data
    points, corners, sizes = _points(mesh), _get(mesh.loops, "vertex_index", np.int32), _face_sizes(mesh)
    normals = _get(mesh.polygons, "normal", np.float32, 3)
    faces = np.repeat(np.arange(len(sizes)), sizes)

    # The mean of unit normals is shorter than 1 by half the squared angle where they differ.
    count = np.bincount(corners, minlength=len(points))
    total = np.stack([np.bincount(corners, normals[faces, i], len(points)) for i in range(3)], axis=1)
    mean = total / np.maximum(count, 1)[:, None]
    length = np.linalg.norm(mean, axis=1)
    inner = (count > 0) & (length > 1 - _FLAT**2 / 2)

    # Inside a plane the angles of the faces around a vertex fill the circle; on a border they do not.
    angles = _corner_angles(points, corners, sizes)
    inner &= np.abs(np.bincount(corners, angles, len(points)) - 2 * np.pi) < 0.01
    return inner, mean / np.maximum(length, 0.5)[:, None]


def fair_vertices(obj: bpy.types.Object) -> np.ndarray:
    """(n,) bool: inner vertices that are neither buried nor touched by another face nor on a triangle without area.

    A mesh in world space, alone in its scene: what other objects hide is not asked. All of it is told from the mesh
    alone, none from any light.
    """
    mesh = obj.data
    points = _points(mesh)
    mesh.calc_loop_triangles()
    triangles = _get(mesh.loop_triangles, "vertices", np.int32, 3)
    fair, normals = inner_vertices(obj)
    fair[triangles[_without_area(points[triangles])].ravel()] = False
    engine = RayEngine(points, triangles)
    fair[fair] = _back_share(engine, points, triangles, points[fair], normals[fair]) <= _BURIED
    fair[fair] = ~_touched(mesh, points, np.nonzero(fair)[0], _CONTACT * engine.offset)
    return fair


def _points(mesh: bpy.types.Mesh) -> np.ndarray:
    return _get(mesh.vertices, "co", np.float32, 3).astype(float)


def _face_sizes(mesh: bpy.types.Mesh) -> np.ndarray:
    return _get(mesh.polygons, "loop_total", np.int32)


def _without_area(corners: np.ndarray) -> np.ndarray:
    """(m,) bool: triangles (m, 3, 3) that are a line."""
    sides = np.roll(corners, -1, axis=1) - corners
    longest = (sides**2).sum(axis=2).max(axis=1)
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) <= _FLAT_TRIANGLE * longest


def _touched(mesh: bpy.types.Mesh, points: np.ndarray, who: np.ndarray, distance: float) -> np.ndarray:
    """(k,) bool: vertices `who` (k,) with a face nearer than `distance` that is not their own: walls that overlap."""
    tree = BVHTree.FromPolygons(points.tolist(), [tuple(polygon.vertices) for polygon in mesh.polygons])
    corners, sizes = _get(mesh.loops, "vertex_index", np.int32), _face_sizes(mesh)
    own = np.stack([np.repeat(np.arange(len(sizes)), sizes), corners], axis=1)
    own = own[np.argsort(corners, kind="stable")]
    starts = np.searchsorted(own[:, 1], np.arange(len(points) + 1))
    touched = np.zeros(len(who), bool)
    for row, vertex in enumerate(who):
        mine = set(own[starts[vertex] : starts[vertex + 1], 0].tolist())
        touched[row] = any(face not in mine for *_, face, _ in tree.find_nearest_range(points[vertex], distance))
    return touched


def _get(collection, name: str, dtype, width: int = 1) -> np.ndarray:
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values if width == 1 else values.reshape(-1, width)


def _corner_angles(points: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Angle of each face at each of its corners."""
    starts = np.cumsum(sizes) - sizes
    place = np.arange(len(corners)) - np.repeat(starts, sizes)
    first, size = np.repeat(starts, sizes), np.repeat(sizes, sizes)
    here = points[corners]
    onward = points[corners[first + (place + 1) % size]] - here
    back = points[corners[first + (place - 1) % size]] - here
    return np.arctan2(np.linalg.norm(np.cross(onward, back), axis=1), np.einsum("ij,ij->i", onward, back))


def _back_share(engine: RayEngine, vertices, triangles, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Share of directions over each oriented point that meet the back of a triangle."""
    index = np.arange(_RAYS) + 0.5
    radius, azimuth = np.sqrt(index / _RAYS), index * np.pi * (1 + np.sqrt(5))
    local = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - radius**2)], axis=1)
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    tangent = np.cross(normals, helper)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    frame = np.stack([tangent, np.cross(normals, tangent), normals], axis=1)
    directions = np.einsum("rk,pki->pri", local, frame).reshape(-1, 3)
    met = engine.closest(np.repeat(points + 2 * engine.offset * normals, _RAYS, axis=0), directions)[0]
    corners = vertices[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[met]
    back = (met >= 0) & (np.einsum("ij,ij->i", facing, directions) > 0)
    return back.reshape(-1, _RAYS).mean(axis=1)
