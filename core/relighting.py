"""Relighting: by what factor each light group of a bake has grown since, where only power and color of lights changed.

Light is linear in its sources: as long as all sources of a group have changed by one factor per channel, so has all the
light that the group gives, and a bake with light groups (`core.light_groups`) is brought up to date by multiplication,
without a ray. Whatever else has changed, shapes, places, reflectances, the picture of the sky, wants a new bake and is
refused by name.

A `LightState` is what a bake must remember for that: digests of all that must not change, and the colors of all
sources. Cost: a pass over the arrays of a scene, some milliseconds for 100,000 triangles. Limits: textures are compared
by their means over triangles, the sky by the means of its rows and columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from hashlib import blake2b

import numpy as np

from .errors import NeedsBakeError
from .lights import Light
from .scene import ReceiverMesh, Scene, Surfaces

#: Relative difference from one factor up to which sources of a group have changed alike: colors are products of a few
#: float32 numbers, and of integrals over the sky.
ALIKE = 1e-4

#: Runs of triangles with one emission that are remembered. Textured emission has one for each triangle.
MOST_RUNS = 20_000

#: What a light calls its color; all else is its shape and place.
_COLORS = ("intensity", "exitance", "irradiance")


@dataclass(frozen=True)
class LightState:
    """Sources of a scene, and what makes the rest of it unmistakable.

    Parameters
    ----------
    shapes, reflectance, receivers : str
        Digests of the surfaces' geometry and transparency, of their reflectance, and of the meshes that receive.
    triangles : int
    lamps : list of (str, str, list)
        Name, digest of shape and place, and color of each lamp.
    suns : list of (str, list)
        The same of suns in the picture of the sky.
    sky : list
        Mean radiance (k, 3) of each row, then of each column of the sky; empty where it is black.
    starts, emission : list
        First triangle and emission (k, 3) of each run of triangles that emit alike, of one object.
    groups : list of str
        Names of the light groups; none where a state is not that of a bake.
    lamp_groups, run_groups : list of int
        Row of `groups` for each lamp and run.
    sky_group : int
    """

    shapes: str
    reflectance: str
    receivers: str
    triangles: int
    lamps: list
    suns: list
    sky: list
    starts: list
    emission: list
    groups: list
    lamp_groups: list
    run_groups: list
    sky_group: int

    def as_dict(self) -> dict:
        """JSON-ready values; `LightState(**values)` is the same state."""
        return asdict(self)


def light_state(scene: Scene, lamp_names: Sequence[str]) -> LightState:
    """The state of a scene whose first lights are the lamps of these names, and the rest suns of the sky.

    Raises
    ------
    NeedsBakeError
        If the emission of surfaces is too varied to be remembered.
    """
    surfaces, groups = scene.surfaces, scene.groups
    count = len(lamp_names)
    starts, emission = _runs(surfaces)
    return LightState(
        shapes=_digest(
            surfaces.vertices,
            surfaces.triangles,
            surfaces.two_sided,
            surfaces.textured,
            surfaces.transmittance[surfaces.palette_of(np.arange(len(surfaces.triangles)))],
        ),
        reflectance=_digest(surfaces.reflectance[surfaces.palette_of(np.arange(len(surfaces.triangles)))]),
        receivers=_digest(*(array for mesh in scene.receivers for array in _arrays_of(mesh))),
        triangles=len(surfaces.triangles),
        lamps=[
            [name, _shape_of(light), light.color.tolist()]
            for name, light in zip(lamp_names, scene.lights[:count], strict=True)
        ],
        suns=[[_shape_of(light), light.color.tolist()] for light in scene.lights[count:]],
        sky=[] if scene.sky_is_dark else _margins(scene.sky.radiance).tolist(),
        starts=starts.tolist(),
        emission=emission.tolist(),
        groups=[] if groups is None else list(groups.names),
        lamp_groups=[] if groups is None else groups.lights[:count].tolist(),
        run_groups=[] if groups is None else groups.objects[surfaces.objects[starts]].tolist(),
        sky_group=0 if groups is None else groups.sky,
    )


def group_factors(before: LightState, after: LightState) -> np.ndarray:
    """Factors (g, 3) by which the light of the groups of the state `before`, of a bake, has changed.

    Raises
    ------
    NeedsBakeError
        If anything else has changed than power and color of lights, each group by one factor.
    """
    for one, other, what in (
        (before.shapes, after.shapes, "Meshes or their places"),
        (before.reflectance, after.reflectance, "Colors of surfaces"),
        (before.receivers, after.receivers, "Meshes that receive light, or their colors,"),
    ):
        if one != other:
            raise NeedsBakeError(f"{what} have changed since the bake: bake again")
    pairs: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in before.groups]
    for group, old, new in zip(before.lamp_groups, *_lamp_colors(before.lamps, after.lamps), strict=True):
        pairs[group].append((old, new))
    if before.sky or before.suns or after.sky or after.suns:
        pairs[before.sky_group] += _sky_colors(before, after)
    for group, old, new in _surface_colors(before, after):
        pairs[group].append((old, new))
    return np.stack([_factor(name, colors) for name, colors in zip(before.groups, pairs, strict=True)])


def _factor(name: str, colors: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(3,) what all sources of a group have changed by."""
    if not colors:
        return np.ones(3)
    old = np.concatenate([np.atleast_2d(each[0]) for each in colors]).astype(float)
    new = np.concatenate([np.atleast_2d(each[1]) for each in colors]).astype(float)
    power = (old**2).sum(axis=0)
    factor = np.where(power > 0, (old * new).sum(axis=0) / np.where(power > 0, power, 1), 1)
    apart = np.abs(new - factor * old).max(axis=0)
    if (apart > ALIKE * np.maximum(new.max(axis=0), (factor * old).max(axis=0))).any():
        raise NeedsBakeError(
            f"Lights of the group {name!r} have changed by different factors, or give a color that they had none of: "
            "bake again"
        )
    return factor


