"""Pictures of a baked scene, straight from its color attributes: no render engine, no GPU, no window.

Shows the evaluated meshes, instances included, in the scene's view
(`adapters.camera`), by `core.rendering.viewer`. A mesh that carries the attribute shows it; one that does not shows its
material's base color under a dim head light, so that it is seen to be unlit and still recognized.
"""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.errors import EmptySceneError
from ...core.rendering.viewer import ShownScene, View, Viewer
from .camera import picture_size, scene_view
from .images import ImageLibrary
from .mesh_arrays import MeshArrays, read_corner_normals, read_mesh
from .picture_file import write_picture
from .world import read_world

logger = logging.getLogger(__name__)

#: Types of objects that Blender can give as a mesh.
_MESHABLE = {'MESH', 'CURVE', 'SURFACE', 'META', 'FONT'}

#: Base color of faces without material, as Blender draws them.
_NO_MATERIAL = (0.8, 0.8, 0.8)

#: How bright the head light leaves surfaces that hold no bake, so that the baked ones stand out beside them.
_UNLIT_DIM = 0.35

#: Head light: what faces away from the viewer keeps this share.
_AMBIENT = 0.35

#: Shown where a ray meets nothing and the world gives nothing: a dark neutral gray, linear.
_BACKGROUND = (0.035, 0.035, 0.04)

#: Share of the picture's width that parts the two halves of a comparison.
_GUTTER = 0.012


@dataclass
class _Part:
    """One mesh in world space, per triangle."""

    vertices: np.ndarray  # (n, 3) float64
    triangles: np.ndarray  # (m, 3) int32
    normals: np.ndarray  # (m, 3, 3) float32, shading normals at the corners
    look: np.ndarray  # (m, 3) float32, base color, or emission scaled to at most 1
    is_emissive: np.ndarray  # (m,) bool
    light: np.ndarray | None  # (m, 3, 3) float32, the baked attribute at the corners


def render_baked_picture(
    context: bpy.types.Context,
    path: str | os.PathLike,
    attribute_name: str,
    resolution: tuple[int, int] | None = None,
    threads: int = 0,
    world_strength: float | None = None,
) -> None:
    """Write a PNG of the scene lit by a color attribute, seen from its camera or from one framed on it.

    Parameters
    ----------
    context : bpy.types.Context
    path : path-like
        Ends in .png; appears complete or not at all.
    attribute_name : str
    resolution : (width, height) or None
        In pixels; None takes the scene's, its longest side capped at `camera.MAX_SIDE`.
    threads : int
        0 takes all cores.
    world_strength : float or None
        That of the bake: the sky behind the scene is the one that lit it.

    Raises
    ------
    EmptySceneError
        If no mesh is visible to the render.
    PictureFileError
        If the file cannot be written.
    """
    write_picture(path, baked_pixels(context, attribute_name, resolution, threads, world_strength))


def render_comparison(
    context: bpy.types.Context,
    path: str | os.PathLike,
    attribute_name: str,
    resolution: tuple[int, int] | None = None,
    threads: int = 0,
) -> None:
    """Write two pictures side by side: plain material colors under a head light, and the same lit by the attribute.

    Parameters and errors are those of `render_baked_picture`; `resolution` is that of each half.
    """
    parts = _read_parts(context, attribute_name)
    width, height = resolution or picture_size(context.scene)
    before, view = _pixels(context, [_without_light(part) for part in parts], width, height, threads, dim=1.0)
    after, _ = _pixels(context, parts, width, height, threads, view=view)
    gutter = np.full((height, max(1, round(_GUTTER * width)), 3), 255, np.uint8)
    write_picture(path, np.concatenate([before, gutter, after], axis=1))


def baked_pixels(
    context: bpy.types.Context,
    attribute_name: str,
    resolution: tuple[int, int] | None = None,
    threads: int = 0,
    world_strength: float | None = None,
) -> np.ndarray:
    """The picture of `render_baked_picture` as (h, w, 3) uint8."""
    parts = _read_parts(context, attribute_name)
    width, height = resolution or picture_size(context.scene)
    return _pixels(context, parts, width, height, threads, world_strength=world_strength)[0]


