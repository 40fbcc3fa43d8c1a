"""Patches solved by a full matrix: what lies under a block or on both sides of a wall, against light known exactly."""

import numpy as np
import pytest
from radiosity.core.visibility.embree import is_available

from tests.bakes import Thing, scene_of, solved_patches
from tests.scenes import box, grid

pytestmark = pytest.mark.skipif(not is_available(), reason="rays need embreex")

#: Side of the block, and where its corner stands: nowhere near the border of a patch.
FOOT, CORNER = 0.4, 0.31

#: Accuracy asked for; sums over many patches come closer.
ACCURACY = 0.05


def floor_fronts(solution):
    """Rows (n,) of what looks up at the height of the floor, the lowest there is."""
    patches = solution.patches
    low = patches.points[..., 2].max(axis=1) < patches.points[..., 2].min() + 1e-5
    return np.flatnonzero(low & (patches.normals[:, 0, 2] > 0.9) & (patches.areas > 0))


def floor(columns=4):
    return grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], columns, columns)


def block(bottom):
    """Vertices and faces of a block on the floor, looking outward, with or without a bottom on it."""
    vertices, faces, sides = box((FOOT,) * 3, 1)
    return vertices + np.array([CORNER, CORNER, 0.0]), faces[sides != 4][:, ::-1] if not bottom else faces[:, ::-1]


def shining(vertices, faces, emission=1.0):
    """What shines on its front alone and reflects nothing."""
    return Thing(vertices, faces, reflectance=0.0, emission=emission, two_sided=False, receives=False)


def room_over(floor_thing, *things):
    """A room of height 1 that shines at 1 all over, on a floor: where nothing else is, the floor gets 1 everywhere."""
    vertices, faces, sides = box(divisions=1)
    return scene_of(floor_thing, shining(vertices, faces[sides != 4]), *things)


@pytest.mark.parametrize("bottom", [False, True])
@pytest.mark.parametrize("two_sided", [False, True])
def test_area_that_takes_part_is_what_does_not_lie_under_a_block(two_sided, bottom):
    solution, model = solved_patches(
        room_over(Thing(*floor()), Thing(*block(bottom), reflectance=0.5, two_sided=two_sided, receives=False)),
        ACCURACY,
        method="hemisphere",
    )
    rows = floor_fronts(solution)
    buried = solution.buried[rows]
    free = solution.areas[np.searchsorted(np.flatnonzero(solution.exchanging), rows[~buried])]
    # A patch's share is told by some hundred rays: 3 % where half of it is hidden, and some twenty even that out.
    assert free.sum() * model.frame.size**2 == pytest.approx(1 - FOOT**2, rel=0.01)


def test_patches_half_or_all_under_a_block_show_the_light_beside_it():
    solution, _ = solved_patches(room_over(Thing(*floor()), shining(*block(False))), ACCURACY, method="hemisphere")
    rows = floor_fronts(solution)
    assert solution.buried[rows].any()
    # What stands around the floor shines at 1 wherever it looks: the floor reflects half of it.
    np.testing.assert_allclose(solution.radiosity[rows], 0.5, rtol=ACCURACY)


def test_patches_on_which_a_wall_stands_show_the_light_of_one_side():
    wall = grid([(0.43, 0, 0), (0.43, 1, 0), (0.43, 1, 1), (0.43, 0, 1)], 1, 1)
    vertices, faces, sides = box(divisions=1)
    lit, dark = vertices * [0.43, 1, 1], vertices * [0.57, 1, 1] + np.array([0.43, 0, 0])
    scene = scene_of(
        Thing(*floor()),
        shining(lit, faces[(sides != 4) & (sides != 1)]),
        shining(wall[0], wall[1][:, ::-1]),
        shining(dark, faces[(sides != 4) & (sides != 0)], 0.0),
    )
    solution, _ = solved_patches(scene, ACCURACY, method="hemisphere")
    rows = floor_fronts(solution)
    assert solution.crossed[rows].any()
    seen = solution.radiosity[rows]
    is_lit = seen.mean(axis=1) > 0.25
    np.testing.assert_allclose(seen, np.where(is_lit, 0.5, 0)[:, None] * np.ones(3), atol=ACCURACY)
