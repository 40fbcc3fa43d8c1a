"""Light groups: each has the light of its own lamps, and all together are the bake without groups."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core import bake as module
from radiosity.core.bake_plan import foreseen_memory, plan_for
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.light_groups import LightGroups, shared_out
from radiosity.core.lights import AreaLight, PointLight, SunLight
from radiosity.core.scene import Sky

from tests.bakes import Thing, all_light, bake, corner_places, relative_rms, scene_of
from tests.scenes import box, grid

#: Sums of a handful of float32 numbers, each rounded a few times: relative to the whole.
ROUNDING = 2e-6

NAMES = ("lamp", "panel", "sun", "window", "bulb", "nothing")


def room(divisions: int = 16):
    """A room open on one side, with a board over the floor, a wall that stands on it, a glowing bulb, and lamps."""
    vertices, faces, sides = box(divisions=divisions)
    walls = Thing(vertices, faces[sides != 2], reflectance=(0.7, 0.5, 0.3), name="Walls")
    board = Thing(*grid(((0.2, 0.2, 0.02), (0.8, 0.2, 0.02), (0.8, 0.8, 0.02), (0.2, 0.8, 0.02)), 6, 6), name="Board")
    stand = Thing(*grid(((0.5, 0.1, -0.1), (0.5, 0.7, -0.1), (0.5, 0.7, 0.5), (0.5, 0.1, 0.5)), 9, 9), name="Stand")
    corners, quads, _ = box((0.06, 0.06, 0.06), 2)
    bulb = Thing(
        corners + np.array((0.3, 0.6, 0.7)), quads[:, ::-1], emission=(3.0, 6.0, 9.0), reflectance=0.2, name="Bulb"
    )
    faint = Thing(*grid(((0.1, 0.9, 0.4), (0.2, 0.9, 0.4), (0.2, 0.9, 0.5), (0.1, 0.9, 0.5)), 1, 1), emission=1e-4)
    lights = (
        PointLight(np.array([0.8, 0.5, 0.8]), np.array([0.1, 0.05, 0.02]), 0.03),
        AreaLight(
            np.array([[0.4, 0.4, 0.99], [0.4, 0.6, 0.99], [0.6, 0.6, 0.99], [0.6, 0.4, 0.99]]),
            np.array([1.0, 4.0, 2.0]),
        ),
        SunLight(np.array([0.0, -0.8, 0.6]), np.array([0.5, 0.5, 0.4]), 0.05),
    )
    scene = scene_of(walls, board, stand, bulb, faint, lights=lights, sky=Sky(_clouds()))
    groups = LightGroups(
        names=NAMES,
        lights=np.array([0, 1, 2]),
        objects=np.array([5, 5, 5, 4, 4]),
        receivers=np.array([5, 5, 5, 4, 4]),
        sky=3,
    )
    return scene, groups


def _clouds():
    generator = np.random.default_rng(5)
    return generator.random((8, 16, 3)) * (0.2, 0.3, 0.4)


def group_light(result, name, bake_type="combined"):
    """(c, 3) at the corners of all meshes, of one group."""
    return np.concatenate([np.pi * mesh.corner_colors(bake_type).astype(np.float64) for mesh in result.groups[name]])


@pytest.fixture(scope="module")
def baked():
    scene, groups = room()
    return bake(scene), bake(replace(scene, groups=groups)), scene, groups


@pytest.mark.parametrize("bake_type", ["combined", "lighting", "direct", "indirect", "emission"])
def test_groups_add_up_to_the_bake_without_groups(baked, bake_type):
    plain, grouped, _, _ = baked
    assert tuple(grouped.groups) == NAMES
    expected = all_light(plain, bake_type)
    np.testing.assert_array_equal(all_light(grouped, bake_type), expected)
    total = sum(group_light(grouped, name, bake_type) for name in NAMES)
    np.testing.assert_allclose(total, expected, rtol=ROUNDING, atol=ROUNDING * expected.max())


def test_no_ray_more_is_sent_for_groups(baked):
    plain, grouped, _, _ = baked
    for name in ("rays", "patches", "nodes", "estimated_error", "iterations", "light_absorbed", "energy_balance_error"):
        assert grouped.statistics[name] == plain.statistics[name]


def test_a_group_without_lights_is_dark(baked):
    _, grouped, _, _ = baked
    assert not group_light(grouped, "nothing").any()
    assert all((group_light(grouped, name) >= 0).all() for name in NAMES)


def test_hardly_anything_is_left_to_be_shared_out(monkeypatch):
    scene, groups = room()
    given = []
    monkeypatch.setattr(module, "shared_out", lambda light: given.append(light) or shared_out(light))
    bake(replace(scene, groups=groups))
    light = given[0].reshape(len(given[0]), -1, 6).astype(np.float64)
    missing = np.abs(light[:, 1:].sum(axis=1) - light[:, 0]).max(axis=1) / light[:, 0].mean(axis=1).mean()
    # The solver leaves a change of 0.002 times the accuracy; what is cut off at zero is rare, and small.
    assert np.quantile(missing, 0.99) < 0.002 * 0.1
    assert missing.max() < 0.02


@pytest.mark.parametrize("name", NAMES[:5])
def test_a_group_has_the_light_of_a_bake_with_its_lights_alone(baked, name):
    _, grouped, scene, groups = baked
    row = NAMES.index(name)
    keep = groups.objects[scene.surfaces.objects] == row
    alone = replace(
        scene,
        surfaces=replace(scene.surfaces, emission=scene.surfaces.emission * keep[:, None]),
        lights=tuple(light for light, group in zip(scene.lights, groups.lights, strict=True) if group == row),
        sky=scene.sky if groups.sky == row else None,
    )
    expected, found = all_light(bake(alone), "lighting"), group_light(grouped, name, "lighting")
    # Both are wrong by the accuracy asked for at most; which nodes are gathered depends on all lights.
    assert relative_rms(found, expected) < 0.1
    np.testing.assert_allclose(found.mean(axis=0), expected.mean(axis=0), rtol=0.02)


def test_emission_of_a_mesh_belongs_to_its_own_group(baked):
    _, grouped, _, _ = baked
    assert all((group_light(grouped, name, "emission") > 0).any() == (name == "bulb") for name in NAMES)


def test_faces_of_one_look_in_two_groups_are_told_apart():
    vertices, faces, _ = box(divisions=4)
    walls = Thing(vertices, faces)
    plate = grid(((0.1, 0.1, 0.9), (0.1, 0.4, 0.9), (0.4, 0.4, 0.9), (0.4, 0.1, 0.9)), 1, 1)
    # Side by side, of one material: as one look they would be merged to one light.
    other = (plate[0] + (0.3, 0.0, 0.0), plate[1])
    scene = scene_of(walls, *(Thing(*each, emission=5.0, receives=False) for each in (plate, other)))
    surfaces = replace(scene.surfaces, materials=np.minimum(scene.surfaces.materials, 1))
    groups = LightGroups(("one", "other"), np.empty(0, int), np.array([0, 0, 1]), np.array([0]), 0)
    result = bake(replace(scene, surfaces=surfaces, groups=groups))
    one, other = (group_light(result, name, "direct") for name in groups.names)
    np.testing.assert_allclose(one + other, all_light(result, "direct"), rtol=ROUNDING, atol=1e-6)
    places = corner_places(scene)
    inside = (places[:, 2] == 0) & (np.abs(places[:, :2] - 0.5) < 0.4).all(axis=1)
    for found, shift in ((one, 0.0), (other, 0.3)):
        exact = 5.0 * point_to_polygon(
            places[inside],
            np.tile([0.0, 0.0, 1.0], (inside.sum(), 1)),
            plate[0][[0, 1, 3, 2]] + (shift, 0.0, 0.0),
            two_sided=True,
        )
        np.testing.assert_allclose(found[inside, 0], exact, rtol=1e-4)  # lifted off the floor a little


def test_what_groups_miss_of_the_whole_is_shared_out():
    generator = np.random.default_rng(1)
    whole = generator.random((50, 6)).astype(np.float32)
    shares = generator.dirichlet(np.ones(3), (50, 6)).transpose(0, 2, 1)
    parts = (whole[:, None] * shares * (1 + 0.01 * generator.random((50, 3, 6)))).astype(np.float32)
    parts[3, 1] *= -0.1  # noise below zero
    parts[4] = 0  # nobody claims it
    whole[5] = 0
    found = shared_out(np.concatenate([whole[:, None], parts], axis=1).reshape(50, -1)).reshape(50, 4, 6)
    np.testing.assert_array_equal(found[:, 0], whole)
    np.testing.assert_allclose(found[:, 1:].sum(axis=1), whole, rtol=ROUNDING)
    assert (found >= 0).all()
    kept = np.delete(np.arange(50), [3, 4, 5])
    np.testing.assert_allclose(found[kept, 1:], parts[kept], rtol=0.011)


def test_named_methods_refuse_groups():
    scene, groups = room(2)
    with pytest.raises(SettingsError, match="Light groups are not kept by method hemicube"):
        bake(replace(scene, groups=groups), method="hemicube")


def test_foreseen_memory_counts_groups():
    plan = plan_for(0.03)
    more = foreseen_memory(0, 1_000_000, plan, 5) - foreseen_memory(0, 1_000_000, plan)
    assert more >= 5 * 1_000_000 * 24  # direct and indirect light alone
