"""Worlds as skies: nothing of an environment's light is lost, and a floor under it agrees with Cycles."""

from math import pi

import bpy
import numpy as np
import pytest
from mathutils import Euler
from radiosity.addon.adapters.images import ImageLibrary
from radiosity.addon.adapters.world import SKY_COLUMNS, SKY_ROWS, read_world


def make_world():
    world = bpy.data.worlds.new("World")
    if world.node_tree is None:  # always there from Blender 5.0
        world.use_nodes = True
    bpy.context.scene.world = world
    nodes = world.node_tree.nodes
    nodes.clear()
    output = nodes.new('ShaderNodeOutputWorld')
    background = nodes.new('ShaderNodeBackground')
    world.node_tree.links.new(background.outputs[0], output.inputs["Surface"])
    return world, background


def make_image(pixels):
    rows, columns = pixels.shape[:2]
    image = bpy.data.images.new("Environment", columns, rows, float_buffer=True)
    image.colorspace_settings.name = 'Linear Rec.709'
    full = np.concatenate([pixels, np.ones((rows, columns, 1))], axis=-1).astype(np.float32)
    image.pixels.foreach_set(full.ravel())
    return image


def add_environment(world, background, image, rotation=None):
    tree = world.node_tree
    node = tree.nodes.new('ShaderNodeTexEnvironment')
    node.image = image
    tree.links.new(node.outputs["Color"], background.inputs["Color"])
    if rotation is not None:
        mapping = tree.nodes.new('ShaderNodeMapping')
        coordinates = tree.nodes.new('ShaderNodeTexCoord')
        mapping.inputs["Rotation"].default_value = rotation
        tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs["Vector"], node.inputs["Vector"])
    return node


def texel_directions(rows, columns):
    """Directions of texel centers and their solid angles, from the definition of the equirectangular map."""
    elevation = ((np.arange(rows) + 0.5) / rows - 0.5) * pi
    azimuth = (0.5 - (np.arange(columns) + 0.5) / columns) * 2 * pi
    direction = np.empty((rows, columns, 3))
    direction[..., 0] = np.cos(elevation)[:, None] * np.cos(azimuth)
    direction[..., 1] = np.cos(elevation)[:, None] * np.sin(azimuth)
    direction[..., 2] = np.sin(elevation)[:, None]
    edges = np.sin(np.linspace(-pi / 2, pi / 2, rows + 1))
    return direction, np.repeat(np.diff(edges)[:, None] * (2 * pi / columns), columns, axis=1)


def cell_directions():
    height = (np.arange(SKY_ROWS) + 0.5) / SKY_ROWS * 2 - 1
    azimuth = (np.arange(SKY_COLUMNS) + 0.5) / SKY_COLUMNS * 2 * pi
    level = np.sqrt(1 - height**2)[:, None]
    return np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), np.repeat(height[:, None], SKY_COLUMNS, axis=1)], axis=-1
    )


def hot_sky(rows=256):
    """A smooth gradient with one texel ten thousand times as bright."""
    direction, _ = texel_directions(rows, 2 * rows)
    pixels = 0.5 + 0.3 * direction + 0.2 * direction[..., 2:] ** 2
    pixels[int(0.7 * rows), int(0.3 * 2 * rows)] = (10000, 8000, 6000)
    return pixels


