"""Extreme and broken input: baked as its sound part would be, or refused in one clear line."""

import builtins
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from radiosity.core import errors
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.lights import PointLight, SunLight

from tests.bakes import Thing, all_light, bake, corner_light, corner_places, relative_rms, scene_of
from tests.scenes import box, cornell_box, furnace_box, grid, scene_from_quads

FLOOR = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
LAMP = PointLight(np.array([0.1, 0.2, 1.0]), np.ones(3))


def floor(divisions=4, **look):
    return Thing(*grid(FLOOR, divisions, divisions), **{"name": "Floor", **look})


def under_lamp(places, lamp=LAMP):
    """Irradiance of an open floor at height 0."""
    apart = lamp.position - places
    return lamp.intensity[0] * apart[:, 2] / np.linalg.norm(apart, axis=1) ** 3


# --- nothing there ---------------------------------------------------------------------------------------------------


def test_no_receiving_mesh_is_refused():
    with pytest.raises(errors.EmptySceneError, match="select one"):
        bake(scene_of(floor(receives=False), lights=[LAMP]))


def test_receiving_meshes_without_faces_are_refused():
    scene = scene_of(floor(), lights=[LAMP])
    mesh = scene.receivers[0]
    empty = replace(
        mesh,
        corner_vertices=np.empty(0, np.int32),
        corner_normals=np.empty((0, 3), np.float32),
        face_offsets=np.zeros(1, np.int32),
        face_materials=np.empty(0, np.int32),
    )
    with pytest.raises(errors.EmptySceneError):
        bake(replace(scene, receivers=(empty,)))
    # Beside a sound mesh it is no trouble.
    result = bake(replace(scene, receivers=(empty, mesh)))
    assert result.meshes[0].corner_colors("combined").shape == (0, 3)
    assert result.meshes[0].vertex_colors("combined").shape == (len(mesh.positions), 3)
    assert (corner_light(result, mesh=1) > 0).all()


def test_no_usable_face_is_refused():
    scene = scene_of(Thing(np.zeros((3, 3)), np.array([[0, 1, 2]])), lights=[LAMP])
    with pytest.raises(errors.EmptySceneError, match="without area or have broken vertices"):
        bake(scene)


def test_all_receivers_broken_is_refused():
    scene = scene_of(floor(), lights=[LAMP])
    mesh = replace(scene.receivers[0], positions=np.full_like(scene.receivers[0].positions, np.nan))
    with pytest.raises(errors.EmptySceneError, match="empty or broken"):
        bake(replace(scene, receivers=(mesh,)))


@pytest.mark.parametrize("lights", [[], [replace(LAMP, intensity=np.zeros(3))]], ids=["none", "lamp-of-zero-power"])
def test_no_light_is_refused_with_remedies(lights):
    with pytest.raises(errors.NoEmittersError, match=r"add a lamp.*emission strength.*--world-strength"):
        bake(scene_of(floor(), lights=lights, sky=0.0))


def test_one_triangle():
    triangle = Thing(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    scene = scene_of(triangle, lights=[LAMP])
    np.testing.assert_allclose(corner_light(bake(scene))[:, 0], under_lamp(corner_places(scene)), rtol=2e-3)


def test_one_emissive_triangle_alone_keeps_its_emission_and_lights_nothing():
    triangle = Thing(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), 0.9, 1.0)
    result = bake(scene_of(triangle))
    np.testing.assert_allclose(corner_light(result, "combined"), 1, rtol=1e-6)
    assert not corner_light(result).any()


# --- broken geometry --------------------------------------------------------------------------------------------------


