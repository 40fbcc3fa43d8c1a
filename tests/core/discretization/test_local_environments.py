"""Partition into local environments: where it cuts, and what stays true of surfaces, cells and portals."""

import itertools

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.hierarchy import Hierarchy, SubdivisionLimits
from radiosity.core.discretization.local_environments import cut_at, partition, planes_between
from radiosity.core.errors import SettingsError

from benchmarks.form_factor_scenes import box, furniture
from benchmarks.solver_scenes import SCENES, row_of_rooms

DOOR = 0.9 * 2.1


def divided(environment, size=200):
    tree = Hierarchy.build(environment, SubdivisionLimits(patch_max=size, patch_min=size / 2))
    return tree.polygons(tree.patch_nodes)


def l_room():
    """Two halls of 2 x 6 m and 4 x 2 m that make an L, 3 m high."""
    outline = np.array([(0, 0), (6, 0), (6, 2), (2, 2), (2, 6), (0, 6)], dtype=float)
    floor, ceiling = (np.column_stack((outline, np.full(6, height))) for height in (0.0, 3.0))
    walls = [
        np.array([(*b, 0), (*a, 0), (*a, 3), (*b, 3)])
        for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True)
    ]
    return core.Environment.from_polygons([floor, ceiling[::-1], *walls])


def check(found):
    """What every partition must keep, whatever the scene: surfaces, convex cells, and openings between two of them."""
    areas = np.bincount(found.patches, found.pieces.areas, len(found.environment))
    np.testing.assert_allclose(areas, found.environment.areas, rtol=1e-9, atol=1e-12)
    # A piece looks where its patch does, or where the back of a two-sided one does.
    cosines = np.einsum("ij,ij->i", found.pieces.normals, found.environment.normals[found.patches])
    turned = ~found.pieces.two_sided & found.environment.two_sided[found.patches]
    np.testing.assert_allclose(np.where(turned, np.abs(cosines), cosines), 1, atol=1e-9)
    assert set(found.cells) <= set(range(found.count))
    if found.portals is None:
        assert found.portal_cells.shape == (0, 2)
        return
    corners = [np.concatenate([found.pieces.polygons[row] for row in np.flatnonzero(found.cells == cell)] or [[]])
               for cell in range(found.count)]  # fmt: skip
    size = np.ptp(found.environment.vertices, axis=0).max()
    for normal, center, cells in zip(found.portals.normals, found.portals.centroids, found.portal_cells, strict=True):
        for cell, sign in zip(cells, (1, -1), strict=True):
            heights = sign * (corners[cell].reshape(-1, 3) - center) @ normal
            assert heights.min(initial=0) > -1e-4 * size


def check_closed(found, axes=(0, 1, 2)):
    """The vector areas of the one-sided surfaces around each cell, openings among them, sum to zero.

    Along `axes` only, where walls and furniture stand on floors without bottoms of their own.
    """
    pieces, portals = found.pieces, found.portals
    total = np.zeros((found.count, 3))
    np.add.at(total, found.cells, pieces.areas[:, None] * pieces.normals)
    if portals is not None:
        for side, sign in ((0, 1), (1, -1)):
            np.add.at(total, found.portal_cells[:, side], sign * portals.areas[:, None] * portals.normals)
    np.testing.assert_allclose(total[:, axes], 0, atol=1e-9)


@pytest.mark.parametrize("name", ["furnished_room", "cornell_box"])
def test_a_scene_without_walls_inside_is_one_cell(name):
    environment = divided(SCENES[name]())
    found = partition(environment)
    check(found)
    assert found.count == 1 and found.portals is None and len(found.planes) == 0
    # Nothing is cut: neither furniture nor blocks.
    assert len(found.pieces) == len(environment)


