"""Materials as looks: which output of a material counts, and what it makes of the surface.

A `Look` holds fields only, no reference to Blender. Limits: a look is the same from both sides, unless the back is
black or does not emit (by Geometry, Backfacing), which makes it one-sided. `use_backface_culling` is ignored, as in
Cycles.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi

import bpy
import numpy as np

from .fields import Field, combine, constant
from .images import ImageLibrary
from .mesh_arrays import AttributeKey
from .node_closures import NOTHING, Closure, compile_closure
from .node_graph import find_input
from .node_values import ValueCompiler

#: What Blender shows where there is no material.
DEFAULT_COLOR = (0.8, 0.8, 0.8)

#: Renderers in the order in which their outputs count. Files from before 2.80 have one for each of the last two.
OUTPUT_ORDER = ('CYCLES', 'ALL', 'EEVEE')


@dataclass(frozen=True, eq=False)
class Look:
    """What a material makes of a surface.

    Parameters
    ----------
    reflectance, emission : Field
        Colors; emission is exitance in W/m2, pi times the shader's radiance.
    transmittance : Field
        Value, 0 to 1.
    two_sided : bool
    attributes : frozenset of AttributeKey
        What evaluation needs; empty for a look that does not vary.
    """

    reflectance: Field
    emission: Field
    transmittance: Field
    two_sided: bool
    attributes: frozenset[AttributeKey]

    @property
    def values(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Reflectance (3,), emission (3,) and transmittance of a look that does not vary, as float64."""
        reflectance, emission = (
            np.asarray(each.constant, dtype=np.float64) for each in (self.reflectance, self.emission)
        )
        return reflectance, emission, float(self.transmittance.constant[0])


def make_look(closure: Closure, two_sided: bool = True) -> Look:
    """A look from what a shader does; non-finite and negative values become 0."""

    def tidy(array):
        return np.maximum(np.nan_to_num(array, nan=0.0, posinf=0.0, neginf=0.0), 0)

    reflectance = combine(tidy, closure.reflectance)
    emission = combine(lambda array: tidy(array) * np.float32(pi), closure.emission)
    transmittance = combine(lambda array: np.minimum(tidy(array), 1), closure.transmittance)
    attributes = reflectance.attributes | emission.attributes | transmittance.attributes
    return Look(reflectance, emission, transmittance, two_sided, attributes)


def node_tree_of(block) -> bpy.types.NodeTree | None:
    """The node tree of a material, world or light that uses one."""
    # Materials and worlds always use nodes from Blender 5.0, which warns when it is asked.
    if bpy.app.version >= (5, 0) and not isinstance(block, bpy.types.Light):
        return block.node_tree
    return block.node_tree if block.use_nodes else None


def find_output(tree: bpy.types.NodeTree, kind: str = 'ShaderNodeOutputMaterial') -> bpy.types.Node | None:
    """The output node that renders: that of Cycles, else for all renderers, else of EEVEE."""
    if kind == 'ShaderNodeOutputMaterial':
        for target in OUTPUT_ORDER:
            node = tree.get_output_node(target)
            if node is not None:
                return node
        return None
    nodes = [node for node in tree.nodes if node.bl_idname == kind]
    ranked = sorted(nodes, key=lambda node: (not node.is_active_output, OUTPUT_ORDER.index(node.target)))
    return ranked[0] if ranked else None


class MaterialLibrary:
    """Reads each material once, and collects what it had to leave out.

    Parameters
    ----------
    images : ImageLibrary
    override : bpy.types.Material or None
        The view layer's material override, worn by everything.
    """

    def __init__(self, images: ImageLibrary, override: bpy.types.Material | None = None) -> None:
        self.images = images
        self.override = override
        self._looks: dict[int, Look] = {}
        self._unsupported: dict[str, list[str]] = {}
        self._one_way: list[str] = []

    @property
    def count(self) -> int:
        """Number of materials read, Blender's default included."""
        return len(self._looks)

    def look(self, material: bpy.types.Material | None) -> Look:
        """The look of a material; of Blender's default where there is none."""
        key = material.as_pointer() if material is not None else 0
        if key not in self._looks:
            self._looks[key] = self._read(material)
        return self._looks[key]

    def warnings(self) -> list[str]:
        """One line per kind of compromise, naming the materials."""
        lines = []
        if self._unsupported:
            parts = [f"{material} ({', '.join(nodes)})" for material, nodes in sorted(self._unsupported.items())]
            lines.append(f"Nodes that cannot be baked were replaced by their sockets' own values: {join_names(parts)}")
        if self._one_way:
            names = join_names(sorted(self._one_way))
            lines.append(f"Materials that differ between front and back were read from the front: {names}")
        return lines

    def _read(self, material) -> Look:
        if material is None:
            return make_look(Closure(constant(*DEFAULT_COLOR), NOTHING.emission, NOTHING.transmittance))
        tree = node_tree_of(material)
        if tree is None:
            color = constant(*material.diffuse_color[:3])
            return make_look(Closure(color, NOTHING.emission, NOTHING.transmittance))
        front = self._side(material, tree, 0.0)
        if not _asks_for_side(tree):
            return front
        back = self._side(material, tree, 1.0)
        if _is_dark(back.emission) and not _is_dark(front.emission):
            return make_look_one_sided(front)
        if _is_dark(back.emission) and _is_dark(back.reflectance) and _is_dark(back.transmittance):
            return make_look_one_sided(front)
        if not _is_equal(front, back):
            self._one_way.append(material.name)
        return front

    def _side(self, material, tree, backfacing: float) -> Look:
        output = find_output(tree)
        if output is None:
            return make_look(NOTHING)
        values = ValueCompiler(self.images, backfacing)
        surface = find_input(output, "Surface")
        if not surface.is_linked and find_input(output, "Volume").is_linked:
            return make_look(Closure(NOTHING.reflectance, NOTHING.emission, constant(1.0)))
        look = make_look(compile_closure(surface, None, values))
        if values.unsupported:
            self._unsupported[material.name] = values.unsupported
        return look


def make_look_one_sided(look: Look) -> Look:
    """The same look with a black back."""
    return Look(look.reflectance, look.emission, look.transmittance, False, look.attributes)


def join_names(names: Iterable[str], limit: int = 8) -> str:
    """Names with commas, the rest as a number where there are many."""
    names = list(names)
    shown = ", ".join(names[:limit])
    return shown if len(names) <= limit else f"{shown} and {len(names) - limit} more"


def _asks_for_side(tree: bpy.types.NodeTree, depth: int = 0) -> bool:
    """Whether a tree or a group in it has a node that tells front from back."""
    for node in tree.nodes:
        if node.bl_idname == 'ShaderNodeNewGeometry':
            return True
        inner = getattr(node, "node_tree", None)
        if inner is not None and depth < 32 and _asks_for_side(inner, depth + 1):
            return True
    return False


def _is_dark(field: Field) -> bool:
    return not field.attributes and not field.constant.any()


def _is_equal(front: Look, back: Look) -> bool:
    """Whether two constant looks are the same; looks that vary are taken for the same where they ask for the same."""
    if front.attributes or back.attributes:
        return front.attributes == back.attributes
    return all(np.allclose(a, b) for a, b in zip(front.values, back.values, strict=True))