def _pixels(
    context: bpy.types.Context,
    parts: list[_Part],
    width: int,
    height: int,
    threads: int,
    view: View | None = None,
    dim: float = _UNLIT_DIM,
    world_strength: float | None = None,
) -> tuple[np.ndarray, View]:
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    triangles = np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets[:-1], strict=True)])
    background, is_light = _background(context, world_strength)
    shown = ShownScene(
        vertices=vertices,
        triangles=triangles,
        colors=np.zeros((len(triangles), 3, 3), np.float32),
        is_light=np.concatenate([np.full(len(part.triangles), part.light is not None) for part in parts]),
        background=background,
        background_is_light=is_light and any(part.light is not None for part in parts),
    )
    viewer = Viewer(shown, threads)
    view = view or scene_view(context, viewer, width, height)
    start = 0
    for part in parts:
        stop = start + len(part.triangles)
        shown.colors[start:stop] = part.light if part.light is not None else _head_lit(part, view, dim)
        start = stop
    return viewer.picture(view, width, height), view


def _without_light(part: _Part) -> _Part:
    return _Part(part.vertices, part.triangles, part.normals, part.look, part.is_emissive, None)


def _head_lit(part: _Part, view: View, dim: float) -> np.ndarray:
    """(m, 3, 3) colors at the corners, 0 to 1, of surfaces lit by a lamp at the viewer."""
    if view.perspective:
        towards = view.position - part.vertices[part.triangles]
        towards /= np.maximum(np.linalg.norm(towards, axis=2, keepdims=True), np.finfo(np.float64).tiny)
    else:
        towards = np.broadcast_to(-np.asarray(view.forward), part.normals.shape)
    facing = np.abs(np.einsum("ijk,ijk->ij", part.normals, towards))
    shade = dim * (_AMBIENT + (1 - _AMBIENT) * facing)
    shade[part.is_emissive] = 1
    return (part.look[:, None, :] * shade[:, :, None]).astype(np.float32)


def _background(context: bpy.types.Context, world_strength: float | None) -> tuple[np.ndarray, bool]:
    """Colors behind the scene, and whether they are light: the sky of the bake, or neutral where it is black."""
    # A view layer may have a world of its own from Blender 5.0 on.
    world = getattr(context.view_layer, "world_override", None) or context.scene.world
    sky, _suns, _warnings = read_world(world, ImageLibrary(), world_strength)
    return (np.array(_BACKGROUND), False) if sky is None else (sky.radiance, True)


def _first_node(tree: bpy.types.NodeTree, kinds: set[str]) -> bpy.types.Node | None:
    return next((node for node in tree.nodes if node.type in kinds), None)


def _material_look(material: bpy.types.Material | None) -> tuple[np.ndarray, bool]:
    """Color (3,) that stands for a material in an unlit picture, and whether it emits."""
    if material is None:
        return np.array(_NO_MATERIAL), False
    color = np.array(material.diffuse_color[:3])
    tree = material.node_tree
    if tree is None:
        return color, False
    principled = _first_node(tree, {'BSDF_PRINCIPLED'})
    glow = _first_node(tree, {'EMISSION'}) or principled
    if glow is not None:
        # Named "Emission Color" by the Principled node since Blender 4.0 and "Color" by the Emission node.
        emitted = glow.inputs.get("Emission Color") or glow.inputs["Color"]
        strength = glow.inputs.get("Emission Strength") or glow.inputs["Strength"]
        emission = np.array(emitted.default_value[:3]) * max(strength.default_value, 0)
        if emission.max() > 0:
            return emission / emission.max(), True
    diffuse = principled or _first_node(tree, {'BSDF_DIFFUSE'})
    if diffuse is not None:
        base = diffuse.inputs.get("Base Color") or diffuse.inputs["Color"]
        if not base.is_linked:
            color = np.array(base.default_value[:3])
    return np.clip(color, 0, 1), False


def _read_parts(context: bpy.types.Context, attribute_name: str) -> list[_Part]:
    """Meshes that the render would show; raises EmptySceneError when there are none."""
    depsgraph = context.evaluated_depsgraph_get()
    local: dict[tuple, _Part | None] = {}
    parts = []
    for instance in depsgraph.object_instances:
        obj = instance.object
        if obj.type not in _MESHABLE or obj.hide_render or not instance.show_self:
            continue
        matrix = np.array(instance.matrix_world, dtype=np.float64)
        # Instances share their mesh: thousands of them are read once.
        key = (obj.data.as_pointer() if obj.data else 0, obj.as_pointer())
        if key not in local:
            local[key] = _read_part(obj, attribute_name)
        part = local[key]
        if part is not None:
            parts.append(_placed(part, matrix))
    parts = [part for part in parts if len(part.triangles)]
    if not parts:
        raise EmptySceneError("There is nothing to show: no mesh with faces is visible to the render")
    return parts