@pytest.mark.parametrize("turn", [0.0, 0.37, 2.0])
def test_hemisphere_integral_of_environment_is_kept(turn):
    pixels = hot_sky()
    world, background = make_world()
    background.inputs["Strength"].default_value = 1.5
    add_environment(world, background, make_image(pixels), (0.0, 0.0, turn))
    sky, (sun,), warnings = read_world(world, ImageLibrary())
    assert warnings == []
    direction, solid_angle = texel_directions(*pixels.shape[:2])
    exact = np.einsum("rck,rc->k", pixels, solid_angle) * 1.5
    found = sky.radiance.mean((0, 1)) * 4 * pi + sun.irradiance
    np.testing.assert_allclose(found, exact, rtol=1e-4)  # float32 look-ups and a turn by parts of a texel
    up = np.maximum(direction[..., 2], 0)
    exact_up = np.einsum("rck,rc->k", pixels, solid_angle * up) * 1.5
    cosine = np.maximum(cell_directions()[..., 2:], 0)
    found_up = (sky.radiance * cosine).mean((0, 1)) * 4 * pi
    found_up += sun.irradiance * sun.direction[2]
    # A turned map is looked up by parts of a texel, 1/80 of the cosine each.
    np.testing.assert_allclose(found_up, exact_up, rtol=1e-3 if turn == 0 else 5e-3)
    # As large as the texel is.
    size = 2 * pi * (1 - np.cos(sun.angle / 2))
    assert size == pytest.approx(solid_angle[int(0.7 * 256), 0], rel=0.01 if turn == 0 else 1.0)


@pytest.mark.parametrize("turn", [0.0, 1.1])
def test_hot_pixel_stands_where_the_render_shows_it(turn):
    pixels = hot_sky()
    world, background = make_world()
    add_environment(world, background, make_image(pixels), (0.0, 0.0, turn))
    sky, (sun,), _ = read_world(world, ImageLibrary())
    assert sky.radiance.max() < 2  # nothing of it is left
    expected = texel_directions(256, 512)[0][int(0.7 * 256), int(0.3 * 512)]
    # Mapping turns the direction that is looked up, so the picture turns the other way.
    cos, sin = np.cos(-turn), np.sin(-turn)
    expected = np.array([cos * expected[0] - sin * expected[1], sin * expected[0] + cos * expected[1], expected[2]])
    assert sun.direction @ expected > np.cos(pi / 256)  # within a texel


def test_uniform_background_is_one_cell():
    world, background = make_world()
    background.inputs["Color"].default_value = (0.2, 0.4, 0.6, 1)
    background.inputs["Strength"].default_value = 2.0
    sky, _, _ = read_world(world, ImageLibrary())
    np.testing.assert_allclose(sky.radiance, [[[0.4, 0.8, 1.2]]], rtol=1e-6)


@pytest.mark.parametrize(
    ("color", "expected"), [((0.2, 0.4, 0.6, 1), (0.6, 1.2, 1.8)), ((0, 0, 0, 1), (3, 3, 3))], ids=["blue", "black"]
)
def test_world_strength_replaces_the_backgrounds(color, expected):
    world, background = make_world()
    background.inputs["Color"].default_value = color
    background.inputs["Strength"].default_value = 17.0
    sky, _, _ = read_world(world, ImageLibrary(), 3.0)
    np.testing.assert_allclose(sky.radiance, [[expected]], rtol=1e-6)


def test_world_strength_lights_a_scene_without_world_in_white():
    sky, _, _ = read_world(None, ImageLibrary(), 2.5)
    np.testing.assert_array_equal(sky.radiance, np.full((1, 1, 3), 2.5))


def test_dark_worlds_are_no_sky():
    world, background = make_world()
    background.inputs["Strength"].default_value = 0.0
    assert read_world(world, ImageLibrary())[0] is None
    assert read_world(None, ImageLibrary())[0] is None
    assert read_world(None, ImageLibrary(), 0.0)[0] is None


def test_camera_only_background_does_not_light():
    world, background = make_world()
    tree = world.node_tree
    seen = tree.nodes.new('ShaderNodeBackground')
    seen.inputs["Color"].default_value = (9, 0, 0, 1)
    background.inputs["Color"].default_value = (0.1, 0.2, 0.3, 1)
    mix, path = tree.nodes.new('ShaderNodeMixShader'), tree.nodes.new('ShaderNodeLightPath')
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(background.outputs[0], mix.inputs[1])
    tree.links.new(seen.outputs[0], mix.inputs[2])
    output = next(node for node in tree.nodes if node.bl_idname == 'ShaderNodeOutputWorld')
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    sky, _, _ = read_world(world, ImageLibrary())
    np.testing.assert_allclose(sky.radiance, [[[0.1, 0.2, 0.3]]], rtol=1e-6)


