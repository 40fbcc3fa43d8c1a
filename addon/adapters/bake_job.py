"""A whole bake in Blender as one generator: read, bake, write. Panel, script and command line all run this.

Between two steps only arrays and names are kept, since undo or a file that is opened may move or free what Blender
holds. Nothing is changed before the last step, so a bake that is closed or fails leaves all as it was; the last step
writes every mesh or none.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from ...core.bake import BakedMesh, BakeResult, Progress, bake_steps
from ...core.errors import RadiosityError
from .bake_settings import BakeOptions
from .color_attribute import (
    GroupColors,
    check_writable,
    flat_colors,
    is_color_attribute,
    write_color_attributes,
    written_attributes,
)
from .group_mix import show_groups
from .light_groups import group_attribute_names
from .memory import MemoryMeter, give_back_freed
from .preview_material import artist_materials
from .receiver_meshes import choose_receivers
from .report import listed, make_report, store_report
from .scene_reader import SceneReading, read_scene
from .update_job import baked_state, store_state
from .viewport import show_colors

#: Shares of the progress bar before and after the core.
_READ_SHARE = 0.04
_WRITE_SHARE = 0.02

#: Bytes above those at the start from which on freed memory is given back between stages.
_TIDY_ABOVE = 64_000_000

#: The largest value that BYTE_COLOR holds; a little more still rounds to it.
_BYTE_LIMIT = 1.0 + 0.5 / 255


#: Objects whose being left out is news. Lamps and cameras come along whenever all is selected.
_SURFACE_TYPES = frozenset(("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"))


class SceneChangedError(RadiosityError):
    """What was read at the start of a bake is no longer there at its end."""


@dataclass(frozen=True)
class _Target:
    """An object whose mesh takes colors, by names: its mesh as it was read."""

    object_name: str
    mesh_name: str
    vertices: int
    corners: int


def bake_job_steps(context: bpy.types.Context, options: BakeOptions) -> Generator[Progress, None, dict[str, Any]]:
    """Bake the scene of a context in steps of some tens of milliseconds.

    Parameters
    ----------
    context : bpy.types.Context
        Used until the scene is read; then names are kept.
    options : BakeOptions

    Yields
    ------
    Progress

    Returns
    -------
    dict
        The report, also stored with the scene as JSON.

    Raises
    ------
    RadiosityError
        For all that the user can mend; the text says what and how. Then nothing was changed.
    """
    start = time.perf_counter()
    meter = MemoryMeter()
    yield Progress(0.0, "Reading the scene")
    scene_name = context.scene.name
    reading = _read(context, options)
    targets = [_target(name) for name in reading.targets]
    light_state = baked_state(reading, options.world_strength)
    groups = _group_attributes(reading, options)
    warnings = _check_targets(targets, reading, options, groups)
    read_seconds = time.perf_counter() - start
    meter.sample()

    scene, reading = reading.scene, replace(reading, scene=None)
    steps = bake_steps(scene, options.settings)
    # The bake lets go of the surfaces when it has its own model of them, if nobody else holds them.
    del scene
    result = yield from _scaled(steps, meter)
    _tidy(meter)

    yield Progress(1.0 - _WRITE_SHARE, "Writing the colors")
    write_start = time.perf_counter()
    scene = bpy.data.scenes.get(scene_name)
    if scene is None:
        raise SceneChangedError(f"Scene {scene_name!r} was removed during the bake: nothing was written")
    warnings += result.warnings
    warnings += _write(targets, result, options, groups)
    show_groups(scene, groups)
    store_state(scene, light_state)
    if options.show_in_viewport:
        show_colors(bpy.context.screen)
    end = time.perf_counter()
    report = make_report(
        scene_name=scene_name,
        counts={**reading.counts, "baked_objects": len(targets)},
        settings=options.as_dict(),
        statistics={**result.statistics, "light_groups": groups},
        seconds={"read": read_seconds, "write": end - write_start, "total": end - start},
        memory=meter.result(),
        warnings=warnings,
        skipped=_skipped(reading),
    )
    store_report(scene, report)
    return report


def _read(context: bpy.types.Context, options: BakeOptions) -> SceneReading:
    """The scene with the artist's materials, and with a mesh for each object where that is wanted; all put back."""
    with ExitStack() as stack:
        stack.enter_context(artist_materials(context.scene.objects))
        if options.make_single_user:
            sharing = [bpy.data.objects[name] for name, _receiver in choose_receivers(context, None).shared]
            stack.callback(_share_again, _make_single_user(sharing))
        return read_scene(context, world_strength=options.world_strength, grouping=options.light_groups)


def _scaled(steps: Generator[Progress, None, BakeResult], meter: MemoryMeter) -> Generator[Progress, None, BakeResult]:
    """The core's steps on their part of the bar."""
    share = 1.0 - _READ_SHARE - _WRITE_SHARE
    message = None
    try:
        while True:
            try:
                progress = next(steps)
            except StopIteration as stop:
                return stop.value
            meter.sample()
            if progress.message != message:
                # A new stage: what the last one took must not add to what this one takes.
                message = progress.message
                _tidy(meter)
            yield Progress(_READ_SHARE + share * progress.fraction, progress.message)
    finally:
        steps.close()


def _tidy(meter: MemoryMeter) -> None:
    if meter.above_start > _TIDY_ABOVE:
        give_back_freed()


