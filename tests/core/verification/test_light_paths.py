"""Reference light against closed solutions: what has no short-cuts must be right on the mean, and know its noise."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.gathering.receivers import build_receivers
from radiosity.core.lights import PointLight
from radiosity.core.progress import finish
from radiosity.core.verification.light_paths import PathScene, direct_reference, followed_light
from radiosity.core.visibility.embree import RayPool

from tests.bakes import Thing, scene_of
from tests.scenes import box, cornell_box, furnace_box, grid, inward_sphere


def irradiance(scene, paths=64, seed=0, threads=1):
    """Answers (2, r, 3) for all receivers of a scene."""
    path_scene = PathScene.of(scene)
    receivers = build_receivers(scene.receivers, path_scene.frame)
    with RayPool(threads) as pool:
        direct, _ = finish(direct_reference(path_scene, receivers.points, receivers.normals, seed, pool))
        light = finish(followed_light(path_scene, receivers.points, receivers.normals, paths, (seed,), pool))
    return direct + light.indirect, light


def assert_mean(answers, expected):
    """The mean over receivers within four of its standard errors, as the receivers' own scatter tells them."""
    values = answers.mean(axis=0)
    error = values.std(axis=0) / np.sqrt(len(values))
    assert np.all(np.abs(values.mean(axis=0) - expected) < 4 * error + 1e-6 * np.abs(expected))
    # And that is a strong statement.
    assert np.all(error < 0.02 * np.abs(expected))


@pytest.mark.parametrize("reflectance", [0.5, 0.9])
def test_furnace(reflectance):
    answers, light = irradiance(furnace_box(6, reflectance, 1.0))
    assert_mean(answers, 1 / (1 - reflectance))
    assert light.rays > 64 * answers.shape[1]


def test_scatter_stays_bounded_among_bright_walls():
    answers, _ = irradiance(furnace_box(2, 0.98, 0.02), paths=256)
    # A path meets 1 / (1 - rho) surfaces on the mean, as many give or take: 128 of each answer err by a tenth.
    assert np.abs(answers - 1).max() < 0.5
    assert answers.std() < 2 / np.sqrt(128)


def test_integrating_sphere():
    intensity, rho = np.array([1.0, 2.0, 3.0]), 0.6
    lamp = PointLight(np.zeros(3), intensity)
    scene = replace(inward_sphere(10, reflectance=rho, emission=0.0), lights=(lamp,))
    answers, _ = irradiance(scene)
    # E = Phi / A / (1 - rho) with A the sphere's area; of 600 facets it is a little smaller.
    total = answers.mean(axis=(0, 1)) / (intensity / (1 - rho))
    np.testing.assert_allclose(total, 1.0, rtol=0.02)
    # All channels took the same paths.
    assert np.ptp(total) < 1e-6


def test_open_floor_under_an_even_sky_has_no_noise():
    vertices, faces = grid(((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)), 3, 3)
    answers, light = irradiance(scene_of(Thing(vertices, faces), sky=2.0), paths=16)
    np.testing.assert_allclose(answers, 2 * np.pi, rtol=1e-6)
    assert light.rays == 16 * answers.shape[1]


def test_veil_lets_its_share_through():
    vertices, faces, _ = box((2.0, 2.0, 2.0), 1)
    floor, floor_faces = grid(((0.5, 0.5, 1), (1.5, 0.5, 1), (1.5, 1.5, 1), (0.5, 1.5, 1)), 6, 6)
    veil = Thing(vertices, faces, reflectance=0.0, transmittance=0.25, receives=False)
    answers, _ = irradiance(scene_of(veil, Thing(floor, floor_faces, reflectance=0.0), sky=1.0), paths=512)
    assert_mean(answers, 0.25 * np.pi)


