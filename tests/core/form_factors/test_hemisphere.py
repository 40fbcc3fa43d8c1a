"""Hemisphere: the statistics of its rays."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors import hemisphere
from radiosity.core.form_factors.hemisphere import hemisphere_rows, standard_error

from tests.reference_cases import form_factor_cases, polygons_of

CASES = form_factor_cases()


def test_standard_error_is_the_binomial_one():
    for value in CASES["rule-ray-sampling"]["values"]:
        assert standard_error(value["F"], value["N"]) == pytest.approx(value["sigma"], abs=1e-9)


def root_mean_square(sampling, rays, monkeypatch, seeds=24):
    """Error of F[0, 1] in a cube from so many rays in all, and the factor."""
    case = CASES["enc-cube"]
    environment = core.Environment.from_polygons(polygons_of(case)[0])
    monkeypatch.setattr(hemisphere, "FIRST_RAYS", rays // hemisphere.REPETITIONS)
    monkeypatch.setattr(hemisphere, "FIRST_ACCURACY", 1)
    exact = np.array(case["matrix"]["F"])[0]
    found = [hemisphere_rows(environment, 0.999, seed, 1, sampling).matrix[0] for seed in range(seeds)]
    return np.sqrt(np.mean((np.array(found)[:, 1:] - exact[1:]) ** 2)), exact[1]


def test_errors_fall_as_theory_says(monkeypatch):
    rays = np.array([256, 1024, 4096, 16384])
    slopes = {}
    for sampling in ("random", "low_discrepancy"):
        errors = [root_mean_square(sampling, int(count), monkeypatch)[0] for count in rays]
        slopes[sampling] = np.polyfit(np.log(rays), np.log(errors), 1)[0]
        if sampling == "random":
            # 24 runs of 5 factors each, not quite independent: the spread is known to a tenth.
            np.testing.assert_allclose(errors, standard_error(0.2, rays), rtol=0.3)
    # Each of the four errors is known to a tenth, so the slope over a factor of 64 to 0.03: two and a half of that.
    assert slopes["random"] == pytest.approx(-0.5, abs=0.08)
    assert slopes["low_discrepancy"] < -0.58


def test_random_rays_reach_the_accuracy_asked_for():
    case = CASES["enc-cube"]
    environment = core.Environment.from_polygons(polygons_of(case)[0])
    result = core.form_factors(environment, method="hemisphere", sampling="random", accuracy=4e-3)
    assert np.abs(result.matrix - np.array(case["matrix"]["F"])).max() < 4 * 4e-3
    assert result.estimated_error <= 4e-3
    with pytest.raises(SettingsError, match="Unknown sampling 'magic'"):
        core.form_factors(environment, method="hemisphere", sampling="magic")


def test_both_sides_of_a_patch_are_sampled_all_over():
    # Below one half of a sheet and above its other half, a plate each. The sheet sends to each half of what a patch of
    # one side that is parallel to it would.
    sheet = np.array([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)], dtype=float)
    above = sheet * (0.5, 1, 1) + (0, 0, 0.2)
    below = sheet * (0.5, 1, 1) + (1, 0, -0.2)
    plates = [sheet, above[::-1], below]
    environment = core.Environment.from_polygons(plates, two_sided=np.array([True, False, False]))
    one_side = core.Environment.from_polygons([sheet, above[::-1]])
    exact = core.form_factors(one_side, "contour_integral", accuracy=1e-6).matrix[0, 1] / 2
    found = hemisphere_rows(environment, 1e-3).matrix[0, 1:]
    # Four standard errors.
    np.testing.assert_allclose(found, exact, atol=4e-3)
