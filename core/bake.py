"""The whole pipeline: read arrays in, light at every corner out, as a generator of `Progress`.

Discretise, find what each patch sees, solve, gather at the receivers (the four steps of the survey's figure 4). Nothing
is written anywhere: whoever runs the generator writes, once it has ended.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from .bake_plan import BakePlan, foreseen_memory, plan_for
from .baked_mesh import BakedMesh, baked_meshes, receiver_warnings
from .cleaning import clean, compacted
from .discretization.merging import merge_coplanar
from .discretization.patch_colors import patch_colors
from .discretization.patch_polygons import PatchPolygons
from .discretization.patches import POINTS, Patches, build_patches, probe_segments, split_cells
from .errors import EmptySceneError, NoEmittersError, SceneTooLargeError, SettingsError
from .form_factors.cached_hemispheres import HitTable, WallSides, gather
from .gathering.indirect_light import indirect_light, uncut_edges
from .gathering.misplaced import mend_misplaced
from .gathering.placing import place_receivers
from .gathering.probe import probe_error
from .gathering.walled_off import find_walled_off
from .keys import row_keys
from .light_groups import BANDS, joined, shared_out, spread
from .lights.direct_light import direct_light
from .lights.emissive import grouped_area_lights
from .matrix_plan import FACTOR_SHARE, check_size, check_surfaces, chosen_names, has_name, matrix_plan
from .progress import Progress, finish, shared_progress
from .scene import Scene, Surfaces
from .settings import BakeSettings
from .solvers.matrix_checks import check_matrix, matrix_statistics, matrix_warnings
from .solvers.matrix_solution import MatrixSolution
from .solvers.patch_checks import check_patches
from .solvers.patch_solution import PatchSolution
from .visibility.embree import CHUNK_RAYS, Frame, RayPool, Tracer

#: Cells to which something stands nearer than this many of their sides are split: light changes over that distance.
NEAR = 1.0

#: Rays per sample point that measure how near.
PROBE_RAYS = 8


@dataclass(frozen=True)
class BakeResult:
    """What a bake gives back.

    `meshes` are in the order of `Scene.receivers`. `statistics` holds JSON-ready numbers: counts of patches, receivers
    and lights, rays, seconds per stage, converged, iterations, light_absorbed, energy_balance_error, closure_error_max,
    reciprocity_error_max, estimated_error. `groups` are the meshes once more for each light group of the scene, by its
    name: with the light of that group alone. Over all groups that adds up to the light of `meshes`.
    """

    meshes: list[BakedMesh]
    statistics: dict
    warnings: list[str] = field(default_factory=list)
    groups: dict[str, list[BakedMesh]] = field(default_factory=dict)


class _Clock:
    """Seconds per stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.started = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self.started


@dataclass
class _Model:
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


