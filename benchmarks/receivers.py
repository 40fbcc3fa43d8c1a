"""Fair receivers on meshes that were not made for benchmarks, and enough of them.

`geometry.Model` knows which vertices lie inside a plane and outside all solids; for a mesh from elsewhere it has to be
found out.
"""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
from radiosity.core.visibility.embree import RayEngine

#: Faces whose normals differ by less than this angle (radians) are one plane.
_FLAT = 1e-3

#: Share of rays over a vertex that may meet back faces; a vertex that sees more lies in a solid or against one.
_BURIED = 0.02
_RAYS = 128


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


def fair_vertices(obj: bpy.types.Object) -> np.ndarray:
    """(n,) bool: vertices inside a plane of the mesh that see no back faces around them.

    A mesh in world space, alone in its scene: what other objects hide is not asked.
    """
    mesh = obj.data
    points = _get(mesh.vertices, "co", np.float32, 3).astype(float)
    corners = _get(mesh.loops, "vertex_index", np.int32)
    normals = _get(mesh.polygons, "normal", np.float32, 3)
    sizes = _get(mesh.polygons, "loop_total", np.int32)
    faces = np.repeat(np.arange(len(sizes)), sizes)

    # The mean of unit normals is shorter than 1 by half the squared angle where they differ.
    count = np.bincount(corners, minlength=len(points))
    total = np.stack([np.bincount(corners, normals[faces, i], len(points)) for i in range(3)], axis=1)
    mean = total / np.maximum(count, 1)[:, None]
    length = np.linalg.norm(mean, axis=1)
    fair = (count > 0) & (length > 1 - _FLAT**2 / 2)
    normal = mean / np.maximum(length, 0.5)[:, None]

    # Inside a plane the angles of the faces around a vertex fill the circle; on a border they do not.
    angles = _corner_angles(points, corners, sizes)
    fair &= np.abs(np.bincount(corners, angles, len(points)) - 2 * np.pi) < 0.01

    mesh.calc_loop_triangles()
    triangles = _get(mesh.loop_triangles, "vertices", np.int32, 3)
    fair[fair] = _back_share(points, triangles, points[fair], normal[fair]) <= _BURIED
    return fair


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


def _back_share(vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Share of directions over each oriented point that meet the back of a triangle."""
    engine = RayEngine(vertices, triangles)
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
