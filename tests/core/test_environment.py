"""Patches from polygons: measured right, triangulated right, refused by name."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity import core
from radiosity.core.errors import EmptySceneError, SettingsError

from tests.reference_cases import form_factor_cases, ids, polygons_of

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
ARROW = np.array([[0, 0, 0], [2, -1, 0], [1, 0, 0], [2, 1, 0]], dtype=float)  # inward corner at (1, 0)


def triangle_vectors(environment):
    corners = environment.vertices[environment.triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def assert_triangles_tile_patches(environment):
    """Upright triangles whose areas add up can neither overlap nor leave anything out."""
    vectors = triangle_vectors(environment)
    upright = np.einsum("ti,ti->t", vectors, environment.normals[environment.triangle_patches])
    sides = np.where(environment.two_sided, 2, 1)
    totals = np.bincount(environment.triangle_patches, upright, len(environment))
    scale = environment.areas.max()
    assert upright.min() >= -1e-12 * scale
    np.testing.assert_allclose(totals * sides, environment.areas, rtol=1e-12, atol=1e-13 * scale)


@st.composite
def star_polygons(draw):
    """Concave loops, star-shaped about their center, anywhere in space."""
    count = draw(st.integers(4, 24))
    generator = np.random.default_rng(draw(st.integers(0, 2**31)))
    angles = (np.arange(count) + 0.8 * generator.random(count)) * 2 * np.pi / count
    radii = 0.05 + generator.random(count)
    loop = np.stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(count)], axis=1)
    rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    return loop @ rotation.T + generator.normal(size=3)


@settings(max_examples=60, deadline=None)
@given(star_polygons())
def test_concave_polygons_are_tiled_by_their_triangles(loop):
    environment = core.Environment.from_polygons([loop])
    assert_triangles_tile_patches(environment)
    corners = environment.vertices[environment.triangles]
    areas = np.linalg.norm(triangle_vectors(environment), axis=1)
    np.testing.assert_allclose(areas @ corners.mean(axis=1) / areas.sum(), environment.centroids[0], atol=1e-12)


def test_reference_geometry_is_tiled_by_its_triangles():
    cases = form_factor_cases()
    for name in ids(cases, "polygon-polygon", "enclosure", "obstructed", "extreme"):
        polygons, _ = polygons_of(cases[name])
        assert_triangles_tile_patches(core.Environment.from_polygons(polygons))


def test_areas_normals_and_centroids_of_simple_shapes():
    environment = core.Environment.from_polygons([SQUARE, ARROW, SQUARE[:3]], two_sided=[False, False, True])
    np.testing.assert_allclose(environment.areas, [1, 1, 1], rtol=1e-15)
    np.testing.assert_allclose(environment.normals, np.tile([0, 0, 1], (3, 1)), atol=1e-15)
    np.testing.assert_allclose(environment.centroids, [[0.5, 0.5, 0], [1, 0, 0], [2 / 3, 1 / 3, 0]], atol=1e-15)


@pytest.mark.parametrize("scale", [1e-5, 1e5])
def test_measures_scale_and_move_with_the_polygon(scale):
    here = core.Environment.from_polygons([ARROW])
    there = core.Environment.from_polygons([ARROW * scale + 1e5 * scale])
    # Coordinates 1e5 sizes from the origin keep 11 digits of the polygon.
    np.testing.assert_allclose(there.areas, here.areas * scale**2, rtol=1e-9)
    np.testing.assert_allclose((there.centroids - 1e5 * scale) / scale, here.centroids, atol=1e-9)


def test_hole_connected_by_a_bridge_is_left_out():
    outer = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]
    hole = [[1, 1], [1, 3], [3, 3], [3, 1], [1, 1]]
    loop = np.column_stack([np.array(outer + hole, float), np.zeros(10)])
    environment = core.Environment.from_polygons([loop])
    assert environment.areas[0] == pytest.approx(12, rel=1e-14)
    assert_triangles_tile_patches(environment)


def test_repeated_corner_makes_a_triangle():
    environment = core.Environment.from_polygons([SQUARE[[0, 1, 2, 2]]])
    assert environment.areas[0] == 0.5
    assert_triangles_tile_patches(environment)


@pytest.mark.parametrize(
    "polygon, reason",
    [
        (SQUARE[:2], "3 or more corners"),
        (np.where(np.eye(4, 3) > 0, np.nan, SQUARE), "not finite"),
        (np.where(np.eye(4, 3) > 0, np.inf, SQUARE), "not finite"),
        (np.array([[0, 0, 0.01], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), "not planar"),
        (np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 0.5, 0]]), "crosses itself"),
        (np.array([[np.cos(a), np.sin(a), 0] for a in np.arange(5) * 0.8 * np.pi]), "crosses itself"),
    ],
    ids=["two corners", "nan", "infinite", "bent", "bow tie", "pentagram"],
)
def test_unusable_polygon_is_refused_by_number(polygon, reason):
    with pytest.raises(core.InvalidPolygonError, match=rf"Polygon 1 .*{reason}"):
        core.Environment.from_polygons([SQUARE, polygon])


def test_polygon_without_area_is_left_out_with_a_warning():
    with pytest.warns(UserWarning, match="Polygon 1 without area"):
        environment = core.Environment.from_polygons([SQUARE, [[0, 0, 0.5], [0.5, 0, 0.5], [1, 0, 0.5]]])
    assert environment.areas.tolist() == [1.0, 0.0]
    assert environment.warnings == ("Polygon 1 without area: left out, all its form factors are 0",)
    assert np.isfinite(environment.centroids).all()


def test_no_polygon_is_an_error():
    with pytest.raises(EmptySceneError, match="at least one polygon"):
        core.Environment.from_polygons([])


@pytest.mark.parametrize("value, clamped", [(1.2, 1.0), (-0.1, 0.0)])
def test_reflectance_out_of_range_is_clamped_with_a_warning(value, clamped):
    with pytest.warns(UserWarning, match="Patch 1 with a reflectance outside 0 to 1"):
        environment = core.Environment.from_polygons([SQUARE, ARROW], reflectance=[0.5, value])
    assert environment.reflectance[1].tolist() == [clamped] * 3


@pytest.mark.parametrize(
    "arguments, reason",
    [
        ({"reflectance": [0.5, np.nan]}, "Reflectance of patch 1 is not a number"),
        ({"emission": [-1.0, 0.0]}, "Emission of patch 0"),
        ({"emission": [[0, 0, np.inf], [0, 0, 0]]}, "Emission of patch 0"),
        ({"reflectance": [0.5, 0.5, 0.5]}, r"Reflectance must be .* not of shape \(3,\)"),
    ],
)
def test_unusable_colors_are_refused(arguments, reason):
    with pytest.raises(SettingsError, match=reason):
        core.Environment.from_polygons([SQUARE, ARROW], **arguments)


def test_colors_take_one_number_one_per_patch_or_three():
    make = core.Environment.from_polygons
    polygons = [SQUARE, ARROW]
    assert make(polygons, reflectance=0.25).reflectance.tolist() == [[0.25] * 3] * 2
    assert make(polygons, emission=[1, 2]).emission.tolist() == [[1, 1, 1], [2, 2, 2]]
    assert make(polygons, emission=[[1, 2, 3], [4, 5, 6]]).emission.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert not make(polygons).emission.any()


def test_environment_cannot_be_changed():
    environment = core.Environment.from_polygons([SQUARE])
    with pytest.raises(ValueError, match="read-only"):
        environment.areas[0] = 2
