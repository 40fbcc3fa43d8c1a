"""What must not change a bake: threads, scale, place, order, split vertices, subdivision.

And what its estimate of its own error is worth.
"""

import threading
from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.bake import bake_steps
from radiosity.core.lights import AreaLight, PointLight, SpotLight, SunLight
from radiosity.core.scene import Sky
from radiosity.core.settings import BakeSettings

from tests.bakes import Thing, all_light, bake, corner_light, corner_places, moved, relative_rms, scene_of
from tests.scenes import box, cornell_box, grid

#: What design.md promises for scales and places: the same scene in ordinary units, to 1e-4.
SAME_SCENE = 1e-4


def scene_with_everything(divisions: int = 8, order=(0, 1, 2, 3)):
    """A floor with a block, a translucent sheet, an emissive quad, every kind of lamp and a sky."""
    vertices, faces, _ = box((0.4, 0.4, 0.4), 3)
    things = [
        Thing(*grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], divisions, divisions), 0.6, name="Floor"),
        Thing(vertices - np.array([0.23, 0.19, 0.0]), faces[:, ::-1], (0.7, 0.2, 0.2), name="Block"),
        Thing(
            *grid([(-0.9, -0.9, 0.7), (-0.9, 0, 0.7), (0, 0, 0.7), (0, -0.9, 0.7)], 3, 3),
            0.3,
            transmittance=0.4,
            name="Sheet",
        ),
        Thing(
            *grid([(0.5, 0.5, 0.8), (0.5, 0.7, 0.8), (0.7, 0.7, 0.8), (0.7, 0.5, 0.8)], 2, 2), 0.0, 5.0, name="Panel"
        ),
    ]
    rows = np.ones((4, 6, 3)) * np.linspace(0.1, 0.3, 4)[:, None, None]
    return scene_of(*(things[i] for i in order), lights=every_lamp(), sky=Sky(rows))


def every_lamp(scale: float = 1.0, shift=(0.0, 0.0, 0.0)):
    """One lamp of each kind, in a frame that is scaled and shifted: irradiance at like places is the same."""
    shift = np.asarray(shift, dtype=float)

    def place(*xyz):
        return np.array(xyz) * scale + shift

    down = np.array([0.0, 0.0, -1.0])
    square = [(-0.6, 0.3, 0.9), (-0.6, 0.6, 0.9), (-0.3, 0.6, 0.9), (-0.3, 0.3, 0.9)]
    return [
        PointLight(place(0.6, -0.6, 0.8), scale**2 * np.array([0.3, 0.2, 0.1]), 0.05 * scale),
        PointLight(place(0.8, 0.1, 0.6), scale**2 * np.array([0.1, 0.1, 0.2]), 0.1 * scale, soft=True),
        SpotLight(place(-0.7, 0.0, 1.0), down, scale**2 * np.array([0.2, 0.4, 0.3]), 1.0, 0.3, 0.02 * scale),
        SunLight(np.array([0.6, 0.0, 0.8]), np.array([0.5, 0.4, 0.3]), 0.1),
        AreaLight(np.array([place(*corner) for corner in square]), np.array([2.0, 3.0, 1.0])),
    ]


# --- the same bits ---------------------------------------------------------------------------------------------------


def bits(scene, **settings):
    result = bake(scene, **settings)
    return np.concatenate([mesh.direct for mesh in result.meshes[:1]]), result.meshes[0].indirect


@pytest.mark.parametrize("threads", [2, 8])
@pytest.mark.parametrize("make", [scene_with_everything, lambda: cornell_box(16)], ids=["everything", "cornell"])
def test_threads_do_not_change_a_bit(make, threads):
    scene = make()
    for one, many in zip(bits(scene, threads=1), bits(scene, threads=threads), strict=True):
        np.testing.assert_array_equal(one, many)


def test_the_same_bake_twice_gives_the_same_bits():
    scene = scene_with_everything()
    for first, second in zip(bits(scene, seed=5), bits(scene, seed=5), strict=True):
        np.testing.assert_array_equal(first, second)


