"""Letters as outlines, from the font that is built into Blender: works in background and with any version."""

from __future__ import annotations

from functools import lru_cache

import bpy
import numpy as np


@lru_cache(maxsize=256)
def lettering(text: str) -> tuple[np.ndarray, float]:
    """Directed edges (m, 2, 2) of a text whose lines are one unit high, y upward from its base line, and its length.

    A text object lives for this moment only, in no scene, and leaves nothing.
    """
    known = set(bpy.data.fonts)
    curve = bpy.data.curves.new("Radiosity lettering", 'FONT')
    obj = bpy.data.objects.new("Radiosity lettering", curve)
    try:
        curve.body, curve.size, curve.fill_mode = text, 1.0, 'FRONT'
        mesh = obj.to_mesh()
        vertices = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", vertices)
        mesh.calc_loop_triangles()
        triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles)
        obj.to_mesh_clear()
    finally:
        bpy.data.objects.remove(obj)
        bpy.data.curves.remove(curve)
        for font in set(bpy.data.fonts) - known:  # the built-in one comes with the first text of a file
            bpy.data.fonts.remove(font)
    corners = vertices.reshape(-1, 3)[triangles.reshape(-1, 3), :2].astype(float)
    # All the same way around, so that triangles never take from each other.
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
    corners[clockwise] = corners[clockwise, ::-1]
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    return edges, float(corners[..., 0].max(initial=0.0))
