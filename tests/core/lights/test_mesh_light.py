"""Mesh lights: many emissive triangles as one light."""

import numpy as np
import pytest
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.lights.emissive import LARGEST_RADIUS, MANY_TRIANGLES, area_lights
from radiosity.core.lights.emissive_groups import are_empty, connected_groups
from radiosity.core.lights.light_tree import FAR, LightTree
from radiosity.core.lights.mesh import SCOUTS, MeshLight

from tests.bakes import Thing, all_light, bake, scene_of
from tests.scenes import box, grid, inward_sphere, joined

FLOOR = Thing(*grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], 16, 16), reflectance=0.0, name="Floor")


def sphere(divisions=6, radius=0.1, center=(0.0, 0.0, 0.6)):
    """Vertices and triangles of a sphere seen from outside."""
    surfaces = inward_sphere(divisions, radius).surfaces
    return surfaces.vertices + center, surfaces.triangles[:, ::-1]


def directions_around(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def exact_sum(triangles, intensities, points, normals, two_sided):
    return sum(
        intensity * point_to_polygon(points, normals, triangle, two_sided)
        for triangle, intensity in zip(triangles, intensities, strict=True)
    )


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("divisions", [2, 6])
def test_the_tree_sums_the_closed_forms_of_its_triangles(divisions, two_sided):
    vertices, triangles = sphere(divisions)
    corners = vertices[triangles]
    intensities = np.random.default_rng(1).uniform(0.5, 2, len(corners))
    tree = LightTree.of(corners, intensities)
    points = (0.0, 0.0, 0.6) + directions_around(300) * np.geomspace(0.11, 3, 300)[:, None]
    normals = directions_around(300, seed=2)
    exact = exact_sum(corners, intensities, points, normals, two_sided)
    found = tree.configuration_factors(points, normals, two_sided)
    # The bounds of the module: 2 % of what a receiver facing the light would get, 1 % RMS.
    facing = (0.0, 0.0, 0.6) - points
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    error = (found - exact) / exact_sum(corners, intensities, points, facing, two_sided)
    assert np.abs(error).max() < 0.02
    assert np.sqrt((error**2).mean()) < 0.01


def test_a_body_whose_sides_cancel_exactly_shines():
    # Of a cube around the origin the vector areas sum to zero to the last bit.
    vertices, faces, _ = box(divisions=2)
    corners = (vertices - 0.5)[np.concatenate([faces[:, [0, 2, 1]], faces[:, [0, 3, 2]]])]
    tree = LightTree.of(corners, np.ones(len(corners)))
    assert tree.sizes[0] == 0
    points = 4 * directions_around(40)
    exact = exact_sum(corners, np.ones(len(corners)), points, -points / 4, False)
    np.testing.assert_allclose(tree.configuration_factors(points, -points / 4, False), exact, rtol=0.02)


def test_a_near_light_is_exact():
    corners = sphere(2)[0][sphere(2)[1]]
    tree = LightTree.of(corners, np.ones(len(corners)))
    points = (0.0, 0.0, 0.6) + 0.12 * directions_around(50)
    normals = directions_around(50, seed=3)
    assert 0.12 < FAR * tree.radii[tree.children < 0].min()
    exact = exact_sum(corners, np.ones(len(corners)), points, normals, False)
    # Only triangles on the far side, which turn away, are at all far.
    np.testing.assert_allclose(tree.configuration_factors(points, normals, False), exact, atol=2e-3 * exact.max())


def test_nodes_hold_their_triangles():
    vertices, triangles = sphere(3)
    tree = LightTree.of(vertices[triangles], np.ones(len(triangles)))
    assert len(tree.starts) == 2 * len(triangles) - 1
    inner = np.flatnonzero(tree.children >= 0)
    first = tree.children[inner]
    np.testing.assert_array_equal(tree.starts[first], tree.starts[inner])
    np.testing.assert_array_equal(tree.stops[first], tree.starts[first + 1])
    np.testing.assert_array_equal(tree.stops[first + 1], tree.stops[inner])
    np.testing.assert_allclose(tree.vectors[first] + tree.vectors[first + 1], tree.vectors[inner], atol=1e-15)
    for node in range(len(tree.starts)):
        corners = tree.triangles[tree.starts[node] : tree.stops[node]].reshape(-1, 3)
        assert np.linalg.norm(corners - tree.centers[node], axis=1).max() == pytest.approx(tree.radii[node])


def test_power_and_frame():
    vertices, triangles = sphere()
    light = MeshLight(vertices[triangles], np.ones(len(triangles)), np.array([1.0, 2.0, 3.0]), two_sided=True)
    area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(vertices[triangles], axis=1), 1, 0)), axis=1).sum() / 2
    np.testing.assert_allclose(light.power, 2 * area * np.array([1, 2, 3]))
    moved = light.in_frame(np.array([1.0, 0.0, 0.0]), 4.0)
    points, normals = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        moved.geometry((points - (1, 0, 0)) / 4, normals), light.geometry(points, normals), rtol=1e-12
    )


