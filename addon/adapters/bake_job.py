"""A whole bake in Blender as one generator: read, bake, write. Panel, script and command line all run this.

Between two steps only arrays and names are kept, since undo or a file that is opened may move or free what Blender
holds. Nothing is changed before the last step, so a bake that is closed or fails leaves all as it was; the last step
writes every mesh or none.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...core.bake import BakedMesh, BakeResult, Progress, bake_steps
from ...core.errors import RadiosityError
from .bake_settings import BakeOptions
from .color_attribute import (
    baked_attributes,
    check_writable,
    flat_colors,
    is_color_attribute,
    write_color_attributes,
)
from .memory import MemoryMeter
from .preview_material import artist_materials
from .report import make_report, store_report
from .scene_reader import read_scene
from .viewport import show_colors

#: Shares of the progress bar before and after the core.
_READ_SHARE = 0.04
_WRITE_SHARE = 0.02

#: The largest value that BYTE_COLOR holds; a little more still rounds to it.
_BYTE_LIMIT = 1.0 + 0.5 / 255


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
    with artist_materials(context.scene.objects):
        reading = read_scene(context, world_strength=options.world_strength)
    targets = [_target(name) for name in reading.targets]
    warnings = _check_targets(targets, options)
    read_seconds = time.perf_counter() - start
    meter.sample()

    result = yield from _scaled(bake_steps(reading.scene, options.settings), meter)

    yield Progress(1.0 - _WRITE_SHARE, "Writing the colors")
    write_start = time.perf_counter()
    scene = bpy.data.scenes.get(scene_name)
    if scene is None:
        raise SceneChangedError(f"Scene {scene_name!r} was removed during the bake: nothing was written")
    warnings += result.warnings
    warnings += _write(targets, result, options)
    if options.show_in_viewport:
        show_colors(bpy.context.screen)
    end = time.perf_counter()
    report = make_report(
        scene_name=scene_name,
        counts=reading.counts,
        settings=options.as_dict(),
        statistics=result.statistics,
        seconds={"read": read_seconds, "write": end - write_start, "total": end - start},
        memory=meter.result(),
        warnings=warnings,
        skipped=[{"object": name, "reason": reason} for name, reason in reading.skipped],
    )
    store_report(scene, report)
    return report


def _scaled(steps: Generator[Progress, None, BakeResult], meter: MemoryMeter) -> Generator[Progress, None, BakeResult]:
    """The core's steps on their part of the bar."""
    share = 1.0 - _READ_SHARE - _WRITE_SHARE
    try:
        while True:
            try:
                progress = next(steps)
            except StopIteration as stop:
                return stop.value
            meter.sample()
            yield Progress(_READ_SHARE + share * progress.fraction, progress.message)
    finally:
        steps.close()


def _target(object_name: str) -> _Target:
    mesh = bpy.data.objects[object_name].data
    return _Target(object_name, mesh.name, len(mesh.vertices), len(mesh.loops))


def _check_targets(targets: Sequence[_Target], options: BakeOptions) -> list[str]:
    """Refuse what cannot be written, before the slow part; returns warnings."""
    warnings = []
    users = Counter(target.mesh_name for target in targets)
    for name, count in users.items():
        if count > 1 and not options.make_single_user:
            warnings.append(_shared_warning(name, [t.object_name for t in targets if t.mesh_name == name]))
    for target in targets:
        obj = bpy.data.objects[target.object_name]
        check_writable(obj.data, options.attribute_name, [group.name for group in obj.vertex_groups])
        if is_color_attribute(obj.data, options.attribute_name) and options.attribute_name not in baked_attributes(
            obj.data
        ):
            warnings.append(
                f"Mesh {target.mesh_name!r} already had a color attribute {options.attribute_name!r} that no bake "
                "made: it was overwritten"
            )
    return list(dict.fromkeys(warnings))


def _shared_warning(mesh_name: str, objects: list[str]) -> str:
    return (
        f"Mesh {mesh_name!r} is shared by {len(objects)} objects, which all show the light of {objects[0]!r}: "
        "turn on Make Single User to bake each"
    )


def _write(targets: Sequence[_Target], result: BakeResult, options: BakeOptions) -> list[str]:
    """Write all meshes or none; returns warnings."""
    objects = [_object_of(target) for target in targets]
    colors: list[tuple[bpy.types.Object, np.ndarray]] = []
    seen: set[str] = set()
    warnings = []
    for target, obj, baked in zip(targets, objects, result.meshes, strict=True):
        if target.mesh_name in seen and not options.make_single_user:
            continue
        seen.add(target.mesh_name)
        values = _values(baked, options)
        if options.data_type == "BYTE_COLOR":
            clipped = int((values.reshape(-1, 4) > _BYTE_LIMIT).any(axis=1).sum())
            if clipped:
                what = "corners" if options.domain == "CORNER" else "vertices"
                warnings.append(
                    f"{target.object_name!r}: {clipped} of {len(values) // 4} {what} are brighter than white and were "
                    "cut off: store the data type Color to keep them"
                )
        colors.append((obj, values))
    copies = _make_single_user([obj for obj, _values in colors]) if options.make_single_user else []
    try:
        write_color_attributes(
            [(obj.data, values) for obj, values in colors],
            options.attribute_name,
            options.domain,
            options.data_type,
        )
    except BaseException:
        for obj, shared in copies:
            copy, obj.data = obj.data, shared
            bpy.data.meshes.remove(copy)
        raise
    return warnings


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
    """Give each object a mesh of its own; returns (object, mesh it shared) of those changed, to take it back."""
    changed = []
    for obj in objects:
        if obj.data.users - obj.data.use_fake_user > 1:
            changed.append((obj, obj.data))
            obj.data = obj.data.copy()
    return changed
