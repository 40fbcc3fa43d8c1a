"""A bake's scene made ready: moved to the unit frame, merged for rays, divided into patches, with its lights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .bake_plan import BakePlan
from .cleaning import compacted
from .discretization.merging import merge_coplanar
from .discretization.patch_colors import patch_colors
from .discretization.patch_polygons import PatchPolygons
from .discretization.patches import Patches
from .dividing import divided_patches
from .form_factors.cached_hemispheres import HitTable, WallSides
from .keys import row_keys
from .light_groups import BANDS, spread
from .lights.emissive import grouped_area_lights
from .matrix_plan import FACTOR_SHARE, check_size, has_name
from .scene import Scene, Surfaces
from .settings import BakeSettings
from .solvers.matrix_solution import MatrixSolution
from .solvers.patch_solution import PatchSolution
from .visibility.embree import Frame, RayPool, Tracer


@dataclass
class BakeModel:
    """The scene in the unit frame, ready for rays."""

    frame: Frame
    tracer: Tracer
    patches: Patches
    reflectance: np.ndarray
    emission: np.ndarray  # (P, c)
    two_sided: np.ndarray
    black_back: np.ndarray
    sides: WallSides | None
    lights: list
    light_colors: np.ndarray  # (L, c)
    polygons: PatchPolygons | None


def in_unit_frame(surfaces: Surfaces, frame: Frame) -> Surfaces:
    """The surfaces with float64 vertices in the unit frame."""
    vertices = surfaces.vertices - frame.center
    vertices /= frame.size
    return replace(surfaces, vertices=vertices)


def build_model(
    surfaces: Surfaces,
    frame: Frame,
    rows: np.ndarray | None,
    scene: Scene,
    plan: BakePlan,
    settings: BakeSettings,
    pool: RayPool,
) -> BakeModel:
    """The model of surfaces in the unit frame; `rows` (m,) are theirs in the surfaces that the shader knows."""
    groups = scene.groups
    count = 0 if groups is None else len(groups.names)
    owners = np.zeros(len(surfaces.triangles), int) if groups is None else groups.objects[surfaces.objects]
    looks = _looks(surfaces, owners)
    merged = merge_coplanar(surfaces.vertices, surfaces.triangles, looks)
    source = merged.source
    worn = surfaces.palette_of(source)
    corners, triangles = compacted(merged.vertices, merged.triangles)
    two_sided = surfaces.two_sided[source]
    bright = [row for row, light in enumerate(scene.lights) if np.any(light.power > 0)]
    lamps = [scene.lights[row].in_frame(frame.center, frame.size) for row in bright]
    # In the unit frame, where a sun's flux is that through one unit of area whatever the scene's size.
    lamp_power = sum(float(light.power.max()) for light in lamps)
    shining, sampled, members = grouped_area_lights(
        corners, triangles, surfaces.emission[worn], two_sided, lamp_power, owners[source]
    )
    lights = [*lamps, *shining]
    if groups is not None:
        members = np.concatenate([np.asarray(groups.lights, dtype=int)[bright], members])
    light_colors = spread(np.array([light.color for light in lights]).reshape(-1, BANDS), members, count)
    tracer = Tracer.build(corners.astype(np.float32), triangles, surfaces.transmittance[worn])
    patches, walled = divided_patches(
        tracer, lights, corners, triangles, looks[source], plan.patches, pool, settings.seed
    )
    check_size(patches, settings)
    reflectance, emission = patch_colors(patches, corners, triangles, surfaces, source, rows, sampled)
    return BakeModel(
        frame=frame,
        tracer=tracer,
        patches=patches,
        reflectance=reflectance,
        emission=spread(emission, owners[source[patches.point_triangles[:, 0]]], count),
        two_sided=two_sided[patches.point_triangles[:, 0]],
        black_back=~two_sided,
        sides=WallSides.of(walled, corners[triangles], patches.areas) if walled.any() else None,
        lights=lights,
        light_colors=light_colors,
        polygons=PatchPolygons.of(patches, corners, triangles) if has_name(settings) else None,
    )


def patch_solution_of(
    model: BakeModel, scene: Scene, plan: BakePlan, settings: BakeSettings, pool: RayPool
) -> PatchSolution:
    """The patch solution of a model, not solved yet; that of a full matrix where a method or solver has been named."""
    # A method knows no two sides of a patch.
    sides = model.sides if settings.method == "auto" else None
    sky = None if scene.sky_is_dark else scene.sky
    sky_columns = (0,) if scene.groups is None else (0, BANDS * (1 + scene.groups.sky))
    parts = dict(
        tracer=model.tracer,
        hits_to_rows=HitTable(model.patches, model.black_back, sky, sides, sky_columns),
        lights=model.lights,
        light_colors=model.light_colors,
        reflectance=model.reflectance,
        emission=model.emission,
        two_sided=model.two_sided,
        rays=plan.patch_rays,
        penumbra_rays=plan.penumbra_rays,
        pool=pool,
        seed=settings.seed,
        tolerance=plan.tolerance,
        detail=plan.patch_detail,
    )
    if not has_name(settings):
        return PatchSolution(**parts)
    return MatrixSolution(
        **parts,
        polygons=model.polygons,
        crossed=np.zeros(model.patches.count, bool) if model.sides is None else model.sides.crossed,
        method=settings.method,
        solver=settings.solver,
        factor_accuracy=FACTOR_SHARE * settings.accuracy,
        light_accuracy=settings.accuracy,
    )


def _looks(surfaces: Surfaces, groups: np.ndarray) -> np.ndarray:
    """Numbers (m,) that are equal where triangles, of light groups (m,), may be merged."""
    # Textured emission and transparency are means over one triangle each, so those triangles stay as they are.
    shining = (surfaces.emission > 0).any(axis=1) | (surfaces.transmittance > 0)
    single = surfaces.textured & surfaces.wearing(shining)
    alone = np.where(single, np.arange(1, len(single) + 1, dtype=np.int32), np.int32(0))
    different, looks = np.unique(row_keys(surfaces.materials, surfaces.two_sided, alone), return_inverse=True)
    # What shines is of one group. The order stays: a scene whose groups differ in looks anyway gets the same numbers.
    different, looks = np.unique(
        looks.reshape(-1) * (int(groups.max(initial=0)) + 1) + groups * surfaces.wearing(shining), return_inverse=True
    )
    return looks.reshape(-1).astype(np.min_scalar_type(len(different)))
