"""The scenes that other tests rest on are what they say."""

import numpy as np
import pytest

from tests.scenes import cornell_box, furnace_box, inward_sphere


def areas_and_normals(surfaces):
    corners = surfaces.vertices[surfaces.triangles]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(crosses, axis=1)
    return lengths / 2, crosses / lengths[:, None], corners.mean(axis=1)


@pytest.mark.parametrize("scene", [furnace_box(4), inward_sphere(4), cornell_box(12)], ids=["box", "sphere", "cornell"])
def test_surfaces_are_closed_and_look_inward(scene):
    areas, normals, centers = areas_and_normals(scene.surfaces)
    # The vector area of a closed surface is zero; the blocks stand open on the floor, which has no hole for them.
    flux = (areas[:, None] * normals).sum(axis=0)
    blocks = 2 * 0.3 * 0.3 if len(scene.surfaces.reflectance) > 12 * 12 * 12 else 0.0
    np.testing.assert_allclose(flux, [0, 0, blocks], atol=1e-12)
    # Divergence theorem: the enclosed volume, negative because normals look inward.
    volume = -(areas * (centers * normals).sum(axis=1)).sum() / 3
    assert volume > 0


def test_sphere_has_the_area_and_shading_normals_of_a_sphere():
    scene = inward_sphere(24, radius=2.0)
    areas, _, _ = areas_and_normals(scene.surfaces)
    # An inscribed polyhedron with edges h is smaller by about h^2 / (4 r^2), h = r (pi / 2) / 24.
    assert 4 * np.pi * 4.0 * (1 - (np.pi / 48) ** 2) < areas.sum() < 4 * np.pi * 4.0
    mesh = scene.receivers[0]
    radial = mesh.positions[mesh.corner_vertices] / -2.0
    np.testing.assert_allclose(mesh.corner_normals, radial, atol=1e-6)


def test_lamp_of_the_cornell_box_is_flush_with_the_ceiling_and_looks_down():
    surfaces = cornell_box(12).surfaces
    areas, normals, centers = areas_and_normals(surfaces)
    lamp = surfaces.emission.any(axis=1)
    np.testing.assert_allclose(normals[lamp], [[0, 0, -1]] * lamp.sum(), atol=1e-12)
    np.testing.assert_allclose(centers[lamp, 2], 1.0)
    assert areas[lamp].sum() == pytest.approx(1 / 36)
