"""Color attributes of meshes: written all or none, and taken back.

What is replaced is kept until every mesh has its colors, so an error half-way leaves each mesh as it was. A mesh
remembers which attributes were baked, and which were active before, in the custom property `STATE_KEY`; copies of the
mesh carry it along, and `remove_color_attributes` takes it away with the rest. Light groups are attributes of their own
beside the one that holds their sum; a bake replaces those of the bake before.

An attribute of the wanted name, domain and type is overwritten in place and keeps its position. A color attribute of
that name with another domain or type is replaced: the new one is filled under a temporary name first, and takes the
name at the very end.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.errors import RadiosityError, SettingsError

#: Custom property of a mesh: JSON with the names of the baked attributes, what was active before the first of them, and
#: for each that has light groups their attributes by the groups' names.
STATE_KEY = "radiosity_color_attributes"

#: Blender 4.2 to 5.0 cut or refuse longer names of attributes: 68 bytes with the closing zero.
LONGEST_NAME = 67

_TEMPORARY_NAME = "radiosity_unfinished"
_COLOR_TYPES = ("FLOAT_COLOR", "BYTE_COLOR")


class WriteError(RadiosityError):
    """Blender refuses to store colors in a mesh."""


def baked_attributes(mesh: bpy.types.Mesh) -> list[str]:
    """Names of the attributes that a bake wrote to a mesh and that it still has."""
    return [name for name in _read_state(mesh).get("attributes", ()) if is_color_attribute(mesh, name)]


def group_attributes(mesh: bpy.types.Mesh) -> dict[str, dict[str, str]]:
    """For each attribute that a bake with light groups wrote to a mesh: names of the groups' attributes, by group.

    Those that are gone since are named too: whoever sums them up must know.
    """
    baked = baked_attributes(mesh)
    return {name: groups for name, groups in _read_state(mesh).get("groups", {}).items() if name in baked}


def written_attributes(mesh: bpy.types.Mesh) -> list[str]:
    """Names of all that bakes wrote to a mesh, light groups included."""
    state = _read_state(mesh)
    return [*state.get("attributes", ()), *_group_names(state)]


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


@dataclass(frozen=True)
class GroupColors:
    """Colors of one light group: its name, that of its attribute, and flat colors for each mesh."""

    group: str
    attribute: str
    colors: Sequence[np.ndarray]


def write_color_attributes(
    colors: Sequence[tuple[bpy.types.Mesh, np.ndarray]],
    name: str,
    domain: str,
    data_type: str,
    groups: Sequence[GroupColors] = (),
) -> None:
    """Store colors in the attribute `name` of each mesh, and make it the active and the render color. All or nothing.

    Parameters
    ----------
    colors : sequence of (Mesh, (4 n,) float32)
        Linear colors from `flat_colors`, n being the size of the domain; each mesh once.
    name, domain, data_type : str
        As in `BakeOptions`.
    groups : sequence of GroupColors
        Stored beside it as 32-bit numbers, in the same domain.

    Raises
    ------
    WriteError, SettingsError
        If any mesh cannot take the attribute; then none was changed.
    """
    # The one that is shown comes last, so that it ends up as the active one.
    layers = [(group.attribute, "FLOAT_COLOR", group.colors) for group in groups]
    layers.append((name, data_type, [values for _mesh, values in colors]))
    meshes = [mesh for mesh, _values in colors]
    for attribute, _type, each in layers:
        for mesh, values in zip(meshes, each, strict=True):
            check_writable(mesh, attribute)
            _check_size(mesh, values, domain)
    befores = [_Before(mesh) for mesh in meshes]
    finish = []
    with ExitStack() as undo:
        for number, (attribute, kind, each) in enumerate(layers):
            temporary = f"{_TEMPORARY_NAME}.{number}"
            for mesh, values, before in zip(meshes, each, befores, strict=True):
                finish.append(_fill(mesh, values, attribute, domain, kind, temporary, undo, before))
        # From here on nothing takes memory or can be refused: names and flags only.
        undo.pop_all()
    for step in finish:
        step()
    for mesh, before in zip(meshes, befores, strict=True):
        _remember(mesh, name, {group.group: group.attribute for group in groups}, before)


def _check_size(mesh, values, domain):
    size = len(mesh.loops if domain == "CORNER" else mesh.vertices)
    if values.shape != (4 * size,):
        raise WriteError(
            f"Mesh {mesh.name!r} has changed during the bake: {len(values) // 4} colors do not fit its {size} "
            f"{'corners' if domain == 'CORNER' else 'vertices'}. Nothing was written; bake again"
        )


def _fill(mesh, values, name, domain, data_type, temporary, undo: ExitStack, before):
    """Store the values of one mesh; the way back goes on the stack `undo`, the last step is returned."""
    old = mesh.attributes.get(name)
    if old is not None and (old.domain, old.data_type) == (domain, data_type):
        kept = np.empty(len(values), dtype=np.float32)
        old.data.foreach_get("color", kept)
        undo.callback(_set_colors, mesh, name, kept)
        _set_colors(mesh, name, values)
        return lambda: None
    mesh.color_attributes.new(name=temporary, type=data_type, domain=domain)
    undo.callback(_drop_temporary, mesh, temporary, before)
    if temporary not in mesh.attributes:
        raise WriteError(f"Blender refuses a new color attribute on mesh {mesh.name!r}")
    _set_colors(mesh, temporary, values)
    return lambda: _rename(mesh, temporary, name)


def _set_colors(mesh, name, values):
    mesh.attributes[name].data.foreach_set("color", values)
    mesh.update()


def _drop_temporary(mesh, temporary, before):
    # Adding moves attributes in memory, so it is always found by name.
    attribute = mesh.attributes.get(temporary)
    if attribute is not None:
        mesh.attributes.remove(attribute)
    before.restore(mesh)


def _rename(mesh, stored, name):
    if name in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[name])
    mesh.attributes[stored].name = name


def _remember(mesh, name, groups: dict[str, str], before):
    """Note what was written, remove groups that only the bake before had, and make the sum the active color."""
    state = _read_state(mesh) or {
        "attributes": [], "active": before.active_color, "render": before.render_color,
    }  # fmt: skip
    if name not in state["attributes"]:
        state["attributes"].append(name)
    former = state.setdefault("groups", {}).pop(name, {})
    _remove(mesh, [attribute for attribute in former.values() if attribute not in groups.values()])
    if groups:
        state["groups"][name] = groups
    if not state["groups"]:
        del state["groups"]
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
    written = written_attributes(mesh)
    _remove(mesh, written)
    # What the artist made active since then stays so.
    for attribute, current, former in (
        ("active_color_name", before.active_color, state["active"]),
        ("default_color_name", before.render_color, state["render"]),
    ):
        if current not in written:
            former = current
        elif former and not is_color_attribute(mesh, former):
            # Without any other it stays: Blender 5.2 keeps the name of an attribute that is gone.
            former = next((other.name for other in mesh.color_attributes), former)
        setattr(mesh.attributes, attribute, former)
    before.restore_active_attribute(mesh)
    del mesh[STATE_KEY]
    mesh.update()
    return True


def forget_groups(mesh: bpy.types.Mesh) -> bool:
    """Remove the light groups of a mesh and leave their sum as it is; whether there were any."""
    state = _read_state(mesh)
    if "groups" not in state:
        return False
    before = _Before(mesh)
    _remove(mesh, _group_names(state))
    del state["groups"]
    mesh[STATE_KEY] = json.dumps(state)
    # An artist may have made a group the active one.
    for flag, current in (("active_color_name", before.active_color), ("default_color_name", before.render_color)):
        setattr(mesh.attributes, flag, current if is_color_attribute(mesh, current) else state["attributes"][-1])
    before.restore_active_attribute(mesh)
    mesh.update()
    return True


def _group_names(state) -> list[str]:
    return [attribute for groups in state.get("groups", {}).values() for attribute in groups.values()]


def _remove(mesh, names):
    for name in names:
        if is_color_attribute(mesh, name):
            mesh.attributes.remove(mesh.attributes[name])


def _read_state(mesh) -> dict:
    text = mesh.get(STATE_KEY)
    return json.loads(text) if isinstance(text, str) else {}
