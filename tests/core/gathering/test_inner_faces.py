"""Faces inside solids of reshaped meshes take the light of the faces around them."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.lights import PointLight
from radiosity.core.visibility.embree import is_available

from tests.bakes import Thing, bake, corner_light, scene_of
from tests.scenes import box, grid

pytestmark = pytest.mark.skipif(not is_available(), reason="rays need embreex")

#: Corners of a cube, its faces seen from outside, and last a face across its inside.
VERTICES = np.array([(x, y, z) for z in (0.2, 0.6) for y in (0.3, 0.7) for x in (0.3, 0.7)])
FACES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6), (0, 3, 7, 4)]


def lit(off_surface, faces=FACES):
    """Light (f, 4) at the corners of the cube in a lit room."""
    vertices, walls, _ = box((1.0, 1.0, 1.0), 6)
    lamp = PointLight(np.array([0.2, 0.15, 0.9]), np.full(3, 0.1), 0.02)
    scene = scene_of(
        Thing(VERTICES, np.array(faces), name="Cube"), Thing(vertices, walls, receives=False), lights=(lamp,)
    )
    cube = replace(scene.receivers[0], is_off_surface=off_surface)
    return corner_light(bake(replace(scene, receivers=(cube,)), 0.1)).mean(axis=1).reshape(-1, 4)


def test_face_inside_takes_the_mean_of_those_at_its_vertices():
    light = lit(True)
    for corner, vertex in enumerate(FACES[-1]):
        others = [light[f, face.index(vertex)] for f, face in enumerate(FACES[:-1]) if vertex in face]
        assert light[-1, corner] == pytest.approx(np.mean(others), rel=1e-5)
    assert light.min() > 0


def test_other_meshes_keep_what_is_there():
    assert lit(False)[-1].max() < 1e-3 * lit(False)[:-1].mean()


def test_faces_in_the_shade_stay_as_they_are():
    with_face, without = lit(True), lit(True, FACES[:-1])
    # The side turned away from the lamp is dim, but sees the room: nothing is done to it.
    np.testing.assert_allclose(with_face[:-1], without, rtol=0.05)
    sheet = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 1, 1)
    scene = scene_of(Thing(*sheet), lights=(PointLight(np.array([0.5, 0.5, -1.0]), np.ones(3)),), sky=1e-6)
    dark = replace(scene.receivers[0], is_off_surface=True)
    assert corner_light(bake(replace(scene, receivers=(dark,)), 0.1)).max() < 1e-4
