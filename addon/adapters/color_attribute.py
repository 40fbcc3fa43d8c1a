"""Color attributes of meshes: written all or none, and taken back.

What is replaced is kept until every mesh has its colors, so an error half-way leaves each mesh as it was. A mesh
remembers which attributes were baked, and which were active before, in the custom property `STATE_KEY`; copies of the
mesh carry it along, and `remove_color_attributes` takes it away with the rest.

An attribute of the wanted name, domain and type is overwritten in place and keeps its position. A color attribute of
that name with another domain or type is replaced: the new one is filled under a temporary name first, and takes the
name at the very end.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack

import bpy
import numpy as np

from ...core.errors import RadiosityError, SettingsError

#: Custom property of a mesh: JSON with the names of the baked attributes, and what was active before the first of them.
STATE_KEY = "radiosity_color_attributes"

_TEMPORARY_NAME = "radiosity_unfinished"
_COLOR_TYPES = ("FLOAT_COLOR", "BYTE_COLOR")


class WriteError(RadiosityError):
    """Blender refuses to store colors in a mesh."""


def baked_attributes(mesh: bpy.types.Mesh) -> list[str]:
    """Names of the attributes that a bake wrote to a mesh and that it still has."""
    return [name for name in _read_state(mesh).get("attributes", ()) if is_color_attribute(mesh, name)]


def is_color_attribute(mesh: bpy.types.Mesh, name: str) -> bool:
    """Whether a mesh has a color attribute of that name, on corners or vertices."""
    attribute = mesh.attributes.get(name)
    return attribute is not None and attribute.data_type in _COLOR_TYPES and attribute.domain in ("CORNER", "POINT")


def check_writable(mesh: bpy.types.Mesh, name: str, vertex_groups: Sequence[str] = ()) -> None:
    """Refuse meshes that cannot take a color attribute of that name.

    Raises
    ------
    WriteError
        If the mesh belongs to a library or is being edited.
    SettingsError
        If the mesh uses the name for something else.
    """
    if not mesh.is_editable:
        raise WriteError(f"Mesh {mesh.name!r} is linked from a library: make it local to bake it")
    if mesh.is_editmode:
        raise WriteError(f"Mesh {mesh.name!r} is in Edit Mode: switch to Object Mode to bake it")
    attribute = mesh.attributes.get(name)
    if attribute is not None and not is_color_attribute(mesh, name):
        raise SettingsError(
            f"Mesh {mesh.name!r} uses the name {name!r} for an attribute of another kind "
            f"({attribute.data_type}, {attribute.domain}): choose another attribute name"
        )
    if attribute is None and name in vertex_groups:
        raise SettingsError(f"Mesh {mesh.name!r} has a vertex group named {name!r}: choose another attribute name")


def flat_colors(rgb: np.ndarray) -> np.ndarray:
    """(n, 3) colors as the flat float32 array with alpha 1 that `foreach_set` takes fastest, 4 n long."""
    rgba = np.ones((len(rgb), 4), dtype=np.float32)
    rgba[:, :3] = rgb
    return rgba.reshape(-1)


def write_color_attributes(
    colors: Sequence[tuple[bpy.types.Mesh, np.ndarray]], name: str, domain: str, data_type: str
) -> None:
    """Store colors in the attribute `name` of each mesh, and make it the active and the render color. All or nothing.

    Parameters
    ----------
    colors : sequence of (Mesh, (4 n,) float32)
        Linear colors from `flat_colors`, n being the size of the domain; each mesh once.
    name, domain, data_type : str
        As in `BakeOptions`.

    Raises
    ------
    WriteError, SettingsError
        If any mesh cannot take the attribute; then none was changed.
    """
    for mesh, values in colors:
        check_writable(mesh, name)
        size = len(mesh.loops if domain == "CORNER" else mesh.vertices)
        if values.shape != (4 * size,):
            raise WriteError(
                f"Mesh {mesh.name!r} has changed during the bake: {len(values) // 4} colors do not fit its {size} "
                f"{'corners' if domain == 'CORNER' else 'vertices'}. Nothing was written; bake again"
            )
    with ExitStack() as undo:
        finish = [_fill(mesh, values, name, domain, data_type, undo) for mesh, values in colors]
        # From here on nothing takes memory or can be refused: names and flags only.
        undo.pop_all()
    for step in finish:
        step()


def _fill(mesh, values, name, domain, data_type, undo: ExitStack):
    """Store the values of one mesh; the way back goes on the stack `undo`, the last step is returned."""
    old = mesh.attributes.get(name)
    before = _Before(mesh)
    if old is not None and (old.domain, old.data_type) == (domain, data_type):
        kept = np.empty(len(values), dtype=np.float32)
        old.data.foreach_get("color", kept)
        undo.callback(_set_colors, mesh, name, kept)
        _set_colors(mesh, name, values)
        return lambda: _finish(mesh, name, name, before)
    mesh.color_attributes.new(name=_TEMPORARY_NAME, type=data_type, domain=domain)
    undo.callback(_drop_temporary, mesh, before)
    if _TEMPORARY_NAME not in mesh.attributes:
        raise WriteError(f"Blender refuses a new color attribute on mesh {mesh.name!r}")
    _set_colors(mesh, _TEMPORARY_NAME, values)
    return lambda: _finish(mesh, _TEMPORARY_NAME, name, before)


def _set_colors(mesh, name, values):
    mesh.attributes[name].data.foreach_set("color", values)
    mesh.update()


def _drop_temporary(mesh, before):
    # Adding moves attributes in memory, so it is always found by name.
    attribute = mesh.attributes.get(_TEMPORARY_NAME)
    if attribute is not None:
        mesh.attributes.remove(attribute)
    before.restore(mesh)


def _finish(mesh, stored, name, before):
    if stored != name:
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
        mesh.attributes[stored].name = name
    state = _read_state(mesh) or {
        "attributes": [], "active": before.active_color, "render": before.render_color,
    }  # fmt: skip
    if name not in state["attributes"]:
        state["attributes"].append(name)
    mesh[STATE_KEY] = json.dumps(state)
    before.restore_active_attribute(mesh)
    mesh.attributes.active_color_name = name
    mesh.attributes.default_color_name = name
    mesh.update()


class _Before:
    """Which attributes of a mesh are active. Blender keeps some by index, which shifts when one is added."""

    def __init__(self, mesh):
        attributes = mesh.attributes
        self.active_color = attributes.active_color_name
        self.render_color = attributes.default_color_name
        self.active = attributes.active.name if attributes.active else None

    def restore(self, mesh):
        mesh.attributes.active_color_name = self.active_color
        mesh.attributes.default_color_name = self.render_color
        self.restore_active_attribute(mesh)

    def restore_active_attribute(self, mesh):
        if self.active is not None and self.active in mesh.attributes:
            mesh.attributes.active = mesh.attributes[self.active]


def remove_color_attributes(mesh: bpy.types.Mesh) -> bool:
    """Remove what bakes wrote to a mesh and make active again what was before; whether there was anything."""
    state = _read_state(mesh)
    if not state:
        return False
    before = _Before(mesh)
    for name in baked_attributes(mesh):
        mesh.attributes.remove(mesh.attributes[name])
    # What the artist made active since then stays so.
    for attribute, current, former in (
        ("active_color_name", before.active_color, state["active"]),
        ("default_color_name", before.render_color, state["render"]),
    ):
        if current not in state["attributes"]:
            former = current
        elif former and not is_color_attribute(mesh, former):
            # Without any other it stays: Blender 5.2 keeps the name of an attribute that is gone.
            former = next((other.name for other in mesh.color_attributes), former)
        setattr(mesh.attributes, attribute, former)
    before.restore_active_attribute(mesh)
    del mesh[STATE_KEY]
    mesh.update()
    return True


def _read_state(mesh) -> dict:
    text = mesh.get(STATE_KEY)
    return json.loads(text) if isinstance(text, str) else {}