def with_bad_faces(scene, vertices, triangles, name="Broken"):
    """The scene with more triangles of an object of their own."""
    surfaces = scene.surfaces
    count = len(triangles)

    def more(values, value):
        return np.concatenate([values, np.broadcast_to(np.asarray(value, values.dtype), (count, *values.shape[1:]))])

    start = len(surfaces.vertices)
    return replace(
        scene,
        surfaces=replace(
            surfaces,
            vertices=np.concatenate([surfaces.vertices, vertices]),
            triangles=np.concatenate([surfaces.triangles, np.asarray(triangles) + start]).astype(np.int32),
            materials=more(surfaces.materials, 99),
            objects=more(surfaces.objects, len(surfaces.object_names)),
            object_names=(*surfaces.object_names, name),
            reflectance=more(surfaces.reflectance, 0.5),
            emission=more(surfaces.emission, 0.0),
            transmittance=more(surfaces.transmittance, 0.0),
            two_sided=more(surfaces.two_sided, True),
            textured=more(surfaces.textured, False),
        ),
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_vertices_that_are_not_numbers_are_left_out_and_their_object_named(value):
    scene = scene_of(floor(), lights=[LAMP])
    bad = with_bad_faces(scene, np.array([[0, 0, 0.5], [1, 0, 0.5], [0, 1, value]]), [[0, 1, 2]])
    result = bake(bad)
    assert [text for text in result.warnings if "'Broken'" in text and "not numbers" in text]
    np.testing.assert_array_equal(corner_light(result), corner_light(bake(scene)))


def test_faces_without_area_are_left_out_and_their_object_named():
    scene = scene_of(floor(), lights=[LAMP])
    points = np.array([[0, 0, 0.5], [0.5, 0, 0.5], [1, 0, 0.5], [0.2, 0.2, 0.2]])
    result = bake(with_bad_faces(scene, points, [[0, 1, 2], [3, 3, 3], [0, 0, 1]]))
    assert [text for text in result.warnings if text.startswith("3 triangles without area") and "'Broken'" in text]
    np.testing.assert_array_equal(corner_light(result), corner_light(bake(scene)))


def test_loose_vertices_do_not_matter_wherever_they_are():
    scene = scene_of(floor(), lights=[LAMP])
    loose = np.array([[np.nan, 0, 0], [1e30, 0, 0], [np.inf, -np.inf, 0]])
    surfaces = replace(scene.surfaces, vertices=np.concatenate([scene.surfaces.vertices, loose]))
    mesh = replace(scene.receivers[0], positions=np.concatenate([scene.receivers[0].positions, loose]))
    result = bake(replace(scene, surfaces=surfaces, receivers=(mesh,)))
    np.testing.assert_array_equal(corner_light(result), corner_light(bake(scene)))
    assert not result.warnings
    assert not result.meshes[0].vertex_colors("combined")[-3:].any()


def test_receiving_vertices_that_are_not_numbers_stay_black_and_are_named():
    scene = scene_of(floor(), lights=[LAMP])
    positions = scene.receivers[0].positions.copy()
    positions[7] = np.nan
    mesh = replace(scene.receivers[0], positions=positions)
    result = bake(replace(scene, receivers=(mesh,)))
    light = corner_light(result)
    broken = mesh.corner_vertices == 7
    assert not light[broken].any()
    np.testing.assert_allclose(light[~broken], corner_light(bake(scene))[~broken], rtol=5e-3)
    assert any("'Floor'" in text and "stay black" in text for text in result.warnings)


@pytest.mark.parametrize("copies", [2, 5])
def test_duplicate_faces_change_nothing(copies):
    scene = cornell_box(8)
    surfaces = scene.surfaces
    repeated = replace(
        surfaces,
        **{
            name: np.concatenate([getattr(surfaces, name)] * copies)
            for name in ("triangles", "materials", "objects", "reflectance", "transmittance", "two_sided", "textured")
        },
        # Coincident lamps would shine once each; the copies are dark.
        emission=np.concatenate([surfaces.emission] + [0 * surfaces.emission] * (copies - 1)),
    )
    light, expected = corner_light(bake(replace(scene, surfaces=repeated), 0.03)), corner_light(bake(scene, 0.03))
    assert np.isfinite(light).all()
    lamp = scene.receivers[0].face_materials.repeat(4) == 3
    # Which of the coincident faces a ray meets is chance; all but the lamp look alike.
    assert relative_rms(light[~lamp], expected[~lamp]) < 0.05


def test_inside_out_box_of_two_sided_faces_is_the_same_room():
    vertices, faces, _ = box(divisions=6)
    inward, outward = Thing(vertices, faces, 0.5, 1.0), Thing(vertices, faces[:, ::-1], 0.5, 1.0)
    # Seen from inside, receivers of the outward box look away: bake a separate plane within each.
    plane = Thing(*grid(np.array(FLOOR) * 0.2 + np.array([0.5, 0.5, 0.5]), 4, 4), 0.5, 1.0, name="Plane")
    light = [corner_light(bake(scene_of(walls, plane)), "combined", 1) for walls in (inward, outward)]
    np.testing.assert_allclose(light[0], 2, rtol=1e-3)
    np.testing.assert_allclose(light[1], 2, rtol=1e-3)


def test_coincident_faces_of_two_objects_are_lit_as_one():
    one = scene_of(floor(), lights=[LAMP])
    two = scene_of(floor(), floor(name="Rug"), lights=[LAMP])
    result = bake(two)
    expected = under_lamp(corner_places(one))
    for mesh in range(2):
        np.testing.assert_allclose(corner_light(result, mesh=mesh)[:, 0], expected, rtol=2e-3)


def test_self_intersecting_blocks_stay_finite_and_lit_outside():
    vertices, faces, _ = box((0.6, 0.6, 0.6), 5)
    blocks = [
        Thing(vertices + np.array(shift), faces[:, ::-1], name=f"Block {row}")
        for row, shift in enumerate([(-0.31, -0.31, 0.0), (-0.07, -0.13, 0.21)])
    ]
    scene = scene_of(floor(8), *blocks, lights=[SunLight(np.array([0.0, 0.0, 1.0]), np.ones(3))], sky=0.5)
    result = bake(scene)
    assert np.isfinite(all_light(result)).all()
    places, normals = corner_places(scene, 2), scene.receivers[2].corner_normals
    top = (normals[:, 2] > 0.5) & (places[:, 2] > 0.8)
    # Nothing stands above the higher block's top: all of the sun and of the sky.
    np.testing.assert_allclose(corner_light(result, mesh=2)[top], 1 + 0.5 * np.pi, rtol=1e-4)


# --- colors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("given", "used"), [(0.0, 0.0), (0.999, 0.999), (1.0, 0.999), (2.0, 0.999), (np.nan, 0.0)])
def test_extreme_reflectance_in_a_furnace(given, used):
    scene = furnace_box(6, reflectance=given)
    result = bake(scene)
    light = corner_light(result, "combined")
    # At 0.999 the solver's tolerance counts a thousandfold; the published furnace's fine level is 2 %.
    np.testing.assert_allclose(light, 1 / (1 - used), rtol=0.02)
    assert result.statistics["converged"]
    warned = [text for text in result.warnings if "reflectance" in text]
    if given in (0.0, 0.999, 1.0):
        assert not warned or given == 1.0
    else:
        assert len(warned) == 1 and "'Mesh'" in warned[0]


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_impossible_emission_emits_nothing_and_is_named(value):
    scene = scene_of(floor(name="Glow", emission=value), lights=[LAMP])
    result = bake(scene)
    assert np.isfinite(corner_light(result, "combined")).all()
    expected = corner_light(bake(scene_of(floor(name="Glow"), lights=[LAMP])), "combined")
    np.testing.assert_array_equal(corner_light(result, "combined"), expected)
    assert any("'Glow'" in text and "emission" in text for text in result.warnings)


def test_one_color_channel_zero():
    vertices, faces, _ = box(divisions=6)
    scene = scene_from_quads(vertices, faces, np.zeros(len(faces)), [0.5, 0.0, 0.5], [1.0, 1.0, 0.0])
    light = corner_light(bake(scene), "combined")
    np.testing.assert_allclose(light, np.broadcast_to([2.0, 1.0, 0.0], light.shape), rtol=1e-3)


@pytest.mark.parametrize("power", [1e-8, 1e8])
def test_faint_and_glaring_lights_in_one_scene(power):
    # Power is linear: a scene 1e16 times brighter has the same picture.
    scene = scene_of(floor(), lights=[replace(LAMP, intensity=np.full(3, power))])
    light = corner_light(bake(scene))[:, 0]
    np.testing.assert_allclose(light / power, under_lamp(corner_places(scene)), rtol=2e-3)


def test_faint_light_beside_a_glaring_one_is_kept_where_it_shines_alone():
    vertices, faces, _ = box(divisions=6)
    rooms = [Thing(vertices + np.array([2.0 * row, 0, 0]), faces, 0.5, name=f"Room {row}") for row in range(2)]
    lamps = [
        PointLight(np.array([0.5 + 2 * row, 0.5, 0.5]), np.full(3, power)) for row, power in enumerate((1e-8, 1e8))
    ]
    result = bake(scene_of(*rooms, lights=lamps))
    faint, glaring = corner_light(result, mesh=0), corner_light(result, mesh=1)
    np.testing.assert_allclose(faint * 1e16, glaring, rtol=0.05)  # hemispheres of other receivers turn differently
    np.testing.assert_allclose(faint.mean() * 1e16, glaring.mean(), rtol=2e-3)


# --- sizes ------------------------------------------------------------------------------------------------------------


def test_slivers_of_aspect_a_million_are_lit_by_the_closed_form():
    long = Thing(*grid(np.array(FLOOR) * (1.0, 1e-6, 1.0), 8, 1), name="Sliver")
    scene = scene_of(long, lights=[LAMP])
    np.testing.assert_allclose(corner_light(bake(scene))[:, 0], under_lamp(corner_places(scene)), rtol=2e-3)


def test_floor_cut_into_slivers_is_lit_as_the_whole_one():
    cuts = np.sort(np.concatenate([np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)[1:-1] + 2e-6]))
    strips = [grid([(a, -1, 0), (b, -1, 0), (b, 1, 0), (a, 1, 0)], 1, 4) for a, b in pairwise(cuts)]
    vertices, faces = np.concatenate([v for v, _ in strips]), []
    start = 0
    for part, quads in strips:
        faces.append(quads + start)
        start += len(part)
    scene = scene_of(Thing(vertices, np.concatenate(faces), name="Strips"), lights=[LAMP])
    np.testing.assert_allclose(corner_light(bake(scene))[:, 0], under_lamp(corner_places(scene)), rtol=2e-3)


