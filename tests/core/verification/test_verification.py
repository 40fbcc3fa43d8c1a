"""Verification of whole bakes: what was stored against light that was followed."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.errors import EmptySceneError, SettingsError
from radiosity.core.lights import PointLight
from radiosity.core.progress import finish
from radiosity.core.verification.verification import StoredColors, verify_steps

from tests.bakes import Thing, bake, scene_of
from tests.scenes import box, cornell_box, furnace_box, grid


def stored(result, bake_type="combined", at_vertices=False, factor=1.0):
    meshes = [mesh.vertex_colors(bake_type) if at_vertices else mesh.corner_colors(bake_type) for mesh in result.meshes]
    return [StoredColors(factor * colors, at_vertices) for colors in meshes]


def verify(scene, colors, **options):
    return finish(verify_steps(scene, colors, **{"threads": 1, "places": 150, "paths": 512, **options}))


def assert_holds(measured, truth):
    assert measured.low <= truth <= measured.high
    assert measured.high - measured.low < truth


@pytest.mark.parametrize("at_vertices", [False, True])
@pytest.mark.parametrize("bake_type", ["combined", "lighting"])
def test_a_known_error_is_found(bake_type, at_vertices):
    scene = furnace_box(8)
    result = bake(scene)
    # Emission is no light that arrives: it must not be part of the mistake.
    colors = stored(result, bake_type, at_vertices)
    emitted = 1 / np.pi if bake_type == "combined" else 0.0
    wrong = [replace(c, values=(c.values - emitted) * 1.05 + emitted) for c in colors]
    found = verify(scene, wrong, bake_type=bake_type)
    assert_holds(found.measured, 0.05)
    assert found.left_out == 0 and found.rays > 0
    assert verify(scene, colors, bake_type=bake_type, paths=2048).measured.error < 0.01


def test_agrees_with_a_far_better_bake():
    scene = cornell_box(14)
    coarse, fine = bake(scene, 0.2), bake(scene, 0.01)
    values, better = (r.meshes[0].direct + r.meshes[0].indirect for r in (coarse, fine))
    usable = ~(coarse.meshes[0].buried | fine.meshes[0].buried)
    difference = values[usable] - better[usable]
    truth = np.sqrt((difference**2).mean()) / better[usable].mean()
    found = verify(scene, stored(coarse), paths=1024, places=400)
    # The better bake errs by a few tenths of a percent itself.
    assert found.measured.low - 0.003 <= truth <= found.measured.high + 0.003
    assert found.measured.high < 2 * found.measured.low
    again = verify(scene, stored(fine), paths=1024, places=400)
    assert again.measured.high < found.measured.low


def test_direct_and_indirect_light_each_by_itself():
    vertices, faces, _ = box((1.0, 1.0, 1.0), 6)
    scene = scene_of(Thing(vertices, faces, 0.6), lights=(PointLight(np.array([0.4, 0.5, 0.6]), np.full(3, 0.1)),))
    result = bake(scene, 0.05)
    for bake_type in ("direct", "indirect", "lighting"):
        assert verify(scene, stored(result, bake_type), bake_type=bake_type).measured.high < 0.05
        found = verify(scene, stored(result, bake_type, factor=1.3), bake_type=bake_type).measured
        assert found.low > 0.2
    # One for the other is seen at once.
    assert verify(scene, stored(result, "direct"), bake_type="lighting").measured.low > 0.3


def test_places_inside_solids_are_left_out():
    scene = cornell_box(12)
    result = bake(scene)
    buried = result.meshes[0].buried.mean()
    # The light and not the color: the lamp in the ceiling reflects nothing, and would be left out too.
    found = verify(scene, stored(result, "lighting"), bake_type="lighting", places=400)
    assert buried > 0 and 0 < found.left_out < 4 * buried * 400
    assert found.measured.places == 400 - found.left_out


def test_corners_that_store_the_light_behind_a_wall_are_left_out():
    vertices, faces, _ = box((1.0, 1.0, 1.0), 8)
    # Its four corners stand outdoors, and hold the light of the room.
    panel = grid([(-0.08, 0.5, -0.08), (1.08, 0.5, -0.08), (1.08, 0.5, 1.08), (-0.08, 0.5, 1.08)], 1, 1)
    lamp = PointLight(np.array([0.5, 0.25, 0.7]), np.full(3, 0.05), 0.02)
    scene = scene_of(Thing(*panel, name="Panel"), Thing(vertices, faces), lights=(lamp,), sky=1.0)
    found = verify(scene, stored(bake(scene, 0.03)), places=10_000)
    walls = 6 * 81
    # Where the panel meets the walls some of their border vertices are cut off as well.
    assert 0.85 * walls < found.measured.places + found.left_out <= walls
    assert found.measured.high < 0.2


def test_same_numbers_again_and_with_more_threads():
    scene = cornell_box(6)
    colors = stored(bake(scene))
    one, two, three = (verify(scene, colors, threads=threads, paths=64) for threads in (1, 1, 2))
    assert one == two == three
    assert verify(scene, colors, paths=64, seed=1) != one


def test_paths_go_on_until_the_noise_is_below_the_error():
    scene = furnace_box(6)
    result = bake(scene)
    right, wrong = stored(result), stored(result, factor=1.2)
    assert verify(scene, wrong, paths=4096).paths == 1024
    assert verify(scene, right, paths=2048).paths == 2048


def test_refusals_name_the_remedy():
    scene = furnace_box(3)
    colors = stored(bake(scene))
    with pytest.raises(SettingsError, match="bake another type"):
        verify(scene, colors, bake_type="emission")
    with pytest.raises(SettingsError, match="At least 16"):
        verify(scene, colors, places=3)
    short = [replace(colors[0], values=colors[0].values[:-1])]
    with pytest.raises(SettingsError, match=r"do not fit its mesh.*bake again"):
        verify(scene, short)
    black = scene_of(Thing(*grid(((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)), 2, 2), reflectance=0.0), sky=1.0)
    with pytest.raises(EmptySceneError, match="reflects too little"):
        verify(black, stored(bake(black)))
    # Irradiance does not ask what reflects.
    assert verify(black, stored(bake(black), "lighting"), bake_type="lighting").measured.high < 1e-3


def test_in_the_dark_there_is_no_relative_error():
    lit, dark = furnace_box(2), furnace_box(2, emission=0.0)
    with pytest.raises(EmptySceneError, match="No light arrives"):
        verify(dark, stored(bake(lit)))


def test_broken_vertices_are_not_asked():
    scene = furnace_box(4)
    positions = scene.receivers[0].positions.copy()
    positions[3] = np.nan
    surfaces = replace(scene.surfaces, vertices=positions)
    broken = replace(scene, surfaces=surfaces, receivers=(replace(scene.receivers[0], positions=positions),))
    found = verify(broken, stored(bake(broken)))
    assert np.isfinite(found.measured.error)
