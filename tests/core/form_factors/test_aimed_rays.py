"""Aimed rays: pairs that whole hemispheres leave uncertain, and the points that they start from."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.form_factors import aimed_rays, identities, segment_samples
from radiosity.core.form_factors.aimed_rays import hemisphere_factors
from radiosity.core.form_factors.faces import Faces, smaller_first
from radiosity.core.form_factors.hemisphere import hemisphere_rows
from radiosity.core.form_factors.sampling import kronecker_points
from radiosity.core.form_factors.segment_samples import SegmentSamples
from radiosity.core.form_factors.sobol import sobol_points
from radiosity.core.visibility.segments import make_visibility

from tests.reference_cases import form_factor_cases, polygons_of

CASES = form_factor_cases()
SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
ABOVE = SQUARE[::-1] + np.array([0, 0, 1])


def box():
    return core.Environment.from_polygons(polygons_of(CASES["enc-box-5-4-3"])[0])


def test_a_far_patch_is_known_to_a_share_of_its_factor():
    polygons = [SQUARE, ABOVE + np.array([0, 0, 999])]
    found = core.form_factors(core.Environment.from_polygons(polygons), "hemisphere").matrix[0, 1]
    # What a single ray of the thousands that fill a hemisphere stands for is a hundred times as much.
    assert found == pytest.approx(core.form_factor(*polygons, accuracy=1e-9), rel=2e-2)


def test_two_sided_patches_count_on_both_sides():
    middle = SQUARE + np.array([0, 0, 0.5])
    one_sided = core.Environment.from_polygons([SQUARE, middle[::-1], middle, ABOVE])
    two_sided = core.Environment.from_polygons([SQUARE, middle, ABOVE], two_sided=[False, True, False])
    apart, joined = (core.form_factors(e, "hemisphere", accuracy=1e-3).matrix for e in (one_sided, two_sided))
    # Three times what each of both errs by, by `allowed_error` of a factor of 0.4.
    assert joined[0, 1] == pytest.approx(apart[0, 1], abs=2e-3)
    assert joined[1, 2] == pytest.approx(apart[2, 3] / 2, abs=2e-3)
    assert joined[0, 2] == 0 and joined[1, 1] == 0


def test_stated_errors_are_true():
    environment = box()
    exact = core.form_factors(environment, accuracy=1e-6).matrix
    deviations, stated = [], []
    for seed in range(8):
        rows = hemisphere_factors(environment, "embree", 5e-3, seed)
        smaller = np.minimum(environment.areas[:, None], environment.areas)
        deviations.append((rows.matrix - exact) * environment.areas[:, None] / smaller)
        stated.append(np.sqrt(rows.variances) / smaller)
    upper = np.triu_indices(len(environment), 1)
    ratios = np.array([(d / s)[upper] for d, s in zip(deviations, stated, strict=True)])
    # Of Student's distribution of 7 degrees of freedom, with a variance of 7/5; 120 values know it to a fifth.
    assert 0.7 < np.sqrt(np.square(ratios).mean()) < 1.6


def test_many_patches_are_left_to_rows(monkeypatch):
    environment = box()
    assert hemisphere_factors(environment, "embree", 5e-3).variances is not None
    monkeypatch.setattr(aimed_rays, "FEW_PATCHES", 5)
    np.testing.assert_array_equal(
        hemisphere_factors(environment, "embree", 5e-3).matrix, hemisphere_rows(environment, 5e-3).matrix
    )


def test_a_repair_changes_what_is_uncertain():
    areas = np.ones(3)
    matrix = np.array([[0, 0.5, 0.4], [0.5, 0, 0.5], [0.4, 0.5, 0]])
    variances = np.array([[0, 1e-12, 1e-4], [1e-12, 0, 1e-12], [1e-4, 1e-12, 0]])
    repaired = identities.repair(matrix, areas, True, variances=variances)
    np.testing.assert_allclose(repaired, (1 - np.eye(3)) / 2, atol=1e-9)
    # Rows 0 and 2 lack as much, and only the pair that they share may give it.
    assert abs(identities.repair(matrix, areas, False, variances=variances) - matrix).max() < 1e-15


def test_points_fill_every_box():
    for dimensions in (1, 2, 3, 4):
        points = sobol_points(2**10, dimensions)
        for axis in range(dimensions):
            assert (np.bincount((points[:, axis] * 2**10).astype(int)) == 1).all()
    # The first two are a (0, 10, 2)-net: each of these boxes of one thousandth holds one point.
    points = sobol_points(2**10, 2)
    for level in range(11):
        cells = (points * (2**level, 2 ** (10 - level))).astype(int)
        assert len(np.unique(cells, axis=0)) == 2**10
    np.testing.assert_array_equal(sobol_points(100, 4)[:, :2], sobol_points(128, 2)[:100])


def test_touching_walls_do_not_resonate_with_the_points(monkeypatch):
    """2048 multiples of irrational numbers leave 3 % of the factors between walls, for every shift of them."""
    environment = box()
    faces = Faces(environment)
    samples = SegmentSamples(environment, faces, make_visibility("embree", environment, 1))
    first, second = smaller_first(environment.areas, *np.triu_indices(len(environment), 1))
    exact = core.form_factors(environment, "contour_integral", "none").matrix[first, second]
    shifts = np.random.default_rng(0).random((8, len(first), 4))
    errors = []
    for points in (sobol_points, kronecker_points):
        monkeypatch.setattr(segment_samples, "sobol_points", points)
        found = np.array([samples(first, second, 2048, shift)[0] / 2048 for shift in shifts])
        errors.append(np.sqrt(np.square(found / exact - 1).mean()))
    # Measured 0.0038 and 0.032.
    assert errors[0] < 6e-3 and errors[0] < errors[1] / 4