def test_noise_in_the_world_is_named():
    world, background = make_world()
    noise = world.node_tree.nodes.new('ShaderNodeTexNoise')
    world.node_tree.links.new(noise.outputs["Color"], background.inputs["Color"])
    sky, _, warnings = read_world(world, ImageLibrary())
    assert sky.radiance.shape == (1, 1, 3)
    assert len(warnings) == 1
    assert "World" in warnings[0]
    assert "Noise Texture" in warnings[0]


def test_floor_under_a_turned_environment_agrees_with_cycles():
    """Irradiance from the sky's cells against Cycles' bake of one small face, for floors that face six ways."""
    direction, _ = texel_directions(64, 128)
    pixels = np.maximum(0.5 + 0.4 * direction + 0.5 * direction[..., ::-1] ** 3, 0)
    world, background = make_world()
    add_environment(world, background, make_image(pixels), (0.4, -0.3, 0.8))
    sky, _, _ = read_world(world, ImageLibrary())
    normals = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
    cosines = np.maximum(normals @ cell_directions().reshape(-1, 3).T, 0)
    ours = cosines @ sky.radiance.reshape(-1, 3) * 4 / (SKY_ROWS * SKY_COLUMNS)  # times 4 pi, over pi
    cycles = np.array([_bake_facing(normal) for normal in normals])
    # Cycles' noise, measured over three seeds with half the samples: up to 0.002 per channel, less for the mean of all.
    np.testing.assert_allclose(ours, cycles, atol=4 * 0.002 / np.sqrt(2))
    assert ours.mean() == pytest.approx(cycles.mean(), rel=0.003)
    # And the same integral over the sky's formula, turned by the Euler angles of the Mapping node: X, then Y, then Z.
    fine, solid_angle = texel_directions(256, 512)
    fine, solid_angle = fine.reshape(-1, 3), solid_angle.ravel()
    turned = fine @ np.array(Euler((0.4, -0.3, 0.8)).to_matrix()).T
    radiance = np.maximum(0.5 + 0.4 * turned + 0.5 * turned[:, ::-1] ** 3, 0)
    exact = np.maximum(normals @ fine.T, 0) * solid_angle @ radiance / pi
    np.testing.assert_allclose(ours, exact, atol=1e-3)  # cells of 2.8 degrees, texels of 2.8 degrees


def _bake_facing(normal):
    """(3,) irradiance over pi at a face that looks along an axis."""
    axis = int(np.abs(normal).argmax())
    u, v = np.roll(np.eye(3), -axis, axis=0)[1:]
    if normal[axis] < 0:
        u, v = v, u
    corners = [(-u - v), (u - v), (u + v), (v - u)]
    mesh = bpy.data.meshes.new("Face")
    mesh.from_pydata([tuple(corner) for corner in corners], [], [(0, 1, 2, 3)])
    mesh.color_attributes.new("Bake", 'FLOAT_COLOR', 'POINT')
    mesh.color_attributes.active_color = mesh.color_attributes["Bake"]
    face = bpy.data.objects.new("Face", mesh)
    bpy.context.collection.objects.link(face)
    bpy.context.view_layer.update()
    scene = bpy.context.scene
    scene.render.engine = 'CYCLES'
    scene.cycles.samples = 32768
    # Cycles' own map for sampling takes seconds at its default size, and this sky is smooth.
    scene.world.cycles.sampling_method = 'MANUAL'
    scene.world.cycles.sample_map_resolution = 64
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == face)
    bpy.context.view_layer.objects.active = face
    bpy.ops.object.bake(type='DIFFUSE', pass_filter={'DIRECT', 'INDIRECT'}, target='VERTEX_COLORS')
    colors = np.empty(16, dtype=np.float32)
    mesh.attributes["Bake"].data.foreach_get("color", colors)
    bpy.data.objects.remove(face)
    return colors.reshape(4, 4)[:, :3].mean(0)
