"""Scenes for benchmarks and for agreement with Cycles, built in the open file: sizes in meters, up is +Z.

Each builder starts from an empty file, links one receiving mesh with about the asked number of vertices and its lights,
selects the mesh, and returns it. Lights made of mesh are objects of their own and are no receivers.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from .geometry import Model

WHITE = (0.725, 0.71, 0.68)
RED = (0.63, 0.065, 0.05)
GREEN = (0.14, 0.45, 0.091)

#: Radiance of the Cornell box's lamp, in W/(m2 sr).
LAMP_RADIANCE = (17.0, 12.0, 4.0)

#: The lamp hangs this far below the ceiling: coincident faces would fight for hits.
_LAMP_GAP = 0.005


def empty_scene() -> None:
    """An empty file whose world is black. Keeps registered add-ons."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    set_world((0.0, 0.0, 0.0))


def set_world(color: tuple[float, float, float]) -> None:
    """A world of one radiance in all directions, in W/(m2 sr)."""
    world = bpy.data.worlds.new("world")
    if world.node_tree is None:  # before Blender 5.0, where worlds always have nodes
        world.use_nodes = True
    world.node_tree.nodes.clear()
    background = world.node_tree.nodes.new('ShaderNodeBackground')
    background.inputs["Color"].default_value = (*color, 1)
    output = world.node_tree.nodes.new('ShaderNodeOutputWorld')
    world.node_tree.links.new(background.outputs[0], output.inputs["Surface"])
    bpy.context.scene.world = world


def _material(name: str) -> tuple[bpy.types.Material, bpy.types.NodeTree, bpy.types.Node]:
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    return material, tree, tree.nodes.new('ShaderNodeOutputMaterial')


def diffuse(color: tuple[float, float, float]) -> bpy.types.Material:
    """A material that only reflects, equally to all sides."""
    material, tree, output = _material("diffuse")
    shader = tree.nodes.new('ShaderNodeBsdfDiffuse')
    shader.inputs["Color"].default_value = (*color, 1)
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    material.diffuse_color = (*color, 1)
    return material


def front_emission(radiance: tuple[float, float, float]) -> bpy.types.Material:
    """A black material that emits on its front only."""
    material, tree, output = _material("front emission")
    geometry = tree.nodes.new('ShaderNodeNewGeometry')
    front = tree.nodes.new('ShaderNodeMath')
    front.operation = 'SUBTRACT'
    front.inputs[0].default_value = 1.0
    tree.links.new(geometry.outputs["Backfacing"], front.inputs[1])
    shader = tree.nodes.new('ShaderNodeEmission')
    shader.inputs["Color"].default_value = (*radiance, 1)
    tree.links.new(front.outputs[0], shader.inputs["Strength"])
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def glowing_diffuse(reflectance: float, radiance: float) -> bpy.types.Material:
    """A gray material that reflects and emits on both sides alike."""
    material, tree, output = _material("glowing diffuse")
    reflection = tree.nodes.new('ShaderNodeBsdfDiffuse')
    reflection.inputs["Color"].default_value = (reflectance, reflectance, reflectance, 1)
    emission = tree.nodes.new('ShaderNodeEmission')
    emission.inputs["Color"].default_value = (radiance, radiance, radiance, 1)
    both = tree.nodes.new('ShaderNodeAddShader')
    tree.links.new(reflection.outputs[0], both.inputs[0])
    tree.links.new(emission.outputs[0], both.inputs[1])
    tree.links.new(both.outputs[0], output.inputs["Surface"])
    return material


def add_lamp(kind: str, location, energy: float, rotation=(0.0, 0.0, 0.0), **settings) -> bpy.types.Object:
    """A Blender lamp; `settings` are properties of its data."""
    data = bpy.data.lights.new(kind.lower(), kind)
    data.energy = energy
    for name, value in settings.items():
        setattr(data, name, value)
    lamp = bpy.data.objects.new(kind.lower(), data)
    lamp.location, lamp.rotation_euler = location, rotation
    bpy.context.scene.collection.objects.link(lamp)
    return lamp


