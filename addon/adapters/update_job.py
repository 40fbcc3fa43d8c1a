"""Bringing a bake with light groups up to date after power or color of lights were changed: no ray is traced.

A bake with light groups leaves with the scene what its lights were, and digests of all else. An update reads the scene
again, and where only lights have changed, multiplies their groups. The groups' own attributes stay as they were baked,
so that a lamp that was switched off can come back; what they have changed by goes into the sum beside the mix.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.errors import NeedsBakeError
from ...core.relighting import LightState, group_factors, light_state
from .group_mix import relight, write_mix
from .preview_material import artist_materials
from .scene_reader import SceneReading, read_scene

#: Custom property of a scene: JSON with the state of its lights at the last bake with light groups.
STATE_KEY = "radiosity_light_state"


@dataclass(frozen=True)
class Updated:
    """How many light groups have changed, and how many meshes were written."""

    groups: int
    meshes: int


def baked_state(reading: SceneReading, world_strength: float | None) -> dict | None:
    """What an update will have to know, JSON-ready; None for a scene without light groups."""
    if reading.scene.groups is None:
        return None
    known = {"targets": list(reading.targets), "world_strength": world_strength}
    try:
        return {**known, "state": light_state(reading.scene, reading.lamps).as_dict()}
    except NeedsBakeError as error:
        return {**known, "refusal": str(error)}


def store_state(scene: bpy.types.Scene, state: dict | None) -> None:
    """Keep the state of the lights of a bake with its scene, or forget the one before."""
    if state is not None:
        scene[STATE_KEY] = json.dumps(state)
    elif STATE_KEY in scene:
        del scene[STATE_KEY]


def update_lights(context: bpy.types.Context) -> Updated:
    """Bring the baked light of a scene up to date with the power and color of its lights.

    Raises
    ------
    RadiosityError
        If there are no light groups, or if anything else has changed; then nothing was changed.
    """
    scene = context.scene
    text = scene.get(STATE_KEY)
    if text is None:
        raise NeedsBakeError("Without light groups every change wants a new bake: bake with light groups, then update")
    baked = json.loads(text)
    if "refusal" in baked:
        raise NeedsBakeError(baked["refusal"])
    before = LightState(**baked["state"])
    receivers = _receivers(context, baked["targets"])
    with artist_materials(scene.objects):
        reading = read_scene(context, receivers, baked["world_strength"])
    factors = group_factors(before, light_state(reading.scene, reading.lamps))
    former = relight(scene, dict(zip(before.groups, factors, strict=True)))
    try:
        meshes = write_mix(scene)
    except BaseException:
        relight(scene, former)
        raise
    changed = sum(
        not np.allclose(factor, former[name], rtol=1e-6, atol=0)  # they are kept as float32
        for name, factor in zip(before.groups, factors, strict=True)
    )
    return Updated(changed, meshes)


def _receivers(context: bpy.types.Context, names: Sequence[str]) -> list[bpy.types.Object]:
    objects = context.view_layer.objects
    missing = [name for name in names if name not in objects]
    if missing:
        raise NeedsBakeError(f"Object {missing[0]!r} is gone since the bake: bake again")
    return [objects[name] for name in names]
