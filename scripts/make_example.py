"""Makes examples/cornell_box.blend from the measurements that Cornell University published for its box.

Run it with the bpy module 4.2, the oldest that must open the file: a .blend of Blender 5 cannot be opened there.

    python scripts/make_example.py examples/cornell_box.blend

Measurements: Cornell University Program of Computer Graphics, "Cornell Box Data", 1998. The room is taken as exactly
right-angled, the lamp sits in a hole of the ceiling, flush with it, and colors are the common RGB values for the
measured spectra.
"""

from __future__ import annotations

import math
import os
import sys
from itertools import pairwise
from pathlib import Path

import bpy
import numpy as np

MILLIMETER = 1e-3
WIDTH, DEPTH, HEIGHT = 556.0, 559.2, 548.8
LAMP_X, LAMP_Y = (213.0, 343.0), (227.0, 332.0)
# Corners of the tops, counter-clockwise seen from above after the change of axes below.
SHORT_BLOCK = ((130.0, 65.0), (82.0, 225.0), (240.0, 272.0), (290.0, 114.0)), 165.0
TALL_BLOCK = ((423.0, 247.0), (265.0, 296.0), (314.0, 456.0), (472.0, 406.0)), 330.0
CAMERA = (278.0, -800.0, 273.0)
FOCAL_LENGTH, SENSOR = 35.0, 25.0

WHITE, RED, GREEN = (0.725, 0.71, 0.68), (0.63, 0.065, 0.05), (0.14, 0.45, 0.091)
LAMP_COLOR, LAMP_STRENGTH = (1.0, 12 / 17, 4 / 17), 17.0

# Millimeters between vertices: gives about 20,000, so that soft shadows show.
SPACING = 9.7


def steps(*ends: float) -> np.ndarray:
    """Coordinates from the first to the last of some ends, all of them included, about `SPACING` apart."""
    pieces = [np.linspace(start, end, round(abs(end - start) / SPACING) + 1)[:-1] for start, end in pairwise(ends)]
    return np.concatenate([*pieces, [ends[-1]]])