def select_only(*objects: bpy.types.Object) -> None:
    """Select these and nothing else; the first becomes active."""
    # Selection belongs to the view layer, which learns of newly linked objects only now.
    bpy.context.view_layer.update()
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in objects)
    bpy.context.view_layer.objects.active = objects[0]


def _lamp_panels(panels: list[tuple[tuple, tuple]], radiance: tuple[float, float, float]) -> None:
    """One object of horizontal rectangles that shine downwards; `panels` are their low and high corners."""
    model = Model()
    for low, high in panels:
        model.rectangle(low, high, 0, towards=np.array([low[0], low[1], low[2] - 1e3]))
    model.build("lamp", [front_emission(radiance)], 4 * len(panels))


def _shadow_of(model: Model, low: tuple, high: tuple, ceiling: float) -> None:
    """The slot between a lamp and the ceiling sees nothing but both: vertices there are as good as buried."""
    empty = Model()
    empty.box((low[0], low[1], low[2]), (high[0], high[1], ceiling), 0)
    model.solids.extend(empty.solids)


def cornell_box(vertices: int = 20_000) -> bpy.types.Object:
    """The Cornell box with its front wall closed: published measurements [1]_, one unit a centimeter, so 5.56 m wide.

    Seen along +Y, red left and green right. Walls are made exactly rectangular.

    References
    ----------
    .. [1] Cornell University Program of Computer Graphics, "Cornell Box Data", 1998.
    """
    empty_scene()
    width, depth, height = 5.56, 5.592, 5.488
    materials = [diffuse(WHITE), diffuse(RED), diffuse(GREEN)]
    model = Model()
    model.room((0, 0, 0), (width, depth, height), {"-x": 1, "+x": 2, "-y": 0, "+y": 0, "-z": 0, "+z": 0})
    short = [(130, 65), (82, 225), (240, 272), (290, 114)]
    tall = [(423, 247), (265, 296), (314, 456), (472, 406)]
    for footprint, top in ((short, 1.65), (tall, 3.30)):
        # Published x runs to the left as seen from the camera.
        model.prism([(width - x / 100, y / 100) for x, y in footprint], 0.0, top, 0)
    low = (width - 3.43, 2.27, height - _LAMP_GAP)
    high = (width - 2.13, 3.32, height - _LAMP_GAP)
    _shadow_of(model, low, high, height)
    box = model.build("cornell_box", materials, vertices)
    _lamp_panels([(low, high)], LAMP_RADIANCE)
    select_only(box)
    return box


def _table(model: Model, x: float, y: float, width: float, depth: float, material: int) -> None:
    leg, top = 0.06, 0.74  # in meters
    for i in (0, 1):
        for j in (0, 1):
            low = (x + i * (width - leg), y + j * (depth - leg), 0.0)
            model.box(low, (low[0] + leg, low[1] + leg, top), material, without=("top",))
    model.box((x, y, top), (x + width, y + depth, top + 0.04), material, bottom=True)


def furnished_room(vertices: int = 20_000) -> bpy.types.Object:
    """A closed room full of what is hard for radiosity: tables on thin legs, crates, shelves 1 cm off the wall, a
    cupboard 5 cm off the wall; about 190 rectangles and five ceiling panels."""
    empty_scene()
    width, depth, height = 8.0, 6.0, 2.8
    materials = [diffuse(WHITE), diffuse((0.5, 0.32, 0.18)), diffuse((0.25, 0.4, 0.6)), diffuse((0.6, 0.25, 0.2))]
    model = Model()
    model.room((0, 0, 0), (width, depth, height), dict.fromkeys(("-x", "+x", "-y", "+y", "-z", "+z"), 0))
    for x, y in ((1.2, 1.0), (4.6, 0.9), (2.9, 3.4)):
        _table(model, x, y, 1.5, 0.8, 1)
    for i, (x, y, side, top) in enumerate(
        ((0.5, 4.6, 0.6, 0.6), (1.3, 4.9, 0.5, 0.5), (6.6, 1.0, 0.7, 0.7), (6.7, 2.1, 0.4, 0.4), (5.6, 4.4, 0.5, 0.9))
    ):
        angle = 0.3 + 0.9 * i
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * (side / 2)
        square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ turn.T + (x + side / 2, y + side / 2)
        model.prism(square, 0.0, top, 2 + i % 2)
    for z in (1.1, 1.5, 1.9):
        model.box((2.0, depth - 0.31, z), (4.4, depth - 0.01, z + 0.03), 1, bottom=True)
    model.box((width - 0.55, 3.2, 0.0), (width - 0.05, 4.9, 2.0), 3)
    lows = [(x, y, height - _LAMP_GAP) for x, y in ((1.2, 1.2), (6.0, 1.2), (3.6, 2.7), (1.2, 4.2), (6.0, 4.2))]
    panels = [(low, (low[0] + 0.8, low[1] + 0.5, low[2])) for low in lows]
    for low, high in panels:
        _shadow_of(model, low, high, height)
    room = model.build("furnished_room", materials, vertices)
    _lamp_panels(panels, (12.0, 11.0, 9.0))
    select_only(room)
    return room


