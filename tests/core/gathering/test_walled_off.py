"""Corners that stand outside the room in which their face is seen: they must not bring the outside's light in."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core import bake as module
from radiosity.core.gathering.walled_off import WalledOff
from radiosity.core.lights import PointLight
from radiosity.core.visibility.embree import is_available

from tests.bakes import Thing, all_light, bake, corner_light, scene_of
from tests.scenes import box, cornell_box, grid

pytestmark = pytest.mark.skipif(not is_available(), reason="rays need embreex")

LAMP = PointLight(np.array([0.5, 0.25, 0.7]), np.full(3, 0.01), 0.02)


def room(panel, sky=None, divisions=1):
    """A closed room of side 1 with an upright panel across its middle, by default of one quad, and what is outside."""
    low, high = panel
    quad = grid([(low, 0.5, low), (high, 0.5, low), (high, 0.5, high), (low, 0.5, high)], divisions, divisions)
    vertices, faces, _ = box((1.0, 1.0, 1.0), 8)
    return scene_of(Thing(*quad, name="Panel"), Thing(vertices, faces), lights=(LAMP,), sky=sky)


@pytest.fixture(scope="module")
def inside():
    """Mean light of a panel that ends in the room, finely divided."""
    return corner_light(bake(room((0.01, 0.99), divisions=12), 0.05)).mean()


def test_wall_that_reaches_out_into_daylight_is_lit_as_its_room(inside):
    light = corner_light(bake(room((-0.08, 1.08), sky=1.0), 0.05))
    # Outdoors a corner gets half of pi from the sky, far more than the room has.
    assert np.pi / 2 > 20 * inside
    assert np.all((light > 0.4 * inside) & (light < 2.5 * inside))


def test_corner_that_is_mostly_outdoors_keeps_daylight():
    light = corner_light(bake(room((-1.5, 2.5), sky=1.0), 0.05))
    assert np.all(light > 1.0)


def test_corner_in_the_dark_takes_the_light_of_the_room(inside):
    light = corner_light(bake(room((-0.3, 1.3)), 0.05))
    assert np.all((light > 0.4 * inside) & (light < 2.5 * inside))


def test_where_nothing_is_cut_off_no_bit_changes(monkeypatch):
    scene = cornell_box(12)
    with_stage = all_light(bake(scene))
    nobody = np.empty(0, np.int64)
    nothing = WalledOff(
        nobody,
        np.empty(0),
        np.empty(0, bool),
        np.empty(0, bool),
        np.empty((0, 3), np.float32),
        np.empty((0, 3), np.float32),
        nobody,
        np.empty((0, 3), np.float32),
        np.empty((0, 3), np.float32),
        np.empty(0),
    )
    monkeypatch.setattr(module, "find_walled_off", lambda *_: nothing)
    assert np.array_equal(all_light(bake(scene)), with_stage)


def test_mirrored_and_broken_meshes_are_looked_at_the_same():
    scene = room((-0.08, 1.08), sky=1.0)
    panel, walls = scene.receivers
    expected = corner_light(bake(scene, 0.05))
    # The order of corners of a mirrored object runs the other way around its normal.
    flipped = replace(
        panel,
        corner_vertices=panel.corner_vertices[::-1].copy(),
        corner_normals=panel.corner_normals[::-1].copy(),
        flipped=True,
    )
    found = corner_light(bake(replace(scene, receivers=(flipped, walls)), 0.05))[::-1]
    np.testing.assert_allclose(found, expected, rtol=0.05)
    positions = panel.positions.copy()
    positions[0] = np.nan
    broken = corner_light(bake(replace(scene, receivers=(replace(panel, positions=positions), walls)), 0.05))
    assert np.isfinite(broken).all()