def test_scouts_go_to_the_side_that_is_seen():
    vertices, triangles = sphere()
    light = MeshLight(vertices[triangles], np.ones(len(triangles)), np.ones(3))
    points = (0.0, 0.0, 0.6) + 0.5 * directions_around(40)
    segments = light.scout(points)
    assert segments.shape == (40, SCOUTS, 3)
    # All end on the near half: no farther than the rim, but for the triangles' own size.
    rim = np.sqrt(0.5**2 - 0.1**2)
    assert (np.linalg.norm(segments, axis=2) < rim + 0.02).all()
    assert len(np.unique(segments[0].round(6), axis=0)) == SCOUTS


def test_aimed_places_weigh_as_their_factors():
    vertices, triangles = sphere()
    light = MeshLight(vertices[triangles], np.ones(len(triangles)), np.ones(3))
    points, normals = np.array([[0.3, 0.1, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    _, weights = light.aim(points, normals, 4096)
    estimate = weights.mean(axis=1) * light.area / np.pi
    # 4096 well-spread places on half a sphere; the rim where they stop counting has no weight.
    np.testing.assert_allclose(estimate, light.geometry(points, normals), rtol=0.01)


def test_groups_hang_together_by_place_and_closed_ones_are_known():
    ball = sphere(3)
    split = ball[0][ball[1]].reshape(-1, 3), np.arange(3 * len(ball[1])).reshape(-1, 3)  # no shared vertex
    bowl = ball[0] + (0.5, 0, 0), ball[1][: len(ball[1]) // 2]
    hollow = ball[0] + (0.9, 0, 0), ball[1][:, ::-1]
    vertices, triangles, part = joined(split, bowl, hollow)
    groups, closed = connected_groups(vertices[triangles])
    assert len(closed) == 3
    for number in range(3):
        assert len(np.unique(groups[part == number])) == 1
    # The bowl is open, and the last looks into itself.
    assert [bool(closed[groups[part == number][0]]) for number in range(3)] == [True, False, False]
    corner = vertices[triangles][part == 1].reshape(-1, 3).max(axis=0) - 1e-3
    empty = are_empty(vertices[triangles], groups, corner[None])
    assert empty.sum() == 2 and not empty[groups[part == 1][0]]


def room_with(vertices, triangles, emission):
    walls, faces, _ = box(divisions=1)
    quads = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    all_vertices = np.concatenate([walls - (0.5, 0.5, 0), vertices])
    all_triangles = np.concatenate([quads, triangles + len(walls)])
    glow = np.concatenate([np.zeros((len(quads), 3)), np.broadcast_to(emission, (len(triangles), 3))])
    return all_vertices, all_triangles, glow, np.ones(len(all_triangles), bool)


def test_a_bulb_is_one_light_that_shines_outward_only():
    vertices, triangles = sphere(4, 0.05)
    (light,), sampled = area_lights(*room_with(vertices, triangles, 2.0), 0.0)
    assert isinstance(light, MeshLight) and not light.two_sided
    assert sampled.sum() == len(triangles) == len(light.triangles)
    assert light.power[0] == pytest.approx(2 * np.pi * 4 * 0.05**2, rel=0.05)  # of a sphere, less its facets


def test_an_open_shade_shines_on_both_sides():
    vertices, triangles = sphere(4, 0.05)
    (light,), _ = area_lights(*room_with(vertices, triangles[: len(triangles) // 2], 2.0), 0.0)
    assert light.two_sided


def test_a_screen_with_a_picture_keeps_its_colors():
    vertices, faces = grid([(-0.05, 0, 0.5), (0.05, 0, 0.5), (0.05, 0, 0.6), (-0.05, 0, 0.6)], 4, 4)
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    emission = np.random.default_rng(0).uniform(0, 3, (len(triangles), 3))
    lights, _ = area_lights(*room_with(vertices, triangles, emission), 0.0)
    assert len(lights) == 3
    corners = vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    np.testing.assert_allclose(sum(light.power for light in lights), 2 * areas @ emission)


def test_a_long_strip_is_divided():
    vertices, faces = grid([(-0.45, 0, 0.8), (0.45, 0, 0.8), (0.45, 0.02, 0.8), (-0.45, 0.02, 0.8)], 60, 1)
    vertices[:, 2] += 0.05 * np.sin(20 * vertices[:, 0])  # bent, or it would be a few flat quads
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    lights, sampled = area_lights(*room_with(vertices, triangles, 1.0), 0.0)
    assert len(lights) > 3 and sampled.sum() == len(triangles)
    assert all(light.radius <= 2 * LARGEST_RADIUS for light in lights)
    assert sum(len(light.triangles) for light in lights) == len(triangles) > MANY_TRIANGLES


def test_a_bulb_lights_the_floor_without_noise():
    vertices, triangles = sphere(5, 0.1)
    bulb = Thing(vertices, triangles, reflectance=0.0, emission=10.0, receives=False, name="Bulb")
    light = all_light(bake(scene_of(FLOOR, bulb), accuracy=0.03))[:, 0]
    places = FLOOR.vertices[FLOOR.faces.reshape(-1)]
    corners = vertices[triangles]
    exact = 10 * exact_sum(corners, np.ones(len(corners)), places, np.tile((0.0, 0.0, 1.0), (len(places), 1)), False)
    np.testing.assert_allclose(light, exact, rtol=0.02)  # of the tree, see its module
