"""Single plane: published coverage, proxels of equal share, and the share that is lost."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.delta_factors import top_corner
from radiosity.core.form_factors.single_plane import SinglePlane, captured_share, half_width, single_plane_rows

from tests.reference_cases import allowed, form_factor_cases, in_order, polygons_of, surface_matrix

CASES = form_factor_cases()


def test_coverage_is_the_published_one_and_can_be_inverted():
    for value in CASES["rule-single-plane-public"]["values"]:
        assert captured_share(value["w"]) == pytest.approx(value["captured"], abs=1e-9)
        assert half_width(value["lost"]) == pytest.approx(value["w"], rel=1e-9)


@pytest.mark.parametrize("lost", [0.3, 1e-2, 1e-5])
@pytest.mark.parametrize("resolution", [2, 7, 24])
def test_proxels_have_equal_shares_and_fill_the_plane(resolution, lost):
    plane = SinglePlane.of(lost, resolution)
    assert plane.lost == pytest.approx(lost, abs=1e-13)
    assert plane.deltas.sum() == pytest.approx(1 - lost, abs=1e-12)
    assert np.ptp(plane.deltas) == 0
    assert (np.diff(plane.columns, axis=1) > 0).all() and (np.diff(plane.rows) > 0).all()
    assert np.abs(plane.columns).max() < plane.half_width
    # A row's samples halve its cells: as much lies between two neighbors as in a proxel.
    inner = resolution // 2
    levels = np.linspace(-0.5, 0.5, resolution + 1) * (1 - plane.lost)
    strip = 2 * top_corner(plane.half_width, plane.rows)
    np.testing.assert_allclose(strip, (levels[1:] + levels[:-1]) / 2, atol=1e-12)
    np.testing.assert_allclose(plane.columns, -plane.columns[:, ::-1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(plane.columns[inner], plane.columns[-1 - inner], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["enc-cube", "enc-tetra", "enc-L-room", "enc-two-sealed-cubes"])
def test_enclosures_at_the_fine_level(name):
    case = CASES[name]
    expected = np.array(case["matrix"]["F"])
    result, _, info = surface_matrix(case, method="single_plane", accuracy=1e-3)
    error = np.abs(in_order(case, result, case["matrix"]["order"]) - expected)
    assert (error > allowed(case, "fine", expected)).mean() <= 0.01
    assert info.closed and error.max() < 4 * info.estimated_error


def test_what_passes_beside_the_plane_is_reported():
    environment = core.Environment.from_polygons(polygons_of(CASES["enc-cube"])[0])
    rows = single_plane_rows(environment, "zbuffer", 0.02, lost=0.05)
    np.testing.assert_allclose(rows.escaped, 0.05, atol=1e-12)
    np.testing.assert_allclose(rows.matrix.sum(axis=1), 0.95, atol=1e-12)
    assert (rows.errors > 0.05).all()
    expected = np.array(CASES["enc-cube"]["matrix"]["F"])
    assert np.abs(rows.matrix - expected).max() < rows.errors.min()


def test_bad_choices_are_refused():
    with pytest.raises(SettingsError, match="Resolution of a single plane"):
        SinglePlane.of(0.1, 1)
    for lost in (0, 1, -0.1, float("nan"), 1e-14):
        with pytest.raises(SettingsError, match="Share lost beside a single plane"):
            half_width(lost)
