"""Replaces the faces of a mesh by finer ones and carries over everything that is stored on it.

The mesh stays the same data-block, so objects, materials, drivers and links keep it. Floats and colors are interpolated
linearly; whole numbers, flags and text take the value of the nearest old element; edges and faces inherit from the one
that they are part of. Smooth shading must look as before: where Blender would shade the new faces otherwise (a smooth
box turns flat as soon as it has inner vertices), the old normals are kept as custom normals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.discretization.subdivision import SubdividedMesh
from .mesh_arrays import read_corner_normals, read_positions
from .vertex_groups import read_vertex_groups, write_vertex_groups

# Largest turn of a normal, in radians, that is left to Blender: it changes diffuse shading by one percent at most.
SHADING_TOLERANCE = 1e-2

# Property, columns and type of what is interpolated, by data type.
_LINEAR = {
    'FLOAT': ("value", 1, np.float32),
    'FLOAT2': ("vector", 2, np.float32),
    'FLOAT_VECTOR': ("vector", 3, np.float32),
    'FLOAT_COLOR': ("color", 4, np.float32),
    'BYTE_COLOR': ("color", 4, np.float32),  # linear here: Blender decodes and encodes sRGB
    'FLOAT4X4': ("value", 16, np.float32),
    'QUATERNION': ("value", 4, np.float32),
}
_NEAREST = {
    'INT': ("value", 1, np.int32),
    'INT8': ("value", 1, np.int32),
    'BOOLEAN': ("value", 1, bool),
    'INT32_2D': ("value", 2, np.int32),
    'INT16_2D': ("value", 2, np.int32),
}
# The geometry itself, and normals, which depend on it.
_OWN = frozenset({"position", ".edge_verts", ".corner_vert", ".corner_edge", "custom_normal"})
# What marks a corner point of the shape says nothing about the points between two of them.
_AT_OLD_VERTICES = frozenset({"crease_vert", "bevel_weight_vert"})
# Rows that are interpolated at a time, to bound the memory of a step.
_BLOCK = 1 << 18


@dataclass(frozen=True)
class _Stored:
    """One attribute: what it takes to make it again, and its values."""

    name: str
    domain: str
    data_type: str
    values: np.ndarray | list[str]


def rewrite_mesh(mesh: bpy.types.Mesh, result: SubdividedMesh) -> None:
    """Give the mesh the geometry of `result`, which was made from it, and all it had before."""
    attributes = [_read_attribute(attribute) for attribute in mesh.attributes if attribute.name not in _OWN]
    marks = _read_freestyle(mesh)
    groups = read_vertex_groups(mesh)
    had_custom_normals = mesh.has_custom_normals
    normals = _means(read_corner_normals(mesh), result.corner_sources, result.corner_weights)
    positions = read_positions(mesh)
    old_count = len(positions)
    positions = np.concatenate(
        [positions, _means(positions, result.vertex_sources[old_count:], result.vertex_weights[old_count:])]
    )
    sources, shares = result.vertex_sources[old_count:], result.vertex_weights[old_count:]
    groups = replace(groups, weights=[np.concatenate([old, _means(old, sources, shares)]) for old in groups.weights])
    layers = _LayerChoice.of(mesh)
    mesh.clear_geometry()
    _write_geometry(mesh, positions, result)
    # Before anything else is stored on it: this puts a copy of the geometry in its place.
    write_vertex_groups(mesh, groups)
    for stored in attributes:
        _write_attribute(mesh, stored, result, old_count)
    _write_freestyle(mesh, marks, result)
    layers.restore(mesh)
    mesh.update()
    _keep_shading(mesh, normals, had_custom_normals)


def _means(values: np.ndarray, sources: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted means of rows of `values`, (n,) or (n, k), in their type."""
    values = values if values.ndim > 1 else values[:, None]
    means = np.empty((len(sources), values.shape[1]), dtype=values.dtype)
    # Values that are not finite must not spread by a weight of 0.
    finite = bool(np.isfinite(values).all())
    for start in range(0, len(sources), _BLOCK):
        rows = slice(start, start + _BLOCK)
        total = 0.0
        for place in range(sources.shape[1]):
            term = values[sources[rows, place]] * weights[rows, place, None]
            total = total + (term if finite else np.where(weights[rows, place, None] > 0.0, term, 0.0))
        means[rows] = total
    return means if values.shape[1] > 1 else means[:, 0]


def _read_attribute(attribute: bpy.types.Attribute) -> _Stored:
    if attribute.data_type in _LINEAR or attribute.data_type in _NEAREST:
        name, width, dtype = (_LINEAR | _NEAREST)[attribute.data_type]
        values = np.empty(len(attribute.data) * width, dtype=dtype)
        attribute.data.foreach_get(name, values)
        values = values.reshape(-1, width)
    else:
        # Text is the one type that Blender gives out one by one only.
        values = [item.value for item in attribute.data]
    return _Stored(attribute.name, attribute.domain, attribute.data_type, values)