def _target(object_name: str) -> _Target:
    mesh = bpy.data.objects[object_name].data
    return _Target(object_name, mesh.name, len(mesh.vertices), len(mesh.loops))


def _group_attributes(reading: SceneReading, options: BakeOptions) -> dict[str, str]:
    """Attribute of each light group, by the groups' names."""
    groups = reading.scene.groups
    if groups is None:
        return {}
    return dict(zip(groups.names, group_attribute_names(options.attribute_name, groups.names), strict=True))


def _check_targets(
    targets: Sequence[_Target], reading: SceneReading, options: BakeOptions, groups: dict[str, str]
) -> list[str]:
    """Refuse what cannot be written, before the slow part; returns warnings."""
    warnings = []
    for name in (options.attribute_name, *groups.values()):
        overwritten = []
        for target in targets:
            obj = bpy.data.objects[target.object_name]
            mesh = obj.data
            check_writable(mesh, name, [group.name for group in obj.vertex_groups])
            if is_color_attribute(mesh, name) and name not in written_attributes(mesh):
                overwritten.append(mesh.name)
        if overwritten:
            warnings.append(
                f"A color attribute {name!r} that no bake had made was overwritten on: {listed(overwritten)}"
            )
    if not options.make_single_user:
        meshes = {bpy.data.objects[target.object_name].data for target in targets}
        crowded = {mesh for mesh in meshes if mesh.users - mesh.use_fake_user > 1}
        # Those that were asked for are named among the skipped.
        known = {*(target.object_name for target in targets), *(name for name, _receiver in reading.shared)}
        sharing = [obj.name for obj in bpy.data.objects if obj.data in crowded and obj.name not in known]
        if sharing:
            warnings.append(
                "These objects share their mesh with a baked one and show its light: "
                f"{listed(sharing)}. Turn on Make Single User to keep them apart"
            )
    return warnings


def _skipped(reading: SceneReading) -> list[dict[str, str]]:
    """What did not receive and why, with the remedy that this job offers for shared meshes."""
    remedies = {
        name: f"shares its mesh with {receiver!r} and shows its light: turn on Make Single User to bake it by itself"
        for name, receiver in reading.shared
    }
    return [
        {"object": name, "reason": remedies.get(name, reason)}
        for name, reason in reading.skipped
        if bpy.data.objects[name].type in _SURFACE_TYPES
    ]


def _write(targets: Sequence[_Target], result: BakeResult, options: BakeOptions, groups: dict[str, str]) -> list[str]:
    """Write all meshes or none; returns warnings."""
    objects = [_object_of(target) for target in targets]
    colors = [_values(baked, options) for baked in result.meshes]
    parts = [
        GroupColors(group, attribute, [_values(baked, options) for baked in result.groups[group]])
        for group, attribute in groups.items()
    ]
    copies = _make_single_user(objects) if options.make_single_user else []
    try:
        write_color_attributes(
            [(obj.data, values) for obj, values in zip(objects, colors, strict=True)],
            options.attribute_name,
            options.domain,
            options.data_type,
            parts,
        )
    except BaseException:
        _share_again(copies)
        raise
    if options.data_type != "BYTE_COLOR":
        return []
    what = "corners" if options.domain == "CORNER" else "vertices"
    clipped = [int((values.reshape(-1, 4) > _BYTE_LIMIT).any(axis=1).sum()) for values in colors]
    return [
        f"{target.object_name!r}: {count} of {len(values) // 4} {what} are brighter than white and were cut off: "
        "store the data type Color to keep them"
        for target, values, count in zip(targets, colors, clipped, strict=True)
        if count
    ]


def _object_of(target: _Target) -> bpy.types.Object:
    """The object of a target, if it is still what was read."""
    obj = bpy.data.objects.get(target.object_name)
    if obj is None or obj.type != 'MESH' or obj.data.name != target.mesh_name:
        raise SceneChangedError(
            f"Object {target.object_name!r} was removed or has another mesh since the bake started: nothing was written"
        )
    if (len(obj.data.vertices), len(obj.data.loops)) != (target.vertices, target.corners):
        raise SceneChangedError(
            f"Mesh {target.mesh_name!r} of {target.object_name!r} was edited during the bake: nothing was written; "
            "bake again"
        )
    return obj


def _values(baked: BakedMesh, options: BakeOptions) -> np.ndarray:
    bake_type = options.settings.bake_type
    rgb = baked.corner_colors(bake_type) if options.domain == "CORNER" else baked.vertex_colors(bake_type)
    if not np.isfinite(rgb).all():
        raise RadiosityError(
            f"The light on {baked.name!r} is not finite: nothing was written. Look for extreme emission strengths"
        )
    return flat_colors(rgb)


def _make_single_user(objects: Sequence[bpy.types.Object]) -> list[tuple[bpy.types.Object, bpy.types.Mesh]]:
    """Give each object a mesh of its own; returns (object, mesh it shared) of those changed."""
    changed = []
    for obj in objects:
        if obj.data.users - obj.data.use_fake_user > 1:
            changed.append((obj, obj.data))
            obj.data = obj.data.copy()
    return changed


def _share_again(changed: Sequence[tuple[bpy.types.Object, bpy.types.Mesh]]) -> None:
    """Take back `_make_single_user`."""
    for obj, shared in changed:
        copy, obj.data = obj.data, shared
        bpy.data.meshes.remove(copy)
