"""Vertex groups of a mesh as arrays, which Blender's Python does not offer.

Python sees weights vertex by vertex only. Geometry nodes see a group as an attribute, so a node that copies attributes,
on a temporary object, reads and writes whole groups at once. Everything temporary is removed again.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bmesh
import bpy
import numpy as np

_PREFIX = "radiosity_weights_"


@dataclass(frozen=True)
class VertexGroups:
    """All groups of a mesh, in order."""

    names: list[str]
    locked: list[bool]
    active: int
    weights: list[np.ndarray]  # (n,) float32 each, 0 for vertices outside of the group


def _listed(mesh: bpy.types.Mesh) -> bpy.types.VertexGroups:
    """The groups, which the mesh owns but only its objects list."""
    return next(obj for obj in bpy.data.objects if obj.data == mesh).vertex_groups


def read_vertex_groups(mesh: bpy.types.Mesh) -> VertexGroups:
    """The groups of a mesh that some object shows."""
    listed = _listed(mesh)
    names, locked = [group.name for group in listed], [group.lock_weight for group in listed]
    weights = []
    if names:
        copies = [(name, f"{_PREFIX}{number}") for number, name in enumerate(names)]
        with _evaluated_copy(mesh, copies) as evaluated:
            for _, copy in copies:
                values = np.empty(len(mesh.vertices), dtype=np.float32)
                evaluated.attributes[copy].data.foreach_get("value", values)
                weights.append(values)
    return VertexGroups(names, locked, listed.active_index, weights)


def write_vertex_groups(mesh: bpy.types.Mesh, groups: VertexGroups) -> None:
    """Give groups to a mesh that has none; vertices with weight 0 do not become members.

    Replaces the geometry by an equal one: what else is stored on the mesh must be written afterwards.
    """
    if not groups.names:
        return
    listed = _listed(mesh)
    for name, locked in zip(groups.names, groups.locked, strict=True):
        listed.new(name=name).lock_weight = locked
    listed.active_index = groups.active
    copies = [(f"{_PREFIX}{number}", name) for number, name in enumerate(groups.names)]
    for (copy, _), weights in zip(copies, groups.weights, strict=True):
        attribute = mesh.attributes.new(copy, 'FLOAT', 'POINT')
        attribute.data.foreach_set("value", np.ascontiguousarray(weights, dtype=np.float32))
    with _evaluated_copy(mesh, copies) as evaluated:
        weighted = bmesh.new()
        try:
            weighted.from_mesh(evaluated)
            weighted.to_mesh(mesh)
        finally:
            weighted.free()
    for copy, _ in copies:
        mesh.attributes.remove(mesh.attributes[copy])


@contextmanager
def _evaluated_copy(mesh, copies) -> Iterator[bpy.types.Mesh]:
    """The mesh after attributes or groups were copied, as pairs (from, to)."""
    tree = _copying_nodes(copies)
    obj = bpy.data.objects.new("radiosity_weights", mesh)
    scene = bpy.data.scenes.new("radiosity_weights")
    try:
        scene.collection.objects.link(obj)
        obj.modifiers.new("Copy", 'NODES').node_group = tree
        # A scene of its own: evaluating the user's would take as long as all their modifiers do.
        with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
            graph = bpy.context.evaluated_depsgraph_get()
        evaluated = obj.evaluated_get(graph)
        try:
            yield evaluated.to_mesh()
        finally:
            evaluated.to_mesh_clear()
    finally:
        bpy.data.objects.remove(obj)
        bpy.data.scenes.remove(scene)
        bpy.data.node_groups.remove(tree)


def _copying_nodes(copies) -> bpy.types.NodeTree:
    """Geometry nodes that store each (from, to) pair's first attribute, on points, under the second's name."""
    tree = bpy.data.node_groups.new("radiosity_weights", 'GeometryNodeTree')
    for direction in ('INPUT', 'OUTPUT'):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type='NodeSocketGeometry')
    geometry = tree.nodes.new('NodeGroupInput').outputs[0]
    for source, target in copies:
        read = tree.nodes.new('GeometryNodeInputNamedAttribute')
        read.data_type = 'FLOAT'
        read.inputs["Name"].default_value = source
        store = tree.nodes.new('GeometryNodeStoreNamedAttribute')
        store.data_type, store.domain = 'FLOAT', 'POINT'
        store.inputs["Name"].default_value = target
        tree.links.new(geometry, store.inputs["Geometry"])
        tree.links.new(read.outputs["Attribute"], store.inputs["Value"])
        geometry = store.outputs["Geometry"]
    tree.links.new(geometry, tree.nodes.new('NodeGroupOutput').inputs[0])
    return tree
