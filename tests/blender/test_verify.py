"""`radiosity.verify` and `radiosity verify`: what the last bake is worth, measured and told."""

import json

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters.verify_job import KEYS, verify_job_steps
from radiosity.addon.command_line import main
from radiosity.addon.panels.statistics import _rows
from radiosity.core.progress import finish


@pytest.fixture
def room():
    """A closed white room with a lamp, as fine as a draft wants it."""
    bpy.ops.mesh.primitive_cube_add(size=4)
    room = bpy.context.object
    room.name = "Room"
    bpy.ops.object.mode_set(mode='EDIT')
    bpy.ops.mesh.subdivide(number_cuts=7)
    bpy.ops.mesh.flip_normals()
    bpy.ops.object.mode_set(mode='OBJECT')
    bpy.ops.object.light_add(type='POINT', location=(0.5, 0.3, 1))
    bpy.context.object.data.energy = 15
    room.select_set(True)
    return room


def report():
    return json.loads(bpy.context.scene["radiosity_report"])


def bake(**options):
    assert bpy.ops.radiosity.bake(quality='DRAFT', show_in_viewport=False, **options) == {'FINISHED'}


def values(mesh, name="Radiosity"):
    colors = np.empty(4 * len(mesh.attributes[name].data), np.float32)
    mesh.attributes[name].data.foreach_get("color", colors)
    return colors


def test_measures_and_changes_only_the_report(room):
    bake()
    before, colors = report(), values(room.data)
    assert bpy.ops.radiosity.verify(places=100) == {'FINISHED'}
    after = report()
    assert {key: value for key, value in after.items() if key not in KEYS and key != "seconds"} == {
        key: value for key, value in before.items() if key != "seconds"
    }
    assert after["measured_error_low"] <= after["measured_error"] <= after["measured_error_high"] < 0.1
    assert after["measured_places"] == 100 and after["seconds"]["verify"] > 0
    assert np.array_equal(values(room.data), colors)


@pytest.mark.parametrize("domain", ["CORNER", "POINT"])
@pytest.mark.parametrize("data_type", ["FLOAT_COLOR", "BYTE_COLOR"])
@pytest.mark.parametrize("bake_type", ["COMBINED", "LIGHTING"])
def test_a_spoiled_attribute_is_seen_however_it_is_stored(room, domain, data_type, bake_type):
    bake(domain=domain, data_type=data_type, bake_type=bake_type)
    bpy.ops.radiosity.verify(places=60)
    right = report()
    attribute = room.data.attributes["Radiosity"]
    attribute.data.foreach_set("color", 0.7 * values(room.data))
    bpy.ops.radiosity.verify(places=60)
    wrong = report()
    assert right["measured_error_high"] < 0.15 < 0.25 < wrong["measured_error_low"] < 0.5


def test_direct_light_is_compared_with_direct_light(room):
    bake(bake_type='DIRECT')
    bpy.ops.radiosity.verify(places=60)
    assert report()["measured_error_high"] < 0.02


def test_light_changed_since_the_bake_is_an_error(room):
    bake()
    bpy.data.lights[0].energy *= 2
    bpy.ops.radiosity.verify(places=60)
    assert report()["measured_error"] > 0.3


def test_world_strength_of_the_bake_is_used(room):
    bpy.data.objects.remove(bpy.data.objects["Room"])
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4, size=2)
    bake(world_strength=3.0)
    bpy.ops.radiosity.verify(places=20)
    assert report()["measured_error_high"] < 0.01


def test_preview_material_is_not_taken_for_the_artists(room):
    bake()
    bpy.ops.radiosity.preview_material()
    bpy.ops.radiosity.verify(places=60)
    assert report()["measured_error_high"] < 0.15


def test_new_bake_forgets_what_was_measured(room):
    bake()
    bpy.ops.radiosity.verify(places=20)
    bake()
    assert "measured_error" not in report()


def test_refusals(room):
    assert not bpy.ops.radiosity.verify.poll()
    bake()
    room.data.attributes.remove(room.data.attributes["Radiosity"])
    with pytest.raises(RuntimeError, match="No mesh has the baked attribute 'Radiosity' any more: bake again"):
        bpy.ops.radiosity.verify()


def test_stop_half_way_changes_nothing(room):
    bake()
    before = report()
    steps = verify_job_steps(bpy.context, 50)
    fractions = [next(steps).fraction for _ in range(4)]
    steps.close()
    assert fractions == sorted(fractions) and report() == before
    assert finish(verify_job_steps(bpy.context, 50))["measured_places"] == 50


def test_panel_shows_error_and_interval(room):
    bake()
    assert "Measured Error" not in dict(_rows(report()))
    bpy.ops.radiosity.verify(places=20)
    assert "to" in dict(_rows(report()))["Measured Error"]


def test_command_line_measures_a_baked_file(room, tmp_path, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    baked, told = tmp_path / "baked.blend", tmp_path / "told.json"
    arguments = ["bake", str(tmp_path / "room.blend"), "--output", str(baked), "--quality", "draft"]
    assert main([*arguments, "--verify"]) == 0
    assert "measured error" in capfd.readouterr().out
    size = baked.stat().st_mtime_ns
    assert main(["verify", str(baked), "--places", "40", "--report", str(told)]) == 0
    line = capfd.readouterr().out
    assert "measured error" in line and "95 % interval" in line and "at 40 vertices" in line
    assert json.loads(told.read_text())["measured_places"] == 40
    assert baked.stat().st_mtime_ns == size
    # What the bake measured itself is in its file.
    bpy.ops.wm.open_mainfile(filepath=str(baked))
    assert report()["measured_places"] > 100


def test_command_line_refuses_by_name(room, tmp_path, capfd):
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert main(["verify", str(path)]) == 1
    assert "Nothing was baked" in capfd.readouterr().err
    assert main(["verify", str(path), "--places", "3"]) == 2
    assert "--places must be 16 or more" in capfd.readouterr().err
    assert main(["verify"]) == 2


def test_mesh_that_a_modifier_reshapes_is_compared_on_its_surface(room):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=6, y_subdivisions=6, size=2, location=(0, 0, -1))
    modifier = bpy.context.object.modifiers.new("Slab", 'SOLIDIFY')
    # The slab rises above the mesh, whose own vertices would look at its inside.
    modifier.thickness, modifier.offset = 0.03, 1
    room.select_set(False)
    bake()
    bpy.ops.radiosity.verify(places=40)
    assert report()["measured_places"] == 40 and report()["measured_error_high"] < 0.1