def bake_steps(scene: Scene, settings: BakeSettings) -> Generator[Progress, None, BakeResult]:
    """Bake in steps of some tens of milliseconds; the generator's return value is the result.

    Raises
    ------
    EmptySceneError
        Nothing to light.
    NoEmittersError
        Nothing emits light.
    SceneTooLargeError
        More memory foreseen than allowed, or too many polygons for the method chosen by name.
    SettingsError
        The method or solver chosen by name cannot serve the scene.
    MissingRayEngineError
        embreex cannot be imported.
    """
    clock = _Clock()
    plan = plan_for(settings.accuracy)
    if has_name(settings):
        plan = matrix_plan(plan, settings.accuracy)
    yield Progress(0.0, "Preparing surfaces")
    with clock.stage("prepare"):
        cleaned = clean(scene.surfaces)
        _check(scene, cleaned.surfaces, plan, settings)
        warnings, triangles = [*scene.warnings, *cleaned.warnings], len(scene.surfaces.triangles)
        frame = Frame.around(np.asarray(cleaned.surfaces.vertices, dtype=np.float64))
        surfaces = replace(cleaned.surfaces, vertices=_moved(cleaned.surfaces.vertices, frame))
        meshes = [replace(mesh, positions=frame.to_unit(mesh.positions)) for mesh in scene.receivers]
        # Which rows they were is what shaders ask.
        rows = None if surfaces.shader is None else cleaned.rows
        # Nothing is held any longer than it serves: what was read is by far the largest.
        scene = replace(scene, surfaces=None, receivers=())
        del cleaned
    with RayPool(settings.threads) as pool:
        yield Progress(0.01, "Preparing surfaces to trace")
        with clock.stage("trace mesh"):
            model = _build_model(surfaces, frame, rows, scene, plan, settings, pool)
        del surfaces, rows
        yield Progress(0.05, "Preparing receivers")
        with clock.stage("receivers"):
            receivers = place_receivers(meshes, model.tracer, pool)
            walled = find_walled_off(model.tracer, meshes, receivers, model.patches.spacing, pool)
            stored = [(mesh.without_geometry(), len(mesh.positions)) for mesh in meshes]
            del meshes
        if not len(receivers):
            raise EmptySceneError("No usable vertex to light: all receiving meshes are empty or broken")
        solution = _patch_solution(model, scene, plan, settings, pool)
        with clock.stage("patches"):
            message = f"Form factors by {settings.method}" if has_name(settings) else "Solving patches"
            yield from _told(solution.solve(), 0.1, 0.3, message)
        with clock.stage("direct light"):
            work = direct_light(
                model.tracer,
                model.lights,
                receivers.points,
                receivers.normals,
                receivers.edges,
                plan.penumbra_rays,
                pool,
                settings.seed,
                colors=model.light_colors,
            )
            direct, rays = yield from _told(work, 0.3, 0.6, "Direct light")
        yield Progress(0.6, "Indirect light")
        with clock.stage("indirect light"):
            free = uncut_edges(model.tracer, receivers, pool)
            deadline = clock.started + settings.time_limit if settings.time_limit else inf
            work = indirect_light(
                solution, receivers, receivers.edges[free], direct, plan.indirect, settings.seed, deadline
            )
            indirect = yield from _told(work, 0.6, 0.95, "Indirect light")
        with clock.stage("fill"):
            light = joined(direct, indirect.irradiance)
            del direct
            indirect = replace(indirect, irradiance=None)  # it is in `light` now
            work = mend_misplaced(
                solution, receivers, walled, [mesh for mesh, _ in stored], light, indirect.buried, plan, settings.seed
            )
            light, mended = yield from _told(work, 0.95, 0.97, "Buried vertices")
        yield Progress(0.97, "Estimating the error")
        with clock.stage("estimate"):
            error, probe_rays = probe_error(solution, receivers, light, indirect, mended.moved, plan, settings.seed)
        light = shared_out(light)
    rays += len(receivers.edges) + solution.rays_traced + indirect.rays + probe_rays + mended.rays
    statistics = _statistics(triangles, model, receivers, solution, indirect, rays, error, clock)
    meshes, groups = baked_meshes(stored, receivers.corner_receivers, light, mended.buried, scene.groups)
    warnings += receiver_warnings(meshes)
    if isinstance(solution, MatrixSolution):
        warnings += matrix_warnings(solution)
    if indirect.is_cut_short:
        warnings.append(
            f"The time limit of {settings.time_limit:g} s ended refinement early: the estimated error is {error:.1%}"
        )
    return BakeResult(meshes, statistics, warnings, groups)


def _check(scene: Scene, surfaces: Surfaces, plan: BakePlan, settings: BakeSettings) -> None:
    if not len(scene.receivers) or not any(len(mesh.corner_vertices) for mesh in scene.receivers):
        raise EmptySceneError("No mesh with faces to bake: select one, or add faces to it")
    if not len(surfaces.triangles):
        raise EmptySceneError("No usable face in the scene: all are without area or have broken vertices")
    dark = not surfaces.wearing(surfaces.emission.any(axis=1)).any() and scene.sky_is_dark
    if dark and not any(np.any(light.power > 0) for light in scene.lights):
        raise NoEmittersError(
            "Nothing in the scene emits light: add a lamp, give a material an emission strength above 0, or light the "
            "world (World properties, or --world-strength 1 on the command line)"
        )
    check_surfaces(surfaces, settings)
    if scene.groups is not None and has_name(settings):
        raise SettingsError(
            f"Light groups are not kept by {chosen_names(settings)}: choose method and solver auto, or no light groups"
        )
    corners = sum(len(mesh.corner_vertices) for mesh in scene.receivers)
    groups = 0 if scene.groups is None else len(scene.groups.names)
    needed = foreseen_memory(len(surfaces.triangles), corners, plan, groups)
    if settings.memory_limit and needed > settings.memory_limit:
        raise SceneTooLargeError(
            f"Baking {corners:,} corners among {len(surfaces.triangles):,} triangles would take about "
            f"{needed / 1e6:,.0f} MB, and the limit is {settings.memory_limit / 1e6:,.0f} MB: select fewer objects or "
            "raise the limit"
        )


def _moved(vertices: np.ndarray, frame: Frame) -> np.ndarray:
    """(n, 3) float64 vertices in the unit frame."""
    moved = vertices - frame.center
    moved /= frame.size
    return moved