def l_room(vertices: int = 20_000) -> bpy.types.Object:
    """A closed L-shaped room with its lamp in one arm: the other arm is lit around the reentrant corner, and has two
    crates on its floor."""
    empty_scene()
    height = 2.6
    plan = [(0.0, 0.0), (6.0, 0.0), (6.0, 2.5), (2.5, 2.5), (2.5, 6.0), (0.0, 6.0)]
    model = Model()
    for start, end in zip(plan, [*plan[1:], plan[0]], strict=True):
        # Counter-clockwise from above, so the inside lies to the left.
        inside = np.array([start[0] + start[1] - end[1], start[1] + end[0] - start[0], height / 2])
        model.add([(*start, 0), (*end, 0), (*end, height), (*start, height)], 0, towards=inside)
    for z, towards in ((0.0, 1e3), (height, -1e3)):
        for low, high in (((0, 0), (6.0, 2.5)), ((0, 2.5), (2.5, 6.0))):
            model.rectangle((*low, z), (*high, z), 0, towards=np.array([1.0, 1.0, towards]))
    model.box((0.3, 4.8, 0.0), (1.0, 5.5, 0.7), 1)
    model.box((1.4, 3.6, 0.0), (1.9, 4.1, 0.5), 2)
    low = (4.3, 0.8, height - _LAMP_GAP)
    high = (5.2, 1.7, height - _LAMP_GAP)
    _shadow_of(model, low, high, height)
    room = model.build("l_room", [diffuse(WHITE), diffuse(RED), diffuse((0.25, 0.4, 0.6))], vertices)
    _lamp_panels([(low, high)], (14.0, 12.0, 10.0))
    select_only(room)
    return room


def two_rooms(vertices: int = 10_000) -> bpy.types.Object:
    """Two closed rooms joined by a doorway; the lamp hangs in one, so the other has second-hand light only."""
    empty_scene()
    low, high = (0.0, 0.0, 0.0), (8.0, 4.0, 2.6)
    wall, door, lintel = (3.95, 4.05), (1.5, 2.4), 2.1
    model = Model()
    model.room(low, high, dict.fromkeys(("-x", "+x", "-y", "+y", "-z", "+z"), 0))
    model.box((wall[0], low[1], 0.0), (wall[1], door[0], high[2]), 0, without=("top", 0))
    model.box((wall[0], door[1], 0.0), (wall[1], high[1], high[2]), 0, without=("top", 2))
    model.box((wall[0], door[0], lintel), (wall[1], door[1], high[2]), 0, without=("top", 0, 2), bottom=True)
    panel = ((1.5, 1.5, high[2] - _LAMP_GAP), (2.5, 2.5, high[2] - _LAMP_GAP))
    _shadow_of(model, *panel, high[2])
    rooms = model.build("two_rooms", [diffuse(WHITE)], vertices)
    _lamp_panels([panel], (10.0, 10.0, 10.0))
    select_only(rooms)
    return rooms


