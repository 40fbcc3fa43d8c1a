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

from .bake_model import build_model, in_unit_frame, patch_solution_of
from .bake_plan import BakePlan, foreseen_memory, plan_for
from .baked_mesh import BakedMesh, baked_meshes, receiver_warnings
from .cleaning import clean
from .errors import EmptySceneError, NoEmittersError, SceneTooLargeError, SettingsError
from .gathering.indirect_light import indirect_light, uncut_edges
from .gathering.misplaced import mend_misplaced
from .gathering.placing import place_receivers
from .gathering.probe import probe_error
from .gathering.walled_off import find_walled_off
from .light_groups import joined, shared_out
from .lights.direct_light import direct_light
from .matrix_plan import check_surfaces, chosen_names, has_name, matrix_plan
from .progress import Progress, shared_progress
from .scene import Scene, Surfaces
from .settings import BakeSettings
from .solvers.matrix_checks import check_matrix, matrix_statistics, matrix_warnings
from .solvers.matrix_solution import MatrixSolution
from .solvers.patch_checks import check_patches
from .visibility.embree import Frame, RayPool


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
        surfaces = in_unit_frame(cleaned.surfaces, frame)
        meshes = [replace(mesh, positions=frame.to_unit(mesh.positions)) for mesh in scene.receivers]
        # Which rows they were is what shaders ask.
        rows = None if surfaces.shader is None else cleaned.rows
        # Nothing is held any longer than it serves: what was read is by far the largest.
        scene = replace(scene, surfaces=None, receivers=())
        del cleaned
    with RayPool(settings.threads) as pool:
        yield Progress(0.01, "Preparing surfaces to trace")
        with clock.stage("trace mesh"):
            model = build_model(surfaces, frame, rows, scene, plan, settings, pool)
        del surfaces, rows
        yield Progress(0.05, "Preparing receivers")
        with clock.stage("receivers"):
            receivers = place_receivers(meshes, model.tracer, pool)
            walled = find_walled_off(model.tracer, meshes, receivers, model.patches.spacing, pool)
            stored = [(mesh.without_geometry(), len(mesh.positions)) for mesh in meshes]
            del meshes
        if not len(receivers):
            raise EmptySceneError("No usable vertex to light: all receiving meshes are empty or broken")
        solution = patch_solution_of(model, scene, plan, settings, pool)
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
