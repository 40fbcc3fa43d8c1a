"""Writing color attributes: exact, all or none, and refused with a reason."""

import json

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters import color_attribute
from radiosity.addon.adapters.color_attribute import (
    STATE_KEY,
    WriteError,
    baked_attributes,
    check_writable,
    flat_colors,
    remove_color_attributes,
    write_color_attributes,
)
from radiosity.core.errors import SettingsError


@pytest.fixture
def meshes():
    made = []
    for index in range(2):
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3, location=(index, 0, 0))
        made.append(bpy.context.object.data)
        made[-1].name = f"Mesh {index}"
    return made


def random_colors(mesh, domain, seed=0, high=1.0):
    size = len(mesh.loops if domain == 'CORNER' else mesh.vertices)
    return np.random.default_rng(seed).uniform(0, high, (size, 3)).astype(np.float32)


def stored(mesh, name):
    data = mesh.attributes[name].data
    values = np.empty(4 * len(data), np.float32)
    data.foreach_get("color", values)
    return values.reshape(-1, 4)


@pytest.mark.parametrize("domain", ['CORNER', 'POINT'])
def test_float_colors_come_back_bit_for_bit(meshes, domain):
    wanted = random_colors(meshes[0], domain, high=1e6)
    write_color_attributes([(meshes[0], flat_colors(wanted))], "Light", domain, 'FLOAT_COLOR')
    np.testing.assert_array_equal(stored(meshes[0], "Light")[:, :3], wanted)
    assert (stored(meshes[0], "Light")[:, 3] == 1).all()


@pytest.mark.parametrize("domain", ['CORNER', 'POINT'])
def test_byte_colors_come_back_as_the_nearest_srgb_byte(meshes, domain):
    wanted = random_colors(meshes[0], domain)
    write_color_attributes([(meshes[0], flat_colors(wanted))], "Light", domain, 'BYTE_COLOR')
    srgb = np.where(wanted <= 0.0031308, 12.92 * wanted, 1.055 * np.maximum(wanted, 1e-9) ** (1 / 2.4) - 0.055)
    data = meshes[0].attributes["Light"].data
    raw = np.empty(4 * len(data), np.float32)
    data.foreach_get("color_srgb", raw)
    # Half a byte, and float32's share where a value lies between two.
    np.testing.assert_allclose(raw.reshape(-1, 4)[:, :3], srgb, atol=0.5 / 255 + 1e-5)


def test_flat_colors_is_what_foreach_set_takes_fastest():
    flat = flat_colors(np.arange(6, dtype=np.float64).reshape(2, 3))
    assert flat.dtype == np.float32 and flat.flags.c_contiguous
    np.testing.assert_array_equal(flat, [0, 1, 2, 1, 3, 4, 5, 1])


def test_overwriting_keeps_the_place_among_the_attributes(meshes):
    mesh = meshes[0]
    write_color_attributes([(mesh, flat_colors(random_colors(mesh, 'POINT')))], "B", 'POINT', 'FLOAT_COLOR')
    mesh.color_attributes.new(name="C", type='FLOAT_COLOR', domain='POINT')
    order = [attribute.name for attribute in mesh.color_attributes]
    write_color_attributes([(mesh, flat_colors(random_colors(mesh, 'POINT', 1)))], "B", 'POINT', 'FLOAT_COLOR')
    assert [attribute.name for attribute in mesh.color_attributes] == order
    np.testing.assert_array_equal(stored(mesh, "B")[:, :3], random_colors(mesh, 'POINT', 1))


@pytest.mark.parametrize("old", [None, ('CORNER', 'FLOAT_COLOR'), ('POINT', 'FLOAT_COLOR'), ('CORNER', 'BYTE_COLOR')])
@pytest.mark.parametrize("when", ["before", "after"])
def test_failure_on_the_last_mesh_puts_the_first_back(meshes, monkeypatch, old, when):
    if old:
        for mesh in meshes:
            mesh.color_attributes.new(name="Light", domain=old[0], type=old[1])
            values = random_colors(mesh, old[0], 5)
            mesh.attributes["Light"].data.foreach_set("color", flat_colors(values))
    before = [state_of(mesh) for mesh in meshes]
    real = color_attribute._set_colors
    failed = []

    def set_colors(mesh, name, values):
        if when == "after" or mesh != meshes[1]:
            real(mesh, name, values)
        if mesh == meshes[1] and not failed:
            failed.append(True)
            raise MemoryError

    monkeypatch.setattr(color_attribute, "_set_colors", set_colors)
    colors = [(mesh, flat_colors(random_colors(mesh, 'CORNER', 9))) for mesh in meshes]
    with pytest.raises(MemoryError):
        write_color_attributes(colors, "Light", 'CORNER', 'FLOAT_COLOR')
    assert [state_of(mesh) for mesh in meshes] == before