def test_another_seed_gives_other_bits_that_agree_within_the_accuracy():
    scene = scene_with_everything()
    one, other = bake(scene, 0.03), bake(scene, 0.03, seed=1)
    first, second = all_light(one), all_light(other)
    assert (first != second).any()
    # Two independent errors of 3 % at most differ by 4.2 %.
    assert relative_rms(first, second) < 0.03 * np.sqrt(2)


# --- the same scene ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-5, 1e-2, 1e3, 1e5])
def test_scale_changes_nothing(scale):
    scene = scene_with_everything()
    expected = all_light(bake(scene))
    scaled = moved(scene, scale, lights=every_lamp(scale))
    # Vertices are rounded anew, and a ray that grazes an edge may fall on the other side: judged by RMS.
    assert relative_rms(all_light(bake(scaled)), expected) < SAME_SCENE


@pytest.mark.parametrize("scale", [0.125, 8.0, 2.0**20])
def test_scale_by_a_power_of_two_changes_no_bit_of_a_room(scale):
    scene = cornell_box(8)
    np.testing.assert_array_equal(corner_light(bake(moved(scene, scale))), corner_light(bake(scene)))


@pytest.mark.parametrize("distance", [1e2, 1e5])
def test_place_changes_nothing(distance):
    scene = scene_with_everything()
    expected = all_light(bake(scene))
    shift = 2.0 * distance * np.array([1.0, -0.7, 0.4])
    there = moved(scene, shift=shift, lights=every_lamp(shift=shift))
    assert relative_rms(all_light(bake(there)), expected) < SAME_SCENE


def matched(scene, result, reference_scene, reference):
    """Light at the corners of `scene` and that of the reference at the same place and normal."""

    def table(of, light):
        places = np.concatenate([corner_places(of, row) for row in range(len(of.receivers))])
        normals = np.concatenate([mesh.corner_normals for mesh in of.receivers])
        keys = np.round(np.concatenate([places, normals], axis=1), 5) + 0.0
        return {tuple(key): value for key, value in zip(keys.tolist(), light, strict=True)}

    one, other = table(scene, all_light(result)), table(reference_scene, all_light(reference))
    common = [key for key in one if key in other]
    return np.array([one[key] for key in common]), np.array([other[key] for key in common])


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (1, 3, 0, 2)])
def test_order_of_objects_changes_nothing_beyond_the_accuracy(order):
    scene, other = scene_with_everything(), scene_with_everything(order=order)
    light, expected = matched(other, bake(other, 0.03), scene, bake(scene, 0.03))
    assert len(light) > 200
    # Receivers get other numbers, and so turn their hemispheres by other angles.
    assert relative_rms(light, expected) < 0.03 * np.sqrt(2)


def test_order_of_lights_changes_only_rounding():
    scene = scene_with_everything()
    backwards = replace(scene, lights=tuple(reversed(scene.lights)))
    light, expected = all_light(bake(backwards)), all_light(bake(scene))
    # Direct light is a sum in another order; indirect light is the same rays.
    np.testing.assert_allclose(light, expected, rtol=1e-4, atol=1e-5)


def unwelded(mesh):
    """The mesh as glTF has it: every face with vertices of its own."""
    return replace(
        mesh,
        positions=mesh.positions[mesh.corner_vertices],
        corner_vertices=np.arange(len(mesh.corner_vertices), dtype=np.int32),
    )


@pytest.mark.parametrize("make", [lambda: cornell_box(12), scene_with_everything], ids=["cornell", "everything"])
def test_split_vertices_change_nothing(make):
    scene = make()
    surfaces = scene.surfaces
    split = replace(
        scene,
        receivers=tuple(unwelded(mesh) for mesh in scene.receivers),
        surfaces=replace(
            surfaces,
            vertices=surfaces.vertices[surfaces.triangles.ravel()],
            triangles=np.arange(surfaces.triangles.size, dtype=np.int32).reshape(-1, 3),
        ),
    )
    one, other = bake(scene, 0.03), bake(split, 0.03)
    assert one.statistics["receivers"] == other.statistics["receivers"]
    assert relative_rms(all_light(other), all_light(one)) < 0.03 * np.sqrt(2)
    # Corners of one vertex share a receiver, so no seam shows.
    mesh = split.receivers[0]
    keys = np.round(np.concatenate([corner_places(split), mesh.corner_normals], axis=1), 5) + 0.0
    _, inverse = np.unique(keys, axis=0, return_inverse=True)
    first = np.zeros(inverse.max() + 1, np.int32)
    first[inverse.ravel()] = other.meshes[0].corner_receivers
    np.testing.assert_array_equal(first[inverse.ravel()], other.meshes[0].corner_receivers)


