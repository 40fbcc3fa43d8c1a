"""Corners under what has no bottom: their faces are lit as what is seen of them."""

from dataclasses import replace

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


def stepped_floor(step):
    """A floor of one face, a corner of which goes inward in two steps; its corners 2 to 6 are those of the steps."""
    far, half = 10 - step, step / 2
    steps = [(step, 10), (step, 10 - half), (half, 10 - half), (half, far), (0, far)]
    places = [(10, 0), (10, 10), *steps, (0, 0)]
    return Thing(np.array([(x, y, 0.0) for x, y in places]), np.arange(8)[None], name="Floor")


def stepped_light(step, width):
    """Light (8,) of the stepped floor under an even sky, with a plinth over its steps."""
    cover = plinth(width)
    cover = replace(cover, vertices=cover.vertices + np.array([0, 10, 0]))
    return corner_light(bake(scene_of(stepped_floor(step), cover, sky=1.0), 0.05)).mean(axis=1)


def test_corners_of_a_face_with_many_are_lit_as_the_face():
    # All triangles of the middle step's corner lie under the plinth, as which the face is cut up here.
    np.testing.assert_allclose(stepped_light(0.4, 1.2), np.pi, rtol=0.1)


def test_corners_of_a_face_with_many_stay_dark_where_most_of_it_is():
    assert (stepped_light(4.0, 18.0)[2:7] < 0.1 * np.pi).all()


def test_corner_in_a_dark_room_drawn_inward_stays_dark():
    assert floor_light(plinth(1.0, inward=True))[0] < 0.1 * np.pi


def test_corner_stays_dark_where_most_of_its_face_does():
    assert floor_light(plinth(12.0))[0] < 0.1 * np.pi