def sheet(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and quads of a (rows, columns, 3) grid; columns then rows is counter-clockwise seen from the front."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4)


def wall(origin, along, up, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A sheet from unit vectors; its front is where `along` x `up` points."""
    origin, along, up = (np.asarray(vector, dtype=float) for vector in (origin, along, up))
    return sheet(origin + columns[None, :, None] * along + rows[:, None, None] * up)


def add_object(name: str, parts: list[tuple[np.ndarray, np.ndarray]], looks: list[int], materials: list) -> None:
    """Join sheets into one object, one material per sheet, and weld the vertices they share."""
    counts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([part[0] for part in parts])
    faces = np.concatenate([quads + start for (_, quads), start in zip(parts, counts, strict=False)])
    _, first, inverse = np.unique(np.round(vertices, 4), axis=0, return_index=True, return_inverse=True)
    # Published axes have x to the left when seen from the camera; mirrored to the right by turning around the middle.
    placed = vertices[first] * (-1.0, 1.0, 1.0) + (WIDTH, 0.0, 0.0)
    faces = inverse.reshape(-1)[faces][:, ::-1]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata((placed * MILLIMETER).tolist(), [], faces.tolist())
    for material in materials:
        mesh.materials.append(material)
    slots = np.repeat(np.asarray(looks, dtype=np.int32), [len(quads) for _, quads in parts])
    mesh.polygons.foreach_set("material_index", slots)
    mesh.validate()
    mesh.update()
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def material(name: str, color, emission=(0.0, 0.0, 0.0), strength: float = 0.0):
    """A matte material, or a lamp."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"].inputs
    shader["Base Color"].default_value = (*color, 1.0)
    shader["Roughness"].default_value = 1.0
    shader["Specular IOR Level"].default_value = 0.0
    shader["Emission Color"].default_value = (*emission, 1.0)
    shader["Emission Strength"].default_value = strength
    made.diffuse_color = (*color, 1.0)
    return made


def block(corners, height: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Top and four sides of a standing block."""
    corners = np.asarray(corners)
    top_counts = np.linspace(0.0, 1.0, round(165.0 / SPACING) + 1)
    u, v = np.meshgrid(top_counts, top_counts)
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)
    top = np.dstack([weights @ corners, np.full(u.shape, height)])
    sides = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        line = start + top_counts[:, None] * (end - start)
        rows = steps(0.0, height)
        ground = np.broadcast_to(line[None], (len(rows), *line.shape))
        sides.append(sheet(np.dstack([ground, np.broadcast_to(rows[:, None], ground.shape[:2])])[::-1]))
    return [sheet(top), *sides]


def build() -> None:
    """Fill the current, empty file."""
    white, red, green = material("White", WHITE), material("Red", RED), material("Green", GREEN)
    lamp = material("Light", (0.0, 0.0, 0.0), LAMP_COLOR, LAMP_STRENGTH)
    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    columns, rows, levels = steps(0.0, *LAMP_X, WIDTH), steps(0.0, *LAMP_Y, DEPTH), steps(0.0, HEIGHT)
    ceiling, quads = wall((0, 0, HEIGHT), y, x, rows, columns)
    middle = ceiling[quads].mean(axis=1)
    is_lamp = np.all([(middle[:, axis] > low) & (middle[:, axis] < high)
                      for axis, (low, high) in enumerate((LAMP_X, LAMP_Y))], axis=0)  # fmt: skip
    room = [
        wall((0, 0, 0), x, y, columns, rows),
        (ceiling, quads[~is_lamp]),
        wall((0, DEPTH, 0), x, z, columns, levels),
        wall((0, 0, 0), y, z, rows, levels),
        wall((WIDTH, DEPTH, 0), (0, -1, 0), z, DEPTH - rows[::-1], levels),
    ]
    for index, (vertices, faces) in enumerate(room):  # the faces look into the room
        room[index] = vertices, _facing(vertices, faces, (WIDTH / 2, DEPTH / 2, HEIGHT / 2))
    add_object("Room", room, [0, 0, 0, 2, 1], [white, red, green])
    used, renumbered = np.unique(quads[is_lamp], return_inverse=True)
    panel = ceiling[used], renumbered.reshape(-1, 4)
    add_object("Light", [(panel[0], _facing(*panel, (WIDTH / 2, DEPTH / 2, 0.0)))], [0], [lamp])
    for name, (corners, height) in (("Short Block", SHORT_BLOCK), ("Tall Block", TALL_BLOCK)):
        middle = (*np.mean(corners, axis=0), height / 2)
        parts = [
            (vertices, _facing(vertices, faces, middle, inward=False)) for vertices, faces in block(corners, height)
        ]
        add_object(name, parts, [0] * len(parts), [white])
    _add_camera()


def _facing(vertices: np.ndarray, faces: np.ndarray, point, inward: bool = True) -> np.ndarray:
    """Turn quads so that they look at a point, or away from it."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    looks_at = np.einsum("ij,ij->i", normals, np.asarray(point) - corners.mean(axis=1)) > 0
    return np.where((looks_at == inward)[:, None], faces, faces[:, ::-1])


def _add_camera() -> None:
    scene = bpy.context.scene
    data = bpy.data.cameras.new("Camera")
    data.lens, data.sensor_width = FOCAL_LENGTH, SENSOR
    camera = bpy.data.objects.new("Camera", data)
    camera.location = (CAMERA[0] * MILLIMETER, CAMERA[1] * MILLIMETER, CAMERA[2] * MILLIMETER)
    camera.rotation_euler = (math.pi / 2, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 800
    scene.view_settings.view_transform = 'Standard'
    scene.world = bpy.data.worlds.new("Dark")
    scene.world.color = (0.0, 0.0, 0.0)


def main(path: Path) -> None:
    """Write the example."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    build()
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), compress=True)
    count = sum(len(mesh.vertices) for mesh in bpy.data.meshes)
    print(f"{path}: {count} vertices, {path.stat().st_size / 1e3:.0f} kB, Blender {bpy.app.version_string}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    sys.stdout.flush()
    os._exit(0)