def test_backs_reflect_only_where_both_sides_do():
    vertices, faces = grid(((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)), 4, 4)
    # The front of the cover looks away from the floor, so that its back is what the floor sees.
    cover, cover_faces = grid(((-1, -1, 0.2), (1, -1, 0.2), (1, 1, 0.2), (-1, 1, 0.2)), 1, 1)
    lit = []
    for two_sided in (True, False):
        thing = Thing(cover, cover_faces, reflectance=0.9, two_sided=two_sided, receives=False)
        answers, light = irradiance(scene_of(Thing(vertices, faces, reflectance=0.9), thing, sky=1.0), paths=256)
        lit.append(answers.mean())
        assert light.backs.max() > 0.6
    assert lit[0] > 1.5 * lit[1] > 0


def test_color_is_read_at_the_very_place():
    scene = furnace_box(2, reflectance=0.9, emission=0.25)
    count = len(scene.surfaces.triangles)

    class Half:
        """Emits 2 on one half of each triangle and nothing on the other, and reflects half everywhere."""

        def __call__(self, triangles, barycentric):
            np.testing.assert_allclose(barycentric.sum(axis=1), 1, atol=1e-6)
            glow = np.where(barycentric[:, 1] > barycentric[:, 2], 2.0, 0.0)
            return np.full((len(triangles), 3), 0.5), np.repeat(glow[:, None], 3, axis=1), np.zeros(len(triangles))

    surfaces = replace(scene.surfaces, textured=np.ones(count, bool), shader=Half())
    answers, _ = irradiance(replace(scene, surfaces=surfaces), paths=256)
    assert answers.mean() == pytest.approx(2.0, rel=0.03)


def test_a_divided_lamp_is_one_light_and_counts_once():
    fine, coarse = cornell_box(20), cornell_box(5)
    lights = [PathScene.of(scene).lights for scene in (fine, coarse)]
    assert [len(found) for found in lights] == [1, 1]
    np.testing.assert_allclose(lights[0][0].power, lights[1][0].power, rtol=1e-6)
    means = [irradiance(scene, paths=64)[0].mean(axis=(0, 1)) for scene in (fine, coarse)]
    # Different receivers, so only roughly; twice the lamp would be twice the light.
    np.testing.assert_allclose(means[0], means[1], rtol=0.25)


def test_many_lamps_by_one_ray_each_give_the_sum():
    vertices, faces, _ = box((1.0, 1.0, 1.0), 4)
    generator = np.random.default_rng(5)
    places, strengths = generator.uniform(0.2, 0.8, (6, 3)), generator.uniform(0.01, 0.3, 6)
    alone = [PointLight(p, np.full(3, s), radius=0.03) for p, s in zip(places, strengths, strict=True)]
    together, _ = irradiance(scene_of(Thing(vertices, faces, 0.7), lights=alone), paths=256)
    each = [irradiance(scene_of(Thing(vertices, faces, 0.7), lights=(lamp,)), paths=256)[0] for lamp in alone]
    difference = together.mean(axis=0) - np.sum(each, axis=0).mean(axis=0)
    error = difference.std(axis=0) / np.sqrt(len(difference))
    assert np.all(np.abs(difference.mean(axis=0)) < 4 * error)
    assert np.all(error < 0.01 * together.mean())


def test_two_answers_are_independent():
    answers, _ = irradiance(cornell_box(5), paths=128)
    truth = irradiance(cornell_box(5), paths=2048, seed=1)[0].mean(axis=0)
    one, other = (answers - truth)[:, :, 0]
    correlation = (one * other).mean() / np.sqrt((one**2).mean() * (other**2).mean())
    # What the truth itself errs by is common to both: of each answer's variance, half of its paths
    # against all of those, a thirty-second.
    assert abs(correlation) < 1 / 32 + 4 / np.sqrt(len(one))


def test_threads_do_not_change_a_bit():
    one, two = (irradiance(cornell_box(6), paths=64, threads=threads)[0] for threads in (1, 2))
    assert np.array_equal(one, two)
