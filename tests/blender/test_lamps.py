"""Lamps are defined by agreement with Cycles: the same lamp lights the same floor in both.

Cycles bakes the floor's diffuse light without color; ours is the closed form of the light's own `geometry`, which needs
no visibility as nothing is in the way. The floor receives from all angles. The mean agrees within 1 % plus three
standard errors of Cycles' mean, the standard error taken from the spread between seeds.
"""

from math import pi, radians

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters.scene_reader import read_scene
from radiosity.core.lights import AreaLight, PointLight, SpotLight, SunLight

SAMPLES = 64
SEEDS = (0, 1)


def add_floor(size=2.0, steps=8):
    """A white floor of steps x steps faces around the origin, with a float color attribute to bake into."""
    ticks = np.linspace(-size / 2, size / 2, steps + 1)
    x, y = np.meshgrid(ticks, ticks)
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)
    faces = np.stack([corner, corner + 1, corner + steps + 2, corner + steps + 1], axis=-1).reshape(-1, 4)
    mesh = bpy.data.meshes.new("Floor")
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    mesh.color_attributes.new("Bake", 'FLOAT_COLOR', 'POINT')
    mesh.color_attributes.active_color = mesh.color_attributes["Bake"]
    obj = bpy.data.objects.new("Floor", mesh)
    bpy.context.collection.objects.link(obj)
    return obj


def cycles_lighting(floor, pass_filter=('DIRECT',)):
    """(seeds, vertices, 3) irradiance over pi, as Cycles bakes it."""
    scene = bpy.context.scene
    scene.render.engine = 'CYCLES'
    scene.cycles.device = 'CPU'
    scene.cycles.samples = SAMPLES
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0
    scene.cycles.light_sampling_threshold = 0
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == floor)
    bpy.context.view_layer.objects.active = floor
    results = []
    for seed in SEEDS:
        scene.cycles.seed = seed
        bpy.ops.object.bake(type='DIFFUSE', pass_filter=set(pass_filter), target='VERTEX_COLORS')
        colors = np.empty(4 * len(floor.data.vertices), dtype=np.float32)
        floor.data.attributes["Bake"].data.foreach_get("color", colors)
        results.append(colors.reshape(-1, 4)[:, :3])
    return np.array(results, dtype=np.float64)


def add_lamp(kind, location=(0.3, -0.2, 1.5), rotation=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0), **values):
    lamp = bpy.data.lights.new("Lamp", kind)
    for name, value in values.items():
        setattr(lamp, name, value)
    obj = bpy.data.objects.new("Lamp", lamp)
    obj.location, obj.rotation_euler, obj.scale = location, rotation, scale
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def our_lighting(floor):
    """(vertices, 3) irradiance over pi of all lights, unoccluded; and the reading."""
    reading = read_scene(bpy.context, receivers=[floor])
    points = reading.scene.receivers[0].positions
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    total = np.zeros((len(points), 3))
    for light in reading.scene.lights:
        total += light.geometry(points, normals)[:, None] * light.color
    return total / pi, reading


def assert_agrees(ours, cycles, tolerance=0.01):
    means = cycles.mean((1, 2))
    error = np.abs(means[0] - means[1]) / np.sqrt(2) / np.sqrt(len(means))
    assert means.mean() > 0
    assert ours.mean() == pytest.approx(means.mean(), abs=tolerance * means.mean() + 3 * error)
    # And the pattern: each vertex within 4 % of the brightest, which bounds Cycles' noise per vertex.
    assert np.abs(ours - cycles.mean(0)).max() < 0.04 * cycles.max()


HAS_TEMPERATURE = bpy.app.version >= (4, 5)

LARGE_SPOT = dict(kind='SPOT', energy=50, shadow_soft_size=0.25, spot_size=radians(80), spot_blend=0.5)