def test_narrow_gap_between_plates_is_a_furnace_within():
    # Plates 1e-4 of their size apart: in the middle each sees only the other.
    low = Thing(*grid(FLOOR, 8, 8), 0.5, 1.0, two_sided=False)
    high = Thing(*grid(np.array(FLOOR)[::-1] + np.array([0, 0, 2e-4]), 8, 8), 0.5, 1.0, two_sided=False)
    scene = scene_of(low, high)
    light, places = corner_light(bake(scene, 0.03), "combined"), corner_places(scene)
    middle = (np.abs(places[:, :2]) < 0.9).all(axis=1)
    np.testing.assert_allclose(light[middle], 2, rtol=5e-3)


def test_plate_close_to_its_source_gets_all_its_light():
    source = Thing(*grid(FLOOR, 1, 1), 0.0, 1.0, two_sided=False)
    plate = Thing(*grid(np.array(FLOOR)[::-1] * 0.5 + np.array([0, 0, 2e-4]), 8, 8), 0.0, two_sided=False)
    scene = scene_of(source, plate)
    expected = point_to_polygon(
        corner_places(scene, 1), scene.receivers[1].corner_normals.astype(float), np.array(FLOOR, dtype=float)
    )
    np.testing.assert_allclose(corner_light(bake(scene, 0.03), mesh=1)[:, 0], expected, rtol=5e-3)