def state_of(mesh):
    group = mesh.attributes
    return (
        [(each.name, each.domain, each.data_type, stored(mesh, each.name).tobytes()) for each in mesh.color_attributes],
        group.active_color_name,
        group.default_color_name,
        group.active and group.active.name,
        dict(mesh.items()),
    )


@pytest.mark.parametrize("domain", ['CORNER', 'POINT'])
def test_active_attribute_of_the_list_stays_what_it_was(meshes, domain):
    """Blender keeps it by index, and a new attribute may come to stand before it."""
    mesh = meshes[0]
    for name in ("position", "UVMap"):
        mesh.attributes.active = mesh.attributes[name]
        write_color_attributes(
            [(mesh, flat_colors(random_colors(mesh, domain)))], f"Light {name}", domain, 'FLOAT_COLOR'
        )
        assert mesh.attributes.active.name == name
    remove_color_attributes(mesh)
    assert mesh.attributes.active.name == "UVMap"


def test_wrong_size_is_refused_before_any_mesh_is_touched(meshes):
    before = [state_of(mesh) for mesh in meshes]
    good, bad = flat_colors(random_colors(meshes[0], 'CORNER')), np.zeros(8, np.float32)
    with pytest.raises(WriteError, match="'Mesh 1' has changed during the bake: 2 colors do not fit its 36 corners"):
        write_color_attributes([(meshes[0], good), (meshes[1], bad)], "Light", 'CORNER', 'FLOAT_COLOR')
    assert [state_of(mesh) for mesh in meshes] == before


def test_mesh_in_edit_mode_is_refused(meshes):
    bpy.ops.object.mode_set(mode='EDIT')
    with pytest.raises(WriteError, match="'Mesh 1' is in Edit Mode"):
        check_writable(meshes[1], "Light")
    bpy.ops.object.mode_set(mode='OBJECT')
    check_writable(meshes[1], "Light")


def test_linked_mesh_is_refused(meshes, tmp_path):
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {meshes[0]}, fake_user=True)
    with bpy.data.libraries.load(path, link=True) as (_source, target):
        target.meshes = ["Mesh 0"]
    (linked,) = [mesh for mesh in bpy.data.meshes if mesh.library]
    with pytest.raises(WriteError, match="linked from a library: make it local"):
        check_writable(linked, "Light")


def test_names_in_use_for_other_things_are_refused(meshes):
    meshes[0].attributes.new(name="density", type='FLOAT', domain='POINT')
    meshes[0].attributes.new(name="face", type='FLOAT_COLOR', domain='FACE')
    for name in ("density", "UVMap", "face"):
        with pytest.raises(SettingsError, match=f"'Mesh 0' uses the name '{name}'"):
            check_writable(meshes[0], name)
    with pytest.raises(SettingsError, match="vertex group named 'Group'"):
        check_writable(meshes[0], "Group", ["Group"])


def test_state_survives_a_copy_of_the_mesh(meshes):
    mesh = meshes[0]
    write_color_attributes([(mesh, flat_colors(random_colors(mesh, 'POINT')))], "Light", 'POINT', 'FLOAT_COLOR')
    copy = mesh.copy()
    assert baked_attributes(copy) == ["Light"]
    assert remove_color_attributes(copy)
    assert baked_attributes(copy) == [] and baked_attributes(mesh) == ["Light"]


def test_state_remembers_the_first_active_and_all_names(meshes):
    mesh = meshes[0]
    for name in ("One", "Two", "One"):
        write_color_attributes([(mesh, flat_colors(random_colors(mesh, 'POINT')))], name, 'POINT', 'FLOAT_COLOR')
    assert json.loads(mesh[STATE_KEY]) == {"attributes": ["One", "Two"], "active": "", "render": ""}


def test_attribute_removed_by_hand_is_no_longer_baked(meshes):
    mesh = meshes[0]
    write_color_attributes([(mesh, flat_colors(random_colors(mesh, 'POINT')))], "Light", 'POINT', 'FLOAT_COLOR')
    mesh.attributes.remove(mesh.attributes["Light"])
    assert baked_attributes(mesh) == []
    assert remove_color_attributes(mesh)
    assert mesh.attributes.active_color_name == "" and STATE_KEY not in mesh
    assert not remove_color_attributes(mesh)


def test_longest_name_is_kept_whole(meshes):
    name = "x" * 67
    write_color_attributes([(meshes[0], flat_colors(random_colors(meshes[0], 'POINT')))], name, 'POINT', 'FLOAT_COLOR')
    assert baked_attributes(meshes[0]) == [name]