def test_two_rooms_are_cut_at_their_wall_and_see_each_other_through_the_doorway():
    found = partition(divided(SCENES["two_rooms"]()))
    check(found)
    check_closed(found, [0])
    assert found.count == 2 and len(found.planes) == 1
    normal, offset = found.planes[0, :3], found.planes[0, 3]
    np.testing.assert_allclose(np.abs(normal), (1, 0, 0), atol=1e-12)
    assert offset / normal[0] in (pytest.approx(4.0), pytest.approx(4.1))
    assert found.portals.areas.sum() == pytest.approx(DOOR, rel=1e-9)
    corners = np.concatenate(found.portals.polygons)
    np.testing.assert_allclose(corners[:, 1:].min(axis=0), (1.5, 0), atol=1e-9)
    np.testing.assert_allclose(corners[:, 1:].max(axis=0), (2.4, 2.1), atol=1e-9)


@pytest.mark.parametrize("furnished", [True, False])
def test_a_row_of_rooms_has_a_cell_for_each_and_doorways_between(furnished):
    environment = divided(row_of_rooms(4, furnished), 60)
    found = partition(environment)
    check(found)
    check_closed(found, [0])
    assert found.count == 4 and len(found.planes) == 3
    pairs, group = np.unique(np.sort(found.portal_cells, axis=1), axis=0, return_inverse=True)
    assert len(pairs) == 3
    np.testing.assert_allclose(np.bincount(group.reshape(-1), found.portals.areas), DOOR, rtol=1e-9)
    # Rooms from left to right, each seeing the next one only.
    places = [found.pieces.centroids[found.cells == cell, 0].mean() for cell in range(4)]
    order = np.argsort(places)
    expected = {tuple(sorted(pair)) for pair in itertools.pairwise(order)}
    assert set(map(tuple, pairs.tolist())) == expected


def test_furniture_is_not_cut():
    environment = row_of_rooms(2)
    found = partition(divided(environment, 100))
    for start in (0, 5.1):
        for polygon in furniture():
            center = polygon.mean(axis=0) + np.array((start, 0, 0))
            inside = (np.abs(found.pieces.centroids - center) <= np.ptp(polygon, axis=0) / 2 + 1e-9).all(axis=1)
            assert inside.any() and len(np.unique(found.cells[inside])) == 1


def test_an_l_is_cut_at_its_inner_corner():
    environment = divided(l_room(), 150)
    found = partition(environment)
    check(found)
    check_closed(found)
    assert found.count == 2
    normal, offset = found.planes[0, :3], found.planes[0, 3]
    assert np.abs(normal[:2]).max() == pytest.approx(1) and abs(offset) == pytest.approx(2)
    assert found.portals.areas.sum() == pytest.approx(6, rel=1e-9)


def test_a_closed_wall_separates_without_portals():
    found = partition(divided(row_of_rooms(3, doorway=False)))
    check(found)
    check_closed(found, [0])
    assert found.count == 3 and found.portals is None


def test_cells_of_few_patches_are_left_alone():
    environment = divided(SCENES["two_rooms"]())
    assert partition(environment, least=len(environment)).count == 1
    assert partition(environment, least=len(environment) - 1).count == 2


def test_a_two_sided_screen_has_a_side_in_each_cell():
    polygons = box((0, 0, 0), (4, 2, 2), inward=True)
    screen = np.array([(2, 0, 0), (2, 1, 0), (2, 1, 2), (2, 0, 2)], dtype=float)
    environment = core.Environment.from_polygons([*polygons, screen], two_sided=[False] * 6 + [True])
    found = cut_at(environment, [1, 0, 0, 2])
    check(found)
    check_closed(found)
    sides = np.flatnonzero(found.patches == 6)
    assert len(sides) == 2 and not found.pieces.two_sided[sides].any()
    assert set(found.cells[sides]) == {0, 1}
    np.testing.assert_allclose(found.pieces.normals[sides].sum(axis=0), 0, atol=1e-15)
    assert found.portals.areas.sum() == pytest.approx(2)


