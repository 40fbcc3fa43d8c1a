"""The estimated error asks only receivers whose light is their own."""

import numpy as np
import pytest
from radiosity.core.lights import PointLight
from radiosity.core.visibility.embree import is_available

from tests.bakes import Thing, all_light, bake, scene_of
from tests.scenes import box, grid

pytestmark = pytest.mark.skipif(not is_available(), reason="rays need embreex")


def test_a_floor_that_reaches_beyond_its_room_counts_for_what_is_seen_of_it():
    # The corners of the floor lie outside, in the dark, and take the light of the room: that is no error.
    vertices, faces, _ = box((1.0, 1.0, 1.0), 6)
    floor = grid([(-0.2, -0.2, 0.1), (1.2, -0.2, 0.1), (1.2, 1.2, 0.1), (-0.2, 1.2, 0.1)], 1, 1)
    lamp = PointLight(np.array([0.5, 0.5, 0.8]), np.ones(3), 0.02)
    scene = scene_of(Thing(*floor, reflectance=0.5), Thing(vertices, faces, reflectance=0.5), lights=[lamp])
    result = bake(scene, accuracy=0.03)
    floor_light = all_light(result)[:4]
    assert floor_light.min() > 0.1 * floor_light.max()
    assert result.statistics["estimated_error"] < 0.03