LAMPS = {
    "point": (PointLight, dict(kind='POINT', energy=50, shadow_soft_size=0.0)),
    "sphere": (PointLight, dict(kind='POINT', energy=50, shadow_soft_size=0.25, use_soft_falloff=False)),
    "scaled point": (PointLight, dict(kind='POINT', energy=50, shadow_soft_size=0.1, scale=(2, 3, 0.5))),
    "colored point": (PointLight, dict(kind='POINT', energy=50, shadow_soft_size=0.0, color=(1.0, 0.5, 0.1))),
    "spot": (SpotLight, dict(kind='SPOT', energy=50, shadow_soft_size=0.0, spot_size=radians(80), spot_blend=0.0)),
    "blended spot": (
        SpotLight,
        dict(kind='SPOT', energy=50, shadow_soft_size=0.0, spot_size=radians(80), spot_blend=0.6),
    ),
    "tilted spot": (
        SpotLight,
        dict(
            kind='SPOT', energy=50, shadow_soft_size=0.0, spot_size=radians(60), spot_blend=1.0, rotation=(0.4, 0.3, 0)
        ),
    ),
    "large spot": (SpotLight, {**LARGE_SPOT, "use_soft_falloff": False}),
    "soft sphere": (PointLight, dict(kind='POINT', energy=50, shadow_soft_size=0.5, use_soft_falloff=True)),
    "soft sphere close by": (
        PointLight,
        dict(kind='POINT', energy=50, shadow_soft_size=0.4, use_soft_falloff=True, location=(0.3, -0.2, 0.6)),
    ),
    "soft large spot": (SpotLight, {**LARGE_SPOT, "use_soft_falloff": True}),
    "soft spot close by": (
        SpotLight,
        dict(
            kind='SPOT',
            energy=50,
            shadow_soft_size=0.2,
            spot_size=radians(110),
            spot_blend=0.8,
            use_soft_falloff=True,
            location=(0.1, -0.1, 0.5),
        ),
    ),
    "sun": (SunLight, dict(kind='SUN', energy=3, angle=0.0, rotation=(0.5, 0.2, 0.0))),
    "wide sun": (SunLight, dict(kind='SUN', energy=3, angle=radians(30), rotation=(0.5, 0.2, 0.0))),
    "square": (AreaLight, dict(kind='AREA', energy=20, shape='SQUARE', size=0.5)),
    "rectangle": (
        AreaLight,
        dict(kind='AREA', energy=20, shape='RECTANGLE', size=0.5, size_y=1.0, rotation=(0.3, 0, 0.5)),
    ),
    "disk": (AreaLight, dict(kind='AREA', energy=20, shape='DISK', size=0.8)),
    "ellipse": (AreaLight, dict(kind='AREA', energy=20, shape='ELLIPSE', size=0.8, size_y=0.3, scale=(1.5, 0.5, 2.0))),
    "mirrored rectangle": (
        AreaLight,
        dict(kind='AREA', energy=20, shape='RECTANGLE', size=0.5, size_y=1.0, scale=(-1.0, 2.0, 1.0)),
    ),
}
if HAS_TEMPERATURE:
    warm = dict(use_temperature=True, temperature=3000.0, exposure=1.0)
    LAMPS["warm point"] = (PointLight, dict(kind='POINT', energy=50, shadow_soft_size=0.0, **warm))
    LAMPS["warm sun"] = (SunLight, dict(kind='SUN', energy=3, angle=0.0, **warm))
    for name in ("sphere", "large spot", "ellipse", "wide sun"):
        kind, values = LAMPS[name]
        LAMPS[f"{name} not normalized"] = (kind, {**values, "normalize": False})
    LAMPS["sun not normalized"] = (SunLight, dict(kind='SUN', energy=3, angle=0.0, normalize=False))
    LAMPS["point not normalized"] = (PointLight, dict(kind='POINT', energy=50, shadow_soft_size=0.0, normalize=False))