@pytest.mark.parametrize("gap", [0.0, 1e-5, 1e-3])
def test_source_touching_the_ceiling_lights_the_room_as_one_just_below(gap):
    def room(gap):
        vertices, faces, _ = box(divisions=8)
        panel = [(0.4, 0.4, 1 - gap), (0.4, 0.6, 1 - gap), (0.6, 0.6, 1 - gap), (0.6, 0.4, 1 - gap)]
        lamp = Thing(*grid(panel, 1, 1), 0.0, 10.0, two_sided=False, receives=False, name="Lamp")
        return scene_of(Thing(vertices, faces, 0.5, name="Room"), lamp)

    scene = room(gap)
    light, expected = corner_light(bake(scene, 0.03)), corner_light(bake(room(2e-3), 0.03))
    away = corner_places(scene)[:, 2] < 1 - 1e-6
    assert relative_rms(light[away], expected[away]) < 0.03


def test_flush_source_that_is_part_of_the_ceiling_is_in_closed_form():
    scene = cornell_box(12)
    black = replace(scene.surfaces, reflectance=np.zeros_like(scene.surfaces.reflectance))
    light = corner_light(bake(replace(scene, surfaces=black), 0.03))
    places, normals = corner_places(scene), scene.receivers[0].corner_normals.astype(float)
    half = 1 / 12
    panel = np.array([[-half, -half, 0], [-half, half, 0], [half, half, 0], [half, -half, 0]])
    panel += np.array([0.5, 0.5, 1.0])
    factor = point_to_polygon(places, normals, panel)
    # The tops of the blocks and the upper halves of the walls see all of the lamp.
    seen = (places[:, 2] > 0.62) & (factor > 1e-3)
    np.testing.assert_allclose(light[seen, 0], np.pi * 17 * factor[seen], rtol=0.02)


