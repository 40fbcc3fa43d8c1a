"""Rows on demand: those of the whole matrix, whatever else is asked for, and those of parts of patches."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.environment import Environment
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.clipped_quadrature import clipped_rows
from radiosity.core.form_factors.contour_integral import contour_rows
from radiosity.core.form_factors.hemicube import hemicube_rows
from radiosity.core.form_factors.hemisphere import hemisphere_rows
from radiosity.core.form_factors.quadrature import quadrature_rows
from radiosity.core.form_factors.rows_on_demand import Receivers, rows_on_demand
from radiosity.core.form_factors.single_plane import single_plane_rows

from tests.reference_cases import form_factor_cases, polygons_of

CASES = form_factor_cases()
ACCURACY = 1e-2
BLOCKED = {
    ("hemisphere", "embree"): lambda e: hemisphere_rows(e, ACCURACY),
    ("hemicube", "zbuffer"): lambda e: hemicube_rows(e, "zbuffer", ACCURACY),
    ("single_plane", "zbuffer"): lambda e: single_plane_rows(e, "zbuffer", ACCURACY),
    ("point_to_polygon", "bsp"): lambda e: clipped_rows(e, "bsp", ACCURACY),
    ("point_to_polygon", "none"): lambda e: quadrature_rows(e, "none", ACCURACY),
    ("contour_integral", "none"): lambda e: contour_rows(e, "none", ACCURACY),
}
SAMPLED = [("contour_integral", "embree"), ("point_to_polygon", "embree")]
WHOLE = [("disk", "embree"), ("point_to_point", "silhouettes"), ("hybrid", "embree")]
OF_PARTS = [*(names for names in BLOCKED if names[1] != "bsp"), *SAMPLED]


def room(two_sided=False):
    """A closed room with a table, one patch without area, and where asked for two-sided sheets."""
    polygons, _ = polygons_of(CASES["enc-cube"])
    sheet = np.array([[0.2, 0.2, 0.4], [0.7, 0.2, 0.4], [0.7, 0.8, 0.4], [0.2, 0.8, 0.4]])
    line = np.array([[0.1, 0.1, 0.5], [0.2, 0.1, 0.5], [0.3, 0.1, 0.5]])
    below = [] if two_sided else [sheet[::-1] - [0, 0, 0.05]]
    sides = [False] * 6 + [two_sided, False] + [False] * len(below)
    with pytest.warns(UserWarning, match="without area"):
        return Environment.from_polygons([*polygons, sheet, line, *below], two_sided=sides)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("names", BLOCKED, ids=" ".join)
def test_rows_are_those_of_the_matrix_in_any_company(names, two_sided):
    environment = room(two_sided)
    matrix = BLOCKED[names](environment).matrix
    rows = rows_on_demand(environment, *names, accuracy=ACCURACY)
    # Sums in another order round differently; contours are taken from the other end.
    np.testing.assert_allclose(rows(np.array([6])), matrix[[6]], atol=1e-12)
    np.testing.assert_allclose(rows(np.array([7, 2, 6, 0])), matrix[[7, 2, 6, 0]], atol=1e-12)
    assert rows.computed == 4 and rows.method == names[0]
    assert not rows(np.array([7])).any()


@pytest.mark.parametrize("names", [*SAMPLED, *WHOLE], ids=" ".join)
def test_every_other_method_gives_rows_too(names):
    environment = room()
    exact = core.form_factors(environment, "point_to_polygon", "bsp", accuracy=1e-4).matrix
    rows = rows_on_demand(environment, *names, accuracy=ACCURACY)(np.array([1, 6]))
    # Point to point states its own error on so coarse a room; the others keep theirs.
    allowed = 0.05 if names[0] == "point_to_point" else 4 * ACCURACY
    np.testing.assert_allclose(rows, exact[[1, 6]], atol=allowed)


@pytest.mark.parametrize("names", OF_PARTS, ids=" ".join)
def test_rows_of_parts_average_to_that_of_their_patch(names):
    environment = room()
    rows = rows_on_demand(environment, *names, accuracy=ACCURACY)
    floor, top = (np.asarray(environment.polygons[patch]) for patch in (0, 6))
    parts = [part for loop in (floor, top) for part in quarters(loop)]
    receivers = Receivers(Environment.from_polygons(parts), np.repeat([0, 6], 4), np.arange(100, 108))
    factors = rows.of(receivers)
    whole = rows(np.array([0, 6]))
    # Survey eq. 12, with parts of equal area; each of the errors is a standard error or a bound.
    np.testing.assert_allclose(factors.reshape(2, 4, -1).mean(axis=1), whole, atol=4 * ACCURACY)
    alone = rows.of(Receivers(Environment.from_polygons(parts[3:4]), np.array([0]), np.array([103])))
    if names != ("point_to_polygon", "embree"):
        np.testing.assert_allclose(alone, factors[3:4], atol=1e-12)
    assert np.all(factors[:4, 0] == 0) and np.all(factors[4:, 6] == 0)


def quarters(loop):
    a, b, c, d = loop
    middle = (a + c) / 2
    return [np.array(part) for part in ((a, (a + b) / 2, middle, (a + d) / 2), ((a + b) / 2, b, (b + c) / 2, middle),
            (middle, (b + c) / 2, c, (c + d) / 2), ((a + d) / 2, middle, (c + d) / 2, d))]  # fmt: skip


def test_methods_that_know_patches_only_say_so():
    environment = room()
    receivers = Receivers(Environment.from_polygons(environment.polygons[:1]), np.array([0]), np.array([0]))
    for names in (("disk", "embree"), ("point_to_polygon", "bsp")):
        with pytest.raises(SettingsError, match="Rows of elements do not exist by"):
            rows_on_demand(environment, *names).of(receivers)
    with pytest.raises(SettingsError, match="Unknown form-factor method"):
        rows_on_demand(environment, "magic")
    with pytest.raises(SettingsError, match="Unknown sampling"):
        rows_on_demand(environment, "hemisphere", sampling="magic")


def test_auto_takes_contours_where_nothing_can_block():
    polygons, _ = polygons_of(CASES["enc-cube"])
    assert rows_on_demand(room()).method == "hemisphere"
    rows = rows_on_demand(Environment.from_polygons(polygons))
    assert rows.method == "contour_integral"
    np.testing.assert_allclose(rows(np.arange(6)), CASES["enc-cube"]["matrix"]["F"], atol=1e-5)


@pytest.mark.parametrize("names", [*BLOCKED, *SAMPLED, *WHOLE], ids=" ".join)
def test_shooting_works_with_every_method(names):
    environment = room()
    environment = Environment.from_polygons(
        [polygon for polygon, area in zip(environment.polygons, environment.areas, strict=True) if area > 0],
        0.7, [0, 1, 0, 0, 0, 0, 0, 0],
    )  # fmt: skip
    rows = rows_on_demand(environment, *names, accuracy=ACCURACY)
    solution = core.solve(environment, rows, tolerance=1e-6)
    assert solution.converged and rows.computed <= 8
    matrix = rows(np.arange(8))
    exchange = environment.areas[:, None] * matrix
    # The limit is the solution of the rows as they are: F_ji = F_ij A_i / A_j.
    other = exchange.T / environment.areas[:, None]
    exact = core.solve_radiosity(other, environment.reflectance, environment.emission, environment.areas).radiosity
    np.testing.assert_allclose(solution.radiosity, exact, rtol=1e-4)