def _build_model(
    surfaces: Surfaces,
    frame: Frame,
    rows: np.ndarray | None,
    scene: Scene,
    plan: BakePlan,
    settings: BakeSettings,
    pool: RayPool,
) -> _Model:
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
    patches = build_patches(corners, triangles, looks[source], plan.patches)
    cells, starts, segments = probe_segments(patches, corners, triangles)
    crossed = _crossed(tracer, starts, segments, pool)
    nearness = _nearness(tracer, patches, cells, pool)
    urgent = np.lexsort((nearness, ~crossed))
    urgent = urgent[crossed[urgent] | (nearness[urgent] < NEAR)]
    whole = patches.count
    patches = split_cells(patches, corners, triangles, cells[urgent], plan.patches)
    # Parts that a wall still crosses are split once more: they alone would carry light to its other side.
    cells, starts, segments = probe_segments(patches, corners, triangles, whole)
    crossed = _crossed(tracer, starts, segments, pool)
    patches = split_cells(patches, corners, triangles, cells[crossed], plan.patches)
    check_size(patches, settings)
    cells, starts, segments = probe_segments(patches, corners, triangles)
    walled = np.zeros(patches.count, bool)
    walled[cells[_crossed(tracer, starts, segments, pool)]] = True
    # Only next to small patches is it sure that what lies aside is on the same side.
    walled &= np.sqrt(patches.areas) < 0.5 * patches.spacing
    reflectance, emission = patch_colors(patches, corners, triangles, surfaces, source, rows, sampled)
    return _Model(
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


def _crossed(tracer: Tracer, starts: np.ndarray, segments: np.ndarray, pool: RayPool) -> np.ndarray:
    """(n,) bool: whether anything crosses one of the segments (n, s, 3) of each row."""
    count, each = starts.shape[:2]
    seen = np.ones((count, each), bool)

    def work(start: int, stop: int) -> None:
        begin = starts[start:stop].reshape(-1, 3).astype(np.float32)
        passed = tracer.visibility(begin, segments[start:stop].reshape(-1, 3).astype(np.float32), 1.0)
        seen[start:stop] = passed.reshape(-1, each) > 0

    pool.run(work, count, CHUNK_RAYS // each)
    return ~seen.all(axis=1)


def _nearness(tracer: Tracer, patches: Patches, cells: np.ndarray, pool: RayPool) -> np.ndarray:
    """(n,) harmonic mean distance to what stands around each cell, in sides of the cell."""
    points, normals = patches.points[cells].reshape(-1, 3), patches.normals[cells].reshape(-1, 3)
    nowhere = HitTable(patches, np.zeros(len(patches.first), bool), None)
    seen = finish(gather(tracer, nowhere, points, normals, PROBE_RAYS, pool))
    distances = 1 / (1 / seen.distances).reshape(-1, POINTS).mean(axis=1)
    return distances / np.sqrt(patches.areas[cells])


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


def _patch_solution(
    model: _Model, scene: Scene, plan: BakePlan, settings: BakeSettings, pool: RayPool
) -> PatchSolution:
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


def _told(work: Generator, low: float, high: float, message: str) -> Generator[Progress, None, object]:
    """Progress of `work` within [low, high], with a message that comes before it; its result is returned."""
    yield Progress(low, message)
    work = shared_progress(work, low, high)
    while True:
        try:
            fraction = next(work)
        except StopIteration as end:
            return end.value
        yield Progress(fraction, message)


def _statistics(triangles, model, receivers, solution, indirect, rays, error, clock) -> dict:
    is_matrix = isinstance(solution, MatrixSolution)
    checks = check_matrix(solution) if is_matrix else check_patches(solution)
    return {
        "method": "auto",
        "solver": "auto",
        **(matrix_statistics(solution) if is_matrix else {}),
        "triangles": triangles,
        "traced_triangles": len(model.black_back),
        "patches": int((model.patches.areas > 0).sum()),
        "elements": len(receivers),
        "receivers": len(receivers),
        "buried_receivers": int(indirect.buried.sum()),
        "nodes": indirect.nodes,
        "lights": len(model.lights),
        "rays": int(rays),
        "converged": solution.converged and not indirect.is_cut_short,
        "iterations": solution.sweeps,
        "residual": solution.residual,
        "light_absorbed": checks.light_absorbed,
        "light_escaped": checks.light_escaped,
        "energy_balance_error": checks.energy_balance_error,
        "closure_error_max": checks.closure_error_max,
        "reciprocity_error_max": checks.reciprocity_error_max,
        "estimated_error": error,
        "seconds": {**{k: round(v, 4) for k, v in clock.seconds.items()}, "total": round(clock.elapsed, 4)},
    }
