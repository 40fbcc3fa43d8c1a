"""What tests of the bake share: objects to put a scene together from, and a bake run to its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from radiosity.core.bake import BakeResult, bake_steps
from radiosity.core.bake_model import build_model, in_unit_frame, patch_solution_of
from radiosity.core.bake_plan import plan_for
from radiosity.core.cleaning import clean
from radiosity.core.matrix_plan import has_name, matrix_plan
from radiosity.core.progress import finish
from radiosity.core.scene import ReceiverMesh, Scene, Sky, Surfaces
from radiosity.core.settings import BakeSettings
from radiosity.core.visibility.embree import Frame, RayPool


@dataclass(frozen=True)
class Thing:
    """One object of a scene: faces of one number of corners, seen whole from their first corner, and one look.

    `normals` (v, 3) make it smooth; without them it is flat. `receives` tells whether its light is wanted.
    """

    vertices: np.ndarray
    faces: np.ndarray
    reflectance: object = 0.5
    emission: object = 0.0
    transmittance: float = 0.0
    two_sided: bool = True
    receives: bool = True
    name: str = "Thing"
    normals: np.ndarray | None = None


def scene_of(*things: Thing, lights: Sequence = (), sky: Sky | float | None = None) -> Scene:
    """A scene of these things; a number for the sky is its radiance everywhere."""
    parts, start = [], 0
    for number, thing in enumerate(things):
        faces = np.asarray(thing.faces, dtype=np.int32)
        triangles = _fan(faces) + start
        parts.append((number, thing, triangles))
        start += len(thing.vertices)
    counts = [len(triangles) for _, _, triangles in parts]

    def per_triangle(values):
        return np.repeat(np.array(values), counts, axis=0)

    surfaces = Surfaces(
        vertices=np.concatenate([np.asarray(thing.vertices, dtype=np.float64) for thing in things]),
        triangles=np.concatenate([triangles for _, _, triangles in parts]).astype(np.int32),
        materials=per_triangle([number for number, _, _ in parts]).astype(np.int32),
        objects=per_triangle([number for number, _, _ in parts]).astype(np.int32),
        object_names=tuple(thing.name for thing in things),
        reflectance=per_triangle([color(thing.reflectance) for thing in things]),
        emission=per_triangle([color(thing.emission) for thing in things]),
        transmittance=per_triangle([float(thing.transmittance) for thing in things]),
        two_sided=per_triangle([thing.two_sided for thing in things]),
        textured=np.zeros(sum(counts), bool),
    )
    if not isinstance(sky, Sky | None):
        sky = Sky(np.full((1, 1, 3), float(sky)))
    return Scene(surfaces, tuple(receiver_of(thing) for thing in things if thing.receives), tuple(lights), sky)


def receiver_of(thing: Thing) -> ReceiverMesh:
    """The thing's own topology as a mesh that receives."""
    vertices, faces = np.asarray(thing.vertices, dtype=np.float64), np.asarray(thing.faces, dtype=np.int32)
    if thing.normals is None:
        corners = vertices[faces]
        # Diagonals of a quad; of a triangle, which repeats its last corner here, the two sides.
        with np.errstate(invalid="ignore"):
            crosses = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])
            lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
            normals = np.repeat(crosses / np.where(lengths > 0, lengths, 1), faces.shape[1], axis=0)
    else:
        normals = np.asarray(thing.normals)[faces.reshape(-1)]
    return ReceiverMesh(
        name=thing.name,
        positions=vertices,
        corner_vertices=faces.reshape(-1),
        corner_normals=normals.astype(np.float32),
        face_offsets=np.arange(0, faces.size + 1, faces.shape[1], dtype=np.int32),
        face_materials=np.zeros(len(faces), np.int32),
        palette_reflectance=color(thing.reflectance)[None],
        palette_emission=color(thing.emission)[None],
    )


def color(value) -> np.ndarray:
    """Three channels of a number or of three."""
    return np.broadcast_to(np.asarray(value, dtype=float), (3,)).copy()


def _fan(faces: np.ndarray) -> np.ndarray:
    return np.stack([faces[:, [0, i, i + 1]] for i in range(1, faces.shape[1] - 1)], axis=1).reshape(-1, 3)


def bake(scene: Scene, accuracy: float = 0.1, threads: int = 1, **settings) -> BakeResult:
    """Bake to the end; coarse and on one thread unless asked otherwise."""
    return finish(bake_steps(scene, BakeSettings(accuracy=accuracy, threads=threads, **settings)))


def solved_patches(scene: Scene, accuracy: float = 0.1, **settings):
    """The patch solution of a scene, on one thread, and its model."""
    cleaned, plan = clean(scene.surfaces), plan_for(accuracy)
    settings = BakeSettings(accuracy=accuracy, **settings)
    if has_name(settings):
        plan = matrix_plan(plan, accuracy)
    frame = Frame.around(cleaned.surfaces.vertices)
    surfaces = in_unit_frame(cleaned.surfaces, frame)
    with RayPool(1) as pool:
        model = build_model(surfaces, frame, cleaned.rows, scene, plan, settings, pool)
        solution = patch_solution_of(model, scene, plan, settings, pool)
        finish(solution.solve())
    return solution, model


def corner_light(result: BakeResult, bake_type: str = "lighting", mesh: int = 0) -> np.ndarray:
    """(c, 3) at the corners of one mesh: irradiance in W/m2, or exitance for ``combined`` and ``emission``."""
    return np.pi * result.meshes[mesh].corner_colors(bake_type).astype(np.float64)


def all_light(result: BakeResult, bake_type: str = "lighting") -> np.ndarray:
    """(c, 3) at the corners of all meshes, one after the other."""
    return np.concatenate([corner_light(result, bake_type, mesh) for mesh in range(len(result.meshes))])


def corner_places(scene: Scene, mesh: int = 0) -> np.ndarray:
    """(c, 3) positions of the corners of one receiving mesh."""
    receiver = scene.receivers[mesh]
    return receiver.positions[receiver.corner_vertices]


def moved(scene: Scene, scale: float = 1.0, shift=(0.0, 0.0, 0.0), lights: Sequence | None = None) -> Scene:
    """The same scene, scaled about the origin and then shifted; lights must be given anew."""
    shift = np.asarray(shift, dtype=float)
    surfaces = replace(scene.surfaces, vertices=scene.surfaces.vertices * scale + shift)
    receivers = tuple(replace(mesh, positions=mesh.positions * scale + shift) for mesh in scene.receivers)
    return replace(
        scene, surfaces=surfaces, receivers=receivers, lights=scene.lights if lights is None else tuple(lights)
    )


def relative_rms(values: np.ndarray, reference: np.ndarray) -> float:
    """RMS of the difference over the mean of the reference: the error that an accuracy promises."""
    return float(np.sqrt(((values - reference) ** 2).mean()) / reference.mean())