def test_finer_receivers_get_the_same_light_at_common_vertices():
    coarse, fine = cornell_box(12), cornell_box(36)
    # The traced room stays that of the coarse one: only the receiving mesh is finer.
    finer = replace(coarse, receivers=fine.receivers)
    light, expected = matched(finer, bake(finer, 0.03), coarse, bake(coarse, 0.03))
    assert len(light) > 500
    # Receivers on borders move inward with the size of their faces, so common vertices are compared off borders by RMS
    # with the accuracy of both bakes.
    assert relative_rms(light, expected) < 0.05


def test_subdividing_what_is_traced_changes_nothing_beyond_the_accuracy():
    coarse, fine = cornell_box(12), cornell_box(24)
    finer = replace(coarse, surfaces=fine.surfaces)
    light, expected = corner_light(bake(finer, 0.03)), corner_light(bake(coarse, 0.03))
    assert relative_rms(light, expected) < 0.03 * np.sqrt(2)


# --- the error --------------------------------------------------------------------------------------------------------


def interior(scene):
    """(c,) bool: corners at vertices that have faces of their own smooth group all around, four in these grids."""
    places = np.concatenate([corner_places(scene, row) for row in range(len(scene.receivers))])
    normals = np.concatenate([mesh.corner_normals for mesh in scene.receivers])
    keys = np.round(np.concatenate([places, normals], axis=1), 5) + 0.0
    _, inverse, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    return counts[inverse.ravel()] == 4


@pytest.mark.parametrize("make", [lambda: cornell_box(12), scene_with_everything], ids=["cornell", "everything"])
def test_estimated_error_is_the_true_one_within_a_factor_of_two(make):
    scene = make()
    inside = interior(scene)
    reference = all_light(bake(scene, 0.01, seed=99))
    for accuracy in (0.2, 0.05):
        result = bake(scene, accuracy)
        light, kept = all_light(result), ~np.concatenate([mesh.buried_corners for mesh in result.meshes])
        everywhere = relative_rms(light[kept], reference[kept])
        within = relative_rms(light[kept & inside], reference[kept & inside])
        # What patches half under something do to the border beside them is not estimated; the rest is.
        assert within / 2 < result.statistics["estimated_error"] < 2 * everywhere, (accuracy, within, everywhere)
        assert everywhere < accuracy


@pytest.mark.slow
def test_error_falls_as_the_accuracy_tightens():
    scene = cornell_box(12)
    inside = interior(scene)
    reference = corner_light(bake(scene, 0.004, seed=99))
    errors = []
    for accuracy in (0.3, 0.06, 0.012):
        light = corner_light(bake(scene, accuracy))
        errors.append(relative_rms(light[inside], reference[inside]))
        assert errors[-1] < accuracy
    assert errors[0] > 1.5 * errors[1] > 2 * errors[2]


# --- stopping ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, 2, 5, 15, 40])
def test_closing_half_way_leaves_no_thread(steps):
    before = set(threading.enumerate())
    work = bake_steps(scene_with_everything(), BakeSettings(accuracy=0.1, threads=4))
    for _ in range(steps):
        next(work)
    work.close()
    assert set(threading.enumerate()) <= before


def test_a_finished_bake_leaves_no_thread():
    before = set(threading.enumerate())
    bake(cornell_box(6), threads=4)
    assert set(threading.enumerate()) <= before


def test_an_error_within_a_ray_chunk_comes_through_and_leaves_no_thread():
    scene = scene_with_everything()

    class Broken(PointLight):
        def aim(self, points, normals, count):
            raise ZeroDivisionError("broken lamp")

        def in_frame(self, center, size):
            return self

    lamp = Broken(np.array([0.0, 0.0, 0.9]), np.ones(3), 0.1)
    before = set(threading.enumerate())
    with pytest.raises(ZeroDivisionError, match="broken lamp"):
        bake(replace(scene, lights=(lamp,)), threads=4)
    assert set(threading.enumerate()) <= before
