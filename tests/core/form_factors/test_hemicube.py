"""Hemicube: published delta factors, convergence, closure, and honest errors."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.delta_factors import side_integrals, top_integrals
from radiosity.core.form_factors.hemicube import Hemicube, hemicube_at, hemicube_rows
from radiosity.core.form_factors.point_to_polygon import point_to_polygon

from tests.reference_cases import allowed, form_factor_cases, ids, in_order, polygons_of, surface_matrix

CASES = form_factor_cases()
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
UP = np.array([0.0, 0, 1])


def test_delta_factors_at_centers_are_the_published_ones():
    for value in CASES["rule-hemicube-sum-public"]["values"]:
        top, side = Hemicube.of(value["R"], "center").face_sums()
        assert top == pytest.approx(value["top"], abs=1e-9)
        assert side == pytest.approx(value["side"], abs=1e-9)
        assert top + 4 * side == pytest.approx(value["total"], abs=1e-9)


@pytest.mark.parametrize("resolution", [2, 3, 8, 65, 256])
def test_delta_factors_sum_to_one(resolution):
    cube = Hemicube.of(resolution)
    # Every row of pixels is a telescoping sum of values near 1.
    assert cube.deltas.sum() == pytest.approx(1, abs=1e-13)
    assert cube.deltas.min() > 0
    limits = CASES["rule-hemicube-sum-public"]["setup"]["limits"]
    assert cube.face_sums() == pytest.approx((limits["top"], limits["side"]), abs=1e-13)


def test_delta_factors_are_the_exact_factors_of_their_pixels():
    lines = np.array([-1, -0.4, 0.1, 0.7])
    for values, face in (
        (top_integrals(lines, lines + 0.3), lambda x, y: np.array([x, y, 1])),
        (side_integrals(lines, lines + 1), lambda x, y: np.array([1, x, y])),
    ):
        for row in range(3):
            for column in range(3):
                rows = lines + (0.3 if values is not None and face(0, 0)[2] == 1 else 1)
                x, y = lines[[column, column + 1]], rows[[row, row + 1]]
                loop = np.array([face(x[0], y[0]), face(x[0], y[1]), face(x[1], y[1]), face(x[1], y[0])])
                expected = point_to_polygon(np.zeros((1, 3)), UP[None], loop, two_sided=True)[0]
                assert values[row, column] == pytest.approx(expected, abs=1e-13)


def test_a_single_hemicube_reproduces_the_published_rule():
    case = CASES["rule-hemicube-ff-public"]
    setup = case["setup"]
    environment = core.Environment.from_polygons([np.array(setup["polygon"])])
    for value in case["values"]:
        cube = Hemicube.of(value["R"], "center")
        _, factors = hemicube_at(environment, setup["point"], setup["normal"], cube, setup["u_axis"])
        assert factors[0] == pytest.approx(value["F"], abs=1e-9)


def test_aliasing_falls_about_as_one_over_resolution():
    setup = CASES["rule-hemicube-ff-public"]["setup"]
    environment = core.Environment.from_polygons([np.array(setup["polygon"])])
    generator = np.random.default_rng(0)
    sizes = np.array([16, 32, 64, 128, 256])
    errors = []
    for size in sizes:
        # Columns along the polygon's edges are the worst case: whole rows of pixels are in or out together.
        shifts = generator.uniform(-0.05, 0.05, (40, 3)) * [1, 1, 0]
        found = [hemicube_at(environment, setup["point"] + s, UP, Hemicube.of(size), [1, 0, 0])[1][0] for s in shifts]
        exact = point_to_polygon(np.array(setup["point"]) + shifts, np.tile(UP, (40, 1)), environment.polygons[0])
        errors.append(np.sqrt(np.mean((found - exact) ** 2)))
    slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    # 40 places know each error to a tenth, and the slope over a factor of 16 to 0.06; three times that.
    assert -1.2 < slope < -0.8


def test_directions_belong_to_their_pixels():
    cube = Hemicube.of(9)
    environment = core.Environment.from_polygons(polygons_of(CASES["enc-box-5-4-3"])[0])
    point = environment.vertices.mean(axis=0) + [0.1, 0.2, -0.3]
    items, _ = hemicube_at(environment, point, UP, cube, [1, 0, 0])
    directions = cube.directions()
    heights = np.einsum("nk,nk->n", environment.centroids - point, environment.normals)
    reach = heights / (directions @ environment.normals.T)
    np.testing.assert_array_equal(items, np.where(reach > 0, reach, np.inf).argmin(axis=1))


@pytest.mark.parametrize("resolution", [16, 17])
@pytest.mark.parametrize("name", ["enc-cube", "enc-prism", "enc-L-room", "enc-facet-8"])
def test_rows_sum_to_one_in_closed_scenes(name, resolution):
    environment = core.Environment.from_polygons(polygons_of(CASES[name])[0])
    rows = hemicube_rows(environment, "zbuffer", 0.05, resolution=resolution)
    # No gap between polygons: every pixel of every hemicube meets one.
    np.testing.assert_allclose(rows.matrix.sum(axis=1), 1, atol=1e-12)
    assert not np.diag(rows.matrix).any() and rows.matrix.min() >= 0 and rows.rays == 0


@pytest.mark.parametrize("name", ["enc-cube", "enc-tetra", "enc-L-room", "enc-two-sealed-cubes", "enc-ward-room"])
def test_enclosures_at_the_fine_level(name):
    case = CASES[name]
    expected = np.array(case["matrix"]["F"])
    result, _, info = surface_matrix(case, method="hemicube", accuracy=1e-3)
    result = in_order(case, result, case["matrix"]["order"])
    error = np.abs(result - expected)
    assert (error > allowed(case, "fine", expected)).mean() <= 0.01
    assert error.max() < 4 * info.estimated_error and info.estimated_error < 1e-3
    assert not result[expected == 0].any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ids(CASES, "enclosure"))
def test_all_enclosures_at_the_coarse_level(name):
    case = CASES[name]
    expected = np.array(case["matrix"]["F"])
    result, _, _ = surface_matrix(case, method="hemicube")
    assert np.all(
        np.abs(in_order(case, result, case["matrix"]["order"]) - expected) <= allowed(case, "coarse", expected)
    )


def test_two_sided_patch_radiates_from_both_sides():
    middle, above = SQUARE + 0.5 * UP, SQUARE[::-1] + UP
    one_sided = core.Environment.from_polygons([SQUARE, middle[::-1], middle, above])
    two_sided = core.Environment.from_polygons([SQUARE, middle, above], two_sided=[False, True, False])
    apart, joined = (core.form_factors(e, method="hemicube", accuracy=1e-3).matrix for e in (one_sided, two_sided))
    assert joined[0, 1] == pytest.approx(apart[0, 1], abs=4e-3)
    assert joined[1, 0] == pytest.approx(apart[1, 0] / 2, abs=4e-3)
    assert joined[1, 2] == pytest.approx(apart[2, 3] / 2, abs=4e-3)
    assert joined[0, 2] == 0 and joined[1, 1] == 0


def test_a_patch_below_a_pixel_is_covered_by_the_reported_error():
    speck = (SQUARE[::-1] - 0.5) * 0.01 + [0.5, 0.5, 1]
    environment = core.Environment.from_polygons([SQUARE, speck])
    rows = hemicube_rows(environment, "zbuffer", 0.05, resolution=8)
    exact = core.form_factor(SQUARE, speck, accuracy=1e-7)
    assert abs(rows.matrix[0, 1] - exact) <= 3 * rows.errors[0]
    # From the speck the square is large, and reciprocity carries that over.
    result = core.form_factors(environment, method="hemicube", accuracy=1e-3)
    assert result.matrix[0, 1] == pytest.approx(exact, rel=0.01)


def test_same_seed_gives_the_same_matrix_and_rows_do_not_depend_on_others():
    environment = core.Environment.from_polygons(polygons_of(CASES["enc-facet-8"])[0])
    first, again, other = (hemicube_rows(environment, "zbuffer", 0.02, seed).matrix for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0


def test_bad_choices_are_refused():
    for resolution in (1, 0, 8.5):
        with pytest.raises(SettingsError, match="Resolution of a hemicube"):
            Hemicube.of(resolution)
    with pytest.raises(SettingsError, match="Unknown rule 'magic'"):
        Hemicube.of(8, "magic")
