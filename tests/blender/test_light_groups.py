"""Light groups in Blender: attributes beside the whole light, mixed without a bake, flattened, taken back."""

import json

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters import bake_job, group_mix
from radiosity.addon.adapters.color_attribute import group_attributes
from radiosity.addon.adapters.light_groups import LONGEST_NAME, MOST_GROUPS, group_attribute_names
from radiosity.addon.command_line import main

from tests.blender.test_bake_operator import colors, grid, snapshot
from tests.blender.test_panel import draw

#: Sums of a handful of float32 numbers, relative to the largest.
ROUNDING = 2e-6


def add_lamp(name, location, color=(1.0, 1.0, 1.0), power=50.0):
    light = bpy.data.lights.new(name, 'POINT')
    light.energy, light.color = power, color
    obj = bpy.data.objects.new(name, light)
    obj.location = location
    bpy.context.scene.collection.objects.link(obj)
    return obj


def glowing(name, strength=3.0):
    obj = grid(name, size=0.4, count=1, z=1.5)
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"].inputs
    shader["Emission Color"].default_value = (0.2, 0.5, 1.0, 1.0)
    shader["Emission Strength"].default_value = strength
    obj.data.materials.append(material)
    return obj


@pytest.fixture
def room():
    """A floor under a red lamp, a green one, a glowing panel and a sky; and a wall that receives too."""
    floor, wall = grid("Floor"), grid("Wall", count=3)
    wall.rotation_euler = 0.0, 1.5708, 0.0
    wall.location = 1.0, 0.0, 1.0
    add_lamp("Red", (0.0, 0.5, 2.0), (1.0, 0.1, 0.0))
    add_lamp("Green", (-0.5, -0.5, 1.5), (0.0, 1.0, 0.2))
    glowing("Panel")
    world = bpy.data.worlds.new("Sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.3
    bpy.context.scene.world = world
    return floor.data, wall.data


def bake(groups='LIGHT', **arguments):
    arguments = {'quality': 'DRAFT', 'show_in_viewport': False, 'light_groups': groups, **arguments}
    return bpy.ops.radiosity.bake(**arguments)


def mix():
    return bpy.context.scene.radiosity.groups


def total(mesh, factors=None):
    """(n, 4) sum of the groups of a mesh, each times a factor, as the mix defines it."""
    out = np.zeros_like(colors(mesh))
    for group, attribute in group_attributes(mesh)["Radiosity"].items():
        out[:, :3] += np.float32((factors or {}).get(group, 1.0)) * colors(mesh, attribute)[:, :3]
    out[:, 3] = 1
    return out


@pytest.mark.parametrize("domain", ['CORNER', 'POINT'])
@pytest.mark.parametrize("bake_type", ['COMBINED', 'INDIRECT'])
def test_each_light_has_an_attribute_and_they_add_up(room, domain, bake_type):
    bake('NONE', domain=domain, bake_type=bake_type)
    plain = [colors(mesh) for mesh in room]
    assert all(not group_attributes(mesh) for mesh in room) and not len(mix())
    assert bake(domain=domain, bake_type=bake_type) == {'FINISHED'}
    names = ["Green", "Panel", "Red", "World"]
    assert [(item.name, item.attribute) for item in mix()] == [(name, f"Radiosity.{name}") for name in names]
    for mesh, expected in zip(room, plain, strict=True):
        assert group_attributes(mesh) == {"Radiosity": {name: f"Radiosity.{name}" for name in names}}
        for name in names:
            stored = mesh.attributes[f"Radiosity.{name}"]
            assert (stored.domain, stored.data_type) == (domain, 'FLOAT_COLOR')
            assert (colors(mesh, stored.name)[:, 3] == 1).all()
        np.testing.assert_array_equal(colors(mesh), expected)
        np.testing.assert_allclose(total(mesh), expected, rtol=ROUNDING, atol=ROUNDING * expected.max())
        assert mesh.attributes.active_color_name == mesh.attributes.default_color_name == "Radiosity"
    red, green = (colors(room[0], f"Radiosity.{name}")[:, :3] for name in ("Red", "Green"))
    assert not red[:, 2].any() and not green[:, 0].any() and red[:, 0].any() and green[:, 1].any()
    report = json.loads(bpy.context.scene["radiosity_report"])
    assert report["light_groups"] == {name: f"Radiosity.{name}" for name in names}
    assert report["settings"]["light_groups"] == 'LIGHT'


def test_the_panels_own_brightness_is_in_its_group(room):
    bake(bake_type='EMISSION')
    panel = bpy.data.objects["Panel"].data
    assert (colors(panel, "Radiosity.Panel")[:, 2] > 2.9).all()
    assert not colors(panel, "Radiosity.Red")[:, :3].any() and not colors(room[0], "Radiosity.Panel")[:, :3].any()


def test_lights_of_a_collection_are_one_group(room):
    scene = bpy.context.scene
    warm = bpy.data.collections.new("Warm")
    scene.collection.children.link(warm)
    for name in ("Red", "Panel"):
        warm.objects.link(bpy.data.objects[name])
    bake()
    red_and_panel = sum(colors(room[0], f"Radiosity.{name}")[:, :3].astype(float) for name in ("Red", "Panel"))
    bake('COLLECTION')
    assert [item.name for item in mix()] == ["Scene Collection", "Warm", "World"]
    warm_light = colors(room[0], "Radiosity.Warm")[:, :3]
    np.testing.assert_allclose(warm_light, red_and_panel, rtol=1e-5, atol=1e-5 * warm_light.max())
    # Those of the bake before are gone.
    assert {each.name for each in room[0].color_attributes} == {"Radiosity", *(item.attribute for item in mix())}


def test_a_bake_without_groups_takes_them_away(room):
    bake()
    bake('NONE')
    assert [each.name for each in room[0].color_attributes] == ["Radiosity"] and not len(mix())


def test_the_mix_is_written_when_it_is_changed(room, monkeypatch):
    bake()
    monkeypatch.setattr(bake_job, "bake_steps", None)  # nothing is solved
    kept = {item.attribute: colors(room[0], item.attribute) for item in mix()}
    mix()["Red"].strength = 0.25
    np.testing.assert_array_equal(colors(room[0]), total(room[0], {"Red": 0.25}))
    mix()["Green"].use_group = False
    np.testing.assert_array_equal(colors(room[1]), total(room[1], {"Red": 0.25, "Green": 0.0}))
    mix()["World"].color = 0.5, 1.0, 2.0
    expected = total(room[0], {"Red": 0.25, "Green": 0.0, "World": np.array([0.5, 1.0, 2.0], np.float32)})
    np.testing.assert_array_equal(colors(room[0]), expected)
    assert all((colors(room[0], name) == values).all() for name, values in kept.items())


def test_mixed_light_is_that_of_a_bake_with_those_lamps(room):
    bake(quality='PREVIEW')
    bpy.ops.radiosity.mix_groups(group="Red", strength=2.0)
    bpy.ops.radiosity.mix_groups(group="Green", use_group=False)
    mixed = colors(room[0])[:, :3]
    bpy.data.objects["Red"].data.energy *= 2
    bpy.data.objects["Green"].data.energy = 0
    bake('NONE', quality='PREVIEW')
    expected = colors(room[0])[:, :3]
    # Both within the 3 % asked for; where nodes lie depends on the lights.
    assert np.sqrt(((mixed - expected) ** 2).mean()) / expected.mean() < 0.03


def test_the_operator_changes_what_it_is_given_and_resets(room):
    bake()
    whole = colors(room[0])
    assert bpy.ops.radiosity.mix_groups(group="Red", strength=0.5) == {'FINISHED'}
    assert bpy.ops.radiosity.mix_groups(group="Red", use_group=False) == {'FINISHED'}
    item = mix()["Red"]
    assert (item.use_group, item.strength, tuple(item.color)) == (False, 0.5, (1, 1, 1))
    np.testing.assert_array_equal(colors(room[0]), total(room[0], {"Red": 0.0}))
    assert group_mix.is_mixed(bpy.context.scene)
    bpy.ops.radiosity.mix_groups(reset=True)
    assert not group_mix.is_mixed(bpy.context.scene)
    np.testing.assert_allclose(colors(room[0]), whole, rtol=ROUNDING, atol=ROUNDING * whole.max())
    with pytest.raises(RuntimeError, match="no light group 'Blue': choose Green, Panel, Red, World"):
        bpy.ops.radiosity.mix_groups(group="Blue")


def test_a_new_bake_shows_the_light_as_it_is(room):
    bake()
    whole = colors(room[0])
    mix()["Red"].strength = 3.0
    bake()
    assert mix()["Red"].strength == 1.0
    np.testing.assert_array_equal(colors(room[0]), whole)


def test_mixed_light_is_not_measured(room):
    bake()
    mix()["Red"].strength = 3.0
    with pytest.raises(RuntimeError, match="mixed, and the light shown is not that of the scene: reset the mix"):
        bpy.ops.radiosity.verify(places=16)


def test_a_lost_group_is_named_and_nothing_changed(room):
    bake()
    room[1].attributes.remove(room[1].attributes["Radiosity.Red"])
    before = [snapshot(mesh) for mesh in room]
    with pytest.raises(RuntimeError, match="'Wall' has lost the light of group 'Red': bake again"):
        bpy.ops.radiosity.mix_groups(group="Green", strength=0.0)
    assert [snapshot(mesh) for mesh in room] == before and mix()["Green"].strength == 1.0


def test_flatten_keeps_the_mix_and_removes_the_groups(room):
    bake()
    mix()["Red"].strength = 0.5
    mixed = [colors(mesh) for mesh in room]
    room[0].attributes.active_color_name = "Radiosity.Red"
    assert bpy.ops.radiosity.flatten_groups() == {'FINISHED'}
    for mesh, expected in zip(room, mixed, strict=True):
        assert [each.name for each in mesh.color_attributes] == ["Radiosity"]
        np.testing.assert_array_equal(colors(mesh), expected)
        assert mesh.attributes.active_color_name == mesh.attributes.default_color_name == "Radiosity"
    assert not len(mix())
    with pytest.raises(RuntimeError, match="There are no light groups"):
        bpy.ops.radiosity.flatten_groups()
    bpy.ops.radiosity.clear()
    assert not len(room[0].color_attributes)


@pytest.mark.parametrize("active", ["Paint", "Radiosity.Red"])
def test_clear_leaves_the_mesh_as_it_was(room, active):
    for mesh in room:
        mesh.color_attributes.new(name="Paint", type='BYTE_COLOR', domain='POINT')
        mesh.attributes.active_color_name = mesh.attributes.default_color_name = "Paint"
    before = [snapshot(mesh) for mesh in room]
    bake()
    bake(attribute_name="Second", domain='POINT')
    mix()["Red"].strength = 0.5
    for mesh in room:
        mesh.attributes.active_color_name = active
    bpy.ops.radiosity.clear()
    assert [snapshot(mesh) for mesh in room] == before and not len(mix())


def test_a_bake_that_cannot_write_a_group_changes_nothing(room):
    room[1].attributes.new(name="Radiosity.Red", type='FLOAT', domain='POINT')
    before = [snapshot(mesh) for mesh in room]
    with pytest.raises(RuntimeError, match=r"uses the name 'Radiosity\.Red' for an attribute of another kind"):
        bake()
    assert [snapshot(mesh) for mesh in room] == before and not len(mix())


def test_writing_fails_for_all_meshes_and_groups_or_none(room, monkeypatch):
    from radiosity.addon.adapters import color_attribute

    bake('NONE')
    before = [snapshot(mesh) for mesh in room]
    real, calls = color_attribute._set_colors, []

    def set_colors(mesh, name, values):
        calls.append(name)
        real(mesh, name, values)
        if len(calls) == 8:
            raise MemoryError

    monkeypatch.setattr(color_attribute, "_set_colors", set_colors)
    with pytest.raises(RuntimeError, match="MemoryError"):
        bake()
    assert [snapshot(mesh) for mesh in room] == before


def test_undo_brings_back_the_mix_and_the_groups(room):
    bake()
    before = colors(room[0])
    bpy.ops.ed.undo_push(message="Bake")  # scripts push no steps of their own; the interface does
    bpy.ops.radiosity.mix_groups(group="Red", strength=3.0)
    bpy.ops.ed.undo_push(message="Mix")
    assert (colors(room[0]) != before).any()
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(colors(bpy.data.objects["Floor"].data), before)
    assert mix()["Red"].strength == 1.0
    bpy.ops.radiosity.flatten_groups()
    bpy.ops.ed.undo_push(message="Flatten")
    bpy.ops.ed.undo()
    assert len(bpy.data.objects["Floor"].data.color_attributes) == 5 and len(mix()) == 4


def test_the_panel_lists_the_groups_when_there_are_any(room):
    assert "light_groups" in draw() and "radiosity.update" not in draw()
    bpy.context.scene.radiosity.light_groups = 'LIGHT'
    bpy.context.scene.radiosity.method = 'HEMICUBE'
    assert "Only with Method and Solver Automatic" in draw()
    bake(method='AUTO')
    labels = draw()
    assert {"Green", "Panel", "Red", "World", "use_group", "color", "strength"} <= set(labels)
    assert {"radiosity.update", "radiosity.mix_groups", "radiosity.flatten_groups"} <= set(labels)


def test_undo_of_the_operators_is_one_step_each():
    for name in ("mix_groups", "flatten_groups"):
        assert {'REGISTER', 'UNDO'} <= getattr(bpy.types, f"RADIOSITY_OT_{name}").bl_options


def test_named_method_refuses_groups(room):
    with pytest.raises(RuntimeError, match="Light groups are not kept by method hemicube"):
        bake(method='HEMICUBE')


def test_too_many_groups_are_refused(room):
    for number in range(MOST_GROUPS):
        add_lamp(f"Lamp {number}", (0, 0, 2))
    with pytest.raises(RuntimeError, match=f"{MOST_GROUPS + 4} light groups, and {MOST_GROUPS} are the limit: group"):
        bake()
    bake('COLLECTION')
    assert [item.name for item in mix()] == ["Scene Collection", "World"]


def test_names_of_attributes_are_short_and_different():
    long = "ä" * 60
    names = group_attribute_names("Radiosity", [long, long + "b", "One", "One.001"])
    assert len(set(names)) == 4 and all(len(name.encode()) <= LONGEST_NAME for name in names)
    assert names[2:] == ["Radiosity.One", "Radiosity.One.001"]


def test_the_world_and_a_lamp_of_that_name_are_two_groups(room):
    bpy.data.objects["Red"].name = "World"
    bake()
    assert [item.name for item in mix()] == ["Green", "Panel", "World", "World.001"]
    assert not colors(room[0], "Radiosity.World")[:, 2].any() and colors(room[0], "Radiosity.World.001")[:, 2].any()


def test_command_line_keeps_groups(room, tmp_path):
    source, result = tmp_path / "room.blend", tmp_path / "baked.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(source))
    status = main(["bake", str(source), "--output", str(result), "--quality", "draft", "--light-groups", "collection"])
    assert status == 0
    bpy.ops.wm.open_mainfile(filepath=str(result))
    names = [item.name for item in mix()]
    assert names == ["Scene Collection", "World"]
    mesh = bpy.data.objects["Floor"].data
    assert {"Radiosity", *(f"Radiosity.{name}" for name in names)} == {each.name for each in mesh.color_attributes}
    # The mix works on a file that was opened.
    mix()["World"].use_group = False
    np.testing.assert_array_equal(colors(mesh), total(mesh, {"World": 0.0}))
