"""Corners under what has no bottom: their faces are lit as what is seen of them."""

import numpy as np
import pytest
from radiosity.core.visibility.embree import is_available

from tests.bakes import Thing, bake, corner_light, scene_of
from tests.scenes import box

pytestmark = pytest.mark.skipif(not is_available(), reason="rays need embreex")

#: A floor of one face.
FLOOR = Thing(np.array([(0.0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0)]), np.array([(0, 1, 2, 3)]), name="Floor")


def plinth(width, inward=False):
    """A box without bottom over the floor's first corner, lower than what walled-off corners look over; light creeps in
    below its sides."""
    vertices, faces, sides = box((width, width, 0.2), 2)
    faces = faces if inward else faces[:, ::-1]
    return Thing(vertices - [width / 2, width / 2, -0.01], faces[sides != 4], reflectance=0.05, receives=False)


def floor_light(*things):
    """Light (4,) at the corners of the floor under an even sky."""
    return corner_light(bake(scene_of(FLOOR, *things, sky=1.0), 0.05)).mean(axis=1)


def test_corner_under_a_plinth_is_lit_as_the_floor():
    light = floor_light(plinth(1.0))
    assert light[0] == pytest.approx(np.pi, rel=0.1)
    np.testing.assert_allclose(light[1:], np.pi, rtol=0.02)


def test_corner_in_a_dark_room_drawn_inward_stays_dark():
    assert floor_light(plinth(1.0, inward=True))[0] < 0.1 * np.pi


def test_corner_stays_dark_where_most_of_its_face_does():
    assert floor_light(plinth(12.0))[0] < 0.1 * np.pi
