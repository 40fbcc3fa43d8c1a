"""CIE 171:2006 tests 5.3, 5.6 and 5.8 by every solver and strategy, within 0.1 %, which is their exact level.

Points are squares of a millimeter here: over such a square the light of an area meters away changes by less than 1e-6.
"""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.hierarchy import SubdivisionLimits
from radiosity.core.solvers import SOLVERS
from radiosity.core.solvers.strategies import DIVISIONS, LOCAL_ENVIRONMENTS, STRATEGIES

from tests.reference_cases import form_factor_cases, polygons_of, solution_cases

CUBE = solution_cases()["cie171-5.8-public"]
SIDE = 1e-3
EXACT = 1e-3

#: Patches of a quarter of the room's side, and elements of an eighth.
LIMITS = SubdivisionLimits(patch_max=500, patch_min=300, element_max=250, element_min=150)


def square(point, normal):
    """A square of a millimeter around a point; normals lie along an axis."""
    axis = int(np.abs(normal).argmax())
    across, up = np.roll(np.eye(3), -1 - axis, axis=0)[:2] * SIDE / 2
    corners = np.array([-across - up, across - up, across + up, -across + up])
    return np.asarray(point, dtype=float) + corners[:: int(np.sign(normal[axis]))]


def lit_elements(environment, method):
    """Radiosity of an environment's surfaces (n, 3), by a solver or a strategy."""
    if method in LOCAL_ENVIRONMENTS:
        return core.solve(
            environment,
            method=method,
            factor_method="contour_integral",
            visibility="none",
            accuracy=1e-6,
            tolerance=1e-8,
        ).radiosity
    if method not in DIVISIONS:
        factors = core.form_factors(environment, method="contour_integral", visibility="none", accuracy=1e-6)
        return core.solve(environment, factors, method=method, tolerance=1e-8).radiosity
    choices = {"error": 0.5} if method == "adaptive" else {}
    solution = core.solve(
        environment, method=method, limits=LIMITS, factor_method="contour_integral", visibility="none", accuracy=1e-6,
        tolerance=1e-8, **choices,
    )  # fmt: skip
    surfaces = solution.hierarchy.surfaces[solution.hierarchy.elements]
    sums = np.zeros((len(environment), 3))
    np.add.at(sums, surfaces, solution.factors.areas[:, None] * solution.elements)
    return sums / environment.areas[:, None]


@pytest.mark.parametrize("method", [*SOLVERS, *STRATEGIES])
@pytest.mark.parametrize("name", ["cie171-5.3-diffuse", "cie171-5.6-s2"])
def test_points_lit_by_an_area(name, method):
    case = form_factor_cases()[name]
    (source,), _ = polygons_of(case)
    points = [square(element["point"], element["normal"]) for element in case["elements"]]
    # The standard's surface S2 reflects 0.3 of what arrives, which is what the points are told in parts of.
    reflectance = np.r_[0.3, np.full(len(points), 0.8)]
    environment = core.Environment.from_polygons([source, *points], reflectance, np.r_[0.3, np.zeros(len(points))])
    light = lit_elements(environment, method)[1:] / 0.8 / 0.3
    expected = np.array([entry["F"] for entry in case["expected"]])
    np.testing.assert_allclose(light, np.tile(expected[:, None], 3), rtol=EXACT)


@pytest.mark.parametrize("method", [*SOLVERS, *STRATEGIES])
@pytest.mark.parametrize("row", CUBE["expected"]["cases"], ids=lambda row: str(row["rho"]))
@pytest.mark.parametrize("lit", [[0, 1, 2, 3, 4, 5], [2]], ids=["evenly", "one wall"])
def test_mean_indirect_light_of_a_cube(lit, row, method):
    # All direct light on one wall or on all: the mean over the walls does not depend on it.
    polygons, _ = polygons_of(CUBE["geometry"])
    direct = np.zeros(6)
    direct[lit] = 10_000 / (16 * len(lit))
    environment = core.Environment.from_polygons(polygons, row["rho"], row["rho"] * direct)
    radiosity = lit_elements(environment, method)
    mean = environment.areas @ radiosity / environment.areas.sum()
    # What arrives after reflections is what leaves in the end less what was sent first, over the reflectance.
    indirect = mean / row["rho"] - row["E_direct"]
    assert EXACT == CUBE["tolerance"]["exact"]["rel"]
    np.testing.assert_allclose(indirect, row["E_indirect"], rtol=EXACT)