def _write_attribute(mesh: bpy.types.Mesh, stored: _Stored, result: SubdividedMesh, old_count: int) -> None:
    attribute = mesh.attributes.get(stored.name)
    if attribute is not None and (attribute.domain, attribute.data_type) != (stored.domain, stored.data_type):
        mesh.attributes.remove(attribute)
        attribute = None
    if attribute is None:
        attribute = mesh.attributes.new(stored.name, stored.data_type, stored.domain)
    name = attribute.name
    if stored.domain == 'FACE':
        sources, weights = result.face_sources, None
    elif stored.domain == 'EDGE':
        sources, weights = result.edge_sources, None
    elif stored.domain == 'CORNER':
        sources, weights = result.corner_sources, result.corner_weights
    else:
        sources, weights = result.vertex_sources, result.vertex_weights
    if weights is not None and stored.data_type not in _LINEAR:
        sources = np.take_along_axis(sources, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        weights = None
    if isinstance(stored.values, list):
        for item, source in zip(attribute.data, sources.tolist(), strict=True):
            if source >= 0:
                item.value = stored.values[source]
        return
    if weights is None:
        values = stored.values[sources]
        values[sources < 0] = 0  # edges inside of faces: neither sharp nor a seam
    else:
        values = _means(stored.values, sources, weights).reshape(len(sources), -1)
        if stored.domain == 'POINT':
            values[:old_count] = stored.values
            if stored.name in _AT_OLD_VERTICES:
                values[old_count:] = 0.0
        if stored.data_type == 'QUATERNION':
            values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
    property_name = (_LINEAR | _NEAREST)[stored.data_type][0]
    mesh.attributes[name].data.foreach_set(property_name, np.ascontiguousarray(values).ravel())


def _write_geometry(mesh: bpy.types.Mesh, positions: np.ndarray, result: SubdividedMesh) -> None:
    mesh.vertices.add(len(positions))
    mesh.edges.add(len(result.edges))
    mesh.loops.add(len(result.corner_vertices))
    mesh.polygons.add(len(result.face_sources))
    mesh.attributes["position"].data.foreach_set("vector", np.ascontiguousarray(positions, dtype=np.float32).ravel())
    mesh.attributes[".edge_verts"].data.foreach_set("value", np.ascontiguousarray(result.edges).ravel())
    mesh.attributes[".corner_vert"].data.foreach_set("value", result.corner_vertices)
    mesh.attributes[".corner_edge"].data.foreach_set("value", result.corner_edges)
    mesh.polygons.foreach_set("loop_start", np.ascontiguousarray(result.face_offsets[:-1]))


def _read_freestyle(mesh: bpy.types.Mesh):
    """Freestyle marks of edges and faces; they are attributes from Blender 5.0 on, and properties before."""
    marks = []
    for items, kind in ((mesh.edges, bpy.types.MeshEdge), (mesh.polygons, bpy.types.MeshPolygon)):
        values = None
        if "use_freestyle_mark" in kind.bl_rna.properties:
            values = np.empty(len(items), dtype=bool)
            items.foreach_get("use_freestyle_mark", values)
        marks.append(values)
    return marks


def _write_freestyle(mesh: bpy.types.Mesh, marks, result: SubdividedMesh) -> None:
    sources_of = (result.edge_sources, result.face_sources)
    for items, old, sources in zip((mesh.edges, mesh.polygons), marks, sources_of, strict=True):
        if old is not None and old.any():
            items.foreach_set("use_freestyle_mark", np.where(sources >= 0, old[sources], False))


def _keep_shading(mesh: bpy.types.Mesh, normals: np.ndarray, had_custom_normals: bool) -> None:
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    shown = read_corner_normals(mesh)
    # Opposite normals can cancel in between: there Blender's own are as good as any.
    normals = np.where(lengths > 1e-6, normals / np.maximum(lengths, 1e-6), shown)
    turn = np.linalg.norm(normals - shown, axis=1)
    turn = turn[np.isfinite(turn)]
    if had_custom_normals or (len(turn) and turn.max() > SHADING_TOLERANCE):
        # Zeros mean "as Blender has it". Tuples, because Blender takes arrays apart ten times slower.
        normals = np.where(np.isfinite(normals), normals, 0.0)
        mesh.normals_split_custom_set(list(zip(*normals.T.tolist(), strict=True)))


@dataclass(frozen=True)
class _LayerChoice:
    """Which UV map and color attribute are active and rendered."""

    active_uv: str | None
    render_uv: str | None
    active_color: str | None
    default_color: str | None
    active: str | None

    @classmethod
    def of(cls, mesh: bpy.types.Mesh) -> _LayerChoice:
        attributes, layers = mesh.attributes, mesh.uv_layers
        return cls(
            active_uv=layers.active.name if layers.active else None,
            render_uv=next((layer.name for layer in layers if layer.active_render), None),
            active_color=attributes.active_color_name,
            default_color=attributes.default_color_name,
            active=attributes.active.name if attributes.active else None,
        )

    def restore(self, mesh: bpy.types.Mesh) -> None:
        attributes, layers = mesh.attributes, mesh.uv_layers
        if self.active_uv and self.active_uv in layers:
            layers.active = layers[self.active_uv]
        if self.render_uv and self.render_uv in layers:
            layers[self.render_uv].active_render = True
        if self.active and self.active in attributes:
            attributes.active = attributes[self.active]
        if self.active_color:
            attributes.active_color_name = self.active_color
        if self.default_color:
            attributes.default_color_name = self.default_color
