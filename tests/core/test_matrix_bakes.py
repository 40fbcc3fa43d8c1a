"""Bakes by a method or a solver chosen by name: all of them light a scene, or say by name why not."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.errors import SceneTooLargeError, SettingsError
from radiosity.core.lights import PointLight
from radiosity.core.matrix_plan import MOST_POLYGONS
from radiosity.core.settings import METHODS, SOLVERS
from radiosity.core.solvers import matrix_solution
from radiosity.core.visibility.embree import is_available

from tests.bakes import Thing, all_light, bake, corner_light, corner_places, relative_rms, scene_of
from tests.scenes import box, cornell_box, furnace_box, grid, inward_sphere

pytestmark = pytest.mark.skipif(not is_available(), reason="rays need embreex")

NAMED = METHODS[1:]

#: Methods that take a minute and more for a room with a few blocks.
SLOW = ("hybrid", "disk", "point_to_polygon", "point_to_point")


def methods(slow=SLOW):
    return [pytest.param(name, marks=[pytest.mark.slow] if name in slow else []) for name in NAMED]


@pytest.mark.parametrize("method", NAMED)
def test_furnace_by_each_method(method):
    light = all_light(bake(furnace_box(3), 0.1, method=method))
    # Every patch sees only others of radiosity 2: what is left is the method's own error at receivers, whose rows no
    # closure repairs, within the accuracy asked for.
    np.testing.assert_allclose(light, 2.0, rtol=0.1)


@pytest.mark.parametrize("solver", SOLVERS[1:])
def test_solvers_agree(solver):
    scene = cornell_box(6)
    light, expected = (all_light(bake(scene, method="hemisphere", solver=name)) for name in (solver, "direct"))
    # The tolerance of an accuracy of 10 % is 2e-4 of the light.
    assert relative_rms(light, expected) < 1e-3


@pytest.mark.parametrize("method", methods())
def test_room_by_each_method_agrees_with_rays(method):
    scene = cornell_box(8)
    expected = all_light(bake(scene, 0.01))
    result = bake(scene, 0.03, method=method)
    assert relative_rms(all_light(result), expected) < 0.05
    assert result.statistics["method"] == method and result.statistics["method_counts"]
    assert result.statistics["energy_balance_error"] < 0.02
    assert result.statistics["estimated_error"] < 0.08


@pytest.mark.parametrize("method", methods())
def test_wall_of_no_thickness_keeps_light_on_its_side(method):
    vertices, faces, _ = box((2.0, 1.0, 1.0), 4)
    wall = grid([(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)], 4, 4)
    lamp = PointLight(np.array([0.4, 0.5, 0.6]), np.full(3, 0.2), 0.05)
    scene = scene_of(Thing(vertices, faces), Thing(*wall, receives=False), lights=(lamp,))
    result = bake(scene, 0.1, method=method)
    light, places = all_light(result).mean(axis=1), vertices[faces.reshape(-1)]
    lit, dark = light[places[:, 0] < 0.8].mean(), light[places[:, 0] > 1.2].mean()
    assert dark < 0.01 * lit


@pytest.mark.parametrize("method", methods())
def test_receivers_under_a_block_are_found_and_bounced_light_beside_it_is_right(method):
    floor = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 12, 12)
    vertices, faces, _ = box((0.4, 0.4, 0.4), 2)
    block = Thing(vertices + np.array([0.31, 0.31, 0.0]), faces[:, ::-1], receives=False)
    scene = scene_of(Thing(*floor), block, lights=[PointLight(np.array([0.1, 0.1, 1.0]), np.ones(3))])
    result, expected = bake(scene, 0.1, method=method), bake(scene, 0.02)
    inside = (np.abs(corner_places(scene)[:, :2] - 0.51) < 0.2).all(axis=1)
    assert np.array_equal(result.meshes[0].buried_corners, inside)
    assert corner_light(result)[inside].min() > 0
    light, right = (corner_light(each, "indirect")[~inside] for each in (result, expected))
    # The accuracy asked for, of the bounced light alone, which is a thirtieth of all.
    assert relative_rms(light, right) < 0.1


@pytest.mark.parametrize("method", methods())
def test_room_without_light_beside_a_lit_one_stays_black(method):
    vertices, faces, _ = box((1.0, 1.0, 1.0), 4)
    lamp = PointLight(np.array([0.5, 0.5, 0.6]), np.full(3, 0.2), 0.05)
    scene = scene_of(Thing(vertices, faces), Thing(vertices + np.array([3.0, 0, 0]), faces), lights=[lamp])
    result = bake(scene, 0.1, method=method)
    assert relative_rms(corner_light(result), corner_light(bake(scene, 0.02))) < 0.1
    assert not corner_light(result, mesh=1).any()


def test_automatic_bake_is_what_it_was_before_methods_had_names():
    scene = cornell_box(6)
    plain, named = bake(scene), bake(scene, method="auto", solver="auto")
    assert np.array_equal(all_light(plain), all_light(named))
    assert plain.statistics["method"] == "auto" and "polygons" not in plain.statistics


def test_same_bits_again_and_with_more_threads():
    scene = cornell_box(6)
    one, two = (all_light(bake(scene, method="hemisphere", threads=threads)) for threads in (1, 2))
    assert np.array_equal(one, two)


def test_too_many_polygons_are_refused_with_the_numbers_and_before_the_slow_part(monkeypatch):
    def never(*_, **__):
        raise AssertionError("form factors were computed")

    monkeypatch.setattr(matrix_solution, "form_factors", never)
    scene = inward_sphere(40)
    # A cell of 40 by 40 on each of 6 sides, in two triangles.
    count = 2 * 6 * 40**2
    numbers = rf"hemicube between {count:,} polygons .*{8 * count**2 / 1e6:,.0f} MB.*{MOST_POLYGONS:,}.*--method auto"
    with pytest.raises(SceneTooLargeError, match=numbers):
        bake(scene, method="hemicube")
    with pytest.raises(SceneTooLargeError, match=r"solver jacobi .*--solver auto"):
        bake(scene, solver="jacobi")


def test_what_lets_light_through_is_refused_by_name():
    vertices, faces, _ = box((1.0, 1.0, 1.0), 2)
    scene = scene_of(Thing(vertices, faces, transmittance=0.5, name="Curtain"), sky=1.0)
    with pytest.raises(SettingsError, match=r"hemicube cannot see through 'Curtain'.*--method auto.*opaque"):
        bake(scene, method="hemicube")


def test_unknown_names_are_refused_by_name():
    with pytest.raises(SettingsError, match="Unknown method 'magic': choose auto, hemisphere"):
        bake(cornell_box(2), method="magic")
    with pytest.raises(SettingsError, match="Unknown solver 'magic': choose auto, "):
        bake(cornell_box(2), solver="magic")


def test_one_sided_faces_have_black_backs():
    # A sheet over a floor, which sees its back only.
    floor = grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], 3, 3)
    sheet = grid([(-1, -1, 0.5), (1, -1, 0.5), (1, 1, 0.5), (-1, 1, 0.5)], 1, 1)
    both = scene_of(Thing(*floor), Thing(*sheet, reflectance=0.9, receives=False), sky=1.0)
    single = replace(both, surfaces=replace(both.surfaces, two_sided=both.surfaces.objects == 0))
    for scene in (both, single):
        light = all_light(bake(scene, 0.05, method="hemisphere"))
        assert relative_rms(light, all_light(bake(scene, 0.01))) < 0.08


def test_a_method_that_misses_its_accuracy_says_so_in_the_report(monkeypatch):
    scene = cornell_box(6)
    result = bake(scene, 0.03, method="hemisphere")
    assert not any("Form factors by" in text for text in result.warnings)
    computed = matrix_solution.form_factors
    monkeypatch.setattr(matrix_solution, "form_factors", lambda *given: replace(computed(*given), estimated_error=0.26))
    missed = bake(scene, 0.03, method="hemisphere")
    assert any("by hemisphere may be off by 0.26, not 0.03 as asked for" in text for text in missed.warnings)