def _read_part(obj: bpy.types.Object, attribute_name: str) -> _Part | None:
    """One evaluated object as triangles in its own space; None if it has no mesh."""
    mesh = obj.to_mesh()
    if mesh is None:
        return None
    try:
        arrays = read_mesh(mesh)
        normals = read_corner_normals(mesh)
        colors = _corner_colors(mesh, obj.original, attribute_name, arrays)
    finally:
        obj.to_mesh_clear()
    looks = [_material_look(slot.material) for slot in obj.material_slots] or [_material_look(None)]
    # Faces may name a slot that is not there; Blender then takes the last.
    rows = np.clip(arrays.face_materials[arrays.triangle_faces], 0, len(looks) - 1)
    return _Part(
        vertices=arrays.positions.astype(np.float64),
        triangles=arrays.corner_vertices[arrays.triangle_corners],
        normals=normals[arrays.triangle_corners],
        look=np.array([color for color, _ in looks], dtype=np.float32)[rows],
        is_emissive=np.array([emits for _, emits in looks], dtype=bool)[rows],
        light=None if colors is None else colors[arrays.triangle_corners],
    )


def _corner_colors(
    mesh: bpy.types.Mesh, original: bpy.types.Object, name: str, arrays: MeshArrays
) -> np.ndarray | None:
    """(c, 3) float32 scene-linear colors of an attribute at the corners, or None if the mesh has none by that name."""
    attribute = mesh.color_attributes.get(name)
    if attribute is None:
        return None
    colors = _values(attribute)
    if attribute.domain == 'POINT':
        return colors[arrays.corner_vertices, :3]
    blank = (colors == 1).all(axis=1)
    if blank.any() and not _holds_white(original, name):
        faces = np.repeat(np.arange(len(arrays.face_offsets) - 1), np.diff(arrays.face_offsets))
        _fill(colors, blank, arrays.corner_vertices, faces)
    return colors[:, :3]


def _values(attribute: bpy.types.Attribute) -> np.ndarray:
    colors = np.empty(4 * len(attribute.data), np.float32)
    # "color" is scene-linear for bytes too; "color_srgb" would be the encoded value.
    attribute.data.foreach_get("color", colors)
    return colors.reshape(-1, 4)


def _holds_white(original: bpy.types.Object, name: str) -> bool:
    """Whether white was baked: then white is no sign of a face without colors."""
    attribute = original.data.color_attributes.get(name) if original.type == 'MESH' else None
    return attribute is None or bool((_values(attribute) == 1).all(axis=1).any())


def _fill(colors: np.ndarray, blank: np.ndarray, corner_vertices: np.ndarray, corner_faces: np.ndarray) -> None:
    """Give `blank` (c,) corners the mean color of the others at their vertex or, ring by ring, in their face.

    Some faces that the Bevel modifier makes have no corner to take colors from: Blender leaves them white.
    """
    known = ~blank
    while not known.all():
        before = known.sum()
        for groups in (corner_vertices, corner_faces):
            shares = np.bincount(groups[known], minlength=int(groups.max()) + 1)
            reached = np.nonzero(~known & (shares[groups] > 0))[0]
            for channel in range(4):
                sums = np.bincount(groups[known], weights=colors[known, channel], minlength=len(shares))
                colors[reached, channel] = (sums / np.maximum(shares, 1))[groups[reached]]
            known[reached] = True
        if known.sum() == before:
            break


def _placed(part: _Part, matrix: np.ndarray) -> _Part:
    """The part in world space, without triangles that have a corner nowhere."""
    vertices = part.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    # A mirrored or flat matrix has no useful inverse for normals; the cofactors serve every matrix.
    x, y, z = matrix[:3, :3].T
    normals = part.normals @ np.array([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), np.finfo(np.float32).tiny)
    sound = np.isfinite(vertices).all(axis=1)[part.triangles].all(axis=1)
    vertices = np.where(np.isfinite(vertices), vertices, 0)
    return _Part(
        vertices=vertices,
        triangles=part.triangles[sound],
        normals=normals[sound].astype(np.float32),
        look=part.look[sound],
        is_emissive=part.is_emissive[sound],
        light=None if part.light is None else part.light[sound],
    )
