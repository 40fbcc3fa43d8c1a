"""The view of a picture: the scene's camera as Blender means it, or one framed on the scene where it has none."""

from __future__ import annotations

import logging

import bpy
import numpy as np

from ...core.rendering.framing import framed_view
from ...core.rendering.viewer import View, Viewer

logger = logging.getLogger(__name__)

#: Longest side of a picture in pixels when the scene's own resolution is taken: enough to judge a bake, quick to make.
MAX_SIDE = 1280


def picture_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """Width and height in pixels of the scene's render, scaled down to `MAX_SIDE` with its shape kept."""
    render = scene.render
    width = render.resolution_x * render.pixel_aspect_x
    height = render.resolution_y * render.pixel_aspect_y
    # Square pixels at the finer of the two spacings would enlarge; the first axis keeps its number.
    scale = render.resolution_percentage / 100 / render.pixel_aspect_x
    scale *= min(1.0, MAX_SIDE / (max(width, height) * scale))
    return max(1, round(width * scale)), max(1, round(height * scale))


def scene_view(context: bpy.types.Context, viewer: Viewer, width: int, height: int) -> View:
    """View of the scene's camera, or one framed on what the viewer shows if the scene has none.

    A camera that stands outside a closed room (a file's untouched default camera, mostly) looks through its back faces.
    """
    camera = context.scene.camera
    if camera is None or camera.type != 'CAMERA':
        return framed_view(viewer.engine, viewer.scene.vertices, viewer.scene.triangles, width / height)
    view = viewer.opened(camera_view(context, camera, width, height))
    if view.skips_backs:
        logger.info("Camera %r stands outside the room: its picture leaves out back faces", camera.name)
    return view


def camera_view(context: bpy.types.Context, camera: bpy.types.Object, width: int, height: int) -> View:
    """What a camera object sees in a picture of square pixels: lens, sensor fit, shift, clipping, orthographic scale.

    A panoramic camera is taken as a perspective one of the same lens.
    """
    depsgraph = context.evaluated_depsgraph_get()
    evaluated = camera.evaluated_get(depsgraph)
    # Blender's own projection knows every rule of sensor fit and shift; the window is read off its matrix.
    projection = np.array(evaluated.calc_matrix_camera(depsgraph, x=width, y=height, scale_x=1.0, scale_y=1.0))
    matrix = np.array(evaluated.matrix_world, dtype=np.float64)
    # A scaled camera sees as an unscaled one.
    right, up, backward = matrix[:3, :3].T / np.linalg.norm(matrix[:3, :3], axis=0)[:, None]
    data = evaluated.data
    perspective = data.type != 'ORTHO'
    half = 1 / projection[0, 0], 1 / projection[1, 1]
    # Column of the offset: applied to depth in perspective, constant otherwise, with opposite signs.
    offset = projection[:2, 2] if perspective else -projection[:2, 3]
    return View(
        position=matrix[:3, 3],
        right=right,
        up=up,
        forward=-backward,
        half_width=half[0],
        half_height=half[1],
        center=(offset[0] * half[0], offset[1] * half[1]),
        perspective=perspective,
        near=data.clip_start,
        far=data.clip_end,
    )
