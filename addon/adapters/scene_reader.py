"""The scene as the core wants it: everything that a render shows becomes arrays, once, before the bake.

Instances of one mesh are transformed together, so that ten thousand of them cost one pass and no loop over elements.
Objects in Edit Mode are refused by name: their mesh is in the hands of the editor. Limits: hair, point clouds and
volumes do not block light; modifiers count as the viewport shows them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.errors import RadiosityError
from ...core.lights import Light
from ...core.scene import Scene
from .images import ImageLibrary
from .lamps import LampReader, is_portal
from .light_groups import light_groups
from .materials import Look, MaterialLibrary, join_names
from .mesh_arrays import MeshArrays, read_corner_attribute, read_mesh
from .receiver_meshes import choose_receivers, read_receivers
from .render_visibility import instanced_objects, rendered_objects, shown_as_rendered
from .surfaces import Placement, build_surfaces
from .world import read_world


@dataclass(frozen=True)
class SceneReading:
    """What was read.

    Parameters
    ----------
    scene : Scene
    targets : tuple of str
        Names of the objects that receive, in the order of `scene.receivers`.
    skipped : tuple of (str, str)
        Objects that were asked for but do not receive, with the reason.
    counts : dict of str to int
        ``objects``, ``meshes`` (distinct ones), ``faces``, ``triangles``, ``lights`` (lamps), ``materials``,
        ``receivers``.
    shared : tuple of (str, str)
        Objects that were skipped since they share their mesh, with the object that receives for both.
    lamps : tuple of str
        Objects of the first of `scene.lights`; the rest are suns of the world.
    """

    scene: Scene
    targets: tuple[str, ...]
    skipped: tuple[tuple[str, str], ...]
    counts: dict[str, int]
    shared: tuple[tuple[str, str], ...] = ()
    lamps: tuple[str, ...] = ()


def read_scene(
    context: bpy.types.Context,
    receivers: Sequence[bpy.types.Object] | None = None,
    world_strength: float | None = None,
    grouping: str = "NONE",
) -> SceneReading:
    """Read the scene and view layer of a context.

    Parameters
    ----------
    context : bpy.types.Context
    receivers : sequence of bpy.types.Object, optional
        Who wants to know its light; by default the selected meshes, or without any, all that render.
    world_strength : float, optional
        Replaces the strength of the world's background, in W/(m2 sr).
    grouping : str
        Whose light is kept apart; see `light_groups.light_groups`.

    Returns
    -------
    SceneReading

    Raises
    ------
    EmptySceneError
        If no mesh with faces can receive.
    RadiosityError
        If an object of the view layer is in Edit Mode.
    """
    for obj in context.view_layer.objects:
        if obj.mode == 'EDIT':
            raise RadiosityError(f"{obj.name!r} is in Edit Mode: switch to Object Mode to bake")
    with shown_as_rendered(context) as depsgraph:
        choice = choose_receivers(context, receivers)
        reader = _Reader(context, depsgraph)
        reader.read_instances()
        surfaces = build_surfaces(reader.placements)
        counts = reader.counts()
        reader.forget_meshes()
        meshes, retopologized = read_receivers(context, choice.objects, reader.materials)
        world = getattr(context.view_layer, "world_override", None) or context.scene.world  # override from Blender 5.0
        sky, suns, world_warnings = read_world(world, reader.images, world_strength)
    warnings = [*reader.warnings(), *world_warnings]
    if retopologized:
        warnings.append(
            f"Modifiers that change the topology: light is baked on the base mesh of {join_names(retopologized)}"
        )
    warnings += _image_warnings(reader.images)
    scene = Scene(surfaces, tuple(meshes), (*reader.lights, *suns), sky, tuple(warnings))
    if grouping != "NONE":
        scene = replace(scene, groups=light_groups(grouping, scene, reader.lamp_names, context.scene))
    counts = {
        **counts,
        "triangles": len(surfaces.triangles),
        "lights": len(reader.lights),
        "materials": reader.materials.count,
        "receivers": len(meshes),
    }
    targets = tuple(obj.name for obj in choice.objects)
    return SceneReading(scene, targets, choice.skipped, counts, choice.shared, tuple(reader.lamp_names))


class _Reader:
    """Walks over what the evaluated scene shows and sorts it."""

    def __init__(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        self.images = ImageLibrary()
        self.materials = MaterialLibrary(self.images, context.view_layer.material_override)
        self.placements: dict[tuple, Placement] = {}
        self.lights: list[Light] = []
        self.lamp_names: list[str] = []
        self._lamps = LampReader(self.images)
        self._depsgraph = depsgraph
        self._rendered = rendered_objects(context.view_layer)
        self._instanced: dict[bpy.types.Object, set[bpy.types.Object]] = {}
        self._meshes: dict[int, MeshArrays] = {}
        self._names: defaultdict[str, list[str]] = defaultdict(list)

    def read_instances(self) -> None:
        """Collect meshes and lamps. References to evaluated data live only as long as the evaluated scene does."""
        for instance in self._depsgraph.object_instances:
            obj = instance.object
            if obj.type not in ('MESH', 'LIGHT') or not instance.show_self or not self._is_rendered(instance):
                continue
            placed = instance.matrix_world
            matrix = np.array(placed, dtype=np.float64)
            if obj.type == 'LIGHT':
                self._add_lamp(obj, matrix)
            else:
                self._add_mesh(obj, matrix, placed.is_negative)

    def warnings(self) -> list[str]:
        """What lamps and materials had to leave out, and objects whose settings differ from what was read."""
        lines = [f"{text}: {join_names(dict.fromkeys(names))}" for text, names in self._names.items()]
        return [*lines, *self.materials.warnings(), *self._lamps.warnings()]

    def forget_meshes(self) -> None:
        """Let go of the meshes once surfaces are made of them."""
        self.placements.clear()
        self._meshes.clear()

    def counts(self) -> dict[str, int]:
        """Objects with instances, distinct meshes and faces."""
        sizes = [(len(each.matrices), len(each.arrays.face_offsets) - 1) for each in self.placements.values()]
        return {
            "objects": sum(count for count, _ in sizes),
            "meshes": len(self._meshes),
            "faces": sum(count * faces for count, faces in sizes),
        }

    def _is_rendered(self, instance) -> bool:
        if not instance.is_instance:
            obj = instance.object.original
            # The original of what is instanced on vertices or faces is drawn for editing only.
            is_pattern = obj.parent is not None and obj.parent.instance_type in ('VERTS', 'FACES')
            return obj in self._rendered and not is_pattern
        parent = instance.parent.original
        if parent not in self._rendered:
            return False
        if parent.instance_type == 'COLLECTION' and parent.instance_collection is not None:
            if parent not in self._instanced:
                self._instanced[parent] = instanced_objects(parent.instance_collection)
            return instance.object.original in self._instanced[parent]
        # Instances on vertices and faces are children with switches of their own. What geometry nodes, particles or a
        # curve's own surface make is shown whatever the source's switches say.
        return parent.instance_type in ('NONE', 'COLLECTION') or not instance.object.original.hide_render

    def _add_lamp(self, obj, matrix) -> None:
        if is_portal(obj.data) or not obj.visible_diffuse:
            return
        light = self._lamps.read(obj, matrix)
        if light is not None:
            self.lights.append(light)
            self.lamp_names.append(obj.name)

    def _add_mesh(self, obj, matrix, mirrored: bool) -> None:
        mesh = obj.data
        if not len(mesh.polygons):
            return
        if not obj.visible_diffuse and not obj.visible_shadow:
            return
        if not obj.visible_diffuse or not obj.visible_shadow:
            self._names["Hidden from shadow or diffuse rays only, and taken as visible to both"].append(obj.name)
        if any(modifier.show_viewport != modifier.show_render for modifier in obj.modifiers):
            self._names["Modifiers differ between viewport and render: the viewport's were baked"].append(obj.name)
        slots = [self.materials.override or slot.material for slot in obj.material_slots] or [self.materials.override]
        color = tuple(obj.color)
        pointers = tuple(slot.as_pointer() if slot is not None else 0 for slot in slots)
        key = (mesh.as_pointer(), pointers, color, mirrored)
        if key not in self.placements:
            if mesh.as_pointer() not in self._meshes:
                self._meshes[mesh.as_pointer()] = read_mesh(mesh)
            arrays = self._meshes[mesh.as_pointer()]
            looks = self._used_looks(arrays, slots)
            attributes = {
                key: read_corner_attribute(mesh, arrays, key, color)
                for key in sorted({key for look in looks for key in look.attributes})
            }
            self.placements[key] = Placement(arrays, looks, attributes, mirrored)
        self.placements[key].add(obj.name, matrix)

    def _used_looks(self, arrays: MeshArrays, slots) -> list[Look]:
        """One look per slot; a slot without faces is not read, so that nothing is said about it."""
        used = np.zeros(len(slots), dtype=bool)
        used[np.minimum(arrays.face_materials, len(slots) - 1)] = True
        return [
            self.materials.look(slot.original if slot is not None and use else None)
            for slot, use in zip(slots, used, strict=True)
        ]


def _image_warnings(images: ImageLibrary) -> list[str]:
    """One line per kind of trouble with images."""
    texts = {
        "missing": "Missing images were taken as mid gray",
        "tiled": "Of tiled images only the first tile was read",
        "color space": "Images in color spaces that are not known were read as sRGB",
    }
    found: defaultdict[str, list[str]] = defaultdict(list)
    for kind, name in images.problems:
        found[kind].append(name)
    return [f"{texts[kind]}: {join_names(dict.fromkeys(names))}" for kind, names in found.items()]
