"""`radiosity.clear`: afterwards the file is what it was before the first bake."""

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters.preview_material import PREVIEW_NAME, artist_materials, has_preview


@pytest.fixture
def room():
    """A floor with two materials, one on the mesh and one on the object; a cube without slots; a lamp."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4, size=4)
    floor = bpy.context.object
    floor.name = "Floor"
    for name in ("Wood", "Stone"):
        floor.data.materials.append(bpy.data.materials.new(name))
    floor.material_slots[1].link = 'OBJECT'
    floor.material_slots[1].material = bpy.data.materials.new("Own")
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0, 0, 0.5))
    cube = bpy.context.object
    cube.name = "Cube"
    paint = floor.data.color_attributes.new(name="Paint", type='BYTE_COLOR', domain='POINT')
    paint.data.foreach_set("color", np.linspace(0, 1, 4 * len(paint.data), dtype=np.float32))
    bpy.ops.object.light_add(type='POINT', location=(1, 1, 3))
    bpy.context.object.data.energy = 200
    for obj in (floor, cube):
        obj.select_set(True)
    return floor, cube


def simple_values(struct):
    """Values of all plain properties of a Blender struct, by name."""
    values = {}
    for prop in struct.bl_rna.properties:
        if prop.type in ('BOOLEAN', 'INT', 'FLOAT', 'STRING', 'ENUM') and prop.identifier not in _RUNTIME:
            value = getattr(struct, prop.identifier)
            values[prop.identifier] = tuple(value) if getattr(prop, "is_array", False) else value
        elif prop.type == 'POINTER' and isinstance(getattr(struct, prop.identifier), bpy.types.ID):
            values[prop.identifier] = getattr(struct, prop.identifier).name
    return values


#: What the session sets, not the artist; and what Blender 5 deprecates.
_RUNTIME = {
    'use_nodes',
    'is_evaluated',
    'tag',
    'session_uid',
    'is_updated',
    'is_updated_data',
    'matrix_world',
    'dimensions',
}


def attribute_values(attribute):
    field, width, kind = {
        'FLOAT_COLOR': ("color", 4, np.float32),
        'BYTE_COLOR': ("color", 4, np.float32),
        'FLOAT_VECTOR': ("vector", 3, np.float32),
        'FLOAT2': ("vector", 2, np.float32),
        'INT': ("value", 1, np.int32),
        'INT32_2D': ("value", 2, np.int32),
        'BOOLEAN': ("value", 1, bool),
    }[attribute.data_type]
    values = np.empty(width * len(attribute.data), kind)
    attribute.data.foreach_get(field, values)
    return attribute.name, attribute.domain, attribute.data_type, values.tobytes()


def whole_file():
    """All data-blocks of the file with their plain values, custom properties, mesh attributes, slots and shading."""
    dump = {}
    for collection in (getattr(bpy.data, name) for name in dir(bpy.data)):
        if not isinstance(collection, bpy.types.bpy_prop_collection):
            continue
        for block in collection:
            key = (type(block).__name__, block.name_full)
            dump[key] = {**simple_values(block), 'keys': sorted(block.keys())}
            if isinstance(block, bpy.types.Mesh):
                group = block.attributes
                dump[key] |= {
                    'attributes': sorted(map(attribute_values, group)),
                    'active': (group.active_color_name, group.default_color_name, group.active and group.active.name),
                    'materials': [material and material.name for material in block.materials],
                }
            elif isinstance(block, bpy.types.Object):
                dump[key]['slots'] = [
                    (slot.link, slot.material and slot.material.name) for slot in block.material_slots
                ]
            elif isinstance(block, bpy.types.Screen):
                dump[key]['shading'] = [
                    simple_values(area.spaces.active.shading) for area in block.areas if area.type == 'VIEW_3D'
                ]
    return dump


def difference(before, after):
    lines = [f"{key} appeared" for key in after.keys() - before.keys()]
    lines += [f"{key} is gone" for key in before.keys() - after.keys()]
    for key in before.keys() & after.keys():
        lines += [
            f"{key} {name}: {before[key].get(name)!r:.80} became {after[key].get(name)!r:.80}"
            for name in before[key].keys() | after[key].keys()
            if before[key].get(name) != after[key].get(name)
        ]
    return lines


def bake(**arguments):
    bpy.ops.radiosity.bake(**{'quality': 'DRAFT', **arguments})


@pytest.mark.parametrize("active", ["", "Paint"])
def test_clear_leaves_the_file_as_it_was(room, active):
    floor, _cube = room
    if active:
        floor.data.attributes.active_color_name = floor.data.attributes.default_color_name = active
    else:
        floor.data.attributes.remove(floor.data.attributes["Paint"])
    before = whole_file()
    bake(show_in_viewport=True)
    bake(attribute_name="Second", domain='POINT', data_type='BYTE_COLOR')
    bpy.ops.radiosity.preview_material()
    assert difference(before, whole_file())
    bpy.ops.radiosity.clear()
    assert difference(before, whole_file()) == []


def test_a_bake_changes_the_attribute_and_what_it_says_and_nothing_else(room):
    before = whole_file()
    bake(show_in_viewport=False)
    changed = sorted(line.split(":")[0] for line in difference(before, whole_file()))
    names = ["('Mesh', 'Cube')", "('Mesh', 'Grid')"]
    wanted = [f"{name} {what}" for name in names for what in ("active", "attributes", "keys")]
    assert changed == sorted([*wanted, "('Scene', 'Scene') keys"])


def test_active_attribute_chosen_after_the_bake_stays_active(room):
    floor, _cube = room
    bake()
    floor.data.attributes.active_color_name = "Paint"
    bpy.ops.radiosity.clear()
    assert floor.data.attributes.active_color_name == "Paint"


def test_former_active_attribute_that_is_gone_gives_way_to_another(room):
    floor, _cube = room
    floor.data.attributes.active_color_name = "Paint"
    bake()
    floor.data.attributes.remove(floor.data.attributes["Paint"])
    other = floor.data.color_attributes.new(name="Other", type='BYTE_COLOR', domain='POINT').name
    floor.data.attributes.active_color_name = "Radiosity"
    bpy.ops.radiosity.clear()
    assert floor.data.attributes.active_color_name == other
    assert [attribute.name for attribute in floor.data.color_attributes] == [other]


def test_shading_changed_after_the_bake_stays(room):
    area = next(area for area in bpy.context.screen.areas if area.type == 'VIEW_3D')
    shading = area.spaces.active.shading
    bake(show_in_viewport=True)
    assert (shading.type, shading.light, shading.color_type) == ('SOLID', 'FLAT', 'VERTEX')
    shading.light = 'MATCAP'
    bpy.ops.radiosity.clear()
    assert (shading.type, shading.light, shading.color_type) == ('SOLID', 'MATCAP', 'MATERIAL')


def test_second_bake_does_not_forget_the_first_shading(room):
    area = next(area for area in bpy.context.screen.areas if area.type == 'VIEW_3D')
    area.spaces.active.shading.type = 'WIREFRAME'
    bake(show_in_viewport=True)
    bake(show_in_viewport=True)
    bpy.ops.radiosity.clear()
    assert area.spaces.active.shading.type == 'WIREFRAME'


def test_third_bake_does_not_take_later_shading_for_the_first(room):
    area = next(area for area in bpy.context.screen.areas if area.type == 'VIEW_3D')
    shading = area.spaces.active.shading
    bake(show_in_viewport=True)
    shading.light = 'MATCAP'
    bake(show_in_viewport=True)
    bpy.ops.radiosity.clear()
    assert (shading.type, shading.light, shading.color_type) == ('SOLID', 'STUDIO', 'MATERIAL')


def test_clear_is_refused_in_edit_mode(room):
    bake()
    bpy.context.view_layer.objects.active = room[0]
    bpy.ops.object.mode_set(mode='EDIT')
    with pytest.raises(RuntimeError, match="Switch to Object Mode"):
        bpy.ops.radiosity.clear()
    bpy.ops.object.mode_set(mode='OBJECT')


def test_clear_without_a_bake_changes_nothing(room):
    before = whole_file()
    assert bpy.ops.radiosity.clear() == {'FINISHED'}
    assert difference(before, whole_file()) == []


# Preview material


def shown(obj):
    return [slot.material and slot.material.name for slot in obj.material_slots]


def test_preview_shows_the_attribute_as_emission(room):
    bake()
    bpy.ops.radiosity.preview_material()
    for obj in room:
        assert set(shown(obj)) == {PREVIEW_NAME}
    nodes = bpy.data.materials[PREVIEW_NAME].node_tree.nodes
    (output,) = [node for node in nodes if node.type == 'OUTPUT_MATERIAL']
    emission = output.inputs["Surface"].links[0].from_node
    color = emission.inputs["Color"].links[0].from_node
    assert (emission.type, color.type, color.layer_name) == ('EMISSION', 'VERTEX_COLOR', "Radiosity")
    assert emission.inputs["Strength"].default_value == 1.0


def test_preview_can_be_switched_off_alone(room):
    bake()
    before = whole_file()
    bpy.ops.radiosity.preview_material()
    bpy.ops.radiosity.preview_material(use_preview=False)
    assert difference(before, whole_file()) == []


def test_preview_without_a_bake_says_so(room):
    with pytest.raises(RuntimeError, match="bake first"):
        bpy.ops.radiosity.preview_material()
    assert PREVIEW_NAME not in bpy.data.materials


def test_preview_follows_the_attribute_of_the_scene(room):
    bake()
    bake(attribute_name="Second")
    bpy.ops.radiosity.preview_material()
    bpy.context.scene.radiosity.attribute_name = "Second"
    bpy.ops.radiosity.preview_material()
    material = room[0].material_slots[0].material
    assert {node.layer_name for node in material.node_tree.nodes if node.type == 'VERTEX_COLOR'} == {"Second"}


def test_bake_with_the_preview_on_gives_the_same_light(room):
    """The preview glows: a bake that saw it would take the light of the last one for emission."""
    floor, _cube = room
    bake(attribute_name="Radiosity")
    first = attribute_values(floor.data.attributes["Radiosity"])
    bpy.ops.radiosity.preview_material()
    bake(attribute_name="Radiosity")
    assert attribute_values(floor.data.attributes["Radiosity"]) == first
    assert shown(floor) == [PREVIEW_NAME, PREVIEW_NAME]


def test_artist_materials_are_there_while_reading(room):
    floor, cube = room
    bake()
    bpy.ops.radiosity.preview_material()
    with pytest.raises(ZeroDivisionError), artist_materials(bpy.context.scene.objects):
        assert shown(floor) == ["Wood", "Own"] and not has_preview(floor)
        raise ZeroDivisionError
    assert shown(floor) == [PREVIEW_NAME, PREVIEW_NAME] and has_preview(cube)


def test_preview_survives_renaming_and_deleting_what_it_replaced(room):
    floor, _cube = room
    bake()
    bpy.ops.radiosity.preview_material()
    bpy.data.materials["Own"].name = "Renamed"
    bpy.ops.outliner.orphans_purge(do_recursive=True)
    bpy.ops.radiosity.clear()
    assert shown(floor) == ["Wood", "Renamed"]


def test_twins_that_share_a_mesh_without_slots_get_them_back(room):
    _floor, cube = room
    twin = bpy.data.objects.new("Twin", cube.data)
    bpy.context.collection.objects.link(twin)
    before = whole_file()
    bake()
    bpy.ops.radiosity.preview_material()
    assert shown(cube) == shown(twin) == [PREVIEW_NAME]
    bpy.ops.radiosity.clear()
    assert difference(before, whole_file()) == []
