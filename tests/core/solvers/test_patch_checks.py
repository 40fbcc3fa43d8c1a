"""The balance of the patches' power: what escapes, what black backs keep, and patches partly inside solids."""

import numpy as np
import pytest
from radiosity.core.lights import PointLight
from radiosity.core.solvers.patch_checks import check_patches

from tests.bakes import Thing, scene_of
from tests.core.solvers.test_patch_solution import solved
from tests.scenes import box, inward_sphere

WHITE = 0.8

#: Balance at an accuracy of 3 %: rays that count both ways leave less than a percent (a third of it here).
BALANCE = 0.01


def holed_sphere(cover=None):
    """A sphere that looks inward with a hole above, a lamp in its middle, and the hole's share of the area.

    `cover` lies over the hole.
    """
    surfaces = inward_sphere(16).surfaces
    triangles = surfaces.triangles
    corners = surfaces.vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    # Whole quads: they lie in the order of the triangles.
    above = corners.mean(axis=1)[:, 2].reshape(-1, 2).min(axis=1).repeat(2) > 0.8
    things = [Thing(surfaces.vertices, triangles[~above], WHITE)]
    if cover is not None:
        things.append(Thing(surfaces.vertices, triangles[above][:, ::-1], WHITE, **cover))
    scene = scene_of(*things, lights=[PointLight(np.zeros(3), np.ones(3))])
    return scene, float(areas[above].sum() / areas.sum())


@pytest.mark.parametrize("seed", [0, 1])
def test_what_leaves_through_a_hole_has_escaped(seed):
    scene, hole = holed_sphere()
    checks = check_patches(solved(scene, 0.03, seed)[0])
    # All points of a sphere see all of it alike, so each bounce loses the same share through the hole.
    expected = WHITE * hole / (1 - WHITE * (1 - hole))
    assert expected > 0.2
    assert checks.light_escaped == pytest.approx(expected, rel=0.03)
    assert checks.light_absorbed == pytest.approx(1 - expected, abs=BALANCE)
    assert checks.energy_balance_error < BALANCE


def test_what_a_black_back_takes_is_absorbed():
    scene, _ = holed_sphere(cover={"two_sided": False})
    checks = check_patches(solved(scene, 0.03)[0])
    assert checks.light_escaped == 0
    assert checks.light_absorbed == pytest.approx(1, abs=BALANCE)
    assert checks.energy_balance_error < BALANCE


@pytest.mark.parametrize("seed", [0, 1])
def test_patches_partly_inside_a_solid_keep_the_balance(seed):
    vertices, faces, _ = box(divisions=4)
    block, sides, _ = box((0.3, 0.3, 0.4), 2)
    # Turned and sunk, so that its sides run across the floor's patches.
    turn = np.array([[np.cos(0.3), np.sin(0.3), 0], [-np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    block = block @ turn + np.array([0.33, 0.36, -0.1])
    lamp = PointLight(np.array([0.2, 0.5, 0.8]), np.ones(3))
    scene = scene_of(Thing(vertices, faces, WHITE), Thing(block, sides[:, ::-1], WHITE), lights=[lamp])
    solution, _ = solved(scene, 0.1, seed)
    count = solution.patches.count
    share = solution.open_areas[:count] / np.where(solution.patches.areas > 0, solution.patches.areas, 1)
    assert ((share > 0) & (share < 1)).any()
    assert solution.enclosed[count:].any()
    checks = check_patches(solution)
    # The block stands through the floor: a crack beside it, as wide as rays start above a surface, lets light out.
    assert checks.light_escaped < 1e-3
    assert checks.light_absorbed == pytest.approx(1, abs=BALANCE)
    assert checks.energy_balance_error < BALANCE


def test_light_that_reaches_nobody_is_an_error_and_nothing_else():
    solution, _ = solved(holed_sphere()[0], 0.03)
    before = check_patches(solution)
    given = solution.given()
    between = solution.irradiance - given
    lost = 0.1 * float((solution.open_areas @ between)[1] / (solution.open_areas @ given)[1])
    # A tenth of what patches send each other never arrives, and they shine as before.
    solution.irradiance = given + np.float32(0.9) * between
    after = check_patches(solution)
    assert after.energy_balance_error == pytest.approx(lost, rel=1e-3)
    assert after.light_absorbed == pytest.approx(before.light_absorbed - lost, abs=1e-4)
    assert after.light_escaped == before.light_escaped
