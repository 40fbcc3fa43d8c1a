"""Receivers: which objects get light written into their mesh, and that mesh in the world.

What is baked is the mesh that holds the attribute, the artist's own. It stands where modifiers move it; those that
change its topology (Bevel, Subdivision Surface, Mirror) are left out for it, while they do shape what blocks light.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.errors import EmptySceneError
from ...core.scene import ReceiverMesh
from .materials import MaterialLibrary
from .mesh_arrays import (
    has_same_topology,
    read_corner_attribute,
    read_corner_normals,
    read_mesh,
    read_vertex_normals,
)
from .render_visibility import rendered_objects
from .surface_shader import evaluate
from .surfaces import transform_normals, transform_points

#: Modifiers that leave vertices, edges and faces as they are.
_DEFORMING = frozenset(
    (
        'ARMATURE CAST CLOTH COLLISION CORRECTIVE_SMOOTH CURVE DATA_TRANSFER DISPLACE DYNAMIC_PAINT HOOK '
        'LAPLACIANDEFORM LAPLACIANSMOOTH LATTICE MESH_CACHE MESH_DEFORM MESH_SEQUENCE_CACHE NORMAL_EDIT '
        'PARTICLE_SYSTEM SHRINKWRAP SIMPLE_DEFORM SMOOTH SOFT_BODY SURFACE SURFACE_DEFORM UV_PROJECT UV_WARP '
        'VERTEX_WEIGHT_EDIT VERTEX_WEIGHT_MIX VERTEX_WEIGHT_PROXIMITY WARP WAVE WEIGHTED_NORMAL'
    ).split()
)

#: Node groups that only smooth: Blender's own, and the one it adds to files from before 4.1.
_SMOOTHING = ("Smooth by Angle", "Auto Smooth")


@dataclass(frozen=True)
class ReceiverChoice:
    """Objects that receive, those that do not (name, reason), and those left out for a shared mesh (name, other)."""

    objects: tuple[bpy.types.Object, ...]
    skipped: tuple[tuple[str, str], ...]
    shared: tuple[tuple[str, str], ...]


def choose_receivers(context: bpy.types.Context, receivers: Sequence[bpy.types.Object] | None = None) -> ReceiverChoice:
    """Decide which objects receive.

    Parameters
    ----------
    context : bpy.types.Context
    receivers : sequence of bpy.types.Object, optional
        By default the selected meshes of the view layer, or where none is selected, all that render.

    Returns
    -------
    ReceiverChoice

    Raises
    ------
    EmptySceneError
        If none is left; the text says what to do.
    """
    view_layer = context.view_layer
    if receivers is None:
        selected = [obj for obj in view_layer.objects if obj.select_get(view_layer=view_layer)]
        if not any(obj.type == 'MESH' for obj in selected):
            rendered = rendered_objects(view_layer)
            selected = [obj for obj in view_layer.objects if obj.type == 'MESH' and obj in rendered]
            if not selected:
                raise EmptySceneError("The scene has no mesh that renders: add one, or show one to the render")
    else:
        selected = list(dict.fromkeys(receivers))
    present = set(view_layer.objects)
    chosen: dict[bpy.types.Mesh, bpy.types.Object] = {}
    skipped, shared = [], []
    for obj in selected:
        reason = _reason_to_skip(obj, present)
        if reason is None and obj.data in chosen:
            other = chosen[obj.data].name
            reason = f"shares its mesh with {other}, and only one can be baked: make it single-user"
            shared.append((obj.name, other))
        if reason is None:
            chosen[obj.data] = obj
        else:
            skipped.append((obj.name, reason))
    if not chosen:
        reasons = "; ".join(f"{name} {reason}" for name, reason in skipped[:4])
        raise EmptySceneError(f"No mesh can receive light ({reasons}): select an editable mesh with faces")
    return ReceiverChoice(tuple(chosen.values()), tuple(skipped), tuple(shared))


def _reason_to_skip(obj, present: set[bpy.types.Object]) -> str | None:
    if obj.type != 'MESH':
        can_convert = obj.type in ('CURVE', 'SURFACE', 'FONT', 'META')
        return "is not a mesh: convert it to one" if can_convert else "is not a mesh"
    if obj not in present:
        return "is not in the view layer"
    if obj.data.library is not None or not obj.data.is_editable:
        return "has a mesh linked from another file: make it local"
    if not len(obj.data.polygons):
        return "has no faces"
    return None


def read_receivers(
    context: bpy.types.Context, objects: Sequence[bpy.types.Object], materials: MaterialLibrary
) -> tuple[list[ReceiverMesh], list[str]]:
    """The meshes of objects in the world, with the colors of their materials.

    Parameters
    ----------
    context : bpy.types.Context
        Modifiers that change the topology of one of the objects are switched off for a moment, which evaluates the
        scene again: nothing evaluated before may be used after.
    objects : sequence of bpy.types.Object
        Original mesh objects.
    materials : MaterialLibrary

    Returns
    -------
    meshes : list of ReceiverMesh
        In the order of `objects`.
    changed : list of str
        Objects with modifiers that change the topology, and the names of these.
    """
    depsgraph = context.evaluated_depsgraph_get()
    meshes = {}
    changed = []
    for obj in objects:
        evaluated = obj.evaluated_get(depsgraph)
        if not obj.modifiers or has_same_topology(evaluated.data, obj.data):
            meshes[obj] = _read_receiver(obj, evaluated.data, evaluated.matrix_world, materials)
        else:
            changed.append(obj)
    names = [f"{obj.name} ({', '.join(each.name for each in _changing_modifiers(obj))})" for obj in changed]
    if changed:
        with _switched_off(context, [each for obj in changed for each in _changing_modifiers(obj)]) as depsgraph:
            for obj in changed:
                evaluated = obj.evaluated_get(depsgraph)
                mesh = evaluated.data if has_same_topology(evaluated.data, obj.data) else obj.data
                receiver = _read_receiver(obj, mesh, evaluated.matrix_world, materials)
                meshes[obj] = replace(receiver, is_off_surface=True)
    return [meshes[obj] for obj in objects], names


def _changing_modifiers(obj) -> list[bpy.types.Modifier]:
    return [
        each
        for each in obj.modifiers
        if each.show_viewport
        and each.type not in _DEFORMING
        and not (each.type == 'NODES' and each.node_group and each.node_group.name.startswith(_SMOOTHING))
    ]


@contextmanager
def _switched_off(context: bpy.types.Context, modifiers: Sequence[bpy.types.Modifier]) -> Iterator[bpy.types.Depsgraph]:
    """The scene evaluated without some modifiers, so that those which only move or smooth still count."""
    try:
        for modifier in modifiers:
            modifier.show_viewport = False
        context.view_layer.update()
        yield context.evaluated_depsgraph_get()
    finally:
        for modifier in modifiers:
            modifier.show_viewport = True
        context.view_layer.update()


def _read_receiver(obj, mesh, matrix, materials) -> ReceiverMesh:
    arrays = read_mesh(mesh, with_triangles=False)
    flipped = matrix.is_negative
    matrix = np.array(matrix, dtype=np.float64)
    slots = [materials.override or slot.material for slot in obj.material_slots] or [materials.override]
    slot_rows = np.minimum(arrays.face_materials, len(slots) - 1)
    used = np.bincount(slot_rows, minlength=len(slots)) > 0
    looks = [materials.look(slot if use else None) for slot, use in zip(slots, used, strict=True)]
    values = [(np.zeros(3), np.zeros(3), 0.0) if look.attributes else look.values for look in looks]
    reflectance = np.array([value[0] for value in values])
    emission = np.array([value[1] for value in values])
    colors = (None, None)
    if any(look.attributes for look in looks):
        colors = _corner_colors(mesh, arrays, obj, looks, slot_rows, reflectance, emission)
    by_vertex = read_vertex_normals(mesh)
    by_corner = transform_normals(read_corner_normals(mesh), matrix) if by_vertex is None else None
    return ReceiverMesh(
        name=obj.name,
        positions=transform_points(arrays.positions, matrix[None])[0],
        corner_vertices=arrays.corner_vertices,
        corner_normals=by_corner,
        vertex_normals=None if by_vertex is None else transform_normals(by_vertex, matrix),
        face_offsets=arrays.face_offsets,
        face_materials=slot_rows.astype(np.int32),
        palette_reflectance=reflectance,
        palette_emission=emission,
        corner_reflectance=colors[0],
        corner_emission=colors[1],
        flipped=flipped,
    )


def _corner_colors(mesh, arrays, obj, looks, slot_rows, reflectance, emission) -> tuple[np.ndarray, np.ndarray]:
    """(c, 3) float32 reflectance and emission at every corner; fills the palette's rows that vary with their means."""
    corner_slots = np.repeat(slot_rows, np.diff(arrays.face_offsets))
    attributes = {
        key: read_corner_attribute(mesh, arrays, key, tuple(obj.color))
        for key in sorted({key for look in looks for key in look.attributes})
    }
    corner_reflectance = reflectance[corner_slots].astype(np.float32)
    corner_emission = emission[corner_slots].astype(np.float32)
    for row, look in enumerate(looks):
        inside = np.flatnonzero(corner_slots == row)
        if not look.attributes or not len(inside):
            continue
        here = {key: attributes[key][inside] for key in look.attributes}
        corner_reflectance[inside], corner_emission[inside], _ = evaluate(look, here, len(inside))
        reflectance[row] = corner_reflectance[inside].mean(0, dtype=np.float64)
        emission[row] = corner_emission[inside].mean(0, dtype=np.float64)
    return corner_reflectance, corner_emission
