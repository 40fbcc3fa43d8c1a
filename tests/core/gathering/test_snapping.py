"""Receivers off the traced surface: moved onto it, or left alone."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.lights import PointLight

from tests.bakes import Thing, bake, corner_light, scene_of
from tests.scenes import grid

LAMP = PointLight(np.array([0.5, 0.5, 1.0]), np.ones(3))


def floor_with_receivers_at(height, is_off_surface):
    floor = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 6, 6)
    scene = scene_of(Thing(*floor, name="Floor"), lights=[LAMP])
    mesh = scene.receivers[0]
    moved = replace(mesh, positions=mesh.positions + np.array([0, 0, height]), is_off_surface=is_off_surface)
    return replace(scene, receivers=(moved,))


@pytest.mark.parametrize("height", [-0.03, 0.03])
def test_receivers_off_the_surface_take_its_light(height):
    on_it = corner_light(bake(floor_with_receivers_at(0.0, False)))
    snapped = corner_light(bake(floor_with_receivers_at(height, True)))
    # Light varies by less than this over the float32 steps that moving there and back costs.
    np.testing.assert_allclose(snapped, on_it, rtol=1e-4)


def test_receivers_that_lie_where_they_should_are_not_moved():
    below = corner_light(bake(floor_with_receivers_at(-0.03, False)))
    assert not below.any()


def test_a_receiver_with_no_surface_near_stays():
    far = corner_light(bake(floor_with_receivers_at(0.5, True)))
    # The closed form at its own place: intensity cos / distance^2, with the lamp half a meter above.
    mesh = floor_with_receivers_at(0.5, True).receivers[0]
    towards = LAMP.position - mesh.positions[mesh.corner_vertices]
    expected = towards[:, 2] / np.linalg.norm(towards, axis=1) ** 3
    # The inset of border receivers moves them by a thousandth of a face.
    np.testing.assert_allclose(far[:, 0], expected, rtol=2e-3)
