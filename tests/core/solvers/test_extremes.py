"""Reflectance 1 and above, islands that exchange nothing, rooms without light: every solver and strategy says so."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.hierarchy import SubdivisionLimits
from radiosity.core.errors import SolverError
from radiosity.core.form_factors.rows_on_demand import rows_on_demand
from radiosity.core.solvers import SOLVERS
from radiosity.core.solvers.strategies import DIVISIONS, LOCAL_ENVIRONMENTS, STRATEGIES

from tests.reference_cases import form_factor_cases, polygons_of, solution_cases

#: Patches are a quarter of a cube's side, elements may be half as large.
LIMITS = SubdivisionLimits(patch_max=1000, patch_min=400, element_max=1000, element_min=200)
WAYS = [*SOLVERS, "rows", *STRATEGIES]
ITERATIVE = [name for name in SOLVERS if name != "direct"]


def cube(reflectance, emission):
    return core.Environment.from_polygons(polygons_of(form_factor_cases()["enc-cube"])[0], reflectance, emission)


def solve(environment, way, **choices):
    """A solution by the way of its name; the form factors are exact where nothing occludes."""
    if way in LOCAL_ENVIRONMENTS:
        return core.solve(environment, method=way, **({"accuracy": 2e-3} | choices))
    if way in DIVISIONS:
        choices = {"limits": LIMITS, "accuracy": 2e-3} | choices | ({"error": 0.3} if way == "adaptive" else {})
        return core.solve(environment, method=way, **choices)
    if way == "rows":
        return core.solve(environment, rows_on_demand(environment, accuracy=2e-3), **choices)
    return core.solve(environment, core.form_factors(environment, accuracy=2e-3), method=way, **choices)


def elements(solution):
    """Radiosity of all elements, and the surface of each; of the surfaces themselves where nothing was divided."""
    if getattr(solution, "hierarchy", None) is None:
        return solution.radiosity, np.arange(len(solution.radiosity))
    return solution.elements, solution.hierarchy.surfaces[solution.hierarchy.elements]


def areas(solution, sides):
    """Areas of the elements of unit squares, or of the squares."""
    return np.ones(sides) if getattr(solution, "factors", None) is None else solution.factors.areas


@pytest.mark.parametrize("way", WAYS)
def test_reflectance_above_1_is_clamped_and_said(way):
    emission = np.array([0, 1.0, 0, 0, 0, 0])
    with pytest.warns(UserWarning, match="Patch 3 with a reflectance outside 0 to 1: clamped"):
        environment = cube([0.5, 0.5, 0.5, 1.2, 0.5, 0.5], emission)
    here, there = (
        elements(solve(each, way))[0] for each in (environment, cube([0.5, 0.5, 0.5, 1, 0.5, 0.5], emission))
    )
    np.testing.assert_array_equal(here, there)
    assert here.min() > 0 and np.isfinite(here).all()


@pytest.mark.parametrize("way", WAYS)
def test_light_in_a_closed_room_of_reflectance_1_has_no_solution(way):
    environment = cube(1.0, np.array([0, 1.0, 0, 0, 0, 0]))
    if way in ("direct", *DIVISIONS):
        # Divided surfaces of so few patches are eliminated.
        with pytest.raises(SolverError, match="absorbs nothing"):
            solve(environment, way)
    if way != "direct":
        for solver in ITERATIVE if way in DIVISIONS else [None]:
            choices = {"solver": solver} if solver else {}
            solution = solve(environment, way, max_iterations=20, **choices)
            assert not solution.converged and solution.ended_by == "max_iterations"
            assert np.isfinite(solution.radiosity).all()


@pytest.mark.parametrize("way", WAYS)
def test_open_room_of_reflectance_1_has_one(way):
    case = solution_cases()["openpair-rho1"]
    where = form_factor_cases()[case["geometry"]["form_factor_case"]]
    polygons, _ = polygons_of(where)
    names = [surface["name"] for surface in where["surfaces"]]
    emission = np.concatenate([np.atleast_1d(case["emission"][name]) for name in names])
    environment = core.Environment.from_polygons(polygons, 1.0, emission)
    # One patch each, as in the published solution.
    whole = SubdivisionLimits(patch_max=2000, patch_min=2000, element_max=1000, element_min=1000)
    solution = solve(environment, way, tolerance=1e-8, **({"limits": whole} if way in DIVISIONS else {}))
    expected = np.concatenate([np.atleast_1d(case["expected"]["B"][name]) for name in names])
    np.testing.assert_allclose(solution.radiosity[:, 0], expected, rtol=case["tolerance"]["fine"]["rel"])


@pytest.mark.parametrize("way", WAYS)
def test_sealed_island_stays_black_and_does_not_dim_the_lit_one(way):
    where = form_factor_cases()["enc-two-sealed-cubes"]
    polygons, owners = polygons_of(where)
    names = np.array([surface["name"] for surface in where["surfaces"]])[owners]
    environment = core.Environment.from_polygons(polygons, 0.5, np.where(names == "L_ceiling", 1.0, 0.0))
    lit = solve(environment, way)
    radiosity, surfaces = elements(lit)
    dark = np.char.startswith(names[surfaces], "R_")
    assert dark.any() and not dark.all()
    assert not radiosity[dark].any()
    alone = np.flatnonzero(np.char.startswith(names, "L_"))
    room = core.Environment.from_polygons([polygons[row] for row in alone], 0.5, environment.emission[alone])
    # Closed rooms absorb what is emitted, half of it at each meeting: mean radiosity is twice the mean emission.
    for solution, sides in ((lit, 12), (solve(room, way), 6)):
        powers = np.zeros((sides, 3))
        np.add.at(powers, elements(solution)[1], areas(solution, sides)[:, None] * elements(solution)[0])
        # The rows' sums are not mended: they hold to the accuracy.
        np.testing.assert_allclose(powers.sum(axis=0), 2.0, rtol=2e-3 if way == "rows" else 1e-6)


@pytest.mark.parametrize("way", WAYS)
def test_islands_that_see_nothing_keep_what_they_emit(way):
    # Two squares back to back, and one beside them.
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    apart = [square, square[::-1] - np.array([0, 0, 0.1]), square + np.array([5, 0, 0])]
    emission = np.array([1.0, 0.0, 0.25])
    radiosity, surfaces = elements(solve(core.Environment.from_polygons(apart, 0.8, emission), way))
    np.testing.assert_array_equal(radiosity, np.tile(emission[surfaces][:, None], 3))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("reflectance", [0.5, 1.0])
def test_room_without_light_is_dark(reflectance, way):
    solution = solve(cube(reflectance, 0.0), way)
    assert solution.converged and solution.residual == 0
    assert not elements(solution)[0].any()
    if way in DIVISIONS:
        assert solution.rows == len(solution.elements)
