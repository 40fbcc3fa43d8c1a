"""Relighting: factors of light groups where only lights have changed, and a refusal by name for all else."""

import json
from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.errors import NeedsBakeError
from radiosity.core.light_groups import LightGroups
from radiosity.core.lights import SunLight
from radiosity.core.relighting import MOST_RUNS, LightState, group_factors, light_state

from tests.bakes import moved
from tests.core.test_light_groups import room

LAMPS = ("Lamp", "Panel")


def lit_room():
    """The room of the tests of light groups; its last light is a sun of the world."""
    scene, groups = room(4)
    groups = LightGroups(
        ("lamp", "panel", "world", "bulb", "nothing"),
        np.array([0, 1, 2]),
        np.array([4, 4, 4, 3, 3]),
        np.array([4, 4, 4, 3, 3]),
        2,
    )
    return replace(scene, groups=groups)


def state_of(scene, lamps=LAMPS):
    return light_state(scene, lamps)


def with_emission(scene, factor, which=slice(None)):
    emission = scene.surfaces.emission.copy()
    emission[which] *= factor
    return replace(scene, surfaces=replace(scene.surfaces, emission=emission))


def with_lamp(scene, row, **changes):
    lights = list(scene.lights)
    lights[row] = replace(lights[row], **changes)
    return replace(scene, lights=tuple(lights))


def test_nothing_has_changed():
    state = state_of(lit_room())
    np.testing.assert_allclose(group_factors(state, state_of(lit_room())), np.ones((5, 3)))


def test_a_state_survives_json():
    state = state_of(lit_room())
    assert LightState(**json.loads(json.dumps(state.as_dict()))) == state


@pytest.mark.parametrize("factor", [2.0, 0.0, np.array([0.5, 1.0, 3.0])])
def test_each_group_has_the_factor_of_its_sources(factor):
    scene = lit_room()
    before = state_of(scene)
    expected = np.ones((5, 3))

    lamp = with_lamp(scene, 0, intensity=scene.lights[0].intensity * factor)
    expected[0] = factor
    np.testing.assert_allclose(group_factors(before, state_of(lamp)), expected, rtol=1e-12)

    expected = np.ones((5, 3))
    expected[3] = factor
    np.testing.assert_allclose(group_factors(before, state_of(with_emission(scene, factor))), expected, rtol=1e-12)

    world = with_lamp(scene, 2, irradiance=scene.lights[2].irradiance * factor)
    world = replace(world, sky=replace(scene.sky, radiance=scene.sky.radiance * factor))
    expected = np.ones((5, 3))
    expected[2] = factor
    np.testing.assert_allclose(group_factors(before, state_of(world)), expected, rtol=1e-12)


def test_a_lamp_that_is_gone_and_a_world_without_light_are_switched_off():
    scene = lit_room()
    dark = replace(scene, lights=scene.lights[:1], sky=None, groups=None)
    factors = group_factors(state_of(scene), state_of(dark, LAMPS[:1]))
    np.testing.assert_array_equal(factors, [[1] * 3, [0] * 3, [0] * 3, [1] * 3, [1] * 3])


def test_a_lamp_switched_off_and_on_again_is_as_it_was():
    scene = lit_room()
    before = state_of(scene)
    off = with_lamp(scene, 0, intensity=np.zeros(3))
    assert not group_factors(before, state_of(off))[0].any()
    np.testing.assert_allclose(group_factors(before, state_of(scene))[0], 1)


CHANGES = {
    "Meshes or their places": lambda scene: moved(scene, shift=(0.1, 0, 0)),
    "Colors of surfaces": lambda scene: replace(
        scene, surfaces=replace(scene.surfaces, reflectance=scene.surfaces.reflectance * 0.9)
    ),
    "Meshes that receive light": lambda scene: replace(scene, receivers=scene.receivers[:1]),
    "The lamp 'Lamp' was moved": lambda scene: with_lamp(scene, 0, position=np.array([0.8, 0.5, 0.7])),
    "The lamp 'Panel' was moved or has another shape": lambda scene: with_lamp(scene, 1, two_sided=True),
    "The picture of the world": lambda scene: replace(scene, sky=None),
    "of the group 'world' have changed by different factors": lambda scene: replace(
        scene, sky=replace(scene.sky, radiance=np.roll(scene.sky.radiance, 1, axis=1))
    ),
    "of the group 'bulb' have changed by different factors": lambda scene: with_emission(scene, 2.0, slice(-30, None)),
    "of the group 'lamp' have .* a color that they had none of": lambda scene: with_lamp(
        scene, 0, intensity=scene.lights[0].intensity * (0, 1, 1)
    ),
}


@pytest.mark.parametrize("what", CHANGES)
def test_what_wants_a_new_bake_is_named(what):
    scene = lit_room()
    before, after = state_of(scene), state_of(CHANGES[what](scene))
    if "none of" in what:
        before, after = after, before  # a red that was not there
    with pytest.raises(NeedsBakeError, match=f"{what}.*: bake again"):
        group_factors(before, after)


def test_walls_that_begin_to_glow_want_a_bake():
    scene = lit_room()
    emission = scene.surfaces.emission.copy()
    emission[0] = 1.0
    glowing = replace(scene, surfaces=replace(scene.surfaces, emission=emission))
    with pytest.raises(NeedsBakeError, match="Surfaces that were dark have begun to glow since the bake: bake again"):
        group_factors(state_of(scene), state_of(glowing))


def test_a_new_lamp_wants_a_bake():
    scene = lit_room()
    more = replace(scene, lights=(scene.lights[0], *scene.lights))
    for names in (("Other", *LAMPS), ("Lamp", *LAMPS)):
        with pytest.raises(NeedsBakeError, match=f"The lamp '{names[0]}' was added since the bake"):
            group_factors(state_of(scene), state_of(more, names))


def test_another_sun_in_the_sky_wants_a_bake():
    scene = lit_room()
    more = replace(scene, lights=(*scene.lights, SunLight(np.array([0.0, 0.0, 1.0]), np.ones(3))))
    with pytest.raises(NeedsBakeError, match="The picture of the world"):
        group_factors(state_of(scene), state_of(more))


def test_textured_light_of_many_triangles_is_refused():
    scene = lit_room()
    count = MOST_RUNS + 1
    surfaces = replace(
        scene.surfaces,
        triangles=np.tile(scene.surfaces.triangles[:1], (count, 1)),
        objects=np.zeros(count, int),
        emission=np.arange(3.0 * count).reshape(-1, 3),
    )
    with pytest.raises(NeedsBakeError, match="too varied"):
        state_of(replace(scene, surfaces=surfaces))
