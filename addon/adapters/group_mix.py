"""Mixing of light groups: what the mesh shows is the sum of its groups, each dimmed, colored or switched off.

Nothing is solved: every group's light is kept in an attribute of its own, in 32-bit numbers. The mix is kept with the
scene, in `Scene.radiosity.groups`, and what changes there is written to all meshes of the scene at once; a new bake
starts from the light as it is. Beside the mix stands what each group has changed by since the bake (`update_job`).
Cost: about a millisecond for each group and 100,000 corners.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import bpy
import numpy as np

from ...core.errors import RadiosityError
from .color_attribute import forget_groups, group_attributes, is_color_attribute

_is_waiting = False


@contextmanager
def all_at_once() -> Iterator[None]:
    """While it lasts, changes of the mix are not written: whoever changes several does so at the end."""
    global _is_waiting
    before, _is_waiting = _is_waiting, True
    try:
        yield
    finally:
        _is_waiting = before


def mix_changed(scene: bpy.types.Scene) -> None:
    """Write the mix, unless more changes are to come; for update callbacks."""
    if not _is_waiting:
        write_mix(scene)


def write_mix(scene: bpy.types.Scene) -> int:
    """Make every baked attribute with light groups the sum of these, mixed; in how many meshes.

    Raises
    ------
    RadiosityError
        If a mesh is being edited, is linked, or has lost a group; then none was changed.
    """
    factors = {item.attribute: _factor(item) * np.array(item.change, np.float32) for item in scene.radiosity.groups}
    meshes = meshes_with_groups(scene)
    work = [(mesh, name, groups) for mesh in meshes for name, groups in group_attributes(mesh).items()]
    for mesh, name, groups in work:
        _check(mesh, name, groups)
    for mesh, name, groups in work:
        _write(mesh, name, [(attribute, factors.get(attribute, np.ones(3))) for attribute in groups.values()])
    return len(meshes)


def meshes_with_groups(scene: bpy.types.Scene) -> list[bpy.types.Mesh]:
    """Meshes of objects of a scene that have light groups, each once."""
    meshes = dict.fromkeys(obj.data for obj in scene.objects if obj.type == 'MESH')
    return [mesh for mesh in meshes if group_attributes(mesh)]


def is_mixed(scene: bpy.types.Scene) -> bool:
    """Whether any group is not as it was baked."""
    return any((_factor(item) != 1).any() for item in scene.radiosity.groups)


def show_groups(scene: bpy.types.Scene, attributes: dict[str, str]) -> None:
    """List groups, given as their attributes by name, with the light as it was baked."""
    groups = scene.radiosity.groups
    if not len(groups) and not attributes:
        return  # a file without groups is not to hold an empty list of them
    with all_at_once():
        groups.clear()
        for name, attribute in attributes.items():
            item = groups.add()
            item.name, item.attribute = name, attribute


def reset_mix(scene: bpy.types.Scene) -> None:
    """Bring all groups back to what was baked; nothing is written."""
    with all_at_once():
        for item in scene.radiosity.groups:
            for name in ("use_group", "color", "strength"):
                item.property_unset(name)


def relight(scene: bpy.types.Scene, factors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Note by what (3,) the light of each group has changed since the bake, and return what was noted; nothing is
    written."""
    former = {}
    for item in scene.radiosity.groups:
        former[item.name] = np.array(item.change)
        if item.name in factors:
            item.change = factors[item.name]
    return former


def flatten_groups(scene: bpy.types.Scene) -> int:
    """Remove the groups of all meshes of a scene and keep what they show; how many meshes had any."""
    meshes = {obj.data for obj in scene.objects if obj.type == 'MESH' and obj.data.is_editable}
    count = sum(forget_groups(mesh) for mesh in meshes)
    show_groups(scene, {})
    return count


def _factor(item) -> np.ndarray:
    return np.array(item.color, dtype=np.float32) * np.float32(item.strength if item.use_group else 0)


def _check(mesh, name, groups):
    if not mesh.is_editable:
        raise RadiosityError(f"Mesh {mesh.name!r} is linked from a library: make it local to mix its light groups")
    if mesh.is_editmode:
        raise RadiosityError(f"Mesh {mesh.name!r} is in Edit Mode: switch to Object Mode to mix its light groups")
    for group, attribute in groups.items():
        stored = mesh.attributes.get(attribute)
        if not is_color_attribute(mesh, attribute) or stored.domain != mesh.attributes[name].domain:
            raise RadiosityError(f"Mesh {mesh.name!r} has lost the light of group {group!r}: bake again")


def _write(mesh, name, parts):
    """Fill the attribute `name` with the sum of the attributes times their factors, `parts`."""
    size = len(mesh.attributes[name].data)
    total, light = (np.zeros((size, 4), np.float32) for _ in range(2))
    for attribute, factor in parts:
        if factor.any():
            mesh.attributes[attribute].data.foreach_get("color", light.reshape(-1))
            light *= np.append(factor, np.float32(0))
            total += light
    total[:, 3] = 1
    mesh.attributes[name].data.foreach_set("color", total.reshape(-1))
    mesh.update()
