"""A whole verification in Blender as one generator: read scene and colors, measure, add to the report.

What was baked, and with which settings, is read from the report of the scene. Nothing but that report is changed, and
only at the end.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any

import bpy
import numpy as np

from ...core.errors import EmptySceneError, RadiosityError
from ...core.progress import Progress
from ...core.verification.verification import PLACES, StoredColors, Verification, verify_steps
from .color_attribute import baked_attributes
from .group_mix import is_mixed
from .preview_material import artist_materials
from .report import read_report, store_report
from .scene_reader import SceneReading, read_scene

#: Names in the report.
KEYS = ("measured_error", "measured_error_low", "measured_error_high", "measured_places", "measured_noise")

_READ_SHARE = 0.04


def verify_job_steps(
    context: bpy.types.Context, places: int = PLACES, seed: int = 0, threads: int | None = None
) -> Generator[Progress, None, dict[str, Any]]:
    """Measure the error of what the last bake stored in the scene of a context.

    Parameters
    ----------
    context : bpy.types.Context
        Used until the scene is read.
    places : int
        Receivers compared.
    seed : int
        Other numbers choose other receivers.
    threads : int, optional
        As in the bake unless given.

    Yields
    ------
    Progress

    Returns
    -------
    dict
        The report of the last bake with what was measured, also stored with the scene.

    Raises
    ------
    RadiosityError
        For all that the user can mend; then nothing was changed.
    """
    start = time.perf_counter()
    yield Progress(0.0, "Reading the scene")
    scene_name = context.scene.name
    report = read_report(context.scene)
    if report is None:
        raise EmptySceneError(f"Nothing was baked in scene {scene_name!r} yet: bake first, then measure")
    if is_mixed(context.scene):
        raise RadiosityError("The light groups are mixed, and the light shown is not that of the scene: reset the mix")
    settings = report["settings"]
    name = settings["attribute_name"]
    reading = _read(context, name, settings["world_strength"])
    stored = [_stored(bpy.data.objects[target].data, name) for target in reading.targets]
    work = verify_steps(
        reading.scene,
        stored,
        settings["bake_type"],
        places,
        seed=seed,
        threads=settings["threads"] if threads is None else threads,
    )
    del reading, stored
    found = yield from _scaled(work)
    scene = bpy.data.scenes.get(scene_name)
    if scene is None:
        raise RadiosityError(f"Scene {scene_name!r} was removed meanwhile: nothing was stored")
    report = {**report, **_entries(found), "seconds": {**report["seconds"], "verify": time.perf_counter() - start}}
    store_report(scene, report)
    return report


def _read(context: bpy.types.Context, name: str, world_strength: float | None) -> SceneReading:
    """The scene as it was baked, with the meshes that hold the attribute as receivers."""
    objects = [obj for obj in context.view_layer.objects if obj.type == 'MESH' and name in baked_attributes(obj.data)]
    if not objects:
        raise EmptySceneError(f"No mesh has the baked attribute {name!r} any more: bake again")
    with artist_materials(context.scene.objects):
        return read_scene(context, receivers=objects, world_strength=world_strength)


def _stored(mesh: bpy.types.Mesh, name: str) -> StoredColors:
    attribute = mesh.attributes[name]
    colors = np.empty(4 * len(attribute.data), dtype=np.float32)
    attribute.data.foreach_get("color", colors)
    values = colors.reshape(-1, 4)[:, :3]
    if attribute.data_type == 'BYTE_COLOR':
        values = np.where(values < 1, values, np.nan)  # cut off: what light it was is not told
    return StoredColors(values, attribute.domain == 'POINT')


def _scaled(work: Generator[Progress, None, Verification]) -> Generator[Progress, None, Verification]:
    try:
        while True:
            try:
                progress = next(work)
            except StopIteration as end:
                return end.value
            yield Progress(_READ_SHARE + (1 - _READ_SHARE) * progress.fraction, progress.message)
    finally:
        work.close()


def _entries(found: Verification) -> dict[str, float | int]:
    measured = found.measured
    return dict(zip(KEYS, (measured.error, measured.low, measured.high, measured.places, measured.noise), strict=True))