def _lamp_colors(before: list, after: list) -> tuple[list, list]:
    """Colors of all lamps before, and of the same lamps now: black where they have been switched off."""
    now: dict[str, list] = {}
    for name, shape, color in after:
        now.setdefault(name, []).append((shape, color))
    names = [name for name, _shape, _color in before]
    for name, found in now.items():
        if names.count(name) != len(found):
            raise NeedsBakeError(f"The lamp {name!r} was added since the bake: bake again")
    old, new = [], []
    for name, shape, color in before:
        found, there = now[name].pop(0) if name in now else (shape, [0.0, 0.0, 0.0])
        if found != shape:
            raise NeedsBakeError(f"The lamp {name!r} was moved or has another shape since the bake: bake again")
        old.append(np.array(color))
        new.append(np.array(there))
    return old, new


def _sky_colors(before: LightState, after: LightState) -> list[tuple[np.ndarray, np.ndarray]]:
    """Colors of the sky and its suns before and now."""
    is_off = not after.sky and not any(np.any(color) for _shape, color in after.suns)
    shapes = [[shape for shape, _color in state.suns] for state in (before, after)]
    if not is_off and (shapes[0] != shapes[1] or len(before.sky) != len(after.sky)):
        raise NeedsBakeError("The picture of the world has changed since the bake: bake again")
    colors = []
    for old, new in (
        (before.sky, after.sky),
        ([color for _shape, color in before.suns], [color for _shape, color in after.suns]),
    ):
        if old:
            colors.append((np.array(old), np.zeros((len(old), 3)) if is_off else np.array(new)))
    return colors


def _surface_colors(before: LightState, after: LightState) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Group and emission before and now of all runs of triangles that are alike in both."""
    cuts = np.union1d(before.starts, after.starts).astype(int)
    runs = [np.searchsorted(state.starts, cuts, side="right") - 1 for state in (before, after)]
    old, new = (np.array(state.emission).reshape(-1, 3)[run] for state, run in zip((before, after), runs, strict=True))
    lit = np.flatnonzero((old > 0).any(axis=1) | (new > 0).any(axis=1))
    if not (old[lit] > 0).any(axis=1).all():
        raise NeedsBakeError("Surfaces that were dark have begun to glow since the bake: bake again")
    return [(before.run_groups[runs[0][row]], old[row], new[row]) for row in lit]


def _runs(surfaces: Surfaces) -> tuple[np.ndarray, np.ndarray]:
    """First triangle (k,) and emission (k, 3) of runs of triangles of one object that emit alike."""
    worn = surfaces.palette_of(np.arange(len(surfaces.triangles)))
    emission = surfaces.emission[worn].astype(float)
    lit = (emission > 0).any(axis=1)
    change = (np.diff(emission, axis=0) != 0).any(axis=1)
    change |= (lit[1:] | lit[:-1]) & (np.diff(surfaces.objects.astype(np.int64)) != 0)
    starts = np.flatnonzero(np.concatenate([[True], change]))
    if len(starts) > MOST_RUNS:
        raise NeedsBakeError(
            f"Surfaces glow in more than {MOST_RUNS:,} different patches, too varied to be compared: bake again"
        )
    return starts, emission[starts]


def _margins(radiance: np.ndarray) -> np.ndarray:
    """Means (rows + columns, 3) of the rows and of the columns of radiance (rows, columns, 3)."""
    return np.concatenate([radiance.mean(axis=1), radiance.mean(axis=0)]).astype(float)


def _shape_of(light: Light) -> str:
    values = [getattr(light, field.name) for field in fields(light) if field.name not in _COLORS]
    return type(light).__name__ + " " + _digest(*(np.asarray(value, dtype=float) for value in values))


def _arrays_of(mesh: ReceiverMesh) -> list[np.ndarray]:
    """What of a mesh decides its light, its emission apart."""
    arrays = [
        mesh.positions,
        mesh.corner_vertices,
        mesh.face_offsets,
        mesh.face_materials,
        mesh.corner_normals,
        mesh.vertex_normals,
        mesh.palette_reflectance,
        mesh.corner_reflectance,
    ]
    return [array for array in arrays if array is not None]


def _digest(*arrays: np.ndarray) -> str:
    digest = blake2b(digest_size=16)
    for array in arrays:
        digest.update(str((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8))
    return digest.hexdigest()