def test_given_planes_cut_all_cells_and_openings_that_they_meet():
    environment = core.Environment.from_polygons(box((0, 0, 0), (4, 2, 2), inward=True))
    # Unit normals or not: the third is y = 1; the last one misses the scene.
    found = cut_at(environment, [(1, 0, 0, 1), (1, 0, 0, 3), (0, 5, 0, 5), (0, 0, 1, 9)], portal_size=10)
    check(found)
    check_closed(found)
    assert found.count == 6 and len(found.planes) == 5
    # Two openings cut in two, and three new ones, 1 or 2 m long.
    np.testing.assert_allclose(np.sort(found.portals.areas), [2, 2, 2, 2, 2, 2, 4], rtol=1e-9)


@pytest.mark.parametrize("plane", [(0.6, 0.8, 0, 2.3), (1, 1, 1, 3.7), (0, 0, 1, 1.3)])
def test_slanted_planes_cut_patches_and_close_their_cells(plane):
    room = box((0, 0, 0), (5, 4, 2.6), inward=True, divisions=3)
    found = cut_at(core.Environment.from_polygons(room), plane)
    check(found)
    check_closed(found)
    assert found.count == 2
    # What lies inside a block that stands in the opening belongs to the opening, too.
    blocked = cut_at(core.Environment.from_polygons(room + box((1.2, 1.1, 0.7), (2.4, 1.9, 1.75))), plane)
    check(blocked)
    assert blocked.portals.areas.sum() == pytest.approx(found.portals.areas.sum(), rel=1e-9)


def test_portals_are_as_small_as_asked_for():
    environment = divided(SCENES["two_rooms"]())
    coarse, fine = (partition(environment, portal_size=size) for size in (10, 0.2))
    assert len(coarse.portals) < 8 and fine.portals.areas.max() <= 0.2**2 * (1 + 1e-9)
    assert fine.portals.areas.sum() == pytest.approx(coarse.portals.areas.sum(), rel=1e-9)


def test_planes_between_groups_lie_in_the_face_of_one():
    environment = row_of_rooms(3, furnished=False)
    groups = np.floor(environment.centroids[:, 0] / 5.1).astype(int)
    wall = np.isclose(environment.centroids[:, 0] % 5.1, 5.05) | np.isclose(environment.centroids[:, 0] % 5.1, 5.0)
    groups[wall | np.isclose(environment.centroids[:, 0] % 5.1, 0)] = -1
    planes = planes_between(environment, groups)
    np.testing.assert_allclose(planes, [(1, 0, 0, 5.1), (1, 0, 0, 10.2)], atol=1e-12)
    found = cut_at(environment, planes)
    check(found)
    assert found.count == 3


def test_groups_that_overlap_are_named():
    environment = SCENES["furnished_room"]()
    groups = np.arange(len(environment)) % 2
    with pytest.raises(SettingsError, match="Groups 0 and 1 overlap in every direction"):
        planes_between(environment, groups)
    with pytest.raises(SettingsError, match=r"Groups must be \d+ numbers"):
        planes_between(environment, groups[1:])


@pytest.mark.parametrize("plane", [(0, 0, 0, 1), (np.nan, 0, 1, 0), (1, 0, 0, np.inf)])
def test_planes_that_are_none_are_refused(plane):
    with pytest.raises(SettingsError, match="four finite numbers"):
        cut_at(SCENES["two_rooms"](), plane)


def test_the_scene_may_lie_anywhere_and_have_any_size():
    environment = divided(SCENES["two_rooms"]())
    moved = core.Environment.from_polygons([1000 + 0.01 * polygon for polygon in environment.polygons])
    found, same = partition(moved), partition(environment)
    check(found)
    assert found.count == same.count == 2
    np.testing.assert_array_equal(found.cells, same.cells)
    assert found.portals.areas.sum() == pytest.approx(1e-4 * DOOR, rel=1e-5)