@pytest.mark.slow
def test_ten_thousand_objects():
    side = (np.arange(100) - 49.5) / 50
    small = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * 0.004
    quad = np.array([[0, 1, 2, 3]])
    things = [Thing(small + np.array([x, y, 0.0]), quad, name=f"Tile {x} {y}") for x in side for y in side]
    scene = scene_of(*things, lights=[LAMP])
    result = bake(scene)
    places = np.concatenate([mesh.positions[mesh.corner_vertices] for mesh in scene.receivers])
    np.testing.assert_allclose(all_light(result)[:, 0], under_lamp(places), rtol=2e-3)


def test_sixty_four_materials():
    vertices, faces, _ = box(divisions=8)
    reflectance = np.linspace(0.2, 0.8, 64)[:, None].repeat(3, axis=1)
    emission = 1 - reflectance  # B = E / (1 - rho) = 1 everywhere, whatever the material
    scene = scene_from_quads(vertices, faces, np.arange(len(faces)) % 64, reflectance, emission)
    light = corner_light(bake(scene, 0.03), "combined")
    # Every material's faces are lights of their own, 384 in all, of which receivers ask the strongest and draw others.
    assert relative_rms(light, np.ones_like(light)) < 0.03
    np.testing.assert_allclose(light.mean(), 1, rtol=2e-3)


def test_many_triangles_are_clustered_and_lit_by_the_closed_form():
    scene = scene_of(floor(100), lights=[LAMP])
    result = bake(scene)
    np.testing.assert_allclose(corner_light(result)[:, 0], under_lamp(corner_places(scene)), rtol=2e-3)
    assert result.statistics["traced_triangles"] == 2


# --- refusals ---------------------------------------------------------------------------------------------------------


def test_memory_is_refused_with_numbers_before_any_work(monkeypatch):
    from radiosity.core import bake as module

    def never(*_):
        raise AssertionError("work began")

    monkeypatch.setattr(module, "build_model", never)
    scene = scene_of(floor(50), lights=[LAMP])
    with pytest.raises(errors.SceneTooLargeError, match=r"10,000 corners among 5,000 triangles .* \d+ MB,.* 1 MB"):
        bake(scene, memory_limit=1e6)


def test_enough_memory_is_not_refused():
    assert bake(scene_of(floor(), lights=[LAMP]), memory_limit=1e9).meshes


def test_missing_ray_engine_is_named(monkeypatch):
    whole = builtins.__import__

    def without_embreex(name, *rest, **more):
        if name.startswith("embreex"):
            raise ImportError("No module named 'embreex'")
        return whole(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without_embreex)
    with pytest.raises(errors.MissingRayEngineError, match="embreex package is missing"):
        bake(scene_of(floor(), lights=[LAMP]))


def test_warnings_of_the_reader_come_first():
    scene = replace(scene_of(floor(reflectance=2.0), lights=[LAMP]), warnings=("The reader's",))
    result = bake(scene)
    assert result.warnings[0] == "The reader's" and len(result.warnings) == 2
