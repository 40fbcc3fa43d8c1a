"""Preview material: shows the baked colors in EEVEE and Cycles, with the artist's materials left alone.

The preview goes into the object's own material slots (link ``OBJECT``), so the materials that the mesh holds are never
touched; what the object held itself is kept in the object's custom property `STATE_KEY`, by pointer, so that renaming
or purging loses nothing. A mesh without slots gets one, which is taken back. Since a bake must see the artist's
materials, it reads the scene inside `artist_materials`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import bpy

PREVIEW_NAME = "Radiosity Preview"

#: Custom property of an object: the former link of each slot, and the object's own materials.
STATE_KEY = "radiosity_preview"

#: Custom property of a mesh that got a slot, and of the material, which holds the attribute's name.
_SLOT_KEY = "radiosity_added_slot"
_MATERIAL_KEY = "radiosity_attribute"


def has_preview(obj: bpy.types.Object) -> bool:
    """Whether an object shows the preview material."""
    return STATE_KEY in obj


def show_preview(obj: bpy.types.Object, attribute_name: str) -> None:
    """Give all slots of a mesh object the preview material of an attribute. Again with another name: replaces it."""
    material = _preview_material(attribute_name)
    if not has_preview(obj):
        if not obj.material_slots:
            obj.data.materials.append(None)
            obj.data[_SLOT_KEY] = True
        _remember(obj)
    for slot in obj.material_slots:
        slot.link = 'OBJECT'
        slot.material = material


def restore_materials(obj: bpy.types.Object) -> bool:
    """Take back `show_preview`; whether there was anything. The slot added to a mesh goes with `remove_leftovers`."""
    if not has_preview(obj):
        return False
    state = obj[STATE_KEY]
    links = state["links"].split()
    for index, slot in enumerate(obj.material_slots):
        # A slot that the artist has added since was linked to the mesh, as new slots are.
        slot.link = 'OBJECT'
        slot.material = state.get(f"material_{index}")
        slot.link = links[index] if index < len(links) else 'DATA'
    del obj[STATE_KEY]
    return True


def remove_leftovers(objects: Iterable[bpy.types.Object]) -> None:
    """Remove the slots added to meshes of these objects, and preview materials that nothing uses any more."""
    for mesh in {obj.data for obj in objects if obj.data is not None and _SLOT_KEY in obj.data}:
        if any(has_preview(obj) for obj in bpy.data.objects if obj.data == mesh):
            continue
        del mesh[_SLOT_KEY]
        if len(mesh.materials) == 1 and mesh.materials[0] is None:
            mesh.materials.clear()  # tells the objects too, which pop() forgets
    for material in [material for material in bpy.data.materials if _MATERIAL_KEY in material]:
        if material.users == 0:
            bpy.data.materials.remove(material)


@contextmanager
def artist_materials(objects: Iterable[bpy.types.Object]) -> Iterator[None]:
    """While inside, objects that show the preview have the artist's materials."""
    shown = [
        (obj, slot.material[_MATERIAL_KEY])
        for obj in objects
        if has_preview(obj)
        for slot in obj.material_slots[:1]
        if slot.material is not None and _MATERIAL_KEY in slot.material
    ]
    for obj, _attribute in shown:
        restore_materials(obj)
    try:
        yield
    finally:
        for obj, attribute in shown:
            show_preview(obj, attribute)


def _remember(obj):
    state = {"links": " ".join(slot.link for slot in obj.material_slots)}
    for index, slot in enumerate(obj.material_slots):
        link = slot.link
        slot.link = 'OBJECT'  # an object may hold a material that its slot does not use
        if slot.material is not None:
            state[f"material_{index}"] = slot.material
        slot.link = link
    obj[STATE_KEY] = state


def _preview_material(attribute_name):
    for material in bpy.data.materials:
        if material.get(_MATERIAL_KEY) == attribute_name and material.library is None:
            return material
    material = bpy.data.materials.new(PREVIEW_NAME)
    material[_MATERIAL_KEY] = attribute_name
    if material.node_tree is None:  # always there from Blender 5.0, which warns when it is asked for
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    color = nodes.new('ShaderNodeVertexColor')
    color.layer_name = attribute_name
    color.location = (-400, 0)
    emission = nodes.new('ShaderNodeEmission')
    emission.location = (-200, 0)
    output = nodes.new('ShaderNodeOutputMaterial')
    links.new(color.outputs["Color"], emission.inputs["Color"])
    links.new(emission.outputs["Emission"], output.inputs["Surface"])
    return material
