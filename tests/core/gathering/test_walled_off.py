"""Corners that stand outside the room in which their face is seen: they must not bring the outside's light in."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core import bake as module
from radiosity.core.gathering.walled_off import APART, WalledOff
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


def without_stage(monkeypatch, scene, accuracy):
    """Light of all receivers where none is looked for behind walls."""
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
    return all_light(bake(scene, accuracy))


def test_where_nothing_is_cut_off_no_bit_changes(monkeypatch):
    scene = cornell_box(12)
    with_stage = all_light(bake(scene, 0.1))
    assert np.array_equal(without_stage(monkeypatch, scene, 0.1), with_stage)


def test_corner_dim_because_walls_meet_there_stays_dim(monkeypatch):
    # Walls that lean inward stand between the corners of the ceiling and all the rest of it, as measured walls do.
    top, bottom = [(0, 0, 0.9), (0, 1, 0.9), (1, 1, 0.9), (1, 0, 0.9)], [(0.2, 0.2), (0.2, 0.8), (0.8, 0.8), (0.8, 0.2)]
    room = np.array([*top, *((x, y, 0) for x, y in bottom)], float)
    sides = [(4, 7, 6, 5), *((i, (i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(4))]
    lamp = PointLight(np.array([0.5, 0.5, 0.5]), np.full(3, 0.1), 0.02)
    scene = scene_of(Thing(room[:4], np.array([(0, 1, 2, 3)])), Thing(room, np.array(sides)), lights=(lamp,))
    light = all_light(bake(scene, 0.05))
    assert np.array_equal(without_stage(monkeypatch, scene, 0.05)[:4], light[:4])


def test_hollow_full_of_backs_is_no_room(monkeypatch):
    # Most of the panel lies in a box without a bottom, into which a little light leaks from below.
    quad = grid([(0.05, 0.5, 0.1), (0.95, 0.5, 0.1), (0.95, 0.5, 0.9), (0.05, 0.5, 0.9)], 1, 1)
    vertices, faces, sides = box((0.77, 0.2, 0.86), 2)
    cover = Thing(vertices + np.array([0.2, 0.4, 0.09]), faces[sides != 4][:, ::-1], receives=False)
    walls = Thing(*box((1.0, 1.0, 1.0), 8)[:2], receives=False)
    scene = scene_of(Thing(*quad, name="Panel"), walls, cover, lights=(LAMP,))
    light = all_light(bake(scene, 0.05))
    outside = [0, 3]
    assert np.array_equal(without_stage(monkeypatch, scene, 0.05)[outside], light[outside])
    # It is dark enough to be taken for a dark room.
    assert light[outside].min() > APART * light[[1, 2]].max()


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