def floor_with_blocker(light: Callable[[], object], vertices: int = 2_500) -> bpy.types.Object:
    """A floor of 6 by 6 m with a box floating over it; `light` adds the light and is called in the empty scene."""
    empty_scene()
    model = Model()
    model.rectangle((-3, -3, 0), (3, 3, 0), 0, towards=np.array([0, 0, 1e3]))
    model.box((-0.5, -0.6, 0.5), (0.7, 0.4, 0.9), 0, bottom=True)
    floor = model.build("floor", [diffuse((0.5, 0.5, 0.5))], vertices)
    light()
    select_only(floor)
    return floor


#: Every kind of lamp above the blocker, by name, and the world alone. Powers give an irradiance near 1 W/m2.
FLOOR_LIGHTS: dict[str, Callable[[], object]] = {
    "point": lambda: add_lamp('POINT', (0.4, -0.3, 3), 400, shadow_soft_size=0.0, color=(1, 0.8, 0.5)),
    "point with radius": lambda: add_lamp('POINT', (0.4, -0.3, 3), 400, shadow_soft_size=0.4),
    "point as a sphere": lambda: add_lamp('POINT', (0.4, -0.3, 3), 400, shadow_soft_size=0.4, use_soft_falloff=False),
    "spot": lambda: add_lamp(
        'SPOT', (0.4, -0.3, 3), 800, (0.1, 0.15, 0), spot_size=1.4, spot_blend=0.3, shadow_soft_size=0.0
    ),
    "spot with radius": lambda: add_lamp(
        'SPOT', (0.4, -0.3, 3), 800, (0.1, 0.15, 0), spot_size=1.4, spot_blend=0.3, shadow_soft_size=0.3
    ),
    "sun": lambda: add_lamp('SUN', (0, 0, 5), 3, (0.5, 0.3, 0), angle=0.0),
    "sun with angle": lambda: add_lamp('SUN', (0, 0, 5), 3, (0.5, 0.3, 0), angle=0.3),
    "square area": lambda: add_lamp('AREA', (0.4, -0.3, 3), 200, (0.3, 0.2, 0), shape='SQUARE', size=0.8),
    "rectangle area": lambda: add_lamp(
        'AREA', (0.4, -0.3, 3), 200, (0.3, 0.2, 0.5), shape='RECTANGLE', size=1.4, size_y=0.3
    ),
    "disk area": lambda: add_lamp('AREA', (0.4, -0.3, 3), 200, (0.3, 0.2, 0), shape='DISK', size=0.8),
    "ellipse area": lambda: add_lamp(
        'AREA', (0.4, -0.3, 3), 200, (0.3, 0.2, 0.5), shape='ELLIPSE', size=1.4, size_y=0.5
    ),
    "world": lambda: set_world((0.3, 0.4, 0.6)),
}


def open_scene_with_sky(vertices: int = 5_000) -> bpy.types.Object:
    """A courtyard under a blue sky and a low sun: two walls and three blocks on a ground."""
    empty_scene()
    model = Model()
    model.rectangle((-5, -5, 0), (5, 5, 0), 0, towards=np.array([0, 0, 1e3]))
    model.box((-5, 4.6, 0), (5, 5, 3), 1)
    model.box((-5, -5, 0), (-4.6, 4.6, 2), 2, without=(2,))
    for x, y, side, top in ((-2, -1, 1.2, 1.2), (1, 1.5, 0.8, 2.2), (2, -2.5, 1.6, 0.6)):
        model.box((x, y, 0), (x + side, y + side, top), 1)
    yard = model.build("courtyard", [diffuse((0.4, 0.38, 0.35)), diffuse(WHITE), diffuse(RED)], vertices)
    set_world((0.4, 0.6, 1.0))
    add_lamp('SUN', (0, 0, 5), 3, (0.9, 0.2, 0.4), angle=0.01, color=(1, 0.9, 0.7))
    select_only(yard)
    return yard


def furnace(vertices: int = 600) -> bpy.types.Object:
    """A closed box that reflects half and emits an exitance of 1 W/m2 everywhere: radiosity is 2 everywhere."""
    empty_scene()
    model = Model()
    model.room((0, 0, 0), (3, 2, 1), dict.fromkeys(("-x", "+x", "-y", "+y", "-z", "+z"), 0))
    box = model.build("furnace", [glowing_diffuse(0.5, 1 / np.pi)], vertices)
    select_only(box)
    return box