@pytest.mark.parametrize("name", LAMPS)
def test_lamp_lights_the_floor_as_in_cycles(name):
    kind, values = LAMPS[name]
    floor = add_floor()
    add_lamp(**values)
    ours, reading = our_lighting(floor)
    assert [type(light) for light in reading.scene.lights] == [kind]
    assert_agrees(ours, cycles_lighting(floor))


def test_light_nodes_multiply_the_lamps_strength():
    floor = add_floor()
    lamp = add_lamp(kind='POINT', energy=50, shadow_soft_size=0.0)
    lamp.data.use_nodes = True
    node = next(node for node in lamp.data.node_tree.nodes if node.type == 'EMISSION')
    node.inputs["Color"].default_value = (0.2, 1.0, 0.4, 1.0)
    node.inputs["Strength"].default_value = 1.7
    assert_agrees(our_lighting(floor)[0], cycles_lighting(floor))


def test_area_lamp_is_dark_behind():
    floor = add_floor()
    add_lamp(kind='AREA', energy=20, shape='SQUARE', size=0.5, rotation=(pi, 0, 0))
    assert our_lighting(floor)[0].max() == 0
    assert cycles_lighting(floor).max() == 0


def test_round_lamp_has_the_area_of_its_ellipse():
    floor = add_floor()
    add_lamp(kind='AREA', energy=20, shape='ELLIPSE', size=0.8, size_y=0.3, scale=(1.5, 0.5, 2.0))
    (light,) = our_lighting(floor)[1].scene.lights
    assert light.area == pytest.approx(pi / 4 * (0.8 * 1.5) * (0.3 * 0.5), rel=1e-6)
    np.testing.assert_allclose(light.normal, (0, 0, -1), atol=1e-12)
    assert light.power[0] == pytest.approx(20, rel=1e-6)


@pytest.mark.parametrize("hide", ["hide_render", "portal", "visible_diffuse", "dark"])
def test_lamp_that_gives_no_light_is_left_out(hide):
    floor = add_floor()
    lamp = add_lamp(kind='AREA', energy=0.0 if hide == "dark" else 20.0, shape='SQUARE', size=0.5)
    if hide == "portal":
        lamp.data.cycles.is_portal = True
    elif hide == "visible_diffuse":
        lamp.visible_diffuse = False
    elif hide == "hide_render":
        lamp.hide_render = True
    assert our_lighting(floor)[1].scene.lights == ()


def test_lamp_hidden_in_the_viewport_only_shines():
    floor = add_floor()
    lamp = add_lamp(kind='POINT', energy=50, shadow_soft_size=0.0)
    lamp.hide_viewport = True
    assert len(our_lighting(floor)[1].scene.lights) == 1
    assert lamp.hide_viewport


def test_lamps_in_instanced_collections_shine_where_the_instances_stand():
    floor = add_floor()
    collection = bpy.data.collections.new("Lamps")
    lamp = bpy.data.lights.new("Lamp", 'POINT')
    inner = bpy.data.objects.new("Lamp", lamp)
    inner.location = (0, 0, 1)
    collection.objects.link(inner)
    for x in (-1, 2):
        empty = bpy.data.objects.new("Instance", None)
        empty.instance_type = 'COLLECTION'
        empty.instance_collection = collection
        empty.location = (x, 0, 0)
        bpy.context.collection.objects.link(empty)
    places = sorted(tuple(light.position) for light in our_lighting(floor)[1].scene.lights)
    assert places == [(-1, 0, 1), (2, 0, 1)]


def test_limits_are_named_once_for_all_lamps():
    floor = add_floor()
    for _ in range(3):
        lamp = add_lamp(kind='AREA', energy=20, shape='SQUARE', size=0.5)
        lamp.data.spread = 1.0
        lamp.data.use_shadow = False
    warnings = our_lighting(floor)[1].scene.warnings
    assert len([text for text in warnings if "spread" in text and "Lamp.002" in text]) == 1
    assert len([text for text in warnings if "shadow" in text and "Lamp.001" in text]) == 1
    assert len(warnings) == 2
