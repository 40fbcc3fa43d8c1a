"""Lamps as lights of the core: positions, shapes and units, defined by agreement with Cycles.

Blender gives the power of a point, spot or area lamp in W, and the strength of a sun in W/m2 across its rays. A point
or spot of power P has the intensity P / (4 pi) per steradian, a spot within its cone; an area lamp of area A has the
exitance P / A on the side of its -Z axis. The radius of a point or spot is that of a sphere, or with Soft Falloff that
of a disk that faces each point it lights. Limits, each named in a warning: the spread of an area lamp is taken as
180 degrees, textures of lamps as their sockets' values, lamps without shadow cast them, and light linking is ignored.
"""

from __future__ import annotations

from collections import defaultdict
from math import pi

import bpy
import numpy as np

from ...core.lights import AreaLight, Light, PointLight, SpotLight, SunLight
from .images import ImageLibrary
from .materials import find_output, node_tree_of
from .node_closures import compile_closure
from .node_graph import find_input
from .node_values import ValueCompiler

#: Corners of the polygon that stands for a disk or an ellipse, whose area it has.
ROUND_CORNERS = 48

#: Spreads within this of 180 degrees count as 180: the property is a float32.
SPREAD_TOLERANCE = 1e-3


class LampReader:
    """Makes lights of lamps, and collects what it had to leave out."""

    def __init__(self, images: ImageLibrary) -> None:
        self.images = images
        self._notes: defaultdict[str, list[str]] = defaultdict(list)

    def warnings(self) -> list[str]:
        """One line per kind of compromise, naming the lamps."""
        return [f"{text}: {', '.join(dict.fromkeys(names))}" for text, names in self._notes.items()]

    def read(self, obj: bpy.types.Object, matrix: np.ndarray) -> Light | None:
        """The light of a lamp.

        Parameters
        ----------
        obj : bpy.types.Object
            Whose data is a light.
        matrix : (4, 4) float64
            From the lamp's space to the world.

        Returns
        -------
        Light or None
            None where the lamp gives no light at all.
        """
        lamp = obj.data
        color = self._color(obj)
        if not color.any() or not np.isfinite(color).all() or not np.isfinite(matrix).all():
            return None
        self._note_limits(obj)
        position, back = matrix[:3, 3], matrix[:3, 2]
        length = np.linalg.norm(back)
        back = back / length if length > 0 else np.array([0.0, 0.0, 1.0])
        if lamp.type == 'SUN':
            return SunLight(back, color * _sun_share(lamp), float(lamp.angle))
        if lamp.type == 'AREA':
            return self._area(lamp, matrix, color, back)
        size = lamp.shadow_soft_size
        soft = bool(getattr(lamp, "use_soft_falloff", False))  # Blender 4.2 has it, older files open with it off
        intensity = color * _sphere_share(lamp) / (4 * pi)
        if lamp.type == 'SPOT':
            return SpotLight(
                position, -back, intensity, float(lamp.spot_size), float(lamp.spot_blend), float(size), soft
            )
        return PointLight(position, intensity, float(size), soft)

    def _area(self, lamp, matrix, color, back) -> AreaLight | None:
        corners = area_outline(lamp) @ matrix[:3, :3].T + matrix[:3, 3]
        center = corners - corners[0]
        vector_area = np.cross(center[1:-1], center[2:]).sum(0) / 2
        area = float(np.linalg.norm(vector_area))
        if area == 0:
            return None
        if vector_area @ back > 0:  # the front is where the lamp shines to, its -Z, mirrored or not
            corners = corners[::-1]
        return AreaLight(np.ascontiguousarray(corners), color / area if _is_normalized(lamp) else color)

    def _color(self, obj) -> np.ndarray:
        """(3,) strength times color, in the lamp's own unit."""
        lamp = obj.data
        color = np.array(lamp.color, dtype=np.float64) * lamp.energy
        if getattr(lamp, "use_temperature", False):  # from Blender 4.5
            color = color * np.array(lamp.temperature_color, dtype=np.float64)
        color = color * 2.0 ** getattr(lamp, "exposure", 0.0)  # from Blender 4.5
        tree = node_tree_of(lamp)
        if tree is None:
            return np.maximum(color, 0)
        output = find_output(tree, 'ShaderNodeOutputLight')
        if output is None:
            return np.zeros(3)
        values = ValueCompiler(self.images)
        emission = compile_closure(find_input(output, "Surface"), None, values).emission
        if values.unsupported or emission.attributes:
            self._notes["Textures and rays in the nodes of lamps were replaced by constants"].append(obj.name)
        if emission.attributes:
            return np.maximum(color, 0)
        return np.maximum(color * np.asarray(emission.constant, dtype=np.float64), 0)

    def _note_limits(self, obj) -> None:
        lamp = obj.data
        cycles = getattr(lamp.original, "cycles", None)  # an add-on of Blender's own, which may be disabled
        if not lamp.use_shadow or not getattr(cycles, "cast_shadow", True):
            self._notes["Lamps without shadow cast shadows in the bake"].append(obj.name)
        if lamp.type == 'AREA' and lamp.spread < pi - SPREAD_TOLERANCE:
            self._notes["The spread of area lamps is ignored: they shine over 180 degrees"].append(obj.name)
        linking = getattr(obj, "light_linking", None)  # from Blender 4.0
        if linking is not None and (linking.receiver_collection or linking.blocker_collection):
            self._notes["Light linking is ignored: these lamps light everything"].append(obj.name)


def area_outline(lamp: bpy.types.AreaLight) -> np.ndarray:
    """(k, 3) corners of an area lamp in its own space, counter-clockwise seen from +Z."""
    width = lamp.size
    height = lamp.size_y if lamp.shape in ('RECTANGLE', 'ELLIPSE') else width
    if lamp.shape in ('SQUARE', 'RECTANGLE'):
        outline = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    else:
        angles = np.arange(ROUND_CORNERS) * (2 * pi / ROUND_CORNERS)
        # A regular polygon of k corners on the unit circle has the area k/2 sin(2 pi / k) instead of pi.
        radius = 0.5 * np.sqrt(pi / (ROUND_CORNERS / 2 * np.sin(2 * pi / ROUND_CORNERS)))
        outline = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.column_stack([outline * (width, height), np.zeros(len(outline))])


def is_portal(lamp: bpy.types.Light) -> bool:
    """Whether an area lamp only guides Cycles' sampling and gives no light."""
    return lamp.type == 'AREA' and bool(getattr(getattr(lamp.original, "cycles", None), "is_portal", False))


def _is_normalized(lamp) -> bool:
    """Whether the power stays the same when the lamp's size changes; a choice from Blender 4.5."""
    return getattr(lamp, "normalize", True)


def _sphere_share(lamp) -> float:
    """Power per unit of strength: a lamp that is not normalized gives W per m2 of its sphere; 4 W for a point."""
    if _is_normalized(lamp):
        return 1.0
    return 4 * pi * lamp.shadow_soft_size**2 if lamp.shadow_soft_size > 0 else 4.0


def _sun_share(lamp) -> float:
    """Irradiance per unit of strength: a sun that is not normalized has the strength as its radiance."""
    if _is_normalized(lamp) or lamp.angle <= 0:
        return 1.0
    return pi * np.sin(lamp.angle / 2) ** 2
