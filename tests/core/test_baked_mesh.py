"""Light at corners becomes what is stored: five forms, per corner or per vertex."""

import numpy as np
import pytest
from radiosity.core.baked_mesh import BakedMesh
from radiosity.core.scene import ReceiverMesh

GENERATOR = np.random.default_rng(4)
DIRECT, INDIRECT = GENERATOR.random((2, 7, 3)).astype(np.float32)
#: Two quads of two materials that share an edge; corner 5 has no receiver, receiver 2 is buried.
RECEIVERS = np.array([0, 1, 2, 3, 4, -1, 6, 2], np.int32)
BURIED = np.arange(7) == 2
REFLECTANCE, EMISSION = np.array([[0.2, 0.4, 0.6], [0.9, 0.1, 0.0]]), np.array([[0.0, 0, 0], [1.0, 2.0, 3.0]])


def baked(**changes):
    mesh = ReceiverMesh(
        name="Two",
        positions=np.zeros((7, 3)),
        corner_vertices=np.array([0, 1, 2, 3, 1, 4, 5, 2], np.int32),
        corner_normals=np.zeros((8, 3), np.float32),
        face_offsets=np.array([0, 4, 8], np.int32),
        face_materials=np.array([0, 1], np.int32),
        palette_reflectance=REFLECTANCE,
        palette_emission=EMISSION,
        **changes,
    )
    return BakedMesh(mesh, 7, RECEIVERS, DIRECT, INDIRECT, BURIED)


def expected(bake_type, reflectance, emission):
    direct, indirect = DIRECT[RECEIVERS].astype(float), INDIRECT[RECEIVERS].astype(float)
    out = {
        "combined": reflectance * (direct + indirect) + emission,
        "lighting": direct + indirect,
        "direct": direct,
        "indirect": indirect,
        "emission": emission,
    }[bake_type]
    out = np.array(out) / np.pi
    if bake_type != "emission":
        out[5] = 0
    return out


@pytest.mark.parametrize("bake_type", ["combined", "lighting", "direct", "indirect", "emission"])
def test_corner_colors_by_palette(bake_type):
    colors = baked().corner_colors(bake_type)
    assert colors.dtype == np.float32
    reflectance, emission = np.repeat(REFLECTANCE, 4, axis=0), np.repeat(EMISSION, 4, axis=0)
    np.testing.assert_allclose(colors, expected(bake_type, reflectance, emission), rtol=1e-6)


@pytest.mark.parametrize("bake_type", ["combined", "emission", "lighting"])
def test_corner_colors_by_corner(bake_type):
    reflectance, emission = GENERATOR.random((2, 8, 3)).astype(np.float32)
    mesh = baked(corner_reflectance=reflectance, corner_emission=emission)
    np.testing.assert_allclose(mesh.corner_colors(bake_type), expected(bake_type, reflectance, emission), rtol=1e-6)


def test_impossible_colors_of_corners_are_clamped():
    reflectance = np.full((8, 3), 2.0, np.float32)
    emission = np.full((8, 3), -1.0, np.float32)
    emission[0] = np.nan
    colors = baked(corner_reflectance=reflectance, corner_emission=emission)
    np.testing.assert_allclose(
        colors.corner_colors("combined"), expected("combined", np.full((8, 3), 0.999), np.zeros((8, 3))), rtol=1e-6
    )


def test_vertex_colors_are_means_of_the_corners_that_are_not_buried():
    mesh = baked()
    corners, vertices = mesh.corner_colors("lighting").astype(float), mesh.vertex_colors("lighting")
    assert vertices.dtype == np.float32
    # Vertex 1 has corners 1 and 4; vertex 2 has the buried corners 2 and 7 only; vertex 4 none with a receiver.
    np.testing.assert_allclose(vertices[1], (corners[1] + corners[4]) / 2, rtol=1e-6)
    np.testing.assert_allclose(vertices[2], (corners[2] + corners[7]) / 2, rtol=1e-6)
    np.testing.assert_array_equal(vertices[4], 0)
    np.testing.assert_array_equal(vertices[6], 0)  # loose
    np.testing.assert_allclose(vertices[0], corners[0], rtol=1e-6)


def test_a_buried_corner_does_not_count_beside_a_free_one():
    mesh = baked()
    mixed = BakedMesh(mesh.mesh, 7, np.array([0, 2, 3, 3, 4, 5, 6, 6], np.int32), DIRECT, INDIRECT, BURIED)
    corners = mixed.corner_colors("direct").astype(float)
    np.testing.assert_allclose(mixed.vertex_colors("direct")[1], corners[4], rtol=1e-6)
    np.testing.assert_array_equal(mixed.buried_corners, np.arange(8) == 1)
