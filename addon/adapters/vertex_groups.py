"""Vertex groups of a mesh as arrays, which Blender's Python does not offer.

Python sees weights vertex by vertex only. Geometry nodes see a group as an attribute, so a node that copies attributes,
on a temporary object, reads and writes whole groups at once. Everything temporary is removed again.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bmesh
import bpy
import numpy as np

_PREFIX = "radiosity_weights_"


def _group_names(mesh: bpy.types.Mesh) -> list[str]:
    """Names of the groups that the mesh has weights for."""
    # Groups are named by the mesh but listed by its objects.
    obj = next((obj for obj in bpy.data.objects if obj.data == mesh), None)
    return [group.name for group in obj.vertex_groups] if obj is not None else []


def read_vertex_groups(mesh: bpy.types.Mesh) -> list[tuple[str, np.ndarray]]:
    """Name and weights (n,) float32 of each group, 0 for vertices outside of it. Empty without groups."""
    names = _group_names(mesh)
    if not names:
        return []
    copies = [(name, f"{_PREFIX}{number}") for number, name in enumerate(names)]
    with _evaluated_copy(mesh, names, copies) as evaluated:
        groups = []
        for name, copy in copies:
            weights = np.empty(len(mesh.vertices), dtype=np.float32)
            evaluated.attributes[copy].data.foreach_get("value", weights)
            groups.append((name, weights))
    return groups


def write_vertex_groups(mesh: bpy.types.Mesh, groups: list[tuple[str, np.ndarray]]) -> None:
    """Give the mesh the weights (n,) of groups that its objects have; vertices with weight 0 do not become members.

    Replaces the geometry by an equal one: what else is stored on the mesh must be written afterwards.
    """
    copies = [(f"{_PREFIX}{number}", name) for number, (name, _) in enumerate(groups)]
    for (copy, _), (_, weights) in zip(copies, groups, strict=True):
        attribute = mesh.attributes.new(copy, 'FLOAT', 'POINT')
        attribute.data.foreach_set("value", np.ascontiguousarray(weights, dtype=np.float32))
    with _evaluated_copy(mesh, [name for name, _ in groups], copies) as evaluated:
        weighted = bmesh.new()
        try:
            weighted.from_mesh(evaluated)
            weighted.to_mesh(mesh)
        finally:
            weighted.free()
    for copy, _ in copies:
        mesh.attributes.remove(mesh.attributes[copy])


@contextmanager
def _evaluated_copy(mesh, names, copies) -> Iterator[bpy.types.Mesh]:
    """The mesh after attributes were copied, as pairs (from, to), on an object that has groups of these names."""
    tree = _copying_nodes(copies)
    obj = bpy.data.objects.new("radiosity_weights", mesh)
    scene = bpy.data.scenes.new("radiosity_weights")
    try:
        scene.collection.objects.link(obj)
        for name in names:
            if name not in obj.vertex_groups:
                obj.vertex_groups.new(name=name)
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
