"""Scenes that tests share, as arrays: a Cornell box, closed boxes and spheres, and what turns faces into a scene."""

from __future__ import annotations

import numpy as np
from radiosity.core.scene import ReceiverMesh, Scene, Sky, Surfaces

WHITE, RED, GREEN = (0.725, 0.71, 0.68), (0.63, 0.065, 0.05), (0.14, 0.45, 0.091)


def grid(corners, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and (n, 4) faces of a quad divided into columns x rows, in the order of its four corners."""
    corners = np.asarray(corners, dtype=float)
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)
    index = np.arange(u.size).reshape(u.shape)
    faces = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1)
    return (weights @ corners).reshape(-1, 3), faces.reshape(-1, 4)


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and the part of each face; vertices stay apart, so that each part has its own edges."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=False)])
    return vertices, faces, np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts])


def scene_from_quads(
    vertices,
    faces,
    face_materials,
    reflectance,
    emission,
    *,
    normals=None,
    name: str = "Mesh",
    two_sided: bool = True,
    sky: Sky | None = None,
    lights=(),
) -> Scene:
    """One mesh of quads as a scene that receives, blocks and bounces.

    Parameters
    ----------
    vertices : (v, 3) float
    faces : (f, 4) int
    face_materials : (f,) int
        Rows of the two that follow.
    reflectance, emission : (p, 3) float
        Emission is exitance in W/m2.
    normals : (v, 3) float or None
        Shading normals of a smooth mesh; None makes it flat.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    faces = np.asarray(faces, dtype=np.int32)
    face_materials = np.asarray(face_materials, dtype=np.int32)
    reflectance = np.asarray(reflectance, dtype=float).reshape(-1, 3)
    emission = np.asarray(emission, dtype=float).reshape(-1, 3)
    triangles = np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    materials = np.repeat(face_materials, 2)
    count = len(triangles)
    if normals is None:
        corners = vertices[faces]
        face_normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        face_normals /= np.linalg.norm(face_normals, axis=1, keepdims=True)
        corner_normals = np.repeat(face_normals, 4, axis=0)
    else:
        corner_normals = np.asarray(normals)[faces.reshape(-1)]
    surfaces = Surfaces(
        vertices=vertices,
        triangles=triangles,
        materials=materials,
        objects=np.zeros(count, dtype=np.int32),
        object_names=(name,),
        reflectance=reflectance[materials],
        emission=emission[materials],
        transmittance=np.zeros(count),
        two_sided=np.full(count, two_sided),
        textured=np.zeros(count, dtype=bool),
    )
    receiver = ReceiverMesh(
        name=name,
        positions=vertices,
        corner_vertices=faces.reshape(-1),
        corner_normals=corner_normals.astype(np.float32),
        face_offsets=np.arange(0, 4 * len(faces) + 1, 4, dtype=np.int32),
        face_materials=face_materials,
        palette_reflectance=reflectance,
        palette_emission=emission,
    )
    return Scene(surfaces=surfaces, receivers=(receiver,), lights=tuple(lights), sky=sky)


def box(size=(1.0, 1.0, 1.0), divisions: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A closed box that looks inward: vertices, faces and side (-x, +x, -y, +y, -z, +z) of each face."""
    x, y, z = size
    sides = (
        ((0, 0, 0), (0, y, 0), (0, y, z), (0, 0, z)),
        ((x, 0, 0), (x, 0, z), (x, y, z), (x, y, 0)),
        ((0, 0, 0), (0, 0, z), (x, 0, z), (x, 0, 0)),
        ((0, y, 0), (x, y, 0), (x, y, z), (0, y, z)),
        ((0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0)),
        ((0, 0, z), (0, y, z), (x, y, z), (x, 0, z)),
    )
    return joined(*(grid(corners, divisions, divisions) for corners in sides))


def furnace_box(divisions: int = 8, reflectance: float = 0.5, emission: float = 1.0) -> Scene:
    """A closed box that glows all over: the radiosity is emission / (1 - reflectance) everywhere."""
    vertices, faces, _ = box(divisions=divisions)
    return scene_from_quads(vertices, faces, np.zeros(len(faces)), [[reflectance] * 3], [[emission] * 3])


def inward_sphere(
    divisions: int = 12, radius: float = 1.0, reflectance: float = 0.5, emission: float = 1.0, smooth: bool = True
) -> Scene:
    """A closed sphere that looks inward and glows all over, made of a cube's six grids: no poles, quads only."""
    vertices, faces, _ = box((2.0, 2.0, 2.0), divisions)
    cube = np.tan((vertices - 1.0) * (np.pi / 4))  # equal angles, which keeps the quads alike in size
    directions = cube / np.linalg.norm(cube, axis=1, keepdims=True)
    _, first, inverse = np.unique(np.round(directions, 9), axis=0, return_index=True, return_inverse=True)
    faces, directions = inverse.reshape(-1)[faces], directions[first]
    return scene_from_quads(
        radius * directions,
        faces,
        np.zeros(len(faces)),
        [[reflectance] * 3],
        [[emission] * 3],
        normals=-directions if smooth else None,
    )


def cornell_box(divisions: int = 12, lamp: float = 17.0) -> Scene:
    """A Cornell box of side 1 with its front closed by a white wall, two blocks, and a lamp flush with the ceiling.

    Closed, so that all light is absorbed inside: power in equals power absorbed. Materials 0 to 3 are white, red, green
    and the lamp, whose exitance is pi times `lamp` times (1, 0.7, 0.25).
    """
    vertices, faces, sides = box(divisions=divisions)
    side_materials = np.array([1, 2, 0, 0, 0, 0])
    materials = side_materials[sides]
    middle = vertices[faces].mean(axis=1)
    materials[(sides == 5) & (np.abs(middle[:, :2] - 0.5) < 0.1).all(axis=1)] = 3
    parts, looks = [(vertices, faces)], [materials]
    for center, half, height, angle in (((0.67, 0.32), 0.15, 0.3, -0.3), ((0.33, 0.63), 0.15, 0.6, 0.3)):
        block = _block(center, half, height, angle, max(divisions // 3, 2))
        parts.append(block)
        looks.append(np.zeros(len(block[1]), dtype=int))
    vertices, faces, _ = joined(*parts)
    emission = np.zeros((4, 3))
    emission[3] = np.pi * lamp * np.array([1.0, 0.7, 0.25])
    return scene_from_quads(
        vertices, faces, np.concatenate(looks), [WHITE, RED, GREEN, (0.0, 0.0, 0.0)], emission, name="Cornell Box"
    )


def _block(center, half: float, height: float, angle: float, divisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Top and sides of a standing block, turned around its axis, looking outward."""
    size = np.array([2 * half, 2 * half, height])
    vertices, faces, sides = box(size, divisions)
    faces = faces[sides != 4, ::-1]
    used, inverse = np.unique(faces, return_inverse=True)
    vertices = vertices[used] - (half, half, 0.0)
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = vertices @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return turned + np.array([*center, 0.0]), inverse.reshape(-1, 4)
