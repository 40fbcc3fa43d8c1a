"""Light groups of a scene: which lamps, emitting objects and skies have their light kept apart, and under what names.

*Per Light* gives each lamp a group, each object that emits, and the world; objects with instances are one. *Per
Collection* puts together what is in one collection, the first one where an object is in several. Only what gives light
has a group. Each group becomes a color attribute, named after the attribute of the whole light.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ...core.errors import SettingsError
from ...core.light_groups import LightGroups
from ...core.scene import ReceiverMesh, Scene
from .color_attribute import LONGEST_NAME

#: Ways to put lights into groups.
GROUPINGS = ("LIGHT", "COLLECTION")

#: Groups at most: each is a color attribute on every baked mesh, 16 bytes a corner, and a row in the panel.
MOST_GROUPS = 64

#: Group of the sky and of suns in its picture.
WORLD = "World"


def light_groups(
    grouping: str, scene: Scene, lamp_names: Sequence[str], blender_scene: bpy.types.Scene
) -> LightGroups | None:
    """The groups of what gives light in a scene that was read, None where nothing does.

    Parameters
    ----------
    grouping : str
        One of `GROUPINGS`.
    scene : Scene
        As the core will have it; lights beyond the lamps are suns of the world.
    lamp_names : sequence of str
        Objects of the first of its lights.
    blender_scene : bpy.types.Scene
        Whose collections count.

    Raises
    ------
    SettingsError
        If there would be more than `MOST_GROUPS`.
    """
    surfaces = scene.surfaces
    shining = surfaces.wearing((surfaces.emission > 0).any(axis=1))
    emitting = {surfaces.object_names[row] for row in np.unique(surfaces.objects[shining])}
    emitting |= {mesh.name for mesh in scene.receivers if _emits(mesh)}
    group_of = _groups_of_objects(grouping, blender_scene, {*lamp_names, *emitting})
    has_world = not scene.sky_is_dark or len(scene.lights) > len(lamp_names)
    names = sorted(set(group_of.values()))
    if has_world:
        names.append(_unused(WORLD, names))
    if len(names) > MOST_GROUPS:
        remedy = "group them by collection" if grouping == "LIGHT" else "put lights into fewer collections"
        raise SettingsError(f"There would be {len(names)} light groups, and {MOST_GROUPS} are the limit: {remedy}")
    if not names:
        return None
    rows = {name: row for row, name in enumerate(names)}

    def row_of(name: str) -> int:
        # What gives no light may be in any group.
        return rows[group_of[name]] if name in group_of else 0

    suns = len(scene.lights) - len(lamp_names)
    return LightGroups(
        names=tuple(names),
        lights=np.array([row_of(name) for name in lamp_names] + [len(names) - 1] * suns, dtype=np.int64),
        objects=np.array([row_of(name) for name in surfaces.object_names], dtype=np.int64),
        receivers=np.array([row_of(mesh.name) for mesh in scene.receivers], dtype=np.int64),
        sky=len(names) - 1,
    )


def group_attribute_names(attribute: str, groups: Sequence[str]) -> list[str]:
    """Names of the attributes of groups beside that of the whole light: short enough for Blender, none twice."""
    names = []
    for group in groups:
        name = _cut(f"{attribute}.{group}", LONGEST_NAME)
        names.append(_unused(name, [attribute, *names]))
    return names


def _groups_of_objects(grouping: str, blender_scene: bpy.types.Scene, names: set[str]) -> dict[str, str]:
    """Group of each of the named objects."""
    if grouping == "LIGHT":
        return {name: name for name in names}
    found = {}
    for collection in (*blender_scene.collection.children_recursive, blender_scene.collection):
        for obj in collection.objects:
            if obj.name in names:
                found.setdefault(obj.name, collection.name)
    for name in names - found.keys():
        # In a collection that the scene only instances.
        obj = bpy.data.objects.get(name)
        collections = obj.users_collection if obj is not None else ()
        found[name] = collections[0].name if collections else blender_scene.collection.name
    return found


def _emits(mesh: ReceiverMesh) -> bool:
    return bool((mesh.palette_emission > 0).any() or (mesh.corner_emission is not None and mesh.corner_emission.any()))


def _unused(name: str, names: Sequence[str]) -> str:
    """The name, or as Blender does it with a number where it is taken."""
    number, free = 0, name
    while free in names:
        number += 1
        free = f"{_cut(name, LONGEST_NAME - 4)}.{number:03d}"
    return free


def _cut(name: str, size: int) -> str:
    return name.encode("utf-8")[:size].decode("utf-8", errors="ignore").rstrip()
