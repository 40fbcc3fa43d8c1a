"""The balance of the patches' power: what escapes, what black backs keep, and patches partly inside solids."""

import numpy as np
import pytest
from radiosity.core import dividing
from radiosity.core.lights import PointLight
from radiosity.core.progress import finish
from radiosity.core.solvers.patch_checks import LUMINANCE, check_patches

from tests.bakes import Thing, scene_of, solved_patches
from tests.core.solvers.test_patch_solution import dense_of
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
    checks = check_patches(solved_patches(scene, 0.03, seed=seed)[0])
    # All points of a sphere see all of it alike, so each bounce loses the same share through the hole.
    expected = WHITE * hole / (1 - WHITE * (1 - hole))
    assert expected > 0.2
    assert checks.light_escaped == pytest.approx(expected, rel=0.03)
    assert checks.light_absorbed == pytest.approx(1 - expected, abs=BALANCE)
    assert checks.energy_balance_error < BALANCE


def test_what_a_black_back_takes_is_absorbed():
    scene, _ = holed_sphere(cover={"two_sided": False})
    checks = check_patches(solved_patches(scene, 0.03)[0])
    assert checks.light_escaped == 0
    assert checks.light_absorbed == pytest.approx(1, abs=BALANCE)
    assert checks.energy_balance_error < BALANCE


def astray(solution) -> float:
    """Part of the light that patches send each other by their own rays and nobody receives, by dense matrices; black
    backs receive what is sent to them."""
    dark = solution.dark_rows()
    luminous = solution.radiosity.astype(float) @ LUMINANCE
    size = len(luminous)
    sent, areas, lit = np.zeros(size), np.zeros(size), 0.0
    table = solution.hits_to_rows.table(np.zeros_like(solution.radiosity))[:, :3]
    for rows, direct, seen, kept in solution.gathered_sides():
        for number, row in enumerate(rows):
            seen_here = seen.rows.reshape(*kept.shape, -1)[number][kept[number]]
            areas[row] = solution.patches.areas[row % solution.patches.count] * kept[number].mean()
            sent[row] = areas[row] * ((seen_here < size) & ~dark[seen_here]).mean() * luminous[row]
            given = direct[number][kept[number]].mean(axis=0) + table[seen_here].mean(axis=(0, 1))
            lit += areas[row] * float((given + solution.emitted[row]) @ LUMINANCE)
    received = areas * (dense_of(solution.factors) @ luminous)
    return abs(sent.sum() - received[~dark[:size]].sum()) / lit


@pytest.mark.parametrize("seed", [0, 1])
def test_patches_partly_inside_solids_keep_the_balance(seed, monkeypatch):
    # Where the lamp lights one part of them only they would be split, and few would be left to test with.
    monkeypatch.setattr(dividing, "LIGHT_ROUNDS", 0)
    vertices, faces, _ = box(divisions=4)
    block, sides, _ = box((0.15, 0.15, 0.3), 1)
    things = [Thing(vertices, faces, WHITE)]
    # Turned and sunk, so that their sides run across the floor's patches: large ones, for effects of some percent.
    for number in range(16):
        angle = 0.3 + 0.7 * number
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        place = np.array([(number % 4 + 0.5) / 4, (number // 4 + 0.5) / 4, -0.1])
        things.append(Thing((block - np.array([0.075, 0.075, 0])) @ turn + place, sides[:, ::-1], WHITE))
    scene = scene_of(*things, lights=[PointLight(np.array([0.5, 0.5, 0.8]), np.ones(3))])
    solution, _ = solved_patches(scene, 0.3, seed=seed)
    count = solution.patches.count
    share = solution.open_areas[:count] / np.where(solution.patches.areas > 0, solution.patches.areas, 1)
    assert ((share > 0) & (share < 1)).sum() > 20
    assert solution.enclosed[count:].any()
    # To the end of float32, for what is left of the bounces counts as well.
    finish(solution._iterate(1e-6))
    checks = check_patches(solution)
    assert checks.energy_balance_error == pytest.approx(astray(solution), rel=0.01)
    # The blocks stand through the floor, and patches this large let light slip out beside them.
    assert checks.light_escaped < 0.05
    assert checks.light_absorbed + checks.light_escaped == pytest.approx(1, abs=BALANCE)
    assert checks.energy_balance_error < BALANCE


def test_light_that_reaches_nobody_is_an_error_and_nothing_else():
    solution, _ = solved_patches(holed_sphere()[0], 0.03)
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
