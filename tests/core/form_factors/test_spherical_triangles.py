"""Points spread by solid angle: the angle itself, and integrals over it against closed forms."""

import numpy as np
import pytest
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.form_factors.sampling import kronecker_points
from radiosity.core.form_factors.spherical_triangles import LEAST_ANGLE, points_by_solid_angle, solid_angles

GENERATOR = np.random.default_rng(17)
CORNERS = GENERATOR.normal(size=(20, 3, 3)) + np.array([0, 0, 3.0])
OCTANT = np.eye(3)


def test_solid_angle_of_an_octant():
    assert solid_angles(np.zeros((1, 3)), OCTANT[None])[0] == pytest.approx(np.pi / 2, rel=1e-14)


@pytest.mark.parametrize("scale", [1.0, 1e2, 1e6], ids=["near", "apart", "below the least angle"])
def test_cosines_over_the_solid_angle_sum_to_the_factor(scale):
    normal, count = np.array([0, 0, 1.0]), 4096
    for corners in CORNERS:
        corners = corners - corners.mean(axis=0) + np.array([0.2, 0.1, 1.0]) * max(scale, 4) / 2
        if (corners[:, 2] <= 0).any():
            continue
        triangles = np.broadcast_to(corners, (count, 3, 3))
        points, angles = points_by_solid_angle(np.zeros((count, 3)), triangles, kronecker_points(count, 2))
        assert (angles[0] < LEAST_ANGLE) == (scale == 1e6)
        cosines = points @ normal / np.linalg.norm(points, axis=1)
        sampled = (angles * cosines).mean() / np.pi
        wanted = max(point_to_polygon(np.zeros((1, 3)), normal[None], loop)[0] for loop in (corners, corners[::-1]))
        assert sampled == pytest.approx(wanted, rel=2e-3)


def test_points_lie_on_their_triangles_and_fill_them():
    count = 2000
    for corners in CORNERS:
        triangles = np.broadcast_to(corners, (count, 3, 3))
        points, _ = points_by_solid_angle(np.zeros((count, 3)), triangles, GENERATOR.random((count, 2)))
        places = np.linalg.solve(corners.T, points.T).T
        np.testing.assert_allclose(places.sum(axis=1), 1, atol=1e-9)
        assert places.min() > -1e-9
        assert (places.max(axis=0) > 0.8).all()
