"""Paths of the near field: gaps are dark, where light is even nothing is added, and their reach is bounded."""

import numpy as np
import pytest
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.gathering import near_paths as module
from radiosity.core.gathering.near_paths import follow_paths, reach_of_rows
from radiosity.core.lights import SunLight
from radiosity.core.progress import finish

from tests.bakes import Thing, bake, corner_light, corner_places, scene_of, solved_patches
from tests.scenes import furnace_box, grid

FLOOR = np.array([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], dtype=float)
SUN = SunLight(np.array([0.0, 0.0, 1.0]), np.ones(3), 0.0)


def plate_over_floor(gap):
    """A black plate close above a floor under a sharp sun: what its underside gets is in closed form."""
    half = 0.3
    low = np.array([(-half, half, gap), (half, half, gap), (half, -half, gap), (-half, -half, gap)])
    floor = Thing(*grid(FLOOR, 1, 1), 0.5, name="Floor", receives=False)
    return scene_of(floor, Thing(*grid(low, 8, 8), 0.0, name="Plate"), lights=[SUN]), half


@pytest.mark.parametrize("gap", [0.03, 0.1])
def test_gap_under_a_plate_is_as_dark_as_in_closed_form(gap):
    scene, half = plate_over_floor(gap)
    light, places = corner_light(bake(scene, 0.03))[:, 0], corner_places(scene)
    inner = (np.abs(places[:, :2]) < half - 1e-6).all(axis=1)
    down = np.tile([0.0, 0.0, -1.0], (inner.sum(), 1))
    shade = FLOOR * np.array([half / 2, half / 2, 1])
    expected = 0.5 * (point_to_polygon(places[inner], down, FLOOR) - point_to_polygon(places[inner], down, shade))
    # The sharp rim of the shadow as 64 spread directions see it, which err as 600 random ones: half of 1 in root 600.
    assert np.sqrt(np.mean((light[inner] - expected) ** 2)) < 0.5 / np.sqrt(600) * 0.5


@pytest.mark.parametrize("reflectance", [0.5, 0.9])
def test_nothing_is_added_where_light_is_even(reflectance):
    solution, _ = solved_patches(furnace_box(reflectance=reflectance))
    points = np.array([[0.0, 0.0, -0.49], [0.3, 0.1, 0.2]], np.float32)
    points[0, 2] = solution.patches.points[:, 0, 2].min()
    normals = np.tile(np.array([0, 0, 1], np.float32), (2, 1))
    added, rays = finish(follow_paths(solution, points, normals, 64, np.arange(2), 0))
    assert rays >= 128
    np.testing.assert_allclose(added, 0, atol=2e-3 / (1 - reflectance))


def test_reach_is_that_of_the_patch_and_none_for_what_is_black():
    solution, _ = solved_patches(furnace_box())
    reach, count = reach_of_rows(solution), solution.patches.count
    np.testing.assert_allclose(reach[:count], module.REACH * np.sqrt(solution.patches.areas), rtol=1e-6)
    np.testing.assert_array_equal(reach[:count], reach[count : 2 * count])
    assert not reach[2 * count :].any()
