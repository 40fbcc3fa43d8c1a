"""The solved patches: against the same system solved another way, power, backs, and buried points."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.gathering.indirect_light import uncut_edges
from radiosity.core.gathering.receivers import build_receivers
from radiosity.core.lights import PointLight
from radiosity.core.solvers.patch_checks import check_patches
from radiosity.core.solvers.reciprocity import SeenRows
from radiosity.core.visibility.embree import RayPool

from tests.bakes import Thing, scene_of, solved_patches
from tests.scenes import box, cornell_box, furnace_box, grid, inward_sphere


def dense_of(matrix):
    """(m, m) float64 of a sparse matrix."""
    out = np.zeros((matrix.size, matrix.size))
    for part in matrix.slices:
        np.add.at(out, (part.rows[:, None], part.columns), part.weights.astype(float))
    return out


def dense_factors(batches, areas, is_open):
    """Form factors (m, m) of rays that count both ways, by dense matrices: the balance heuristic, the damped scaling,
    and rows that sum to what their own rays have met."""
    size = len(areas)
    counts, rays, surface = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    for batch in batches:
        kept, every = batch.kept, batch.seen.shape[1]
        patch = np.repeat(batch.rows, kept.shape[1])[kept.ravel()]
        origin, target = np.repeat(patch, every), batch.seen[kept.ravel()].ravel()
        met = target < size
        np.add.at(counts, (origin[met], target[met]), 1.0)
        np.add.at(rays, patch, every)
        surface[batch.rows] = areas[batch.rows] * kept.mean(axis=1)
    is_open = is_open & (rays > 0)
    mutual = is_open[:, None] & is_open[None]
    density = np.where(is_open, rays / np.where(surface > 0, surface, 1), 1)
    exchange = np.where(mutual, (counts + counts.T) / (density[:, None] + density[None]), 0)
    wanted = (counts * mutual).sum(axis=1) / density
    scale = np.ones(size)
    for _ in range(3):
        found = scale * (exchange @ scale)
        step = np.sqrt(wanted / np.where(found > 0, found, 1))
        scale = np.where((found > 0) & (wanted > 0), np.clip(scale * step, 0.25, 4), scale)
    found = exchange @ scale
    stretch = wanted / np.where(found > 0, found, 1) / np.where(surface > 0, surface, 1)
    own = counts / np.where(rays > 0, rays, 1)[:, None]
    return np.where(mutual, stretch[:, None] * exchange * scale, own)


def fixed_point(solution, sweeps=2000):
    """Radiosity (2P, 3) by plain sweeps of the same rays in float64, with the same points left out and both ways."""
    radiosity = solution.emitted.astype(float)
    rho = solution.reflectances.astype(float)
    sides = list(solution.gathered_sides())
    areas = np.tile(solution.patches.areas, 2)
    batches = [SeenRows(rows, seen.rows, kept) for rows, _, seen, kept in sides]
    factors = dense_factors(batches, areas, ~solution.enclosed)
    sky = solution.table()[:, :3].astype(float)
    sky[: len(radiosity)] = 0
    given = np.zeros_like(radiosity)
    for rows, direct, seen, kept in sides:
        gathered = sky[seen.rows].mean(axis=1).reshape(*kept.shape, 3) + direct
        given[rows] = np.einsum("npk,np->nk", gathered, kept / kept.sum(axis=1, keepdims=True))
    for _ in range(sweeps):
        image = solution.emitted + rho * (given + factors @ radiosity)
        if np.abs(image - radiosity).max() < 1e-10 * np.abs(image).max():
            return image
        radiosity = image
    return radiosity


@pytest.mark.parametrize("make", [cornell_box, lambda: furnace_box(reflectance=0.9)], ids=["cornell", "furnace"])
def test_accelerated_solution_is_the_fixed_point_of_plain_sweeps(make):
    solution, _ = solved_patches(make())
    exact = fixed_point(solution)
    areas = np.tile(solution.patches.areas, 2)[:, None]
    error = np.sqrt((areas * (solution.radiosity - exact) ** 2).sum() / (areas * exact**2).sum())
    assert solution.converged
    # A change below the tolerance leaves at most rho / (1 - rho) times it undone.
    assert error < 10 * solution.tolerance
    assert solution.residual <= solution.tolerance
    assert solution.sweeps < 30, "plain sweeps need a hundred at a reflectance of 0.9"


def test_nearly_perfect_reflectance_converges():
    solution, _ = solved_patches(furnace_box(reflectance=0.999))
    assert solution.converged
    fronts = solution.radiosity[: solution.patches.count][solution.patches.areas > 0]
    # The published furnace's fine level.
    np.testing.assert_allclose(fronts, 1000, rtol=0.02)


def test_sphere_of_many_colors_has_even_irradiance():
    scene = inward_sphere(16)
    generator = np.random.default_rng(0)
    surfaces = replace(
        scene.surfaces,
        reflectance=generator.uniform(0.1, 0.9, scene.surfaces.reflectance.shape),
        emission=generator.uniform(0.5, 1.5, scene.surfaces.emission.shape),
    )
    surfaces = replace(surfaces, materials=np.arange(len(surfaces.triangles), dtype=np.int32))
    # All emit about alike, so all is left to the hemispheres: one look of emission would be a light.
    surfaces.emission[:] = 1.0
    solution, _ = solved_patches(replace(scene, surfaces=surfaces), 0.03)
    corners = surfaces.vertices[surfaces.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    expected = 1 / (1 - areas @ surfaces.reflectance / areas.sum())
    fronts = solution.irradiance[: solution.patches.count]
    weights = solution.patches.areas / solution.patches.areas.sum()
    np.testing.assert_allclose(weights @ fronts, expected, rtol=3e-3)
    # 128 rays on patches whose radiosity varies by a fifth: 2 % of noise at most.
    assert (fronts.std(axis=0) / expected).max() < 0.03


def test_closed_room_keeps_the_balance_and_open_one_lets_go():
    closed = check_patches(solved_patches(cornell_box())[0])
    assert closed.light_escaped == 0
    assert closed.light_absorbed == pytest.approx(1, abs=0.02)
    # Factors are float32, and their roundings mostly cancel in a group.
    assert closed.closure_error_max < 1e-7
    assert closed.reciprocity_error_max < 0.1
    vertices, faces, sides = box(divisions=4)
    lamp = PointLight(np.full(3, 0.5), np.ones(3))
    opened = check_patches(solved_patches(scene_of(Thing(vertices, faces[sides != 5], 0.5), lights=[lamp]))[0])
    assert 0.05 < opened.light_escaped < 0.6
    assert opened.light_absorbed + opened.light_escaped == pytest.approx(1, abs=0.02)
    assert opened.energy_balance_error < 0.02


def test_backs_are_worked_on_only_where_they_are_met():
    room, _ = solved_patches(cornell_box())
    count = room.patches.count
    assert room.active[:count][room.patches.areas > 0].all()
    # Blocks stand open on the floor: its points below them meet their inside; nothing meets the room's outside.
    outside = np.abs(room.patches.points[:, 0]).max(axis=1) > 0.5 - 1e-6
    assert not room.active[count:][outside].any()
    plate = Thing(*grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], 1, 1))
    alone, _ = solved_patches(scene_of(plate, lights=[PointLight(np.array([0, 0, 1.0]), np.ones(3))]))
    assert not alone.active[alone.patches.count :].any()


def test_one_sided_backs_reflect_nothing():
    floor = Thing(*grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], 2, 2), 0.5)
    lid = [(-1, -1, 0.5), (1, -1, 0.5), (1, 1, 0.5), (-1, 1, 0.5)]
    lamp = PointLight(np.array([0, 0, 0.2]), np.ones(3))
    values = []
    for two_sided in (True, False):
        scene = scene_of(floor, Thing(*grid(lid, 2, 2), 0.5, two_sided=two_sided), lights=[lamp])
        solution, _ = solved_patches(scene)
        below = (solution.patches.points[:, 0, 2] < 0) & (solution.patches.areas > 0)
        direct = np.zeros(2 * solution.patches.count)
        for rows, light, _, kept in solution.gathered_sides():
            direct[rows] = (light.mean(axis=2) * kept).sum(axis=1) / kept.sum(axis=1)
        indirect = solution.irradiance.mean(axis=1) - direct
        values.append(indirect[: solution.patches.count][below].mean())
    assert values[0] > 0.1 * values[1] + 0.01
    assert values[1] == pytest.approx(0, abs=1e-6)


def test_patches_under_a_block_are_buried_and_those_beside_it_are_not():
    floor = Thing(*grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], 1, 1))
    vertices, faces, _ = box((0.6, 0.6, 0.6), 1)
    block = Thing(vertices - np.array([0.3, 0.3, 0.0]), faces[:, ::-1])
    lamp = PointLight(np.array([0.2, 0.1, 1.5]), np.full(3, 3.0))
    solution, model = solved_patches(scene_of(floor, block, lights=[lamp]))
    points = model.frame.size * solution.patches.points + model.frame.center
    on_floor = (np.abs(points[..., 2]) < 1e-6).all(axis=1) & (solution.patches.areas > 0)
    on_floor &= solution.patches.normals[:, 0, 2] > 0  # the block's bottom lies there too
    inside = on_floor & (np.abs(points[..., :2]) < 0.29).all(axis=(1, 2))
    beside = on_floor & (np.abs(points[..., :2]) > 0.31).any(axis=2).all(axis=1)
    buried = solution.buried[: solution.patches.count]
    assert inside.sum() > 10
    assert not buried[beside].any()
    assert buried[inside].all()


@pytest.mark.parametrize("gap", [0.0, 0.05])
def test_mesh_edges_that_cross_a_wall_are_cut(gap):
    floor = Thing(*grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 9, 9))
    wall = Thing(np.array([(0.51, 0, gap), (0.51, 1, gap), (0.51, 1, 0.5), (0.51, 0, 0.5)]), np.array([[0, 1, 2, 3]]))
    scene = scene_of(floor, replace(wall, receives=False), lights=[PointLight(np.array([0.2, 0.5, 0.4]), np.ones(3))])
    _, model = solved_patches(scene)
    receivers = build_receivers(scene.receivers, model.frame)
    with RayPool(1) as pool:
        free = uncut_edges(model.tracer, receivers, pool)
    ends = model.frame.size * receivers.points[receivers.edges][..., 0] + model.frame.center[0]
    crossing = (ends.min(axis=1) < 0.51) & (ends.max(axis=1) > 0.51)
    assert crossing.sum() == 10
    # A wall that floats above the floor leaves the light on both sides alike.
    np.testing.assert_array_equal(free, ~crossing if gap == 0 else np.ones(len(free), bool))
