"""Pictures of scenes in Blender: the camera against Blender's own projection, attributes, and files."""

import os
import struct
import zlib

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Vector
from radiosity.addon.adapters.camera import MAX_SIDE, camera_view, picture_size
from radiosity.addon.adapters.picture import baked_pixels, render_baked_picture, render_comparison
from radiosity.addon.adapters.picture_file import PictureFileError, write_picture
from radiosity.core.errors import EmptySceneError
from radiosity.core.rendering.color import compress_highlights, exposure_scale, linear_to_srgb, srgb_to_linear

NAME = "Radiosity"


def _add(name, data):
    obj = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _wall(name="wall", y=3.0, half=20.0):
    """A square that faces -Y."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-half, y, -half), (half, y, -half), (half, y, half), (-half, y, half)], [], [(0, 1, 2, 3)])
    return _add(name, mesh)


def _paint(obj, color, domain='CORNER', data_type='FLOAT_COLOR', name=NAME):
    attribute = obj.data.color_attributes.new(name, data_type, domain)
    attribute.data.foreach_set("color", np.tile(np.array([*color, 1], np.float32), len(attribute.data)))
    obj.data.update()


def _camera(**settings):
    camera = _add("camera", bpy.data.cameras.new("camera"))
    camera.rotation_euler = (np.pi / 2, 0, 0)
    for name, value in settings.items():
        setattr(camera.data, name, value)
    bpy.context.scene.camera = camera
    return camera


@pytest.mark.parametrize("size", [(640, 360), (300, 500)])
@pytest.mark.parametrize(
    "settings",
    [
        {"lens": 24.0},
        {"lens": 85.0, "sensor_fit": 'VERTICAL', "sensor_height": 20.0},
        {"sensor_fit": 'HORIZONTAL', "sensor_width": 24.0},
        {"shift_x": 0.3, "shift_y": -0.2},
        {"type": 'ORTHO', "ortho_scale": 4.0},
        {"type": 'ORTHO', "ortho_scale": 7.0, "shift_x": -0.1, "shift_y": 0.4},
    ],
)
def test_window_agrees_with_blenders_own_projection(settings, size):
    camera = _camera(**settings)
    camera.location = (1, 2, 3)
    camera.rotation_euler = Euler((1.1, 0.2, 0.7))
    camera.scale = (2, 2, 2)  # ignored by Blender
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = size
    bpy.context.view_layer.update()
    view = camera_view(bpy.context, camera, *size)
    x, y = np.array([-1, 0.3, 0.9]), np.array([-0.7, 0.2, 1.0])
    origins, directions = view.rays(x, y)
    for depth in (0.5, 4.0):
        for i, point in enumerate(origins + depth * directions):
            seen = world_to_camera_view(bpy.context.scene, camera, Vector(point))
            assert (2 * seen.x - 1, 2 * seen.y - 1) == pytest.approx((x[i], y[i]), abs=1e-5)


def test_size_is_capped_with_its_shape_kept():
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 4096, 2048, 100
    assert picture_size(bpy.context.scene) == (MAX_SIDE, MAX_SIDE // 2)
    render.resolution_percentage = 25
    assert picture_size(bpy.context.scene) == (1024, 512)
    render.pixel_aspect_y = 2.0
    assert picture_size(bpy.context.scene) == (1024, 1024)


@pytest.mark.parametrize("domain", ['POINT', 'CORNER'])
@pytest.mark.parametrize("data_type", ['FLOAT_COLOR', 'BYTE_COLOR'])
def test_attribute_is_shown_in_its_own_colors(domain, data_type):
    color = np.array([0.4, 0.2, 0.1])
    _paint(_wall(), color, domain, data_type)
    _camera()
    pixels = baked_pixels(bpy.context, NAME, (32, 24)).reshape(-1, 3).astype(float)
    expected = 255 * linear_to_srgb(compress_highlights(color * exposure_scale(color[None])))
    # Bytes store the color to half a step of 255, some 0.5 steps here after exposure; a picture rounds to one step.
    np.testing.assert_allclose(pixels.mean(axis=0), expected, atol=1.0)
    assert np.ptp(pixels, axis=0).max() <= 1


def test_only_the_named_attribute_counts():
    wall = _wall()
    _paint(wall, (1, 0, 0), name="Other")
    _paint(wall, (0, 1, 0))
    _camera()
    assert baked_pixels(bpy.context, NAME, (8, 8))[4, 4].argmax() == 1
    assert baked_pixels(bpy.context, "Other", (8, 8))[4, 4].argmax() == 0


def test_mesh_without_attribute_shows_its_material_and_does_not_change_the_exposure():
    baked, plain = _wall("baked"), _wall("plain", y=2.9, half=0.5)
    _paint(baked, (1000, 1000, 1000))
    material = bpy.data.materials.new("blue")
    if material.node_tree is None:  # before Blender 5.0, where the switch is on for good and deprecated
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.1, 0.1, 0.8, 1)
    plain.data.materials.append(material)
    _camera()
    pixels = baked_pixels(bpy.context, NAME, (40, 40))
    assert pixels[20, 20].argmax() == 2
    assert 20 < pixels[20, 20, 2] < 250
    np.testing.assert_allclose(srgb_to_linear(pixels[2, 2] / 255.0), 0.78, atol=0.08)


def test_moved_mirrored_and_instanced_objects_are_seen_where_they_are():
    source = _wall("source", y=0.0, half=0.2)
    _paint(source, (0.5, 0.5, 0.5))
    collection = bpy.data.collections.new("instanced")
    bpy.context.scene.collection.objects.unlink(source)
    collection.objects.link(source)
    for x, scale in ((-1.0, (1, 1, 1)), (1.0, (-1, 1, 1))):
        empty = _add("instance", None)
        empty.instance_type, empty.instance_collection = 'COLLECTION', collection
        empty.location, empty.scale = (x, 3, 0), scale
    _camera(type='ORTHO', ortho_scale=4.0)
    lit = baked_pixels(bpy.context, NAME, (40, 40)).max(axis=2) > 100
    columns = np.nonzero(lit.any(axis=0))[0]
    assert lit[20, 10] and lit[20, 30] and not lit[20, 20]
    np.testing.assert_array_equal(columns, np.r_[8:12, 28:32])


def test_modifiers_take_part():
    wall = _wall(half=0.5)
    _paint(wall, (0.5, 0.5, 0.5), 'POINT')
    modifier = wall.modifiers.new("array", 'ARRAY')
    modifier.relative_offset_displace = (2, 0, 0)
    _camera(type='ORTHO', ortho_scale=8.0)
    lit = baked_pixels(bpy.context, NAME, (80, 80)).max(axis=2) > 100
    assert lit[40, 40] and lit[40, 60] and not lit[40, 50]


def _beveled_cube(domain):
    """A cube whose corners are cut off by faces that Blender gives no color at their corners."""
    bpy.ops.mesh.primitive_cube_add(size=2.0, location=(0, 4, 0), rotation=(0.5, 0.4, 0.3))
    cube = bpy.context.object
    _paint(cube, (0.2, 0.1, 0.05), domain)
    bevel = cube.modifiers.new("bevel", 'BEVEL')
    bevel.width, bevel.segments, bevel.vmesh_method, bevel.limit_method = 0.5, 3, 'CUTOFF', 'NONE'
    return cube


def test_faces_that_a_modifier_leaves_without_color_take_that_of_their_neighbors():
    _camera(angle=1.0)
    cube = _beveled_cube('CORNER')
    made = cube.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.color_attributes[NAME]
    values = np.empty(4 * len(made.data), np.float32)
    made.data.foreach_get("color", values)
    assert (values.reshape(-1, 4) == 1).all(axis=1).any()
    pixels = baked_pixels(bpy.context, NAME, (80, 60))
    bpy.data.objects.remove(cube)
    # Colors of vertices reach all faces; their means round otherwise, by a step of a byte.
    _beveled_cube('POINT')
    np.testing.assert_allclose(pixels.astype(int), baked_pixels(bpy.context, NAME, (80, 60)).astype(int), atol=1)


def test_white_that_was_baked_stays_white():
    mesh = bpy.data.meshes.new("walls")
    mesh.from_pydata([(x, 3, z) for z in (-2, 2) for x in (-2, 0, 2)], [], [(0, 1, 4, 3), (1, 2, 5, 4)])
    walls = _add("walls", mesh)
    _paint(walls, (1, 1, 1))
    walls.data.color_attributes[NAME].data.foreach_set("color", np.repeat([1, 0.1], 16).astype(np.float32))
    _camera(type='ORTHO', ortho_scale=4.0)
    pixels = baked_pixels(bpy.context, NAME, (80, 80)).astype(int)
    # White is white up to where the two meet; before it the filter takes part of the other.
    assert pixels[:, :36].min() > 0.9 * pixels.max()
    assert pixels[:, :36].min() > 2 * pixels[:, 60].max()


def test_hidden_objects_are_not_shown_and_nothing_visible_is_an_error(tmp_path):
    wall = _wall()
    wall.hide_render = True
    path = tmp_path / "picture.png"
    with pytest.raises(EmptySceneError, match="no mesh"):
        render_baked_picture(bpy.context, path, NAME)
    assert not os.listdir(tmp_path)


def test_mesh_in_edit_mode_is_shown():
    wall = _wall()
    _paint(wall, (0.5, 0.5, 0.5))
    _camera()
    expected = baked_pixels(bpy.context, NAME, (16, 16))
    bpy.context.view_layer.objects.active = wall
    bpy.ops.object.mode_set(mode='EDIT')
    np.testing.assert_array_equal(baked_pixels(bpy.context, NAME, (16, 16)), expected)


def test_vertices_that_are_not_finite_spoil_nothing():
    wall = _wall()
    _paint(wall, (0.5, 0.5, 0.5))
    _camera()
    expected = baked_pixels(bpy.context, NAME, (16, 16))
    broken = _wall("broken", y=2.0, half=1.0)
    broken.data.vertices[0].co = (np.nan, 0, 0)
    np.testing.assert_array_equal(baked_pixels(bpy.context, NAME, (16, 16)), expected)


def test_scene_without_camera_is_framed():
    _paint(_wall(half=1.0), (0.5, 0.5, 0.5))
    pixels = baked_pixels(bpy.context, NAME, (48, 32))
    assert (pixels.max(axis=2) > 100).mean() > 0.2


def _size(path):
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", data[16:24])


def test_file_holds_the_picture_and_blender_reads_it_back(tmp_path):
    _paint(_wall(half=1.0), (0.5, 0.1, 0.05))
    _camera()
    path = tmp_path / "picture.png"
    render_baked_picture(bpy.context, path, NAME, (50, 20))
    image = bpy.data.images.load(str(path))
    values = np.empty(50 * 20 * 4, np.float32)
    image.pixels.foreach_get(values)
    # Blender counts rows from the bottom and gives encoded values as they are.
    read = np.round(values.reshape(20, 50, 4)[::-1, :, :3] * 255)
    np.testing.assert_array_equal(read, baked_pixels(bpy.context, NAME, (50, 20)))
    assert os.listdir(tmp_path) == ["picture.png"]


def test_comparison_puts_the_same_view_twice(tmp_path):
    _paint(_wall(half=1.0), (0.5, 0.1, 0.05))
    path = tmp_path / "both.png"
    render_comparison(bpy.context, path, NAME, (60, 40))
    width, height = _size(path)
    assert height == 40 and width == 2 * 60 + 1
    assert zlib.crc32(path.read_bytes()) != 0


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(PictureFileError, match=r"picture\.png: No space left on device"):
        write_picture(path, np.zeros((2, 2, 3), np.uint8))
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["picture.png"]


def test_missing_folder_and_other_endings_are_named(tmp_path):
    pixels = np.zeros((2, 2, 3), np.uint8)
    with pytest.raises(PictureFileError, match="No such file or directory"):
        write_picture(tmp_path / "nowhere" / "picture.png", pixels)
    with pytest.raises(PictureFileError, match=r"ending \.png"):
        write_picture(tmp_path / "picture.jpg", pixels)
