"""Patches: where they lie, what they cover, how a hit finds its patch, and what color they have."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity.core.cleaning import clean
from radiosity.core.discretization.patch_colors import patch_colors
from radiosity.core.discretization.patches import (
    FREE_TRIANGLES,
    GROWTH,
    POINTS,
    SPLIT,
    build_patches,
    lone_cells,
    probe_segments,
    split_cells,
)

from tests.bakes import Thing, scene_of
from tests.scenes import box, cornell_box, grid, inward_sphere


def unit(scene):
    """Vertices in the unit frame, triangles and looks of a scene."""
    surfaces = scene.surfaces
    low, high = surfaces.vertices.min(axis=0), surfaces.vertices.max(axis=0)
    return (surfaces.vertices - (low + high) / 2) / (high - low).max(), surfaces.triangles, surfaces.materials


def areas_of(vertices, triangles):
    corners = vertices[triangles]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


SCENES = {
    "room": cornell_box(1),
    "divided": cornell_box(12),
    "sphere": inward_sphere(20),
    "sliver": scene_of(Thing(*grid([(0, 0, 0), (1, 0, 0), (1, 1e-3, 0), (0, 1e-3, 0)], 1, 1))),
}
every_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())


def split_all(patches, vertices, triangles, target):
    cells, _, _ = probe_segments(patches, vertices, triangles)
    return split_cells(patches, vertices, triangles, cells, target)


@every_scene
@pytest.mark.parametrize("target", [50, 800, 5000])
def test_patches_cover_all_area_and_number_about_what_was_asked(scene, target):
    vertices, triangles, looks = unit(scene)
    patches = build_patches(vertices, triangles, looks, target)
    assert len(patches.areas) == patches.count
    np.testing.assert_allclose(patches.areas.sum(), areas_of(vertices, triangles).sum(), rtol=1e-9)
    assert (patches.areas > 0).all()
    # Every triangle may have a patch of its own while there are few; a tenth of all at most lies in one triangle.
    least = min(target / 2, 0.05 * target * len(triangles))
    assert min(least, len(triangles)) <= patches.count <= (FREE_TRIANGLES + 2) * target


@every_scene
@pytest.mark.parametrize("target", [50, 800])
@pytest.mark.parametrize("split", [False, True])
def test_sample_points_lie_in_their_own_patch(scene, target, split):
    vertices, triangles, looks = unit(scene)
    patches = build_patches(vertices, triangles, looks, target)
    if split:
        patches = split_all(patches, vertices, triangles, target)
    weights = patches.point_weights
    found = patches.at(patches.point_triangles.ravel(), weights[..., 1].ravel(), weights[..., 2].ravel())
    alive = np.repeat(patches.areas > 0, POINTS)
    np.testing.assert_array_equal(found[alive], np.repeat(np.arange(patches.count), POINTS)[alive])
    places = np.einsum("pcw,pcwi->pci", weights, vertices[triangles[patches.point_triangles]])
    np.testing.assert_allclose(places, patches.points, atol=1e-6)
    np.testing.assert_allclose(weights.sum(axis=2), 1, atol=1e-6)
    assert weights.min() > 0


def test_a_cluster_is_no_lone_cell_however_much_of_it_is_one_triangle():
    # Apart from each other, broad triangles with a sliver at the side of each: a cluster's points, spread by area, all
    # lie in its broad one.
    pair = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.51, 0.51, 0)])
    vertices = np.concatenate([pair + np.array([3 * x, 3 * y, 0]) for x in range(6) for y in range(6)]) / 16
    triangles = np.concatenate([np.array([(0, 1, 2), (2, 1, 3)]) + 4 * row for row in range(36)])
    patches = build_patches(vertices, triangles, np.zeros(len(triangles), int), 12)
    clusters = np.bincount(patches.first, minlength=patches.count) > 1
    assert (clusters & (patches.point_triangles == patches.point_triangles[:, :1]).all(axis=1)).any()
    assert not clusters[lone_cells(patches)].any()


@every_scene
def test_splitting_keeps_the_area(scene):
    vertices, triangles, looks = unit(scene)
    whole = build_patches(vertices, triangles, looks, 800)
    parts = split_all(whole, vertices, triangles, 800)
    np.testing.assert_allclose(parts.areas.sum(), whole.areas.sum(), rtol=1e-9)
    gone = (parts.splits >= 0).sum()
    assert parts.count == whole.count + SPLIT**2 * gone
    assert gone <= GROWTH * 800 / SPLIT**2


@pytest.mark.parametrize("split", [False, True])
def test_hits_spread_evenly_find_patches_in_proportion_to_their_areas(split):
    vertices, triangles, looks = unit(cornell_box(1))
    patches = build_patches(vertices, triangles, looks, 200)
    if split:
        patches = split_all(patches, vertices, triangles, 50)
    generator = np.random.default_rng(0)
    count = 400_000
    areas = areas_of(vertices, triangles)
    which = generator.choice(len(triangles), count, p=areas / areas.sum())
    u, v = generator.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    hits = np.bincount(patches.at(which, u.astype(np.float32), v.astype(np.float32)), minlength=patches.count)
    expected = count * patches.areas / patches.areas.sum()
    assert (hits[expected == 0] == 0).all()
    # Poisson: five and a half standard deviations, for a thousand patches, once in ten thousand runs.
    assert (np.abs(hits - expected) < 5.5 * np.sqrt(expected) + 1).all()


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 60),
    st.floats(-1e-4, 1.0001),
    st.floats(-1e-4, 1.0001),
)
def test_hits_on_and_beyond_the_sides_stay_in_their_triangle(target, u, v):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 0], [6, 5, 0], [5, 6, 0]], float) / 6
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    patches = build_patches(vertices, triangles, np.zeros(2, int), 40 * target)
    if u + v > 1.0001:
        u, v = 1 - u, 1 - v
    for triangle in (0, 1):
        row = patches.at(np.array([triangle]), np.array([u], np.float32), np.array([v], np.float32))[0]
        assert 0 <= row < patches.count
        assert (patches.point_triangles[row] == triangle).all()


def test_clusters_join_only_what_looks_and_faces_alike():
    vertices, faces, sides = box(divisions=40)
    triangles = np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    vertices = vertices - 0.5
    looks = np.repeat(sides % 2, 2) + 10 * (vertices[triangles].mean(axis=1)[:, 2] > 0)
    target = len(triangles) // (2 * FREE_TRIANGLES) // 4
    patches = build_patches(vertices, triangles, looks, target)
    assert patches.count < len(triangles) / 4, "small triangles are clustered"
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    owner = patches.first
    order = np.argsort(owner, kind="stable")
    same = owner[order][1:] == owner[order][:-1]
    np.testing.assert_array_equal(looks[order][1:][same], looks[order][:-1][same])
    assert (np.einsum("ij,ij->i", normals[order][1:], normals[order][:-1])[same] > 0.8).all()
    middle = corners.mean(axis=1)
    assert np.linalg.norm(middle[order][1:] - middle[order][:-1], axis=1)[same].max() < 2 * patches.spacing


def test_a_ground_plane_does_not_take_the_cells_from_the_house():
    ground = Thing(*grid([(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)], 1, 1), name="Ground")
    vertices, faces, _ = box(divisions=1)
    vertices, triangles, looks = unit(scene_of(ground, Thing(vertices, faces, name="House")))
    patches = build_patches(vertices, triangles, looks, 2000)
    on_house = patches.point_triangles[:, 0] >= 2
    assert on_house.sum() > 500


# --- colors -----------------------------------------------------------------------------------------------------------


def colors(scene, target=200, shader=None, sampled=None):
    vertices, triangles, looks = unit(scene)
    surfaces = replace(clean(scene.surfaces).surfaces, vertices=vertices)
    patches = build_patches(vertices, triangles, looks, target)
    source = rows = np.arange(len(triangles))
    if shader is not None:
        surfaces = replace(surfaces, shader=shader, textured=np.ones(len(triangles), bool))
    sampled = np.zeros(len(triangles), bool) if sampled is None else sampled
    return patches, *patch_colors(patches, vertices, triangles, surfaces, source, rows, sampled)


def test_colors_of_cells_are_those_of_their_triangle():
    scene = cornell_box(1)
    patches, reflectance, emission = colors(scene)
    owner = patches.point_triangles[:, 0]
    np.testing.assert_allclose(reflectance, np.minimum(scene.surfaces.reflectance[owner], 0.999))
    np.testing.assert_allclose(emission, scene.surfaces.emission[owner])


def test_power_of_clusters_is_that_of_their_triangles():
    scene = inward_sphere(24)
    generator = np.random.default_rng(1)
    surfaces = scene.surfaces
    surfaces.emission[:] = generator.random(surfaces.emission.shape)
    patches, _, emission = colors(scene, target=60)
    assert patches.count < len(surfaces.triangles)
    vertices, triangles, _ = unit(scene)
    np.testing.assert_allclose(patches.areas @ emission, areas_of(vertices, triangles) @ surfaces.emission, rtol=1e-9)


def test_a_shader_linear_in_place_gives_each_cell_its_value_in_the_middle():
    scene = cornell_box(1)
    vertices, triangles, _ = unit(scene)
    corners = vertices[triangles]

    def shader(rows, weights):
        places = np.einsum("nk,nki->ni", weights, corners[rows])
        return 0.5 + 0.4 * places, np.abs(1 + places), np.zeros(len(rows))

    patches, reflectance, emission = colors(scene, 500, shader)
    middle = patches.points.mean(axis=1)
    np.testing.assert_allclose(reflectance, 0.5 + 0.4 * middle, atol=1e-6)
    np.testing.assert_allclose(emission, 1 + middle, atol=1e-6)


def test_what_lights_stand_for_does_not_glow_a_second_time():
    scene = cornell_box(1)
    sampled = np.arange(len(scene.surfaces.triangles)) % 2 == 0
    scene.surfaces.emission[:] = 1.0
    patches, _, emission = colors(scene, sampled=sampled)
    np.testing.assert_array_equal(emission[:, 0] == 0, sampled[patches.point_triangles[:, 0]])
